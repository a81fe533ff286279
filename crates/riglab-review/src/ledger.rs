//! The file of decisions, and which card each is about.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use riglab_curate::CurateError;
use riglab_curate::decisions::{Decision, Decisions, Verdict, item};

use crate::deck::{Card, Known};
use crate::hold::Hold;

/// Decisions about cards.
pub struct Ledger {
    path: PathBuf,
    known: Known,
    state: Mutex<State>,
    hold: Mutex<Option<Hold>>,
}

/// What the file said when it was last read or written.
#[derive(Clone, Default)]
pub struct State {
    /// The decision about each card; empty where there is none.
    pub of: Vec<Decision>,
    /// Sentences on decisions that are about no card.
    pub told: Vec<String>,
}

impl State {
    /// How many cards have a verdict.
    pub fn decided(&self) -> usize {
        self.of.iter().filter(|d| d.verdict != Verdict::Open).count()
    }
}

impl Ledger {
    /// Reads the file; one that is not there yet holds no decisions.
    ///
    /// # Errors
    /// When it cannot be read, or with the first line that is no decision.
    pub fn open(path: &Path, cards: &[Card], known: Known) -> Result<Self, CurateError> {
        let state = matched(&Decisions::read(path)?, cards, &known);
        Ok(Self { path: path.into(), known, state: Mutex::new(state), hold: Mutex::new(None) })
    }

    /// Keeps other servers from the file, until the end.
    ///
    /// # Errors
    /// [`CurateError::Held`] when another has it.
    pub fn hold(&self) -> Result<(), CurateError> {
        self.held().map(|_| ())
    }

    /// The lock of the file as it is now: one that somebody put in its place is locked anew.
    fn held(&self) -> Result<MutexGuard<'_, Option<Hold>>, CurateError> {
        let mut hold = self.hold.lock().unwrap_or_else(PoisonError::into_inner);
        if !hold.as_ref().is_some_and(|hold| hold.holds(&self.path)) {
            *hold = None;
            *hold = Some(Hold::take(&self.path)?);
        }
        Ok(hold)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What was decided, read anew: the file may have been edited.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn read(&self, cards: &[Card]) -> Result<State, CurateError> {
        let mut state = self.locked();
        *state = matched(&Decisions::read(&self.path)?, cards, &self.known);
        Ok(state.clone())
    }

    /// What was decided when the file was last read or written.
    pub fn state(&self) -> State {
        self.locked().clone()
    }

    /// Decides about a card and writes the file. What was decided about it under an earlier name, or about
    /// an earlier state of its file, goes: a person has looked at it again. `was` is what that person took to be
    /// decided, if it is known.
    ///
    /// Gives how many cards have a verdict now.
    ///
    /// # Errors
    /// When the file cannot be read or written, or is in conflict; [`CurateError::Newer`] where something else was decided
    /// meanwhile. The file stays as it was.
    pub fn decide(
        &self,
        cards: &[Card],
        index: usize,
        decision: Decision,
        was: Option<&Decision>,
    ) -> Result<usize, CurateError> {
        let mut state = self.locked();
        let mut hold = self.held()?;
        let mut all = Decisions::read(&self.path)?;
        let card = &cards[index];
        let now = &matched(&all, cards, &self.known).of[index];
        // A person may have written it otherwise than the page sends it.
        let stands = as_kept(now);
        if was.is_some_and(|was| as_kept(was) != stands) && as_kept(&decision) != stands {
            return Err(CurateError::Newer { name: card.name.clone(), decision: Box::new(now.clone()) });
        }
        for (name, digest) in superseded(&all, cards, card, &self.known) {
            all.set(&name, &digest, Decision::default());
        }
        all.set(&card.name, &card.digest, decision);
        let write = |hold: &mut Hold| hold.write(&self.path, all.to_text().as_bytes());
        let written = hold.as_mut().map_or(Ok(()), write);
        written.map_err(|e| CurateError::write(&self.path, &e))?;
        *state = matched(&all, cards, &self.known);
        Ok(state.decided())
    }

    fn locked(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A decision as the page has the file keep it.
fn as_kept(decision: &Decision) -> Decision {
    let mut one = Decisions::default();
    one.set("", "", Decision { comment: decision.comment.trim().to_owned(), ..decision.clone() });
    one.get("", "").cloned().unwrap_or_default()
}

fn matched(decisions: &Decisions, cards: &[Card], known: &Known) -> State {
    let keys: Vec<(&str, &str)> = cards.iter().map(|c| (c.name.as_str(), c.digest.as_str())).collect();
    let (found, told) = decisions.applied(&keys, |name| known.is_own(name), |name| known.may_be(name));
    let mut of = vec![Decision::default(); cards.len()];
    for (index, (decision, _)) in found {
        of[index] = decision.clone();
    }
    State { of, told }
}

/// Decisions that one about this card takes the place of: about its file as it was, and under names that no
/// asset can have any more.
fn superseded(all: &Decisions, cards: &[Card], card: &Card, known: &Known) -> Vec<(String, String)> {
    let twins = cards.iter().filter(|c| c.digest == card.digest && item(&c.name) == item(&card.name)).count();
    let before = |name: &str, digest: &str| match name == card.name {
        true => digest != card.digest,
        false => twins == 1 && digest == card.digest && item(name) == item(&card.name) && !known.may_be(name),
    };
    let old = all.iter().filter(|(name, digest, _)| before(name, digest));
    old.map(|(name, digest, _)| (name.to_owned(), digest.to_owned())).collect()
}

#[cfg(test)]
mod tests {
    use riglab_curate::Shard;

    use super::*;
    use crate::deck::Place;

    fn card(name: &str, digest: &str) -> Card {
        Card {
            name: name.into(),
            digest: digest.into(),
            stage: None,
            reason: String::new(),
            category: String::new(),
            by: String::new(),
            counts: [0; 3],
            notes: Vec::new(),
            place: Place::Corpus(0),
        }
    }

    /// Of the whole of the curated files.
    fn open(path: &Path, cards: &[Card]) -> Ledger {
        Ledger::open(path, cards, Known::of(cards, Some(Vec::new()))).unwrap()
    }

    fn verdict(verdict: Verdict) -> Decision {
        Decision { verdict, ..Decision::default() }
    }

    #[test]
    fn a_decision_takes_the_place_of_those_about_what_the_asset_was() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let mut old = Decisions::default();
        old.set("a.glb", "11", verdict(Verdict::Reject)); // as it was before it changed
        old.set("was_b.glb", "22", verdict(Verdict::Reject)); // b under another name
        old.set("elsewhere.glb", "99", verdict(Verdict::Reject)); // of another corpus
        old.write(&path).unwrap();
        let cards = [card("a.glb", "12"), card("b.glb", "22")];
        let ledger = open(&path, &cards);
        let state = ledger.state();
        assert_eq!((state.of[0].verdict, state.of[1].verdict), (Verdict::Open, Verdict::Reject));
        assert_eq!(state.told.len(), 2);
        assert_eq!(ledger.decide(&cards, 0, verdict(Verdict::Accept), None).unwrap(), 2);
        // Taking b's decision back leaves nothing of the old name either.
        assert_eq!(ledger.decide(&cards, 1, Decision::default(), None).unwrap(), 1);
        let now = Decisions::read(&path).unwrap();
        let left: Vec<_> = now.iter().map(|(name, digest, _)| (name, digest)).collect();
        assert_eq!(left, [("a.glb", "12"), ("elsewhere.glb", "99")]);
    }

    #[test]
    fn what_may_be_about_a_file_elsewhere_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let cards = [card("a.glb", "11")];
        let shard = |of: u64| Shard { number: (1..=of).find(|&number| Shard { number, of }.has("a.glb")).unwrap(), of };
        let (of, own) = (2..).map(|of| (of, shard(of))).find(|(_, own)| !own.has("copy.glb")).unwrap();
        let mut other = Decisions::default();
        other.set("copy.glb", "11", verdict(Verdict::Reject));
        // A copy of another shard, one that may be anywhere, and one that is told to be nowhere.
        for (parts, told) in
            [(Some(vec![own]), 0), (None, 1), (Some((1..=of).map(|number| Shard { number, of }).collect()), 0)]
        {
            let gone = parts.as_ref().is_some_and(|parts| parts.len() > 1);
            other.write(&path).unwrap();
            let ledger = Ledger::open(&path, &cards, Known::of(&cards, parts)).unwrap();
            let state = ledger.state();
            assert_eq!((state.of[0].verdict != Verdict::Open, state.told.len()), (gone, told));
            ledger.decide(&cards, 0, verdict(Verdict::Accept), None).unwrap();
            let now = Decisions::read(&path).unwrap();
            assert_eq!((now.get("copy.glb", "11").is_none(), now.get("a.glb", "11").is_some()), (gone, true));
        }
    }

    #[test]
    fn what_others_write_meanwhile_stays_and_a_conflict_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let cards = [card("a", "1"), card("b", "2")];
        let ledger = open(&path, &cards);
        let mut other = Decisions::default();
        other.set("b", "2", verdict(Verdict::Reject));
        other.write(&path).unwrap();
        assert_eq!(ledger.decide(&cards, 0, verdict(Verdict::Accept), None).unwrap(), 2);
        let text = std::fs::read_to_string(&path).unwrap() + "<<<<<<< ours\n";
        std::fs::write(&path, &text).unwrap();
        let said = ledger.decide(&cards, 0, Decision::default(), None).unwrap_err().to_string();
        assert!(said.contains("d.tsv:5") && said.contains("conflict"), "{said}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn what_another_window_decided_is_not_wiped() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let cards = [card("a", "1")];
        let ledger = open(&path, &cards);
        let (nothing, mut said) = (Decision::default(), verdict(Verdict::Accept));
        said.comment = "look at the knees".into();
        ledger.decide(&cards, 0, said.clone(), Some(&nothing)).unwrap();
        // A window that loaded nothing, and would wipe the comment.
        let stale = ledger.decide(&cards, 0, verdict(Verdict::Reject), Some(&nothing)).unwrap_err();
        assert!(matches!(&stale, CurateError::Newer { decision, .. } if **decision == said), "{stale}");
        assert_eq!(ledger.state().of[0], said);
        // The same again loses nothing, and whoever has seen it may change it.
        ledger.decide(&cards, 0, said.clone(), Some(&nothing)).unwrap();
        ledger.decide(&cards, 0, verdict(Verdict::Reject), Some(&said)).unwrap();
        // A fault with a comma is kept without it, and known again.
        let odd =
            |faults: &[&str]| Decision { faults: faults.iter().map(|f| (*f).into()).collect(), ..nothing.clone() };
        ledger.decide(&cards, 0, odd(&["knees, both", "knees, both"]), Some(&verdict(Verdict::Reject))).unwrap();
        assert_eq!(ledger.state().of[0].faults.len(), 1);
        ledger.decide(&cards, 0, said, Some(&odd(&["knees, both"]))).unwrap();
    }

    #[test]
    fn what_was_written_by_hand_can_be_changed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let cards = [card("a", "1")];
        for by_hand in ["a\t1\taccept\t\t\tgood \n", "a\t1\treject\t\tlegs,legs\t\n"] {
            std::fs::write(&path, by_hand).unwrap();
            let ledger = open(&path, &cards);
            let was = ledger.state().of[0].clone();
            let sent = Decision { comment: was.comment.trim().to_owned(), ..was };
            assert_eq!(ledger.decide(&cards, 0, Decision::default(), Some(&sent)).unwrap(), 0, "{by_hand}");
        }
    }

    #[test]
    fn a_second_server_is_kept_out() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let cards = [card("a", "1")];
        let [one, two] = [0, 1].map(|_| open(&path, &cards));
        one.hold().unwrap();
        assert!(matches!(two.hold(), Err(CurateError::Held(_))));
        one.decide(&cards, 0, verdict(Verdict::Accept), None).unwrap();
        let said = two.decide(&cards, 0, verdict(Verdict::Reject), None).unwrap_err().to_string();
        assert!(said.contains("d.tsv: another `riglab review` keeps its decisions here"), "{said}");
        drop(one);
        two.hold().unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
