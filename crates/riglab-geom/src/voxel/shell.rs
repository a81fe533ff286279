//! The cells that a surface touches.

use glam::DVec3;
use rayon::prelude::*;
use riglab_core::Mesh;

use super::lattice::{Lattice, SharedBits, Voxels};

/// The cells of the lattice that a triangle touches, with their faces and corners.
///
/// A cell is found by the separating axes of a box and a triangle, along a tree of boxes: the time grows
/// with the cells that are touched and not with those around them.
pub fn shell(mesh: &Mesh, lattice: &Lattice) -> Voxels {
    let bits = SharedBits::new(lattice.cells());
    (0..mesh.triangles().len()).into_par_iter().with_min_len(256).for_each_init(Vec::new, |left, t| {
        let corners = mesh.corners(t).map(|p| DVec3::from(lattice.scaled(p.map(f64::from))));
        mark(&corners, lattice, &bits, left);
    });
    Voxels::from_words(*lattice, bits.into_words())
}

/// Cells `from..to`.
#[derive(Clone, Copy)]
struct Block {
    from: [usize; 3],
    to: [usize; 3],
}

/// Blocks of so many cells are looked through cell by cell.
const FEW: usize = 8;

/// Marks the cells that a triangle touches; `left` is room to work in, empty before and after.
fn mark(corners: &[DVec3; 3], lattice: &Lattice, bits: &SharedBits, left: &mut Vec<Block>) {
    let min = corners[0].min(corners[1]).min(corners[2]).to_array();
    let max = corners[0].max(corners[1]).max(corners[2]).to_array();
    // A face that lies between two cells touches both.
    let from = std::array::from_fn(|k| (min[k].ceil() - 1.0).max(0.0) as usize);
    let to = std::array::from_fn(|k| ((max[k].floor() + 1.0).max(0.0) as usize).min(lattice.size[k]));
    if (0..3).any(|k| from[k] >= to[k]) {
        return;
    }
    let shadows = Shadows::of(corners);
    left.push(Block { from, to });
    while let Some(block) = left.pop() {
        let sides: [usize; 3] = std::array::from_fn(|k| block.to[k] - block.from[k]);
        if sides.iter().product::<usize>() <= FEW {
            for x in block.from[0]..block.to[0] {
                for y in block.from[1]..block.to[1] {
                    for z in block.from[2]..block.to[2] {
                        if shadows.touch([x, y, z].map(|x| x as f64 + 0.5), [0.5; 3]) {
                            bits.set(lattice.index([x, y, z]));
                        }
                    }
                }
            }
            continue;
        }
        let half = sides.map(|x| 0.5 * x as f64);
        if !shadows.touch(std::array::from_fn(|k| block.from[k] as f64 + half[k]), half) {
            continue;
        }
        let longest = (0..3).max_by_key(|&k| sides[k]).unwrap_or(0);
        let middle = block.from[longest] + sides[longest] / 2;
        let (mut low, mut high) = (block, block);
        (low.to[longest], high.from[longest]) = (middle, middle);
        left.extend([low, high]);
    }
}

/// What a triangle covers of each axis that may part it from a box, taken once for all boxes; those of space are left
/// out, along which the triangle meets all cells that are asked for.
struct Shadows {
    face: Shadow<3>,
    /// Of the product of each edge with x, y and z, which has two sides that are not 0.
    edges: [[Shadow<2>; 3]; 3],
}

/// An axis by its sides, and what is covered of it.
#[derive(Clone, Copy)]
struct Shadow<const N: usize> {
    axis: [f64; N],
    from: f64,
    to: f64,
}

impl<const N: usize> Shadow<N> {
    fn of(axis: [f64; N], corners: [[f64; N]; 3]) -> Self {
        let [a, b, c] = corners.map(|p| dot(axis, p));
        // With room for rounding: cells are of edge 1.
        let room = ROOM * dot(axis, axis).sqrt();
        Self { axis, from: a.min(b).min(c) - room, to: a.max(b).max(c) + room }
    }

    fn touches(&self, center: [f64; N], half: [f64; N]) -> bool {
        let reach = (1.0 + ROOM) * dot(self.axis.map(f64::abs), half);
        let at = dot(self.axis, center);
        // Triangles beyond all measure, whose products are no numbers, touch all in their box.
        !(self.from - at > reach || self.to - at < -reach)
    }
}

/// The share by which a reach is longer.
const ROOM: f64 = 1e-9;

fn dot<const N: usize>(a: [f64; N], b: [f64; N]) -> f64 {
    (0..N).map(|k| a[k] * b[k]).sum()
}

/// The sides of a space's axis' product with another.
const OTHERS: [[usize; 2]; 3] = [[1, 2], [2, 0], [0, 1]];

impl Shadows {
    fn of(corners: &[DVec3; 3]) -> Self {
        let [a, b, c] = *corners;
        let edges = [b - a, c - b, a - c];
        let product = |e: DVec3| OTHERS.map(|[i, j]| Shadow::of([-e[j], e[i]], corners.map(|p| [p[i], p[j]])));
        let normal = edges[0].cross(edges[1]).to_array();
        Self { face: Shadow::of(normal, corners.map(|p| p.to_array())), edges: edges.map(product) }
    }

    /// Whether the triangle and a box within its own have a point in common.
    fn touch(&self, center: [f64; 3], half: [f64; 3]) -> bool {
        self.face.touches(center, half)
            && self.edges.iter().all(|edge| {
                let two = |k: usize, p: [f64; 3]| OTHERS[k].map(|i| p[i]);
                let touches = |k: usize| edge[k].touches(two(k, center), two(k, half));
                touches(0) && touches(1) && touches(2)
            })
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    fn lattice(size: usize) -> Lattice {
        Lattice { origin: [0.0; 3], cell: 1.0, size: [size; 3] }
    }

    #[test]
    fn a_flat_triangle_touches_its_layer() {
        let mesh = Mesh::new(vec![[0.5, 0.5, 2.5], [3.5, 0.5, 2.5], [0.5, 3.5, 2.5]], vec![[0, 1, 2]]).unwrap();
        let cells: Vec<_> = shell(&mesh, &lattice(8)).places().collect();
        let mut wanted = Vec::new();
        for x in 0..4 {
            // The long side runs through the corners between cells, which touches both.
            wanted.extend((0..4).filter(|y| x + y <= 4).map(|y| [x, y, 2]));
        }
        assert_eq!(cells, wanted);
    }

    #[test]
    fn a_point_between_cells_touches_all_around() {
        let mesh = Mesh::new(vec![[2.0; 3]], vec![[0; 3]]).unwrap();
        assert_eq!(shell(&mesh, &lattice(4)).count(), 8);
    }

    #[test]
    fn what_lies_outside_is_passed_over() {
        let mesh = Mesh::new(vec![[-5.0; 3], [9.0; 3], [20.0, 0.0, 0.0]], vec![[0, 1, 2], [0, 0, 0]]).unwrap();
        let voxels = shell(&mesh, &lattice(4));
        assert!(voxels.is_occupied([1, 1, 1]) && voxels.count() < 64);
    }

    /// By all separating axes of a cell and a triangle, with the cell's middle as the origin.
    fn touches_simply(corners: &[DVec3; 3], center: DVec3) -> bool {
        let [a, b, c] = corners.map(|p| p - center);
        let edges = [b - a, c - b, a - c];
        let sides = [DVec3::X, DVec3::Y, DVec3::Z];
        let products = edges.iter().flat_map(|e| sides.map(|s| s.cross(*e)));
        let mut axes = sides.into_iter().chain([edges[0].cross(edges[1])]).chain(products);
        !axes.any(|axis| {
            let (x, y, z) = (a.dot(axis), b.dot(axis), c.dot(axis));
            let reach = axis.abs().element_sum() * 0.5;
            let reach = reach + 1e-9 * (reach + axis.length());
            x.min(y).min(z) > reach || x.max(y).max(z) < -reach
        })
    }

    #[test]
    fn a_cell_is_marked_where_no_axis_parts_it_from_a_triangle() {
        let lattice = lattice(12);
        let mut random = stream(1, "shell", &[]);
        for round in 0..300 {
            let size = [0.3, 1.5, 5.0, 30.0][round % 4];
            let at = [0; 3].map(|_| random.within(0.0, 12.0));
            // Some lie in one another's planes, or between cells.
            let snap = [0.0, 0.0, 0.5, 1.0][round / 4 % 4];
            let corner = |random: &mut riglab_random::Stream| -> [f32; 3] {
                at.map(|x| {
                    let x = x + random.within(-size, size);
                    if snap > 0.0 { (x / snap).round() * snap } else { x }
                })
            };
            let corners = [(); 3].map(|()| corner(&mut random));
            let mesh = Mesh::new(corners.to_vec(), vec![[0, 1, 2]]).unwrap();
            let found = shell(&mesh, &lattice);
            let corners = corners.map(|p| DVec3::from(p.map(f64::from)));
            for index in 0..lattice.cells() {
                let wanted = touches_simply(&corners, DVec3::from(lattice.center(lattice.place(index))));
                assert_eq!(found.has(index), wanted, "{corners:?} {:?}", lattice.place(index));
            }
        }
    }
}
