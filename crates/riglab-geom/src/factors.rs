//! A symmetric system taken apart once, and solved for one right side after another.

use clarabel::algebra::CscMatrix;
use clarabel::qdldl::{QDLDLFactorisation, QDLDLSettings};

/// Numbers below the diagonal, as many a row, beyond which a system is not taken apart. A surface has some tens, which grow
/// with the logarithm of its rows; triangles between any vertices would take all memory.
const MOST: usize = 128;

/// And as many in all: 1.6 GB.
const MOST_IN_ALL: usize = 100_000_000;

/// A matrix A = L D Lᵀ, with L lower triangular with ones on its diagonal and D diagonal, its rows in an order that
/// leaves L few numbers (approximate minimum degree).
#[derive(Debug)]
pub struct Factors {
    /// Which row of the system each row is.
    order: Vec<usize>,
    /// L without its diagonal, column after column.
    lower: CscMatrix<f64>,
    /// D's reciprocals.
    inverse: Vec<f64>,
}

impl Factors {
    /// Of a symmetric matrix: of each row the columns beside the diagonal, in order, with what they take away, and the
    /// diagonal. Nothing where L would be too large, or where rounding leaves no positive D, as it does where a row is next
    /// to nothing but what others take away.
    pub fn new<'a>(rows: impl Iterator<Item = (&'a [(u32, f64)], f64)>) -> Option<Self> {
        // Columns of the upper half, which are rows of the lower.
        let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
        for (row, (beside, diagonal)) in rows.enumerate() {
            for (column, w) in beside.iter().take_while(|(column, _)| (*column as usize) < row) {
                columns.push(*column as usize);
                values.push(-w);
            }
            columns.push(row);
            values.push(diagonal);
            starts.push(columns.len());
        }
        let n = starts.len() - 1;
        let (perm, _, told) = amd::order(n, &starts, &columns, &amd::Control::default()).ok()?;
        if told.lnz > MOST * n || told.lnz > MOST_IN_ALL {
            return None;
        }
        let settings = QDLDLSettings { perm: Some(perm), regularize_enable: false, ..Default::default() };
        let matrix = CscMatrix { m: n, n, colptr: starts, rowval: columns, nzval: values };
        let made = QDLDLFactorisation::new(&matrix, Some(settings)).ok()?;
        let sound = made.D.iter().zip(&made.Dinv).all(|(d, i)| *d > 0.0 && d.is_finite() && i.is_finite());
        sound.then_some(Self { order: made.perm, lower: made.L, inverse: made.Dinv })
    }

    /// What the system makes each of several right sides of, N numbers a row: each as if it were alone, to the bit.
    pub fn solve<const N: usize>(&self, right: &[[f64; N]]) -> Vec<[f64; N]> {
        let mut x: Vec<[f64; N]> = self.order.iter().map(|&row| right[row]).collect();
        let column = |j: usize| {
            let those = self.lower.colptr[j]..self.lower.colptr[j + 1];
            self.lower.rowval[those.clone()].iter().zip(&self.lower.nzval[those])
        };
        for j in 0..x.len() {
            let above = x[j];
            // What is cold changes nothing, and most of a right side is.
            if above != [0.0; N] {
                for (&i, l) in column(j) {
                    (0..N).for_each(|k| x[i][k] -= l * above[k]);
                }
            }
        }
        for j in (0..x.len()).rev() {
            let mut own = x[j].map(|x| x * self.inverse[j]);
            for (&i, l) in column(j) {
                (0..N).for_each(|k| own[k] -= l * x[i][k]);
            }
            x[j] = own;
        }
        let mut out = vec![[0.0; N]; x.len()];
        self.order.iter().zip(x).for_each(|(&row, x)| out[row] = x);
        out
    }
}
