//! Joints in one tree.

use std::collections::HashSet;

use serde::{Deserialize, Serialize};

use crate::{RigError, Vec3};

/// The number of a joint in its skeleton.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct JointId(pub u16);

impl JointId {
    /// For indexing.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// One joint as given to [`Skeleton::new`].
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Unique, not empty.
    pub name: String,
    /// `None` for the root alone.
    pub parent: Option<JointId>,
    /// Position at rest.
    pub head: Vec3,
}

/// A tree of joints at rest: the root first, parents before children.
#[derive(Clone, Debug, PartialEq)]
pub struct Skeleton {
    names: Vec<String>,
    parents: Vec<Option<JointId>>,
    heads: Vec<Vec3>,
}

impl Skeleton {
    /// Checks the joints and keeps their order.
    ///
    /// # Errors
    /// The first violation of the crate's invariants, with the joint's number and name.
    pub fn new(joints: Vec<Joint>) -> Result<Self, RigError> {
        if joints.is_empty() {
            return Err(RigError::NoJoints);
        }
        if joints.len() > usize::from(u16::MAX) {
            return Err(RigError::TooManyJoints(joints.len()));
        }
        let mut seen = HashSet::with_capacity(joints.len());
        for (joint, Joint { name, parent, head }) in joints.iter().enumerate() {
            if name.is_empty() || !seen.insert(name.as_str()) {
                return Err(RigError::BadName { joint, name: name.clone() });
            }
            match parent {
                None if joint > 0 => return Err(RigError::SecondRoot { joint, name: name.clone() }),
                Some(_) if joint == 0 => return Err(RigError::RootNotFirst(name.clone())),
                Some(p) if p.index() >= joint => {
                    return Err(RigError::ParentAfterChild { joint, name: name.clone(), parent: p.index() });
                }
                _ => {}
            }
            if !head.iter().all(|x| x.is_finite()) {
                return Err(RigError::JointNotFinite { joint, name: name.clone() });
            }
        }
        let mut skeleton = Self {
            names: Vec::with_capacity(joints.len()),
            parents: Vec::with_capacity(joints.len()),
            heads: Vec::with_capacity(joints.len()),
        };
        for Joint { name, parent, head } in joints {
            skeleton.names.push(name);
            skeleton.parents.push(parent);
            skeleton.heads.push(head);
        }
        Ok(skeleton)
    }

    /// How many joints; at least 1.
    #[allow(clippy::len_without_is_empty)] // never empty
    pub fn len(&self) -> usize {
        self.heads.len()
    }

    /// All joints, root first.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = JointId> + DoubleEndedIterator + use<> {
        (0..self.len() as u16).map(JointId)
    }

    /// The name of a joint.
    pub fn name(&self, joint: JointId) -> &str {
        &self.names[joint.index()]
    }

    /// The names in joint order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The parent of a joint; `None` for the root.
    pub fn parent(&self, joint: JointId) -> Option<JointId> {
        self.parents[joint.index()]
    }

    /// The parents in joint order.
    pub fn parents(&self) -> &[Option<JointId>] {
        &self.parents
    }

    /// The position of a joint at rest.
    pub fn head(&self, joint: JointId) -> Vec3 {
        self.heads[joint.index()]
    }

    /// Rest positions in joint order.
    pub fn heads(&self) -> &[Vec3] {
        &self.heads
    }

    /// The children of every joint, in joint order.
    pub fn children(&self) -> Vec<Vec<JointId>> {
        let mut children = vec![Vec::new(); self.len()];
        for joint in self.ids() {
            if let Some(parent) = self.parent(joint) {
                children[parent.index()].push(joint);
            }
        }
        children
    }

    /// A number that is equal for equal trees, whatever the names, positions and order of children.
    pub fn topology(&self) -> u64 {
        let mut hashes = vec![Vec::new(); self.len()];
        let mut root = 0;
        // Children come after their parents: from the back, each is complete when it is reached.
        for joint in self.ids().rev() {
            let below: &mut Vec<u64> = &mut hashes[joint.index()];
            below.sort_unstable();
            // FNV-1a over the children's numbers.
            let own = below.iter().fold(0xcbf2_9ce4_8422_2325u64, |h, &c| {
                c.to_le_bytes().iter().fold(h, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
            });
            match self.parent(joint) {
                Some(parent) => hashes[parent.index()].push(own),
                None => root = own,
            }
        }
        root
    }

    /// Names, parents and positions at rest, in joint order.
    pub fn into_parts(self) -> (Vec<String>, Vec<Option<JointId>>, Vec<Vec3>) {
        (self.names, self.parents, self.heads)
    }

    /// The same tree with other positions.
    ///
    /// # Errors
    /// [`RigError::JointNotFinite`], or [`RigError::PoseLength`] when the count differs.
    pub fn with_heads(&self, heads: Vec<Vec3>) -> Result<Self, RigError> {
        if heads.len() != self.len() {
            return Err(RigError::PoseLength { pose: heads.len(), joints: self.len() });
        }
        if let Some(joint) = heads.iter().position(|h| !h.iter().all(|x| x.is_finite())) {
            return Err(RigError::JointNotFinite { joint, name: self.names[joint].clone() });
        }
        Ok(Self { names: self.names.clone(), parents: self.parents.clone(), heads })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(name: &str, parent: Option<u16>, x: f32) -> Joint {
        Joint { name: name.into(), parent: parent.map(JointId), head: [x, 0.0, 0.0] }
    }

    #[test]
    fn a_chain_is_valid() {
        let s = Skeleton::new(vec![joint("a", None, 0.0), joint("b", Some(0), 1.0), joint("c", Some(1), 2.0)]).unwrap();
        assert_eq!(s.children(), [vec![JointId(1)], vec![JointId(2)], vec![]]);
    }

    #[test]
    fn topology_is_blind_to_order_and_names() {
        // A root with a leaf and a chain of two, in both orders, and with two leaves and a chain of one.
        let tree = |parents: &[u16]| {
            let below = parents.iter().enumerate().map(|(i, &p)| joint(&format!("j{i}"), Some(p), 0.0));
            Skeleton::new(std::iter::once(joint("root", None, 0.0)).chain(below).collect()).unwrap().topology()
        };
        assert_eq!(tree(&[0, 0, 2]), tree(&[0, 1, 0]));
        assert_ne!(tree(&[0, 0, 2]), tree(&[0, 0, 0]));
    }

    #[test]
    fn each_fault_has_its_error() {
        let faults = [
            (vec![], "no joints"),
            (vec![joint("a", Some(0), 0.0)], "root comes first"),
            (vec![joint("a", None, 0.0), joint("b", None, 0.0)], "no parent"),
            (vec![joint("a", None, 0.0), joint("b", Some(1), 0.0)], "does not come before"),
            (vec![joint("a", None, 0.0), joint("a", Some(0), 0.0)], "taken"),
            (vec![joint("", None, 0.0)], "empty"),
            (vec![joint("a", None, f32::NAN)], "not finite"),
        ];
        for (joints, text) in faults {
            let error = Skeleton::new(joints).unwrap_err().to_string();
            assert!(error.contains(text), "{error} / {text}");
        }
    }
}
