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

/// Drops joints whose weights sum to 1e-6 or less, but for the root, forks with weight in two branches
/// or more, and a joint alone below one with weight: it says where that bone ends.
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
    let keep: Vec<bool> = (0..has.len())
        .map(|joint| {
            let branches = children[joint].iter().filter(|&&c| below[c]).count();
            let alone = draft.parents[joint].is_some_and(|p| has[p.index()] && children[p.index()].len() == 1);
            has[joint] || branches > 1 || alone
        })
        .collect();
    draft.keep_joints(&keep, Colliders::Stay);
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

    #[test]
    fn forks_and_ends_stay() {
        let trimmed = |parents: &[u16], held: &[u16]| {
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
        };
        // 1 is a fork of 2 and 3; 4 hangs alone on 3; 5 on 4, which holds nothing.
        assert_eq!(trimmed(&[0, 1, 1, 3, 4], &[2, 3]), [0, 1, 2, 3, 4]);
        // One branch is no fork.
        assert_eq!(trimmed(&[0, 1, 1], &[2]), [0, 2]);
    }
}
