//! Occupied cells with their neighbours, in an order that keeps near ones together.

use crate::voxel::{Lattice, Voxels};

/// Empty cells around the lattice, so that neighbours and sights need no look at its limits.
const MARGIN: usize = 4;

/// Occupied cells in bricks of 4³, a word of bits each.
pub(super) struct Body {
    lattice: Lattice,
    bricks: [usize; 3],
    words: Vec<u64>,
    /// Occupied cells of the bricks before.
    before: Vec<u32>,
    /// Where each cell is, counted from the margin's corner.
    cells: Vec<[u16; 3]>,
}

impl Body {
    pub(super) fn new(voxels: &Voxels) -> Self {
        let lattice = *voxels.lattice();
        let bricks = lattice.size.map(|n| (n + 2 * MARGIN).div_ceil(4));
        let mut body = Self {
            lattice,
            bricks,
            words: vec![0; bricks.iter().product()],
            before: Vec::new(),
            cells: Vec::with_capacity(voxels.count()),
        };
        for place in voxels.places() {
            let (brick, bit) = body.bit(place.map(|x| (x + MARGIN) as u32));
            body.words[brick] |= 1 << bit;
        }
        for (brick, &word) in body.words.iter().enumerate() {
            body.before.push(body.cells.len() as u32);
            let corner = [brick / bricks[2] / bricks[1], brick / bricks[2] % bricks[1], brick % bricks[2]];
            let mut left = word;
            while left != 0 {
                let bit = left.trailing_zeros() as usize;
                left &= left - 1;
                let within = [bit >> 4, bit >> 2 & 3, bit & 3];
                body.cells.push(std::array::from_fn(|k| (4 * corner[k] + within[k]) as u16));
            }
        }
        body
    }

    /// Where the cells lie.
    pub(super) fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// How many cells.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Where a cell is.
    #[inline]
    pub(super) fn place(&self, cell: u32) -> [u32; 3] {
        self.cells[cell as usize].map(u32::from)
    }

    /// A cell's middle, in edges of a cell from the margin's corner less half an edge: its place.
    #[inline]
    pub(super) fn middle(&self, cell: u32) -> glam::Vec3A {
        glam::Vec3A::from(self.cells[cell as usize].map(f32::from))
    }

    /// A point of the mesh's space in the units of [`Self::middle`].
    pub(super) fn inner(&self, p: [f32; 3]) -> glam::Vec3A {
        let at = self.lattice.scaled(p.map(f64::from));
        // Where lattices end: what is farther off is as good as there.
        glam::Vec3A::from(at.map(|x| (x + MARGIN as f64 - 0.5).clamp(-1e6, 1e6) as f32))
    }

    /// The place that a point of those units lies in or is nearest to.
    #[inline]
    pub(super) fn at(&self, p: glam::Vec3A) -> [u32; 3] {
        let p = p.to_array();
        std::array::from_fn(|k| {
            let most = self.lattice.size[k] + MARGIN - 1;
            (p[k] + 0.5).clamp(MARGIN as f32, most as f32) as u32
        })
    }

    #[inline]
    fn bit(&self, [x, y, z]: [u32; 3]) -> (usize, u32) {
        let brick = ((x >> 2) as usize * self.bricks[1] + (y >> 2) as usize) * self.bricks[2] + (z >> 2) as usize;
        (brick, (x & 3) << 4 | (y & 3) << 2 | (z & 3))
    }

    /// Whether a place, of the lattice or its margin, is occupied.
    #[inline]
    pub(super) fn has(&self, place: [u32; 3]) -> bool {
        let (brick, bit) = self.bit(place);
        self.words[brick] >> bit & 1 == 1
    }

    /// The cell at a place.
    #[inline]
    pub(super) fn number(&self, place: [u32; 3]) -> Option<u32> {
        let (brick, bit) = self.bit(place);
        let word = self.words[brick];
        (word >> bit & 1 == 1).then(|| self.before[brick] + (word & ((1 << bit) - 1)).count_ones())
    }

    /// The cells across the six faces of a place.
    #[inline]
    pub(super) fn beside(&self, [x, y, z]: [u32; 3]) -> [Option<u32>; 6] {
        [[x - 1, y, z], [x + 1, y, z], [x, y - 1, z], [x, y + 1, z], [x, y, z - 1], [x, y, z + 1]]
            .map(|place| self.number(place))
    }

    /// The cells across the faces, edges and corners of a place.
    pub(super) fn around(&self, [x, y, z]: [u32; 3]) -> impl Iterator<Item = u32> + '_ {
        let steps = (0..27).filter(|s| *s != 13);
        steps.filter_map(move |s: u32| self.number([x + s / 9 - 1, y + s / 3 % 3 - 1, z + s % 3 - 1]))
    }

    /// Whether a way from the middle of a cell straight to a point runs through the body.
    ///
    /// On each layer of cells along its longest axis one of the four cells that surround the way there must be
    /// occupied: what is thinner than a cell does not end a sight, a gap of two cells does.
    pub(super) fn sees(&self, place: [u32; 3], to: glam::Vec3A) -> bool {
        let from = glam::Vec3A::from(place.map(|x| x as f32));
        let way = to - from;
        let most = way.abs().max_element();
        // The layers between, without those of both ends.
        let layers = most.ceil() as i32 - 1;
        if layers <= 0 {
            return true;
        }
        let step = way / most;
        let mut p = from;
        for _ in 0..layers {
            p += step;
            let near = (p + 0.5).as_uvec3().to_array();
            if self.has(near) {
                continue;
            }
            let (low, high) = (p.floor().as_uvec3(), p.ceil().as_uvec3());
            let one = |mask: u32| {
                let pick = |k: usize| if mask >> k & 1 == 1 { high[k] } else { low[k] };
                self.has([pick(0), pick(1), pick(2)])
            };
            if !(0..8).any(one) {
                return false;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(cells: impl IntoIterator<Item = [usize; 3]>) -> Body {
        Body::new(&Voxels::new(Lattice { origin: [0.0; 3], cell: 0.5, size: [9, 7, 30] }, cells))
    }

    #[test]
    fn numbers_places_and_neighbours_agree() {
        let b = body((0..9 * 7 * 30).filter(|i| i % 3 != 0).map(|i| [i / 210, i / 30 % 7, i % 30]));
        for cell in 0..b.len() as u32 {
            let place = b.place(cell);
            assert_eq!(b.number(place), Some(cell));
            let beside: Vec<_> = b.beside(place).into_iter().flatten().collect();
            assert!(beside.iter().all(|c| (b.middle(*c) - b.middle(cell)).length() == 1.0));
            assert_eq!(
                b.around(place).filter(|c| (b.middle(*c) - b.middle(cell)).length() == 1.0).count(),
                beside.len()
            );
        }
        assert_eq!(b.at(b.inner([0.6, 0.0, 0.3])), [5, 4, 4]);
    }

    #[test]
    fn a_gap_of_two_cells_ends_a_sight() {
        for (gap, seen) in [(0, true), (1, true), (2, false), (3, false)] {
            let b = body((0..30).filter(|z| !(10..10 + gap).contains(z)).flat_map(|z| [[4, 3, z], [5, 3, z]]));
            let from = b.number([8, 7, 4]).unwrap();
            let straight = b.sees(b.place(from), glam::Vec3A::new(8.0, 7.0, 30.0));
            // Along the layers there is nothing beside a gap.
            assert_eq!(straight, seen && gap == 0, "{gap}");
        }
        let walls = |gap: usize| body((0..9).flat_map(|x| (0..30).flat_map(move |z| [[x, 0, z], [x, 1 + gap, z]])));
        for (gap, seen) in [(0, true), (1, true), (2, false)] {
            let to = glam::Vec3A::new(6.0, 5.0 + gap as f32, 33.0);
            assert_eq!(walls(gap).sees([6, 4, 4], to), seen, "{gap}");
        }
    }
}
