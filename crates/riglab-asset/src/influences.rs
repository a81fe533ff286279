//! Joints and weights of vertices while they are read, and the repair of weights. The same for all formats
//! that give weights by vertex.

use riglab_core::{RigError, SkinWeights};

use crate::Warning;

/// How far a sum of weights may be from 1 without a word: bytes come to 2/255.
const SUM_SLACK: f64 = 0.01;

/// The influences on some vertices, row by row. "Slots" are what the reader numbers its joints by.
pub(crate) struct Rows {
    /// Where each row starts; one more than rows.
    offsets: Vec<usize>,
    /// Slots with weights above 0, not normalised; at least one a row.
    pairs: Vec<(u16, f64)>,
    /// Rows without weight in the file. They have weight 1 on their first slot.
    unweighted: Vec<u32>,
    /// The open row names a slot twice.
    duplicate: bool,
    /// The open row has a weight below 0.
    negative: bool,
}

/// What was mended, in vertices.
#[derive(Clone, Debug, Default)]
pub(crate) struct Repairs {
    unweighted: usize,
    not_normalised: usize,
    /// Smallest and largest of their sums.
    sums: Option<(f64, f64)>,
    negative: usize,
    duplicate: usize,
    /// Vertices with joints out of range, but without weight; counted by the reader, who knows the range.
    pub(crate) unused_index: usize,
}

impl Repairs {
    /// Of other vertices, too.
    pub(crate) fn add(&mut self, other: &Self) {
        self.unweighted += other.unweighted;
        self.not_normalised += other.not_normalised;
        self.negative += other.negative;
        self.duplicate += other.duplicate;
        self.unused_index += other.unused_index;
        let both = |(a, b): (f64, f64), (c, d): (f64, f64)| (a.min(c), b.max(d));
        self.sums = match (self.sums, other.sums) {
            (Some(own), Some(others)) => Some(both(own, others)),
            (own, others) => own.or(others),
        };
    }

    pub(crate) fn warn(&self, warnings: &mut Vec<Warning>) {
        let Self { unweighted, not_normalised, sums, negative, duplicate, unused_index } = *self;
        let found = [
            (negative, Warning::NegativeWeights { vertices: negative }),
            (duplicate, Warning::DuplicateInfluences { vertices: duplicate }),
            (unused_index, Warning::UnusedJointIndex { vertices: unused_index }),
            (not_normalised, Warning::NotNormalised { vertices: not_normalised, sums: sums.unwrap_or_default() }),
            (unweighted, Warning::Unweighted { vertices: unweighted }),
        ];
        warnings.extend(found.into_iter().filter(|(vertices, _)| *vertices > 0).map(|(_, warning)| warning));
    }
}

impl Rows {
    /// No rows yet, with room for some.
    pub(crate) fn with_capacity(rows: usize) -> Self {
        Self {
            offsets: vec![0],
            pairs: Vec::with_capacity(rows * 2),
            unweighted: Vec::new(),
            duplicate: false,
            negative: false,
        }
    }

    /// Adds an influence to the row that is open. Weights are finite; those below 0 count as 0.
    pub(crate) fn push(&mut self, slot: u16, weight: f64) {
        self.negative |= weight < 0.0;
        if weight > 0.0 {
            let start = self.offsets[self.offsets.len() - 1];
            self.duplicate |= self.pairs[start..].iter().any(|(s, _)| *s == slot);
            self.pairs.push((slot, weight));
        }
    }

    /// Ends the row; if it has no weight, it gets 1 on the slot `first`.
    pub(crate) fn end(&mut self, first: u16, repairs: &mut Repairs) {
        let start = self.offsets[self.offsets.len() - 1];
        repairs.negative += usize::from(std::mem::take(&mut self.negative));
        repairs.duplicate += usize::from(std::mem::take(&mut self.duplicate));
        let sum: f64 = self.pairs[start..].iter().map(|(_, w)| w).sum();
        if self.pairs.len() == start {
            self.unweighted.push(self.offsets.len() as u32 - 1);
            self.pairs.push((first, 1.0));
            repairs.unweighted += 1;
        } else if (sum - 1.0).abs() > SUM_SLACK {
            repairs.not_normalised += 1;
            let (low, high) = repairs.sums.unwrap_or((sum, sum));
            repairs.sums = Some((low.min(sum), high.max(sum)));
        }
        self.offsets.push(self.pairs.len());
    }

    /// Slots and weights of a row.
    pub(crate) fn row(&self, row: usize) -> &[(u16, f64)] {
        &self.pairs[self.offsets[row]..self.offsets[row + 1]]
    }

    /// The rows by joint of the reading, normalised, and those without weight in the file.
    pub(crate) fn into_weights(self, joint: impl Fn(u16) -> u16) -> Result<(SkinWeights, Vec<u32>), RigError> {
        let joint = &joint;
        let rows = (0..self.offsets.len() - 1)
            .map(|row| self.row(row).iter().map(move |&(slot, weight)| (joint(slot), weight)));
        let weights = SkinWeights::normalized(rows)?;
        Ok((weights, self.unweighted))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_mended_is_counted_by_vertex() {
        let mut rows = Rows::with_capacity(4);
        let mut repairs = Repairs::default();
        for row in [&[(0, 0.5), (1, 0.5)][..], &[(1, 1.0), (1, 1.0)], &[], &[(2, -1.0), (0, 1.0)]] {
            for &(slot, weight) in row {
                rows.push(slot, weight);
            }
            rows.end(1, &mut repairs);
        }
        assert_eq!(rows.row(3), [(0, 1.0)]);
        let mut warnings = Vec::new();
        repairs.warn(&mut warnings);
        assert_eq!(
            warnings,
            [
                Warning::NegativeWeights { vertices: 1 },
                Warning::DuplicateInfluences { vertices: 1 },
                Warning::NotNormalised { vertices: 1, sums: (2.0, 2.0) },
                Warning::Unweighted { vertices: 1 },
            ]
        );
        let (weights, unweighted) = rows.into_weights(|slot| 10 + slot).unwrap();
        assert_eq!(unweighted, [2]);
        assert_eq!(weights.row(1).map(|(j, w)| (j.index(), w)).collect::<Vec<_>>(), [(11, 1.0)]);
    }
}
