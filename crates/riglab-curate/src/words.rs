//! Names of joints as words.

/// The words of a joint's name, in lower case: parted at anything that is no letter, between letters and
/// digits, and where a capital follows a small letter (`LeftUpLeg` is left, up, leg). Digits are left out, as
/// are codes for signs that FBX writes (`FBXASC046` is a full stop). Words of other scripts come letter run
/// by letter run.
pub fn words(name: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word = String::new();
    let mut before = ' ';
    let clean = without_codes(name);
    let mut letters = clean.chars().peekable();
    while let Some(c) = letters.next() {
        // Also before the last capital of a run: `LHand` is l, hand; `IKFoot` is ik, foot.
        let starts = c.is_uppercase()
            && (before.is_lowercase() || (before.is_uppercase() && letters.peek().is_some_and(|n| n.is_lowercase())));
        if (starts || !c.is_alphabetic()) && !word.is_empty() {
            words.push(std::mem::take(&mut word));
        }
        if c.is_alphabetic() {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    if !word.is_empty() {
        words.push(word);
    }
    words
}

/// Without `FBXASC` and its three digits.
fn without_codes(name: &str) -> String {
    let mut out = String::with_capacity(name.len());
    let mut rest = name;
    while let Some(at) = rest.find("FBXASC") {
        out.push_str(&rest[..at]);
        out.push(' ');
        rest = rest[at + 6..].trim_start_matches(|c: char| c.is_ascii_digit());
    }
    out.push_str(rest);
    out
}

#[cfg(test)]
mod tests {
    use super::words;

    #[test]
    fn names_of_several_conventions_come_apart() {
        for (name, expected) in [
            ("mixamorig:LeftUpLeg", "mixamorig left up leg"),
            ("upper_arm.L.001", "upper arm l"),
            ("Bip01 R Thigh", "bip r thigh"),
            ("f_indexFBXASC04601FBXASC046L", "f index l"),
            ("IKFoot.L", "ik foot l"),
            ("LHand", "l hand"),
            ("J_Bip_C_UpperChest", "j bip c upper chest"),
            ("左ひざ", "左ひざ"),
            ("FFB", "ffb"),
            ("003", ""),
        ] {
            assert_eq!(words(name).join(" "), expected, "{name}");
        }
    }
}
