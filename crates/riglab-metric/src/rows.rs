//! Weights to be compared, sparse by vertex.

use riglab_core::SkinWeights;

/// A matrix of weights, a row a vertex and a column a bone; zeros are not stored. Nothing is asked of the
/// numbers: predictions may be unnormalised, rows empty.
///
/// Tables of vertices and bones are mostly zeros (88 % in real rigs), so metrics are sums over what is stored,
/// with the share of the zeros added by count.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    offsets: Vec<usize>,
    entries: Vec<(u32, f32)>,
    columns: usize,
}

impl Rows {
    /// Of dense rows of `columns` weights a vertex; what is left over at the end is no row.
    pub fn dense(weights: &[f32], columns: usize) -> Self {
        let mut rows = Self { offsets: vec![0], entries: Vec::new(), columns };
        let mut end = 0;
        for row in weights.chunks_exact(columns.max(1)) {
            // Every entry is written, and the next one over it if it was a zero: no branch to guess wrongly.
            rows.entries.resize(end + row.len(), (0, 0.0));
            let room = &mut rows.entries[..];
            for (column, &weight) in (0u32..).zip(row) {
                room[end] = (column, weight);
                end += usize::from(weight != 0.0);
            }
            rows.offsets.push(end);
        }
        rows.entries.truncate(end);
        rows
    }

    /// Of a rig's weights on `joints` joints.
    pub fn of(weights: &SkinWeights, joints: usize) -> Self {
        Self {
            offsets: weights.offsets().iter().map(|&o| o as usize).collect(),
            entries: weights.joints().iter().zip(weights.weights()).map(|(&j, &w)| (u32::from(j), w)).collect(),
            columns: joints,
        }
    }

    /// Of rows of (column, weight) in any order; a column that comes twice has the sum. Columns from `columns` on
    /// are left out.
    pub fn new<R: IntoIterator<Item = (u32, f32)>>(rows: impl IntoIterator<Item = R>, columns: usize) -> Self {
        let mut out = Self { offsets: vec![0], entries: Vec::new(), columns };
        for row in rows {
            let start = out.entries.len();
            out.entries.extend(row.into_iter().filter(|(c, w)| *w != 0.0 && (*c as usize) < columns));
            out.entries[start..].sort_by_key(|(c, _)| *c);
            let mut end = start;
            for at in start..out.entries.len() {
                if end > start && out.entries[end - 1].0 == out.entries[at].0 {
                    out.entries[end - 1].1 += out.entries[at].1;
                } else {
                    out.entries[end] = out.entries[at];
                    end += 1;
                }
            }
            out.entries.truncate(end);
            out.offsets.push(end);
        }
        out
    }

    /// How many vertices.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many bones.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Vertices times bones.
    pub fn size(&self) -> usize {
        self.len() * self.columns
    }

    /// Columns and weights of a vertex, columns rising.
    pub fn row(&self, vertex: usize) -> &[(u32, f32)] {
        &self.entries[self.offsets[vertex]..self.offsets[vertex + 1]]
    }

    /// All rows, first vertex first.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[(u32, f32)]> {
        (0..self.len()).map(|v| self.row(v))
    }
}

/// Goes through two rows at once: `each` gets a column and both weights wherever one of them is stored.
pub(crate) fn both<T, U>(a: &[(u32, T)], b: &[(u32, U)], mut each: impl FnMut(usize, T, U))
where
    T: Copy + Default,
    U: Copy + Default,
{
    let (mut i, mut k) = (0, 0);
    loop {
        let (at, bt) = (a.get(i), b.get(k));
        match (at, bt) {
            (Some(&(c, w)), Some(&(d, p))) if c == d => {
                each(c as usize, w, p);
                (i, k) = (i + 1, k + 1);
            }
            (Some(&(c, w)), next) if next.is_none_or(|&(d, _)| c < d) => {
                each(c as usize, w, U::default());
                i += 1;
            }
            (_, Some(&(d, p))) => {
                each(d as usize, T::default(), p);
                k += 1;
            }
            _ => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dense_and_sparse_rows_are_the_same() {
        let dense = Rows::dense(&[0.0, 0.5, 0.5, 1.0, 0.0, 0.0], 3);
        let sparse = Rows::new([vec![(2, 0.25), (1, 0.5), (2, 0.25), (9, 1.0)], vec![(0, 1.0)]], 3);
        assert_eq!(dense, sparse);
        assert_eq!((dense.len(), dense.size(), dense.row(0)), (2, 6, &[(1, 0.5), (2, 0.5)][..]));
        assert!(Rows::dense(&[], 0).is_empty());
        // Half a row is none, a negative zero is a zero, what is not a number is none.
        let odd = Rows::dense(&[-0.0, f32::NAN, 1.0, 0.0, 0.5], 2);
        assert_eq!((odd.len(), odd.row(0).len(), odd.row(1)), (2, 1, &[(0, 1.0)][..]));
        assert!(odd.row(0)[0].0 == 1 && odd.row(0)[0].1.is_nan());
    }

    #[test]
    fn both_visits_every_stored_entry_once() {
        let mut seen = Vec::new();
        both(&[(0, 1.0f32), (3, 2.0)], &[(1, 3.0f32), (3, 4.0), (5, 5.0)], |c, a, b| seen.push((c, a, b)));
        assert_eq!(seen, [(0, 1.0, 0.0), (1, 0.0, 3.0), (3, 2.0, 4.0), (5, 0.0, 5.0)]);
    }
}
