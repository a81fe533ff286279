//! Meshes that rigs are drawn for, made ready by other threads.

use std::sync::Arc;

use riglab_core::{Bounds, Joint, Mesh, Rig, RigError, Similarity, Skeleton, SkinWeights, Vec3};
use riglab_data::{LONE_JOINT, Mixture};
use riglab_geom::{CloudConfig, CloudSampler};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_random::{Stream, stream};
use riglab_reward::Scorer;
use riglab_train::Source;

use super::config::GrpoTaskConfig;
use crate::assets::{AssetId, Assets, Cache};
use crate::unirig_skeleton::Batch as Shapes;
use crate::unirig_skeleton::batch::{bytes_of, shape};

/// A mesh in the cube, voxelised once for all its rigs.
pub struct Subject {
    /// What seeds its points and draws.
    pub key: u64,
    /// The asset's name, for messages; empty where there is one mesh alone.
    pub name: String,
    /// The mesh.
    pub mesh: Mesh,
    /// What gives its rigs rewards.
    pub scorer: Scorer,
}

/// The meshes of a rollout, with what the policy's shape encoder reads of them; none in the steps that go over the last
/// rollout again.
#[derive(Default)]
pub struct Batch {
    /// The meshes.
    pub subjects: Vec<Subject>,
    /// Clouds and picks of them.
    pub shapes: Shapes,
}

/// Makes batches by number.
pub struct BatchSource {
    pub(super) config: GrpoTaskConfig,
    pub(super) cloud: CloudConfig,
    pub(super) model: PerceiverConfig,
    pub(super) assets: Arc<Assets>,
    /// See [`BatchSource::seen`].
    pub(super) cache: Arc<Cache<Rig>>,
    pub(super) meshes: Mixture<AssetId>,
}

impl Batch {
    /// Adds a mesh in the cube.
    pub(super) fn push(
        &mut self,
        subject: Subject,
        (cloud, model): (&CloudConfig, &PerceiverConfig),
        sampler: &CloudSampler<'_>,
        random: &mut Stream,
    ) {
        shape(cloud, model, sampler, random, &mut self.shapes);
        self.subjects.push(subject);
    }
}

impl BatchSource {
    /// An asset as it is augmented: set into the cube by its mesh alone, as `riglab rig` sets one, and without its skeleton
    /// unless a step of `augment` needs that.
    fn seen(&self, id: AssetId) -> Result<Arc<Rig>, String> {
        self.cache.get(id, || {
            let rig = self.assets.read(id).map_err(|e| e.to_string())?.rig;
            let rig = if self.config.augment.reads_skeletons() { Ok(rig) } else { bare(rig.mesh()) };
            let rig = rig.and_then(|rig| by_mesh(&rig)).map_err(|e| e.to_string())?;
            let bytes = bytes_of(&rig);
            Ok((rig, bytes))
        })
    }
}

/// The middle of a mesh's box, and what sets it into the cube.
fn cube(mesh: &Mesh) -> (Vec3, Similarity) {
    let bounds = Bounds::of(mesh.positions().iter().copied());
    let middle = bounds.map_or([0.0; 3], |b| std::array::from_fn(|k| 0.5 * (b.min[k] + b.max[k])));
    (middle, bounds.map_or(Similarity::NONE, Similarity::into_cube))
}

/// A rig whose mesh is set into the cube, wherever its joints come to stand.
fn by_mesh(rig: &Rig) -> Result<Rig, RigError> {
    rig.transformed(cube(rig.mesh()).1)
}

/// A mesh as a rig of one joint in its middle.
fn bare(mesh: &Mesh) -> Result<Rig, RigError> {
    let skeleton = Skeleton::new(vec![Joint { name: LONE_JOINT.into(), parent: None, head: cube(mesh).0 }])?;
    let weights = SkinWeights::normalized(mesh.positions().iter().map(|_| [(0u16, 1.0)]))?;
    Rig::new(skeleton, mesh.clone(), weights)
}

impl Source for BatchSource {
    type Batch = Batch;

    fn batch(&self, number: u64) -> Result<Batch, String> {
        let (c, mut batch) = (&self.config, Batch::default());
        let updates = c.rollout.updates();
        if !number.is_multiple_of(updates) {
            return Ok(batch);
        }
        let (meshes, seed) = (c.rollout.meshes as u64, c.train.seed);
        for place in (number / updates * meshes..).take(c.rollout.meshes) {
            let id = self.meshes.at(place);
            let name = self.assets.name(id).map_err(|e| e.to_string())?;
            let told = |e: RigError| format!("{name}: {e}");
            let rig = self.seen(id).map_err(|e| format!("{name}: {e}"))?;
            let augmented = c.augment.apply((*rig).clone(), seed, &[place]).map_err(told)?;
            let mesh = by_mesh(&augmented.rig).map_err(told)?.mesh().clone();
            let sampler = match augmented.normals.as_ref() {
                Some(n) => CloudSampler::with_normals(&mesh, &self.cloud, &n.vertices, &n.triangles),
                None => CloudSampler::new(&mesh, &self.cloud),
            };
            let subject = Subject { key: place, name, scorer: Scorer::new(&mesh, &c.reward), mesh: mesh.clone() };
            let mut random = stream(seed, "rollout points", &[place]);
            batch.push(subject, (&self.cloud, &self.model), &sampler, &mut random);
        }
        Ok(batch)
    }
}

#[cfg(test)]
mod tests {
    use riglab_augment::{JitterConfig, PoseConfig, Recipe, ScaleConfig};
    use riglab_core::{Asset, JointId, Provenance};
    use riglab_data::CorpusWriter;

    use super::*;
    use crate::assets::DataConfig;
    use crate::tokenrig::testing::tetrahedron;

    #[test]
    fn batches_are_of_meshes_wherever_their_true_joints_are() {
        let dir = tempfile::tempdir().unwrap();
        let (jitter, scale) = (
            JitterConfig { probability: 1.0, sigma: 0.01, ..JitterConfig::default() },
            ScaleConfig { probability: 1.0, range: [0.7, 1.3], uniform: false },
        );
        let of = |far: f32, augment: Recipe| {
            let path = dir.path().join(format!("{far}.h5"));
            let joint = |name: &str, parent, y| Joint { name: name.into(), parent, head: [0.0, y, 0.0] };
            let joints = vec![joint("root", None, 0.0), joint("tip", Some(JointId(0)), far)];
            let weights = SkinWeights::normalized((0..4).map(|v| [(v % 2, 1.0)])).unwrap();
            let rig = Rig::new(Skeleton::new(joints).unwrap(), tetrahedron(), weights).unwrap();
            let mut writer = CorpusWriter::create(&path).unwrap();
            let provenance = Provenance::default();
            writer.add(&Asset { name: "a".into(), rig, clips: Vec::new(), provenance }).unwrap();
            writer.finish(&["train"]).unwrap();
            let assets = Arc::new(Assets::open(&[path]).unwrap());
            let mut config = GrpoTaskConfig { augment, ..GrpoTaskConfig::default() };
            (config.rollout.meshes, config.reward.resolution) = (3, 8);
            let source = BatchSource {
                cloud: CloudConfig { points: 64, ..CloudConfig::default() },
                model: PerceiverConfig { tokens: 4, drawn: 2, ..PerceiverConfig::default() },
                meshes: Mixture::new(0, vec![(1.0, assets.split("train").unwrap())]),
                cache: Arc::new(Cache::of(&DataConfig::default(), 1)),
                assets,
                config,
            };
            source.batch(0).unwrap()
        };
        let meshes = |batch: &Batch| batch.subjects.iter().map(|s| s.mesh.clone()).collect::<Vec<_>>();
        let plain = || Recipe { jitter: jitter.clone(), scale: scale.clone(), ..Recipe::default() };
        let (near, far) = (of(0.5, plain()), of(50.0, plain()));
        assert_eq!((meshes(&near), &near.shapes), (meshes(&far), &far.shapes));
        // Steps that need the skeleton have it, and the mesh fills the cube all the same.
        let posed = Recipe { pose: PoseConfig { probability: 1.0, degrees: 60.0, scale: [1.0, 1.0] }, ..plain() };
        let (near, far) = (of(0.5, posed.clone()), of(50.0, posed));
        assert_ne!(meshes(&near), meshes(&far));
        for mesh in meshes(&far) {
            let bounds = Bounds::of(mesh.positions().iter().copied()).unwrap();
            let longest = (0..3).map(|k| bounds.max[k] - bounds.min[k]).fold(0.0, f32::max);
            assert!((longest - 2.0).abs() < 1e-4, "{longest}");
        }
    }
}
