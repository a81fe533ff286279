//! Whether a mesh is one object or two.

use riglab_core::{Bounds, Mesh};

/// The widest gap between pieces of a mesh, as a share of its diagonal: the widest slab across one of the
/// axes that no triangle enters while there is mesh on both sides.
///
/// Two characters side by side have one; a body with its eyes and clothes has none, as a slab that parts
/// them meets the body. Objects that stand skew to the axes may have none; this looks for scenes, which
/// stand along them.
pub fn largest_gap(mesh: &Mesh) -> f32 {
    let diagonal = Bounds::of(mesh.positions().iter().copied()).map_or(0.0, |b| b.diagonal());
    if !(diagonal > 0.0 && diagonal.is_finite()) {
        return 0.0;
    }
    let widest = (0..3).map(|axis| gap_along(mesh, axis)).fold(0.0f32, f32::max);
    widest / diagonal
}

fn gap_along(mesh: &Mesh, axis: usize) -> f32 {
    let mut spans: Vec<(f32, f32)> = (0..mesh.triangles().len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t).map(|p| p[axis]);
            (a.min(b).min(c), a.max(b).max(c))
        })
        .collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut end, mut widest) = (spans[0].1, 0.0f32);
    for (from, to) in spans {
        widest = widest.max(from - end);
        end = end.max(to);
    }
    widest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_parts_two_objects_and_nothing_within_one() {
        let at = |x: f32| [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0]];
        let mesh = |shift: f32| {
            let positions = [at(0.0), at(shift)].concat();
            Mesh::new(positions, vec![[0, 1, 2], [3, 4, 5]]).unwrap()
        };
        assert_eq!(largest_gap(&mesh(0.5)), 0.0);
        let two = mesh(4.0);
        assert!((largest_gap(&two) - 3.0 / 26f32.sqrt()).abs() < 1e-6);
        let point = Mesh::new(vec![[1.0; 3]], vec![[0, 0, 0]]).unwrap();
        assert_eq!(largest_gap(&point), 0.0);
    }
}
