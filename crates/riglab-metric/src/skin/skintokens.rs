//! Skin weights against the true ones, convention `skintokens`.
//!
//! w true, ŵ predicted, over all N·J entries of an asset; A = (w > 0.01), B = (ŵ > 0.01):
//!
//! ```text
//! l1, l1_var         mean and population variance of |w - ŵ| over the entries
//! precision, recall  ΣAB / ΣB, ΣAB / ΣA
//! iou                ΣAB / Σ(A or B), summed over vertices and bones (micro)
//! mask_cover_bone    share of bones with any A whose A lies inside B ("Mask accuracy")
//! mask_cover_vertex  the same by vertices
//! mask_entry         share of entries with |w - ŵ| < 0.01
//! ```

use serde::{Deserialize, Deserializer, Serialize};

use crate::Rows;
use crate::rows::both;

/// Weights above this are active (SkinTokens 4.2.1).
pub const ACTIVE: f32 = 0.01;
/// Entries closer than this count for `mask_entry`.
const CLOSE: f64 = 0.01;

/// The metrics of one asset, or of several pooled.
///
/// A ratio over nothing is NaN; JSON has it as null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)] // see the module's formulas
pub struct SkinMetrics {
    #[serde(deserialize_with = "nan_for_null")]
    pub l1: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub l1_var: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub precision: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub recall: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub iou: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub mask_cover_bone: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub mask_cover_vertex: f64,
    #[serde(deserialize_with = "nan_for_null")]
    pub mask_entry: f64,
}

/// Reads a number that JSON could not hold, which it wrote as null.
///
/// # Errors
/// When there is neither.
pub fn nan_for_null<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::NAN))
}

impl SkinMetrics {
    /// Names and values, in the order of the convention's columns.
    pub fn columns(&self) -> [(&'static str, f64); 8] {
        [
            ("l1", self.l1),
            ("l1_var", self.l1_var),
            ("precision", self.precision),
            ("recall", self.recall),
            ("iou", self.iou),
            ("mask_cover_bone", self.mask_cover_bone),
            ("mask_cover_vertex", self.mask_cover_vertex),
            ("mask_entry", self.mask_entry),
        ]
    }
}

/// Sums from which the metrics follow; sums of assets add up to the pooled ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SkinTally {
    entries: u64,
    abs: f64,
    abs2: f64,
    close: u64,
    both: u64,
    predicted: u64,
    truth: u64,
    bones: [u64; 2],
    vertices: [u64; 2],
}

impl SkinTally {
    /// One asset: dense rows of `joints` shares a vertex.
    pub fn of(truth: &[f32], predicted: &[f32], joints: usize) -> Self {
        Self::of_rows(&Rows::dense(truth, joints), &Rows::dense(predicted, joints))
    }

    /// One asset: as many rows of as many bones on both sides.
    pub fn of_rows(truth: &Rows, predicted: &Rows) -> Self {
        let size = truth.size() as u64;
        let (mut t, mut stored) = (Self { entries: size, ..Self::default() }, 0);
        // For each bone: whether it has an active entry, and whether one of them was missed.
        let (mut any, mut missed) = (vec![false; truth.columns()], vec![false; truth.columns()]);
        for (w, p) in truth.iter().zip(predicted.iter()) {
            let (mut any_here, mut missed_here) = (false, false);
            both(w, p, |j, w, p| {
                stored += 1;
                let d = (f64::from(w) - f64::from(p)).abs();
                t.abs += d;
                t.abs2 += d * d;
                t.close += u64::from(d < CLOSE);
                let (a, b) = (w > ACTIVE, p > ACTIVE);
                t.both += u64::from(a && b);
                t.predicted += u64::from(b);
                t.truth += u64::from(a);
                any_here |= a;
                missed_here |= a && !b;
                any[j] |= a;
                missed[j] |= a && !b;
            });
            t.vertices[0] += u64::from(any_here);
            t.vertices[1] += u64::from(any_here && !missed_here);
        }
        // Entries that are 0 on both sides.
        t.close += size - stored;
        for (any, missed) in any.into_iter().zip(missed) {
            t.bones[0] += u64::from(any);
            t.bones[1] += u64::from(any && !missed);
        }
        t
    }

    /// Adds another asset's sums.
    pub fn add(&mut self, other: &Self) {
        self.entries += other.entries;
        self.abs += other.abs;
        self.abs2 += other.abs2;
        self.close += other.close;
        self.both += other.both;
        self.predicted += other.predicted;
        self.truth += other.truth;
        for k in 0..2 {
            self.bones[k] += other.bones[k];
            self.vertices[k] += other.vertices[k];
        }
    }

    /// True positives, predicted active, truly active, and their union.
    pub fn counts(&self) -> [u64; 4] {
        [self.both, self.predicted, self.truth, self.predicted + self.truth - self.both]
    }

    /// The metrics of what was added up.
    pub fn metrics(&self) -> SkinMetrics {
        let share = |a: u64, b: u64| if b == 0 { f64::NAN } else { a as f64 / b as f64 };
        let n = self.entries as f64;
        let l1 = self.abs / n;
        let [both, predicted, truth, union] = self.counts();
        SkinMetrics {
            l1,
            l1_var: (self.abs2 / n - l1 * l1).max(0.0),
            precision: share(both, predicted),
            recall: share(both, truth),
            iou: share(both, union),
            mask_cover_bone: share(self.bones[1], self.bones[0]),
            mask_cover_vertex: share(self.vertices[1], self.vertices[0]),
            mask_entry: share(self.close, self.entries),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_case_by_hand() {
        // Two vertices, two bones.
        let t = SkinTally::of(&[1.0, 0.0, 0.5, 0.5], &[0.9, 0.1, 0.5, 0.0], 2);
        let m = t.metrics();
        assert_eq!(t.counts(), [2, 3, 3, 4]);
        assert_eq!((m.iou, m.mask_cover_bone, m.mask_cover_vertex, m.mask_entry), (0.5, 0.5, 0.5, 0.25));
        assert!((m.l1 - 0.175).abs() < 1e-7);
    }

    #[test]
    fn nothing_active_is_undefined_not_zero() {
        let m = SkinTally::of(&[0.0], &[0.0], 1).metrics();
        assert!(m.iou.is_nan() && m.precision.is_nan() && m.recall.is_nan() && m.l1 == 0.0);
    }

    #[test]
    fn pooled_sums_weigh_assets_by_size() {
        let mut t = SkinTally::of(&[1.0], &[0.0], 1);
        t.add(&SkinTally::of(&[1.0, 1.0, 1.0], &[1.0, 1.0, 1.0], 1));
        assert_eq!((t.metrics().iou, t.metrics().l1), (0.75, 0.25));
    }
}
