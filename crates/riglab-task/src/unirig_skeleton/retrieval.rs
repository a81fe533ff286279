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
    shapes: Vec<(Points, Joints)>,
    /// Which assets they are of.
    of: Vec<AssetId>,
    points: usize,
    seed: u64,
}

/// Points by which shapes are put in order before they are compared in full, nearest first: then most are seen to be
/// further away after a few of theirs.
const COARSE: usize = 64;

/// So many shapes, the nearest by these few points, are compared in full. Of 3,000 made-up shapes the nearest of all was among
/// the first four by them.
const MOST: usize = 1024;

/// Shapes that are compared at once. All of them are told the same bound, so that threads change nothing.
const AT_ONCE: usize = 64;

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
    /// Reads the training assets; shapes are compared by so many points. Those whose skeleton has no bone, which is compared
    /// with none, are passed over.
    ///
    /// # Errors
    /// When an asset cannot be read.
    pub fn new(assets: &Assets, cache: &Cache<Rig>, ids: &[AssetId], points: usize, seed: u64) -> Result<Self, String> {
        let of: Vec<AssetId> = ids.iter().copied().filter(|&id| assets.counts(id)[2] > 1).collect();
        let shapes = of.par_iter().map(|&id| {
            let rig = normalized(assets, cache, id)?;
            Ok((Points::of(&cloud(&rig, points, seed, id.key())), Joints::of(rig.skeleton())))
        });
        Ok(Self { shapes: shapes.collect::<Result<_, String>>()?, of, points, seed })
    }

    /// Whether there is nothing to offer.
    pub fn is_empty(&self) -> bool {
        self.shapes.is_empty()
    }

    /// The skeleton of the shape that is nearest to an asset's, by the mean distance of points to the nearest of the other,
    /// both ways. An asset that is a training shape itself is compared with the others: its own skeleton would be the truth.
    pub fn offer(&self, rig: &Rig, id: AssetId) -> Option<Offered> {
        let own = Points::of(&cloud(rig, self.points, self.seed, id.key()));
        let (shape, nearest) = &self.shapes[self.nearest(&own, |k| self.of[k] != id)?];
        let positions = fit(&shape.first(FITTED), &nearest.positions, &own.first(FITTED))?;
        let fitted = Joints { positions, parents: nearest.parents.clone() };
        Some(Offered { nearest: nearest.clone(), fitted })
    }

    /// Of the shapes that are wanted, by their places, the one nearest to points; of equals the first. Of more than [`MOST`]
    /// the furthest by a few points are passed over.
    fn nearest(&self, own: &Points, wanted: impl Fn(usize) -> bool) -> Option<usize> {
        let others: Vec<usize> = (0..self.shapes.len()).filter(|&k| wanted(k)).collect();
        let few = own.some(COARSE);
        let coarse = |&k: &usize| (k, few.chamfer(&self.shapes[k].0.some(COARSE), f32::INFINITY));
        let mut ordered: Vec<(usize, f32)> = others.par_iter().map(coarse).collect();
        ordered.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        ordered.truncate(MOST);
        let mut best: Option<(f32, usize)> = None;
        for some in ordered.chunks(AT_ONCE) {
            let bound = best.map_or(f32::INFINITY, |(least, _)| least);
            let found = some.par_iter().map(|&(k, _)| (own.chamfer(&self.shapes[k].0, bound), k));
            let found: Vec<(f32, usize)> = found.collect();
            best = found.into_iter().chain(best).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        best.map(|(_, k)| k)
    }
}

/// Points as three columns, which processors compare several at a time.
struct Points([Vec<f32>; 3]);

impl Points {
    fn of(points: &[Vec3]) -> Self {
        Self([0, 1, 2].map(|axis| points.iter().map(|p| p[axis]).collect()))
    }

    fn len(&self) -> usize {
        self.0[0].len()
    }

    fn at(&self, k: usize) -> Vec3 {
        [0, 1, 2].map(|axis| self.0[axis][k])
    }

    /// The first so many; all are drawn alike.
    fn first(&self, most: usize) -> Vec<Vec3> {
        (0..self.len().min(most)).map(|k| self.at(k)).collect()
    }

    fn some(&self, most: usize) -> Self {
        Self::of(&self.first(most))
    }

    /// The mean distance of each to the nearest of the other, both ways; infinite where that is more than `bound`, as far as
    /// is seen on the way.
    fn chamfer(&self, other: &Self, bound: f32) -> f32 {
        let one = self.mean_distance(other, bound);
        if one > bound { f32::INFINITY } else { one + other.mean_distance(self, bound) }
    }

    /// As [`Self::chamfer`], one way.
    fn mean_distance(&self, other: &Self, bound: f32) -> f32 {
        let (mut sum, count) = (0.0, self.len().max(1) as f32);
        for k in 0..self.len() {
            sum += other.least_square(self.at(k)).sqrt();
            // Sums only rise.
            if sum / count > bound {
                return f32::INFINITY;
            }
        }
        sum / count
    }

    /// The square of the distance to the nearest of these points.
    fn least_square(&self, p: Vec3) -> f32 {
        const LANES: usize = 16;
        let [x, y, z] = &self.0;
        let square = |x: f32, y: f32, z: f32| (p[0] - x).powi(2) + (p[1] - y).powi(2) + (p[2] - z).powi(2);
        let mut least = [f32::INFINITY; LANES];
        let ((xs, more_x), (ys, more_y), (zs, more_z)) =
            (x.as_chunks::<LANES>(), y.as_chunks::<LANES>(), z.as_chunks::<LANES>());
        for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
            for lane in 0..LANES {
                let d = square(x[lane], y[lane], z[lane]);
                least[lane] = if d < least[lane] { d } else { least[lane] };
            }
        }
        let rest = more_x.iter().zip(more_y).zip(more_z).map(|((x, y), z)| square(*x, *y, *z));
        least.into_iter().chain(rest).fold(f32::INFINITY, f32::min)
    }
}

fn cloud(rig: &Rig, points: usize, seed: u64, key: u64) -> Vec<Vec3> {
    let config = CloudConfig { points, vertices: 0, by: By::Area };
    CloudSampler::new(rig.mesh(), &config).draw(&mut stream(seed, "retrieval", &[key])).positions
}

#[cfg(test)]
mod tests {
    use riglab_core::{Asset, Joint, JointId, Provenance, Skeleton, SkinWeights};
    use riglab_data::CorpusWriter;
    use riglab_random::Draw;

    use super::*;
    use crate::assets::DataConfig;
    use crate::tokenrig::testing::tetrahedron;

    /// The formula as it is written.
    fn chamfer(a: &[Vec3], b: &[Vec3]) -> f32 {
        let one = |a: &[Vec3], b: &[Vec3]| {
            let square = |p: &Vec3, q: &Vec3| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>();
            let least = |p: &Vec3| b.iter().map(|q| square(p, q)).fold(f32::INFINITY, f32::min).sqrt();
            a.iter().map(least).sum::<f32>() / a.len().max(1) as f32
        };
        one(a, b) + one(b, a)
    }

    #[test]
    fn the_nearest_shape_is_that_of_the_formula() {
        let mut random = stream(0, "clouds", &[]);
        let mut cloud = |spread: f32| -> Vec<Vec3> {
            (0..100).map(|_| [0, 1, 2].map(|_| spread * (random.unit() - 0.5))).collect()
        };
        let clouds: Vec<Vec<Vec3>> = (0..300).map(|k| cloud(1.0 + (k % 7) as f32 * 0.05)).collect();
        let joints = || Joints { positions: vec![[0.0; 3]], parents: vec![None] };
        // Of equal ones, which the last two hundred are to others before them, the first.
        let shapes = (0..500).map(|k| (Points::of(&clouds[k % 300]), joints())).collect();
        let all = Retrieval { shapes, of: Vec::new(), points: 100, seed: 0 };
        for own in 0..20 {
            let by = |k: &usize| chamfer(&clouds[own], &clouds[k % 300]);
            let wanted = (0..500).filter(|&k| k != own).min_by(|a, b| by(a).total_cmp(&by(b)));
            assert_eq!(all.nearest(&Points::of(&clouds[own]), |k| k != own), wanted);
            let (a, b) = (Points::of(&clouds[own]), Points::of(&clouds[own + 1]));
            assert_eq!(a.chamfer(&b, f32::INFINITY), chamfer(&clouds[own], &clouds[own + 1]));
        }
    }

    #[test]
    fn an_asset_finds_itself_only_as_another() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.h5");
        let mut writer = CorpusWriter::create(&path).unwrap();
        // The last one has no bone.
        for (name, heights) in [("a", &[0.0, 0.25][..]), ("b", &[0.5, 0.75]), ("c", &[0.0])] {
            let joint = |(k, height): (usize, &f32)| Joint {
                name: format!("j{k}"),
                parent: k.checked_sub(1).map(|parent| JointId(parent as u16)),
                head: [0.0, *height, 0.0],
            };
            let skeleton = Skeleton::new(heights.iter().enumerate().map(joint).collect()).unwrap();
            let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
            let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
            let provenance = Provenance::default();
            writer.add(&Asset { name: name.into(), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&["train"; 3]).unwrap();
        let (assets, cache) = (Assets::open(&[path]).unwrap(), Cache::of(&DataConfig::default(), 1));
        let ids = assets.split("train").unwrap();
        let [a, b] = [0, 1].map(|k| normalized(&assets, &cache, ids[k]).unwrap());
        let found = |ids: &[AssetId], rig: &Rig, id| {
            Retrieval::new(&assets, &cache, ids, 32, 0).unwrap().offer(rig, id).map(|o| o.nearest.positions)
        };
        // All have the same mesh, so that only their numbers tell them apart.
        assert_eq!(found(&ids, &a, ids[0]).unwrap(), Joints::of(b.skeleton()).positions);
        assert_eq!(found(&ids, &b, ids[1]).unwrap(), Joints::of(a.skeleton()).positions);
        assert_eq!(found(&ids[..1], &b, ids[1]).unwrap(), Joints::of(a.skeleton()).positions);
        assert!(found(&ids[..1], &a, ids[0]).is_none(), "nothing but itself");
        // What has no bone is offered to none, and counts as nothing to be compared with.
        let third = normalized(&assets, &cache, ids[2]).unwrap();
        assert_eq!(found(&[ids[2], ids[1]], &third, ids[0]).unwrap(), Joints::of(b.skeleton()).positions);
        assert!(Retrieval::new(&assets, &cache, &ids[2..], 32, 0).unwrap().is_empty());
    }
}
