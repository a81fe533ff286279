//! `manifest.json` beside files: where each is from.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use riglab_core::Provenance;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use crate::words::{listed_name, nearest, some_of, without_mark};

/// What may be said of each file; all of it optional but the name.
#[derive(Default, PartialEq, Deserialize)]
#[serde(default)]
struct Entry {
    #[serde(deserialize_with = "text")]
    file: String,
    #[serde(deserialize_with = "text")]
    source: String,
    #[serde(deserialize_with = "text")]
    licence: String,
    #[serde(deserialize_with = "text")]
    author: String,
    #[serde(deserialize_with = "text")]
    category: String,
}

/// A text; null says as little as an empty one.
fn text<'de, D: Deserializer<'de>>(value: D) -> Result<String, D::Error> {
    Option::<String>::deserialize(value).map(Option::unwrap_or_default)
}

impl Entry {
    /// The first thing that two entries of one file say differently: its key, and what each says.
    fn contradicts<'a>(&'a self, other: &'a Self) -> Option<(&'static str, &'a str, &'a str)> {
        let all = [
            ("licence", &self.licence, &other.licence),
            ("author", &self.author, &other.author),
            ("source", &self.source, &other.source),
            ("category", &self.category, &other.category),
        ];
        all.into_iter().find(|(_, a, b)| a != b).map(|(key, a, b)| (key, a.as_str(), b.as_str()))
    }
}

const KEYS: [&str; 5] = ["file", "source", "licence", "author", "category"];

/// What `manifest.json` beside the files says of them: a list of objects with `file`, `source`, `licence`,
/// `author`, `category`; nothing where there is none.
#[derive(Default)]
pub struct Manifest {
    of: HashMap<String, Entry>,
    /// What is said of each file and of assets in it, as a number.
    said: HashMap<String, u64>,
    told: Vec<String>,
}

impl Manifest {
    /// Reads that of a folder. One that is no such list is left out; an entry that is none costs itself alone.
    pub fn read(folder: &Path) -> Self {
        let place = folder.join("manifest.json");
        let bytes = match std::fs::read(&place) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Self::default(),
            read => read.map_err(|e| e.to_string()),
        };
        let place = place.display();
        match bytes.and_then(|b| serde_json::from_slice::<Vec<Value>>(without_mark(&b)).map_err(|e| e.to_string())) {
            Ok(entries) => Self::of(entries, &place.to_string()),
            Err(e) => {
                let told = vec![format!("{place} is left out ({e}): no licences or authors from it")];
                Self { told, ..Self::default() }
            }
        }
    }

    fn of(entries: Vec<Value>, place: &str) -> Self {
        let mut new = Self::default();
        let (mut wrong, mut unnamed, mut mistyped) = (Vec::new(), 0, BTreeSet::new());
        let mut twice = Vec::new();
        for (number, value) in entries.into_iter().enumerate() {
            // A key is mistyped where the entry lacks the one that it is like: others are somebody's own.
            if let Some(keys) = value.as_object() {
                let meant = |key: &String| nearest(key, &KEYS).filter(|near| !keys.contains_key(*near));
                mistyped.extend(keys.keys().filter_map(|key| Some((key.clone(), meant(key)?))));
            }
            match serde_json::from_value::<Entry>(value) {
                Ok(entry) if entry.file.is_empty() => unnamed += 1,
                Ok(mut entry) => {
                    entry.file = listed_name(&entry.file).to_owned();
                    let name = entry.file.clone();
                    let other = new.of.insert(name.clone(), entry);
                    if let Some((key, a, b)) = other.as_ref().and_then(|other| other.contradicts(&new.of[&name])) {
                        twice.push(format!("`{name}` (`{key}` is `{a}` and then `{b}`)"));
                    }
                }
                Err(e) => wrong.push(format!("{number} ({e})")),
            }
        }
        if let Some(first) = wrong.first() {
            let n = wrong.len();
            let (entries, are) = if n == 1 { ("entry", "is") } else { ("entries", "are") };
            new.told.push(format!("{place}: {n} {entries} {are} of a wrong form and left out, the first: {first}"));
        }
        if unnamed > 0 {
            let entries = if unnamed == 1 { "entry names" } else { "entries name" };
            new.told.push(format!("{place}: {unnamed} {entries} no file (key `file`) and were ignored"));
        }
        if let Some(first) = twice.first() {
            let more = if twice.len() > 1 { format!(" and {} more", twice.len() - 1) } else { String::new() };
            new.told.push(format!(
                "{place}: entries of one file say different things, and the last counts: {first}{more}; keep one of them"
            ));
        }
        for (key, near) in mistyped {
            new.told.push(format!("{place}: the key `{key}` means nothing here; did you mean `{near}`?"));
        }
        new.said = said(&new.of);
        new
    }

    /// Sentences on what is wrong with it, without what a look at the files would tell.
    pub fn told(&self) -> &[String] {
        &self.told
    }

    /// A sentence on the entries of what is not there.
    pub fn strangers(&self, is_there: impl Fn(&str) -> bool) -> Option<String> {
        let gone: Vec<&str> = self.of.keys().map(String::as_str).filter(|name| !is_there(name)).collect();
        let names = (!gone.is_empty()).then(|| some_of(gone))?;
        Some(format!("manifest.json has entries of what is not there: {names}; names are paths below the folder"))
    }

    /// The categories that are stated, each with how many times.
    pub fn categories(&self) -> BTreeMap<&str, usize> {
        let mut all = BTreeMap::new();
        for entry in self.of.values().filter(|e| !e.category.is_empty()) {
            *all.entry(entry.category.as_str()).or_default() += 1;
        }
        all
    }

    /// What is said of a file and of assets in it, as a number that changes with it; 0 for nothing.
    pub fn said(&self, file: &str) -> u64 {
        self.said.get(file).copied().unwrap_or(0)
    }

    /// Adds what is said of an asset's file, and over that what is said of the asset by its own name.
    pub fn describe(&self, asset: &str, file: &str, from: &mut Provenance) {
        for entry in [file, asset].into_iter().filter_map(|name| self.of.get(name)) {
            for (to, value) in [
                (&mut from.source, &entry.source),
                (&mut from.licence, &entry.licence),
                (&mut from.author, &entry.author),
                (&mut from.category, &entry.category),
            ] {
                if !value.is_empty() {
                    to.clone_from(value);
                }
            }
        }
    }
}

/// By file: what its own entry and those of assets in it (`set.npz#a`) say.
fn said(of: &HashMap<String, Entry>) -> HashMap<String, u64> {
    let mut hashes: HashMap<String, blake3::Hasher> = HashMap::new();
    for (name, e) in of.iter().collect::<BTreeMap<_, _>>() {
        let parts = name.match_indices('#').map(|(at, _)| &name[..at]);
        for file in parts.chain([name.as_str()]) {
            let hash = hashes.entry(file.to_owned()).or_default();
            for text in [name, &e.source, &e.licence, &e.author, &e.category] {
                hash.update(text.as_bytes()).update(b"\n");
            }
        }
    }
    let number = |hash: blake3::Hasher| {
        hash.finalize().as_bytes().iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte))
    };
    hashes.into_iter().map(|(file, hash)| (file, number(hash))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Manifest {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("manifest.json"), text).unwrap();
        Manifest::read(dir.path())
    }

    #[test]
    fn a_wrong_entry_costs_itself_alone() {
        let manifest = of(r#"[{"file": "a", "licence": 3}, {"file": "b", "licence": "MIT"}, {"author": "x"}, 7]"#);
        let mut from = Provenance::default();
        manifest.describe("b", "b", &mut from);
        assert_eq!(from.licence, "MIT");
        let told = manifest.told();
        assert!(told[0].contains("2 entries are of a wrong form") && told[0].contains("the first: 0 ("), "{told:?}");
        assert!(told[1].contains("1 entry names no file"), "{told:?}");
        assert!(of("{}").told()[0].contains("manifest.json is left out"));
    }

    #[test]
    fn two_entries_of_a_file_that_differ_are_told() {
        let twice = |licence: &str| {
            let entries = format!(r#"[{{"file": "a", "licence": "MIT"}}, {{"file": "./a", "licence": "{licence}"}}]"#);
            of(&entries).told().concat()
        };
        assert_eq!(twice("MIT"), "");
        let told = twice("CC-BY-NC-4.0");
        assert!(told.contains("`a` (`licence` is `MIT` and then `CC-BY-NC-4.0`)"), "{told}");
    }

    #[test]
    fn nulls_steps_to_the_same_folder_and_byte_order_marks_cost_nothing() {
        let manifest = of("\u{feff}[{\"file\": \"./a/b\", \"licence\": \"MIT\", \"author\": null}]");
        let mut from = Provenance { author: "file's own".into(), ..Provenance::default() };
        manifest.describe("a/b", "a/b", &mut from);
        assert_eq!((from.licence.as_str(), from.author.as_str()), ("MIT", "file's own"));
        assert!(manifest.told().is_empty() && manifest.strangers(|name| name == "a/b").is_none());
    }

    #[test]
    fn keys_and_names_that_mean_nothing_are_told() {
        let manifest =
            of(r#"[{"file": "a.glb", "license": "MIT", "bytes": 3, "title": "A"}, {"file": "b.glb", "bytes": 4}]"#);
        let told = manifest.told();
        assert!(told[0].ends_with("the key `license` means nothing here; did you mean `licence`?"), "{told:?}");
        assert_eq!(told.len(), 1, "what is somebody's own is no fault: {told:?}");
        let gone = manifest.strangers(|name| name == "a.glb").unwrap();
        assert!(gone.contains("`b.glb`") && !gone.contains("a.glb"), "{gone}");
        assert_eq!(manifest.strangers(|_| true), None);
    }

    #[test]
    fn what_is_said_of_an_asset_leaves_what_is_said_of_its_file() {
        let manifest = of(
            r#"[{"file": "set.npz", "licence": "CC-BY-NC-4.0", "category": "prop"}, {"file": "set.npz#a", "category": "quadruped"}]"#,
        );
        let mut from = Provenance::default();
        manifest.describe("set.npz#a", "set.npz", &mut from);
        assert_eq!((from.licence.as_str(), from.category.as_str()), ("CC-BY-NC-4.0", "quadruped"));
    }

    #[test]
    fn what_is_said_of_a_file_is_known_by_a_number() {
        let number =
            |category: &str| of(&format!(r#"[{{"file": "set.npz#a", "category": "{category}"}}]"#)).said("set.npz");
        assert_eq!(number("aquatic"), number("aquatic"));
        assert_ne!(number("aquatic"), number("reptile"));
        assert_eq!(of("[]").said("set.npz"), 0);
    }
}
