//! Skinning weights, sparse by vertex.

use crate::{JointId, RigError};

/// How far the weights of a vertex may be from a sum of 1: what normalised 16-bit weights and their
/// f32 sums come to, with room.
pub const SUM_TOLERANCE: f32 = 1e-4;

/// The share of each joint in each vertex; zeros are not stored.
///
/// Row `v` holds the joints `joints[offsets[v]..offsets[v + 1]]`, rising, with their weights.
#[derive(Clone, Debug, PartialEq)]
pub struct SkinWeights {
    offsets: Vec<u32>,
    joints: Vec<u16>,
    weights: Vec<f32>,
}

impl SkinWeights {
    /// Checks compressed rows.
    ///
    /// # Errors
    /// The first violation of the crate's invariants, with its vertex. That joints exist is checked
    /// where the skeleton is known, by `Rig::new`.
    pub fn new(offsets: Vec<u32>, joints: Vec<u16>, weights: Vec<f32>) -> Result<Self, RigError> {
        let ends = offsets.first() == Some(&0) && offsets.last() == Some(&(joints.len() as u32));
        if !ends || joints.len() != weights.len() || offsets.windows(2).any(|w| w[0] > w[1]) {
            return Err(RigError::BadOffsets(joints.len()));
        }
        for (vertex, span) in offsets.windows(2).enumerate() {
            let span = span[0] as usize..span[1] as usize;
            if let Some(w) = joints[span.clone()].windows(2).find(|w| w[0] >= w[1]) {
                return Err(RigError::JointsNotRising { vertex, joint: w[1] });
            }
            if let Some(&weight) = weights[span.clone()].iter().find(|w| !(w.is_finite() && **w > 0.0)) {
                return Err(RigError::BadWeight { vertex, weight });
            }
            // In double precision: a vertex may have thousands of influences.
            let sum = weights[span].iter().map(|w| f64::from(*w)).sum::<f64>() as f32;
            if (sum - 1.0).abs() > SUM_TOLERANCE {
                return Err(RigError::BadSum { vertex, sum });
            }
        }
        Ok(Self { offsets, joints, weights })
    }

    /// Builds rows from (joint, weight) pairs in any order: repeated joints are added, zeros dropped,
    /// and each row divided by its sum (in f64). This is the normalisation every importer wants.
    ///
    /// # Errors
    /// [`RigError::BadWeight`] for a negative or non-finite weight, [`RigError::BadSum`] for a row
    /// without weight.
    pub fn normalized<R>(rows: impl IntoIterator<Item = R>) -> Result<Self, RigError>
    where
        R: IntoIterator<Item = (u16, f64)>,
    {
        let rows = rows.into_iter();
        let room = rows.size_hint().0;
        let mut offsets = Vec::with_capacity(room + 1);
        offsets.push(0);
        let mut out = Self { offsets, joints: Vec::with_capacity(room), weights: Vec::with_capacity(room) };
        let mut row: Vec<(u16, f64)> = Vec::new();
        for (vertex, pairs) in rows.enumerate() {
            row.clear();
            for (joint, weight) in pairs {
                if !weight.is_finite() || weight < 0.0 {
                    return Err(RigError::BadWeight { vertex, weight: weight as f32 });
                }
                if weight == 0.0 {
                    continue;
                }
                match row.iter_mut().find(|(j, _)| *j == joint) {
                    Some((_, sum)) => *sum += weight,
                    None => row.push((joint, weight)),
                }
            }
            row.sort_unstable_by_key(|(j, _)| *j);
            let sum: f64 = row.iter().map(|(_, w)| w).sum();
            if sum <= 0.0 || !sum.is_finite() {
                return Err(RigError::BadSum { vertex, sum: sum as f32 });
            }
            for &(joint, weight) in &row {
                let weight = (weight / sum) as f32;
                // A share too small for f32 is no share.
                if weight > 0.0 {
                    out.joints.push(joint);
                    out.weights.push(weight);
                }
            }
            out.offsets.push(out.joints.len() as u32);
        }
        Ok(out)
    }

    /// How many vertices.
    pub fn rows(&self) -> usize {
        self.offsets.len() - 1
    }

    /// How many non-zero weights.
    pub fn nonzero(&self) -> usize {
        self.joints.len()
    }

    /// The joints and weights of a vertex, joints rising.
    pub fn row(&self, vertex: usize) -> impl ExactSizeIterator<Item = (JointId, f32)> + '_ {
        let span = self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize;
        self.joints[span.clone()].iter().zip(&self.weights[span]).map(|(&j, &w)| (JointId(j), w))
    }

    /// Where each row starts in [`Self::joints`] and [`Self::weights`]; one more than rows.
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    /// The joints of all rows.
    pub fn joints(&self) -> &[u16] {
        &self.joints
    }

    /// The weights of all rows.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Offsets, joints and weights, as [`Self::new`] takes them.
    pub fn into_parts(self) -> (Vec<u32>, Vec<u16>, Vec<f32>) {
        (self.offsets, self.joints, self.weights)
    }

    /// One list of (vertex, weight) per joint: the same matrix by columns.
    pub fn columns(&self, joints: usize) -> Vec<Vec<(u32, f32)>> {
        let mut columns = vec![Vec::new(); joints];
        for vertex in 0..self.rows() {
            for (joint, weight) in self.row(vertex) {
                columns[joint.index()].push((vertex as u32, weight));
            }
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_normalised_merged_and_sorted() {
        let w = SkinWeights::normalized([vec![(3, 1.0), (1, 2.0), (3, 1.0), (0, 0.0)], vec![(2, 5.0)]]).unwrap();
        assert_eq!(w.row(0).collect::<Vec<_>>(), [(JointId(1), 0.5), (JointId(3), 0.5)]);
        assert_eq!(w.row(1).collect::<Vec<_>>(), [(JointId(2), 1.0)]);
        let again = SkinWeights::new(w.offsets().to_vec(), w.joints().to_vec(), w.weights().to_vec()).unwrap();
        assert_eq!(again, w);
        assert_eq!(w.columns(4), [vec![], vec![(0, 0.5)], vec![(1, 1.0)], vec![(0, 0.5)]]);
    }

    #[test]
    fn each_fault_has_its_error() {
        assert_eq!(SkinWeights::new(vec![0, 2], vec![0], vec![1.0]), Err(RigError::BadOffsets(1)));
        assert_eq!(SkinWeights::new(vec![0, 1], vec![0], vec![0.5]), Err(RigError::BadSum { vertex: 0, sum: 0.5 }));
        assert!(matches!(
            SkinWeights::new(vec![0, 2], vec![1, 1], vec![0.5, 0.5]),
            Err(RigError::JointsNotRising { vertex: 0, joint: 1 })
        ));
        assert!(matches!(SkinWeights::new(vec![0, 1], vec![0], vec![f32::NAN]), Err(RigError::BadWeight { .. })));
        assert!(matches!(SkinWeights::normalized([vec![(0, -1.0)]]), Err(RigError::BadWeight { .. })));
        assert!(matches!(SkinWeights::normalized([vec![(0, 0.0)]]), Err(RigError::BadSum { .. })));
    }
}
