//! Many messages in few lines: what is said of several things for one reason is said once.

use std::collections::HashMap;
use std::mem::{Discriminant, discriminant};
use std::path::Path;

use riglab_asset::WriteNote;
use riglab_asset::export::ExportNote;

use super::{SHOWN, SOME, in_line, some_lines, some_of};

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

/// What a person may want to know of each of many, a line a kind: told when all are done.
#[derive(Debug, Default)]
pub struct Notes(Vec<Kind>);

/// Notes of a kind.
#[derive(Debug)]
struct Kind {
    key: Key,
    /// Whom it is said of: the worst first, where a figure tells it.
    names: Vec<String>,
    /// What is said of the first of them: several things where it is the only one.
    said: Vec<String>,
    figure: Option<f64>,
    /// Whether it is not the same of all.
    differs: bool,
}

/// What makes notes one kind.
#[derive(Debug, PartialEq)]
enum Key {
    Exported(Discriminant<ExportNote>),
    Written(Discriminant<WriteNote>),
    Said(String),
}

impl Notes {
    /// Something about an exported file.
    pub fn exported(&mut self, name: &str, note: &ExportNote) {
        let said = note.to_string();
        match note.figure() {
            Some(_) => self.put(Key::Exported(discriminant(note)), name, said, note.figure()),
            None => self.said(name, said),
        }
    }

    /// What a format does not hold of an asset.
    pub fn written(&mut self, name: &str, note: &WriteNote) {
        self.put(Key::Written(discriminant(note)), name, note.to_string(), note.figure());
    }

    /// A sentence.
    pub fn said(&mut self, name: &str, said: String) {
        // What stands between such signs are names.
        let key = plain(name, &said).split('`').step_by(2).collect::<Vec<_>>().join("`");
        self.put(Key::Said(key), name, said, None);
    }

    fn put(&mut self, key: Key, name: &str, said: String, figure: Option<f64>) {
        let Some(kind) = self.0.iter_mut().find(|kind| kind.key == key) else {
            let (names, said) = (vec![name.to_owned()], vec![said]);
            return self.0.push(Kind { key, names, said, figure, differs: false });
        };
        if kind.names == [name] {
            // Of several the worst stands first, which stays when others come.
            if figure > kind.figure {
                kind.figure = figure;
                return kind.said.insert(0, said);
            }
            return kind.said.push(said);
        }
        kind.said.truncate(1);
        kind.differs |= kind.said[0] != said;
        let known = kind.names.iter().position(|known| known == name);
        if figure > kind.figure {
            known.map(|at| kind.names.remove(at));
            kind.names.insert(0, name.to_owned());
            (kind.said, kind.figure) = (vec![said], figure);
        } else if known.is_none() {
            kind.names.push(name.to_owned());
        }
    }

    /// Tells them.
    pub fn tell(&self) {
        self.lines().iter().for_each(|line| tell!("note: {line}"));
    }

    fn lines(&self) -> Vec<String> {
        let lines = |kind: &Kind| {
            let of = match (kind.differs, kind.figure) {
                (false, _) => "",
                (true, Some(_)) => " (of the first, which is the worst; the others alike)",
                (true, None) => " (of the first; the others alike)",
            };
            let names = in_line(some_of(&kind.names));
            kind.said.iter().map(|said| format!("{names}: {said}{of}")).collect::<Vec<_>>()
        };
        self.0.iter().flat_map(lines).collect()
    }
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
    fn notes_are_a_line_a_kind_with_the_worst_figure() {
        let mut notes = Notes::default();
        for (k, name) in ["a.glb", "b.glb", "c.glb", "d.glb", "e.glb"].into_iter().enumerate() {
            let most = [2.0, 1.5, 9.25, 3.0, 1.0][k];
            notes.written(name, &WriteNote::Beyond { half: 0.5, assets: 1, beyond: 1, most });
            notes.written(name, &WriteNote::Lacks("joint names are not in it"));
            let (motion, share) = (format!("walk {k}"), [0.1, 0.4, 0.2][k.min(2)]);
            notes.exported(name, &ExportNote::MotionSheared { motion, share, others: 3 });
            let picture = |image| ExportNote::PictureLeft { image, uri: format!("{k}.png"), outside: false };
            (0..2 - k.min(1)).for_each(|image| notes.exported(name, &picture(image)));
        }
        let lines = notes.lines();
        assert_eq!(lines.len(), 4, "{lines:?}");
        let all = "a.glb, b.glb, c.glb and 2 more: ";
        assert!(lines[0].starts_with("c.glb, a.glb, b.glb and 2 more: it reaches beyond"), "{}", lines[0]);
        let worst = "(of the first, which is the worst; the others alike)";
        assert!(lines[0].contains("to 9.25;") && lines[0].ends_with(worst), "{}", lines[0]);
        assert_eq!(lines[1], format!("{all}joint names are not in it"));
        assert!(lines[2].starts_with("b.glb, a.glb, c.glb and") && lines[2].contains("40.0 %"), "{}", lines[2]);
        assert!(lines[3].starts_with(all) && lines[3].contains("image 0"), "{}", lines[3]);
        assert!(lines[3].ends_with("(of the first; the others alike)"), "{}", lines[3]);
        // A file that is the worst twice, and one before a milder one.
        let mut notes = Notes::default();
        let beyond = |most| WriteNote::Beyond { half: 0.5, assets: 1, beyond: 1, most };
        let mut put = |all: &[(&str, f32)]| {
            all.iter().for_each(|(name, most)| notes.written(name, &beyond(*most)));
            notes.lines()
        };
        let lines = put(&[("a", 1.5), ("a", 4.0), ("b", 3.0)]);
        assert!(lines.len() == 1 && lines[0].starts_with("a, b: ") && lines[0].contains("to 4"), "{lines:?}");
        let lines = put(&[("c", 5.0), ("b", 2.0), ("a", 6.0)]);
        assert!(lines.len() == 1 && lines[0].starts_with("a, c, b: ") && lines[0].contains("to 6"), "{lines:?}");
        // Of one file each is told.
        let mut notes = Notes::default();
        let picture = |image| ExportNote::PictureLeft { image, uri: format!("{image}.png"), outside: false };
        (0..3).for_each(|image| notes.exported("a.glb", &picture(image)));
        let lines = notes.lines();
        assert!(lines.len() == 3 && lines[2].starts_with("a.glb: image 2 is not"), "{lines:?}");
    }

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
