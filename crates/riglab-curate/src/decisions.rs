//! Decisions that a person made about assets, in a file made for version control.
//!
//! A text of one line an asset, sorted by name, so that two people's changes merge line by line. Fields are
//! parted by tabs; a tab, line break or backslash within one is written `\t`, `\n`, `\\`:
//!
//! ```text
//! # riglab decisions 1
//! # name → digest → verdict → category → faults → comment
//! fox.glb → 0f3c… → accept → quadruped →  → tail is fine
//! set.npz#12 → 77ab… → reject →  → legs,tail → two joints in each knee
//! ```
//!
//! (with tabs for the arrows)
//!
//! - `name`, `digest`: which asset: its name in the folder, and the first 16 digits of its file's BLAKE3
//!   sum. A file that has changed since is no longer what was decided about; one that was renamed still is, unless another
//!   file has its name now. Of two such files with the same bytes that were decided about otherwise, neither counts.
//! - `verdict`: `accept` keeps it whatever stages and duplicates say, `reject` drops it, `-` leaves that to
//!   the stages.
//! - `category`: one of the eight, or nothing.
//! - `faults`: marks of what is wrong with the skeleton, parted by commas; any words.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::path::Path;

use riglab_asset::file_and_item;

use crate::{Category, CurateError};

const HEAD: &str = "# riglab decisions 1\n# name\tdigest\tverdict\tcategory\tfaults\tcomment\n";

/// Whether an asset stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Verdict {
    /// The stages say.
    #[default]
    Open,
    /// It stays, whatever they say.
    Accept,
    /// It goes.
    Reject,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Open => "-",
            Self::Accept => "accept",
            Self::Reject => "reject",
        })
    }
}

/// What was decided about an asset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decision {
    /// Whether it stays.
    pub verdict: Verdict,
    /// Its category, if the person gave one.
    pub category: Option<Category>,
    /// What is wrong with its skeleton.
    pub faults: Vec<String>,
    /// Anything else.
    pub comment: String,
}

impl Decision {
    /// Whether nothing was decided.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether another comes to the same for a corpus.
    fn agrees(&self, other: &Self) -> bool {
        (self.verdict, self.category) == (other.verdict, other.category)
    }
}

/// Decisions by name and digest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decisions(BTreeMap<(String, String), Decision>);

/// How a decision was found for an asset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Match {
    /// By name and digest.
    Same,
    /// By digest alone: the file has another name now.
    Renamed,
}

impl Decisions {
    /// Reads a file; one that is not there yet holds no decisions.
    ///
    /// # Errors
    /// When it cannot be read, or with the first line that is none.
    pub fn read(path: &Path) -> Result<Self, CurateError> {
        match std::fs::read_to_string(path) {
            Ok(text) => {
                Self::parse(&text).map_err(|(line, message)| CurateError::Decision { path: path.into(), line, message })
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Self::default()),
            Err(e) => Err(CurateError::io(path, e)),
        }
    }

    /// Reads a text.
    ///
    /// # Errors
    /// The first line that is none, from 1, and what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, (usize, String)> {
        let mut all = BTreeMap::new();
        // What some editors put before a text.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        for (number, line) in text.lines().enumerate() {
            if line.trim().is_empty() || line.starts_with('#') {
                continue;
            }
            let fail = |message: String| (number + 1, message);
            let fields: Vec<String> = line.split('\t').map(unescaped).collect();
            let [name, digest, verdict, category, faults, comment] = fields.as_slice() else {
                let message = format!(
                    "{} fields, not the 6 of a decision, parted by tabs: name, digest, verdict (accept, reject, -), category, \
                     faults, comment",
                    fields.len()
                );
                return Err(fail(if line.starts_with("<<<<<<<") || line.starts_with(">>>>>>>") {
                    "a conflict of two versions; keep one of the lines".into()
                } else {
                    message
                }));
            };
            let decision = Decision {
                verdict: match verdict.as_str() {
                    "accept" => Verdict::Accept,
                    "reject" => Verdict::Reject,
                    "-" | "" => Verdict::Open,
                    other => return Err(fail(format!("`{other}` is no verdict; give accept, reject or -"))),
                },
                category: if category.is_empty() { None } else { Some(category.parse().map_err(fail)?) },
                faults: faults.split(',').map(str::trim).filter(|f| !f.is_empty()).map(String::from).collect(),
                comment: comment.clone(),
            };
            if all.insert((name.clone(), digest.clone()), decision).is_some() {
                return Err(fail(format!("`{name}` is decided twice; keep one of the lines")));
            }
        }
        Ok(Self(all))
    }

    /// As a text; the same decisions give the same bytes.
    pub fn to_text(&self) -> String {
        let mut text = HEAD.to_owned();
        for ((name, digest), d) in &self.0 {
            let category = d.category.map_or("", Category::name);
            let verdict = d.verdict.to_string();
            let fields = [name, digest, &verdict, category, &d.faults.join(","), &d.comment];
            text += &fields.map(escaped).join("\t");
            text.push('\n');
        }
        text
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// When the disk refuses; what was there stays.
    pub fn write(&self, path: &Path) -> Result<(), CurateError> {
        crate::store::store(path, self.to_text().as_bytes())
    }

    /// Sets the decision about an asset; an empty one takes its line away.
    pub fn set(&mut self, name: &str, digest: &str, decision: Decision) {
        let key = (name.to_owned(), digest.to_owned());
        // A comma parts marks.
        let mut faults: Vec<String> = Vec::new();
        for fault in decision.faults.iter().map(|f| f.replace(',', " ").trim().to_owned()) {
            if !fault.is_empty() && !faults.contains(&fault) {
                faults.push(fault);
            }
        }
        let decision = Decision { faults, ..decision };
        if decision.is_empty() {
            self.0.remove(&key);
        } else {
            self.0.insert(key, decision);
        }
    }

    /// The decision about exactly this asset.
    pub fn get(&self, name: &str, digest: &str) -> Option<&Decision> {
        self.0.get(&(name.to_owned(), digest.to_owned()))
    }

    /// Takes over another's decisions; where both decide about an asset, the other's count.
    pub fn merge(&mut self, other: Self) {
        self.0.extend(other.0);
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// All of them: name, digest, decision.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str, &Decision)> {
        self.0.iter().map(|((name, digest), d)| (name.as_str(), digest.as_str(), d))
    }

    /// Finds for each asset (name, digest) its decision, and tells which decisions are about none of them, a
    /// sentence each. The assets may be a part of all: of the others' names, those that `is_of_it` does not take, nothing is
    /// told. What was decided about a name that `is_there`, in whatever part, is about no other asset of the same bytes.
    pub fn applied<'a>(
        &'a self,
        assets: &[(&str, &str)],
        is_of_it: impl Fn(&str) -> bool,
        is_there: impl Fn(&str) -> bool,
    ) -> (HashMap<usize, (&'a Decision, Match)>, Vec<String>) {
        let by_both: HashMap<(&str, &str), usize> = assets.iter().enumerate().map(|(i, a)| (*a, i)).collect();
        let by_name: HashMap<&str, &str> = assets.iter().copied().collect();
        let mut by_digest: HashMap<(&str, &str), Vec<usize>> = HashMap::new();
        for (i, (name, digest)) in assets.iter().enumerate() {
            by_digest.entry((item(name), digest)).or_default().push(i);
        }
        let (mut found, mut told) = (HashMap::new(), Vec::new());
        let mut moved = Vec::new();
        // By asset, those about files that are gone.
        let mut renamed: BTreeMap<usize, Vec<(&str, &Decision)>> = BTreeMap::new();
        for (name, digest, decision) in self.iter() {
            match by_both.get(&(name, digest)) {
                Some(&i) => drop(found.insert(i, (decision, Match::Same))),
                None => moved.push((name, digest, decision)),
            }
        }
        for (name, digest, decision) in moved {
            match by_digest.get(&(item(name), digest)).map(Vec::as_slice) {
                Some(&[i]) if !digest.is_empty() && !is_there(name) => {
                    renamed.entry(i).or_default().push((name, decision));
                }
                _ if by_name.contains_key(name) => {
                    told.push(format!("`{name}` has changed since it was decided about; look at it again"));
                }
                _ if !is_of_it(name) => {}
                _ => told.push(format!("`{name}` is decided about, but is not among the files")),
            }
        }
        renamed.retain(|i, _| !found.contains_key(i));
        for (i, all) in renamed {
            let (first, decision) = all[0];
            match all.iter().find(|(_, other)| !decision.agrees(other)) {
                None => drop(found.insert(i, (decision, Match::Renamed))),
                Some((other, _)) => told.push(format!(
                    "`{first}` and `{other}` are not among the files any more, and `{}` has the bytes of both, of which \
                     unlike things were decided; neither is applied: keep one of the two lines",
                    assets[i].0
                )),
            }
        }
        (found, told)
    }
}

/// The file that a name means: its own, or that of the asset of a file of several.
pub fn file(name: &str) -> &str {
    file_and_item(name).0
}

/// Which asset of a file of several a name means; empty for the asset of a file of one.
pub fn item(name: &str) -> &str {
    file_and_item(name).1
}

fn escaped(text: &str) -> String {
    // A name may begin as a comment does.
    let start = if text.starts_with('#') { "\\" } else { "" };
    start.to_owned() + &text.replace('\\', "\\\\").replace('\t', "\\t").replace('\n', "\\n").replace('\r', "\\r")
}

fn unescaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut letters = text.chars();
    while let Some(c) = letters.next() {
        match (c, c == '\\') {
            (_, true) => match letters.next() {
                Some('t') => out.push('\t'),
                Some('n') => out.push('\n'),
                Some('r') => out.push('\r'),
                Some(other) => out.push(other),
                None => out.push('\\'),
            },
            (c, _) => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decision(verdict: Verdict, comment: &str) -> Decision {
        Decision { verdict, comment: comment.into(), ..Decision::default() }
    }

    #[test]
    fn decisions_come_back_whatever_they_say() {
        let mut all = Decisions::default();
        let odd = Decision {
            verdict: Verdict::Reject,
            category: Some(Category::Reptile),
            faults: vec!["knees, both".into(), " ".into(), "tail".into()],
            comment: "two\tlines\nand \\ a \\t\r".into(),
        };
        all.set("b é\t.glb", "00", odd);
        all.set("#a.glb", "11", decision(Verdict::Accept, ""));
        all.set("c.glb", "22", decision(Verdict::Open, "?"));
        all.set("gone.glb", "33", decision(Verdict::Accept, ""));
        all.set("gone.glb", "33", Decision::default());
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("decisions.tsv");
        assert!(Decisions::read(&path).unwrap().is_empty());
        all.write(&path).unwrap();
        let again = Decisions::read(&path).unwrap();
        assert_eq!(again.get("b é\t.glb", "00").unwrap().faults, ["knees  both", "tail"]);
        assert_eq!(again, all);
        assert_eq!(again.to_text(), all.to_text());
    }

    #[test]
    fn lines_that_are_none_are_told_by_number() {
        let fault = |line: &str| Decisions::parse(&format!("# head\n\n{line}\n")).unwrap_err();
        assert_eq!(fault("a\tb").0, 3);
        assert!(fault("a\tb\tmaybe\t\t\t").1.contains("`maybe` is no verdict"));
        assert!(fault("a\tb\taccept\tbird\t\t").1.contains("`bird` is no category"));
        assert!(fault("<<<<<<< ours").1.contains("conflict"));
        assert!(fault("a\tb\t-\t\t\tx\na\tb\t-\t\t\ty").1.contains("twice"));
    }

    #[test]
    fn a_mark_that_editors_put_before_a_text_is_no_line() {
        let with_mark = |text: &str| Decisions::parse(&format!("\u{feff}{text}"));
        let line = "a\t1\taccept\t\t\t\n";
        for text in [format!("{HEAD}{line}"), line.to_owned()] {
            assert_eq!(with_mark(&text), Decisions::parse(line));
        }
    }

    #[test]
    fn renamed_files_are_found_and_changed_ones_told() {
        let mut all = Decisions::default();
        all.set("old.glb", "d1", decision(Verdict::Reject, ""));
        all.set("same.glb", "d2", decision(Verdict::Accept, ""));
        all.set("changed.glb", "d3", decision(Verdict::Accept, ""));
        all.set("lost.glb", "d4", decision(Verdict::Accept, ""));
        let assets = [("new.glb", "d1"), ("same.glb", "d2"), ("changed.glb", "d9")];
        let (found, told) = all.applied(&assets, |_| true, |name| ["same.glb", "changed.glb"].contains(&name));
        assert_eq!(found[&0], (&decision(Verdict::Reject, ""), Match::Renamed));
        assert_eq!(found[&1].1, Match::Same);
        assert_eq!((found.len(), told.len()), (2, 2));
        assert!(told[0].contains("`changed.glb` has changed") && told[1].contains("`lost.glb`"));
        // A copy is no renamed file while the one that was decided about is there, changed or in another part.
        let assets = [("copy.glb", "d1"), ("same.glb", "d3"), ("changed.glb", "d9")];
        let (found, told) = all.applied(&assets, |name| name != "old.glb", |name| name != "lost.glb");
        assert!(found.is_empty() && told.len() == 3, "{found:?} {told:?}");
        // Two that are gone, of the same bytes.
        for (verdict, wanted) in
            [(Verdict::Reject, Some(Verdict::Reject)), (Verdict::Accept, None), (Verdict::Open, None)]
        {
            let mut two = Decisions::default();
            two.set("a.glb", "d1", decision(Verdict::Reject, ""));
            two.set("b.glb", "d1", decision(verdict, "fine"));
            let (found, told) = two.applied(&[("c.glb", "d1")], |_| true, |name| name == "c.glb");
            assert_eq!(found.get(&0).map(|(own, _)| own.verdict), wanted);
            assert_eq!(told.len(), usize::from(wanted.is_none()));
            assert!(
                told.iter().all(|said| said.starts_with("`a.glb` and `b.glb`") && said.contains("`c.glb`")),
                "{told:?}"
            );
            // What was decided about the file that is there stands.
            two.set("c.glb", "d1", decision(Verdict::Accept, ""));
            let (found, told) = two.applied(&[("c.glb", "d1")], |_| true, |name| name == "c.glb");
            assert!(found[&0].0.verdict == Verdict::Accept && told.is_empty(), "{told:?}");
        }
        let mut theirs = Decisions::default();
        theirs.set("same.glb", "d2", decision(Verdict::Reject, ""));
        all.merge(theirs);
        assert_eq!((all.len(), all.get("same.glb", "d2").unwrap().verdict), (4, Verdict::Reject));
    }
}
