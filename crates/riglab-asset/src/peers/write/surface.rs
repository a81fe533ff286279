//! Points on a surface, evenly and always the same: the peers' files carry some.

use riglab_core::{Mesh, Rig, Vec3};

/// Steps of the two-dimensional golden ratio: points that follow each other fill a square evenly.
const STEPS: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_3];

/// A point of a triangle.
pub(super) struct Point {
    pub position: Vec3,
    pub normal: Vec3,
    pub triangle: usize,
    /// Shares of the three corners.
    pub shares: [f32; 3],
}

/// `count` points, as many on each triangle as its area takes.
pub(super) fn points(mesh: &Mesh, count: usize) -> Vec<Point> {
    let areas = (0..mesh.triangles().len()).map(|t| f64::from(glam::Vec3::from(mesh.area_vector(t)).length()));
    let mut sum = 0.0;
    let ends: Vec<f64> = areas
        .map(|area| {
            sum += if area.is_finite() { area } else { 0.0 };
            sum
        })
        .collect();
    let point = |i: usize| {
        let at = (i as f64 + 0.5) / count as f64 * sum;
        let triangle = ends.partition_point(|end| *end < at).min(ends.len() - 1);
        let [mut u, mut v] = STEPS.map(|s| (0.5 + i as f64 * s).fract() as f32);
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        let shares = [1.0 - u - v, u, v];
        let corners = mesh.corners(triangle);
        let position = std::array::from_fn(|k| (0..3).map(|c| shares[c] * corners[c][k]).sum());
        let normal = glam::Vec3::from(mesh.area_vector(triangle)).try_normalize().unwrap_or(glam::Vec3::Y).into();
        Point { position, normal, triangle, shares }
    };
    (0..count).map(point).collect()
}

/// Positions and normals, six numbers a point.
pub(super) fn six(points: &[Point]) -> Vec<f32> {
    points.iter().flat_map(|p| [p.position, p.normal].concat()).collect()
}

/// The weights at a point, rising by joint: those of its corners by their shares.
pub(super) fn weights(rig: &Rig, point: &Point) -> Vec<(u16, f32)> {
    let mut out: Vec<(u16, f32)> = Vec::new();
    for (vertex, share) in rig.mesh().triangles()[point.triangle].into_iter().zip(point.shares) {
        for (joint, weight) in rig.weights().row(vertex as usize) {
            match out.iter_mut().find(|(j, _)| *j == joint.0) {
                Some((_, sum)) => *sum += share * weight,
                None => out.push((joint.0, share * weight)),
            }
        }
    }
    out.sort_unstable_by_key(|(joint, _)| *joint);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_on_the_surface_by_area() {
        let square = vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 3.0, 0.0], [0.0, 1.0, 0.0]];
        let mesh = Mesh::new(square, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let all = points(&mesh, 400);
        // Areas of 3/2 and 1/2.
        assert_eq!(all.iter().filter(|p| p.triangle == 0).count(), 300);
        assert!(all.iter().all(|p| p.position[2] == 0.0 && (0.0..=3.0).contains(&p.position[1])));
        assert_eq!(all[0].normal, [0.0, 0.0, 1.0]);
    }
}
