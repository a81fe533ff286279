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

    /// Whether there is nothing to offer.
    pub fn is_empty(&self) -> bool {
        self.shapes.is_empty()
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

#[cfg(test)]
mod tests {
    use riglab_core::{Asset, Joint, Provenance, Skeleton, SkinWeights};
    use riglab_data::CorpusWriter;

    use super::*;
    use crate::tokenrig::testing::tetrahedron;

    #[test]
    fn an_asset_finds_itself_only_as_another() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.h5");
        let mut writer = CorpusWriter::create(&path).unwrap();
        for (name, height) in [("a", 0.0), ("b", 0.5)] {
            let joint = Joint { name: "a".into(), parent: None, head: [0.0, height, 0.0] };
            let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
            let rig = Rig::new(Skeleton::new(vec![joint]).unwrap(), tetrahedron(), weights).unwrap();
            let provenance = Provenance::default();
            writer.add(&Asset { name: name.into(), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&["train", "train"]).unwrap();
        let (assets, cache) = (Assets::open(&[path]).unwrap(), Cache::new(1));
        let ids = assets.split("train").unwrap();
        let [a, b] = [0, 1].map(|k| normalized(&assets, &cache, ids[k]).unwrap());
        let found = |ids: &[AssetId], rig: &Rig, id| {
            Retrieval::new(&assets, &cache, ids, 32, 0).unwrap().offer(rig, id).map(|o| o.nearest.positions)
        };
        // Both have the same mesh, so that only their numbers tell them apart.
        assert_eq!(found(&ids, &a, ids[0]).unwrap(), Joints::of(b.skeleton()).positions);
        assert_eq!(found(&ids, &b, ids[1]).unwrap(), Joints::of(a.skeleton()).positions);
        assert_eq!(found(&ids[..1], &b, ids[1]).unwrap(), Joints::of(a.skeleton()).positions);
        assert!(found(&ids[..1], &a, ids[0]).is_none(), "nothing but itself");
    }
}
