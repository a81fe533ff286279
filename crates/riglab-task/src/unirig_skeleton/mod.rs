//! UniRig's skeleton stage (3.1, 4.1): a shape comes in, the tokens of its skeleton come out.

pub(crate) mod agree;
pub(crate) mod batch;
mod config;
pub(crate) mod evaluate;
pub(crate) mod gallery;
pub(crate) mod generate;
pub(crate) mod report;
pub(crate) mod retrieval;
mod sketcher;
mod trained;

use std::sync::Arc;

use riglab_core::Rig;
use riglab_nn::NnError;
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::skeleton::{SkeletonModel, coordinate_distance, cross_entropy, spread_cross_entropy};
use riglab_token::Tokenizer;
use riglab_train::{At, Better, Loss, LossOf, Source, State, Task, Validation};
use tch::{Device, Kind, Tensor};

pub use batch::{Batch, BatchSource};
pub use config::{EvalConfig, LossConfig, SamplingConfig, SkeletonTaskConfig};
pub use evaluate::{AssetRow, Report, Row};
pub use gallery::ShownAsset;
pub use generate::{Drawer, SkeletonSample};
pub use report::{Evaluation, lines};
pub use sketcher::{Sketch, Sketched, Sketcher};
pub(crate) use trained::Trained;

use crate::assets::{AssetId, Assets, Cache};
use crate::experiment::{Examined, Experiment, beside};
use crate::sequences::LeftOut;
use crate::settings::TaskSettings;

/// The task, with its network and data.
pub struct SkeletonTask {
    config: SkeletonTaskConfig,
    tokenizer: Tokenizer,
    pub(crate) assets: Arc<Assets>,
    pub(crate) cache: Arc<Cache<Rig>>,
    pub(crate) train_assets: Vec<(f32, Vec<AssetId>)>,
    pub(crate) validation_assets: Vec<AssetId>,
    left_out: LeftOut,
    net: SkeletonModel,
    params: Params,
    pub(crate) device: Device,
}

impl SkeletonTask {
    /// Opens the corpora and builds the network with its starting weights. The config was validated.
    ///
    /// # Errors
    /// A sentence: a corpus that cannot be read, a split without assets, or one of bare meshes.
    pub fn new(config: SkeletonTaskConfig, device: Device) -> Result<Self, String> {
        let mut task = Self::on_meshes(config, device)?;
        task.assets.rigged(&task.config.data)?;
        let c = &task.config;
        task.left_out = LeftOut::take(&task.assets, &c.data, c.limits, &mut task.train_assets)?;
        Ok(task)
    }

    /// As [`Self::new`]; meshes may be bare, and of rigs longer than any limit, for who has them rewarded.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(crate) fn on_meshes(config: SkeletonTaskConfig, device: Device) -> Result<Self, String> {
        let (assets, train_assets, validation_assets) = Assets::of(&config.data)?;
        let left_out = LeftOut::of(&assets, &config.data, &train_assets)?;
        let tokenizer = Tokenizer::new(config.tokenizer.clone());
        let (net, params) = Self::network(&config, device).map_err(|e| e.to_string())?;
        let cache = Arc::new(Cache::of(&config.data, 1));
        Ok(Self {
            assets: Arc::new(assets),
            cache,
            train_assets,
            validation_assets,
            left_out,
            net,
            params,
            device,
            tokenizer,
            config,
        })
    }

    /// The network of a config, with its starting weights.
    ///
    /// # Errors
    /// For impossible sizes.
    pub fn network(config: &SkeletonTaskConfig, device: Device) -> Result<(SkeletonModel, Params), NnError> {
        let (net, builder) = Self::built(config);
        Ok((net, builder.finish(config.train.seed, Kind::Float, device)?))
    }

    /// As [`Self::network`], without values: they are to be loaded.
    ///
    /// # Errors
    /// For impossible sizes.
    pub(crate) fn blank(config: &SkeletonTaskConfig, device: Device) -> Result<(SkeletonModel, Params), NnError> {
        let (net, builder) = Self::built(config);
        Ok((net, builder.blank(Kind::Float, device)?))
    }

    /// The network, and what has its names and shapes.
    pub(crate) fn built(config: &SkeletonTaskConfig) -> (SkeletonModel, Builder) {
        let vocabulary = Tokenizer::new(config.tokenizer.clone()).vocabulary().len();
        let mut builder = Builder::default();
        (SkeletonModel::new(builder.root(), &config.model, vocabulary), builder)
    }

    /// Its settings.
    pub fn config(&self) -> &SkeletonTaskConfig {
        &self.config
    }

    /// Its network.
    pub fn net(&self) -> &SkeletonModel {
        &self.net
    }

    /// What draws skeletons with it.
    pub fn drawer(&self) -> Drawer<'_> {
        Drawer { config: &self.config, tokenizer: &self.tokenizer, net: &self.net, device: self.device }
    }

    /// Where batches of the training split come from.
    pub fn batches(&self) -> Arc<BatchSource> {
        let (config, tokenizer) = (self.config.clone(), self.tokenizer.clone());
        let (assets, cache) = (self.assets.clone(), self.cache.clone());
        Arc::new(BatchSource::new(config, tokenizer, assets, cache, self.train_assets.clone()))
    }
}

impl Task for SkeletonTask {
    type Batch = Batch;

    fn name(&self) -> &'static str {
        SkeletonTaskConfig::TASK
    }

    fn params(&self) -> &Params {
        &self.params
    }

    fn source(&self) -> Arc<dyn Source<Batch = Batch>> {
        self.batches()
    }

    fn loss(&self, w: &Weights, batch: &Batch, _at: At) -> Result<Loss, String> {
        loss_of(&self.net, &self.config, w, batch, self.device, true)
    }

    fn beside(&self) -> Option<LossOf<Batch>> {
        let (config, device) = (self.config.clone(), self.device);
        let net = SkeletonModel::new(Builder::default().root(), &config.model, self.tokenizer.vocabulary().len());
        beside(device, move |w, batch: &Batch, _| loss_of(&net, &config, w, batch, device, true))
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
        self.validation(w, at.ranks)
    }

    fn objective(&self) -> (&'static str, Better) {
        ("j2j_all@val", Better::Lower)
    }

    fn told(&self, value: f64) -> String {
        riglab_report::told(self.objective().0, value)
    }
}

impl Experiment for SkeletonTask {
    fn assets(&self) -> &Assets {
        &self.assets
    }

    fn notes(&self) -> Vec<String> {
        self.left_out.notes(&self.config.data)
    }

    fn untrainable(&self) -> Option<String> {
        self.left_out.untrainable()
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
        let (report, skeletons) = self.evaluate(weights, progress)?;
        let sheets = self.gallery(&report, &skeletons, pictures)?;
        let text = report::lines(&report);
        let checkpoint = checkpoint.clone();
        Examined::of(text, sheets, |s| &s.file, |gallery| Evaluation { checkpoint, report, gallery })
    }
}

/// The cloud [b, n, 6] and the picks [b, p] of a batch.
pub(crate) fn shape_of(c: &SkeletonTaskConfig, batch: &Batch, device: Device) -> (Tensor, Tensor) {
    shape_tensors(batch, c.model.shape.tokens, device)
}

/// As [`shape_of`], of so many picks. All rigs have as many points.
pub(crate) fn shape_tensors(batch: &Batch, picks: usize, device: Device) -> (Tensor, Tensor) {
    let (rigs, points) = (batch.rigs as i64, batch.cloud.len() / 6 / batch.rigs.max(1));
    let cloud = Tensor::from_slice(&batch.cloud).view([rigs, points as i64, 6]).to_device(device);
    (cloud, Tensor::from_slice(&batch.picks).view([rigs, picks as i64]).to_device(device))
}

/// Read the shape, read the tokens, compare what should follow each. On the processor rigs are shared out among the
/// threads there are.
///
/// # Errors
/// None at present.
pub fn loss_of(
    net: &SkeletonModel,
    c: &SkeletonTaskConfig,
    w: &Weights,
    batch: &Batch,
    device: Device,
    training: bool,
) -> Result<Loss, String> {
    let parts: Vec<Batch> = batch.dealt(device).iter().map(|rigs| batch.some(rigs)).collect();
    let jobs = parts.iter().map(|part| {
        move |w: &Weights| {
            let (cloud, picks) = shape_of(c, part, device);
            let prefix = net.condition(w, &cloud, &picks);
            let ids = Tensor::from_slice(&part.ids).to_device(device);
            vec![net.logits(w, &prefix, &ids, &part.lengths, training)]
        }
    });
    let logits = w.side_by_side(jobs.collect::<Vec<_>>());
    let logits = Tensor::cat(&logits.iter().flatten().collect::<Vec<_>>(), 0);
    let following = |part: &Batch| {
        let each = (0..part.rigs).map(|rig| &part.ids[part.tokens(rig)][1..]);
        each.flatten().copied().collect::<Vec<_>>()
    };
    let targets: Vec<i64> = parts.iter().flat_map(following).collect();
    let targets = Tensor::from_slice(&targets).to_device(device);
    let bins = i64::from(c.tokenizer.bins);
    let next = if c.loss.spread > 0.0 {
        spread_cross_entropy(&logits, &targets, bins, c.loss.spread)
    } else {
        cross_entropy(&logits, &targets)
    };
    let mut loss = Loss::new().term("next", c.loss.next, next);
    if c.loss.distance > 0.0 {
        loss = loss.term("distance", c.loss.distance, coordinate_distance(&logits, &targets, bins));
    }
    let loss = loss.note("tokens", batch.ids.len() as f64);
    Ok(loss.note("skipped_assets", batch.skipped as f64).note("clamped_joints", batch.clamped as f64))
}
