//! Joints that go with what they hold: a creature without an arm, a coat without its sleeves.

use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::Draft;
use crate::rules::{Colliders, Fault, inside, probability};
use crate::select::close_upwards;

/// Deletes joints with their vertices (SkinTokens, 4.1.2; paper and public code: scattered joints
/// with probability 0.5, up to half of them; paper: or whole subtrees).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DeleteConfig {
    /// How often.
    pub probability: f32,
    /// Largest share of the joints that go; the share is drawn anew each time. 0 to 1.
    pub up_to: f32,
    /// How often, of those times, whole subtrees go instead of scattered joints.
    pub subtrees: f32,
}

impl Default for DeleteConfig {
    fn default() -> Self {
        Self { probability: 0.0, up_to: 0.5, subtrees: 0.5 }
    }
}

/// A joint is dominant on a vertex from this weight on.
const DOMINANT: f32 = 0.1;

/// A weight that holds a vertex.
pub(crate) const HOLDS: f32 = 1e-5;

/// Sum of weights below which a joint counts as without weight.
pub(crate) const WEIGHTLESS: f64 = 1e-6;

impl DeleteConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("up_to", self.up_to, 0.0, 1.0)?;
        probability("subtrees", self.subtrees)
    }

    /// Draws whether and what, and deletes it.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if !random.chance(self.probability) {
            return;
        }
        let share = self.up_to * random.unit();
        let joints = draft.joints();
        let mut order: Vec<usize> = (1..joints).collect();
        if random.chance(self.subtrees) {
            random.shuffled(&mut order);
            let budget = (joints as f32 * share) as usize;
            let keep = without_subtrees(draft, &order, budget);
            keep_part(draft, &keep);
        } else {
            random.shuffled(&mut order);
            let mut keep = vec![false; joints];
            let count = ((joints as f32 * (1.0 - share)) as usize).max(1);
            order.iter().take(count).for_each(|&j| keep[j] = true);
            delete(draft, &keep);
        }
    }
}

/// Marks what is left when subtrees go, tried in an order, as long as no more than `budget` joints do.
fn without_subtrees(draft: &Draft, order: &[usize], budget: usize) -> Vec<bool> {
    let children = draft.children();
    let mut keep = vec![true; draft.joints()];
    let mut left = budget;
    for &root in order {
        let (mut subtree, mut next) = (Vec::new(), vec![root]);
        while let Some(joint) = next.pop().filter(|_| subtree.len() <= left) {
            if keep[joint] {
                subtree.push(joint);
                next.extend(&children[joint]);
            }
        }
        if subtree.len() <= left {
            left -= subtree.len();
            subtree.iter().for_each(|&j| keep[j] = false);
        }
    }
    keep
}

/// Deletes the joints that are not marked, each with the vertices it dominates: those where its
/// weight is the largest and above 0.1. The root stays, so do joints without weight and those that
/// dominate fewer vertices than a joint does on average; and all stay when no triangle would be left.
/// Weights that remain of deleted joints go to their nearest ancestor.
pub fn delete(draft: &mut Draft, keep: &[bool]) {
    let (joints, vertices) = (draft.joints(), draft.vertices());
    let dominant: Vec<Option<usize>> = (0..vertices).map(|v| dominant(draft, v)).collect();
    let mut counts = vec![0usize; joints];
    dominant.iter().flatten().for_each(|&j| counts[j] += 1);
    let held = draft.held();
    let stays: Vec<bool> =
        (0..joints).map(|j| j == 0 || keep[j] || held[j] <= WEIGHTLESS || counts[j] * joints < vertices).collect();
    let left: Vec<bool> = dominant.iter().map(|d| d.is_none_or(|j| stays[j])).collect();
    if draft.keep_vertices(&left) {
        draft.keep_joints(&stays, Colliders::Go);
    }
}

/// The joint with the largest weight, the first of equals, if it is above 0.1.
fn dominant(draft: &Draft, vertex: usize) -> Option<usize> {
    let largest = draft.row(vertex).reduce(|a, b| if b.1 > a.1 { b } else { a });
    largest.filter(|(_, w)| *w > DOMINANT).map(|(j, _)| j)
}

/// Keeps the joints that are marked, with their ancestors, and the vertices that any of them holds
/// by more than 1e-5. All stay when no joint is marked or no triangle would be left.
pub fn keep_part(draft: &mut Draft, keep: &[bool]) {
    // Closing upwards would mark the root, and leave what it alone holds.
    if !keep.contains(&true) {
        return;
    }
    let mut keep = keep.to_vec();
    close_upwards(&mut keep, &draft.parents);
    let left: Vec<bool> = (0..draft.vertices()).map(|v| draft.row(v).any(|(j, w)| keep[j] && w > HOLDS)).collect();
    if draft.keep_vertices(&left) {
        draft.keep_joints(&keep, Colliders::Go);
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::{after, chain, origins};

    #[test]
    fn a_joint_goes_with_what_it_dominates() {
        // Joint 2: the vertices at 2, and those at 2.5 where it is the first of equals.
        let done = after(|d| delete(d, &[true, true, false, true, true, true]));
        assert_eq!(origins(&done), [0, 1, 3, 4, 5]);
        assert_eq!(done.rig.mesh().positions().len(), 14);
        // What it held of the vertices at 1.5 went to joint 1.
        let last: Vec<_> = done.rig.weights().row(7).map(|(j, w)| (j.0, w)).collect();
        assert_eq!((done.rig.mesh().positions()[7], last), ([1.5, 0.5, 0.0], vec![(1, 1.0)]));
        // Joint 4 dominates two vertices, a joint on average three; joint 5 has no weight.
        assert_eq!(after(|d| delete(d, &[true, true, true, true, false, false])).rig, chain());
    }

    #[test]
    fn subtrees_go_whole() {
        let order = [3, 1, 5, 2, 4];
        let keep = |budget| without_subtrees(&crate::Draft::open(chain()), &order, budget);
        // The subtree of joint 3 has 2 joints, that of joint 1 all but the root.
        assert_eq!(keep(0), [true; 6]);
        assert_eq!(keep(1), [true, true, true, true, true, false]);
        assert_eq!(keep(2), [true, true, true, false, false, true]);
        assert_eq!(keep(4), [true, true, false, false, false, false]);
        let done = after(|d| keep_part(d, &keep(2)));
        // Vertices beyond 2.5 are held by joints 3 and 4 alone.
        assert_eq!((origins(&done), done.rig.mesh().positions().len()), (vec![0, 1, 2, 5], 12));
    }

    #[test]
    fn a_part_of_no_joints_is_the_whole() {
        assert_eq!(after(|d| keep_part(d, &[false; 6])).rig, chain());
        // The root's, once it is marked.
        let mut keep = [false; 6];
        keep[0] = true;
        assert_eq!(origins(&after(|d| keep_part(d, &keep))), [0]);
    }

    #[test]
    fn never_more_than_asked_goes_and_often_something() {
        let config = DeleteConfig { probability: 0.5, up_to: 0.5, subtrees: 0.5 };
        let left = |k| origins(&after(|d| config.apply(d, &mut stream(1, "test", &[k])))).len();
        let left: Vec<usize> = (0..400).map(left).collect();
        assert_eq!(left.iter().min(), Some(&4));
        let untouched = left.iter().filter(|n| **n == 6).count();
        assert!((200..340).contains(&untouched), "{untouched}");
    }
}
