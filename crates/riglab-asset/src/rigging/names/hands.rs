//! Fingers.

use glam::DVec3;

use super::tree::Tree;

const THUMB: [&str; 3] = ["ThumbMetacarpal", "ThumbProximal", "ThumbDistal"];
const FINGERS: [[&str; 3]; 4] = [
    ["IndexProximal", "IndexIntermediate", "IndexDistal"],
    ["MiddleProximal", "MiddleIntermediate", "MiddleDistal"],
    ["RingProximal", "RingIntermediate", "RingDistal"],
    ["LittleProximal", "LittleIntermediate", "LittleDistal"],
];

/// The fingers of a hand: chains of two joints or more that hang on it. The thumb is the one that points away from
/// the others; those count from it.
pub(super) fn fingers(tree: &Tree, hand: usize, elbow: usize, ahead: DVec3) -> Vec<(&'static str, usize)> {
    let mut chains: Vec<Vec<usize>> = Vec::new();
    for &child in &tree.children[hand] {
        // Fingers may share a bone of the palm.
        let starts = if tree.is_fan(child) { tree.children[child].clone() } else { vec![child] };
        chains.extend(starts.into_iter().map(|start| tree.chain(start)).filter(|chain| chain.len() >= 2));
    }
    if !(2..=6).contains(&chains.len()) {
        return Vec::new();
    }
    let way = |chain: &[usize]| (tree.heads[chain[chain.len() - 1]] - tree.heads[chain[0]]).normalize_or_zero();
    let Some(arm) = (tree.heads[hand] - tree.heads[elbow]).try_normalize() else { return Vec::new() };
    let along = |chain: &[usize]| (tree.heads[chain[0]] - tree.heads[hand]).dot(arm);
    let reach = chains.iter().map(|c| along(c)).fold(f64::MIN_POSITIVE, f64::max);
    let forward = |chain: &[usize]| tree.heads[chain[0]].dot(ahead);
    let (back, front) =
        chains.iter().map(|c| forward(c)).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    // Nearer to the wrist than others, turned away from them, and where palms look down or in, the foremost.
    let odd = |at: usize| {
        let others: DVec3 = (0..chains.len()).filter(|&o| o != at).map(|o| way(&chains[o])).sum();
        let turned = 1.0 - way(&chains[at]).dot(others.normalize_or_zero());
        let foremost = (forward(&chains[at]) - back) / (front - back).max(f64::MIN_POSITIVE);
        turned + 0.7 * (1.0 - along(&chains[at]) / reach) + 0.3 * foremost
    };
    let thumb = (0..chains.len()).map(|at| (at, odd(at))).reduce(|a, b| if b.1 > a.1 { b } else { a });
    let Some((thumb, _)) = thumb else { return Vec::new() };
    let thumb = chains.remove(thumb);
    // Across the palm, from the side of the thumb.
    let from = tree.heads[thumb[0]];
    let bases = chains.iter().map(|c| tree.heads[c[0]]);
    let Some(last) = bases.reduce(|a, b| if b.distance(from) > a.distance(from) { b } else { a }) else {
        return Vec::new();
    };
    let across = (last - from).reject_from_normalized(arm);
    chains.sort_by(|a, b| tree.heads[a[0]].dot(across).total_cmp(&tree.heads[b[0]].dot(across)));

    let mut found = name(&thumb, &THUMB);
    for (chain, names) in chains.iter().zip(&FINGERS) {
        found.extend(name(chain, names));
    }
    found
}

/// The joints of a finger. The fifth, and the fourth where there are no bones of the palm, is its end.
fn name(chain: &[usize], names: &[&'static str; 3]) -> Vec<(&'static str, usize)> {
    let skip = usize::from(chain.len() >= 5);
    names.iter().copied().zip(chain.iter().skip(skip).copied()).collect()
}
