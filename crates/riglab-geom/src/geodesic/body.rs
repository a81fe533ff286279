//! Occupied cells, and the blocks of them that ways lead over.

use riglab_core::Segment;

use crate::voxel::{Lattice, Voxels};

/// Empty cells around the lattice, so that neighbours and sights need no look at its limits.
const MARGIN: usize = 4;

/// Sights of more layers than any lattice has do not end in it; of so many, places are still numbers of 32 bits.
const FARTHEST: i32 = 1 << 14;

/// Segments that are so many times as long as a lattice's diagonal are not followed from end to end.
const FAR: f64 = 10.0;

/// No node.
const NONE: u32 = u32::MAX;

/// The depth of each cell, in bricks of 4³, for sights; and nodes, for ways: the occupied cells of a block of 2³.
/// Blocks are neighbours where a cell of one and a cell of the other share a face, so a gap of a single cell parts
/// them. A way's corners are nodes, an eighth as many as cells.
pub(super) struct Body {
    lattice: Lattice,
    bricks: [usize; 3],
    /// What a place's coordinate along each axis adds to its number in `depths`. A look costs less than to divide.
    offsets: [Vec<u32>; 3],
    /// How many layers of cells around each occupied place are occupied, and 1; 0 for the others. A brick's are a
    /// line of memory, as what a sight passes lies together.
    depths: Vec<u8>,
    /// Blocks along each axis, and the node of each.
    blocks: [usize; 3],
    nodes: Vec<u32>,
    /// The cell that stands for a node: the one with the fewest layers around it, since ways turn at walls.
    places: Vec<[u16; 3]>,
    /// The same as points.
    middles: Vec<glam::Vec3A>,
    /// Which cells of its block a node has: a bit each, x the highest of its number.
    cells: Vec<u8>,
    /// The nodes across each face.
    beside: Vec<[u32; 6]>,
}

impl Body {
    pub(super) fn new(voxels: &Voxels) -> Self {
        let lattice = *voxels.lattice();
        let bricks = lattice.size.map(|n| (n + 2 * MARGIN).div_ceil(4));
        let blocks = bricks.map(|n| 2 * n);
        let strides = [64 * bricks[1] * bricks[2], 64 * bricks[2], 64];
        let offset = |k: usize, x: usize| (x / 4 * strides[k] + ((x % 4) << (4 - 2 * k))) as u32;
        let mut body = Self {
            lattice,
            bricks,
            offsets: std::array::from_fn(|k| (0..4 * bricks[k]).map(|x| offset(k, x)).collect()),
            depths: vec![0; 64 * bricks.iter().product::<usize>()],
            blocks,
            nodes: vec![NONE; blocks.iter().product()],
            places: Vec::new(),
            middles: Vec::new(),
            cells: Vec::new(),
            beside: Vec::new(),
        };
        for (place, depth) in voxels.places().zip(depths(voxels)) {
            let [x, y, z] = place.map(|x| x + MARGIN);
            let number = body.offsets[0][x] + body.offsets[1][y] + body.offsets[2][z];
            body.depths[number as usize] = depth;
        }
        for place in body.occupied().collect::<Vec<_>>() {
            body.add(place);
        }
        body.middles = body.places.iter().map(|p| glam::Vec3A::from(p.map(f32::from))).collect();
        body.join();
        body
    }

    /// Adds a cell to the node of its block.
    fn add(&mut self, place: [u32; 3]) {
        let block = self.block(place);
        let node = self.nodes[block] as usize;
        let [x, y, z] = place.map(|x| x & 1);
        let (cell, place) = (1 << (x << 2 | y << 1 | z), place.map(|x| x as u16));
        if let Some(old) = self.places.get(node).copied() {
            self.cells[node] |= cell;
            if self.depth(place.map(u32::from)) < self.depth(old.map(u32::from)) {
                self.places[node] = place;
            }
        } else {
            self.nodes[block] = self.places.len() as u32;
            self.places.push(place);
            self.cells.push(cell);
        }
    }

    /// Joins nodes whose cells share faces.
    fn join(&mut self) {
        self.beside = vec![[NONE; 6]; self.len()];
        for node in 0..self.len() {
            let block = self.block(self.place(node as u32));
            let strides = [self.blocks[1] * self.blocks[2], self.blocks[2], 1];
            for (axis, stride) in strides.into_iter().enumerate() {
                // The margin has no nodes, so that there is always a block beside.
                let other = self.nodes[block + stride] as usize;
                // The upper cells of the one beside the lower ones of the other.
                let (shift, low) = [(4, 0b0000_1111), (2, 0b0011_0011), (1, 0b0101_0101)][axis];
                if self.cells.get(other).is_some_and(|cells| self.cells[node] >> shift & cells & low != 0) {
                    self.beside[node][2 * axis + 1] = other as u32;
                    self.beside[other][2 * axis] = node as u32;
                }
            }
        }
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
        self.middles[node as usize]
    }

    /// A point of the mesh's space in the units of [`Self::middle`].
    pub(super) fn inner(&self, p: [f32; 3]) -> glam::Vec3A {
        bounded(self.unbounded(p))
    }

    /// The ends of a segment in those units. Of one that is far longer than the lattice and runs through it, what lies
    /// around the lattice: nothing else is near any place, and its places are found by small steps.
    pub(super) fn part(&self, s: &Segment) -> [glam::Vec3A; 2] {
        let ends = [s.a, s.b].map(|p| self.unbounded(p));
        let (size, across) = (self.lattice.size.map(|n| n as f64), self.across());
        let length = (0..3).map(|k| (ends[1][k] - ends[0][k]).powi(2)).sum::<f64>().sqrt();
        let grown = |by: f64| {
            let low = MARGIN as f64 - 0.5;
            size.map(|n| (low - by, low + n + by))
        };
        if length.is_finite() && length > FAR * across && within(ends, grown(0.0)).is_some() {
            let within = within(ends, grown(across)).unwrap_or(ends);
            return within.map(bounded);
        }
        ends.map(bounded)
    }

    /// The length of the lattice's diagonal.
    fn across(&self) -> f64 {
        self.lattice.size.iter().map(|n| (n * n) as f64).sum::<f64>().sqrt()
    }

    /// Longer ones of [`Self::part`] run past the lattice. With room for rounding.
    pub(super) fn longest(&self) -> f32 {
        (FAR * self.across()) as f32 + 1.0
    }

    fn unbounded(&self, p: [f32; 3]) -> [f64; 3] {
        self.lattice.scaled(p.map(f64::from)).map(|x| x + MARGIN as f64 - 0.5)
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

    /// How many layers around a place, of the lattice or its margin, are occupied, and 1; 0 where it is empty.
    #[inline]
    fn depth(&self, place: [u32; 3]) -> u8 {
        let [x, y, z] = place.map(|x| x as usize);
        self.depths[(self.offsets[0][x] + self.offsets[1][y] + self.offsets[2][z]) as usize]
    }

    /// Whether a place, of the lattice or its margin, is occupied.
    #[inline]
    pub(super) fn has(&self, place: [u32; 3]) -> bool {
        self.depth(place) > 0
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

    /// Visits the nodes across the faces of a node, and those across theirs as far as their blocks touch its own; some
    /// of them twice.
    #[inline]
    pub(super) fn around(&self, node: u32, mut visit: impl FnMut(u32)) {
        let block = self.places[node as usize].map(|x| x >> 1);
        for first in self.beside(node) {
            visit(first);
            for second in self.beside(first) {
                let other = self.places[second as usize].map(|x| x >> 1);
                if second != node && (0..3).all(|k| other[k].abs_diff(block[k]) <= 1) {
                    visit(second);
                }
            }
        }
    }

    /// All occupied places, by bricks.
    pub(super) fn occupied(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        let [_, ny, nz] = self.bricks;
        let full =
            self.depths.chunks_exact(64).enumerate().filter(|(_, depths)| depths.iter().fold(0, |all, d| all | d) > 0);
        full.flat_map(move |(brick, depths)| {
            let corner = [brick / nz / ny, brick / nz % ny, brick % nz].map(|x| 4 * x as u32);
            let place = move |at: u32| [corner[0] + (at >> 4), corner[1] + (at >> 2 & 3), corner[2] + (at & 3)];
            (0..64u32).filter(|at| depths[*at as usize] > 0).map(place)
        })
    }

    /// Whether a way from the middle of an occupied cell straight to a point runs through the body.
    ///
    /// On each layer of cells along its longest axis one of the four cells that surround the way there must be
    /// occupied: what is thinner than a cell does not end a sight, a gap of two cells does.
    pub(super) fn sees(&self, middle: glam::Vec3A, to: glam::Vec3A) -> bool {
        let way = to - middle;
        let most = way.abs().max_element();
        // The layers between, without those of both ends.
        let whole = most as i32;
        let layers = whole - i32::from(whole as f32 == most);
        let place = middle.to_array().map(|x| x as i32);
        // All that surrounds the way on the first layers is occupied.
        let mut first = i32::from(self.depth(place.map(|x| x as u32))).max(1);
        if layers < first {
            return true;
        }
        if layers > FARTHEST {
            return false;
        }
        // In whole numbers, 2¹⁶ a cell.
        let step = (way * (65536.0 / most)).to_array().map(|x| x as i32);
        let at = |layer: i32| [0, 1, 2].map(|k| (place[k] << 16) + layer * step[k]);
        // From both ends: a look takes as long as memory does, and two at a time hardly longer.
        let mut last = layers;
        while first <= last {
            let (p, q) = (at(first), at(last));
            let (Some(front), Some(back)) = (self.nearest_depth(p), self.nearest_depth(q)) else { return false };
            if (front == 0 && !self.surrounded(p)) || (back == 0 && !self.surrounded(q)) {
                return false;
            }
            // All that surrounds the way on the next layers is occupied.
            first += front.max(1);
            last -= back.max(1);
        }
        true
    }

    /// The depth of the place nearest to a point, in 2¹⁶ a cell; none beyond the margin, where all is empty.
    #[inline]
    fn nearest_depth(&self, p: [i32; 3]) -> Option<i32> {
        let [x, y, z] = p.map(|x| ((x + 0x8000) >> 16) as usize);
        let number = self.offsets[0].get(x)? + self.offsets[1].get(y)? + self.offsets[2].get(z)?;
        Some(i32::from(self.depths[number as usize]))
    }

    /// Whether one of the places around a point is occupied.
    #[inline]
    fn surrounded(&self, p: [i32; 3]) -> bool {
        let ends = |k: usize| [p[k], p[k] + 0xffff].map(|x| self.offsets[k].get((x >> 16) as usize));
        let (x, y, z) = (ends(0), ends(1), ends(2));
        (0..8).any(|mask: usize| match (x[mask & 1], y[mask >> 1 & 1], z[mask >> 2]) {
            (Some(x), Some(y), Some(z)) => self.depths[(x + y + z) as usize] > 0,
            _ => false,
        })
    }
}

/// For each occupied cell, in their order, how many layers around it are occupied, and 1, at most 255. Two sweeps,
/// as steps along sides, edges and corners count the same.
fn depths(voxels: &Voxels) -> Vec<u8> {
    let lattice = voxels.lattice();
    let mut depths = vec![0u8; lattice.cells()];
    let [sx, sy] = [lattice.size[1] * lattice.size[2], lattice.size[2]];
    let cells: Vec<usize> = voxels.indices().collect();
    let border = |place: [usize; 3]| (0..3).any(|k| place[k] == 0 || place[k] + 1 == lattice.size[k]);
    for (&cell, place) in cells.iter().zip(voxels.places()) {
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
    cells.into_iter().map(|cell| depths[cell]).collect()
}

/// Where lattices end: what is farther off is as good as there.
fn bounded(p: [f64; 3]) -> glam::Vec3A {
    glam::Vec3A::from(p.map(|x| x.clamp(-1e6, 1e6) as f32))
}

/// The part of a segment that lies in a box of these spans.
fn within(ends: [[f64; 3]; 2], spans: [(f64, f64); 3]) -> Option<[[f64; 3]; 2]> {
    // From the end that is nearer: shares of a long way from afar have no digits left for the box.
    let far = |p: [f64; 3]| (0..3).map(|k| (p[k] - 0.5 * (spans[k].0 + spans[k].1)).powi(2)).sum::<f64>();
    if far(ends[1]) < far(ends[0]) {
        return within([ends[1], ends[0]], spans).map(|[b, a]| [a, b]);
    }
    let (mut first, mut last) = (0.0f64, 1.0f64);
    for (k, (low, high)) in spans.into_iter().enumerate() {
        let (from, along) = (ends[0][k], ends[1][k] - ends[0][k]);
        if along == 0.0 {
            if from < low || from > high {
                return None;
            }
            continue;
        }
        let (a, b) = ((low - from) / along, (high - from) / along);
        (first, last) = (first.max(a.min(b)), last.min(a.max(b)));
    }
    let along = |k: usize, t: f64| ends[0][k] + (ends[1][k] - ends[0][k]) * t;
    let at = |t: f64| std::array::from_fn(|k| along(k, t).clamp(spans[k].0, spans[k].1));
    (first <= last).then(|| [at(first), at(last)])
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn a_cell_is_as_deep_as_layers_around_it_are_full() {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [9, 9, 11] };
        let holes = [[4, 4, 2], [1, 8, 8]];
        let all = (0..lattice.cells()).map(|i| lattice.place(i));
        let voxels = Voxels::new(lattice, all.filter(|p| !holes.contains(p)));
        let body = Body::new(&voxels);
        for index in 0..lattice.cells() {
            let place = lattice.place(index);
            let depth = body.depth(place.map(|x| (x + MARGIN) as u32));
            let p = place.map(|x| x as i32);
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
                    let mut found = false;
                    b.around(node, |n| found |= n == other);
                    assert!(found);
                }
            }
        }
        assert_eq!(b.at(b.inner([0.6, 0.0, 0.3])), [5, 4, 4]);
        // A gap of a cell parts blocks.
        let parted = body([[0, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0], [6, 0, 0]]);
        assert_eq!((0..4).map(|n| parted.beside(n).count()).collect::<Vec<_>>(), [0, 0, 1, 1]);
    }

    /// Layer by layer from one end.
    fn sees_simply(b: &Body, place: [usize; 3], to: glam::Vec3A) -> bool {
        let way = to - glam::Vec3A::from(place.map(|x| x as f32));
        let most = way.abs().max_element();
        let step = (way * (65536.0 / most)).to_array().map(|x| i64::from(x as i32));
        (1..most.ceil() as i64).all(|layer| {
            let ends: [[i64; 2]; 3] = std::array::from_fn(|k| {
                let x = ((place[k] as i64) << 16) + layer * step[k];
                [x >> 16, (x + 0xffff) >> 16]
            });
            (0..8).any(|mask: usize| {
                let p: [i64; 3] = std::array::from_fn(|k| ends[k][mask >> k & 1]);
                let inside = (0..3).all(|k| p[k] >= 0 && p[k] < 4 * b.bricks[k] as i64);
                inside && b.has(p.map(|x| x as u32))
            })
        })
    }

    #[test]
    fn sights_from_both_ends_are_those_from_one() {
        let mut random = stream(1, "sights", &[]);
        let (mut seen, mut hidden) = (0, 0);
        for holes in [0.0, 0.01, 0.1, 0.4] {
            let b = body((0..9 * 7 * 30).filter(|_| random.unit() >= holes).map(|i| [i / 210, i / 30 % 7, i % 30]));
            for place in b.occupied().collect::<Vec<_>>() {
                let far = if random.chance(0.2) { 1e6 } else { 40.0 };
                let at = [9.0, 7.0, 30.0].map(|n: f32| random.within(0.0, n) + 4.0);
                let off = [0; 3].map(|_| random.within(-far, far));
                let to = glam::Vec3A::from(if random.chance(0.5) { at } else { off });
                let wanted = sees_simply(&b, place.map(|x| x as usize), to);
                assert_eq!(b.sees(glam::Vec3A::from(place.map(|x| x as f32)), to), wanted, "{place:?} {to}");
                *if wanted { &mut seen } else { &mut hidden } += 1;
            }
        }
        assert!(seen > 1000 && hidden > 1000, "{seen} {hidden}");
    }

    #[test]
    fn a_gap_of_two_cells_ends_a_sight() {
        for (gap, seen) in [(0, true), (1, true), (2, false), (3, false)] {
            let b = body((0..30).filter(|z| !(10..10 + gap).contains(z)).flat_map(|z| [[4, 3, z], [5, 3, z]]));
            let straight = b.sees(glam::Vec3A::new(8.0, 7.0, 4.0), glam::Vec3A::new(8.0, 7.0, 30.0));
            // Along the layers there is nothing beside a gap.
            assert_eq!(straight, seen && gap == 0, "{gap}");
        }
        let walls = |gap: usize| body((0..9).flat_map(|x| (0..30).flat_map(move |z| [[x, 0, z], [x, 1 + gap, z]])));
        for (gap, seen) in [(0, true), (1, true), (2, false)] {
            let to = glam::Vec3A::new(6.0, 5.0 + gap as f32, 33.0);
            assert_eq!(walls(gap).sees(glam::Vec3A::new(6.0, 4.0, 4.0), to), seen, "{gap}");
        }
    }
}
