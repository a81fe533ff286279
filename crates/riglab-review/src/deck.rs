//! The assets that are looked at: those of a corpus, and those that a curation dropped.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use riglab_curate::{Category, Folder, Places, Shard, decisions, shards};
use riglab_data::Corpus;
use serde::{Deserialize, Serialize};

use crate::ReviewError;

/// The stage of what could not be read, about which nothing can be decided.
const READ: &str = "read";

/// An asset, as the page shows it.
#[derive(Clone, Debug, Serialize)]
pub struct Card {
    /// Its name.
    pub name: String,
    /// The first 16 digits of its file's checksum.
    pub digest: String,
    /// The stage that dropped it; `None` for what is kept.
    pub stage: Option<String>,
    /// Why.
    pub reason: String,
    /// Its category; may be empty.
    pub category: String,
    /// What says so.
    pub by: String,
    /// Joints, vertices, triangles.
    pub counts: [usize; 3],
    /// What the importer and the repairs say of it.
    pub notes: Vec<String>,
    /// Where its rig is.
    #[serde(skip)]
    pub place: Place,
}

/// Where a rig can be read.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// The number in the corpus.
    Corpus(usize),
    /// The file of the curated folder.
    File(String),
}

/// Cards in order of their names.
pub struct Deck {
    /// All of them.
    pub cards: Vec<Card>,
    /// Files that could not be read, which have no card.
    pub unreadable: usize,
    /// What else there may be.
    pub known: Known,
}

/// What is known of the files that a decision may be about.
#[derive(Default)]
pub struct Known {
    /// Names of all assets and their files, whether they have cards or not.
    names: HashSet<String>,
    /// The parts of the curated files that they are all of, none of the whole; `None` where nothing is said of a curation.
    parts: Option<Vec<Shard>>,
    /// The folder as it is now, if it was given.
    pub folder: Option<Arc<Folder>>,
}

impl Known {
    /// Whether there may be an asset of that name, as far as is known: what was decided about it is about no other.
    pub fn may_be(&self, name: &str) -> bool {
        let file = decisions::file(name);
        let is_seen = self.names.contains(name) || self.names.contains(file);
        let is_of_another = self.parts.as_ref().is_none_or(|parts| !Shard::any_has(parts, file));
        is_seen || is_of_another || self.folder.as_ref().is_some_and(|folder| folder.is_there(name))
    }

    /// Whether a name is of the parts that are looked at, not of others, whose decisions are theirs to tell.
    pub fn is_own(&self, name: &str) -> bool {
        self.parts.as_ref().is_none_or(|parts| Shard::any_has(parts, decisions::file(name)))
    }
}

/// A line of a curation's list; what else stands there is not asked.
#[derive(Deserialize)]
struct Line {
    name: String,
    #[serde(default)]
    digest: String,
    #[serde(default)]
    file: String,
    stage: Option<String>,
    reason: Option<String>,
    category: Option<String>,
    by: Option<String>,
    rules: Option<String>,
    joints: Option<usize>,
    vertices: Option<usize>,
    triangles: Option<usize>,
    #[serde(default)]
    notes: Vec<String>,
}

impl Deck {
    /// Of a corpus and the curation beside it; one of them may be missing.
    ///
    /// # Errors
    /// When both are, or one cannot be read.
    pub fn open(path: &Path, corpus: Option<&Corpus>) -> Result<Self, ReviewError> {
        let list = Places::of(path).assets();
        let text = match std::fs::read_to_string(&list) {
            Ok(text) => Some(text),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => None,
            Err(e) => return Err(ReviewError::Io { path: list, message: e.to_string() }),
        };
        let nothing = |why: &str| ReviewError::Nothing { path: path.into(), why: why.into() };
        if text.is_none() && corpus.is_none() {
            return Err(nothing("there is no such corpus, and no curation beside it"));
        }
        let parts = text.is_some().then(|| shards(path));
        let mut deck = Self { cards: Vec::new(), unreadable: 0, known: Known { parts, ..Known::default() } };
        let mut stored = corpus.map(stored).transpose()?.unwrap_or_default();
        for (number, line) in text.iter().flat_map(|text| text.lines()).enumerate() {
            let line: Line = serde_json::from_str(line).map_err(|e| ReviewError::List {
                path: list.clone(),
                line: number + 1,
                message: e.to_string(),
            })?;
            deck.known.names.extend([line.name.clone(), line.file.clone()]);
            if line.stage.as_deref() == Some(READ) {
                deck.unreadable += 1;
            } else {
                let key = (line.name.clone(), line.digest.clone());
                let place = stored.remove(&key).map(|card| card.place);
                deck.cards.push(line.card(place));
            }
        }
        deck.known.names.extend(stored.keys().map(|(name, _)| name.clone()));
        deck.cards.extend(stored.into_values());
        deck.cards.sort_by(|a, b| (&a.name, &a.digest).cmp(&(&b.name, &b.digest)));
        if deck.cards.is_empty() {
            return Err(nothing("no asset of it could be read"));
        }
        Ok(deck)
    }
}

impl Line {
    fn card(self, place: Option<Place>) -> Card {
        let (category, by) = match (self.category, self.rules) {
            (Some(category), _) => (category, self.by.unwrap_or_default()),
            // What was dropped is not labelled.
            (None, Some(rules)) => (rules, "rules".into()),
            (None, None) => (String::new(), String::new()),
        };
        Card {
            place: place.unwrap_or(Place::File(self.file)),
            name: self.name,
            digest: self.digest,
            stage: self.stage,
            reason: self.reason.unwrap_or_default(),
            category,
            by,
            counts: [self.joints, self.vertices, self.triangles].map(Option::unwrap_or_default),
            notes: self.notes,
        }
    }
}

/// The cards of a corpus, by name and digest.
fn stored(corpus: &Corpus) -> Result<HashMap<(String, String), Card>, ReviewError> {
    let [checksums, categories, notes] = ["checksum", "category", "notes"].map(|column| corpus.texts(column));
    let (checksums, categories, notes) = (checksums?, categories?, notes?);
    let mut all = HashMap::with_capacity(corpus.len());
    for (index, name) in corpus.names()?.iter().enumerate() {
        let digest = checksums[index].get(..16).unwrap_or(&checksums[index]).to_owned();
        let [vertices, triangles, joints, _] = corpus.counts(index);
        let known = categories[index].parse::<Category>().is_ok();
        let card = Card {
            name: name.clone(),
            digest: digest.clone(),
            stage: None,
            reason: String::new(),
            category: if known { categories[index].clone() } else { String::new() },
            by: if known { "the corpus".into() } else { String::new() },
            counts: [joints, vertices, triangles],
            notes: notes[index].lines().map(String::from).collect(),
            place: Place::Corpus(index),
        };
        all.insert((name.clone(), digest), card);
    }
    Ok(all)
}

#[cfg(test)]
impl Known {
    /// Of cards of some parts, none of the whole; `None` where nothing is said.
    pub fn of(cards: &[Card], parts: Option<Vec<Shard>>) -> Self {
        Self { names: cards.iter().map(|card| card.name.clone()).collect(), parts, folder: None }
    }
}
