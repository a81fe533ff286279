//! The rivals without learning: the skeleton of the training shape that is nearest, as it is and fitted to the mesh.

use rayon::prelude::*;
use riglab_core::{Rig, Vec3};
use riglab_geom::{By, CloudConfig, CloudSampler};
use riglab_metric::{Joints, fit};
use riglab_random::stream;

use super::batch::normalized;
use crate::assets::{AssetId, Assets, Cache};

/// Training shapes as points, with their skeletons.
pub struct Retrieval {
    shapes: Vec<(Vec<Vec3>, Joints)>,
    /// Which assets they are of.
    of: Vec<AssetId>,
    points: usize,
    seed: u64,
}

/// Points that a template is fitted by: more do not help, and it costs their square.
const FITTED: usize = 256;

/// What training shapes offer for a mesh.
pub struct Offered {
    /// The skeleton of the nearest shape.
    pub nearest: Joints,
    /// The same, carried along as that shape is bent onto the mesh.
    pub fitted: Joints,
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
        Ok(Self { shapes: shapes.collect::<Result<_, String>>()?, of: ids.to_vec(), points, seed })
    }

    /// The skeleton of the shape that is nearest to an asset's, by the mean distance of points to the nearest of the other,
    /// both ways. An asset that is a training shape itself is compared with the others: its own skeleton would be the truth.
    pub fn offer(&self, rig: &Rig, id: AssetId) -> Option<Offered> {
        let own = cloud(rig, self.points, self.seed, id.key());
        let distances = self.shapes.par_iter().map(|(other, _)| chamfer(&own, other));
        let distances: Vec<f32> = distances.collect();
        let others = (0..distances.len()).filter(|&k| self.of[k] != id);
        let best = others.min_by(|&a, &b| distances[a].total_cmp(&distances[b]))?;
        let (shape, nearest) = &self.shapes[best];
        let some = |points: &[Vec3]| points[..points.len().min(FITTED)].to_vec();
        let positions = fit(&some(shape), &nearest.positions, &some(&own))?;
        let fitted = Joints { positions, parents: nearest.parents.clone() };
        Some(Offered { nearest: nearest.clone(), fitted })
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
