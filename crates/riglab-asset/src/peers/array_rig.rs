//! A rig as plain arrays: what the peers' formats have in common.

use std::collections::BTreeMap;

use riglab_core::Vec3;

/// Which axis points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Up {
    /// As in glTF, and in every [`riglab_core::Rig`].
    #[default]
    Y,
    /// As in Blender.
    Z,
}

impl Up {
    /// A point of a space with this axis up, with y up.
    pub fn to_y(self, [x, y, z]: Vec3) -> Vec3 {
        match self {
            Self::Y => [x, y, z],
            Self::Z => [x, z, -y],
        }
    }

    /// A point of a space with y up, with this axis up.
    pub fn from_y(self, [x, y, z]: Vec3) -> Vec3 {
        match self {
            Self::Y => [x, y, z],
            Self::Z => [x, -z, y],
        }
    }
}

/// An asset as its file has it: axes, scale, order of vertices and joints are the file's, and nothing
/// is repaired. Whatever a format does not hold is empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArrayRig {
    /// What the file calls the asset; empty where it does not.
    pub name: String,
    /// The axis that points up, by the format.
    pub up: Up,
    /// Names of the joints; empty, or one a joint.
    pub names: Vec<String>,
    /// Positions of the joints (bone heads).
    pub joints: Vec<Vec3>,
    /// Parents of the joints in any order; empty where the file holds positions alone.
    pub parents: Vec<Option<usize>>,
    /// The joint that the file names as the root of all, where it names one.
    pub root: Option<usize>,
    /// Ends of the bones; empty, or one a joint.
    pub tails: Vec<Vec3>,
    /// Positions of the vertices, or of points where there are no faces.
    pub vertices: Vec<Vec3>,
    /// Triangles, as numbers of vertices.
    pub faces: Vec<[u32; 3]>,
    /// Weights, a row a vertex; `None` where the file has none.
    pub weights: Option<SparseRows>,
    /// Further arrays by the file's own name for them; only [`crate::read_arrays`] fills this.
    pub extras: BTreeMap<String, Array>,
}

/// Weights as read: rows in the order of the vertices, zeros left out, nothing normalised.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseRows {
    /// Where each row starts; one more than rows.
    pub offsets: Vec<usize>,
    /// Joint and weight, within a row in the order of the file. A joint may come up twice: its
    /// weights add up.
    pub pairs: Vec<(u32, f32)>,
}

/// An array of numbers, last axis fastest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Array {
    /// Length along each axis.
    pub shape: Vec<usize>,
    /// The elements.
    pub data: Vec<f32>,
}

impl Default for SparseRows {
    fn default() -> Self {
        Self { offsets: vec![0], pairs: Vec::new() }
    }
}

impl SparseRows {
    /// How many rows.
    pub fn rows(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Joints and weights of a row.
    pub fn row(&self, row: usize) -> &[(u32, f32)] {
        &self.pairs[self.offsets[row]..self.offsets[row + 1]]
    }

    /// Ends the row that was being filled.
    pub(crate) fn end_row(&mut self) {
        self.offsets.push(self.pairs.len());
    }

    /// Sorts triples of (row, joint, weight) into rows; all rows are below `rows`.
    pub(crate) fn from_triples(rows: usize, triples: &[(u32, u32, f32)]) -> Self {
        let mut offsets = vec![0; rows + 1];
        for (row, ..) in triples {
            offsets[*row as usize + 1] += 1;
        }
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        let mut next = offsets.clone();
        let mut pairs = vec![(0, 0.0); triples.len()];
        for &(row, joint, weight) in triples {
            let slot = &mut next[row as usize];
            pairs[*slot] = (joint, weight);
            *slot += 1;
        }
        Self { offsets, pairs }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_turn_forth_and_back() {
        assert_eq!(Up::Z.to_y([1.0, 2.0, 3.0]), [1.0, 3.0, -2.0]);
        assert_eq!(Up::Z.from_y(Up::Z.to_y([1.0, 2.0, 3.0])), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn triples_in_any_order_become_rows() {
        let rows = SparseRows::from_triples(3, &[(2, 0, 0.5), (0, 1, 1.0), (2, 4, 0.25), (2, 0, 0.25)]);
        assert_eq!(rows.row(0), [(1, 1.0)]);
        assert!(rows.row(1).is_empty());
        assert_eq!(rows.row(2), [(0, 0.5), (4, 0.25), (0, 0.25)]);
    }
}
