//! Skeletons of known make: which joints they have, by name and in which order.

use riglab_core::HumanBone;

/// A part of a template: joints that stand together at a fixed place of the sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// `body` or `hand`.
    pub name: &'static str,
    /// The place of its first joint in the template.
    pub first: usize,
    /// Its joints, in order.
    pub joints: &'static [&'static str],
    /// On which joint of the template each hangs, by its place; none of the root.
    pub parents: &'static [Option<u8>],
    /// Which human bone each is, by its name in VRM 1.0.
    pub bones: &'static [&'static str],
}

/// A skeleton of known make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Template {
    /// The class of its skeletons.
    pub class: &'static str,
    /// Its parts, in order.
    pub parts: &'static [Part],
}

impl Template {
    /// Every template.
    pub const ALL: [Self; 2] = [VROID, MIXAMO];

    /// The template of a class.
    pub fn of(class: &str) -> Option<&'static Self> {
        static ALL: [Template; 2] = Template::ALL;
        ALL.iter().find(|t| t.class == class)
    }

    /// Whether a joint of one of its parts is called so.
    pub fn has(&self, name: &str) -> bool {
        self.parts.iter().any(|part| part.joints.contains(&name))
    }

    /// Its joints in their order: each name, what it hangs on by its place, and the human bone that it is.
    pub fn joints(&self) -> impl Iterator<Item = (&'static str, Option<usize>, &'static str)> + use<'_> {
        let of = |part: &'_ Part| part.joints.iter().zip(part.parents).zip(part.bones);
        self.parts.iter().flat_map(of).map(|((name, parent), bone)| (*name, parent.map(usize::from), *bone))
    }

    /// The human bone that a joint of this name is.
    pub fn bone(&self, name: &str) -> Option<&'static str> {
        self.joints().find(|(own, ..)| *own == name).map(|(.., bone)| bone)
    }

    /// The joint of the other side, by the human bones that both are; itself in the middle.
    pub fn mirrored(&self, name: &str) -> Option<&'static str> {
        let bone: HumanBone = self.bone(name)?.parse().ok()?;
        let other = bone.mirrored().name();
        self.joints().find(|(.., bone)| *bone == other).map(|(name, ..)| name)
    }

    /// The template whose first part a skeleton has whole, by the names of its joints.
    pub fn detect<S: AsRef<str>>(names: &[S]) -> Option<&'static Self> {
        let has = |wanted: &&str| names.iter().any(|n| n.as_ref() == *wanted);
        Self::ALL.iter().find(|t| t.parts[0].joints.iter().all(has)).and_then(|t| Self::of(t.class))
    }
}

/// The trees of both templates: hips, spine to head, arms from the upper chest, legs from the hips.
const BODY: [Option<u8>; 22] = parents([-1, 0, 1, 2, 3, 4, 3, 6, 7, 8, 3, 10, 11, 12, 0, 14, 15, 16, 0, 18, 19, 20]);
/// Five fingers of three joints from each hand.
const HAND: [Option<u8>; 30] = parents([
    9, 22, 23, 9, 25, 26, 9, 28, 29, 9, 31, 32, 9, 34, 35, 13, 37, 38, 13, 40, 41, 13, 43, 44, 13, 46, 47, 13, 49, 50,
]);

/// The human bones of both templates, as VRM 1.0 calls them.
const BODY_BONES: [&str; 22] = [
    "hips",
    "spine",
    "chest",
    "upperChest",
    "neck",
    "head",
    "leftShoulder",
    "leftUpperArm",
    "leftLowerArm",
    "leftHand",
    "rightShoulder",
    "rightUpperArm",
    "rightLowerArm",
    "rightHand",
    "leftUpperLeg",
    "leftLowerLeg",
    "leftFoot",
    "leftToes",
    "rightUpperLeg",
    "rightLowerLeg",
    "rightFoot",
    "rightToes",
];
/// Those of the fingers.
const HAND_BONES: [&str; 30] = [
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
    "rightIndexProximal",
    "rightIndexIntermediate",
    "rightIndexDistal",
    "rightThumbMetacarpal",
    "rightThumbProximal",
    "rightThumbDistal",
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

const fn parents<const N: usize>(places: [i8; N]) -> [Option<u8>; N] {
    let (mut out, mut k) = ([None; N], 0);
    while k < N {
        if places[k] >= 0 {
            out[k] = Some(places[k] as u8);
        }
        k += 1;
    }
    out
}

/// For each place of a sequence, the joint that one written without a parent hangs on: where parts stand, by
/// the place of their first joint, that of the template; else the one before it.
pub(crate) fn usual_parents(parts: &[(usize, &Part)], count: usize) -> Vec<Option<usize>> {
    let mut usual: Vec<Option<usize>> = (0..count).map(|at| at.checked_sub(1)).collect();
    // Where each joint of the template stands.
    let mut places = Vec::new();
    for (start, part) in parts {
        places.resize(places.len().max(part.first + part.joints.len()), None);
        (0..part.joints.len()).for_each(|k| places[part.first + k] = Some(start + k));
        for (k, parent) in part.parents.iter().enumerate() {
            let parent = parent.and_then(|p| places.get(usize::from(p)).copied().flatten());
            if let (Some(parent), Some(own)) = (parent.filter(|p| *p < start + k), usual.get_mut(start + k)) {
                *own = Some(parent);
            }
        }
    }
    usual
}

const VROID: Template = Template {
    class: "vroid",
    parts: &[
        Part { name: "body", first: 0, joints: &VROID_BODY, parents: &BODY, bones: &BODY_BONES },
        Part { name: "hand", first: 22, joints: &VROID_HAND, parents: &HAND, bones: &HAND_BONES },
    ],
};

const VROID_BODY: [&str; 22] = [
    "J_Bip_C_Hips",
    "J_Bip_C_Spine",
    "J_Bip_C_Chest",
    "J_Bip_C_UpperChest",
    "J_Bip_C_Neck",
    "J_Bip_C_Head",
    "J_Bip_L_Shoulder",
    "J_Bip_L_UpperArm",
    "J_Bip_L_LowerArm",
    "J_Bip_L_Hand",
    "J_Bip_R_Shoulder",
    "J_Bip_R_UpperArm",
    "J_Bip_R_LowerArm",
    "J_Bip_R_Hand",
    "J_Bip_L_UpperLeg",
    "J_Bip_L_LowerLeg",
    "J_Bip_L_Foot",
    "J_Bip_L_ToeBase",
    "J_Bip_R_UpperLeg",
    "J_Bip_R_LowerLeg",
    "J_Bip_R_Foot",
    "J_Bip_R_ToeBase",
];

const VROID_HAND: [&str; 30] = [
    "J_Bip_L_Thumb1",
    "J_Bip_L_Thumb2",
    "J_Bip_L_Thumb3",
    "J_Bip_L_Index1",
    "J_Bip_L_Index2",
    "J_Bip_L_Index3",
    "J_Bip_L_Middle1",
    "J_Bip_L_Middle2",
    "J_Bip_L_Middle3",
    "J_Bip_L_Ring1",
    "J_Bip_L_Ring2",
    "J_Bip_L_Ring3",
    "J_Bip_L_Little1",
    "J_Bip_L_Little2",
    "J_Bip_L_Little3",
    "J_Bip_R_Index1",
    "J_Bip_R_Index2",
    "J_Bip_R_Index3",
    "J_Bip_R_Thumb1",
    "J_Bip_R_Thumb2",
    "J_Bip_R_Thumb3",
    "J_Bip_R_Middle1",
    "J_Bip_R_Middle2",
    "J_Bip_R_Middle3",
    "J_Bip_R_Ring1",
    "J_Bip_R_Ring2",
    "J_Bip_R_Ring3",
    "J_Bip_R_Little1",
    "J_Bip_R_Little2",
    "J_Bip_R_Little3",
];

const MIXAMO: Template = Template {
    class: "mixamo",
    parts: &[
        Part { name: "body", first: 0, joints: &MIXAMO_BODY, parents: &BODY, bones: &BODY_BONES },
        Part { name: "hand", first: 22, joints: &MIXAMO_HAND, parents: &HAND, bones: &HAND_BONES },
    ],
};

const MIXAMO_BODY: [&str; 22] = [
    "mixamorig:Hips",
    "mixamorig:Spine",
    "mixamorig:Spine1",
    "mixamorig:Spine2",
    "mixamorig:Neck",
    "mixamorig:Head",
    "mixamorig:LeftShoulder",
    "mixamorig:LeftArm",
    "mixamorig:LeftForeArm",
    "mixamorig:LeftHand",
    "mixamorig:RightShoulder",
    "mixamorig:RightArm",
    "mixamorig:RightForeArm",
    "mixamorig:RightHand",
    "mixamorig:LeftUpLeg",
    "mixamorig:LeftLeg",
    "mixamorig:LeftFoot",
    "mixamorig:LeftToeBase",
    "mixamorig:RightUpLeg",
    "mixamorig:RightLeg",
    "mixamorig:RightFoot",
    "mixamorig:RightToeBase",
];

const MIXAMO_HAND: [&str; 30] = [
    "mixamorig:LeftHandThumb1",
    "mixamorig:LeftHandThumb2",
    "mixamorig:LeftHandThumb3",
    "mixamorig:LeftHandIndex1",
    "mixamorig:LeftHandIndex2",
    "mixamorig:LeftHandIndex3",
    "mixamorig:LeftHandMiddle1",
    "mixamorig:LeftHandMiddle2",
    "mixamorig:LeftHandMiddle3",
    "mixamorig:LeftHandRing1",
    "mixamorig:LeftHandRing2",
    "mixamorig:LeftHandRing3",
    "mixamorig:LeftHandPinky1",
    "mixamorig:LeftHandPinky2",
    "mixamorig:LeftHandPinky3",
    "mixamorig:RightHandIndex1",
    "mixamorig:RightHandIndex2",
    "mixamorig:RightHandIndex3",
    "mixamorig:RightHandThumb1",
    "mixamorig:RightHandThumb2",
    "mixamorig:RightHandThumb3",
    "mixamorig:RightHandMiddle1",
    "mixamorig:RightHandMiddle2",
    "mixamorig:RightHandMiddle3",
    "mixamorig:RightHandRing1",
    "mixamorig:RightHandRing2",
    "mixamorig:RightHandRing3",
    "mixamorig:RightHandPinky1",
    "mixamorig:RightHandPinky2",
    "mixamorig:RightHandPinky3",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_of_templates_hang_on_the_joints_of_their_limb() {
        for template in &Template::ALL {
            let names: Vec<&str> = template.parts.iter().flat_map(|p| p.joints).copied().collect();
            let parents: Vec<Option<u8>> = template.parts.iter().flat_map(|p| p.parents).copied().collect();
            assert_eq!((names.len(), parents.len()), (52, 52));
            let of = |name: &str| {
                let at = names.iter().position(|n| n.ends_with(name)).unwrap_or_else(|| panic!("{name}"));
                parents[at].map_or("", |p| names[usize::from(p)])
            };
            let pairs: &[(&str, &str)] = match template.class {
                "vroid" => &[
                    ("L_Shoulder", "C_UpperChest"),
                    ("R_UpperLeg", "C_Hips"),
                    ("R_ToeBase", "R_Foot"),
                    ("L_Little1", "L_Hand"),
                    ("R_Thumb1", "R_Hand"),
                    ("R_Thumb3", "R_Thumb2"),
                ],
                _ => &[
                    ("LeftShoulder", "Spine2"),
                    ("RightUpLeg", "Hips"),
                    ("RightToeBase", "RightFoot"),
                    ("LeftHandPinky1", "LeftHand"),
                    ("RightHandThumb1", "RightHand"),
                    ("RightHandThumb3", "RightHandThumb2"),
                ],
            };
            assert_eq!(parents[0], None);
            assert_eq!(template.mirrored("other"), None);
            // Bones are of the joint's side and kind.
            for (name, _, bone) in template.joints() {
                let told = name.rsplit(['_', ':']).next().unwrap_or(name).to_lowercase();
                let kind = bone.trim_start_matches("left").trim_start_matches("right").to_lowercase();
                let same = [
                    ("toes", "toebase"),
                    ("upperarm", "arm"),
                    ("lowerarm", "forearm"),
                    ("upperleg", "upleg"),
                    ("lowerleg", "leg"),
                ];
                let same = same.iter().find(|(ours, _)| *ours == kind).map_or("", |(_, theirs)| theirs);
                let finger = |f: &str| told.contains(f) && kind.contains(&f.replace("pinky", "little"));
                let spine = ["spine1", "spine2"].contains(&told.as_str()) && kind.ends_with("chest");
                let fingers = ["thumb", "index", "middle", "ring", "little", "pinky"].into_iter().any(finger);
                assert!(
                    told.ends_with(&kind) || (!same.is_empty() && told.ends_with(same)) || fingers || spine,
                    "{name}: {bone}"
                );
                let left = name.contains("Left") || name.contains("_L_");
                let right = name.contains("Right") || name.contains("_R_");
                assert_eq!((bone.starts_with("left"), bone.starts_with("right")), (left, right), "{name}: {bone}");
                assert_eq!(template.bone(name), Some(bone));
                let other = template.mirrored(name).unwrap();
                assert_eq!((template.mirrored(other), other == name), (Some(name), !left && !right), "{name}: {other}");
                assert!(bone.parse::<riglab_core::HumanBone>().is_ok(), "{bone}");
            }
            for (joint, parent) in pairs {
                assert!(of(joint).ends_with(parent), "{joint} hangs on {}", of(joint));
            }
            // Parents come first, and limbs do not cross.
            let side = |name: &str| {
                (name.contains("Left") || name.contains("_L_"), name.contains("Right") || name.contains("_R_"))
            };
            for (at, parent) in parents.iter().enumerate() {
                let Some(parent) = parent.map(usize::from) else { continue };
                assert!(parent < at);
                let (a, b) = (side(names[at]), side(names[parent]));
                assert!(b == (false, false) || a == b, "{} hangs on {}", names[at], names[parent]);
            }
        }
    }
}
