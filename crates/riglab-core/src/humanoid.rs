//! Which joints are the bones of a human body.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::JointId;

/// The human bones of VRM 1.0, body first, then the fingers.
const NAMES: [&str; 55] = [
    "hips",
    "spine",
    "chest",
    "upperChest",
    "neck",
    "head",
    "leftEye",
    "rightEye",
    "jaw",
    "leftUpperLeg",
    "leftLowerLeg",
    "leftFoot",
    "leftToes",
    "rightUpperLeg",
    "rightLowerLeg",
    "rightFoot",
    "rightToes",
    "leftShoulder",
    "leftUpperArm",
    "leftLowerArm",
    "leftHand",
    "rightShoulder",
    "rightUpperArm",
    "rightLowerArm",
    "rightHand",
    "leftThumbMetacarpal",
    "leftThumbProximal",
    "leftThumbDistal",
    "leftIndexProximal",
    "leftIndexIntermediate",
    "leftIndexDistal",
    "leftMiddleProximal",
    "leftMiddleIntermediate",
    "leftMiddleDistal",
    "leftRingProximal",
    "leftRingIntermediate",
    "leftRingDistal",
    "leftLittleProximal",
    "leftLittleIntermediate",
    "leftLittleDistal",
    "rightThumbMetacarpal",
    "rightThumbProximal",
    "rightThumbDistal",
    "rightIndexProximal",
    "rightIndexIntermediate",
    "rightIndexDistal",
    "rightMiddleProximal",
    "rightMiddleIntermediate",
    "rightMiddleDistal",
    "rightRingProximal",
    "rightRingIntermediate",
    "rightRingDistal",
    "rightLittleProximal",
    "rightLittleIntermediate",
    "rightLittleDistal",
];

/// Those that VRM 1.0 asks every humanoid for.
const REQUIRED: [&str; 15] = [
    "hips",
    "spine",
    "head",
    "leftUpperLeg",
    "leftLowerLeg",
    "leftFoot",
    "rightUpperLeg",
    "rightLowerLeg",
    "rightFoot",
    "leftUpperArm",
    "leftLowerArm",
    "leftHand",
    "rightUpperArm",
    "rightLowerArm",
    "rightHand",
];

/// A bone of the human body, by its name in VRM 1.0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct HumanBone(u8);

impl HumanBone {
    /// All of them, body first.
    pub fn all() -> impl ExactSizeIterator<Item = Self> {
        (0..NAMES.len() as u8).map(Self)
    }

    /// Its name in VRM 1.0, such as `leftUpperArm`.
    pub fn name(self) -> &'static str {
        NAMES[usize::from(self.0)]
    }

    /// The bone of the other side; itself in the middle.
    pub fn mirrored(self) -> Self {
        let name = self.name();
        let other = match (name.strip_prefix("left"), name.strip_prefix("right")) {
            (Some(rest), _) => format!("right{rest}"),
            (_, Some(rest)) => format!("left{rest}"),
            _ => return self,
        };
        other.parse().unwrap_or(self)
    }

    /// Whether VRM 1.0 asks every humanoid for it.
    pub fn is_required(self) -> bool {
        REQUIRED.contains(&self.name())
    }
}

impl FromStr for HumanBone {
    type Err = ();

    fn from_str(name: &str) -> Result<Self, ()> {
        NAMES.iter().position(|n| *n == name).map(|at| Self(at as u8)).ok_or(())
    }
}

impl fmt::Display for HumanBone {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Which joints are which human bones: each bone at most once, each joint at most one bone. Empty for
/// what is no humanoid, or not known to be one.
///
/// Stored as an object with the joint's number for each bone.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "BTreeMap<String, JointId>", try_from = "BTreeMap<String, JointId>")]
pub struct Humanoid(Vec<(HumanBone, JointId)>);

impl Humanoid {
    /// Adds a bone. Gives back whether it was free, and the joint too; nothing changes if not.
    pub fn insert(&mut self, bone: HumanBone, joint: JointId) -> bool {
        if self.0.iter().any(|&(b, j)| b == bone || j == joint) {
            return false;
        }
        let at = self.0.partition_point(|&(b, _)| b < bone);
        self.0.insert(at, (bone, joint));
        true
    }

    /// The joint of a bone.
    pub fn joint(&self, bone: HumanBone) -> Option<JointId> {
        self.0.iter().find(|(b, _)| *b == bone).map(|(_, joint)| *joint)
    }

    /// Bones and their joints, body first.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (HumanBone, JointId)> + '_ {
        self.0.iter().copied()
    }

    /// How many bones.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether it has all bones that VRM 1.0 asks for.
    pub fn is_complete(&self) -> bool {
        HumanBone::all().filter(|b| b.is_required()).all(|b| self.joint(b).is_some())
    }
}

impl From<Humanoid> for BTreeMap<String, JointId> {
    fn from(humanoid: Humanoid) -> Self {
        humanoid.iter().map(|(bone, joint)| (bone.name().to_owned(), joint)).collect()
    }
}

impl TryFrom<BTreeMap<String, JointId>> for Humanoid {
    type Error = String;

    fn try_from(stored: BTreeMap<String, JointId>) -> Result<Self, String> {
        let mut humanoid = Self::default();
        for (name, joint) in stored {
            let bone = name.parse().map_err(|()| format!("`{name}` is no human bone"))?;
            if !humanoid.insert(bone, joint) {
                return Err(format!("`{name}` is a joint that is another bone already"));
            }
        }
        Ok(humanoid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_both_ways_and_are_unlike() {
        for bone in HumanBone::all() {
            assert_eq!(bone.name().parse(), Ok(bone));
        }
        let sides: Vec<_> = HumanBone::all().filter(|b| b.mirrored() != *b).collect();
        assert_eq!(sides.len(), NAMES.len() - 7);
        assert!(sides.into_iter().all(|b| b.mirrored().mirrored() == b));
        assert_eq!("tail".parse::<HumanBone>(), Err(()));
        assert_eq!(HumanBone::all().filter(|b| b.is_required()).count(), REQUIRED.len());
    }

    #[test]
    fn a_bone_is_one_joint_and_a_joint_one_bone() {
        let (head, hips) = ("head".parse().unwrap(), "hips".parse().unwrap());
        let mut humanoid = Humanoid::default();
        assert!(humanoid.insert(head, JointId(5)));
        assert!(!humanoid.insert(head, JointId(6)));
        assert!(!humanoid.insert(hips, JointId(5)));
        assert!(humanoid.insert(hips, JointId(0)));
        assert_eq!(humanoid.iter().collect::<Vec<_>>(), [(hips, JointId(0)), (head, JointId(5))]);
        assert!(!humanoid.is_complete());
        let stored = serde_json::to_string(&humanoid).unwrap();
        assert_eq!(stored, r#"{"head":5,"hips":0}"#);
        assert_eq!(serde_json::from_str::<Humanoid>(&stored).unwrap(), humanoid);
        assert!(serde_json::from_str::<Humanoid>(r#"{"head":5,"hips":5}"#).is_err());
    }
}
