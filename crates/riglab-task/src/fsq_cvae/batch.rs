//! Batches: points, weights and queries of a few bones of a few rigs.

use std::sync::Arc;

use riglab_augment::AffineMap;
use riglab_core::{Segment, Vec3};
use riglab_data::Mixture;
use riglab_geom::farthest_points;
use riglab_nn::fsq_cvae::{BONE_FEATURES, BONE_POINT_FEATURES, Bottleneck, REGION, SkinQueries};
use riglab_random::{Draw, Stream, stream};
use riglab_train::Source;

use super::config::{FsqCvaeTaskConfig, PointMix};
use super::prepare::{Bone, Point, Prepared};
use crate::assets::{AssetId, Assets, Cache};

/// Plain arrays, as the network's shapes name them: r rigs, m bones, 6 = position and normal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Rigs.
    pub rigs: usize,
    /// Bones of all rigs.
    pub bones: usize,
    /// [r, n, 6]: what the condition encoder sees.
    pub shape: Vec<f32>,
    /// [r, s]: farthest points among them.
    pub shape_queries: Vec<i64>,
    /// [m, n, 6]: what the skin encoder sees.
    pub skin: Vec<f32>,
    /// [m, n]
    pub skin_weights: Vec<f32>,
    /// [m, t]: query points, none with learned queries.
    pub skin_queries: Vec<i64>,
    /// [m, 6]: where each bone works, with a prior.
    pub regions: Vec<f32>,
    /// [m, p, 6]: where the decoder is asked.
    pub points: Vec<f32>,
    /// [m, p]
    pub targets: Vec<f32>,
    /// [m, 7], with bone geometry; 13 with a prior.
    pub bone_features: Vec<f32>,
    /// [m, p, 10], with bone geometry; 17 with a prior.
    pub bone_points: Vec<f32>,
    /// Codes the decoder is given.
    pub prefix: usize,
    /// [m, prefix, axes]: how many levels off those are; none where all are exact.
    pub off: Vec<f32>,
    /// [m, 6]: how far off the frames are that codes tell; none where all are as they are.
    pub frames_off: Vec<f32>,
    /// [m, prefix, learned axes] of N(0, 1), where codes are drawn.
    pub noise: Vec<f32>,
}

/// Makes batches by number.
pub struct BatchSource {
    config: FsqCvaeTaskConfig,
    assets: Arc<Assets>,
    cache: Arc<Cache<Prepared>>,
    /// Rigs by place; one may occur several times in an epoch.
    rigs: Mixture<AssetId>,
}

impl BatchSource {
    /// Batches of assets with the weights of their corpora; not empty.
    pub fn new(
        config: FsqCvaeTaskConfig,
        assets: Arc<Assets>,
        cache: Arc<Cache<Prepared>>,
        parts: &[(f32, Vec<AssetId>)],
    ) -> Self {
        let rigs = parts.iter().map(|(weight, of)| (*weight, Self::epoch(&config, &assets, of))).collect();
        Self { rigs: Mixture::new(config.train.seed, rigs), config, assets, cache }
    }

    /// The rigs of an epoch, before they are put in order.
    fn epoch(config: &FsqCvaeTaskConfig, assets: &Assets, of: &[AssetId]) -> Vec<AssetId> {
        let power = config.sampling.bone_power;
        let shares: Vec<f32> = of.iter().map(|&id| (assets.counts(id)[2] as f32).powf(power)).collect();
        let mean = shares.iter().sum::<f32>() / shares.len().max(1) as f32;
        // At power 0 each once; else by their share, to a quarter of the mean, at least once.
        let times = |share: f32| if power == 0.0 { 1 } else { (4.0 * share / mean).round().max(1.0) as usize };
        of.iter().zip(&shares).flat_map(|(&id, &s)| std::iter::repeat_n(id, times(s))).collect()
    }

    /// Batches that go over every rig of an epoch once.
    pub fn epoch_batches(&self) -> u64 {
        (self.rigs.len() as u64).div_ceil(self.config.sampling.rigs as u64)
    }

    fn prepared(&self, id: AssetId) -> Result<Arc<Prepared>, String> {
        prepared(&self.assets, &self.cache, id, self.config.model.extensions.prior)
    }

    fn prefix(&self, random: &mut Stream) -> usize {
        let (all, p) = (self.config.model.skin_tokens, &self.config.sampling.prefix);
        if random.chance(p.full) {
            return all;
        }
        match p.lengths.as_slice() {
            [] => {
                let fewest = self.config.model.fewest_codes();
                fewest + random.below(all + 1 - fewest)
            }
            lengths => lengths[random.below(lengths.len())].min(all),
        }
    }
}

/// A prepared asset, from the cache or the corpus; with what geometry alone says where `prior`.
pub fn prepared(assets: &Assets, cache: &Cache<Prepared>, id: AssetId, prior: bool) -> Result<Arc<Prepared>, String> {
    cache.get(id, || {
        let made = Prepared::new(assets.read(id).map_err(|e| e.to_string())?);
        let made = if prior { made.with_prior() } else { made };
        let bytes = made.bytes();
        Ok((made, bytes))
    })
}

impl Source for BatchSource {
    type Batch = Batch;

    fn batch(&self, number: u64) -> Result<Batch, String> {
        let (c, s) = (&self.config, &self.config.sampling);
        let mut random = stream(c.train.seed, "batch", &[number]);
        let mut batch = Batch { prefix: self.prefix(&mut random), ..Batch::default() };
        for k in 0..s.rigs as u64 {
            let rig = self.prepared(self.rigs.at(number * s.rigs as u64 + k))?;
            let map = c.augment.draw(c.data.up.axis(), &mut random);
            let mut make = Maker::new(c, &rig, Some(map), &mut random);
            make.shape(&mut batch);
            let segments = make.segments();
            for b in chosen(rig.bones.len(), s.bones, make.random) {
                make.skin(b, &mut batch);
                let points = make.mix(&rig.bones[b], &s.decoder);
                make.ask(b, &points, &segments, &mut batch);
            }
        }
        if c.model.bottleneck == Bottleneck::Gaussian {
            let mut random = stream(c.train.seed, "latent noise", &[number]);
            let numbers = batch.bones * batch.prefix * c.model.learned_axes();
            batch.noise = (0..numbers).map(|_| random.normal()).collect();
        }
        if s.code_noise > 0.0 {
            let mut random = stream(c.train.seed, "code noise", &[number]);
            batch.off = codes_off(c, batch.bones * batch.prefix, &mut random);
        }
        if s.frame_noise > 0.0 {
            let mut random = stream(c.train.seed, "frame noise", &[number]);
            batch.frames_off = (0..batch.bones * REGION).map(|_| s.frame_noise * random.normal()).collect();
        }
        Ok(batch)
    }
}

/// How many levels off the axes of some codes are; those that are told, none.
fn codes_off(c: &FsqCvaeTaskConfig, codes: usize, random: &mut Stream) -> Vec<f32> {
    let axes = c.model.levels.len();
    let told = axes - c.model.learned_axes();
    (0..codes * axes).map(|k| if k % axes < told { 0.0 } else { off(c.sampling.code_noise, random) }).collect()
}

/// One level up or down as often as is told, else none.
fn off(share: f32, random: &mut Stream) -> f32 {
    let up = random.chance(0.5);
    if !random.chance(share) {
        0.0
    } else if up {
        1.0
    } else {
        -1.0
    }
}

/// `count` of `n` bones: all different where there are enough, else over and over.
fn chosen(n: usize, count: usize, random: &mut Stream) -> Vec<usize> {
    let mut out = Vec::with_capacity(count);
    while out.len() < count {
        let mut all: Vec<usize> = (0..n).collect();
        random.shuffled(&mut all);
        out.extend(all.into_iter().take(count - out.len()));
    }
    out
}

/// Fills arrays from one rig, under one map.
pub struct Maker<'a> {
    /// The task's settings.
    pub config: &'a FsqCvaeTaskConfig,
    /// The rig.
    pub rig: &'a Prepared,
    /// How points are moved; `None` leaves them.
    pub map: Option<AffineMap>,
    /// Where random numbers come from.
    pub random: &'a mut Stream,
    /// With a prior, where each bone works, under the map.
    regions: Vec<[f32; REGION]>,
}

impl<'a> Maker<'a> {
    /// For a rig under a map; `None` leaves it.
    pub fn new(
        config: &'a FsqCvaeTaskConfig,
        rig: &'a Prepared,
        map: Option<AffineMap>,
        random: &'a mut Stream,
    ) -> Self {
        let moved = |p| map.as_ref().map_or(p, |m| m.exact(p));
        let known = config.model.extensions.prior.then(|| rig.regions());
        let regions = known.map(|known| known.under(moved)).unwrap_or_default();
        Self { config, rig, map, random, regions }
    }

    /// Adds the condition encoder's cloud and queries.
    pub fn shape(&mut self, batch: &mut Batch) {
        let (n, tokens) = (self.config.sampling.shape_points, self.config.model.shape_tokens);
        let mut positions = Vec::with_capacity(n);
        for _ in 0..n {
            let point = self.rig.surface(self.random);
            positions.push(self.push(&point, &mut batch.shape));
        }
        // Points are drawn one by one: the first ones are as good as any.
        let from = match self.config.sampling.shape_drawn {
            0 => n,
            drawn => n.min(drawn.saturating_mul(tokens)),
        };
        batch.shape_queries.extend(farthest_points(&positions[..from], tokens, 0).into_iter().map(|i| i as i64));
        batch.rigs += 1;
    }

    /// Adds a bone's cloud for the skin encoder, with weights and queries.
    pub fn skin(&mut self, b: usize, batch: &mut Batch) {
        let (bone, model) = (&self.rig.bones[b], &self.config.model);
        let mix = &self.config.sampling.encoder;
        let points = self.mix(bone, mix);
        let mut positions = Vec::with_capacity(points.len());
        let mut weights = Vec::with_capacity(points.len());
        for point in &points {
            positions.push(self.push(point, &mut batch.skin));
            weights.push(self.rig.weight(bone, point));
        }
        let picks = match model.skin_queries {
            SkinQueries::Learned => Vec::new(),
            SkinQueries::Farthest => farthest_points(&positions, model.skin_tokens, 0),
            SkinQueries::Active => {
                let active = &positions[..mix.active];
                farthest_points(active, model.skin_tokens, central(active, &weights[..mix.active]))
            }
        };
        batch.skin_queries.extend(picks.into_iter().map(|i| i as i64));
        batch.skin_weights.extend(weights);
        batch.regions.extend(self.regions.get(b).into_iter().flatten());
        batch.bones += 1;
    }

    /// Points of a mix: where the bone holds the mesh, around that, and anywhere. A bone that holds
    /// everything has nothing around it; those points lie anywhere.
    pub fn mix(&mut self, bone: &Bone, mix: &PointMix) -> Vec<Point> {
        let (share, rig) = (self.config.sampling.vertex_share, self.rig);
        let mut points: Vec<Point> = Vec::with_capacity(mix.total());
        for (patch, count) in [(&bone.held, mix.active), (&bone.shell, mix.near)] {
            for _ in 0..count {
                let point = rig.within(patch, share, self.random);
                points.push(point.unwrap_or_else(|| rig.anywhere(share, self.random)));
            }
        }
        for _ in 0..mix.uniform {
            points.push(rig.anywhere(share, self.random));
        }
        points
    }

    /// Adds points for the decoder, with the bone's weights and, where the model wants it, geometry.
    pub fn ask(&mut self, b: usize, points: &[Point], segments: &[Vec<Segment>], batch: &mut Batch) {
        let bone = &self.rig.bones[b];
        let (geometry, told) = (self.config.model.extensions.bone_geometry, self.rig.told());
        if geometry {
            bone_features(&segments[b], &mut batch.bone_features);
            batch.bone_features.extend(self.regions.get(b).into_iter().flatten());
        }
        for point in points {
            let position = self.push(point, &mut batch.points);
            batch.targets.push(self.rig.weight(bone, point));
            if geometry {
                let distances: Vec<f32> = segments.iter().map(|s| Segment::nearest_of(s, position).1).collect();
                point_features(position, b, &segments[b], &distances, &mut batch.bone_points);
                if let Some(told) = told {
                    told.tell(&point.at, b, &mut batch.bone_points);
                }
            }
        }
    }

    /// The segments of all bones, under the map.
    pub fn segments(&self) -> Vec<Vec<Segment>> {
        let moved = |p| self.map.as_ref().map_or(p, |m| m.exact(p));
        let each = |b: &Bone| b.segments.iter().map(|s| Segment { a: moved(s.a), b: moved(s.b) }).collect();
        self.rig.bones.iter().map(each).collect()
    }

    /// Adds position and normal under the map; gives the position.
    fn push(&mut self, point: &Point, out: &mut Vec<f32>) -> Vec3 {
        let (position, normal) = match &self.map {
            Some(map) => (map.position(point.position, self.random), map.normal(point.normal)),
            None => (point.position, point.normal),
        };
        out.extend(position);
        out.extend(normal);
        position
    }
}

/// The point nearest to the centre of weight.
fn central(points: &[Vec3], weights: &[f32]) -> usize {
    let total: f32 = weights.iter().sum::<f32>().max(1e-6);
    let center: Vec3 = std::array::from_fn(|k| points.iter().zip(weights).map(|(p, w)| p[k] * w).sum::<f32>() / total);
    let d = |p: &Vec3| (0..3).map(|k| (p[k] - center[k]).powi(2)).sum::<f32>();
    (0..points.len()).min_by(|&a, &b| d(&points[a]).total_cmp(&d(&points[b]))).unwrap_or(0)
}

/// Head, mean tail, length.
pub fn bone_features(segments: &[Segment], out: &mut Vec<f32>) {
    let n = segments.len().max(1) as f32;
    let head = segments.first().map_or([0.0; 3], |s| s.a);
    let tail: Vec3 = std::array::from_fn(|k| segments.iter().map(|s| s.b[k]).sum::<f32>() / n);
    out.extend(head);
    out.extend(tail);
    out.push(Segment { a: head, b: tail }.length());
    const { assert!(BONE_FEATURES == 7) };
}

/// How a point lies to bone `b` of a rig, whose bones are at `distances` from it.
pub fn point_features(p: Vec3, b: usize, segments: &[Segment], distances: &[f32], out: &mut Vec<f32>) {
    const { assert!(BONE_POINT_FEATURES == 10) };
    let own = distances[b].max(1e-4);
    let least = distances.iter().copied().fold(f32::INFINITY, f32::min).max(1e-4);
    let share = |power: i32| {
        let sum: f32 = distances.iter().map(|d| (least / d.max(1e-4)).powi(power)).sum();
        (least / own).powi(power) / sum
    };
    let sharp = share(8);
    let head = segments.first().map_or([0.0; 3], |s| s.a);
    out.extend([own, own.ln(), sharp, share(2), sharp.max(1e-6).ln() / 4.0, least / own]);
    out.extend((0..3).map(|k| p[k] - head[k]));
    out.push(Segment::nearest_of(segments, p).0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chosen_bones_differ_while_there_are_enough() {
        let mut random = stream(1, "test", &[]);
        let mut all = chosen(6, 6, &mut random);
        all.sort_unstable();
        assert_eq!(all, [0, 1, 2, 3, 4, 5]);
        assert_eq!(chosen(2, 5, &mut random).len(), 5);
    }

    #[test]
    fn codes_are_as_often_off_as_told() {
        let mut random = stream(1, "test", &[]);
        let drawn: Vec<f32> = (0..10_000).map(|_| off(0.2, &mut random)).collect();
        let share = |of: f32| drawn.iter().filter(|x| **x == of).count() as f32 / 10_000.0;
        assert!((share(0.0) - 0.8).abs() < 0.02 && (share(1.0) - 0.1).abs() < 0.02, "{} {}", share(0.0), share(1.0));
        assert!((share(0.0) + share(1.0) + share(-1.0) - 1.0).abs() < 1e-6);

        // What tells a frame is exact.
        let mut config = FsqCvaeTaskConfig::default();
        (config.sampling.code_noise, config.model.extensions.frame) = (1.0, true);
        let drawn = codes_off(&config, 50, &mut random);
        assert!(drawn.len() == 300 && drawn.chunks(6).all(|c| c[..3] == [0.0; 3] && c[3..].iter().all(|x| *x != 0.0)));
    }

    #[test]
    fn the_centre_is_weighted() {
        let points = [[0.0; 3], [1.0, 0.0, 0.0], [10.0, 0.0, 0.0]];
        assert_eq!(central(&points, &[1.0, 1.0, 0.0]), 0);
        assert_eq!(central(&points, &[0.0, 0.1, 1.0]), 2);
    }

    #[test]
    fn geometry_tells_bones_apart() {
        let segments = [
            vec![Segment { a: [0.0; 3], b: [0.0, 1.0, 0.0] }],
            vec![Segment { a: [0.0, 1.0, 0.0], b: [0.0, 2.0, 0.0] }],
        ];
        let p = [0.1, 0.5, 0.0];
        let distances: Vec<f32> = segments.iter().map(|s| Segment::nearest_of(s, p).1).collect();
        let mut features = Vec::new();
        point_features(p, 0, &segments[0], &distances, &mut features);
        point_features(p, 1, &segments[1], &distances, &mut features);
        assert!(features[2] > 0.99 && features[12] < 0.01 && features.len() == 20);
        assert!((features[9] - 0.5).abs() < 1e-6);
    }
}
