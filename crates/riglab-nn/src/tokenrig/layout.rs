//! Which number means what, in the sequences of TokenRig.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// How skin codes are scored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Head {
    /// One softmax over all tokens and codes (the paper's).
    #[default]
    Flat,
    /// A small softmax for each FSQ level, each given the levels before it (an extension): a codebook of
    /// thousands is learnt from few rigs, and costs a fraction.
    Levels,
}

/// Ids of a sequence: those of the skeleton, then one for each skin code, then the end; after it, where bones
/// may be empty, the id that stands for all codes of a bone that moves nothing (an extension).
///
/// Tokens are *drawn* by numbers of their own ([`Self::ranges`]): with [`Head::Levels`] a code is drawn level by
/// level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    skeleton: i64,
    levels: Vec<i64>,
    head: Head,
    bins: i64,
}

impl Layout {
    /// Of so many ids of the skeleton, and a codebook of these levels, the first counting fastest.
    pub fn new(skeleton: usize, levels: &[i64], head: Head) -> Self {
        Self { skeleton: skeleton as i64, levels: levels.to_vec(), head, bins: 0 }
    }

    /// The first so many ids of the skeleton are cells along an axis, from -1 to 1.
    pub fn with_bins(self, bins: i64) -> Self {
        Self { bins, ..self }
    }

    /// Ids that are cells along an axis.
    pub fn bins(&self) -> i64 {
        self.bins
    }

    /// Ids of the skeleton.
    pub fn skeleton(&self) -> i64 {
        self.skeleton
    }

    /// Levels of a code's axes.
    pub fn levels(&self) -> &[i64] {
        &self.levels
    }

    /// How codes are scored.
    pub fn head(&self) -> Head {
        self.head
    }

    /// How many of the `ids` that follow a skeleton, end and all, are scored.
    pub fn scored(&self, ids: usize) -> usize {
        match self.head {
            Head::Flat => ids,
            // The end follows by the grammar alone.
            Head::Levels => ids.saturating_sub(1),
        }
    }

    /// Codes.
    pub fn codes(&self) -> i64 {
        self.levels.iter().product()
    }

    /// The levels of a code, each from -1 to 1.
    pub fn levels_of(&self, code: i64) -> impl Iterator<Item = f32> {
        let mut left = code;
        self.levels.iter().map(move |&levels| {
            let level = left.rem_euclid(levels);
            left = left.div_euclid(levels);
            2.0 * level as f32 / (levels - 1).max(1) as f32 - 1.0
        })
    }

    /// The id of a code.
    pub fn code(&self, code: i64) -> i64 {
        self.skeleton + code
    }

    /// The id of the end.
    pub fn end(&self) -> i64 {
        self.skeleton + self.codes()
    }

    /// The id of a bone that moves nothing.
    pub fn empty(&self) -> i64 {
        self.end() + 1
    }

    /// Where in a list of all levels' tables each begins, and how many there are in all.
    pub(crate) fn offsets(&self) -> (Vec<i64>, i64) {
        let mut sum = 0;
        let each = self.levels.iter().map(|l| {
            sum += l;
            sum - l
        });
        (each.collect(), sum)
    }

    /// The drawn numbers of a code, one range after another.
    pub fn ranges(&self) -> Vec<Range<u32>> {
        let first = self.skeleton as u32;
        match self.head {
            Head::Flat => std::iter::once(first..first + self.codes() as u32).collect(),
            Head::Levels => {
                let each = self.offsets().0.into_iter().zip(&self.levels);
                each.map(|(at, l)| first + at as u32..first + (at + l) as u32).collect()
            }
        }
    }

    /// The drawn number of the end.
    pub fn drawn_end(&self) -> u32 {
        self.ranges().last().map_or(self.skeleton as u32, |r| r.end)
    }

    /// The drawn number of a bone that moves nothing.
    pub fn drawn_empty(&self) -> u32 {
        self.drawn_end() + 1
    }

    /// How many drawn numbers there are.
    pub fn drawn(&self) -> usize {
        self.drawn_empty() as usize + 1
    }

    /// Drawn numbers as ids; `None` where a code is not whole, or its levels are out of turn.
    pub fn ids(&self, drawn: &[u32]) -> Option<Vec<i64>> {
        let ranges = self.ranges();
        let mut out = Vec::with_capacity(drawn.len());
        let mut left = drawn;
        while let Some((&first, rest)) = left.split_first() {
            left = rest;
            out.push(if i64::from(first) < self.skeleton {
                i64::from(first)
            } else if first == self.drawn_end() {
                self.end()
            } else if first == self.drawn_empty() {
                self.empty()
            } else {
                let (more, rest) = left.split_at_checked(ranges.len() - 1)?;
                left = rest;
                let (mut code, mut basis) = (0, 1);
                for (&number, range) in std::iter::once(&first).chain(more).zip(&ranges) {
                    if !range.contains(&number) {
                        return None;
                    }
                    code += i64::from(number - range.start) * basis;
                    basis *= i64::from(range.end - range.start);
                }
                self.code(code)
            });
        }
        Some(out)
    }

    /// Ids as they are drawn.
    pub fn drawn_of(&self, ids: &[i64]) -> Vec<u32> {
        let ranges = self.ranges();
        let mut out = Vec::with_capacity(ids.len());
        for &id in ids {
            match id {
                id if id < self.skeleton => out.push(id as u32),
                id if id == self.end() => out.push(self.drawn_end()),
                id if id == self.empty() => out.push(self.drawn_empty()),
                id => {
                    let mut code = id - self.skeleton;
                    for range in &ranges {
                        let levels = i64::from(range.end - range.start);
                        out.push(range.start + (code % levels) as u32);
                        code /= levels;
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_come_back_from_what_is_drawn() {
        for head in [Head::Flat, Head::Levels] {
            let layout = Layout::new(267, &[3, 4], head);
            let ids: Vec<i64> = [5, 258]
                .into_iter()
                .chain((0..12).map(|c| layout.code(c)))
                .chain([layout.empty(), layout.end()])
                .collect();
            let drawn = layout.drawn_of(&ids);
            assert!(drawn.iter().all(|&n| (n as usize) < layout.drawn()));
            assert_eq!(layout.ids(&drawn).unwrap(), ids);
        }
    }

    #[test]
    fn half_a_code_is_none() {
        let layout = Layout::new(10, &[3, 4], Head::Levels);
        assert_eq!(layout.ranges(), [10..13, 13..17]);
        assert_eq!((layout.drawn_end(), layout.drawn()), (17, 19));
        assert_eq!(layout.ids(&[10]), None);
        assert_eq!(layout.ids(&[10, 11]), None);
        assert_eq!(layout.ids(&[11, 14]), Some(vec![10 + 1 + 3]));
    }

    #[test]
    fn the_flat_layout_is_the_released_one() {
        let layout = Layout::new(267, &[8, 8, 8, 8, 8], Head::Flat);
        assert_eq!((layout.code(0), layout.end()), (267, 33035));
    }
}
