//! Cells between the front and the back of depth images.

use glam::DVec2;
use riglab_core::Mesh;

use super::lattice::{Lattice, MOST_CELLS, Voxels};

/// Where in a pixel the driver took the depth on which UniRig's goldens were recorded, in pixels right and up
/// from its middle: a place of its multisample pattern.
const SAMPLE: [f64; 2] = [-0.125, -0.375];

/// An axis of an image: an axis of space and its sign.
type Axis = (usize, f64);

/// The six cameras: the axis they look along, the image axes right and up, and whether they see the end
/// with the larger coordinates.
const CAMERAS: [(usize, Axis, Axis, bool); 6] = [
    (2, (0, 1.0), (1, 1.0), true),
    (2, (0, -1.0), (1, 1.0), false),
    (0, (2, 1.0), (1, 1.0), false),
    (0, (2, -1.0), (1, 1.0), true),
    (1, (0, 1.0), (2, 1.0), false),
    (1, (0, 1.0), (2, -1.0), true),
];

/// The cells of the cube [-1, 1]³ that UniRig's public code takes by default: its middle lies between what
/// cameras see from both ends of an axis, for two axes of three. `grid` cells along each side, from 1 to
/// [`MOST_CELLS`]; the mesh is normalised to the cube.
///
/// With the fault of that code, which looks along z at the mirrored place: bodies that are not symmetric in z
/// come out wrong. For what was trained on it; [`super::solid`] is the sound way.
pub fn by_depth(mesh: &Mesh, grid: usize) -> Voxels {
    let n = grid.clamp(1, MOST_CELLS);
    let lattice = Lattice { origin: [-1.0; 3], cell: 2.0 / n as f64, size: [n; 3] };
    // By axis and by pixel: the nearer and the farther end. Pixels run by the lower and the higher other axis.
    let mut ends = [0; 3].map(|_| vec![(f64::INFINITY, f64::NEG_INFINITY); n * n]);
    for (axis, right, up, far) in CAMERAS {
        let at = |k: f64, sign: f64, side: f64| -1.0 + (k + 0.5 + sign * side) * lattice.cell;
        for t in 0..mesh.triangles().len() {
            let corners = mesh.corners(t).map(|p| p.map(f64::from));
            let flat = corners.map(|p| DVec2::new(p[right.0], p[up.0]));
            let area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]);
            if area == 0.0 {
                continue;
            }
            let (low, high) = (flat[0].min(flat[1]).min(flat[2]), flat[0].max(flat[1]).max(flat[2]));
            let pixels = |low: f64, high: f64| {
                let pixel = |x: f64| ((x + 1.0) / lattice.cell).clamp(-2.0, n as f64 + 2.0) as isize;
                (pixel(low) - 2).max(0) as usize..((pixel(high) + 2).max(0) as usize).min(n)
            };
            for i in pixels(low.x, high.x) {
                for j in pixels(low.y, high.y) {
                    let p = DVec2::new(at(i as f64, right.1, SAMPLE[0]), at(j as f64, up.1, SAMPLE[1]));
                    let share = |a: usize, b: usize| (flat[a] - p).perp_dot(flat[b] - p) / area;
                    let shares = [share(1, 2), share(2, 0), share(0, 1)];
                    if shares.iter().any(|s| *s < 0.0) {
                        continue;
                    }
                    let depth: f64 = (0..3).map(|k| shares[k] * corners[k][axis]).sum();
                    let pixel = if right.0 < up.0 { i * n + j } else { j * n + i };
                    let (first, last) = &mut ends[axis][pixel];
                    if far {
                        *last = last.max(depth);
                    } else {
                        *first = first.min(depth);
                    }
                }
            }
        }
    }
    let kept = |&[x, y, z]: &[usize; 3]| {
        let center = lattice.center([x, y, z]);
        let pixels = [y * n + z, x * n + z, x * n + y];
        let passes = |axis: usize| {
            let (first, last) = ends[axis][pixels[axis]];
            // The fault: z is looked at from behind the mirror.
            let at = if axis == 2 { -center[2] } else { center[axis] };
            usize::from(first <= at && at <= last)
        };
        (0..3).map(passes).sum::<usize>() >= 2
    };
    Voxels::new(lattice, (0..lattice.cells()).map(|i| lattice.place(i)).filter(kept))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::cube;

    #[test]
    fn a_box_is_full() {
        let voxels = by_depth(&cube([0.0; 3], 0.5), 16);
        assert_eq!(voxels.count(), 8 * 8 * 8);
        assert!(voxels.contains([0.45, -0.45, 0.45]) && !voxels.contains([0.55, 0.0, 0.0]));
    }

    #[test]
    fn along_z_it_looks_in_the_mirror() {
        let voxels = by_depth(&cube([0.0, 0.0, 0.5], 0.25), 16);
        assert!(voxels.contains([0.0, 0.0, 0.5]), "x and y are right");
        // Where two axes see the body is kept, the mirrored place sees it along z alone.
        assert!(!voxels.contains([0.0, 0.0, -0.5]));
    }
}
