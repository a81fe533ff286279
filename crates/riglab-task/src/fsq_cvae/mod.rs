//! The FSQ-CVAE of skinning weights (SkinTokens 3.2): each bone's weights as a few codes.

mod batch;
mod coder;
mod config;
pub(crate) mod evaluate;
mod frozen;
pub(crate) mod gallery;
mod prepare;
mod prior;
mod region;
mod report;
mod table;
mod tensors;

use std::sync::Arc;

use riglab_nn::NnError;
use riglab_nn::fsq_cvae::{ACTIVE, BoneGeometry, Coded, FsqCvae, SkinCloud};
use riglab_nn::loss;
use riglab_nn::params::{Builder, Params, Weights};
use riglab_train::{At, Better, Loss, LossOf, Source, State, Task, Validation};
use tch::{Device, Kind, Tensor};

pub use batch::{Batch, BatchSource};
pub use coder::Coder;
pub use config::{EvalConfig, FsqCvaeTaskConfig, LossConfig, PointMix, PrefixConfig, SamplingConfig};
pub(crate) use config::{cells, cuts};
pub use evaluate::{AssetRow, BoneCodes, CodebookRow, Encoded, Report, Row, Truth, ruled};
pub use frozen::Frozen;
pub use gallery::ShownAsset;
pub use prepare::{Bone, Ground, Patch, Place, Point, Prepared, threshold};
pub use prior::{Prior, SurfacePrior};
pub(crate) use region::{Regions, Surface};
pub use report::Evaluation;
pub(crate) use report::{BONES_KNOWN, asset_columns, skin_columns};

use crate::assets::{AssetId, Assets, Cache};
use crate::experiment::{Examined, Experiment, beside};
use crate::sequences::LeftOut;
use crate::settings::TaskSettings;

/// The task, with its network and data.
pub struct FsqCvaeTask {
    config: FsqCvaeTaskConfig,
    assets: Arc<Assets>,
    cache: Arc<Cache<Prepared>>,
    train_assets: Vec<(f32, Vec<AssetId>)>,
    validation_assets: Vec<AssetId>,
    left_out: LeftOut,
    net: FsqCvae,
    params: Params,
    device: Device,
}

impl FsqCvaeTask {
    /// Opens the corpora and builds the network with its starting weights. The config was validated.
    ///
    /// # Errors
    /// A sentence: a corpus that cannot be read, or a split without assets.
    pub fn new(config: FsqCvaeTaskConfig, device: Device) -> Result<Self, String> {
        let (assets, train_assets, validation_assets) = Assets::of(&config.data)?;
        assets.rigged(&config.data)?;
        let left_out = LeftOut::of(&assets, &config.data, &train_assets)?;
        let (net, params) = Self::network(&config, device).map_err(|e| e.to_string())?;
        let cache = Arc::new(Cache::of(&config.data, 1));
        let assets = Arc::new(assets);
        Ok(Self { assets, cache, train_assets, validation_assets, left_out, net, params, device, config })
    }

    /// The network of a config, with its starting weights.
    ///
    /// # Errors
    /// For impossible sizes.
    pub fn network(config: &FsqCvaeTaskConfig, device: Device) -> Result<(FsqCvae, Params), NnError> {
        let (net, builder) = Self::built(config)?;
        Ok((net, builder.finish(config.train.seed, Kind::Float, device)?))
    }

    /// As [`Self::network`], without values: they are to be loaded.
    ///
    /// # Errors
    /// For impossible sizes.
    pub(crate) fn blank(config: &FsqCvaeTaskConfig, device: Device) -> Result<(FsqCvae, Params), NnError> {
        let (net, builder) = Self::built(config)?;
        Ok((net, builder.blank(Kind::Float, device)?))
    }

    /// The network, and what has its names and shapes.
    pub(crate) fn built(config: &FsqCvaeTaskConfig) -> Result<(FsqCvae, Builder), NnError> {
        let mut builder = Builder::default();
        Ok((FsqCvae::new(builder.root(), &config.model)?, builder))
    }

    /// Its settings.
    pub fn config(&self) -> &FsqCvaeTaskConfig {
        &self.config
    }

    /// Where batches of the training split come from.
    pub fn batches(&self) -> Arc<BatchSource> {
        Arc::new(BatchSource::new(self.config.clone(), self.assets.clone(), self.cache.clone(), &self.train_assets))
    }
}

impl Task for FsqCvaeTask {
    type Batch = Batch;

    fn name(&self) -> &'static str {
        FsqCvaeTaskConfig::TASK
    }

    fn params(&self) -> &Params {
        &self.params
    }

    fn source(&self) -> Arc<dyn Source<Batch = Batch>> {
        self.batches()
    }

    fn loss(&self, w: &Weights, batch: &Batch, _at: At) -> Result<Loss, String> {
        loss_of(&self.net, &self.config, w, batch, self.device)
    }

    fn beside(&self) -> Option<LossOf<Batch>> {
        let (config, device) = (self.config.clone(), self.device);
        let net = FsqCvae::new(Builder::default().root(), &config.model).ok()?;
        beside(device, move |w, batch: &Batch, _| loss_of(&net, &config, w, batch, device))
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
        let metrics = self.validation(w, at)?;
        let encoded = self.encode(w, self.validated()[0])?;
        let (_, sheet, _) = self.sheet(w, &encoded, (self.config.eval.cuts[0], self.config.model.skin_tokens))?;
        let pictures = vec![("validation/first".into(), sheet.width() as u32, sheet.height() as u32, sheet.to_png())];
        Ok(Validation { metrics, pictures, ..Validation::default() })
    }

    fn objective(&self) -> (&'static str, Better) {
        ("iou_rule@val", Better::Higher)
    }
}

impl Experiment for FsqCvaeTask {
    fn assets(&self) -> &Assets {
        &self.assets
    }

    fn notes(&self) -> Vec<String> {
        self.left_out.notes(&self.config.data)
    }

    fn examination_steps(&self) -> Result<usize, String> {
        self.evaluation_assets()
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
        let text = table::lines(&report);
        let codes = lines_of(&report.codes)?;
        let checkpoint = checkpoint.clone();
        let found = Examined::of(text, sheets, |s| &s.file, |gallery| Evaluation { checkpoint, report, gallery });
        found.map(|mut found| {
            found.pictures.push((CODES.into(), codes));
            found
        })
    }
}

/// The file of all codes, beside the pictures: a line of JSON a bone.
const CODES: &str = "codes.jsonl";

fn lines_of(codes: &[BoneCodes]) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    for bone in codes {
        serde_json::to_writer(&mut out, bone).map_err(|e| e.to_string())?;
        out.push(b'\n');
    }
    Ok(out)
}

/// Encode once a rig and once a bone, keep a prefix of the codes, decode, compare. On the processor, rigs are shared out
/// among the threads there are.
///
/// # Errors
/// None at present.
pub fn loss_of(
    net: &FsqCvae,
    c: &FsqCvaeTaskConfig,
    w: &Weights,
    batch: &Batch,
    device: Device,
) -> Result<Loss, String> {
    let parts = NetworkInput::parts(c, batch, device).into_iter();
    let found = w.side_by_side(parts.map(|asked| move |w: &Weights| asked.outputs(net, c, w)).collect());
    let joined = |k: usize| {
        let all: Option<Vec<&Tensor>> = found.iter().map(|own| own.get(k)).collect();
        all.filter(|all| !all.is_empty()).map(|all| Tensor::cat(&all, 0))
    };
    let logits = joined(0).ok_or("a batch without rigs")?;
    let targets = tensors::targets(c, batch, device);
    let predicted = logits.sigmoid();
    let mut loss = Loss::new()
        .term("bce", c.loss.bce, loss::bce(&logits, &targets))
        .term("mse", c.loss.mse, loss::mse(&predicted, &targets))
        .term("dice", c.loss.dice, loss::dice(&predicted, &targets).mean(None::<Kind>));
    if c.loss.support > 0.0 {
        loss = loss.term("support", c.loss.support, loss::support(&logits, &targets, ACTIVE));
    }
    if c.loss.spread > 0.0 {
        loss = loss.term("spread", c.loss.spread, loss::spread(&joined(1).ok_or("nothing was rounded")?));
    }
    if let Some(divergence) = joined(2) {
        loss = loss.term("kl", c.loss.kl, divergence.mean(None::<Kind>));
    }
    Ok(loss.note("prefix", batch.prefix as f64))
}

/// What the network is asked of some rigs.
struct NetworkInput {
    shape: Tensor,
    shape_queries: Tensor,
    cloud: SkinCloud,
    points: Tensor,
    geometry: Option<BoneGeometry>,
    noise: Option<Tensor>,
    off: Option<Tensor>,
    prefix: usize,
}

impl NetworkInput {
    /// A batch's rigs, dealt out to as many threads as this one may take; all together on other devices.
    fn parts(c: &FsqCvaeTaskConfig, batch: &Batch, device: Device) -> Vec<Self> {
        let (shape, shape_queries) = tensors::shape(c, batch, device);
        let (points, geometry) = tensors::asked(c, batch, device);
        let (cloud, noise) = (tensors::skin(c, batch, device), tensors::noise(c, batch, device));
        let (off, prefix) = (tensors::off(c, batch, device), batch.prefix);
        let all = Self { shape, shape_queries, cloud, points, geometry, noise, off, prefix };
        let threads = riglab_torch::threads_on(device);
        let (rigs, each) = (batch.rigs, batch.bones / batch.rigs.max(1));
        let count = threads.min(rigs).max(1);
        let of = |k: usize| {
            let (from, to) = (k * rigs / count, (k + 1) * rigs / count);
            all.narrow((from, to - from), (from * each, (to - from) * each))
        };
        (0..count).map(of).collect()
    }

    /// Of some rigs and their bones, first and number of each.
    fn narrow(&self, rigs: (usize, usize), bones: (usize, usize)) -> Self {
        let some = |t: &Tensor, (from, count): (usize, usize)| t.narrow(0, from as i64, count as i64);
        let of_bones = |t: &Tensor| some(t, bones);
        Self {
            shape: some(&self.shape, rigs),
            shape_queries: some(&self.shape_queries, rigs),
            cloud: SkinCloud {
                points: of_bones(&self.cloud.points),
                weights: of_bones(&self.cloud.weights),
                queries: self.cloud.queries.as_ref().map(of_bones),
                regions: self.cloud.regions.as_ref().map(of_bones),
                off: self.cloud.off.as_ref().map(of_bones),
            },
            points: of_bones(&self.points),
            geometry: self
                .geometry
                .as_ref()
                .map(|g| BoneGeometry { bones: of_bones(&g.bones), points: of_bones(&g.points) }),
            noise: self.noise.as_ref().map(of_bones),
            off: self.off.as_ref().map(of_bones),
            prefix: self.prefix,
        }
    }

    /// Logits [m, p], what is rounded [m, k, axes], and the divergence of latents that are drawn.
    fn outputs(&self, net: &FsqCvae, c: &FsqCvaeTaskConfig, w: &Weights) -> Vec<Tensor> {
        let cond = net.encode_shape(w, &self.shape, &self.shape_queries);
        // Without any code one is made, for the parts of the loss that look at what is rounded.
        let latent = net.encode_skin(w, &self.cloud, self.prefix.max(1));
        let Coded { codes, said } = net.code(w, &latent, &self.cloud, self.noise.as_ref());
        let codes = codes.narrow(1, 0, self.prefix as i64);
        let codes = self.off.as_ref().map_or(codes.shallow_clone(), |by| net.fsq().off(&codes, by));
        let mut out = vec![net.decode(w, &codes, &cond, &self.points, self.geometry.as_ref())];
        if c.loss.spread > 0.0 || said.is_some() {
            out.push(net.unrounded(w, &latent));
        }
        out.extend(said.map(|said| said.divergence));
        out
    }
}
