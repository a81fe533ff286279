//! What may follow so that the whole is one tree.

use serde::{Deserialize, Serialize};

use crate::encode::Tokenizer;
use crate::template::Part;
use crate::vocabulary::Meaning;
use crate::{Classes, GrammarFault, Mask, Spring, Vocabulary};

/// Where a branch may come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Parents {
    /// From a joint that is there.
    #[default]
    Existing,
    /// From anywhere: decoding takes the nearest joint.
    Anywhere,
}

/// How long a skeleton may become.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Most joints.
    pub joints: usize,
    /// Most tokens, from `bos` to `eos`.
    pub tokens: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { joints: 256, tokens: 2048 }
    }
}

impl Limits {
    /// Whether a skeleton of so many joints and tokens is within them.
    pub fn hold(&self, joints: usize, tokens: usize) -> bool {
        joints <= self.joints && tokens <= self.tokens
    }
}

/// The tokens of a joint that goes on with a chain, and of one that branches off.
const CHAIN: usize = 3;
const BRANCH: usize = 7;

#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    Start,
    Class,
    /// Between joints.
    Between,
    /// After a branch token, or within a parent's or a joint's point: the coordinates so far.
    Parent([u16; 2], u8),
    Point([u16; 2], u8),
    Done,
}

/// The strict grammar, as it stands after some tokens: it lets a sequence end before a limit makes that
/// impossible, so whoever follows it always ends with a skeleton.
#[derive(Clone, Debug)]
pub struct Grammar {
    vocabulary: Vocabulary,
    limits: Limits,
    parents: Parents,
    spring: Spring,
    by_parts: bool,
    templates: bool,
    least: usize,
    state: State,
    tokens: usize,
    cells: Vec<[u16; 3]>,
    /// Parts of the class' template that may still come, by number.
    parts: Vec<(usize, &'static Part)>,
    /// Joints that the part in progress still lacks.
    lacking: usize,
    /// Whether joints of no part may come now.
    free: bool,
    /// Whether a part or class has just been named, so that a joint must follow.
    owing: bool,
    /// Whether a part was written.
    parted: bool,
}

impl Grammar {
    /// Before the first token of a sequence of this tokenizer.
    pub fn new(tokenizer: &Tokenizer, limits: Limits, parents: Parents) -> Self {
        let config = tokenizer.config();
        Self {
            vocabulary: tokenizer.vocabulary().clone(),
            limits,
            parents,
            spring: config.spring,
            by_parts: config.class == Classes::ByParts,
            templates: config.templates,
            least: config.least_joints,
            state: State::Start,
            tokens: 0,
            cells: Vec::new(),
            parts: Vec::new(),
            lacking: 0,
            free: false,
            owing: true,
            parted: false,
        }
    }

    /// Joints so far.
    pub fn joints(&self) -> usize {
        self.cells.len()
    }

    /// Tokens so far.
    pub fn tokens(&self) -> usize {
        self.tokens
    }

    /// Whether the end has come.
    pub fn is_done(&self) -> bool {
        self.state == State::Done
    }

    /// Whether a joint of so many tokens may follow: it must leave room for what the part in progress
    /// lacks, for the fewest joints there must be and for the end.
    fn room(&self, tokens: usize) -> bool {
        let joints = self.cells.len() + self.lacking.max(1);
        let after = CHAIN * self.lacking.saturating_sub(1) + self.rest(joints, self.lacking > 0);
        joints <= self.limits.joints && self.tokens + tokens + after <= self.limits.tokens
    }

    /// Whether a part of so many joints, or a spring token with one, may follow.
    fn room_for(&self, joints: usize, part: bool) -> bool {
        let all = self.cells.len() + joints;
        let after = CHAIN * joints + self.rest(all, part);
        all <= self.limits.joints && self.tokens + 1 + after <= self.limits.tokens
    }

    /// The tokens that must follow so many joints, the last of them of a part or of none: of joints that are still too few,
    /// and of the end.
    fn rest(&self, joints: usize, part: bool) -> usize {
        let lacking = self.least.saturating_sub(joints);
        // Behind a part, others are told by a token of their own.
        let told = lacking > 0 && part && self.spring != Spring::Never;
        CHAIN * lacking + usize::from(told) + 1
    }

    fn parts_of(&self, class: usize) -> Vec<(usize, &'static Part)> {
        if self.templates { self.vocabulary.parts_of(&self.vocabulary.classes()[class]) } else { Vec::new() }
    }

    /// Writes which ids may follow; none after the end.
    pub fn allowed(&self, mask: &mut Mask) {
        mask.clear();
        let ids = &self.vocabulary;
        match &self.state {
            State::Start => mask.allow(ids.bos()),
            State::Class => {
                mask.allow(ids.no_class());
                for class in 0..ids.classes().len() {
                    // One with a template begins with a part of it, where that is the rule.
                    let parts = self.parts_of(class);
                    let after = Self { tokens: self.tokens + 1, ..self.clone() };
                    if parts.is_empty()
                        || !self.by_parts
                        || parts.iter().any(|(_, p)| after.room_for(p.joints.len(), true))
                    {
                        mask.allow(ids.class(class));
                    }
                }
            }
            State::Between => self.between(mask),
            State::Parent(so_far, n) => self.parent(mask, so_far, *n),
            State::Point(..) => mask.allow_all(0..ids.branch()),
            State::Done => {}
        }
    }

    fn between(&self, mask: &mut Mask) {
        let ids = &self.vocabulary;
        let in_part = self.lacking > 0;
        if (in_part || self.free) && self.room(CHAIN) {
            mask.allow_all(0..ids.branch());
        }
        if (in_part || self.free) && !self.cells.is_empty() && self.room(BRANCH) {
            mask.allow(ids.branch());
        }
        if in_part || self.owing {
            // A class has just been named: its parts, or a spring token, may come before the first joint.
            if self.cells.is_empty() && !in_part && !self.parted {
                self.starts(mask);
            }
            return;
        }
        self.starts(mask);
        if self.cells.len() >= self.least {
            mask.allow(ids.eos());
        }
    }

    /// Parts, and the spring token.
    fn starts(&self, mask: &mut Mask) {
        let ids = &self.vocabulary;
        for (number, part) in &self.parts {
            if self.room_for(part.joints.len(), true) {
                mask.allow(ids.part(*number));
            }
        }
        let first = self.cells.is_empty();
        let may = match self.spring {
            Spring::Never => false,
            Spring::AfterParts => self.parted,
            Spring::WithClass | Spring::Always => self.parted || first,
        };
        if may && (first || !self.free) && self.room_for(1, false) {
            mask.allow(ids.spring());
        }
    }

    fn parent(&self, mask: &mut Mask, so_far: &[u16; 2], n: u8) {
        if self.parents == Parents::Anywhere {
            mask.allow_all(0..self.vocabulary.branch());
            return;
        }
        let n = usize::from(n);
        for cell in self.cells.iter().filter(|cell| cell[..n] == so_far[..n]) {
            mask.allow(u32::from(cell[n]));
        }
    }

    /// Takes the next token.
    ///
    /// # Errors
    /// [`GrammarFault::Forbidden`]; the grammar stands as before.
    pub fn advance(&mut self, id: u32) -> Result<(), GrammarFault> {
        let mut mask = Mask::none(self.vocabulary.len());
        self.allowed(&mut mask);
        if !mask.allows(id) {
            return Err(GrammarFault::Forbidden { at: self.tokens, word: self.vocabulary.word(id) });
        }
        self.accept(id);
        Ok(())
    }

    /// Takes a token that [`Self::allowed`] has allowed.
    pub fn accept(&mut self, id: u32) {
        self.tokens += 1;
        let meaning = self.vocabulary.meaning(id);
        self.state = match (std::mem::replace(&mut self.state, State::Done), meaning) {
            (State::Start, _) => State::Class,
            (State::Class, meaning) => {
                if let Meaning::Class(class) = meaning {
                    self.parts = self.parts_of(class);
                }
                // With a template of its own, joints follow a part; where springs are told from the
                // start, they follow that token.
                self.free = match self.spring {
                    Spring::AfterParts => self.parts.is_empty() || !self.by_parts,
                    Spring::Never => true,
                    Spring::WithClass => meaning == Meaning::NoClass,
                    Spring::Always => false,
                };
                State::Between
            }
            (State::Between, Meaning::Part(part)) => {
                let at = self.parts.iter().position(|(number, _)| *number == part).unwrap_or(0);
                self.lacking = self.parts.get(at).map_or(0, |(_, part)| part.joints.len());
                // Parts come in the template's order.
                self.parts.drain(..(at + 1).min(self.parts.len()));
                (self.free, self.owing, self.parted) = (false, true, true);
                State::Between
            }
            (State::Between, Meaning::Spring) => {
                (self.free, self.owing) = (true, true);
                self.parts.clear();
                self.parted = true;
                State::Between
            }
            (State::Between, Meaning::Branch) => State::Parent([0; 2], 0),
            (State::Between, Meaning::Cell(x)) => State::Point([x, 0], 1),
            (State::Parent(mut so_far, n), Meaning::Cell(x)) => match n {
                2 => State::Point([0; 2], 0),
                n => {
                    so_far[usize::from(n)] = x;
                    State::Parent(so_far, n + 1)
                }
            },
            (State::Point(mut so_far, n), Meaning::Cell(x)) => match n {
                2 => {
                    self.cells.push([so_far[0], so_far[1], x]);
                    if self.free {
                        self.parts.clear();
                    }
                    self.lacking = self.lacking.saturating_sub(1);
                    // Without a token for them, other joints follow a part at once.
                    if self.lacking == 0 && self.spring == Spring::Never {
                        self.free = true;
                    }
                    self.owing = false;
                    State::Between
                }
                n => {
                    so_far[usize::from(n)] = x;
                    State::Point(so_far, n + 1)
                }
            },
            // The end, and what is not allowed.
            _ => State::Done,
        };
    }
}
