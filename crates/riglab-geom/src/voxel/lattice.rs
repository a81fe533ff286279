//! Which cells there are, and which of them are occupied.

use std::sync::atomic::{AtomicU64, Ordering};

use riglab_core::{Bounds, Mesh};

/// Most cells along a side; finer lattices are cut to it.
pub const MOST_CELLS: usize = 512;

/// Cubes side by side: cell (i, j, k) spans `origin + cell * [i, i + 1)` along x, and so on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// The corner with the smallest coordinates.
    pub origin: [f64; 3],
    /// The edge of a cell, in the mesh's units; positive.
    pub cell: f64,
    /// How many cells along each axis.
    pub size: [usize; 3],
}

impl Lattice {
    /// `resolution` cells along the longest side of the mesh's box, from 2 to [`MOST_CELLS`]; the box's
    /// ends are half a cell from the lattice's. A mesh without extent gets one cell of edge 1.
    pub fn around(mesh: &Mesh, resolution: usize) -> Self {
        let resolution = resolution.clamp(2, MOST_CELLS);
        let (min, extent) = extent(mesh);
        let longest = extent.into_iter().fold(0.0, f64::max);
        let cell = if longest > 0.0 { longest / (resolution - 1) as f64 } else { 1.0 };
        let size = extent.map(|e| ((e / cell).round() as usize + 1).min(resolution));
        // Where a side is no multiple of the edge, the rest is shared by both ends.
        let origin = std::array::from_fn(|k| min[k] + 0.5 * (extent[k] - size[k] as f64 * cell));
        Self { origin, cell, size }
    }

    /// That of UniRig's surface voxels: cells of edge 2 / `grid` around a mesh in [-1, 1]³, the first half a
    /// cell before its smallest corner.
    pub fn unirig(mesh: &Mesh, grid: usize) -> Self {
        let cell = 2.0 / grid.clamp(1, MOST_CELLS) as f64;
        let (min, extent) = extent(mesh);
        let size = extent.map(|e| ((e / cell + 0.5).floor() as usize + 1).min(MOST_CELLS + 1));
        Self { origin: min.map(|x| x - 0.5 * cell), cell, size }
    }

    /// The number of cells.
    pub fn cells(&self) -> usize {
        self.size.iter().product()
    }

    /// The number of a cell; z runs fastest.
    #[inline]
    pub fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (x * self.size[1] + y) * self.size[2] + z
    }

    /// The cell of a number.
    #[inline]
    pub fn place(&self, index: usize) -> [usize; 3] {
        let (row, z) = (index / self.size[2], index % self.size[2]);
        [row / self.size[1], row % self.size[1], z]
    }

    /// The middle of a cell.
    #[inline]
    pub fn center(&self, place: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|k| self.origin[k] + (place[k] as f64 + 0.5) * self.cell)
    }

    /// The cell that a point lies in; `None` outside of the lattice.
    #[inline]
    pub fn find(&self, p: [f64; 3]) -> Option<[usize; 3]> {
        let at = self.scaled(p).map(f64::floor);
        let inside = (0..3).all(|k| at[k] >= 0.0 && at[k] < self.size[k] as f64);
        inside.then(|| at.map(|x| x as usize))
    }

    /// The cell that a point lies in or is nearest to.
    #[inline]
    pub fn nearest(&self, p: [f64; 3]) -> [usize; 3] {
        let at = self.scaled(p);
        std::array::from_fn(|k| (at[k].max(0.0) as usize).min(self.size[k] - 1))
    }

    /// A point in units of cells, from the origin.
    #[inline]
    pub fn scaled(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| (p[k] - self.origin[k]) / self.cell)
    }
}

/// The smallest corner of a mesh's box, and its sides.
pub(crate) fn extent(mesh: &Mesh) -> ([f64; 3], [f64; 3]) {
    let points = mesh.positions().iter().copied();
    let bounds = Bounds::of(points).unwrap_or(Bounds { min: [0.0; 3], max: [0.0; 3] });
    let (min, max) = (bounds.min.map(f64::from), bounds.max.map(f64::from));
    (min, std::array::from_fn(|k| max[k] - min[k]))
}

/// A lattice with some of its cells occupied.
#[derive(Clone, Debug, PartialEq)]
pub struct Voxels {
    lattice: Lattice,
    /// A bit a cell, in the order of their numbers.
    words: Vec<u64>,
}

impl Voxels {
    /// With the given cells occupied; those that the lattice does not have are passed over.
    pub fn new(lattice: Lattice, cells: impl IntoIterator<Item = [usize; 3]>) -> Self {
        let mut voxels = Self { words: vec![0; lattice.cells().div_ceil(64)], lattice };
        for place in cells {
            if (0..3).all(|k| place[k] < lattice.size[k]) {
                voxels.set(lattice.index(place));
            }
        }
        voxels
    }

    pub(crate) fn from_words(lattice: Lattice, words: Vec<u64>) -> Self {
        Self { lattice, words }
    }

    pub(crate) fn words(&self) -> &[u64] {
        &self.words
    }

    #[inline]
    pub(crate) fn set(&mut self, index: usize) {
        self.words[index / 64] |= 1 << (index % 64);
    }

    /// Where the cells lie.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// How many cells are occupied.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// The volume of the occupied cells, in cubes of the mesh's unit.
    pub fn volume(&self) -> f64 {
        self.count() as f64 * self.lattice.cell.powi(3)
    }

    /// Whether the cell of a number is occupied.
    #[inline]
    pub fn has(&self, index: usize) -> bool {
        self.words[index / 64] >> (index % 64) & 1 == 1
    }

    /// Whether a cell is occupied; those outside of the lattice are not.
    #[inline]
    pub fn is_occupied(&self, place: [isize; 3]) -> bool {
        let inside = (0..3).all(|k| place[k] >= 0 && (place[k] as usize) < self.lattice.size[k]);
        inside && self.has(self.lattice.index(place.map(|x| x as usize)))
    }

    /// Whether a point lies in an occupied cell.
    #[inline]
    pub fn contains(&self, p: [f64; 3]) -> bool {
        self.lattice.find(p).is_some_and(|place| self.has(self.lattice.index(place)))
    }

    /// The numbers of the occupied cells, rising.
    pub fn indices(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().flat_map(|(w, &word)| {
            let mut left = word;
            std::iter::from_fn(move || {
                (left != 0).then(|| {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    w * 64 + bit
                })
            })
        })
    }

    /// The occupied cells, by rising number.
    pub fn places(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.indices().map(|i| self.lattice.place(i))
    }

    /// Adds the occupied cells of the same lattice's other voxels.
    pub(crate) fn add(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a |= b);
    }
}

/// Bits that several threads set.
pub(crate) struct SharedBits(Vec<AtomicU64>);

impl SharedBits {
    pub(crate) fn new(bits: usize) -> Self {
        Self((0..bits.div_ceil(64)).map(|_| AtomicU64::new(0)).collect())
    }

    #[inline]
    pub(crate) fn set(&self, index: usize) {
        let (word, bit) = (&self.0[index / 64], 1 << (index % 64));
        // Most are set already, which costs less to see than to repeat.
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    }

    pub(crate) fn into_words(self) -> Vec<u64> {
        self.0.into_iter().map(AtomicU64::into_inner).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice() -> Lattice {
        Lattice { origin: [-1.0, 0.0, 2.0], cell: 0.5, size: [4, 3, 50] }
    }

    #[test]
    fn numbers_and_places_are_inverse() {
        let l = lattice();
        assert!((0..l.cells()).all(|i| l.index(l.place(i)) == i));
        assert_eq!(l.find(l.center([3, 2, 49])), Some([3, 2, 49]));
        assert_eq!((l.find([-1.0, 0.0, 2.0]), l.find([1.0, 0.0, 2.0])), (Some([0; 3]), None));
        assert_eq!((l.find([f64::NAN; 3]), l.nearest([9.0, -9.0, 2.6])), (None, [3, 0, 1]));
    }

    #[test]
    fn occupied_cells_come_in_order() {
        let voxels = Voxels::new(lattice(), [[3, 2, 49], [0, 0, 1], [1, 1, 1], [4, 0, 0]]);
        assert_eq!(voxels.places().collect::<Vec<_>>(), [[0, 0, 1], [1, 1, 1], [3, 2, 49]]);
        assert_eq!((voxels.count(), voxels.volume()), (3, 0.375));
        assert!(voxels.contains([-0.9, 0.1, 2.6]) && !voxels.is_occupied([-1, 0, 0]));
    }

    #[test]
    fn the_longest_side_has_as_many_cells_as_asked() {
        let mesh = |x: f32, y: f32| Mesh::new(vec![[0.0; 3], [x, y, 0.0]], vec![[0, 1, 1]]).unwrap();
        let l = Lattice::around(&mesh(10.0, 2.6), 11);
        assert_eq!((l.size, l.cell), ([11, 4, 1], 1.0));
        assert!((l.origin[0] + 0.5).abs() < 1e-9 && (l.origin[1] + 0.7).abs() < 1e-6);
        assert_eq!(Lattice::around(&mesh(0.0, 0.0), 64).size, [1; 3]);
        assert_eq!(Lattice::around(&mesh(3e38, 1e-38), 1_000_000).size, [MOST_CELLS, 1, 1]);
    }
}
