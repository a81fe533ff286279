//! Sequences of several lengths one after another, without padding.

use tch::Tensor;

/// Where each sequence lies among the rows of a packed tensor [T, d].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packed {
    lengths: Vec<i64>,
}

impl Packed {
    /// Of these lengths.
    pub fn new(lengths: Vec<i64>) -> Self {
        Self { lengths }
    }

    /// The lengths.
    pub fn lengths(&self) -> &[i64] {
        &self.lengths
    }

    /// Rows in all.
    pub fn rows(&self) -> i64 {
        self.lengths.iter().sum()
    }

    /// The place of every row in its sequence, [T].
    pub fn places(&self) -> Vec<i64> {
        self.lengths.iter().flat_map(|&n| 0..n).collect()
    }

    /// x [T, ..] apart by sequence.
    pub fn apart(&self, x: &Tensor) -> Vec<Tensor> {
        x.split_with_sizes(&self.lengths, 0)
    }
}
