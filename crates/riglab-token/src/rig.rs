//! What may follow in a sequence that goes on after the skeleton with its bones' skin codes (SkinTokens 3.3).

use std::ops::Range;

use crate::{Grammar, Mask, Walk};

/// A grammar of skeletons, as far as that of whole rigs needs it.
pub trait SkeletonGrammar: Clone {
    /// Writes which ids may follow.
    fn allowed(&self, mask: &mut Mask);

    /// Takes the next token.
    fn accept(&mut self, id: u32);

    /// Joints so far.
    fn joints(&self) -> usize;
}

impl SkeletonGrammar for Grammar {
    fn allowed(&self, mask: &mut Mask) {
        self.allowed(mask);
    }

    fn accept(&mut self, id: u32) {
        self.accept(id);
    }

    fn joints(&self) -> usize {
        self.joints()
    }
}

impl SkeletonGrammar for Walk {
    fn allowed(&self, mask: &mut Mask) {
        self.allowed(mask);
    }

    fn accept(&mut self, id: u32) {
        // Only the very first token can be refused; the skeleton then has no joints.
        let _ = self.advance(id);
    }

    fn joints(&self) -> usize {
        self.joints()
    }
}

/// The ids that skin codes are written with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkinIds {
    /// The parts of a code, one after another: one id of each range. A single range where a code is one id.
    pub parts: Vec<Range<u32>>,
    /// The end of the whole.
    pub end: u32,
    /// In place of a bone's codes, where it moves nothing; `None` where every bone has codes.
    pub empty: Option<u32>,
    /// Codes of a bone.
    pub codes: usize,
    /// All ids, those of the skeleton with them.
    pub len: usize,
}

/// Which rule ends the skin part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SkinRule {
    /// Exactly as many codes as the joints have, then the end.
    #[default]
    Exact,
    /// As released: one code too few, and any id from the skeleton's end on in place of a code.
    Released,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Skeleton,
    /// Bones left, codes of this one so far, parts of this code so far.
    Skin(usize, usize, usize),
    /// Released: tokens since the skeleton's end, of how many.
    Loose(usize, usize),
    Done,
}

/// The grammar of a skeleton and its skin codes, as it stands after some tokens.
#[derive(Clone, Debug)]
pub struct RigGrammar<G> {
    skeleton: G,
    skeleton_end: u32,
    ids: SkinIds,
    rule: SkinRule,
    state: State,
}

impl<G: SkeletonGrammar> RigGrammar<G> {
    /// After what `skeleton` has taken, which is no whole skeleton yet; `skeleton_end` ends it.
    pub fn new(skeleton: G, skeleton_end: u32, ids: SkinIds, rule: SkinRule) -> Self {
        Self { skeleton, skeleton_end, ids, rule, state: State::Skeleton }
    }

    /// Ids in all.
    pub fn len(&self) -> usize {
        self.ids.len
    }

    /// There always are ids.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Whether the end has come.
    pub fn is_done(&self) -> bool {
        self.state == State::Done
    }

    /// Writes which ids may follow, into a mask of [`Self::len`]; none after the end.
    pub fn allowed(&self, mask: &mut Mask) {
        mask.clear();
        match self.state {
            State::Skeleton => self.skeleton.allowed(mask),
            State::Skin(0, ..) => mask.allow(self.ids.end),
            State::Skin(_, code, part) => {
                mask.allow_all(self.ids.parts[part].clone());
                if let (0, 0, Some(empty)) = (code, part, self.ids.empty) {
                    mask.allow(empty);
                }
            }
            State::Loose(since, all) if since == all => mask.allow(self.ids.end),
            State::Loose(..) => mask.allow_all(self.skeleton_end..self.ids.end),
            State::Done => {}
        }
    }

    /// Takes a token that [`Self::allowed`] has allowed.
    pub fn accept(&mut self, id: u32) {
        self.state = match self.state {
            State::Skeleton if id == self.skeleton_end => {
                let joints = self.skeleton.joints();
                match self.rule {
                    SkinRule::Exact => State::Skin(joints, 0, 0),
                    SkinRule::Released => State::Loose(1, joints * self.ids.codes),
                }
            }
            State::Skeleton => {
                self.skeleton.accept(id);
                State::Skeleton
            }
            // The released rule knows no state after the end.
            State::Loose(since, all) => State::Loose(since + 1, all),
            _ if id == self.ids.end => State::Done,
            State::Skin(bones, ..) if Some(id) == self.ids.empty => State::Skin(bones.saturating_sub(1), 0, 0),
            State::Skin(bones, code, part) if part + 1 < self.ids.parts.len() => State::Skin(bones, code, part + 1),
            State::Skin(bones, code, _) if code + 1 < self.ids.codes => State::Skin(bones, code + 1, 0),
            State::Skin(bones, ..) => State::Skin(bones.saturating_sub(1), 0, 0),
            State::Done => State::Done,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Limits, Parents, Preset, Tokenizer};

    fn ids(parts: Vec<Range<u32>>, codes: usize, empty: bool) -> SkinIds {
        let end = parts.last().unwrap().end;
        SkinIds { len: end as usize + 2, end, empty: empty.then_some(end + 1), parts, codes }
    }

    /// Follows the grammar by choosing with `pick` among what may follow.
    fn drawn(ids: SkinIds, mut pick: impl FnMut(usize) -> usize) -> Vec<u32> {
        let tokenizer = Tokenizer::new(Preset::default().config());
        let limits = Limits { joints: 5, tokens: 60 };
        let grammar = Grammar::new(&tokenizer, limits, Parents::Existing);
        let mut grammar = RigGrammar::new(grammar, tokenizer.vocabulary().eos(), ids, SkinRule::Exact);
        let mut mask = Mask::none(grammar.len());
        let mut out = Vec::new();
        while !grammar.is_done() {
            grammar.allowed(&mut mask);
            let all: Vec<u32> = mask.iter().collect();
            out.push(all[pick(all.len())]);
            grammar.accept(*out.last().unwrap());
        }
        out
    }

    #[test]
    fn every_joint_has_all_its_codes_and_then_comes_the_end() {
        use riglab_random::{Draw, stream};
        let tokenizer = Tokenizer::new(Preset::default().config());
        let first = tokenizer.vocabulary().len() as u32;
        for (codes, empty) in [(&[12][..], false), (&[3, 4], true)] {
            let mut at = first;
            let parts: Vec<Range<u32>> = codes
                .iter()
                .map(|n| {
                    at += n;
                    at - n..at
                })
                .collect();
            let ids = ids(parts.clone(), 2, empty);
            for seed in 0..200 {
                let mut random = stream(seed, "test", &[]);
                let sequence = drawn(ids.clone(), |n| random.below(n));
                let at = sequence.iter().position(|&id| id == tokenizer.vocabulary().eos()).unwrap();
                let joints = tokenizer.decode(&sequence[..=at]).unwrap().joints.len();
                let skin = &sequence[at + 1..];
                assert_eq!(skin.last(), Some(&ids.end));
                let empties = skin.iter().filter(|id| Some(**id) == ids.empty).count();
                assert_eq!(skin.len() - 1, (joints - empties) * 2 * parts.len() + empties);
            }
        }
    }
}
