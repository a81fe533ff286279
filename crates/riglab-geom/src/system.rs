//! A symmetric system of a surface, solved.

use std::sync::OnceLock;

use crate::factors::Factors;

/// Where a search for the solution ends: the share of the first residual that is left.
const RESIDUAL: f64 = 1e-6;
/// Where any search ends.
const ROUNDS: usize = 1_000;

/// A symmetric matrix whose diagonal outweighs the rest of every row, all of which is below zero.
#[derive(Default)]
pub struct System {
    /// Where the entries of each row end.
    ends: Vec<usize>,
    /// Columns beside the diagonal, in order, with what they take away.
    entries: Vec<(u32, f64)>,
    diagonal: Vec<f64>,
    /// It taken apart, once it is to be solved; nothing where that cannot be.
    factors: OnceLock<Option<Factors>>,
}

impl System {
    /// Adds a row: the columns beside the diagonal, in order, with what they take away, and what the diagonal has beyond
    /// their sum.
    pub fn add(&mut self, columns: &[(u32, f64)], beyond: f64) {
        self.entries.extend(columns);
        self.ends.push(self.entries.len());
        self.diagonal.push(columns.iter().map(|(_, w)| w).sum::<f64>() + beyond);
    }

    /// What is beside the diagonal of a row.
    fn beside(&self, row: usize) -> &[(u32, f64)] {
        &self.entries[row.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[row]]
    }

    /// The solution for each of N right sides, N numbers a row: each as if it were alone, to the bit. By the matrix taken
    /// apart, which is done once; by conjugate gradients where it cannot be.
    pub fn solve<const N: usize>(&self, right: Vec<[f64; N]>) -> Vec<[f64; N]> {
        let rows = || (0..self.ends.len()).map(|row| (self.beside(row), self.diagonal[row]));
        match self.factors.get_or_init(|| Factors::new(rows())) {
            Some(factors) => factors.solve(&right),
            None => self.by_gradients(right),
        }
    }

    /// The matrix times x, and x times that.
    fn times<const N: usize>(&self, x: &[[f64; N]], out: &mut [[f64; N]]) -> [f64; N] {
        let mut product = [0.0; N];
        for ((row, x_row), out) in x.iter().enumerate().zip(out) {
            let mut beside = [0.0; N];
            for (column, w) in self.beside(row) {
                let x = &x[*column as usize];
                (0..N).for_each(|k| beside[k] += w * x[k]);
            }
            let (x, d) = (x_row, self.diagonal[row]);
            *out = std::array::from_fn(|k| d * x[k] - beside[k]);
            (0..N).for_each(|k| product[k] += x[k] * out[k]);
        }
        product
    }

    /// Conjugate gradients, the diagonal as preconditioner, until that share of the first residual is left.
    fn by_gradients<const N: usize>(&self, right: Vec<[f64; N]>) -> Vec<[f64; N]> {
        let diagonal = &self.diagonal;
        let (mut x, mut r) = (vec![[0.0; N]; right.len()], right);
        let mut rz = [0.0; N];
        let eased = |(r, d): (&[f64; N], &f64)| {
            let z = r.map(|r| r / d);
            (0..N).for_each(|k| rz[k] += r[k] * z[k]);
            z
        };
        let mut p: Vec<[f64; N]> = r.iter().zip(diagonal).map(eased).collect();
        let mut ap = vec![[0.0; N]; r.len()];
        let enough = rz.map(|rz| rz * RESIDUAL * RESIDUAL);
        let mut ended = [false; N];
        for _ in 0..ROUNDS {
            for k in 0..N {
                if !ended[k] && (rz[k].is_nan() || rz[k] <= enough[k]) {
                    // It stays as it is while others go on: nothing moves what has no direction.
                    ended[k] = true;
                    r.iter_mut().zip(&mut p).for_each(|(r, p)| (r[k], p[k]) = (0.0, 0.0));
                }
            }
            if ended == [true; N] {
                break;
            }
            let of_those = |a: [f64; N], b: [f64; N]| -> [f64; N] {
                std::array::from_fn(|k| if ended[k] { 0.0 } else { a[k] / b[k] })
            };
            let product = self.times(&p, &mut ap);
            let step = of_those(rz, product);
            let mut next = [0.0; N];
            let states = x.iter_mut().zip(&mut r).zip(p.iter().zip(&mut ap));
            for (((x, r), (p, ap)), d) in states.zip(diagonal) {
                for k in 0..N {
                    x[k] += step[k] * p[k];
                    r[k] -= step[k] * ap[k];
                    // The product is of no more use, and r eased by the diagonal has its place.
                    ap[k] = r[k] / d;
                    next[k] += r[k] * ap[k];
                }
            }
            let turn = of_those(next, rz);
            for (p, z) in p.iter_mut().zip(&ap) {
                (0..N).for_each(|k| p[k] = z[k] + turn[k] * p[k]);
            }
            rz = next;
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of rows each of which has these neighbours, all of the same weight.
    fn system(neighbours: &[Vec<u32>], beyond: f64) -> System {
        let mut out = System::default();
        neighbours.iter().for_each(|own| out.add(&own.iter().map(|&column| (column, 0.5)).collect::<Vec<_>>(), beyond));
        out
    }

    /// A square of as many rows and columns, each joined to those beside it.
    fn square(side: u32) -> Vec<Vec<u32>> {
        let of = |v: u32| {
            let (r, c) = (v / side, v % side);
            let beside = [(r.wrapping_sub(1), c), (r, c.wrapping_sub(1)), (r, c + 1), (r + 1, c)].into_iter();
            beside.filter(|(r, c)| r.max(c) < &side).map(|(r, c)| r * side + c).collect()
        };
        (0..side * side).map(of).collect()
    }

    /// Each joined to many, in no order.
    fn tangle(rows: u32) -> Vec<Vec<u32>> {
        let mut out = vec![Vec::new(); rows as usize];
        let mut seed = 1u32;
        for _ in 0..rows * 4 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let (a, b) = (seed / 7 % rows, seed / 65_537 % rows);
            if a != b {
                out[a as usize].push(b);
                out[b as usize].push(a);
            }
        }
        for own in &mut out {
            own.sort_unstable();
            own.dedup();
        }
        out
    }

    fn right(rows: usize) -> Vec<[f64; 2]> {
        (0..rows).map(|row| [f64::from(row % 13 == 0), (row as f64).sin()]).collect()
    }

    /// How far what the matrix makes of a solution is from the right side, at most.
    fn off(system: &System, x: &[[f64; 2]], right: &[[f64; 2]]) -> f64 {
        let mut back = vec![[0.0; 2]; x.len()];
        system.times(x, &mut back);
        back.iter().flatten().zip(right.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn a_surface_is_taken_apart_and_solved_exactly() {
        let system = system(&square(40), 1e-3);
        let right = right(1_600);
        let x = system.solve(right.clone());
        assert!(system.factors.get().unwrap().is_some());
        assert!(off(&system, &x, &right) < 1e-10, "{}", off(&system, &x, &right));
        let near = system.by_gradients(right.clone());
        assert!(off(&system, &near, &right) < 1e-4);
        // Of one row, and of two that nothing joins.
        for rows in [1, 2] {
            let x = self::system(&vec![Vec::new(); rows], 4.0).solve(vec![[2.0]; rows]);
            assert_eq!(x, vec![[0.5]; rows]);
        }
    }

    #[test]
    fn what_would_fill_the_memory_is_solved_by_gradients() {
        let system = system(&tangle(3_000), 1e-2);
        let right = right(3_000);
        let x = system.solve(right.clone());
        assert!(system.factors.get().unwrap().is_none());
        assert!(off(&system, &x, &right) < 1e-3, "{}", off(&system, &x, &right));
    }

    #[test]
    fn numbers_at_the_end_of_what_there_is_break_nothing() {
        for beyond in [f64::MIN_POSITIVE, 1e-300, 1e300, f64::MAX] {
            let system = system(&square(9), beyond);
            assert_eq!(system.solve(right(81)).len(), 81);
        }
    }
}
