//! Whether the surface stays whole when bones turn.

use glam::{DAffine3, DVec3};
use multiversion::multiversion;

use crate::RawWeights;

/// Shortest edge that counts; what the paper's equation adds to lengths.
const LEAST: f64 = 1e-6;

/// Deformation smoothness (SkinTokens 3.4.1):
///
/// ```text
/// R_mo = 1 / (1 + s E_poses[ max_edges max(1, l(LBS(e)) / (l(e) + 1e-6)) ])
/// ```
///
/// `poses` has a map for each joint from rest to each pose ([`crate::maps`]). Lengths are meant for a mesh in
/// [-1, 1]³. One bad edge decides a pose, and one of length 0 whose ends move apart gives a million: leave
/// such out, as [`crate::Scorer`] does. 1 / (1 + s) where nothing is stretched, 0 without a pose.
pub fn motion(
    positions: &[[f64; 3]],
    edges: &[[u32; 2]],
    weights: &RawWeights,
    poses: &[Vec<DAffine3>],
    scale: f64,
) -> f64 {
    if poses.is_empty() {
        return 0.0;
    }
    let mean = stretches(positions, edges, weights, poses).iter().sum::<f64>() / poses.len() as f64;
    1.0 / (1.0 + scale * mean)
}

/// The largest stretch of an edge in each pose, at least 1.
pub fn stretches(
    positions: &[[f64; 3]],
    edges: &[[u32; 2]],
    weights: &RawWeights,
    poses: &[Vec<DAffine3>],
) -> Vec<f64> {
    let length = |p: &[[f64; 3]], [a, b]: [u32; 2]| squared(p[a as usize], p[b as usize]).sqrt();
    let inverse: Vec<f64> = edges.iter().map(|e| (1.0 / (length(positions, *e) + LEAST)).powi(2)).collect();
    stretches_by(positions, edges, &inverse, weights, poses)
}

/// The same with 1 / (l + 1e-6)² of each edge.
pub(crate) fn stretches_by(
    positions: &[[f64; 3]],
    edges: &[[u32; 2]],
    inverse: &[f64],
    weights: &RawWeights,
    poses: &[Vec<DAffine3>],
) -> Vec<f64> {
    let mut posed = vec![[0.0; 4]; positions.len()];
    let one = |maps: &Vec<DAffine3>| {
        skin(positions, weights, &columns(maps), &mut posed);
        most_stretched(&posed, edges, inverse).sqrt()
    };
    poses.iter().map(one).collect()
}

/// The largest square of an edge's stretch, at least 1; squares are in the order of lengths.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn most_stretched(posed: &[[f64; 4]], edges: &[[u32; 2]], inverse: &[f64]) -> f64 {
    let mut most = 1.0;
    for ([a, b], inverse) in edges.iter().zip(inverse) {
        let (p, q) = (posed[*a as usize], posed[*b as usize]);
        let (x, y, z) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
        let s = (x * x + y * y + z * z) * inverse;
        // Not `f64::max`, which takes several steps for what is no number; such are passed over here, too.
        most = if s > most { s } else { most };
    }
    most
}

#[inline]
fn squared(a: [f64; 3], b: [f64; 3]) -> f64 {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

/// Linear blend skinning by the map of each joint; sums are divided by the sum of weights and 1e-8, so that what
/// nothing holds goes to the origin.
pub fn skinned(positions: &[[f64; 3]], weights: &RawWeights, maps: &[DAffine3]) -> Vec<[f64; 3]> {
    let mut posed = vec![[0.0; 4]; positions.len()];
    skin(positions, weights, &columns(maps), &mut posed);
    posed.into_iter().map(|[x, y, z, _]| [x, y, z]).collect()
}

/// A map's columns, the translation last; what fills them up is 0.
type Columns = [[f64; 4]; 4];

fn columns(maps: &[DAffine3]) -> Vec<Columns> {
    let filled = |v: DVec3| [v.x, v.y, v.z, 0.0];
    let of = |m: &DAffine3| [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation].map(filled);
    maps.iter().map(of).collect()
}

/// By instructions of as many numbers as there are; the values are the same.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn skin(positions: &[[f64; 3]], weights: &RawWeights, maps: &[Columns], posed: &mut [[f64; 4]]) {
    for (v, ([x, y, z], out)) in positions.iter().zip(posed).enumerate() {
        let (joints, values) = weights.row(v);
        let (mut sum, mut total) = ([0.0; 4], 0.0);
        for (joint, w) in joints.iter().zip(values) {
            let [of_x, of_y, of_z, shift] = &maps[usize::from(*joint)];
            for k in 0..4 {
                sum[k] += w * (of_x[k] * x + of_y[k] * y + of_z[k] * z + shift[k]);
            }
            total += w;
        }
        *out = sum.map(|s| s / (total + 1e-8));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::maps;

    #[test]
    fn a_torn_edge_is_seen() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        let heads = [[0.0; 3], [1.0, 0.0, 0.0]];
        let half_turn = [[0.0; 3], [0.0, 0.0, std::f64::consts::PI]];
        let poses = [maps(&heads, &[None, Some(0)], &half_turn)];
        let held = |last: u16| RawWeights::new([[(0, 1.0)], [(0, 1.0)], [(last, 1.0)]]);
        let of = |w: &RawWeights| motion(&positions, &[[0, 1], [1, 2]], w, &poses, 1.0);
        assert!((of(&held(0)) - 0.5).abs() < 1e-6 && (of(&held(1)) - 0.5).abs() < 1e-6);
        // Half held: between (0, 0) and (2, 0), at (1, 0), where the edge has no length; the neighbour is whole.
        let torn = RawWeights::new([[(1, 1.0)], [(0, 1.0)], [(0, 1.0)]]);
        // (0, 0) turned about (1, 0) is (2, 0), as far away as before.
        assert!((of(&torn) - 0.5).abs() < 1e-6);
        let lost = RawWeights::new([vec![(0, 1.0)], vec![(0, 1.0)], vec![]]);
        assert!((of(&lost) - 0.5).abs() < 1e-6, "the origin is as far from (1, 0)");
        let quarter = [maps(&heads, &[None, Some(0)], &[[0.0; 3], [0.0, 0.0, std::f64::consts::FRAC_PI_2]])];
        let stretched =
            stretches(&positions, &[[0, 2]], &RawWeights::new([[(1, 1.0)], [(0, 1.0)], [(0, 1.0)]]), &quarter);
        // (0, 0) goes to (1, -1): √2 from (2, 0), less than before.
        assert_eq!(stretched, [1.0]);
        assert_eq!(motion(&positions, &[], &held(0), &[], 1.0), 0.0);
    }
}
