//! In how many directions a cell sees the inside of a surface.
//!
//! The winding number of a surface around a point is the mean over all directions of how often a ray leaves
//! the body less how often it enters. Here the mean is taken over the 26 directions from a cell to its
//! neighbours, by the weights of Lebedev's rule for just these, and a ray counts as inside or not. Rays of
//! one direction run through the middles of whole columns of cells, so that triangles are cut with columns
//! instead of rays with triangles.
//!
//! Cuts are in whole numbers: a ray that meets an edge meets one of the triangles there, as if all rays lay a
//! little aside, so that a closed surface has no holes.

use std::sync::atomic::{AtomicU16, Ordering};

use rayon::prelude::*;
use riglab_core::Mesh;

use super::lattice::Lattice;
use crate::buckets::sorted_by_place;

/// The half of the directions; the others are opposite. Lebedev's weights of a side's, an edge's and a
/// corner's direction are 1/21, 4/105 and 9/280, here in parts of [`TOTAL`].
const DIRECTIONS: [([i64; 3], u16); 13] = [
    ([1, 0, 0], 80),
    ([0, 1, 0], 80),
    ([0, 0, 1], 80),
    ([1, 1, 0], 64),
    ([1, -1, 0], 64),
    ([1, 0, 1], 64),
    ([1, 0, -1], 64),
    ([0, 1, 1], 64),
    ([0, 1, -1], 64),
    ([1, 1, 1], 54),
    ([1, 1, -1], 54),
    ([1, -1, 1], 54),
    ([1, -1, -1], 54),
];

/// What a cell gets that every ray says is inside.
pub(super) const TOTAL: u16 = 1680;

/// Parts of a cell in which positions are counted.
const PARTS: i64 = 4096;

/// So many columns of a row and one are looked at one by one.
const FEW: i64 = 8;

/// The share of directions, in parts of [`TOTAL`], from which each cell's middle is inside. `turned` says
/// which triangles count with their other side.
pub(super) fn votes(mesh: &Mesh, turned: &[bool], lattice: &Lattice) -> Vec<u16> {
    let rounded = |p: &[f32; 3]| {
        let p = lattice.scaled(p.map(f64::from));
        // Counted from the middle of the first cell; what lies far outside is brought near.
        let far = 4.0 * super::MOST_CELLS as f64;
        p.map(|x| (x.clamp(-far, far) * PARTS as f64).round() as i64 - PARTS / 2)
    };
    let positions: Vec<[i64; 3]> = mesh.positions().par_iter().with_min_len(4096).map(rounded).collect();
    let votes: Vec<AtomicU16> = (0..lattice.cells()).map(|_| AtomicU16::new(0)).collect();
    // Directions side by side, each sorted by one thread: that takes less than all threads on one after another.
    let cut = |&(direction, weight): &([i64; 3], u16)| {
        let sheared = Sheared::new(direction, lattice);
        let cuts = sheared.cuts(mesh.triangles(), turned, &positions);
        (sheared, weight, cuts)
    };
    let cut: Vec<_> = DIRECTIONS.par_iter().map(cut).collect();
    for (sheared, weight, cuts) in cut {
        let columns: Vec<&[u64]> = by_column(&cuts);
        columns.par_iter().for_each(|columns| {
            columns.chunk_by(|a, b| a >> 33 == b >> 33).for_each(|column| sheared.count(column, weight, &votes));
        });
    }
    votes.into_iter().map(AtomicU16::into_inner).collect()
}

/// Parts of about the same length that divide no column.
fn by_column(cuts: &[u64]) -> Vec<&[u64]> {
    const LENGTH: usize = 4096;
    let (mut parts, mut left) = (Vec::with_capacity(cuts.len() / LENGTH + 1), cuts);
    while left.len() > LENGTH {
        let column = left[LENGTH] >> 33;
        let end = LENGTH + left[LENGTH..].partition_point(|c| c >> 33 == column);
        let (part, rest) = left.split_at(end);
        parts.push(part);
        left = rest;
    }
    parts.push(left);
    parts
}

/// Space with one direction brought along an axis: along the main axis a column keeps its place on both
/// others.
struct Sheared<'a> {
    lattice: &'a Lattice,
    /// The axis along which cells of a column are counted, and the other two.
    axes: [usize; 3],
    /// How far a column moves along the other two from cell to cell.
    slope: [i64; 2],
    /// The smallest place of a column on both.
    from: [i64; 2],
    /// How many places there are.
    size: [i64; 2],
    /// Whether the axes are in cyclic order; else areas change their sign.
    mirrored: bool,
}

impl<'a> Sheared<'a> {
    fn new(direction: [i64; 3], lattice: &'a Lattice) -> Self {
        let main = direction.iter().position(|d| *d != 0).unwrap_or(0);
        let axes = match main {
            0 => [0, 1, 2],
            1 => [1, 0, 2],
            _ => [2, 0, 1],
        };
        let slope = [direction[axes[1]], direction[axes[2]]];
        let n = axes.map(|a| lattice.size[a] as i64);
        let reach = |k: usize| slope[k] * (n[0] - 1);
        let from = [0, 1].map(|k| (-reach(k)).min(0));
        let size = [0, 1].map(|k| n[k + 1] + reach(k).abs());
        Self { lattice, axes, slope, from, size, mirrored: main == 1 }
    }

    /// Where triangles cut columns: column, depth in parts of a cell, and whether the way along the direction
    /// leaves there, packed so that they sort by column and depth.
    fn cuts(&self, triangles: &[[u32; 3]], turned: &[bool], positions: &[[i64; 3]]) -> Vec<u64> {
        let cut = |(triangle, turned): (&[u32; 3], &bool), out: &mut Vec<u64>| {
            let corners = triangle.map(|v| {
                let p = self.axes.map(|axis| positions[v as usize][axis]);
                [p[1] - self.slope[0] * p[0], p[2] - self.slope[1] * p[0], p[0]]
            });
            self.cut(corners, *turned, out);
        };
        let parts = triangles.par_chunks(2048).zip(turned.par_chunks(2048));
        let parts: Vec<Vec<u64>> = parts
            .map(|(triangles, turned)| {
                let mut out = Vec::with_capacity(triangles.len());
                triangles.iter().zip(turned).for_each(|both| cut(both, &mut out));
                out
            })
            .collect();
        sorted_by_place(parts.concat(), (self.size[0] * self.size[1]) as usize, |cut| (cut >> 33) as usize)
    }

    /// The columns that one triangle cuts.
    fn cut(&self, [a, mut b, mut c]: [[i64; 3]; 3], turned: bool, out: &mut Vec<u64>) {
        let mut area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0 {
            return;
        }
        // Facing along the direction, the way out.
        let leaves = (area > 0) ^ self.mirrored ^ turned;
        if area < 0 {
            (b, c, area) = (c, b, -area);
        }
        let [low, high] = [0, 1].map(|k| {
            let (min, max) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
            [-(-min).div_euclid(PARTS), max.div_euclid(PARTS)]
        });
        // The share of corner c is the function of the edge from a to b, and so on.
        let edges = [(b, c), (c, a), (a, b)];
        for v in low_to(high, self.from[1], self.size[1]) {
            let (mut first, mut last) = (low[0].max(self.from[0]), low[1].min(self.from[0] + self.size[0] - 1));
            // Along the row, each edge's function at u = 0, its step, and its limit.
            let functions = edges.map(|(p, q)| {
                let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
                // On the edge itself: whether a little aside is within.
                let owned = dy < 0 || (dy == 0 && dx > 0);
                (dx * (v * PARTS - p[1]) + dy * p[0], -dy * PARTS, i64::from(!owned))
            });
            // A look at each of a few columns costs less than to divide.
            if last - first >= FEW {
                for (start, step, least) in functions {
                    match step.cmp(&0) {
                        std::cmp::Ordering::Equal if start < least => last = first - 1,
                        std::cmp::Ordering::Equal => {}
                        std::cmp::Ordering::Greater => first = first.max(-(start - least).div_euclid(step)),
                        std::cmp::Ordering::Less => last = last.min((start - least).div_euclid(-step)),
                    }
                }
            }
            for u in first..=last {
                let at = functions.map(|(start, step, _)| start + step * u);
                if functions.iter().zip(at).any(|((.., least), at)| at < *least) {
                    continue;
                }
                let share = |k: usize| at[k] as f64;
                let depth = (share(0) * a[2] as f64 + share(1) * b[2] as f64 + share(2) * c[2] as f64) / area as f64;
                // Before the first cell is as good as far before it.
                let depth = (depth + PARTS as f64).clamp(0.0, f64::from(u32::MAX)) as u64;
                let column = ((u - self.from[0]) * self.size[1] + v - self.from[1]) as u64;
                out.push(column << 33 | depth << 1 | u64::from(leaves));
            }
        }
    }

    /// Adds the weight, once for each way along the column, to its cells that are inside.
    fn count(&self, column: &[u64], weight: u16, votes: &[AtomicU16]) {
        let at = (column[0] >> 33) as i64;
        let at = [at / self.size[1] + self.from[0], at % self.size[1] + self.from[1]];
        // The column's cells that the lattice has.
        let (mut first, mut last) = (0, self.lattice.size[self.axes[0]] as i64 - 1);
        for ((at, slope), axis) in at.into_iter().zip(self.slope).zip(&self.axes[1..]) {
            let n = self.lattice.size[*axis] as i64;
            match slope {
                0 if at < 0 || at >= n => return,
                0 => {}
                1 => (first, last) = (first.max(-at), last.min(n - 1 - at)),
                _ => (first, last) = (first.max(at - n + 1), last.min(at)),
            }
        }
        let strides = [self.lattice.size[1] * self.lattice.size[2], self.lattice.size[2], 1];
        let place = |t: i64| {
            let others = [0, 1].map(|k| (at[k] + self.slope[k] * t) as usize);
            t as usize * strides[self.axes[0]] + others[0] * strides[self.axes[1]] + others[1] * strides[self.axes[2]]
        };
        let stride = {
            let along = |k: usize| self.slope[k] * strides[self.axes[k + 1]] as i64;
            strides[self.axes[0]] as i64 + along(0) + along(1)
        };
        // Ways back: entered below less left below. Ways on: left above less entered above.
        let mut below = 0i32;
        let mut above = column.iter().map(|c| if c & 1 == 1 { 1 } else { -1 }).sum::<i32>();
        let mut next = first;
        for cut in column.iter().map(Some).chain([None]) {
            // Cells whose middle is not beyond the cut.
            let end = cut.map_or(last, |c| ((c >> 1 & 0xffff_ffff) as i64 / PARTS - 1).min(last));
            let here = weight * (u16::from(below > 0) + u16::from(above > 0));
            if here > 0 && next <= end {
                let start = place(next) as i64;
                for t in 0..=end - next {
                    // Each cell lies on one column of a direction, so nobody else writes here.
                    let vote = &votes[(start + t * stride) as usize];
                    vote.store(vote.load(Ordering::Relaxed) + here, Ordering::Relaxed);
                }
            }
            next = next.max(end + 1);
            if let Some(cut) = cut {
                let step = if cut & 1 == 1 { 1 } else { -1 };
                (below, above) = (below - step, above - step);
            }
        }
    }
}

/// Rows that are both the triangle's and the lattice's.
fn low_to([low, high]: [i64; 2], from: i64, size: i64) -> std::ops::RangeInclusive<i64> {
    low.max(from)..=high.min(from + size - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::{cube, joined};

    /// A box whose sides run through middles of cells: every ray meets edges.
    #[test]
    fn a_closed_surface_has_no_holes() {
        let mesh = cube([3.5; 3], 2.0);
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [8; 3] };
        let votes = votes(&mesh, &[false; 12], &lattice);
        for (index, vote) in votes.iter().enumerate() {
            let place = lattice.place(index);
            if place.iter().all(|x| (2..5).contains(x)) {
                assert_eq!(*vote, TOTAL, "{place:?}");
            } else if place.iter().any(|x| !(1..6).contains(x)) {
                assert_eq!(*vote, 0, "{place:?}");
            }
        }
    }

    #[test]
    fn bodies_in_one_another_are_inside_once() {
        let mesh = joined(&[cube([4.0; 3], 3.3), cube([4.0; 3], 1.3)]);
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [8; 3] };
        let votes = votes(&mesh, &[false; 24], &lattice);
        assert!(votes.iter().all(|v| *v == 0 || *v == TOTAL));
        assert_eq!(votes.iter().filter(|v| **v > 0).count(), 6 * 6 * 6);
    }

    #[test]
    fn weights_are_those_of_all_directions() {
        assert_eq!(2 * DIRECTIONS.iter().map(|(_, w)| w).sum::<u16>(), TOTAL);
    }
}
