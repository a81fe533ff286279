//! Where the points of clouds lie: cells, orders along curves, neighbours, patches. Plain numbers, so that
//! the threads that make batches can prepare them.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use super::curves::Curve;

/// Cells an axis at most: codes have 16 bits for each.
const CELLS: f32 = 65_535.0;

/// Points of one or several clouds, one after another, on a lattice.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Points of each cloud.
    pub sizes: Vec<usize>,
    /// The cell of each point.
    pub cells: Vec<[u32; 3]>,
    /// Of [`Curve::ALL`], the points in the order of their codes; of one code, in their own order.
    pub orders: Vec<Vec<i64>>,
    /// Neighbours for the kernel of the stem and that of the blocks.
    pub stem: Taps,
    /// See `stem`.
    pub blocks: Taps,
}

/// Cells along the side of the stem's kernel.
pub(super) const STEM: usize = 5;
/// The same for the blocks.
pub(super) const BLOCK: usize = 3;

impl Layout {
    /// Of points in cells of side `grid`, counted from the least coordinates of all.
    pub fn new(points: &[[f32; 3]], sizes: &[usize], grid: f32) -> Self {
        let least: [f32; 3] = std::array::from_fn(|k| points.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min));
        let cell = |p: &[f32; 3]| std::array::from_fn(|k| ((p[k] - least[k]) / grid).clamp(0.0, CELLS) as u32);
        Self::of(points.iter().map(cell).collect(), sizes)
    }

    /// Of points in given cells.
    pub fn of(cells: Vec<[u32; 3]>, sizes: &[usize]) -> Self {
        assert_eq!(cells.len(), sizes.iter().sum::<usize>(), "a cell a point");
        let batch = batches(sizes);
        let most = cells.iter().flatten().copied().max().unwrap_or(0);
        let bits = (u32::BITS - most.leading_zeros()).max(1);
        let orders = Curve::ALL.iter().map(|curve| {
            let codes = cells.iter().zip(&batch).map(|(cell, b)| curve.code(*cell, *b, bits));
            order(&codes.collect::<Vec<_>>())
        });
        let orders = orders.collect();
        let places = Places::new(&cells, &batch);
        let (stem, blocks) = (places.taps(STEM), places.taps(BLOCK));
        Self { sizes: sizes.to_vec(), cells, orders, stem, blocks }
    }
}

/// The cloud of each point.
fn batches(sizes: &[usize]) -> Vec<usize> {
    sizes.iter().enumerate().flat_map(|(b, &n)| std::iter::repeat_n(b, n)).collect()
}

/// Numbers by ascending code, equal ones as they come.
pub fn order(codes: &[i64]) -> Vec<i64> {
    let mut order: Vec<i64> = (0..codes.len() as i64).collect();
    order.sort_by_key(|&i| codes[i as usize]);
    order
}

/// Which points a kernel joins: of each tap but the middle one, the points read and those written.
///
/// A cell is represented by its first point. Taps before the middle carry all points of a cell to the first
/// of the other, those after it the first of a cell to all points of the other: spconv's rule on the CPU,
/// where its rule on GPUs leaves open which point counts. The middle tap is the point itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taps {
    /// Cells along a side of the kernel; odd.
    pub side: usize,
    /// Of each tap before the middle, points read and points written; the tap opposite has the two exchanged.
    pub pairs: Vec<(Vec<i64>, Vec<i64>)>,
}

impl Taps {
    /// Of points in cells of clouds, one after another.
    pub fn new(cells: &[[u32; 3]], sizes: &[usize], side: usize) -> Self {
        Places::new(cells, &batches(sizes)).taps(side)
    }
}

/// The first point of each cell of each cloud.
struct Places<'a> {
    cells: &'a [[u32; 3]],
    batch: &'a [usize],
    first: HashMap<u64, i64, BuildHasherDefault<Mix>>,
}

/// 17 bits an axis, so that a step beyond the last cell is no other cell.
fn key([x, y, z]: [i64; 3], batch: usize) -> u64 {
    let axis = |a: i64| (a + 8) as u64 & 0x1_ffff;
    (batch as u64) << 51 | axis(x) << 34 | axis(y) << 17 | axis(z)
}

impl<'a> Places<'a> {
    fn new(cells: &'a [[u32; 3]], batch: &'a [usize]) -> Self {
        let mut first = HashMap::with_capacity_and_hasher(cells.len(), BuildHasherDefault::default());
        for (i, (cell, b)) in cells.iter().zip(batch).enumerate() {
            first.entry(key(cell.map(i64::from), *b)).or_insert(i as i64);
        }
        Self { cells, batch, first }
    }

    fn taps(&self, side: usize) -> Taps {
        let half = (side / 2) as i64;
        let pairs = (0..side.pow(3) / 2).map(|tap| {
            let away = [tap / (side * side), tap / side % side, tap % side].map(|s| s as i64 - half);
            let (mut read, mut written) = (Vec::new(), Vec::new());
            for (i, (cell, b)) in self.cells.iter().zip(self.batch).enumerate() {
                let other = std::array::from_fn(|k| i64::from(cell[k]) - away[k]);
                if let Some(&o) = self.first.get(&key(other, *b)) {
                    read.push(i as i64);
                    written.push(o);
                }
            }
            (read, written)
        });
        Taps { side, pairs: pairs.collect() }
    }
}

/// Keys are places already; one multiplication spreads them (Fibonacci hashing). Cells are no attacker's choice
/// of much: a cloud has as many as it has points.
#[derive(Default)]
struct Mix(u64);

impl Hasher for Mix {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u64(u64::from(*b)));
    }

    fn write_u64(&mut self, n: u64) {
        let h = (self.0 ^ n).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = h ^ (h >> 29);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Ordered points cut into patches of one length, within which attention looks.
///
/// A cloud no larger than a patch is one by itself. In others the last patch is completed with the points
/// right before it, whose results there are dropped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Patches {
    /// Which place of the order stands where in the patches.
    pub pad: Vec<i64>,
    /// Where in the patches the result of each place stands.
    pub unpad: Vec<i64>,
    /// Points of each patch.
    pub lengths: Vec<i64>,
}

impl Patches {
    /// Of clouds of so many points.
    pub fn new(sizes: &[usize], patch: usize) -> Self {
        let patch = patch.max(1);
        let mut out = Self { pad: Vec::new(), unpad: Vec::new(), lengths: Vec::new() };
        let mut start = 0;
        for &n in sizes.iter().filter(|n| **n > 0) {
            out.unpad.extend((0..n).map(|i| (out.pad.len() + i) as i64));
            out.pad.extend((start..start + n).map(|i| i as i64));
            let over = n % patch;
            if n > patch && over > 0 {
                // What stands one patch length before.
                out.pad.extend((start + n - patch..start + n - over).map(|i| i as i64));
            }
            if n <= patch {
                out.lengths.push(n as i64);
            } else {
                out.lengths.extend(std::iter::repeat_n(patch as i64, n.div_ceil(patch)));
            }
            start += n;
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_patch_is_completed_with_what_is_before_it() {
        let p = Patches::new(&[3, 5, 0, 4], 4);
        assert_eq!(p.pad, [0, 1, 2, 3, 4, 5, 6, 7, 4, 5, 6, 8, 9, 10, 11]);
        assert_eq!(p.unpad, [0, 1, 2, 3, 4, 5, 6, 7, 11, 12, 13, 14]);
        assert_eq!(p.lengths, [3, 4, 4, 4]);
    }

    #[test]
    fn taps_join_cells_of_one_cloud_only() {
        let cells = vec![[0, 0, 0], [0, 0, 1], [0, 0, 1]];
        let t = Taps::new(&cells, &[2, 1], 3);
        let pairs: Vec<_> = t.pairs.iter().enumerate().filter(|(_, p)| !p.0.is_empty()).collect();
        // Tap 12 reads from one cell lower in z.
        assert_eq!(pairs, [(12, &(vec![0], vec![1]))]);
        let far = Taps::new(&[[65_535; 3], [0; 3]], &[2], 5);
        assert!(far.pairs.iter().all(|p| p.0.is_empty()));
    }

    #[test]
    fn anything_has_a_place() {
        let odd = [[f32::NAN; 3], [f32::INFINITY; 3], [-f32::MAX; 3], [0.0; 3]];
        let layout = Layout::new(&odd, &[4], 0.01);
        assert!(layout.orders.iter().all(|o| o.len() == 4) && layout.orders.len() == 4);
        assert!(Layout::new(&[], &[], 0.01).orders.iter().all(Vec::is_empty));
    }
}
