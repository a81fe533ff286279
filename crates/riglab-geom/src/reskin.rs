//! Weights known at points of a cloud, told for a mesh's vertices as UniRig's public code does.

use rayon::prelude::*;
use riglab_core::Vec3;
use rstar::primitives::GeomWithData;
use rstar::{DefaultParams, RTree};

/// What of the nearest points counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Nearby {
    /// The mean, by exp(-α d).
    Mean,
    /// The median, bone by bone.
    Median,
}

/// How weights come from points to vertices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReskinConfig {
    /// So many of the nearest points are asked.
    pub nearest: usize,
    /// What of them counts.
    pub nearby: Nearby,
    /// How fast what is farther counts less, α.
    pub falloff: f32,
    /// How often neighbours are smoothed after.
    pub steps: usize,
    /// Weights below are dropped, where another of the vertex is not below.
    pub threshold: f32,
}

impl Default for ReskinConfig {
    /// UniRig's release where it is used.
    fn default() -> Self {
        Self { nearest: 7, nearby: Nearby::Median, falloff: 2.0, steps: 1, threshold: 0.03 }
    }
}

/// Weights of vertices, V × J, from those of points, P × J; rows sum to 1, but for rows that are all 0 because
/// the points' are.
///
/// A step of smoothing takes the sums over each bone's subtree, lets every vertex take from one neighbour
/// what is more there, and takes the sums apart again. The neighbour is the one of the vertex' last edge,
/// where edges are listed as (0, 1) of all triangles, then (1, 2), then (2, 0), then the same reversed: the
/// released code means all neighbours, but its indexed addition keeps the last.
///
/// `parents` come before their children. Lengths are in the units of the released code, where the mesh
/// fills the cube from -1 to 1.
///
/// # Panics
/// When the lengths do not fit, or a triangle names a vertex that does not exist.
pub fn reskin(
    points: &[Vec3],
    weights: &[f32],
    parents: &[Option<usize>],
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    config: &ReskinConfig,
) -> Vec<f32> {
    let joints = parents.len();
    assert_eq!(weights.len(), points.len() * joints, "a row of weights a point");
    if joints == 0 || points.is_empty() {
        return vec![0.0; vertices.len() * joints];
    }
    let mut skin = gathered(points, weights, joints, vertices, config);
    let last = (config.steps > 0).then(|| last_neighbours(vertices.len(), triangles));
    for _ in 0..config.steps {
        smooth(&mut skin, parents, vertices, last.as_deref().unwrap_or_default(), config.falloff);
    }
    skin.par_chunks_exact_mut(joints).for_each(|row| {
        if row.iter().any(|w| *w >= config.threshold) {
            row.iter_mut().filter(|w| **w < config.threshold).for_each(|w| *w = 0.0);
        }
        normalise(row);
    });
    skin
}

fn gathered(points: &[Vec3], weights: &[f32], joints: usize, vertices: &[Vec3], config: &ReskinConfig) -> Vec<f32> {
    let each = points.iter().zip(0u32..).map(|(p, k)| GeomWithData::new(p.map(f64::from), k));
    let tree: RTree<_, DefaultParams> = RTree::bulk_load(each.collect());
    let mut out = vec![0.0; vertices.len() * joints];
    out.par_chunks_exact_mut(joints).zip(vertices).for_each(|(row, vertex)| {
        let near = tree.nearest_neighbor_iter_with_distance_2(vertex.map(f64::from)).take(config.nearest.max(1));
        let near: Vec<(usize, f64)> = near.map(|(p, square)| (p.data as usize, square.sqrt())).collect();
        let of = |k: usize, j: usize| weights[k * joints + j];
        match config.nearby {
            Nearby::Mean => {
                let shares: Vec<f64> = near.iter().map(|(_, d)| (-f64::from(config.falloff) * d).exp()).collect();
                let total: f64 = shares.iter().sum();
                for (j, w) in row.iter_mut().enumerate() {
                    let sum: f64 = near.iter().zip(&shares).map(|((k, _), s)| s * f64::from(of(*k, j))).sum();
                    // So far away that all shares are 0: the nearest alone.
                    *w = if total > 0.0 { (sum / total) as f32 } else { of(near[0].0, j) };
                }
            }
            Nearby::Median => {
                let mut column = vec![0.0; near.len()];
                for (j, w) in row.iter_mut().enumerate() {
                    column.iter_mut().zip(&near).for_each(|(c, (k, _))| *c = of(*k, j));
                    column.sort_unstable_by(f32::total_cmp);
                    let (low, high) = (column[(column.len() - 1) / 2], column[column.len() / 2]);
                    *w = (low + high) / 2.0;
                }
                if row.iter().all(|w| *w == 0.0) {
                    // Points that agree on nothing: as released this row would be lost.
                    row.iter_mut().enumerate().for_each(|(j, w)| *w = of(near[0].0, j));
                }
            }
        }
    });
    out
}

/// Of each vertex, the start of the last edge that comes in.
fn last_neighbours(vertices: usize, triangles: &[[u32; 3]]) -> Vec<Option<u32>> {
    let mut last = vec![None; vertices];
    let sides = [(0, 1), (1, 2), (2, 0)];
    let reversed = sides.map(|(a, b)| (b, a));
    for (from, to) in sides.into_iter().chain(reversed) {
        triangles.iter().for_each(|t| last[t[to] as usize] = Some(t[from]));
    }
    last
}

fn smooth(skin: &mut [f32], parents: &[Option<usize>], vertices: &[Vec3], last: &[Option<u32>], falloff: f32) {
    let joints = parents.len();
    skin.par_chunks_exact_mut(joints).for_each(|row| {
        for (j, parent) in parents.iter().enumerate().rev() {
            if let Some(p) = *parent {
                row[p] += row[j];
            }
        }
    });
    let before = skin.to_vec();
    skin.par_chunks_exact_mut(joints).enumerate().for_each(|(v, row)| {
        if let Some(n) = last[v].map(|n| n as usize) {
            let d = (0..3).map(|k| (vertices[v][k] - vertices[n][k]).powi(2)).sum::<f32>().sqrt();
            let share = (-falloff * d).exp();
            for (w, other) in row.iter_mut().zip(&before[n * joints..(n + 1) * joints]) {
                if *w < *other {
                    *w = (*w + share * other) / (1.0 + share);
                }
            }
        }
        for (j, parent) in parents.iter().enumerate() {
            if let Some(p) = *parent {
                row[p] -= row[j];
            }
        }
        normalise(row);
    });
}

fn normalise(row: &mut [f32]) {
    let sum: f32 = row.iter().sum();
    if sum > 0.0 {
        row.iter_mut().for_each(|w| *w /= sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_takes_what_points_around_it_agree_on() {
        let points: Vec<Vec3> = (0..9).map(|i| [i as f32 / 10.0, 0.0, 0.0]).collect();
        let weights: Vec<f32> = (0..9).flat_map(|i| if i < 5 { [1.0, 0.0] } else { [0.0, 1.0] }).collect();
        let config = ReskinConfig { nearest: 3, steps: 0, ..ReskinConfig::default() };
        let found = reskin(&points, &weights, &[None, Some(0)], &[[0.01, 0.0, 0.0], [0.9, 0.0, 0.0]], &[], &config);
        assert_eq!(found, [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn rows_sum_to_one_whatever_the_mesh() {
        let points = vec![[0.5f32; 3]; 20];
        let weights: Vec<f32> = (0..20).flat_map(|i| (0..3).map(move |j| f32::from(u8::from(i % 3 == j)))).collect();
        let vertices = [[0.0; 3], [1e20, 0.0, 0.0], [0.5; 3]];
        for nearby in [Nearby::Mean, Nearby::Median] {
            let config = ReskinConfig { nearby, ..ReskinConfig::default() };
            let parents = [None, Some(0), Some(1)];
            let found = reskin(&points, &weights, &parents, &vertices, &[[0, 1, 2], [0, 0, 0]], &config);
            for row in found.chunks_exact(3) {
                assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{nearby:?}: {row:?}");
            }
        }
    }
}
