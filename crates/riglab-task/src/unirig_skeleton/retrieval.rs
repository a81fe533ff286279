//! The rival without learning: the skeleton of the training shape that is nearest.

use rayon::prelude::*;
use riglab_core::{Rig, Vec3};
use riglab_geom::{By, CloudConfig, CloudSampler};
use riglab_metric::Joints;
use riglab_random::stream;

use super::batch::normalized;
use crate::assets::{AssetId, Assets, Cache};

/// Training shapes as points, with their skeletons.
pub struct Retrieval {
    shapes: Vec<(Vec<Vec3>, Joints)>,
    points: usize,
    seed: u64,
}

impl Retrieval {
    /// Reads the training assets; shapes are compared by so many points.
    ///
    /// # Errors
    /// When an asset cannot be read.
    pub fn new(assets: &Assets, cache: &Cache<Rig>, ids: &[AssetId], points: usize, seed: u64) -> Result<Self, String> {
        let shapes = ids.par_iter().map(|&id| {
            let rig = normalized(assets, cache, id)?;
            Ok((cloud(&rig, points, seed, id.key()), Joints::of(rig.skeleton())))
        });
        Ok(Self { shapes: shapes.collect::<Result<_, String>>()?, points, seed })
    }

    /// The skeleton of the nearest shape, by the mean distance of points to the nearest of the other, both ways.
    pub fn nearest(&self, rig: &Rig, key: u64) -> Option<&Joints> {
        let own = cloud(rig, self.points, self.seed, key);
        let distances = self.shapes.par_iter().map(|(other, _)| chamfer(&own, other));
        let distances: Vec<f32> = distances.collect();
        let best = (0..distances.len()).min_by(|&a, &b| distances[a].total_cmp(&distances[b]))?;
        Some(&self.shapes[best].1)
    }
}

fn cloud(rig: &Rig, points: usize, seed: u64, key: u64) -> Vec<Vec3> {
    let config = CloudConfig { points, vertices: 0, by: By::Area };
    CloudSampler::new(rig.mesh(), &config).draw(&mut stream(seed, "retrieval", &[key])).positions
}

fn chamfer(a: &[Vec3], b: &[Vec3]) -> f32 {
    let one = |a: &[Vec3], b: &[Vec3]| {
        let least = |p: &Vec3| {
            b.iter().map(|q| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>()).fold(f32::INFINITY, f32::min).sqrt()
        };
        a.iter().map(least).sum::<f32>() / a.len().max(1) as f32
    };
    one(a, b) + one(b, a)
}
