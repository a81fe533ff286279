//! Joints that hold nothing.

use serde::{Deserialize, Serialize};

use crate::delete::WEIGHTLESS;
use crate::draft::Draft;
use crate::rules::Colliders;

/// Drops joints without weight that the tree does not need (`trim` of SkinTokens' public code).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrimConfig {
    /// Whether.
    pub enabled: bool,
}

impl TrimConfig {
    /// Trims if enabled.
    pub fn apply(&self, draft: &mut Draft) {
        if self.enabled {
            trim(draft);
        }
    }
}

/// Drops joints whose weights sum to 1e-6 or less, but for forks with weight in two branches or more, and
/// the first joint of a branch of such a fork. So a root that only moves the whole goes, too.
pub fn trim(draft: &mut Draft) {
    let children = draft.children();
    let has: Vec<bool> = draft.held().into_iter().map(|sum| sum > WEIGHTLESS).collect();
    // Whether there is weight at or below a joint; parents come first.
    let mut below = has.clone();
    for joint in (0..below.len()).rev() {
        if let (true, Some(parent)) = (below[joint], draft.parents[joint]) {
            below[parent.index()] = true;
        }
    }
    let branches: Vec<usize> = children.iter().map(|c| c.iter().filter(|&&c| below[c]).count()).collect();
    let below_fork = |joint: usize| draft.parents[joint].is_some_and(|p| branches[p.index()] > 1);
    let needed = |joint: usize| branches[joint] > 1 || branches[joint] == 1 && below_fork(joint);
    let keep: Vec<bool> = (0..has.len()).map(|joint| has[joint] || needed(joint)).collect();
    // One tree: two parts without a common joint would have been branches of a fork.
    draft.keep_tree(&keep, Colliders::Stay);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draft::tests::{after, chain, origins};

    #[test]
    fn joints_that_nothing_needs_go() {
        // Joint 5 holds nothing and stands beside joint 2.
        assert_eq!(origins(&after(trim)), [0, 1, 2, 3, 4]);
        assert_eq!(after(|d| TrimConfig::default().apply(d)).rig, chain());
    }

    /// What is left of a root and joints with these parents, when some of them hold a vertex each.
    fn trimmed(parents: &[u16], held: &[u16]) -> Vec<u16> {
        use riglab_core::{Joint, JointId, Mesh, Rig, Skeleton, SkinWeights};
        let joint = |(j, parent): (usize, Option<u16>)| Joint {
            name: format!("joint {j}"),
            parent: parent.map(JointId),
            head: [0.0; 3],
        };
        let parents = std::iter::once(None).chain(parents.iter().copied().map(Some)).enumerate();
        let skeleton = Skeleton::new(parents.map(joint).collect()).unwrap();
        let mesh = Mesh::new(vec![[0.0; 3]; held.len()], vec![[0; 3]]).unwrap();
        let weights = SkinWeights::normalized(held.iter().map(|&j| [(j, 1.0)])).unwrap();
        let mut draft = Draft::open(Rig::new(skeleton, mesh, weights).unwrap());
        trim(&mut draft);
        origins(&draft.close().unwrap())
    }

    #[test]
    fn forks_stay_and_the_ends_of_bones_go() {
        // 1 is a fork of 2 and 3; 4 hangs alone on 3, 5 on 4.
        assert_eq!(trimmed(&[0, 1, 1, 3, 4], &[2, 3]), [1, 2, 3]);
        // One branch is no fork.
        assert_eq!(trimmed(&[0, 1, 1], &[0, 2]), [0, 2]);
    }

    #[test]
    fn the_first_joint_of_a_branch_stays() {
        // Below the fork 1: 2 leads on to 5 by way of 4; 3 has weight; 6 leads nowhere.
        assert_eq!(trimmed(&[0, 1, 1, 2, 4, 1], &[3, 5]), [1, 2, 3, 5]);
        // A joint with weight may be the fork.
        assert_eq!(trimmed(&[0, 0, 1, 2], &[0, 3, 4]), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn a_root_that_only_moves_the_whole_goes() {
        assert_eq!(trimmed(&[0, 1, 2, 0], &[2, 3]), [2, 3]);
        assert_eq!(trimmed(&[0, 0, 1, 2], &[3, 4]), [0, 1, 2, 3, 4]);
    }
}
