//! Cells around the surface: an octree, fine where the body is thin.
//!
//! A uniform grid that shows fingers spends nearly all its triangles on the back; here a cell's
//! size follows the thickness of the part next to it. Signs are taken at the corners of every
//! leaf, each corner once, so neighbours of any size agree and the surface has no cracks.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;

use glam::Vec3;

use crate::field::{Field, Scratch};

/// How large cells should be.
#[derive(Clone, Debug)]
pub(crate) struct Sizes {
    /// The largest wanted size in metres; cells are this times a power of two.
    unit: f32,
    /// Wanted size next to each part, in metres.
    pub at_part: Vec<f32>,
}

impl Sizes {
    /// Sizes wanted next to each part, in metres.
    pub fn new(at_part: Vec<f32>) -> Self {
        Self { unit: at_part.iter().copied().fold(1e-3, f32::max), at_part }
    }
}

/// Index of a cell in [`Cells::cells`].
pub(crate) type CellId = u32;

/// A box of the octree.
#[derive(Clone, Debug)]
pub(crate) struct Cell {
    /// The first of eight children in a row; `None` for a leaf. Bits 0, 1, 2 of a child's rank say
    /// whether it is the upper half in x, y, z.
    pub children: Option<CellId>,
    /// Halvings since the root.
    pub depth: u8,
    /// Of a leaf: its corners, ranked as children are.
    pub corners: [u32; 8],
    /// Where [`Cells::near`] lists the parts that matter here.
    near: (u32, u32),
    /// Lowest corner on the finest lattice.
    at: [u32; 3],
}

/// The octree.
pub(crate) struct Cells {
    pub cells: Vec<Cell>,
    /// Corners: place, and the function there.
    pub corners: Vec<(Vec3, f32)>,
    lists: Vec<u16>,
}

impl Cells {
    /// The parts that matter in and around a cell.
    pub fn near(&self, cell: CellId) -> &[u16] {
        let (start, end) = self.cells[cell as usize].near;
        &self.lists[start as usize..end as usize]
    }

    /// Divides space around the zero set of the field.
    pub fn new(field: &Field, sizes: &Sizes) -> Self {
        Builder::new(field, sizes).build()
    }
}

/// Cells grow by at most this share of the way from a thin part, so that levels change gradually.
const GRADING: f32 = 0.35;

/// A cell further from the surface than this many of its half diagonals does not touch it. More
/// than 1 because distances hold to first order only.
const SLACK: f32 = 1.1;

/// The deepest octree: 2^15 cells a side.
const DEEPEST: u8 = 15;

struct Builder<'a> {
    field: &'a Field<'a>,
    sizes: &'a Sizes,
    out: Cells,
    known: HashMap<u64, u32, BuildHasherDefault<LatticeHasher>>,
    origin: Vec3,
    /// Side of the root in metres, and in steps of the finest lattice.
    side: f32,
    steps: u32,
    scratch: Scratch,
}

impl<'a> Builder<'a> {
    fn new(field: &'a Field<'a>, sizes: &'a Sizes) -> Self {
        let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
        for part in field.parts() {
            let (a, b) = part.bounds();
            (low, high) = (low.min(a), high.max(b));
        }
        if field.parts().is_empty() {
            // All pieces and no skin: one cell, outside.
            (low, high) = (Vec3::ZERO, Vec3::ZERO);
        }
        // A root whose cells halve to the unit, centred on x = 0 so that cells come in mirrored
        // pairs and a symmetric creature gets a symmetric mesh.
        let center = (low + high) * Vec3::new(0.0, 0.5, 0.5);
        let reach = (high - center).max(center - low).max_element() + 2.0 * sizes.unit;
        let mut side = sizes.unit;
        while side < 2.0 * reach {
            side *= 2.0;
        }
        Self {
            field,
            sizes,
            out: Cells { cells: Vec::new(), corners: Vec::new(), lists: Vec::new() },
            known: HashMap::default(),
            origin: center - 0.5 * side,
            side,
            steps: 1 << DEEPEST,
            scratch: Vec::new(),
        }
    }

    fn build(mut self) -> Cells {
        self.out.lists.extend(0..self.field.parts().len() as u16);
        let near = (0, self.out.lists.len() as u32);
        self.out.cells.push(Cell { children: None, depth: 0, corners: [0; 8], near, at: [0; 3] });
        let mut next = 0;
        while next < self.out.cells.len() {
            self.visit(next);
            next += 1;
        }
        self.out
    }

    /// Divides a cell or fixes it as a leaf.
    fn visit(&mut self, id: usize) {
        let Cell { depth, at, near, .. } = self.out.cells[id];
        let size = self.side / (1u32 << depth) as f32;
        let half_diagonal = 0.5 * 1.732_051 * size;
        let center = self.place(at) + 0.5 * size;
        let list = range(near);
        let d = self.field.sample(center, &self.out.lists[list.clone()], &mut self.scratch).d;
        // Thin parts ask for small cells, far ones the less the further they are.
        let wanted = (self.out.lists[list.clone()].iter().zip(&self.scratch))
            .map(|(&i, part)| self.sizes.at_part[usize::from(i)] + GRADING * (part.d - half_diagonal).max(0.0))
            .fold(f32::INFINITY, f32::min);
        let coarse = size > wanted && depth < DEEPEST;
        if coarse && d.abs() < SLACK * half_diagonal {
            return self.divide(id, center, half_diagonal);
        }
        let corners = self.corners_of(at, depth, list.clone());
        let inside = corners.iter().filter(|&&c| self.out.corners[c as usize].1 < 0.0).count();
        if coarse && inside > 0 && inside < 8 {
            // Corners were asked since.
            self.field.sample(center, &self.out.lists[list], &mut self.scratch);
            return self.divide(id, center, half_diagonal);
        }
        self.out.cells[id].corners = corners;
    }

    fn divide(&mut self, id: usize, center: Vec3, half_diagonal: f32) {
        let Cell { depth, at, near, .. } = self.out.cells[id];
        let start = self.out.lists.len() as u32;
        let list = self.out.lists[range(near)].to_vec();
        // Vertices may wander out of their cell while they are spread: keep a cell's width of room.
        self.field.prune(center, 2.0 * half_diagonal, &list, &self.scratch, &mut self.out.lists);
        let near = (start, self.out.lists.len() as u32);
        let step = self.steps >> (depth + 1);
        self.out.cells[id].children = Some(self.out.cells.len() as u32);
        for rank in 0..8 {
            let at = std::array::from_fn(|k| at[k] + step * (rank >> k & 1));
            self.out.cells.push(Cell { children: None, depth: depth + 1, corners: [0; 8], near, at });
        }
    }

    fn corners_of(&mut self, at: [u32; 3], depth: u8, list: Range<usize>) -> [u32; 8] {
        let step = self.steps >> depth;
        std::array::from_fn(|rank| {
            let at: [u32; 3] = std::array::from_fn(|k| at[k] + step * (rank as u32 >> k & 1));
            let key = at.iter().fold(0u64, |key, &x| key << 21 | u64::from(x));
            if let Some(&known) = self.known.get(&key) {
                return known;
            }
            let p = self.place(at);
            let d = self.field.sample(p, &self.out.lists[list.clone()], &mut self.scratch).d;
            let id = self.out.corners.len() as u32;
            self.out.corners.push((p, d));
            self.known.insert(key, id);
            id
        })
    }

    fn place(&self, at: [u32; 3]) -> Vec3 {
        self.origin + Vec3::from(at.map(|x| x as f32)) * (self.side / self.steps as f32)
    }
}

fn range((start, end): (u32, u32)) -> Range<usize> {
    start as usize..end as usize
}

/// Spreads packed lattice points; quicker than the standard hasher and needs no secret.
#[derive(Default)]
pub(crate) struct LatticeHasher(u64);

impl Hasher for LatticeHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(u64::from(b)));
    }

    fn write_u64(&mut self, x: u64) {
        let x = (self.0 ^ x).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = x ^ (x >> 32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dice::Dice;
    use crate::plan::Plan;

    #[test]
    fn what_matters_in_a_cell_is_told_by_the_distances_at_its_center() {
        // Among them are cells whose corners have both signs, though the centre seems far from the surface.
        let mut far = 0;
        for (plan, index) in Plan::ALL.into_iter().flat_map(|plan| [(plan, 0), (plan, 1), (plan, 2)]) {
            let body = plan.body(&mut Dice::new(riglab_random::stream(2, "cells", &[index])), 3_000);
            let field = Field::new(&body);
            let sizes = Sizes::new(body.parts.iter().map(|part| 0.4 * part.mean()).collect());
            let builder = Builder::new(&field, &sizes);
            let (origin, side, steps) = (builder.origin, builder.side, builder.steps as f32);
            let cells = builder.build();
            for (id, cell) in cells.cells.iter().enumerate() {
                let Some(first) = cell.children else { continue };
                let size = side / (1u32 << cell.depth) as f32;
                let center = origin + Vec3::from(cell.at.map(|x| x as f32)) * (side / steps) + 0.5 * size;
                let (half_diagonal, mut scratch, mut kept) = (0.5 * 1.732_051 * size, Vec::new(), Vec::new());
                let d = field.sample(center, cells.near(id as CellId), &mut scratch).d;
                far += usize::from(d.abs() >= SLACK * half_diagonal);
                field.prune(center, 2.0 * half_diagonal, cells.near(id as CellId), &scratch, &mut kept);
                assert_eq!(kept, cells.near(first), "{} {index}", plan.name());
            }
        }
        assert!(far > 0);
    }
}
