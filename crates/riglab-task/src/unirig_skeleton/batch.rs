//! Batches: points of a few rigs, and their skeletons' tokens.

use std::ops::Range;
use std::sync::Arc;

use riglab_core::{Rig, Skeleton, Vec3};
use riglab_data::Mixture;
use riglab_geom::{CloudConfig, CloudSampler, farthest_points};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::skin_stage::ptv3::Curve;
use riglab_random::{Draw, Stream, stream};
use riglab_token::{Bones, EncodeFault, Encoded, Template, Tokenizer};
use riglab_train::Source;
use tch::Device;

use super::config::SkeletonTaskConfig;
use crate::assets::{AssetId, Assets, Cache};
use crate::sequences::{Unfit, filled};

/// Plain arrays: b rigs, n points, p picked ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Rigs.
    pub rigs: usize,
    /// [b, n, 6]: position and normal.
    pub cloud: Vec<f32>,
    /// [b, p]: the points that queries start from.
    pub picks: Vec<i64>,
    /// The tokens of all rigs, one after another.
    pub ids: Vec<i64>,
    /// How many of each.
    pub lengths: Vec<i64>,
    /// Assets that were passed over, as their sequences are too long after augmentation.
    pub skipped: usize,
    /// Joints outside the range, written at its border.
    pub clamped: usize,
}

impl Batch {
    /// Its rigs, dealt out to as many threads as this one may take, about as many tokens to each; all together on other
    /// devices.
    pub(crate) fn dealt(&self, device: Device) -> Vec<Vec<usize>> {
        deal(&self.lengths, riglab_torch::threads_on(device))
    }

    /// Some of its rigs alone.
    pub(crate) fn some(&self, rigs: &[usize]) -> Self {
        let (points, picks) = (self.cloud.len() / self.rigs.max(1), self.picks.len() / self.rigs.max(1));
        Self {
            rigs: rigs.len(),
            cloud: rigs.iter().flat_map(|&r| &self.cloud[r * points..(r + 1) * points]).copied().collect(),
            picks: rigs.iter().flat_map(|&r| &self.picks[r * picks..(r + 1) * picks]).copied().collect(),
            ids: rigs.iter().flat_map(|&r| &self.ids[self.tokens(r)]).copied().collect(),
            lengths: rigs.iter().map(|&r| self.lengths[r]).collect(),
            ..Self::default()
        }
    }

    /// The tokens of a rig among all.
    pub(crate) fn tokens(&self, rig: usize) -> Range<usize> {
        let start: i64 = self.lengths[..rig].iter().sum();
        start as usize..(start + self.lengths[rig]) as usize
    }
}

/// Numbers of sequences in as many groups as there are threads, none of them empty: the longest first, each to the group
/// that has fewest tokens.
fn deal(lengths: &[i64], threads: usize) -> Vec<Vec<usize>> {
    let mut groups = vec![(0, Vec::new()); threads.min(lengths.len()).max(1)];
    let mut order: Vec<usize> = (0..lengths.len()).collect();
    order.sort_by_key(|&k| std::cmp::Reverse(lengths[k]));
    for k in order {
        let least = (0..groups.len()).min_by_key(|&g| groups[g].0).unwrap_or(0);
        groups[least].0 += lengths[k];
        groups[least].1.push(k);
    }
    let sorted = |(_, mut own): (i64, Vec<usize>)| {
        own.sort_unstable();
        own
    };
    groups.into_iter().map(sorted).collect()
}

/// Makes batches by number.
pub struct BatchSource {
    config: SkeletonTaskConfig,
    tokenizer: Tokenizer,
    assets: Arc<Assets>,
    cache: Arc<Cache<Rig>>,
    rigs: Mixture<AssetId>,
}

impl BatchSource {
    /// Batches of assets with the weights of their corpora; not empty.
    pub fn new(
        config: SkeletonTaskConfig,
        tokenizer: Tokenizer,
        assets: Arc<Assets>,
        cache: Arc<Cache<Rig>>,
        parts: Vec<(f32, Vec<AssetId>)>,
    ) -> Self {
        Self { rigs: Mixture::new(config.train.seed, parts), config, tokenizer, assets, cache }
    }

    /// Batches that go over every rig once.
    pub fn epoch_batches(&self) -> u64 {
        (self.rigs.len() as u64).div_ceil(self.config.sampling.rigs as u64)
    }

    /// Adds the rig at a place of the endless training sequence, augmented, or says why it has no sequence.
    fn add(&self, place: u64, batch: &mut Batch) -> Result<Result<(), Unfit>, String> {
        let c = &self.config;
        let id = self.rigs.at(place);
        let rig = normalized(&self.assets, &self.cache, id)?;
        let augmented = c.augment.apply_in_cube((*rig).clone(), c.train.seed, &[place]).map_err(|e| e.to_string())?;
        let rig = augmented.rig;
        let mut random = stream(c.train.seed, "skeleton sample", &[place]);
        // Where left and right are exchanged, the names of known makes are no longer true.
        let mirrored = augmented.motion.world.matrix3.determinant() < 0.0;
        let told = !random.chance(c.sampling.class_dropout) && !mirrored;
        let encoded = match encode(&self.tokenizer, &c.class, rig.skeleton(), told) {
            Ok(encoded) => encoded,
            Err(fault) => return Ok(Err(fault.into())),
        };
        if !c.limits.hold(rig.skeleton().len(), encoded.ids.len()) {
            return Ok(Err(Unfit::Long));
        }
        let normals = augmented.normals.as_ref();
        let sampler = match normals {
            Some(n) => CloudSampler::with_normals(rig.mesh(), &c.sampling.cloud, &n.vertices, &n.triangles),
            None => CloudSampler::new(rig.mesh(), &c.sampling.cloud),
        };
        shape(&c.sampling.cloud, &c.model.shape, &sampler, &mut random, batch);
        batch.ids.extend(encoded.ids.iter().map(|&id| i64::from(id)));
        batch.lengths.push(encoded.ids.len() as i64);
        batch.clamped += encoded.clamped;
        Ok(Ok(()))
    }
}

impl Source for BatchSource {
    type Batch = Batch;

    fn batch(&self, number: u64) -> Result<Batch, String> {
        let c = &self.config;
        let points = 6 * c.sampling.cloud.points * c.sampling.rigs;
        let mut batch = Batch { cloud: Vec::with_capacity(points), ..Batch::default() };
        let skipped = filled(number, c.sampling.rigs, c.limits, |place| self.add(place, &mut batch))?;
        batch.skipped += skipped;
        Ok(batch)
    }
}

/// A skeleton's tokens, with its class as of [`class_of`]; `told`: by its names, else as that of no known make.
pub(crate) fn encode(
    tokenizer: &Tokenizer,
    class: &str,
    skeleton: &Skeleton,
    told: bool,
) -> Result<Encoded, EncodeFault> {
    if told {
        return tokenizer.encode(skeleton, class_of(tokenizer, class, skeleton.names()));
    }
    let joints: Vec<_> = skeleton.heads().iter().map(|p| p.map(f64::from)).collect();
    let parents: Vec<_> = skeleton.parents().iter().map(|p| p.map(riglab_core::JointId::index)).collect();
    // Names that tell nothing.
    let names: Vec<String> = (0..joints.len()).map(|j| j.to_string()).collect();
    let bones = Bones { joints: &joints, parents: &parents, names: &names };
    tokenizer.encode_bones(&bones, class_of(tokenizer, class, &names))
}

/// The class that a skeleton is written with: that of the template which its names tell, where there is a token for it; else
/// `class`, what sequences of the model begin with (empty for none), unless that is of a template, whose joints it lacks.
pub(crate) fn class_of<'a>(tokenizer: &Tokenizer, class: &'a str, names: &[String]) -> Option<&'a str> {
    let told = Template::detect(names).map(|t| t.class);
    let written = |class: &&str| tokenizer.vocabulary().class_named(class).is_some();
    let of_template = |class: &str| tokenizer.config().templates && Template::of(class).is_some();
    told.filter(written).or(Some(class).filter(|class| !class.is_empty() && !of_template(class))).or(told)
}

/// Adds a cloud and what is picked from it for a shape encoder.
pub(crate) fn shape(
    cloud: &CloudConfig,
    model: &PerceiverConfig,
    sampler: &CloudSampler<'_>,
    random: &mut Stream,
    batch: &mut Batch,
) {
    looked_at((cloud, model), sampler, false, random, batch);
}

/// As [`shape`]; `mirrored`: seen in the mirror, x for -x.
pub(crate) fn looked_at(
    (cloud, model): (&CloudConfig, &PerceiverConfig),
    sampler: &CloudSampler<'_>,
    mirrored: bool,
    random: &mut Stream,
    batch: &mut Batch,
) {
    let before = batch.cloud.len();
    sampler.append(cloud.points, random, &mut batch.cloud);
    if mirrored {
        // Of positions and normals.
        batch.cloud[before..].iter_mut().step_by(3).for_each(|x| *x = -*x);
    }
    let (rows, _) = batch.cloud[before..].as_chunks::<6>();
    let drawn = some_of(rows.len(), model.tokens * model.drawn, random);
    let positions: Vec<Vec3> = drawn.iter().map(|&i| [rows[i][0], rows[i][1], rows[i][2]]).collect();
    let mut picks = farthest_points(&positions, model.tokens, 0);
    if model.sorted {
        picks.sort_by_key(|&k| along(positions[k]));
    }
    batch.picks.extend(picks.into_iter().map(|i| drawn[i] as i64));
    batch.rigs += 1;
}

/// Where a point of the cube lies along z-order.
fn along(at: Vec3) -> i64 {
    let [x, y, z] = at.map(|x| ((x + 1.0) * 512.0).clamp(0.0, 1023.0) as u32);
    Curve::Z.code([z, y, x], 0, 10)
}

/// `count` of the numbers below `n`, no two the same.
fn some_of(n: usize, count: usize, random: &mut Stream) -> Vec<usize> {
    let mut all: Vec<usize> = (0..n).collect();
    for k in 0..count.min(n) {
        let other = k + random.below(n - k);
        all.swap(k, other);
    }
    all.truncate(count);
    all
}

/// An asset's rig in the cube, from the cache or the corpus.
pub(crate) fn normalized(assets: &Assets, cache: &Cache<Rig>, id: AssetId) -> Result<Arc<Rig>, String> {
    cache.get(id, || {
        let rig = in_cube(assets, id)?;
        let bytes = bytes_of(&rig);
        Ok((rig, bytes))
    })
}

/// The same, read anew.
pub(crate) fn in_cube(assets: &Assets, id: AssetId) -> Result<Rig, String> {
    let asset = assets.read(id).map_err(|e| e.to_string())?;
    Ok(asset.rig.normalized().0)
}

/// About how many bytes a rig takes.
pub(crate) fn bytes_of(rig: &Rig) -> usize {
    24 * rig.mesh().positions().len() + 12 * rig.mesh().triangles().len() + 8 * rig.weights().nonzero()
}

#[cfg(test)]
mod tests {
    use riglab_core::Mesh;
    use riglab_random::stream;
    use riglab_token::Preset;

    use super::*;
    use crate::assets::DataConfig;
    use crate::tokenrig::testing::{assert_placed, corpus_of_one};

    #[test]
    fn sequences_of_skeletons_begin_as_free_ones_do() {
        let named = |names: &[&str]| {
            let joint = |(k, name): (usize, &&str)| riglab_core::Joint {
                name: (*name).into(),
                parent: k.checked_sub(1).map(|p| riglab_core::JointId(p as u16)),
                head: [0.0, 0.01 * k as f32, 0.0],
            };
            Skeleton::new(names.iter().enumerate().map(joint).collect()).unwrap()
        };
        let of = |preset: Preset, class: &str, skeleton: &Skeleton, told| {
            let tokenizer = Tokenizer::new(preset.config());
            let ids = encode(&tokenizer, class, skeleton, told).unwrap().ids;
            tokenizer.vocabulary().word(ids[1])
        };
        let plain = named(&["a", "b"]);
        let [mixamo, vroid] = ["mixamo", "vroid"].map(|class| {
            let joints: Vec<&str> = Template::of(class).unwrap().joints().map(|(name, ..)| name).collect();
            named(&joints)
        });
        for told in [true, false] {
            assert_eq!(of(Preset::SkintokensReleased, "articulation", &plain, told), "<articulation>");
            assert_eq!(of(Preset::UnirigReleased, "articulationxl", &plain, told), "<articulationxl>");
            // It lacks the joints of a template that the tokenizer knows.
            assert_eq!(of(Preset::UnirigReleased, "mixamo", &plain, told), "<no class>");
            assert_eq!(of(Preset::Riglab, "mixamo", &plain, told), "<no class>");
            assert_eq!(of(Preset::SkintokensReleased, "", &plain, told), "<no class>");
        }
        assert_eq!(of(Preset::UnirigReleased, "articulationxl", &mixamo, true), "<mixamo>");
        assert_eq!(of(Preset::UnirigReleased, "articulationxl", &mixamo, false), "<articulationxl>");
        assert_eq!(of(Preset::SkintokensReleased, "articulation", &vroid, true), "<vroid>");
        assert_eq!(
            of(Preset::SkintokensReleased, "articulation", &mixamo, true),
            "<articulation>",
            "of no class there"
        );
    }

    #[test]
    fn picks_may_be_sorted_so_that_near_ones_stay_together_and_in_the_mirror_as_there() {
        let [low, high] = [[0.1, 0.1, 0.1], [0.9, 0.9, 0.9]].map(along);
        let x = along([0.9, 0.1, 0.1]);
        assert!(low < x && x < along([0.9, 0.1, 0.9]) && along([0.9, 0.1, 0.9]) < high && along([-1.0; 3]) == 0);
        let corners = vec![[-0.9, -0.8, -0.7], [0.9, 0.8, -0.7], [0.9, -0.8, 0.7], [-0.9, 0.8, 0.7]];
        let mesh = Mesh::new(corners, vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]).unwrap();
        let cloud = CloudConfig { points: 64, ..CloudConfig::default() };
        let plain = PerceiverConfig { tokens: 8, drawn: 4, ..PerceiverConfig::default() };
        let sorted = PerceiverConfig { sorted: true, ..plain.clone() };
        let seen = |model: &PerceiverConfig, mirrored| {
            let (mut batch, sampler) = (Batch::default(), CloudSampler::new(&mesh, &cloud));
            looked_at((&cloud, model), &sampler, mirrored, &mut stream(0, "test", &[]), &mut batch);
            let (rows, _) = batch.cloud.as_chunks::<6>();
            let places: Vec<Vec3> = batch.picks.iter().map(|&k| [0, 1, 2].map(|axis| rows[k as usize][axis])).collect();
            (places, batch)
        };
        let ((as_picked, one), (in_order, two)) = (seen(&plain, false), seen(&sorted, false));
        assert_eq!(one.cloud, two.cloud);
        let set = |picks: &[i64]| picks.iter().copied().collect::<std::collections::BTreeSet<_>>();
        assert!(one.picks != two.picks && set(&one.picks) == set(&two.picks), "the same points");
        let rises = |places: &[Vec3]| places.iter().map(|&p| along(p)).is_sorted();
        assert!(rises(&in_order) && !rises(&as_picked));
        let (turned, three) = seen(&sorted, true);
        assert!(rises(&turned) && set(&three.picks) == set(&two.picks), "as it is seen");
        for (here, there) in three.cloud.chunks(3).zip(two.cloud.chunks(3)) {
            assert_eq!(here, [-there[0], there[1], there[2]]);
        }
    }

    #[test]
    fn rigs_lie_where_the_recipe_leaves_them() {
        let dir = tempfile::tempdir().unwrap();
        let assets = corpus_of_one(dir.path());
        assert_placed(|augment| {
            let mut config = SkeletonTaskConfig { augment, ..SkeletonTaskConfig::default() };
            config.sampling.cloud = CloudConfig { points: 64, vertices: 4, ..CloudConfig::default() };
            config.sampling.rigs = 1;
            config.model.shape = PerceiverConfig { tokens: 4, drawn: 2, ..PerceiverConfig::default() };
            let cache = Arc::new(Cache::of(&DataConfig::default(), 1));
            let parts = vec![(1.0, assets.split("train").unwrap())];
            let tokenizer = Tokenizer::new(Preset::Riglab.config());
            BatchSource::new(config, tokenizer, assets.clone(), cache, parts).batch(0).unwrap().cloud
        });
    }

    #[test]
    fn rigs_are_dealt_out_by_their_tokens_and_keep_what_is_theirs() {
        assert_eq!(deal(&[2, 9, 3, 4], 2), [vec![1], vec![0, 2, 3]]);
        assert_eq!(deal(&[5, 5], 8), [[0], [1]]);
        assert_eq!(deal(&[3, 1, 2], 1), [[0, 1, 2]]);
        let all = Batch {
            rigs: 3,
            cloud: (0..18).map(|k| k as f32).collect(),
            picks: vec![0, 1, 2],
            ids: vec![10, 11, 20, 30, 31, 32],
            lengths: vec![2, 1, 3],
            skipped: 4,
            clamped: 5,
        };
        let some = all.some(&[0, 2]);
        assert_eq!(
            (some.rigs, some.ids, some.lengths, some.picks),
            (2, vec![10, 11, 30, 31, 32], vec![2, 3], vec![0, 2])
        );
        assert_eq!(some.cloud, [0, 1, 2, 3, 4, 5, 12, 13, 14, 15, 16, 17].map(|k| k as f32));
        assert_eq!(all.tokens(1), 2..3);
    }
}
