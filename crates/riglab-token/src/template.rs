//! Skeletons of known make: which joints they have, by name and in which order.

/// A part of a template: joints that stand together at a fixed place of the sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// `body` or `hand`.
    pub name: &'static str,
    /// Its joints, in order.
    pub joints: &'static [&'static str],
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

    /// The template whose first part a skeleton has whole, by the names of its joints.
    pub fn detect<S: AsRef<str>>(names: &[S]) -> Option<&'static Self> {
        let has = |wanted: &&str| names.iter().any(|n| n.as_ref() == *wanted);
        Self::ALL.iter().find(|t| t.parts[0].joints.iter().all(has)).and_then(|t| Self::of(t.class))
    }
}

const VROID: Template = Template {
    class: "vroid",
    parts: &[Part { name: "body", joints: &VROID_BODY }, Part { name: "hand", joints: &VROID_HAND }],
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
    parts: &[Part { name: "body", joints: &MIXAMO_BODY }, Part { name: "hand", joints: &MIXAMO_HAND }],
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
