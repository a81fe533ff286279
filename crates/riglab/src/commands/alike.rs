//! Many messages in few lines: what is said of several things for one reason is said once.

use std::collections::HashMap;
use std::path::Path;

use super::{SHOWN, SOME, some_lines, some_of};

/// What is said of each of many, in lines that begin with `of`: one a reason, with some of those that it is said of. Reasons
/// are the same where they differ in numbers and in what names their subject alone. And whether some are not named.
pub fn by_reason(of: &str, said: &[(String, String)]) -> (Vec<String>, bool) {
    let mut groups: Vec<Vec<(&str, &str)>> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    for (name, reason) in said.iter().map(|(name, reason)| (name.as_str(), reason.as_str())) {
        let place = *places.entry(plain(name, reason)).or_insert(groups.len());
        if place == groups.len() {
            groups.push(Vec::new());
        }
        groups[place].push((name, reason));
    }
    let cut = groups.len() > SHOWN + 1 || groups.iter().any(|members| members.len() > SOME + 1);
    let lines = groups.iter().map(|members| {
        let names: Vec<String> = members.iter().map(|(name, _)| (*name).to_owned()).collect();
        let (name, reason) = members[0];
        let said = if members.len() > 1 { own(name, reason) } else { reason };
        let others = members.iter().any(|(name, reason)| own(name, reason) != said);
        let alike = if others && members.len() > 1 { " (of the first; the others alike)" } else { "" };
        format!("{of}{}: {said}{alike}", some_of(&names))
    });
    (some_lines(lines, &format!("more reasons, of others: {}", of.trim_end_matches([':', ' ']))), cut)
}

/// A reason without the file that it begins with, where that is the subject's own.
fn own<'a>(name: &str, reason: &'a str) -> &'a str {
    match reason.split_once(": ") {
        Some((file, rest)) if stem(file) == stem(name) => rest,
        _ => reason,
    }
}

/// A reason without what is its subject's alone.
fn plain(name: &str, reason: &str) -> String {
    let mut out = String::new();
    for word in own(name, reason).split(' ') {
        let bare = word.trim_matches(['`', '"', '\'', '(', ')', ',', ':', ';']);
        let word = if stem(bare) == stem(name) { "*" } else { word };
        for c in word.chars().map(|c| if c.is_ascii_digit() { '0' } else { c }) {
            if c != '0' || !out.ends_with('0') {
                out.push(c);
            }
        }
        out.push(' ');
    }
    out
}

fn stem(name: &str) -> String {
    Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_said_once_with_some_of_whom_it_is_said() {
        let mut said: Vec<(String, String)> =
            (0..300).map(|k| (format!("fox{k}.glb"), format!("out/fox{k}.glb: it holds no skeleton"))).collect();
        said.push(("hen.glb".into(), "out/hen.glb: cut off at byte 30".into()));
        said.push(("cow.glb".into(), "out/cow.glb: cut off at byte 417".into()));
        said.push(("one.glb".into(), "out/one.npz: of another mesh".into()));
        let (lines, cut) = by_reason("failed: ours: ", &said);
        assert!(cut && !by_reason("failed: ours: ", &said[296..]).1);
        assert_eq!(
            lines,
            [
                "failed: ours: fox0.glb, fox1.glb, fox2.glb and 297 more: it holds no skeleton",
                "failed: ours: hen.glb, cow.glb: cut off at byte 30 (of the first; the others alike)",
                "failed: ours: one.glb: out/one.npz: of another mesh",
            ]
        );
        // Of many reasons some.
        let said: Vec<(String, String)> = ('a'..='z').map(|c| (format!("{c}.glb"), format!("why {c}{c}?"))).collect();
        let (lines, cut) = by_reason("note: ours: ", &said);
        assert!(cut && lines.len() == 6 && lines[5] == "21 more reasons, of others: note: ours", "{lines:?}");
    }
}
