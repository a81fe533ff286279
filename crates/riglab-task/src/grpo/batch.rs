//! Meshes that rigs are drawn for, made ready by other threads.

use std::sync::Arc;

use riglab_core::{Mesh, Rig};
use riglab_data::Mixture;
use riglab_geom::{CloudConfig, CloudSampler};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_random::{Stream, stream};
use riglab_reward::Scorer;
use riglab_train::Source;

use super::config::GrpoTaskConfig;
use crate::assets::{AssetId, Assets, Cache};
use crate::unirig_skeleton::Batch as Shapes;
use crate::unirig_skeleton::batch::{normalized, shape};

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
            let rig = normalized(&self.assets, &self.cache, id)?;
            let augmented = c.augment.apply((*rig).clone(), seed, &[place]).map_err(|e| e.to_string())?;
            let (rig, _) = augmented.rig.normalized();
            let name = self.assets.name(id).map_err(|e| e.to_string())?;
            let mesh = rig.mesh().clone();
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
