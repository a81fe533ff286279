//! Occupied cells, and the blocks of them that ways lead over.

use crate::voxel::{Lattice, Voxels};

/// Empty cells around the lattice, so that neighbours and sights need no look at its limits.
const MARGIN: usize = 4;

/// No node.
const NONE: u32 = u32::MAX;

/// Occupied cells in bricks of 4³, a word of bits each, for sights; and nodes, for ways: the occupied cells of
/// a block of 2³. Blocks are neighbours where a cell of one and a cell of the other share a face, so a gap of a
/// single cell parts them. A way's corners are nodes, an eighth as many as cells.
pub(super) struct Body {
    lattice: Lattice,
    bricks: [usize; 3],
    words: Vec<u64>,
    /// Occupied cells of the bricks before.
    before: Vec<u32>,
    /// How many layers of cells around each occupied cell are occupied, and 1.
    depths: Vec<u8>,
    /// Blocks along each axis, and the node of each.
    blocks: [usize; 3],
    nodes: Vec<u32>,
    /// The cell that stands for a node: the one with the fewest layers around it, since ways turn at walls.
    places: Vec<[u16; 3]>,
    /// The nodes across each face.
    beside: Vec<[u32; 6]>,
}

impl Body {
    pub(super) fn new(voxels: &Voxels) -> Self {
        let lattice = *voxels.lattice();
        let bricks = lattice.size.map(|n| (n + 2 * MARGIN).div_ceil(4));
        let blocks = bricks.map(|n| 2 * n);
        let mut body = Self {
            lattice,
            bricks,
            words: vec![0; bricks.iter().product()],
            before: Vec::new(),
            depths: Vec::with_capacity(voxels.count()),
            blocks,
            nodes: vec![NONE; blocks.iter().product()],
            places: Vec::new(),
            beside: Vec::new(),
        };
        for place in voxels.places() {
            let (brick, bit) = body.bit(place.map(|x| (x + MARGIN) as u32));
            body.words[brick] |= 1 << bit;
        }
        let depths = depths(voxels);
        for brick in 0..body.words.len() {
            body.before.push(body.depths.len() as u32);
            let corner = [brick / bricks[2] / bricks[1], brick / bricks[2] % bricks[1], brick % bricks[2]];
            let mut left = body.words[brick];
            while left != 0 {
                let bit = left.trailing_zeros() as usize;
                left &= left - 1;
                let within = [bit >> 4, bit >> 2 & 3, bit & 3];
                let place: [usize; 3] = std::array::from_fn(|k| 4 * corner[k] + within[k]);
                let depth = depths[lattice.index(place.map(|x| x - MARGIN))];
                body.depths.push(depth);
                body.add(place, depth, &depths);
            }
        }
        body.beside = (0..body.len() as u32).map(|node| body.neighbours(node)).collect();
        body
    }

    /// Adds a cell to the node of its block.
    fn add(&mut self, place: [usize; 3], depth: u8, depths: &[u8]) {
        let block = self.block(place.map(|x| x as u32));
        let place = place.map(|x| x as u16);
        match self.nodes[block] {
            NONE => {
                self.nodes[block] = self.places.len() as u32;
                self.places.push(place);
            }
            node => {
                let old = self.places[node as usize];
                if depth < depths[self.lattice.index(old.map(|x| usize::from(x) - MARGIN))] {
                    self.places[node as usize] = place;
                }
            }
        }
    }

    /// The nodes whose cells share faces with those of a node.
    fn neighbours(&self, node: u32) -> [u32; 6] {
        let corner = self.place(node).map(|x| x & !1);
        let mut found = [NONE; 6];
        for (face, found) in found.iter_mut().enumerate() {
            let (axis, up) = (face / 2, face % 2 == 1);
            for i in 0..4 {
                let mut inner = corner;
                inner[(axis + 1) % 3] += i & 1;
                inner[(axis + 2) % 3] += i >> 1;
                inner[axis] += u32::from(up);
                let mut outer = inner;
                outer[axis] = if up { outer[axis] + 1 } else { outer[axis] - 1 };
                if self.has(inner) && self.has(outer) {
                    *found = self.nodes[self.block(outer)];
                }
            }
        }
        found
    }

    #[inline]
    fn block(&self, [x, y, z]: [u32; 3]) -> usize {
        ((x >> 1) as usize * self.blocks[1] + (y >> 1) as usize) * self.blocks[2] + (z >> 1) as usize
    }

    /// Where the cells lie.
    pub(super) fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// How many nodes.
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    /// Where a node's cell is.
    #[inline]
    pub(super) fn place(&self, node: u32) -> [u32; 3] {
        self.places[node as usize].map(u32::from)
    }

    /// Its middle, in edges of a cell from the margin's corner less half an edge: its place.
    #[inline]
    pub(super) fn middle(&self, node: u32) -> glam::Vec3A {
        glam::Vec3A::from(self.places[node as usize].map(f32::from))
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

    /// The number of an occupied place's cell.
    #[inline]
    fn number(&self, place: [u32; 3]) -> Option<u32> {
        let (brick, bit) = self.bit(place);
        let word = self.words[brick];
        (word >> bit & 1 == 1).then(|| self.before[brick] + (word & ((1 << bit) - 1)).count_ones())
    }

    /// The node of an occupied place.
    #[inline]
    pub(super) fn node(&self, place: [u32; 3]) -> Option<u32> {
        self.has(place).then(|| self.nodes[self.block(place)])
    }

    /// The nodes across the faces of a node.
    #[inline]
    pub(super) fn beside(&self, node: u32) -> impl Iterator<Item = u32> + use<> {
        self.beside[node as usize].into_iter().filter(|n| *n != NONE)
    }

    /// The nodes across the faces of a node, and those across theirs as far as their blocks touch its own.
    pub(super) fn around(&self, node: u32) -> impl Iterator<Item = u32> + '_ {
        let block = self.place(node).map(|x| x >> 1);
        let touches = move |other: u32| {
            let place = self.place(other);
            other != node && (0..3).all(|k| (place[k] >> 1).abs_diff(block[k]) <= 1)
        };
        self.beside(node).flat_map(move |first| {
            std::iter::once(first).chain(self.beside(first).filter(move |second| touches(*second)))
        })
    }

    /// All occupied places.
    pub(super) fn occupied(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        let [_, ny, nz] = self.bricks;
        let set = |word: u64| (0..64u32).filter(move |bit| word >> bit & 1 == 1);
        self.words.iter().enumerate().filter(|(_, word)| **word != 0).flat_map(move |(brick, word)| {
            let corner = [brick / nz / ny, brick / nz % ny, brick % nz].map(|x| 4 * x as u32);
            set(*word).map(move |bit| [corner[0] + (bit >> 4), corner[1] + (bit >> 2 & 3), corner[2] + (bit & 3)])
        })
    }

    /// Whether a way from the middle of a cell straight to a point runs through the body.
    ///
    /// On each layer of cells along its longest axis one of the four cells that surround the way there must be
    /// occupied: what is thinner than a cell does not end a sight, a gap of two cells does.
    pub(super) fn sees(&self, place: [u32; 3], to: glam::Vec3A) -> bool {
        let way = to - glam::Vec3A::from(place.map(|x| x as f32));
        let most = way.abs().max_element();
        // The layers between, without those of both ends.
        let layers = most.ceil() as i32 - 1;
        if layers <= 0 {
            return true;
        }
        // In whole numbers, 2¹⁶ a cell: the way stays in the lattice and its margin, as it ends where nothing
        // around it is occupied.
        let step = (way * (65536.0 / most)).to_array().map(|x| x as i32);
        let mut layer = 1;
        while layer <= layers {
            let p: [i32; 3] = std::array::from_fn(|k| ((place[k] as i32) << 16) + layer * step[k]);
            let near = p.map(|x| ((x + 0x8000) >> 16) as u32);
            if let Some(cell) = self.number(near) {
                // All that surrounds the way on the next layers is occupied.
                layer += i32::from(self.depths[cell as usize]);
                continue;
            }
            layer += 1;
            let one = |mask: u32| {
                let pick = |k: usize| ((p[k] + if mask >> k & 1 == 1 { 0xffff } else { 0 }) >> 16) as u32;
                self.has([pick(0), pick(1), pick(2)])
            };
            if !(0..8).any(one) {
                return false;
            }
        }
        true
    }
}

/// For each occupied cell of the lattice how many layers around it are occupied, and 1, at most 255; 0 for
/// the others. Two sweeps, as steps along sides, edges and corners count the same.
fn depths(voxels: &Voxels) -> Vec<u8> {
    let lattice = voxels.lattice();
    let mut depths = vec![0u8; lattice.cells()];
    let [sx, sy] = [lattice.size[1] * lattice.size[2], lattice.size[2]];
    let cells: Vec<usize> = voxels.indices().collect();
    let border = |place: [usize; 3]| (0..3).any(|k| place[k] == 0 || place[k] + 1 == lattice.size[k]);
    for &cell in &cells {
        let place = lattice.place(cell);
        let least = if border(place) {
            0
        } else {
            // Those that come before: the layer below, the row before, the cell before.
            let below = cell - sx;
            let row = |c: usize| depths[c - 1].min(depths[c]).min(depths[c + 1]);
            row(below - sy).min(row(below)).min(row(below + sy)).min(row(cell - sy)).min(depths[cell - 1])
        };
        depths[cell] = least.saturating_add(1);
    }
    for &cell in cells.iter().rev() {
        if depths[cell] > 1 {
            let above = cell + sx;
            let row = |c: usize| depths[c - 1].min(depths[c]).min(depths[c + 1]);
            let least = row(above - sy).min(row(above)).min(row(above + sy)).min(row(cell + sy)).min(depths[cell + 1]);
            depths[cell] = depths[cell].min(least.saturating_add(1));
        }
    }
    depths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_is_as_deep_as_layers_around_it_are_full() {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [9, 9, 11] };
        let holes = [[4, 4, 2], [1, 8, 8]];
        let all = (0..lattice.cells()).map(|i| lattice.place(i));
        let voxels = Voxels::new(lattice, all.filter(|p| !holes.contains(p)));
        for (index, depth) in depths(&voxels).into_iter().enumerate() {
            let p = lattice.place(index).map(|x| x as i32);
            let ends = (0..3).map(|k| p[k].min(lattice.size[k] as i32 - 1 - p[k]) + 1).min().unwrap();
            let hole = |h: &[usize; 3]| (0..3).map(|k| (p[k] - h[k] as i32).abs()).max().unwrap();
            let wanted = holes.iter().map(hole).min().unwrap().min(ends);
            assert_eq!(i32::from(depth), wanted, "{p:?}");
        }
    }

    fn body(cells: impl IntoIterator<Item = [usize; 3]>) -> Body {
        Body::new(&Voxels::new(Lattice { origin: [0.0; 3], cell: 0.5, size: [9, 7, 30] }, cells))
    }

    #[test]
    fn nodes_are_neighbours_where_their_cells_are() {
        let b = body((0..9 * 7 * 30).filter(|i| i % 3 != 0).map(|i| [i / 210, i / 30 % 7, i % 30]));
        assert_eq!(b.occupied().count(), 9 * 7 * 20);
        for place in b.occupied() {
            let node = b.node(place).unwrap();
            assert!((0..3).all(|k| b.place(node)[k] >> 1 == place[k] >> 1));
            for axis in 0..3 {
                let mut next = place;
                next[axis] += 1;
                if let Some(other) = b.node(next).filter(|other| *other != node) {
                    assert!(b.beside(node).any(|n| n == other) && b.beside(other).any(|n| n == node));
                    assert!(b.around(node).any(|n| n == other));
                }
            }
        }
        assert_eq!(b.at(b.inner([0.6, 0.0, 0.3])), [5, 4, 4]);
        // A gap of a cell parts blocks.
        let parted = body([[0, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0], [6, 0, 0]]);
        assert_eq!((0..4).map(|n| parted.beside(n).count()).collect::<Vec<_>>(), [0, 0, 1, 1]);
    }

    #[test]
    fn a_gap_of_two_cells_ends_a_sight() {
        for (gap, seen) in [(0, true), (1, true), (2, false), (3, false)] {
            let b = body((0..30).filter(|z| !(10..10 + gap).contains(z)).flat_map(|z| [[4, 3, z], [5, 3, z]]));
            let straight = b.sees([8, 7, 4], glam::Vec3A::new(8.0, 7.0, 30.0));
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
