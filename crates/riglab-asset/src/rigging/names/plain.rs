//! Names that say where a joint is: for all that is no human bone.

use std::collections::BTreeMap;

use glam::DVec3;
use riglab_core::{Bounds, Skeleton};

use super::tree::Tree;

/// How far off the middle a chain is beside it, as a share of the size.
const BESIDE: f64 = 0.03;
/// What ends below this share of the height stands on the ground.
const GROUND: f64 = 0.15;

/// A name for each joint: `root`, then `spine_1`, `leg_2_l_1`, `tail_3` and so on: what the chain it is on seems to
/// be, which of several such (from front to back), the side, the number in the chain.
///
/// Chains are read off the tree: each joint goes on to the child with the most joints below, pairs of limbs apart. A chain in the
/// middle that holds others is `spine`, one that ends there in front `head`, behind `tail`; one beside it that ends on
/// the ground `leg`, above it `arm`; short ones are `part`. Sides are those of a model with y up that looks along +z.
/// The same tree and places give the same names.
pub(super) fn names(skeleton: &Skeleton, mesh: Option<Bounds>) -> Vec<String> {
    let tree = Tree::new(skeleton);
    let mut names = vec!["root".to_owned(); tree.heads.len()];
    let box_of = mesh.map(|b| [b.min, b.max].map(|p| glam::Vec3::from(p).as_dvec3()));
    let ends = tree.heads.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let [low, high] = box_of.unwrap_or([ends.0, ends.1]);
    let frame = Frame { middle: 0.5 * (low + high), low: low.min(ends.0), size: (high - low).max_element() };

    // By part and side: the chains, front to back.
    let mut chains: BTreeMap<(&'static str, &'static str), Vec<Vec<usize>>> = BTreeMap::new();
    // The trunk goes on from the root; every other chain starts at a joint that is not its parent's main child.
    let next: Vec<Option<usize>> = (0..tree.heads.len()).map(|joint| goes_on(&tree, joint)).collect();
    let mut starts: Vec<usize> = next[0].into_iter().collect();
    for (joint, next) in next.iter().enumerate() {
        starts.extend(tree.children[joint].iter().copied().filter(|c| Some(*c) != *next));
    }
    for start in starts {
        let chain: Vec<usize> = std::iter::successors(Some(start), |&joint| next[joint]).collect();
        chains.entry(frame.kind(&tree, &chain)).or_default().push(chain);
    }
    for ((part, side), mut all) in chains {
        // Stable: equals stay in the order of the joints.
        all.sort_by(|a, b| tree.heads[b[0]].z.total_cmp(&tree.heads[a[0]].z));
        let several = all.len() > 1;
        for (number, chain) in all.into_iter().enumerate() {
            let which = if several { format!("_{}", number + 1) } else { String::new() };
            for (at, joint) in chain.into_iter().enumerate() {
                names[joint] = format!("{part}{which}{side}_{}", at + 1);
            }
        }
    }
    names
}

/// The joint in which a chain goes on: of those that are no pair of limbs, the one with the most joints below.
fn goes_on(tree: &Tree, joint: usize) -> Option<usize> {
    let limbs: Vec<usize> = tree.pairs(joint, DVec3::X).into_iter().flat_map(|(a, b)| [a, b]).collect();
    let others: Vec<usize> = tree.children[joint].iter().copied().filter(|c| !limbs.contains(c)).collect();
    others.into_iter().reduce(|best, c| if tree.branches[c].joints > tree.branches[best].joints { c } else { best })
}

/// Where a model is.
struct Frame {
    middle: DVec3,
    low: DVec3,
    size: f64,
}

impl Frame {
    /// What a chain seems to be, and its side.
    fn kind(&self, tree: &Tree, chain: &[usize]) -> (&'static str, &'static str) {
        let (first, last) = (tree.heads[chain[0]], tree.heads[chain[chain.len() - 1]]);
        let size = self.size.max(f64::MIN_POSITIVE);
        let off = |p: DVec3| (p.x - self.middle.x) / size;
        let furthest =
            chain.iter().map(|&j| off(tree.heads[j])).fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        let side = match furthest {
            x if x > BESIDE => "_l",
            x if x < -BESIDE => "_r",
            _ => "",
        };
        let length = tree.reach(chain[0]);
        let height = (last.y - self.low.y) / size;
        let part = if length < 0.1 * size {
            "part"
        } else if !side.is_empty() {
            if height < GROUND && first.y - last.y > 0.1 * size { "leg" } else { "arm" }
        } else if chain.iter().any(|&j| tree.children[j].len() > 1) {
            "spine"
        } else if last.z < first.z - 0.05 * size && last.z < self.middle.z {
            "tail"
        } else {
            "head"
        };
        (part, side)
    }
}
