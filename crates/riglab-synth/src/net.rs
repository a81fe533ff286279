//! From cells to polygons: one polygon around every cell edge that crosses the surface.
//!
//! This is the dual of the octree, as in surface nets: the polygon's corners are the three or four
//! cells around the edge. [`polygons`] walks pairs and quadruples of neighbouring cells down the
//! tree, so it visits every shortest edge once, whatever the sizes around it.

use glam::Vec3;

use crate::cells::{CellId, Cells};

/// A polygon between cells, wound so that its normal points out of the body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Polygon {
    /// Its corners; the last is repeated in a triangle.
    pub cells: [CellId; 4],
    /// The end of the crossed edge that lies inside.
    pub inside: u32,
    /// Where the edge crosses the surface, by linear interpolation.
    pub crossing: Vec3,
}

impl Polygon {
    /// 3 or 4.
    pub fn sides(&self) -> usize {
        if self.cells[3] == self.cells[2] { 3 } else { 4 }
    }
}

/// All polygons of the surface.
pub(crate) fn polygons(cells: &Cells) -> Vec<Polygon> {
    let mut walk = Walk { cells, out: Vec::new() };
    walk.cell(0);
    walk.out
}

struct Walk<'a> {
    cells: &'a Cells,
    out: Vec<Polygon>,
}

/// The rank of a child or corner that is at `x` along axis `d`, `y` and `z` along the next two.
fn rank(d: usize, [x, y, z]: [usize; 3]) -> usize {
    x << d | y << ((d + 1) % 3) | z << ((d + 2) % 3)
}

impl Walk<'_> {
    fn is_leaf(&self, cell: CellId) -> bool {
        self.cells.cells[cell as usize].children.is_none()
    }

    /// A child, or the cell itself where it has none.
    fn child(&self, cell: CellId, rank: usize) -> CellId {
        self.cells.cells[cell as usize].children.map_or(cell, |first| first + rank as u32)
    }

    /// Everything inside a cell.
    fn cell(&mut self, cell: CellId) {
        if self.is_leaf(cell) {
            return;
        }
        for rank in 0..8 {
            self.cell(self.child(cell, rank));
        }
        for d in 0..3 {
            for y in 0..2 {
                for z in 0..2 {
                    self.face(d, [0, 1].map(|x| self.child(cell, rank(d, [x, y, z]))));
                }
            }
            for x in 0..2 {
                self.edge(d, [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[y, z]| self.child(cell, rank(d, [x, y, z]))));
            }
        }
    }

    /// Everything in the face between two cells that follow each other along axis `d`.
    fn face(&mut self, d: usize, pair: [CellId; 2]) {
        if pair.iter().all(|&c| self.is_leaf(c)) {
            return;
        }
        for y in 0..2 {
            for z in 0..2 {
                let lower = self.child(pair[0], rank(d, [1, y, z]));
                let upper = self.child(pair[1], rank(d, [0, y, z]));
                self.face(d, [lower, upper]);
            }
        }
        // Edges that lie in the face, along e; around them the cells differ along d and f.
        for half in 0..2 {
            let (e, f) = ((d + 1) % 3, (d + 2) % 3);
            // Seen from e, the next two axes are f and d.
            self.edge(
                e,
                [[0, 0], [1, 0], [0, 1], [1, 1]]
                    .map(|[along_f, along_d]| self.child(pair[along_d], half << e | along_f << f | (1 - along_d) << d)),
            );
            // Seen from f, they are d and e.
            self.edge(
                f,
                [[0, 0], [1, 0], [0, 1], [1, 1]]
                    .map(|[along_d, along_e]| self.child(pair[along_d], half << f | along_e << e | (1 - along_d) << d)),
            );
        }
    }

    /// The edge along axis `d` between four cells: lower and upper along the next axis, then along
    /// the one after.
    fn edge(&mut self, d: usize, around: [CellId; 4]) {
        if around.iter().all(|&c| self.is_leaf(c)) {
            return self.polygon(d, around);
        }
        for half in 0..2 {
            // The edge is on the upper side of the lower cells.
            let inner = |k: usize| rank(d, [half, 1 - (k & 1), 1 - (k >> 1)]);
            self.edge(d, std::array::from_fn(|k| self.child(around[k], inner(k))));
        }
    }

    fn polygon(&mut self, d: usize, around: [CellId; 4]) {
        // The edge belongs whole to the smallest cell only.
        let depth = |k: usize| self.cells.cells[around[k] as usize].depth;
        let k = (1..4).fold(0, |best, k| if depth(k) > depth(best) { k } else { best });
        let ends = [0, 1].map(|x| {
            let corner = rank(d, [x, 1 - (k & 1), 1 - (k >> 1)]);
            self.cells.cells[around[k] as usize].corners[corner]
        });
        let [(p0, d0), (p1, d1)] = ends.map(|c| self.cells.corners[c as usize]);
        if (d0 < 0.0) == (d1 < 0.0) {
            return;
        }
        // Counterclockwise as seen against the axis; outwards is along the axis if its start is inside.
        let mut ring = [around[0], around[1], around[3], around[2]];
        if d0 >= 0.0 {
            ring.reverse();
        }
        let mut corners = [0; 4];
        let mut n = 0;
        for (k, &cell) in ring.iter().enumerate() {
            if cell != ring[(k + 3) % 4] {
                corners[n] = cell;
                n += 1;
            }
        }
        assert!(n >= 3, "an edge is no face's inside");
        if n == 3 {
            corners[3] = corners[2];
        }
        let crossing = p0 + (p1 - p0) * (d0 / (d0 - d1));
        self.out.push(Polygon { cells: corners, inside: if d0 < 0.0 { ends[0] } else { ends[1] }, crossing });
    }
}
