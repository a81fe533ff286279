//! A rig to be scored, as a model gives it: weights need not sum to 1.

use riglab_core::{Rig, SkinWeights};

/// Why parts do not make a candidate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CandidateError {
    /// A skeleton needs a joint.
    NoJoints,
    /// One parent or none a joint, parents before children, all finite.
    Tree(usize),
    /// A row of weights names a joint that does not exist, or has a weight that is negative or no number.
    Weights(usize),
}

impl std::fmt::Display for CandidateError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoJoints => write!(f, "the candidate has no joints"),
            Self::Tree(joint) => {
                write!(f, "joint {joint} of the candidate is not finite, or its parent does not come before it")
            }
            Self::Weights(vertex) => {
                write!(
                    f,
                    "vertex {vertex} of the candidate has a negative weight, or one on a joint that does not exist"
                )
            }
        }
    }
}

impl std::error::Error for CandidateError {}

/// Weights by vertex as predicted: in [0, 1] or so, rows of any sum. Zeros are not kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawWeights {
    offsets: Vec<u32>,
    joints: Vec<u16>,
    weights: Vec<f64>,
}

impl RawWeights {
    /// From (joint, weight) pairs by vertex.
    pub fn new<R: IntoIterator<Item = (u16, f64)>>(rows: impl IntoIterator<Item = R>) -> Self {
        let mut out = Self { offsets: vec![0], ..Self::default() };
        for row in rows {
            for (joint, weight) in row {
                if weight != 0.0 {
                    out.joints.push(joint);
                    out.weights.push(weight);
                }
            }
            out.offsets.push(out.joints.len() as u32);
        }
        out
    }

    /// From a table, a row of `joints` weights a vertex.
    pub fn dense(table: &[f32], joints: usize) -> Self {
        let row = |row: &[f32]| row.iter().enumerate().map(|(j, w)| (j as u16, f64::from(*w))).collect::<Vec<_>>();
        Self::new(table.chunks_exact(joints.max(1)).map(row))
    }

    /// Those of a sound rig.
    pub fn of(weights: &SkinWeights) -> Self {
        Self {
            offsets: weights.offsets().to_vec(),
            joints: weights.joints().to_vec(),
            weights: weights.weights().iter().map(|w| f64::from(*w)).collect(),
        }
    }

    /// How many vertices.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Joints and weights of a vertex.
    #[inline]
    pub fn row(&self, vertex: usize) -> (&[u16], &[f64]) {
        let span = self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize;
        (&self.joints[span.clone()], &self.weights[span])
    }
}

/// A skeleton with weights for some mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    heads: Vec<[f64; 3]>,
    parents: Vec<Option<usize>>,
    weights: RawWeights,
}

impl Candidate {
    /// Checks joints, tree and weights. Several roots are allowed.
    ///
    /// # Errors
    /// The first fault: a model's output that does not make a candidate is worth 0.
    pub fn new(heads: Vec<[f64; 3]>, parents: Vec<Option<usize>>, weights: RawWeights) -> Result<Self, CandidateError> {
        if heads.is_empty() || heads.len() != parents.len() {
            return Err(CandidateError::NoJoints);
        }
        let sound = |j: usize| heads[j].iter().all(|x| x.is_finite()) && parents[j].is_none_or(|p| p < j);
        if let Some(joint) = (0..heads.len()).find(|j| !sound(*j)) {
            return Err(CandidateError::Tree(joint));
        }
        let good = |v: &usize| {
            let (joints, values) = weights.row(*v);
            joints.iter().all(|j| usize::from(*j) < heads.len()) && values.iter().all(|w| w.is_finite() && *w >= 0.0)
        };
        if let Some(vertex) = (0..weights.rows()).find(|v| !good(v)) {
            return Err(CandidateError::Weights(vertex));
        }
        Ok(Self { heads, parents, weights })
    }

    /// Joints alone: what is about weights is not judged.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn skeleton(heads: Vec<[f64; 3]>, parents: Vec<Option<usize>>) -> Result<Self, CandidateError> {
        Self::new(heads, parents, RawWeights::new(std::iter::empty::<[(u16, f64); 0]>()))
    }

    /// A sound rig as a candidate.
    pub fn of(rig: &Rig) -> Self {
        Self {
            heads: rig.skeleton().heads().iter().map(|p| p.map(f64::from)).collect(),
            parents: rig.skeleton().parents().iter().map(|p| p.map(riglab_core::JointId::index)).collect(),
            weights: RawWeights::of(rig.weights()),
        }
    }

    /// Joints, in the mesh's units.
    pub fn heads(&self) -> &[[f64; 3]] {
        &self.heads
    }

    /// Parents by joint.
    pub fn parents(&self) -> &[Option<usize>] {
        &self.parents
    }

    /// The weights; without rows where there are joints alone.
    pub fn weights(&self) -> &RawWeights {
        &self.weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_has_its_error() {
        let new = |heads: &[[f64; 3]], parents: &[Option<usize>], w: f64| {
            Candidate::new(heads.to_vec(), parents.to_vec(), RawWeights::new([[(1, w)]])).unwrap_err()
        };
        assert_eq!(new(&[], &[], 1.0), CandidateError::NoJoints);
        assert_eq!(new(&[[0.0; 3]; 2], &[None, Some(1)], 1.0), CandidateError::Tree(1));
        assert_eq!(new(&[[f64::NAN; 3]], &[None], 1.0), CandidateError::Tree(0));
        assert_eq!(new(&[[0.0; 3]], &[None], 1.0), CandidateError::Weights(0));
        assert_eq!(new(&[[0.0; 3]; 2], &[None, Some(0)], f64::NAN), CandidateError::Weights(0));
        assert_eq!(RawWeights::dense(&[0.0, 0.5, 1.0, 0.0], 2).row(1), (&[0][..], &[1.0][..]));
    }
}
