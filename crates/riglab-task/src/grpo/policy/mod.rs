//! What GRPO has to know of the model that it refines: the one place that tells TokenRig and the skeleton model apart.

mod rigs;
mod skeletons;

use std::sync::Arc;

use riglab_core::{Mesh, Rig};
use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::{Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::tokenrig::Likelihood;
use riglab_random::Stream;
use tch::{Device, Tensor};

use super::rollout::Sequence;
use crate::assets::{AssetId, Assets, Up};
use crate::fsq_cvae::Frozen;
use crate::tokenrig::{RigSample, Rigger};
use crate::unirig_skeleton::Batch as Shapes;

/// A model that draws for meshes, and says how likely each draw was.
pub(super) trait Policy {
    /// Its parameters, and where they lie.
    fn params(&self) -> &Params;
    /// Where it computes.
    fn device(&self) -> Device;
    /// What it is trained and validated on.
    fn pool(&self) -> Pool<'_>;
    /// What is left out of it, for people.
    fn notes(&self) -> Vec<String>;
    /// What its shape encoder reads of a mesh.
    fn reads(&self) -> (CloudConfig, &PerceiverConfig);
    /// Which way is up in its cube.
    fn up(&self) -> Up;
    /// Itself as a model that makes rigs; `None` where it draws skeletons alone.
    fn rigger(&self) -> Option<&Rigger> {
        None
    }
    /// The auto-encoder that says the weights of what it draws.
    fn vae(&self) -> Option<&Frozen> {
        self.rigger().map(Rigger::vae)
    }
    /// What its decoder reads of shapes, [b, p, d].
    fn prefix(&self, w: &Weights, shapes: &Shapes) -> Tensor;
    /// A draw for each stream after a prefix [b, p, d] of so many meshes: of one, or of as many as there are streams.
    fn draw(
        &self,
        w: &Weights,
        seen: (&Tensor, &[&Mesh]),
        how: &GenerateConfig,
        streams: &mut [Stream],
    ) -> Result<Vec<RigSample>, String>;
    /// What the tokens of a draw are told, one after another (see [`riglab_nn::tokenrig::Sequences::told`]).
    fn told(&self, drawn: &RigSample) -> Vec<f32>;
    /// Log-probabilities and entropies of the free tokens of sequences, one after another, and how many each has.
    fn likely(&self, w: &Weights, shapes: &Shapes, all: &[&Sequence], temperature: f64) -> (Likelihood, Vec<i64>);
    /// A draw as a rig of its mesh in the cube; `None` where it says none.
    fn rig(&self, mesh: &Mesh, drawn: &RigSample, key: u64) -> Result<Option<Rig>, String>;
}

/// The corpora of a run, and the assets it takes.
pub(super) struct Pool<'a> {
    pub assets: &'a Arc<Assets>,
    pub train: &'a [(f32, Vec<AssetId>)],
    pub validate: &'a [AssetId],
}

/// The ids of sequences one after another, and what should follow each but the last of every one.
struct Flat {
    ids: Tensor,
    targets: Tensor,
    lengths: Vec<i64>,
    /// The mesh of each.
    meshes: Vec<usize>,
}

impl Flat {
    fn of(all: &[&Sequence], device: Device) -> Self {
        let ids: Vec<i64> = all.iter().flat_map(|s| &s.ids).copied().collect();
        let targets: Vec<i64> = all.iter().flat_map(|s| &s.ids[1..]).copied().collect();
        let on = |of: &[i64]| Tensor::from_slice(of).to_device(device);
        let lengths = all.iter().map(|s| s.ids.len() as i64).collect();
        Self { ids: on(&ids), targets: on(&targets), lengths, meshes: all.iter().map(|s| s.mesh).collect() }
    }
}

/// Sequences in runs of about as many tokens, for as many threads as there are; all together on other devices.
fn dealt<'a, 'b>(all: &'b [&'a Sequence], device: Device) -> Vec<&'b [&'a Sequence]> {
    let threads = riglab_torch::threads_on(device).min(all.len());
    let tokens: usize = all.iter().map(|s| s.ids.len()).sum();
    let (mut runs, mut left, mut before, mut start) = (Vec::new(), all, 0, 0);
    for (k, own) in all.iter().enumerate() {
        before += own.ids.len();
        if before * threads >= (runs.len() + 1) * tokens && runs.len() + 1 < threads {
            let (run, rest) = left.split_at(k + 1 - start);
            runs.push(run);
            (left, start) = (rest, k + 1);
        }
    }
    runs.push(left);
    runs.retain(|run| !run.is_empty());
    if runs.is_empty() { vec![all] } else { runs }
}

/// How many of each sequence's targets were chosen: `chosen` says it of those of one sequence after another.
fn counts(all: &[&Sequence], chosen: &[bool]) -> Vec<i64> {
    let mut left = chosen;
    all.iter()
        .map(|s| {
            let (own, rest) = left.split_at(s.ids.len() - 1);
            left = rest;
            own.iter().filter(|c| **c).count() as i64
        })
        .collect()
}

fn bits(of: &[bool], device: Device) -> Tensor {
    Tensor::from_slice(of).to_device(device)
}
