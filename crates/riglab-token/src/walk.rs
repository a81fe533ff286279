//! What may follow by the released tokenizers: goldens of theirs, and their holes, exactly.
//!
//! It lets through what cannot be decoded (a class followed by the end, a branch of three coordinates) and
//! refuses what the encoder writes (a part followed by a branch); ids that may not follow still move it on.

use crate::vocabulary::Meaning;
use crate::{DecodeFault, Mask, Vocabulary};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Nothing yet.
    Start,
    AfterBos,
    AfterClass,
    /// The second and the third coordinate.
    Second,
    Third,
    /// After three coordinates.
    AfterPoint,
    /// A first coordinate must follow.
    First,
}

/// The released grammar, as it stands after some tokens.
#[derive(Clone, Debug)]
pub struct Walk {
    vocabulary: Vocabulary,
    state: State,
    points: usize,
    /// Points that only name a parent.
    parents: usize,
    branch: bool,
}

impl Walk {
    /// Before the first token.
    pub fn new(vocabulary: &Vocabulary) -> Self {
        let vocabulary = vocabulary.clone();
        Self { vocabulary, state: State::Start, points: 0, parents: 0, branch: false }
    }

    /// Takes the next token, allowed or not.
    ///
    /// # Errors
    /// When the first is not `bos`.
    pub fn advance(&mut self, id: u32) -> Result<(), DecodeFault> {
        let meaning = self.vocabulary.meaning(id);
        let cell = matches!(meaning, Meaning::Cell(_));
        self.state = match self.state {
            State::Start if meaning != Meaning::Bos => return Err(DecodeFault::NoBos),
            State::Start => State::AfterBos,
            State::AfterBos | State::AfterClass if cell => State::Second,
            State::AfterBos if matches!(meaning, Meaning::Class(_) | Meaning::NoClass) => State::AfterClass,
            State::AfterBos => State::First,
            State::AfterClass => State::AfterClass,
            State::First => State::Second,
            State::Second => State::Third,
            State::Third => {
                self.points += 1;
                self.parents += usize::from(std::mem::take(&mut self.branch));
                State::AfterPoint
            }
            State::AfterPoint if cell => State::Second,
            State::AfterPoint => {
                self.branch = meaning == Meaning::Branch;
                State::First
            }
        };
        Ok(())
    }

    /// Writes which ids may follow.
    pub fn allowed(&self, mask: &mut Mask) {
        mask.clear();
        let ids = &self.vocabulary;
        let cells = 0..ids.branch();
        match self.state {
            State::Start => mask.allow(ids.bos()),
            State::AfterBos => {
                mask.allow_all(cells);
                mask.allow_all(ids.spring()..ids.len() as u32);
            }
            State::AfterClass => {
                mask.allow_all(cells);
                mask.allow(ids.eos());
                mask.allow_all(ids.spring()..ids.no_class());
            }
            State::First | State::Second | State::Third => mask.allow_all(cells),
            State::AfterPoint => {
                mask.allow_all(cells);
                mask.allow(ids.branch());
                mask.allow(ids.eos());
                mask.allow_all(ids.spring()..ids.no_class());
            }
        }
    }

    /// Points so far, as UniRig counts joints: a branch counts twice.
    pub fn points(&self) -> usize {
        self.points
    }

    /// Joints so far, as SkinTokens counts them: wrong where a branch follows a part.
    pub fn joints(&self) -> usize {
        self.points - self.parents
    }
}
