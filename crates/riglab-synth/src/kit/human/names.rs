//! What human bones are called in rigs of one kind and another.

/// A way to name joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Names {
    /// `mixamorig:LeftForeArm`
    Mixamo,
    /// `J_Bip_L_LowerArm`
    VRoid,
    /// `lower_arm.L`, as Blender mirrors names.
    Blender,
}

impl Names {
    /// The name of a bone of VRM 1.0.
    pub fn of(self, bone: &str) -> String {
        let (side, part) = split(bone);
        match self {
            Self::Mixamo => format!("mixamorig:{}{}", ["", "Left", "Right"][side], mixamo(part)),
            Self::VRoid => format!("J_Bip_{}_{}", ["C", "L", "R"][side], vroid(part)),
            Self::Blender => format!("{}{}", blender(part), ["", ".L", ".R"][side]),
        }
    }

    /// The name of joint `k` (from 1) of a skirt's chain.
    pub fn skirt(self, chain: usize, k: usize) -> String {
        match self {
            Self::VRoid => format!("J_Sec_Skirt{}_{k:02}", chain + 1),
            _ => format!("skirt_{}_{k}", chain + 1),
        }
    }

    /// The name of the joint that takes half of a bone's twist.
    pub fn twist(self, bone: &str) -> String {
        match self {
            Self::Blender => {
                let (side, part) = split(bone);
                format!("{}_twist{}", blender(part), ["", ".L", ".R"][side])
            }
            _ => format!("{}Twist", self.of(bone)),
        }
    }
}

/// 0, 1, 2 for middle, left and right, and the bone without its side.
fn split(bone: &str) -> (usize, &str) {
    match (bone.strip_prefix("left"), bone.strip_prefix("right")) {
        (Some(part), _) => (1, part),
        (_, Some(part)) => (2, part),
        _ => (0, bone),
    }
}

fn mixamo(part: &str) -> String {
    let known = match part {
        "hips" => "Hips",
        "spine" => "Spine",
        "chest" => "Spine1",
        "upperChest" => "Spine2",
        "neck" => "Neck",
        "head" => "Head",
        "UpperArm" => "Arm",
        "LowerArm" => "ForeArm",
        "UpperLeg" => "UpLeg",
        "LowerLeg" => "Leg",
        "Toes" => "ToeBase",
        _ => {
            return finger(part).map_or(part.into(), |(name, k)| format!("Hand{}{k}", name.replace("Little", "Pinky")));
        }
    };
    known.into()
}

fn vroid(part: &str) -> String {
    let known = match part {
        "Toes" => "ToeBase",
        _ => return finger(part).map_or(capital(part), |(name, k)| format!("{name}{k}")),
    };
    known.into()
}

fn blender(part: &str) -> String {
    if let Some((name, k)) = finger(part) {
        return format!("f_{}.0{k}", name.to_lowercase());
    }
    let mut out = String::new();
    for (k, c) in part.chars().enumerate() {
        if c.is_uppercase() && k > 0 {
            out.push('_');
        }
        out.extend(c.to_lowercase());
    }
    out
}

fn capital(part: &str) -> String {
    let mut chars = part.chars();
    chars.next().map_or(String::new(), |c| c.to_uppercase().chain(chars).collect())
}

/// A finger and which of its bones, from 1.
fn finger(part: &str) -> Option<(&str, usize)> {
    let thumb = part.starts_with("Thumb");
    let parts = if thumb { ["Metacarpal", "Proximal", "Distal"] } else { ["Proximal", "Intermediate", "Distal"] };
    parts.iter().enumerate().find_map(|(k, bone)| part.strip_suffix(bone).map(|name| (name, k + 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_their_tools() {
        let all =
            |names: Names| ["hips", "leftLowerArm", "rightLittleProximal", "leftThumbDistal"].map(|b| names.of(b));
        let mixamo =
            ["mixamorig:Hips", "mixamorig:LeftForeArm", "mixamorig:RightHandPinky1", "mixamorig:LeftHandThumb3"];
        assert_eq!(all(Names::Mixamo), mixamo);
        assert_eq!(all(Names::VRoid), ["J_Bip_C_Hips", "J_Bip_L_LowerArm", "J_Bip_R_Little1", "J_Bip_L_Thumb3"]);
        assert_eq!(all(Names::Blender), ["hips", "lower_arm.L", "f_little.01.R", "f_thumb.03.L"]);
        assert_eq!(Names::VRoid.of("upperChest"), "J_Bip_C_UpperChest");
    }
}
