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
    (0..mesh.triangles().len()).into_par_iter().with_min_len(256).for_each(|t| {
        let corners = mesh.corners(t).map(|p| DVec3::from(lattice.scaled(p.map(f64::from))));
        mark(&corners, lattice, &bits);
    });
    Voxels::from_words(*lattice, bits.into_words())
}

/// Cells `from..to`.
#[derive(Clone, Copy)]
struct Block {
    from: [usize; 3],
    to: [usize; 3],
}

fn mark(corners: &[DVec3; 3], lattice: &Lattice, bits: &SharedBits) {
    let min = corners[0].min(corners[1]).min(corners[2]).to_array();
    let max = corners[0].max(corners[1]).max(corners[2]).to_array();
    // A face that lies between two cells touches both.
    let from = std::array::from_fn(|k| (min[k].ceil() - 1.0).max(0.0) as usize);
    let to = std::array::from_fn(|k| ((max[k].floor() + 1.0).max(0.0) as usize).min(lattice.size[k]));
    if (0..3).any(|k| from[k] >= to[k]) {
        return;
    }
    let mut left = vec![Block { from, to }];
    while let Some(block) = left.pop() {
        let sides: [usize; 3] = std::array::from_fn(|k| block.to[k] - block.from[k]);
        let low = DVec3::from(block.from.map(|x| x as f64));
        let half = DVec3::from(sides.map(|x| 0.5 * x as f64));
        if !touches(corners, low + half, half) {
            continue;
        }
        let longest = (0..3).max_by_key(|&k| sides[k]).unwrap_or(0);
        if sides[longest] == 1 {
            bits.set(lattice.index(block.from));
            continue;
        }
        let middle = block.from[longest] + sides[longest] / 2;
        let (mut low, mut high) = (block, block);
        (low.to[longest], high.from[longest]) = (middle, middle);
        left.extend([low, high]);
    }
}

/// Whether a triangle and a box have a point in common.
fn touches(corners: &[DVec3; 3], center: DVec3, half: DVec3) -> bool {
    let [a, b, c] = corners.map(|p| p - center);
    let apart = |axis: DVec3| {
        let (x, y, z) = (a.dot(axis), b.dot(axis), c.dot(axis));
        let reach = half.dot(axis.abs());
        // With room for rounding: cells are of edge 1.
        let reach = reach + 1e-9 * (reach + axis.length());
        x.min(y).min(z) > reach || x.max(y).max(z) < -reach
    };
    if apart(DVec3::X) || apart(DVec3::Y) || apart(DVec3::Z) {
        return false;
    }
    let edges = [b - a, c - b, a - c];
    if apart(edges[0].cross(edges[1])) {
        return false;
    }
    edges.into_iter().all(|e| {
        !apart(DVec3::new(0.0, -e.z, e.y)) && !apart(DVec3::new(e.z, 0.0, -e.x)) && !apart(DVec3::new(-e.y, e.x, 0.0))
    })
}

#[cfg(test)]
mod tests {
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
}
