//! Names of human bones in Mixamo's rigs.

use riglab_core::HumanBone;

/// Bones of the body, by their names in VRM 1.0 without a side.
const BODY: [(&str, &str); 16] = [
    ("hips", "Hips"),
    ("spine", "Spine"),
    ("chest", "Spine1"),
    ("upperChest", "Spine2"),
    ("neck", "Neck"),
    ("head", "Head"),
    ("jaw", "Jaw"),
    ("Eye", "Eye"),
    ("UpperLeg", "UpLeg"),
    ("LowerLeg", "Leg"),
    ("Foot", "Foot"),
    ("Toes", "ToeBase"),
    ("Shoulder", "Shoulder"),
    ("UpperArm", "Arm"),
    ("LowerArm", "ForeArm"),
    ("Hand", "Hand"),
];
/// Parts of a finger, from the palm.
const PARTS: [(&str, &str); 4] = [("Metacarpal", "1"), ("Proximal", "1"), ("Intermediate", "2"), ("Distal", "3")];
/// Fingers that are called otherwise.
const LITTLE: (&str, &str) = ("Little", "Pinky");

/// The name of a bone in Mixamo's rigs, such as `mixamorig:LeftForeArm`.
pub(super) fn mixamo(bone: HumanBone) -> String {
    let name = bone.name();
    let (side, rest) = match (name.strip_prefix("left"), name.strip_prefix("right")) {
        (Some(rest), _) => ("Left", rest),
        (_, Some(rest)) => ("Right", rest),
        _ => ("", name),
    };
    if let Some((_, theirs)) = BODY.iter().find(|(ours, _)| *ours == rest) {
        return format!("mixamorig:{side}{theirs}");
    }
    let (part, number) = PARTS.iter().find(|(part, _)| rest.ends_with(part)).copied().unwrap_or_default();
    let finger = rest.strip_suffix(part).unwrap_or(rest);
    let finger = if finger == LITTLE.0 { LITTLE.1 } else { finger };
    // The thumb begins in the palm, and has no part between.
    let number = match (finger, part) {
        ("Thumb", "Proximal") => "2",
        _ => number,
    };
    format!("mixamorig:{side}Hand{finger}{number}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bones_have_the_names_of_mixamo_and_no_two_the_same() {
        let of = |name: &str| mixamo(name.parse().unwrap());
        for (ours, theirs) in [
            ("hips", "mixamorig:Hips"),
            ("upperChest", "mixamorig:Spine2"),
            ("leftLowerArm", "mixamorig:LeftForeArm"),
            ("rightUpperLeg", "mixamorig:RightUpLeg"),
            ("leftToes", "mixamorig:LeftToeBase"),
            ("rightLittleIntermediate", "mixamorig:RightHandPinky2"),
            ("leftThumbMetacarpal", "mixamorig:LeftHandThumb1"),
            ("leftThumbProximal", "mixamorig:LeftHandThumb2"),
            ("leftThumbDistal", "mixamorig:LeftHandThumb3"),
        ] {
            assert_eq!(of(ours), theirs);
        }
        let all: std::collections::BTreeSet<String> = HumanBone::all().map(mixamo).collect();
        assert_eq!(all.len(), HumanBone::all().len());
    }
}
