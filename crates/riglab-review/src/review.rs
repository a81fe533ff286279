//! A review: what is looked at, what was decided, and pictures.

use std::path::{Path, PathBuf};

use riglab_curate::{Places, Reading};
use riglab_data::Corpus;

use crate::ReviewError;
use crate::deck::Deck;
use crate::ledger::Ledger;
use crate::pictures::Pictures;

/// All that the page shows.
pub struct Review {
    /// The name of the corpus, without its folder.
    pub(crate) title: String,
    /// The corpus, as it was given.
    pub(crate) corpus: PathBuf,
    pub(crate) deck: Deck,
    pub(crate) ledger: Ledger,
    pub(crate) pictures: Pictures,
}

/// How far a review is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tally {
    /// Assets with a verdict.
    pub decided: usize,
    /// Assets.
    pub of: usize,
}

impl Review {
    /// Opens a corpus with what a curation wrote beside it, and the file of decisions, which may not be
    /// there yet. `files` is the folder that was curated: what it dropped is drawn from there.
    ///
    /// # Errors
    /// When there is neither corpus nor curation, no folder for the decisions, or something cannot be read.
    pub fn open(corpus: &Path, files: Option<&Path>, decisions: &Path) -> Result<Self, ReviewError> {
        let stored = if corpus.is_file() { Some(Corpus::open(corpus)?) } else { None };
        let mut deck = Deck::open(corpus, stored.as_ref())?;
        // Told now rather than at the first decision.
        let folder = decisions.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            let message = "there is no such folder for the file of decisions".into();
            return Err(ReviewError::Io { path: folder.into(), message });
        }
        let pictures = Pictures::new(stored, files, Reading::of(&Places::of(corpus)))?;
        let mut known = std::mem::take(&mut deck.known);
        known.folder = pictures.folder();
        let ledger = Ledger::open(decisions, &deck.cards, known)?;
        let title = corpus.file_name().unwrap_or(corpus.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { title, corpus: corpus.into(), deck, ledger, pictures })
    }

    /// How far it is, by the last that was read or written.
    pub fn tally(&self) -> Tally {
        Tally { decided: self.ledger.state().decided(), of: self.deck.cards.len() }
    }

    /// Files that could not be read, about which nothing can be decided.
    pub fn unreadable(&self) -> usize {
        self.deck.unreadable
    }

    /// Of the files whose assets are not in the corpus, how many are not in the folder, and how many there are; `None` where
    /// all are there, or no folder was given.
    pub fn gone(&self) -> Option<(usize, usize)> {
        self.pictures.gone(&self.deck.cards)
    }

    /// Sentences on decisions that are about none of the assets.
    pub fn told(&self) -> Vec<String> {
        self.ledger.state().told
    }

    /// Where decisions are kept if nothing else is said ([`Places::decisions`]).
    pub fn decisions_of(corpus: &Path) -> PathBuf {
        Places::of(corpus).decisions()
    }
}
