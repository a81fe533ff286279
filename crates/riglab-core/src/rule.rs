//! From raw predictions to weights.

use crate::{JointId, RigError, SkinWeights};

/// How a vertex' raw shares, one a joint and each on its own in [0, 1], become weights: the largest
/// few are kept, those below a cut dropped, and the rest divided by their sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecodeRule {
    /// Shares at or below this are dropped.
    pub cut: f32,
    /// At most this many are kept; glTF's usual limit is 4.
    pub influences: usize,
}

impl Default for DecodeRule {
    fn default() -> Self {
        Self { cut: 0.01, influences: 4 }
    }
}

impl DecodeRule {
    /// Applies the rule to one vertex in place. A row left empty keeps its largest share, one
    /// without any, or with what is no finite share, becomes 0.
    pub fn apply(&self, row: &mut [f32]) {
        let Some(largest) = (0..row.len()).rev().max_by(|&a, &b| row[a].total_cmp(&row[b])) else { return };
        if row[largest] <= 0.0 || !row[largest].is_finite() {
            row.fill(0.0);
            return;
        }
        let floor = self.floor(row);
        // Those above the floor have their places; of equal shares at it the first joints take what places are left.
        let above = (0..row.len()).filter(|&i| i == largest || row[i] > floor).count();
        let mut room = self.influences.max(1).saturating_sub(above);
        for (i, w) in row.iter_mut().enumerate() {
            if i == largest {
                continue;
            }
            let at_floor = *w == floor && room > 0;
            room -= usize::from(at_floor);
            if *w <= self.cut || !(*w > floor || at_floor) {
                *w = 0.0;
            }
        }
        let sum: f32 = row.iter().sum();
        row.iter_mut().for_each(|w| *w /= sum);
    }

    /// The share of the last influence that the limit allows.
    fn floor(&self, row: &[f32]) -> f32 {
        if row.len() <= self.influences {
            return f32::NEG_INFINITY;
        }
        let mut top = vec![f32::NEG_INFINITY; self.influences.max(1)];
        for &w in row {
            if w > top[top.len() - 1] {
                let at = top.partition_point(|&t| t >= w);
                top.insert(at, w);
                top.pop();
            }
        }
        top[top.len() - 1]
    }

    /// Weights of a rig from raw shares, a row of `joints.len()` a vertex; column k is that of
    /// `joints[k]`. A vertex without any share is given to `joints[0]`.
    ///
    /// # Errors
    /// As [`SkinWeights::normalized`].
    pub fn weights(&self, raw: &[f32], joints: &[JointId]) -> Result<SkinWeights, RigError> {
        let rows = raw.chunks_exact(joints.len()).map(|raw| {
            let mut row = raw.to_vec();
            self.apply(&mut row);
            if row.iter().all(|&w| w == 0.0) {
                row[0] = 1.0;
            }
            row.into_iter().zip(joints).map(|(w, j)| (j.0, f64::from(w))).collect::<Vec<_>>()
        });
        SkinWeights::normalized(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied(cut: f32, influences: usize, row: &[f32]) -> Vec<f32> {
        let mut row = row.to_vec();
        DecodeRule { cut, influences }.apply(&mut row);
        row
    }

    #[test]
    fn keeps_the_largest_above_the_cut_and_divides_by_their_sum() {
        assert_eq!(applied(0.1, 4, &[0.5, 0.05, 0.25, 0.25]), [0.5, 0.0, 0.25, 0.25]);
        assert_eq!(applied(0.0, 2, &[0.1, 0.6, 0.2, 0.1]), [0.0, 0.75, 0.25, 0.0]);
        // Equal shares: never more than the limit.
        assert_eq!(applied(0.0, 2, &[0.5, 0.5, 0.5]), [0.5, 0.5, 0.0]);
        // Nor do those at the limit take the place of a larger one that stands behind them.
        assert_eq!(applied(0.0, 3, &[0.125, 0.125, 0.125, 0.5, 0.25]), [1.0 / 7.0, 0.0, 0.0, 4.0 / 7.0, 2.0 / 7.0]);
        assert_eq!(applied(0.0, 4, &[0.125, 0.125, 0.125, 0.25, 0.5]), [0.125, 0.125, 0.0, 0.25, 0.5]);
        assert_eq!(applied(0.2, 3, &[0.125, 0.125, 0.125, 0.25, 0.75]), [0.0, 0.0, 0.0, 0.25, 0.75]);
        assert_eq!(applied(0.9, 4, &[0.2, 0.3]), [0.0, 1.0]);
        assert_eq!(applied(0.0, 4, &[0.0, 0.0]), [0.0, 0.0]);
        assert_eq!(applied(0.0, 4, &[f32::NAN, 0.5]), [0.0, 0.0]);
    }

    #[test]
    fn every_vertex_gets_weights() {
        let w = DecodeRule::default().weights(&[0.0, 0.0, 0.3, 0.3], &[JointId(2), JointId(5)]).unwrap();
        assert_eq!(w.row(0).collect::<Vec<_>>(), [(JointId(2), 1.0)]);
        assert_eq!(w.row(1).collect::<Vec<_>>(), [(JointId(2), 0.5), (JointId(5), 0.5)]);
    }
}
