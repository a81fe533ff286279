//! Affine maps from rest to pose, and points that follow them.

use tch::{Kind, Tensor};

use super::{dot, tiny};

/// Added to sums of weights, as in UniRig's public code: what nothing holds goes to the origin.
const EPS: f64 = 1e-8;

/// Affine maps: p goes to A p + b.
#[derive(Debug)]
pub struct Maps {
    /// A [.., 3, 3].
    pub matrix: Tensor,
    /// b [.., 3].
    pub shift: Tensor,
}

impl Maps {
    /// From [.., 3, 4], or [.., 4, 4] whose last row is not looked at; matrices by rows.
    pub fn of(rows: &Tensor) -> Self {
        let top = rows.narrow(-2, 0, 3);
        Self { matrix: top.narrow(-1, 0, 3), shift: top.select(-1, 3) }
    }

    /// As [.., 3, 4].
    pub fn rows(&self) -> Tensor {
        Tensor::cat(&[&self.matrix, &self.shift.unsqueeze(-1)], -1)
    }

    /// Turns [.., j, 3, 3] about heads [j, 3].
    pub fn about(turns: &Tensor, heads: &Tensor) -> Self {
        Self { matrix: turns.shallow_clone(), shift: heads - turned(turns, heads) }
    }

    /// These after others.
    pub fn after(&self, first: &Self) -> Self {
        Self { matrix: self.matrix.matmul(&first.matrix), shift: self.apply(&first.shift) }
    }

    /// Points [.., 3], one a map.
    pub fn apply(&self, points: &Tensor) -> Tensor {
        turned(&self.matrix, points) + &self.shift
    }

    /// The maps back; of flat ones the identity.
    pub fn inverse(&self) -> Self {
        let rows: Vec<Tensor> = (0..3).map(|k| self.matrix.select(-2, k)).collect();
        let across = |a: usize, b: usize| rows[a].cross(&rows[b], Some(-1));
        let columns = Tensor::stack(&[across(1, 2), across(2, 0), across(0, 1)], -1);
        let det = dot(&rows[0], &columns.select(-1, 0)).unsqueeze(-1);
        let flat = det.abs().le(tiny(det.kind()));
        let eye = Tensor::eye(3, (self.matrix.kind(), self.matrix.device()));
        let matrix =
            (&columns / det.where_self(&flat.logical_not(), &det.ones_like())).where_self(&flat.logical_not(), &eye);
        let back = -turned(&matrix, &self.shift);
        let shift = back.where_self(&flat.squeeze_dim(-1).logical_not(), &back.zeros_like());
        Self { matrix, shift }
    }

    /// Those of the places `at` along an axis that counts maps (`axis` < 0, -1 the last).
    pub fn select(&self, axis: i64, at: &Tensor) -> Self {
        Self { matrix: self.matrix.index_select(axis - 2, at), shift: self.shift.index_select(axis - 1, at) }
    }

    /// Number `at` along the first axis.
    pub fn get(&self, at: i64) -> Self {
        Self { matrix: self.matrix.get(at), shift: self.shift.get(at) }
    }

    /// These where `which` [..] says so, others elsewhere.
    pub(super) fn or(&self, which: &Tensor, other: &Self) -> Self {
        Self {
            matrix: self.matrix.where_self(&which.unsqueeze(-1).unsqueeze(-1), &other.matrix),
            shift: self.shift.where_self(&which.unsqueeze(-1), &other.shift),
        }
    }

    /// One after another along an axis (`axis` < 0, -1 the last).
    pub(super) fn cat(parts: &[Self], axis: i64) -> Self {
        let all = |of: fn(&Self) -> &Tensor, axis| Tensor::cat(&parts.iter().map(of).collect::<Vec<_>>(), axis);
        Self { matrix: all(|m| &m.matrix, axis - 2), shift: all(|m| &m.shift, axis - 1) }
    }

    /// Stacked along a new first axis.
    pub(super) fn stack(parts: &[Self]) -> Self {
        let all = |of: fn(&Self) -> &Tensor| Tensor::stack(&parts.iter().map(of).collect::<Vec<_>>(), 0);
        Self { matrix: all(|m| &m.matrix), shift: all(|m| &m.shift) }
    }
}

/// Matrices [.., 3, 3] times vectors [.., 3].
pub(super) fn turned(matrix: &Tensor, v: &Tensor) -> Tensor {
    matrix.matmul(&v.unsqueeze(-1)).squeeze_dim(-1)
}

/// Linear blend skinning: points [n, 3] by weights [n, j] and maps [t, j] (or [j]) to [t, n, 3] ([n, 3]):
/// Σ_j w_j M_j p / (Σ_j w_j + 1e-8).
pub fn skin(points: &Tensor, weights: &Tensor, maps: &Maps) -> Tensor {
    let rows = maps.rows().flatten(-2, -1);
    // Weights first: n x j by j x 12 is one product.
    let mixed = weights.matmul(&rows).unflatten(-1, [3, 4]);
    let total = weights.sum_dim_intlist(-1, true, None::<Kind>) + EPS;
    let moved = mixed.narrow(-1, 0, 3).matmul(&points.unsqueeze(-1)).squeeze_dim(-1) + mixed.select(-1, 3);
    moved / total
}
