//! UniRig's skin stage (4.2, 4.3): weights and attributes of bones, given a mesh and its skeleton.
//!
//! What is predicted, what is frozen and what counts is put together in [`loss_of`]; each mechanism is a switch of
//! the config.

mod batch;
mod config;
pub(crate) mod evaluate;
mod gallery;
mod motion;
mod pairs;
mod predict;
mod ready;
mod report;
mod skinner;

use std::sync::Arc;

use riglab_nn::NnError;
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::skin_stage::ptv3::Places;
use riglab_nn::skin_stage::{ATTRIBUTES, SkinModel, loss};
use riglab_train::{At, Better, Loss, LossOf, Source, State, Task, Validation};
use tch::{Device, Kind, Tensor};

pub use batch::{Batch, BatchSource, RigBatch};
pub use config::{
    EvalConfig, FreezeConfig, LossConfig, MergeConfig, PhysicsConfig, ReleasedConfig, SamplingConfig, SkinTaskConfig,
};
pub use evaluate::{AssetRow, AttributeRow, Report, Row};
pub use gallery::ShownAsset;
pub use motion::{Motion, Moving};
pub use pairs::PairInput;
pub use ready::{Ready, Seat};
pub use report::{Evaluation, lines};
pub use skinner::{Holders, Skinner};

use crate::assets::{AssetId, Assets, Cache};
use crate::experiment::{Examined, Experiment, beside};
use crate::sequences::LeftOut;
use crate::settings::TaskSettings;

/// The task, with its network and data.
pub struct SkinTask {
    config: SkinTaskConfig,
    assets: Arc<Assets>,
    cache: Arc<Cache<Ready, batch::Variant>>,
    /// Of the validation split, with the vertices that are looked at while training.
    validated: Cache<evaluate::Subject>,
    train_assets: Vec<(f32, Vec<AssetId>)>,
    validation_assets: Vec<AssetId>,
    left_out: LeftOut,
    net: SkinModel,
    params: Params,
    device: Device,
}

impl SkinTask {
    /// Opens the corpora and builds the network with its starting weights. The config was validated.
    ///
    /// # Errors
    /// A sentence: a corpus that cannot be read, or a split without assets.
    pub fn new(config: SkinTaskConfig, device: Device) -> Result<Self, String> {
        let (assets, train_assets, validation_assets) = Assets::of(&config.data)?;
        assets.rigged(&config.data)?;
        let left_out = LeftOut::of(&assets, &config.data, &train_assets)?;
        let (net, params) = Self::network(&config, device).map_err(|e| e.to_string())?;
        Ok(Self {
            assets: Arc::new(assets),
            cache: Arc::new(Cache::of(&config.data, 2)),
            validated: Cache::of(&config.data, 2),
            train_assets,
            validation_assets,
            left_out,
            net,
            params,
            device,
            config,
        })
    }

    /// The network of a config, with its starting weights.
    ///
    /// # Errors
    /// For impossible sizes.
    pub fn network(config: &SkinTaskConfig, device: Device) -> Result<(SkinModel, Params), NnError> {
        let (net, builder) = Self::built(config);
        Ok((net, builder.finish(config.train.seed, Kind::Float, device)?))
    }

    /// As [`Self::network`], without values: they are to be loaded.
    ///
    /// # Errors
    /// For impossible sizes.
    pub(crate) fn blank(config: &SkinTaskConfig, device: Device) -> Result<(SkinModel, Params), NnError> {
        let (net, builder) = Self::built(config);
        Ok((net, builder.blank(Kind::Float, device)?))
    }

    /// The network, and what has its names and shapes.
    pub(crate) fn built(config: &SkinTaskConfig) -> (SkinModel, Builder) {
        let mut builder = Builder::default();
        (SkinModel::new(builder.root(), &config.model), builder)
    }

    /// Its settings.
    pub fn config(&self) -> &SkinTaskConfig {
        &self.config
    }

    /// Its network.
    pub fn net(&self) -> &SkinModel {
        &self.net
    }

    /// Where batches of the training split come from.
    pub fn batches(&self) -> Arc<BatchSource> {
        let (config, assets, cache) = (self.config.clone(), self.assets.clone(), self.cache.clone());
        Arc::new(BatchSource::new(config, assets, cache, self.train_assets.clone()))
    }
}

impl Task for SkinTask {
    type Batch = Batch;

    fn name(&self) -> &'static str {
        SkinTaskConfig::TASK
    }

    fn params(&self) -> &Params {
        &self.params
    }

    fn source(&self) -> Arc<dyn Source<Batch = Batch>> {
        self.batches()
    }

    fn loss(&self, w: &Weights, batch: &Batch, _at: At) -> Result<Loss, String> {
        Ok(loss_of(&self.net, &self.config, w, batch, self.device))
    }

    fn beside(&self) -> Option<LossOf<Batch>> {
        let (config, device) = (self.config.clone(), self.device);
        let net = SkinModel::new(Builder::default().root(), &config.model);
        beside(device, move |w, batch: &Batch, _| Ok(loss_of(&net, &config, w, batch, device)))
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
        self.validation(w, at.ranks)
    }

    fn objective(&self) -> (&'static str, Better) {
        ("l1_rule@val", Better::Lower)
    }
}

impl Experiment for SkinTask {
    fn assets(&self) -> &Assets {
        &self.assets
    }

    fn notes(&self) -> Vec<String> {
        let wanted = self.config.model.attributes && self.config.loss.attributes > 0.0;
        let ids = self.train_assets.iter().flat_map(|(_, ids)| ids).copied();
        let mut notes = self.left_out.notes(&self.config.data);
        // Where the column cannot be read, the first batch says so.
        if wanted && !self.assets.any_springs(ids).unwrap_or(true) {
            notes.push(
                "no training asset has spring bones: attributes are not learned (model.attributes = false leaves them out)"
                    .into(),
            );
        }
        notes
    }

    fn examination_steps(&self) -> Result<usize, String> {
        self.examined_assets()
    }

    fn examine(
        &self,
        weights: &Weights,
        checkpoint: &State,
        pictures: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Examined, String> {
        let report = self.evaluate(weights, progress)?;
        let sheets = if pictures == 0 { Vec::new() } else { self.gallery(weights, &report, pictures)? };
        let text = report::lines(&report);
        let checkpoint = checkpoint.clone();
        Examined::of(text, sheets, |s| &s.file, |gallery| Evaluation { checkpoint, report, gallery })
    }
}

/// The shapes of a batch, a tensor [1, t, d] each. All rigs have as many points and picks.
fn shapes(net: &SkinModel, w: &Weights, batch: &Batch, device: Device) -> Vec<Tensor> {
    let rigs = batch.rigs.len() as i64;
    let clouds: Vec<f32> = batch.rigs.iter().flat_map(|r| &r.cloud).copied().collect();
    let picks: Vec<i64> = batch.rigs.iter().flat_map(|r| &r.picks).copied().collect();
    let cloud = Tensor::from_slice(&clouds).view([rigs, -1, 6]).to_device(device);
    let picks = Tensor::from_slice(&picks).view([rigs, -1]).to_device(device);
    net.shape(w, &cloud, &picks).split(1, 0)
}

/// What the network makes of a rig of a batch, whose shape was read: logits [q, j], and attributes [j, 7] where it has
/// them.
fn forward(
    net: &SkinModel,
    c: &SkinTaskConfig,
    w: &Weights,
    rig: &RigBatch,
    shape: Tensor,
    device: Device,
) -> (Tensor, Option<Tensor>) {
    let (j, q) = (rig.count as i64, rig.queries as i64);
    let of = |values: &[f32], size: &[i64]| Tensor::from_slice(values).view(size).to_device(device);
    let cloud = of(&rig.cloud, &[1, -1, 6]);
    let read = net.read_shape(w, shape, &cloud, &of(&rig.bones, &[1, j, 3 * c.model.bones.seen.points() as i64]));
    let places = rig.layout.as_ref().map(|(layout, turns)| Places::new(layout, &c.model.points.ptv3, *turns, device));
    let asked = |x: &Tensor| x.narrow(1, 0, q);
    // The backbone sees all points; each of the light encoder's is read alone.
    let encoded = match &places {
        Some(places) => asked(&net.encode(w, &cloud, Some(places))),
        None => net.encode(w, &asked(&cloud), None),
    };
    let points = net.points(w, &read, &encoded);
    let pairs = of(&rig.pairs, &[1, q, j, c.model.pair as i64]);
    (net.logits(w, &read, &points, &pairs).squeeze_dim(0), net.attributes(w, &read, &points).map(|a| a.squeeze_dim(0)))
}

/// Of each rig by itself, what the network predicts against what is true; then the mean over rigs.
pub fn loss_of(net: &SkinModel, c: &SkinTaskConfig, w: &Weights, batch: &Batch, device: Device) -> Loss {
    let l = &c.loss;
    let scale = Tensor::from_slice(&l.attribute_scale.map(|s| s as f32)).to_device(device);
    let (mut skin, mut released, mut springs, mut physics) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut frozen_bones, mut bones) = (0, 0);
    for (rig, shape) in batch.rigs.iter().zip(shapes(net, w, batch, device)) {
        let (logits, attributes) = forward(net, c, w, rig, shape, device);
        let (q, j) = (rig.queries as i64, rig.count as i64);
        let truth = Tensor::from_slice(&rig.truth).view([q, j]).to_device(device);
        let flags = |of: &[bool]| Tensor::from_slice(of).to_device(device);
        let frozen = (!rig.frozen.is_empty()).then(|| flags(&rig.frozen));
        let shares = loss::log_shares(&logits, &truth, frozen.as_ref());
        if l.skin > 0.0 {
            let each = loss::divergence(&shares, &truth);
            skin.push(if l.bone_centric {
                loss::over_bones(&each, &truth, frozen.map(|f| f.logical_not()).as_ref())
            } else {
                each.mean(None::<Kind>)
            });
        }
        let positions = Tensor::from_slice(&rig.cloud).view([-1, 6]).narrow(0, 0, q).narrow(1, 0, 3).to_device(device);
        if l.released.is_on() {
            let maps = Tensor::from_slice(&rig.maps).view([j, 3, 4]).to_device(device);
            released.push(loss::released(&shares.exp(), &truth, &maps, &positions));
        }
        let true_rows = Tensor::from_slice(&rig.swings).view([j, ATTRIBUTES as i64]).to_device(device);
        if let Some(motion) = &rig.motion {
            // What nothing holds stays out: it goes to the origin with both.
            let held = truth.sum_dim_intlist(-1, true, None::<Kind>);
            let moving = |shares, rows| Moving { positions: &positions, shares, attributes: rows };
            let (own, rows) = (shares.exp() * held, attributes.as_ref().map(|_| &true_rows));
            let (found, wanted) = (moving(&own, attributes.as_ref()), moving(&truth, rows));
            physics.push(motion.loss(&l.physics, found, wanted, &rig.swinging));
        }
        if let Some(predicted) = attributes.filter(|_| l.attributes > 0.0 && rig.swinging.contains(&true)) {
            springs.push(loss::attributes(&predicted, &true_rows, &flags(&rig.swinging), &scale));
        }
        frozen_bones += rig.frozen.iter().filter(|f| **f).count();
        bones += rig.count;
    }
    let mut loss = Loss::new();
    if l.skin > 0.0 {
        loss = loss.term("skin", l.skin, mean(skin));
    }
    if l.attributes > 0.0 {
        loss = loss.term("attributes", l.attributes, mean(springs));
    }
    if l.physics.weight > 0.0 {
        loss = loss.term("physics", l.physics.weight, mean(physics));
    }
    for (k, (name, weight)) in l.released.weights().into_iter().enumerate().filter(|(_, (_, w))| *w > 0.0) {
        let part = |r: &loss::Released| {
            [&r.vertex, &r.normalization, &r.l1, &r.bce, &r.zero_l1, &r.non_zero_l1][k].shallow_clone()
        };
        loss = loss.term(name, weight, mean(released.iter().map(part).collect()));
    }
    loss.note("frozen", frozen_bones as f64 / bones.max(1) as f64)
}

/// The mean; 0 of nothing, such as of springs where no rig of a batch has any.
fn mean(parts: Vec<Tensor>) -> Tensor {
    if parts.is_empty() { Tensor::from(0f32) } else { Tensor::stack(&parts, 0).mean(None::<Kind>) }
}
