//! Batches: points, bones and true weights of a few rigs.

use std::sync::Arc;

use riglab_augment::{AffineMap, Recipe};
use riglab_core::{Asset, JointId, Segment, Vec3};
use riglab_data::Mixture;
use riglab_geom::farthest_points;
use riglab_nn::skin_stage::PointEncoder;
use riglab_nn::skin_stage::ptv3::Layout;
use riglab_random::{Draw, Stream, stream};
use riglab_train::Source;

use super::config::{MergeConfig, SkinTaskConfig};
use super::motion::{Motion, poses};
use super::pairs::Around;
use super::ready::{Ready, row};
use crate::assets::{AssetId, Assets, Cache};
use crate::fsq_cvae::Prepared;

/// The rigs of a batch. Each goes through the network by itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// One after another.
    pub rigs: Vec<RigBatch>,
}

/// Plain arrays of a rig: n points, of which the first q are asked; j bones; p numbers told of a pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigBatch {
    /// [n, 6]: positions and normals.
    pub cloud: Vec<f32>,
    /// The points that queries of the shape start from.
    pub picks: Vec<i64>,
    /// [j, 3 k]: the points seen of each bone.
    pub bones: Vec<f32>,
    /// How many bones, j.
    pub count: usize,
    /// How many points are asked, q.
    pub queries: usize,
    /// [q, j, p]
    pub pairs: Vec<f32>,
    /// [q, j]: rows sum to 1, or are 0 where nothing holds a point.
    pub truth: Vec<f32>,
    /// [j]: bones that keep their true weights; empty for none.
    pub frozen: Vec<bool>,
    /// [j, 7]: attributes.
    pub swings: Vec<f32>,
    /// [j]: bones that have some.
    pub swinging: Vec<bool>,
    /// [j, 3, 4]: maps of a random pose, where the release's losses want one.
    pub maps: Vec<f32>,
    /// A motion, where the loss of physics wants one.
    pub motion: Option<Motion>,
    /// Where the backbone finds points, and the turn of its orders.
    pub layout: Option<(Layout, [usize; 4])>,
}

/// Makes batches by number.
pub struct BatchSource {
    config: SkinTaskConfig,
    assets: Arc<Assets>,
    cache: Arc<Cache<Ready, Variant>>,
    rigs: Mixture<AssetId>,
}

/// One of the ways in which an asset is varied.
pub type Variant = (AssetId, u64);

impl BatchSource {
    /// Batches of assets with the weights of their corpora; not empty.
    pub fn new(
        config: SkinTaskConfig,
        assets: Arc<Assets>,
        cache: Arc<Cache<Ready, Variant>>,
        parts: Vec<(f32, Vec<AssetId>)>,
    ) -> Self {
        Self { rigs: Mixture::new(config.train.seed, parts), config, assets, cache }
    }

    /// The rig at a place of the endless training sequence, in one of its variants.
    fn ready(&self, place: u64) -> Result<Arc<Ready>, String> {
        let (s, seed) = (&self.config.sampling, self.config.train.seed);
        let id = self.rigs.at(place);
        if self.config.recipe == Recipe::default() {
            return self.cache.get((id, 0), || {
                let rig = Prepared::new(self.assets.read(id).map_err(|e| e.to_string())?);
                let random = &mut stream(seed, "skin pool", &[id.key()]);
                Ok(kept(Ready::pooled(rig, &s.kept(), s.measured(), random)))
            });
        }
        let variant = match s.variants {
            0 => place,
            n => stream(seed, "skin variant", &[place]).below(n as usize) as u64,
        };
        let make = || {
            let (asset, key) = (self.assets.read(id).map_err(|e| e.to_string())?, [id.key(), variant]);
            let rig = varied(&self.config.recipe, asset, seed, &key)?;
            let random = &mut stream(seed, "skin pool", &key);
            Ok(kept(Ready::pooled(rig, &s.kept(), s.measured(), random)))
        };
        if s.variants == 0 { make().map(|(ready, _)| Arc::new(ready)) } else { self.cache.get((id, variant), make) }
    }
}

/// An asset as a recipe varies it, in the cube.
fn varied(recipe: &Recipe, asset: Asset, seed: u64, key: &[u64]) -> Result<Prepared, String> {
    let varied = recipe.apply_in_cube(asset.rig.normalized().0, seed, key);
    let varied = varied.map_err(|e| format!("{}: {e}", asset.name))?;
    let prepared = Prepared::of(asset.name, varied.rig, false);
    Ok(match varied.normals {
        Some(normals) => prepared.with_normals(normals),
        None => prepared,
    })
}

/// With its size in bytes.
fn kept(ready: Ready) -> (Ready, usize) {
    let bytes = ready.bytes();
    (ready, bytes)
}

impl Source for BatchSource {
    type Batch = Batch;

    fn batch(&self, number: u64) -> Result<Batch, String> {
        let rigs = self.config.sampling.rigs as u64;
        let each = (0..rigs).map(|k| {
            let place = number * rigs + k;
            let ready = self.ready(place)?;
            sample(&self.config, &ready, &mut stream(self.config.train.seed, "skin sample", &[place]))
        });
        Ok(Batch { rigs: each.collect::<Result<_, _>>()? })
    }
}

/// A rig's part of a batch, drawn by a stream.
///
/// # Errors
/// For a skeleton that cannot be posed.
pub fn sample(c: &SkinTaskConfig, ready: &Ready, random: &mut Stream) -> Result<RigBatch, String> {
    let s = &c.sampling;
    let map = c.augment.draw(c.data.up.axis(), random);
    let owners = owners(ready, &s.merge, random);
    let bones = Bones::new(ready, &owners, |p| map.exact(p));
    let mut order: Vec<usize> = (0..ready.points.len()).collect();
    random.shuffled(&mut order);
    order.truncate(s.points);
    let scale = scale(&map);
    let mut out = RigBatch {
        count: bones.of.len(),
        queries: s.queries.min((s.pairs / bones.of.len()).max(1)),
        ..RigBatch::default()
    };
    let mut positions = Vec::with_capacity(order.len());
    for &k in &order {
        let point = &ready.points[k];
        let position = map.position(point.position, random);
        positions.push(position);
        out.cloud.extend(position);
        out.cloud.extend(map.normal(point.normal));
    }
    for (&k, &position) in order.iter().zip(&positions).take(out.queries) {
        let (distances, heat) = bones.around(ready.around(k), scale);
        let around = Around { distances: &distances, heat: &heat };
        s.told.tell(position, &bones.segments, around, &mut out.pairs);
        out.truth.extend(bones.weights(ready, k));
    }
    out.picks = picks(c, &positions);
    for own in &bones.of {
        let seat = &ready.seats[own[0]];
        seat.seen(c.model.bones.seen, |p| map.exact(p), &mut out.bones);
        out.swinging.push(seat.swing.is_some());
        let mut swing = seat.swing.unwrap_or_default();
        swing.hit_radius *= scale;
        swing.gravity_direction = turned(&map, swing.gravity_direction);
        out.swings.extend(row(&swing));
    }
    out.frozen = frozen(c, out.count, random);
    if c.loss.released.is_on() {
        out.maps = poses(ready, &bones, &map, [c.loss.released.degrees, 0.0], &[1.0], random)?;
    }
    if c.loss.physics.weight > 0.0 {
        out.motion = Some(Motion::draw(&c.loss.physics, ready, &bones, &map, random)?);
    }
    if c.model.points.encoder == PointEncoder::Ptv3 {
        let mut turns = [0, 1, 2, 3];
        if c.model.points.ptv3.shuffle {
            random.shuffled(&mut turns);
        }
        out.layout = Some((Layout::new(&positions, &[positions.len()], c.model.points.ptv3.grid), turns));
    }
    Ok(out)
}

/// Of points in random order, those that queries of the shape start from.
pub fn picks(c: &SkinTaskConfig, positions: &[Vec3]) -> Vec<i64> {
    let shape = &c.model.shape;
    let drawn = &positions[..(shape.tokens * shape.drawn).min(positions.len())];
    farthest_points(drawn, shape.tokens, 0).into_iter().map(|i| i as i64).collect()
}

/// The bone that each bone is part of: itself, or one above it.
fn owners(ready: &Ready, merge: &MergeConfig, random: &mut Stream) -> Vec<usize> {
    let mut owners: Vec<usize> = (0..ready.seats.len()).collect();
    if !random.chance(merge.probability) {
        return owners;
    }
    for (b, seat) in ready.seats.iter().enumerate() {
        // Bones stand after those above them.
        if let Some(above) = seat.above.filter(|_| random.chance(merge.share)) {
            owners[b] = owners[above];
        }
    }
    owners
}

/// Bones after merging, under a map.
pub struct Bones {
    /// The bones that each is made of; the first gives it its seat.
    pub of: Vec<Vec<usize>>,
    /// All of their segments.
    pub segments: Vec<Vec<Segment>>,
}

impl Bones {
    /// Of bones and those they are part of.
    pub fn new(ready: &Ready, owners: &[usize], map: impl Fn(Vec3) -> Vec3) -> Self {
        let mut of: Vec<Vec<usize>> = vec![Vec::new(); owners.len()];
        owners.iter().enumerate().for_each(|(b, &owner)| of[owner].push(b));
        of.retain(|own| !own.is_empty());
        let moved = |s: &Segment| Segment { a: map(s.a), b: map(s.b) };
        let segments = |own: &Vec<usize>| {
            own.iter().flat_map(|&b| ready.rig.bones[b].segments.iter().map(moved)).collect::<Vec<_>>()
        };
        Self { segments: of.iter().map(segments).collect(), of }
    }

    /// All of a rig's as they are.
    pub fn all(ready: &Ready) -> Self {
        Self::new(ready, &(0..ready.seats.len()).collect::<Vec<_>>(), |p| p)
    }

    /// The joint that each has its seat from.
    pub fn joints(&self, ready: &Ready) -> Vec<JointId> {
        self.of.iter().map(|own| ready.rig.bones[own[0]].joint).collect()
    }

    /// The one above each; parents come first.
    pub fn parents(&self, ready: &Ready) -> Vec<Option<usize>> {
        let mut part = vec![0; ready.seats.len()];
        self.of.iter().enumerate().for_each(|(b, own)| own.iter().for_each(|&k| part[k] = b));
        self.of.iter().map(|own| ready.seats[own[0]].above.map(|k| part[k])).collect()
    }

    /// Distances and heat of a point, of those of the bones that these are made of.
    fn around(&self, of: Around, scale: f32) -> (Vec<f32>, Vec<f32>) {
        let nearest = |own: &Vec<usize>| own.iter().map(|&b| of.distances[b]).fold(f32::INFINITY, f32::min);
        // What is hot together heats as much as its parts: the equation is linear in what heats.
        let heat = |own: &Vec<usize>| own.iter().map(|&b| of.heat[b]).sum();
        let hot = if of.heat.is_empty() { Vec::new() } else { self.of.iter().map(heat).collect() };
        (self.of.iter().map(|own| scale * nearest(own)).collect(), hot)
    }

    /// Weights of a point of the pool, with sum 1 unless nothing holds it.
    fn weights(&self, ready: &Ready, k: usize) -> Vec<f32> {
        let weight = |b: &usize| ready.rig.weight(&ready.rig.bones[*b], &ready.points[k]);
        let mut row: Vec<f32> = self.of.iter().map(|own| own.iter().map(weight).sum()).collect();
        let sum: f32 = row.iter().sum();
        if sum > 0.0 {
            row.iter_mut().for_each(|w| *w /= sum);
        }
        row
    }
}

/// How much longer things are under a map, as the mean over directions.
pub fn scale(map: &AffineMap) -> f32 {
    let [x, y, z] = axes(map);
    x.cross(y).dot(z).abs().cbrt()
}

fn axes(map: &AffineMap) -> [glam::Vec3; 3] {
    let origin = glam::Vec3::from(map.exact([0.0; 3]));
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| glam::Vec3::from(map.exact(e)) - origin)
}

/// A direction under a map, of length 1.
fn turned(map: &AffineMap, d: Vec3) -> Vec3 {
    let [x, y, z] = axes(map);
    let moved = x * d[0] + y * d[1] + z * d[2];
    moved.try_normalize().map_or(d, Into::into)
}

fn frozen(c: &SkinTaskConfig, bones: usize, random: &mut Stream) -> Vec<bool> {
    let freeze = &c.loss.freeze;
    if !random.chance(freeze.probability) {
        return Vec::new();
    }
    let share = random.unit() * freeze.share;
    let count = ((share * bones as f32).round() as usize).min(bones - 1);
    let mut out: Vec<bool> = (0..bones).map(|b| b < count).collect();
    random.shuffled(&mut out);
    if count == 0 { Vec::new() } else { out }
}

#[cfg(test)]
mod tests {
    use riglab_augment::{CubeConfig, JitterConfig, PoseConfig};
    use riglab_core::{Joint, Mesh, Rig, Skeleton, SkinWeights};
    use riglab_geom::{By, CloudConfig};
    use riglab_nn::skin_stage::{BoneInput, SkinModelConfig};

    use super::*;
    use crate::fsq_cvae::{Place, Point};
    use crate::unirig_skin::config::{FreezeConfig, ReleasedConfig};
    use crate::unirig_skin::pairs::PairInput;
    use crate::unirig_skin::ready::{Measured, pool};

    /// A box four long with joints at 0, 1, 2 and 3; the second holds nothing.
    fn long_box() -> Rig {
        let corners: Vec<Vec3> = (0..40)
            .map(|i| {
                [i as f32 / 4.0 % 5.0 * 0.8, if i / 20 == 0 { 0.0 } else { 1.0 }, if i % 2 == 0 { 0.0 } else { 1.0 }]
            })
            .collect();
        let triangles = (0..38).map(|i| [i, i + 1, i + 2]).collect();
        let mesh = Mesh::new(corners.clone(), triangles).unwrap();
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: (k > 0).then(|| JointId(k - 1)),
            head: [f32::from(k), 0.5, 0.5],
        };
        let skeleton = Skeleton::new((0..4).map(joint).collect()).unwrap();
        let holder = |p: &Vec3| {
            if p[0] < 1.0 {
                0u16
            } else if p[0] < 2.5 {
                2
            } else {
                3
            }
        };
        let weights = SkinWeights::normalized(corners.iter().map(|p| [(holder(p), 1.0)])).unwrap();
        Rig::new(skeleton, mesh, weights).unwrap()
    }

    fn ready() -> Ready {
        let rig = Prepared::of("box".into(), long_box().normalized().0, false);
        Ready::pooled(rig, &cloud(), Measured { resolution: 24, heat: true }, &mut stream(1, "test", &[]))
    }

    fn cloud() -> CloudConfig {
        CloudConfig { points: 64, vertices: 32, ..CloudConfig::default() }
    }

    fn config() -> SkinTaskConfig {
        let mut c = SkinTaskConfig::default();
        c.model = SkinModelConfig { pair: PairInput::Features.width(), ..c.model };
        c.model.shape.tokens = 4;
        c.model.bones.seen = BoneInput::ParentJointAndTail;
        c.sampling.points = 48;
        c.sampling.queries = 20;
        c.sampling.pool = 64;
        c.sampling.told = PairInput::Features;
        c.validate().unwrap();
        c
    }

    #[test]
    fn pools_have_as_many_vertices_as_they_are_told_and_triangles_as_they_weigh() {
        let rig = Prepared::of("box".into(), long_box().normalized().0, false);
        let of = |vertices, by| {
            let cloud = CloudConfig { points: 2_000, vertices, by };
            let points = pool(&rig, &cloud, &mut stream(1, "test", &[]));
            assert_eq!(points.len(), cloud.points);
            points
        };
        let vertices = |points: &[Point]| points.iter().filter(|p| matches!(p.at, Place::Vertex(_))).count();
        let by = [By::Area, By::SquaredArea];
        // There are 40.
        assert_eq!(by.map(|by| [0, 8, 100].map(|n| vertices(&of(n, by)))), [[0, 8, 40]; 2]);
        let triangles = rig.rig.mesh().triangles().len();
        let largest = (0..triangles).map(|t| glam::Vec3::from(rig.rig.mesh().area_vector(t)).length());
        let largest = largest.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0 as u32;
        let on = |points: &[Point]| {
            points.iter().filter(|p| matches!(p.at, Place::Surface(p) if p.triangle == largest)).count()
        };
        let [plain, squared] = by.map(|by| on(&of(0, by)));
        assert!(squared > plain, "{squared} {plain}");
    }

    #[test]
    fn a_sample_has_what_the_network_reads() {
        let (ready, mut c) = (ready(), config());
        assert_eq!(ready.seats.iter().map(|s| s.above).collect::<Vec<_>>(), [None, Some(0), Some(1)]);
        c.loss.released = ReleasedConfig::unirig();
        c.loss.freeze = FreezeConfig { probability: 1.0, share: 1.0 };
        for seed in 0..20 {
            let b = sample(&c, &ready, &mut stream(seed, "test", &[])).unwrap();
            assert_eq!((b.count, b.queries, b.cloud.len(), b.picks.len()), (3, 20, 6 * 48, 4));
            assert_eq!((b.bones.len(), b.pairs.len(), b.truth.len(), b.maps.len()), (27, 20 * 3 * 12, 60, 36));
            assert!(b.truth.chunks_exact(3).all(|row| (row.iter().sum::<f32>() - 1.0).abs() < 1e-5));
            assert!(b.frozen.is_empty() || b.frozen.len() == 3 && b.frozen.contains(&false), "one is always free");
            assert!(b.layout.is_some());
            assert_eq!(b, sample(&c, &ready, &mut stream(seed, "test", &[])).unwrap());
        }
        c.sampling.pairs = 30;
        assert_eq!(sample(&c, &ready, &mut stream(1, "test", &[])).unwrap().queries, 10);
    }

    #[test]
    fn merged_bones_keep_all_weight() {
        let (ready, mut c) = (ready(), config());
        c.sampling.merge = MergeConfig { probability: 1.0, share: 0.5 };
        let mut counts = [0; 4];
        for seed in 0..40 {
            let b = sample(&c, &ready, &mut stream(seed, "test", &[])).unwrap();
            counts[b.count] += 1;
            assert!(b.truth.chunks_exact(b.count).all(|row| (row.iter().sum::<f32>() - 1.0).abs() < 1e-5));
        }
        assert!(counts[1] > 0 && counts[2] > 0 && counts[3] > 0, "{counts:?}");
    }

    #[test]
    fn distances_grow_with_the_rig() {
        let (ready, mut c) = (ready(), config());
        c.augment = riglab_augment::AffineConfig { scale: [2.0, 2.0], ..Default::default() };
        c.model.pair = 1;
        c.sampling.told = PairInput::Distance;
        let of = |c: &SkinTaskConfig| sample(c, &ready, &mut stream(3, "test", &[])).unwrap();
        let large = of(&c);
        c.augment.scale = [1.0, 1.0];
        let own = of(&c);
        for (a, b) in large.pairs.iter().zip(&own.pairs) {
            assert!((a - 2.0 * b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn variants_are_other_poses_of_the_same_rig() {
        let recipe =
            Recipe { pose: PoseConfig { probability: 1.0, degrees: 20.0, scale: [0.9, 1.1] }, ..Recipe::default() };
        let asset = || Asset {
            name: "box".into(),
            rig: long_box(),
            clips: Vec::new(),
            provenance: riglab_core::Provenance::default(),
        };
        let of = |recipe: &Recipe, key| varied(recipe, asset(), 0, &[key]).unwrap();
        let heads = |rig: &Prepared| rig.rig.skeleton().heads().to_vec();
        let (own, posed) = (of(&Recipe::default(), 0), of(&recipe, 0));
        assert_eq!(heads(&own), heads(&Prepared::new(asset())));
        assert_ne!(heads(&own), heads(&posed));
        assert_eq!(heads(&posed), heads(&of(&recipe, 0)));
        assert_ne!(heads(&posed), heads(&of(&recipe, 1)));
        assert_eq!(own.rig.weights(), posed.rig.weights());
        assert!(posed.rig.mesh().positions().iter().flatten().all(|x| x.abs() <= 1.0 + 1e-6));
    }

    #[test]
    fn points_have_the_normals_of_the_recipe_and_lie_where_it_leaves_them() {
        let jitter = JitterConfig { probability: 1.0, sigma: 0.0, normal_sigma: 0.2, ..JitterConfig::default() };
        let cube = CubeConfig { scale_probability: 1.0, scale: [0.5, 0.5], ..CubeConfig::default() };
        let of = |recipe: Recipe| {
            let asset = Asset {
                name: "box".into(),
                rig: long_box(),
                clips: Vec::new(),
                provenance: riglab_core::Provenance::default(),
            };
            let measured = Measured { resolution: 24, heat: true };
            Ready::pooled(varied(&recipe, asset, 0, &[0]).unwrap(), &cloud(), measured, &mut stream(1, "test", &[]))
        };
        let (own, noisy) = (of(Recipe::default()), of(Recipe { jitter, ..Recipe::default() }));
        let far = |(a, b): (&crate::fsq_cvae::Point, &crate::fsq_cvae::Point)| {
            assert_eq!(a.position, b.position);
            let along: f32 = a.normal.iter().zip(b.normal).map(|(x, y)| x * y).sum();
            // Vertices of triangles that cancel out have no normal of the geometry.
            assert!(along < 1.0 - 1e-6 && (along > 0.5 || matches!(a.at, Place::Vertex(_))), "{along}");
        };
        own.points.iter().zip(&noisy.points).for_each(far);
        let small = of(Recipe { cube, ..Recipe::default() });
        for (a, b) in small.points.iter().zip(&own.points) {
            assert!(a.position.iter().zip(b.position).all(|(x, y)| (x - 0.5 * y).abs() < 1e-5));
        }
    }
}
