//! Which joints are the bones of a human body, by the tree and by places alone.

use glam::DVec3;
use riglab_core::{Bounds, Humanoid, JointId, Skeleton};

use super::hands;
use super::tree::Tree;

/// The human bones of a skeleton with y up; `None` for what is no upright body with legs, arms and a head.
///
/// Names of joints are not looked at. `mesh` is the box around the mesh, which tells where the ground and the top of
/// the head are. Which side is left is told by the feet; without toes, a body is taken to look along +z (or, where its
/// legs stand along z, along +x).
pub fn humanoid(skeleton: &Skeleton, mesh: Option<Bounds>) -> Option<Humanoid> {
    let tree = Tree::new(skeleton);
    Body::of(&tree, mesh).filter(|body| tree.is_below(body.legs.0, body.hips)).map(Body::humanoid)
}

/// As [`humanoid`], also of a tree that is none of a body: legs may hang on a root on the ground beside the hips, as they do
/// in rigs whose feet are led. For who asks where bones are, not what hangs on what.
pub fn human_bones(skeleton: &Skeleton, mesh: Option<Bounds>) -> Option<Humanoid> {
    Body::of(&Tree::new(skeleton), mesh).map(Body::humanoid)
}

/// A body as found.
struct Body {
    bones: Vec<(String, usize)>,
    hips: usize,
    legs: (usize, usize),
}

/// A leg or an arm: joints by their names without the side.
type Limb = Vec<(&'static str, usize)>;

impl Body {
    fn of(tree: &Tree, mesh: Option<Bounds>) -> Option<Self> {
        if !(tree.size > 0.0 && tree.size.is_finite()) {
            return None;
        }
        // Left and right are along x but for models that look along it, or between.
        let half = 0.5f64.sqrt();
        let sides = [DVec3::X, DVec3::NEG_Z, DVec3::new(half, 0.0, -half), DVec3::new(half, 0.0, half)];
        sides.into_iter().find_map(|side| Self::find(tree, side, mesh))
    }

    fn find(tree: &Tree, side: DVec3, mesh: Option<Bounds>) -> Option<Self> {
        let lowest = tree.heads.iter().map(|h| h.y).fold(f64::INFINITY, f64::min);
        let highest = tree.heads.iter().map(|h| h.y).fold(f64::NEG_INFINITY, f64::max);
        let (ground, top) = mesh.map_or((lowest, highest), |b| (f64::from(b.min[1]), f64::from(b.max[1])));
        let height = (top - ground).max(f64::MIN_POSITIVE);

        let (fork, legs) = legs(tree, side, ground, height)?;
        let apart = tree.heads[legs.0] - tree.heads[legs.1];
        if apart.dot(side).abs() < 0.85 * apart.x.hypot(apart.z) {
            return None;
        }
        let from = 0.5 * (tree.heads[legs.0] + tree.heads[legs.1]);
        let from = if tree.heads[fork].y < rise(tree, legs) { from } else { tree.heads[fork] };
        let (chest, arms) = arms(tree, side, (fork, from), &legs, height)?;
        // Where the legs hang on a bone of their own beside the spine, the joint above both is the hips.
        let hips = std::iter::successors(Some(fork), |&j| tree.parents[j]).find(|&j| tree.is_below(chest, j))?;
        // A root on the ground is no hips: those are where the spine begins.
        let hips = if tree.heads[hips].y < rise(tree, legs) { *tree.path(hips, chest).first()? } else { hips };
        let hips = if hips == chest { return None } else { hips };
        let spine = tree.path(hips, chest);

        let mut bones: Vec<(String, usize)> = vec![("hips".into(), hips)];
        let torso: &[usize] = &spine;
        let names: Vec<(&str, usize)> = match *torso {
            [] => return None,
            [a] => vec![("spine", a)],
            [a, b] => vec![("spine", a), ("chest", b)],
            [a, b, .., c] => vec![("spine", a), ("chest", b), ("upperChest", c)],
        };
        bones.extend(names.into_iter().map(|(name, joint)| (name.to_owned(), joint)));
        bones.extend(head(tree, side, chest, &arms, top)?.into_iter().map(|(name, joint)| (name.to_owned(), joint)));

        let limbs = [legs.0, legs.1].map(|leg| leg_bones(tree, leg));
        let ahead = ahead(tree, side, &limbs);
        let left = DVec3::Y.cross(ahead);
        let is_left = |a: usize, b: usize| (tree.branches[a].end - tree.branches[b].end).dot(left) > 0.0;
        let sides = |a: usize, b: usize| if is_left(a, b) { ["left", "right"] } else { ["right", "left"] };
        for (prefix, limb) in sides(legs.0, legs.1).into_iter().zip(limbs) {
            bones.extend(limb?.into_iter().map(|(name, joint)| (format!("{prefix}{name}"), joint)));
        }
        for (prefix, start) in sides(arms.0, arms.1).into_iter().zip([arms.0, arms.1]) {
            bones.extend(
                arm_bones(tree, start, ahead)?.into_iter().map(|(name, joint)| (format!("{prefix}{name}"), joint)),
            );
        }
        Some(Self { bones, hips, legs })
    }

    fn humanoid(self) -> Humanoid {
        let mut humanoid = Humanoid::default();
        for (name, joint) in self.bones {
            if let (Ok(bone), Ok(joint)) = (name.parse(), u16::try_from(joint)) {
                humanoid.insert(bone, JointId(joint));
            }
        }
        humanoid
    }
}

/// The height at a third of the legs, below which no hips are.
fn rise(tree: &Tree, (a, b): (usize, usize)) -> f64 {
    let top = 0.5 * (tree.heads[a].y + tree.heads[b].y);
    let end = 0.5 * (tree.branches[a].end.y + tree.branches[b].end.y);
    end + (top - end) / 3.0
}

/// The joint that legs hang on, and the legs: the pair that goes down the most, of those that reach the ground. Arms
/// that hang down may nearly do so.
fn legs(tree: &Tree, side: DVec3, ground: f64, height: f64) -> Option<(usize, (usize, usize))> {
    let mut best: Option<(f64, usize, (usize, usize))> = None;
    for joint in 0..tree.heads.len() {
        for (a, b) in tree.pairs(joint, side) {
            let end = tree.branches[a].end.y.max(tree.branches[b].end.y);
            // From where they begin, should that be higher than what they hang on.
            let down = tree.heads[joint].y.max(0.5 * (tree.heads[a].y + tree.heads[b].y)) - end;
            let score = down - 3.0 * (end - ground).max(0.0);
            let slim = tree.branches[a].joints >= 2 && tree.branches[b].joints >= 2;
            if slim
                && end - ground < 0.2 * height
                && down > 0.15 * height
                && best.is_none_or(|(most, _, _)| score > most)
            {
                best = Some((score, joint, (a, b)));
            }
        }
    }
    best.map(|(_, joint, pair)| (joint, pair))
}

/// The joint that arms hang on, and the arms: a pair above the legs, of a body that stands.
/// `from`: the joint that legs hang on, and where they begin.
fn arms(
    tree: &Tree,
    side: DVec3,
    (fork, from): (usize, DVec3),
    legs: &(usize, usize),
    height: f64,
) -> Option<(usize, (usize, usize))> {
    let mut best: Option<(f64, usize, (usize, usize))> = None;
    for joint in 0..tree.heads.len() {
        if tree.is_below(joint, legs.0) || tree.is_below(joint, legs.1) {
            continue;
        }
        let up = tree.heads[joint] - from;
        let along = (up - DVec3::Y * up.y).length();
        // A body that lies has front legs there.
        if up.y < 0.05 * height || along > up.y {
            continue;
        }
        for (a, b) in tree.pairs(joint, side) {
            if tree.branches[a].joints.min(tree.branches[b].joints) < 2 || [a, b].contains(&fork) {
                continue;
            }
            let arm = tree.reach(a).min(tree.reach(b));
            // Hands have fingers; wings, ears and hair have none.
            let hands = tree.chain(a).iter().any(|&j| tree.is_fan(j));
            let score = arm * if hands { 1.5 } else { 1.0 };
            if arm > 0.12 * height && best.is_none_or(|(most, _, _)| score > most) {
                best = Some((score, joint, (a, b)));
            }
        }
    }
    best.map(|(_, joint, pair)| (joint, pair))
}

/// Neck, head and eyes.
fn head(tree: &Tree, side: DVec3, chest: usize, arms: &(usize, usize), top: f64) -> Option<Limb> {
    let (at, middle) = (tree.heads[chest], tree.size * 0.08);
    let beside = |c: usize| (tree.heads[c] - at).dot(side).abs();
    let upward = |c: usize| tree.branches[c].end.y.max(tree.heads[c].y) - at.y;
    // Not hair or a cape, which may have more joints: what rises, in the middle.
    let others = tree.children[chest].iter().copied().filter(|&c| c != arms.0 && c != arms.1 && beside(c) < middle);
    let start = others.filter(|&c| tree.heads[c].y >= at.y - 1e-3 * tree.size).max_by(|&a, &b| {
        let key = |c: usize| upward(c).max(tree.heads[c].y - at.y);
        key(a).total_cmp(&key(b)).then(b.cmp(&a))
    })?;
    let mut chain = vec![start];
    while let [.., last] = chain[..] {
        let own = &tree.children[last];
        let rises = |c: &usize| tree.heads[*c].y > tree.heads[last].y && beside(*c) < middle;
        match own.iter().copied().filter(rises).collect::<Vec<_>>()[..] {
            // A head has much on it; below that, a neck may have a hood or a beard, but one way up.
            [one] if own.len() == 1 || (chain.len() == 1 && tree.branches[one].joints > 1) => chain.push(one),
            _ => break,
        }
    }
    let share = |j: usize| (tree.heads[j].y - at.y) / (top - at.y).max(f64::MIN_POSITIVE);
    // The end of the head, for those who look for its size.
    if let [.., before, last] = chain[..]
        && tree.children[last].is_empty()
        && (chain.len() > 2 || share(last) > 0.7 && share(before) < 0.6)
    {
        chain.pop();
    }
    let &head = chain.last()?;
    let mut found: Limb = vec![("head", head)];
    if chain.len() > 1 {
        found.push(("neck", chain[0]));
    }
    Some(found)
}

/// Thigh, shin, foot and toes.
fn leg_bones(tree: &Tree, start: usize) -> Option<Limb> {
    let chain = tree.chain(start);
    let ground = chain.iter().map(|&j| tree.heads[j].y).fold(f64::INFINITY, f64::min);
    let hip = tree.heads[start].y - ground;
    let low = |j: usize| tree.heads[j].y - ground < 0.27 * hip;
    let foot = (1..chain.len()).find(|&at| low(chain[at]));
    let last = match foot {
        Some(at) if at >= 2 => at,
        // A foot at the knee's place, or none: two joints make a thigh and a shin.
        _ => return (chain.len() >= 2).then(|| vec![("UpperLeg", chain[0]), ("LowerLeg", chain[1])]),
    };
    let (upper, lower) = bend(tree, &chain[..=last])?;
    let mut found = vec![("UpperLeg", upper), ("LowerLeg", lower), ("Foot", chain[last])];
    if let Some(&toes) = chain.get(last + 1) {
        found.push(("Toes", toes));
    }
    Some(found)
}

/// Collar, arm and hand with its fingers.
fn arm_bones(tree: &Tree, start: usize, ahead: DVec3) -> Option<Limb> {
    let between = |a: usize, b: usize| tree.heads[a].distance(tree.heads[b]);
    let even = |a: usize, b: usize, c: usize| {
        between(a, b).min(between(b, c)) / between(a, b).max(between(b, c)).max(f64::MIN_POSITIVE)
    };
    let mut chain = tree.chain(start);
    if let Some(palm) = (2..chain.len()).find(|&at| tree.is_fan(chain[at])) {
        chain.truncate(palm + 1);
    } else {
        // Without a palm, what goes on behind the hand is one finger or the end.
        match chain[..] {
            [a, b, c, d, ..] => {
                let collar = between(a, b) < 0.8 * between(b, c) || even(b, c, d) > even(a, b, c);
                let end = between(c, d) < 0.45 * between(b, c);
                chain.truncate(if collar && !(end && even(a, b, c) > 0.6) { 4 } else { 3 });
            }
            // Three joints are a collar and an arm without a hand where the first bone is short.
            [a, b, c] if even(a, b, c) < 0.5 && between(a, b) < between(b, c) => {
                return Some(vec![("Shoulder", a), ("UpperArm", b), ("LowerArm", c)]);
            }
            [a, b] => return Some(vec![("UpperArm", a), ("LowerArm", b)]),
            _ => {}
        }
    }
    // Four joints to the hand begin with a collar, however long it is drawn.
    let (shoulder, arm) = if chain.len() >= 4 { (Some(chain[0]), &chain[1..]) } else { (None, &chain[..]) };
    let (upper, lower) = bend(tree, arm)?;
    let &hand = chain.last()?;
    let mut found = vec![("UpperArm", upper), ("LowerArm", lower), ("Hand", hand)];
    found.extend(shoulder.map(|joint| ("Shoulder", joint)));
    found.extend(hands::fingers(tree, hand, lower, ahead));
    Some(found)
}

/// Where a limb begins and where it bends: of a chain to its last joint the two others that part it most evenly,
/// with little left before.
fn bend(tree: &Tree, chain: &[usize]) -> Option<(usize, usize)> {
    let &last = chain.last()?;
    if let [a, b] = chain {
        return Some((*a, *b));
    }
    let between = |a: usize, b: usize| tree.heads[a].distance(tree.heads[b]);
    let whole: f64 = chain.windows(2).map(|w| between(w[0], w[1])).sum();
    let mut best: Option<(f64, (usize, usize))> = None;
    for (i, &upper) in chain[..chain.len() - 1].iter().enumerate() {
        for &lower in &chain[i + 1..chain.len() - 1] {
            let (a, b) = (between(upper, lower), between(lower, last));
            let score = a.min(b) / a.max(b).max(f64::MIN_POSITIVE) * (a + b) / whole.max(f64::MIN_POSITIVE);
            if best.is_none_or(|(most, _)| score > most) {
                best = Some((score, (upper, lower)));
            }
        }
    }
    best.map(|(_, found)| found)
}

/// The direction in which a body looks.
fn ahead(tree: &Tree, side: DVec3, legs: &[Option<Limb>; 2]) -> DVec3 {
    let ahead = side.cross(DVec3::Y);
    let step = |leg: &Limb| {
        let at = |name: &str| leg.iter().find(|(n, _)| *n == name).map(|(_, j)| *j);
        // From the heel, as far as the longest way goes on.
        let foot = at("Toes").and(at("Foot"))?;
        Some((tree.branches[foot].end - tree.heads[foot]).dot(ahead))
    };
    let forward: f64 = legs.iter().flatten().filter_map(step).sum();
    if forward < -0.005 * tree.size { -ahead } else { ahead }
}
