//! TokenRig (SkinTokens 3.3): a shape comes in; the tokens of its skeleton and the codes of its skin come out, as one
//! sequence.

mod batch;
mod beside;
mod bundle;
mod complete;
mod condition;
mod config;
mod drawing;
mod evaluate;
mod facing;
mod gallery;
mod make;
mod report;
mod rigger;
mod sample;
mod shipped;
mod skin;
mod skinner;
mod stage;
mod template;
#[cfg(test)]
pub(crate) mod testing;
mod thinned;
mod told;

use std::sync::Arc;

use riglab_core::Rig;
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::tokenrig::{NextTokens, Parts, Sequences, TokenRig};
use riglab_train::{At, Better, Loss, LossOf, Source, State, Task, Validation};
use tch::{Device, Tensor};

pub use batch::{Batch, BatchSource};
pub use beside::many_bodies;
pub use condition::Condition;
pub use config::{EvalConfig, LossConfig, SamplingConfig, SkinConfig, TokenRigTaskConfig};
pub use drawing::RigSample;
pub(crate) use drawing::Strict;
pub use evaluate::{Report, SkinAsset};
pub use make::{Draw, GeneratedRig, Rank, RigRequest};
pub use report::Evaluation;
pub use rigger::{AUTO_ENCODER, Rigger};
pub use riglab_geom::Yaw;
pub use sample::Sample;
pub(crate) use shipped::is_word;
pub use skin::Codes;
pub use skinner::Skinner;
pub use template::{BODIES, FindHuman, Placed};

use crate::assets::{AssetId, Assets, Cache};
pub use crate::bundle::Card;
use crate::experiment::{Examined, Experiment, beside};
use crate::fsq_cvae::Frozen;
use crate::sequences::{LeftOut, Unfit};
use crate::settings::TaskSettings;
use crate::unirig_skeleton::shape_tensors;

/// The task, with its network and data.
pub struct TokenRigTask {
    rigger: Rigger,
    pub(crate) assets: Arc<Assets>,
    pub(crate) cache: Arc<Cache<Rig>>,
    samples: Arc<Cache<Result<Sample, Unfit>, (AssetId, u64)>>,
    pub(crate) train_assets: Vec<(f32, Vec<AssetId>)>,
    pub(crate) validation_assets: Vec<AssetId>,
    left_out: LeftOut,
}

impl TokenRigTask {
    /// Opens the corpora and the auto-encoder, and builds the network with its starting weights. The config was
    /// validated.
    ///
    /// # Errors
    /// A sentence: a corpus or an auto-encoder that cannot be read, a split without assets, or one of bare meshes.
    pub fn new(config: TokenRigTaskConfig, device: Device) -> Result<Self, String> {
        let vae = Rigger::auto_encoder(&config, device)?;
        let task = Self::with(config, vae, device)?;
        task.assets.rigged(&task.rigger.config.data)?;
        Ok(task)
    }

    /// As [`Self::new`], with an auto-encoder.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with(config: TokenRigTaskConfig, vae: Arc<Frozen>, device: Device) -> Result<Self, String> {
        let mut task = Self::on_meshes(config, vae, device)?;
        let c = &task.rigger.config;
        task.left_out = LeftOut::take(&task.assets, &c.data, c.limits, &mut task.train_assets)?;
        Ok(task)
    }

    /// As [`Self::with`]; meshes may be bare, and of rigs longer than any limit, for who has them rewarded.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(crate) fn on_meshes(config: TokenRigTaskConfig, vae: Arc<Frozen>, device: Device) -> Result<Self, String> {
        let (assets, train_assets, validation_assets) = Assets::of(&config.data)?;
        let left_out = LeftOut::of(&assets, &config.data, &train_assets)?;
        // Samples are kept where there are few of each rig.
        let kinds = if config.sampling.variants == 0 { 1 } else { 2 };
        let (cache, samples) = (Arc::new(Cache::of(&config.data, kinds)), Arc::new(Cache::of(&config.data, kinds)));
        let rigger = Rigger::new(config, vae, device)?;
        Ok(Self { rigger, assets: Arc::new(assets), cache, samples, train_assets, validation_assets, left_out })
    }

    /// Its model.
    pub fn rigger(&self) -> &Rigger {
        &self.rigger
    }

    /// Where batches of the training split come from.
    pub fn batches(&self) -> Arc<BatchSource> {
        let config = self.rigger.config.clone();
        Arc::new(BatchSource {
            rigs: riglab_data::Mixture::new(config.train.seed, self.train_assets.clone()),
            tokenizer: self.rigger.tokenizer.clone(),
            layout: self.rigger.net.layout().clone(),
            vae: self.rigger.vae.clone(),
            assets: self.assets.clone(),
            cache: self.cache.clone(),
            samples: self.samples.clone(),
            config,
        })
    }
}

impl Task for TokenRigTask {
    type Batch = Batch;

    fn name(&self) -> &'static str {
        TokenRigTaskConfig::TASK
    }

    fn params(&self) -> &Params {
        &self.rigger.params
    }

    fn source(&self) -> Arc<dyn Source<Batch = Batch>> {
        self.batches()
    }

    fn loss(&self, w: &Weights, batch: &Batch, at: At) -> Result<Loss, String> {
        let c = &self.rigger.config;
        let done = at.step as f64 / c.train.steps.max(1) as f64;
        loss_of(&self.rigger.net, c, w, batch, self.rigger.device, Some(done))
    }

    fn beside(&self) -> Option<LossOf<Batch>> {
        let (c, device) = (self.rigger.config.clone(), self.rigger.device);
        let layout = self.rigger.net.layout().clone();
        let net = TokenRig::new(Builder::default().root(), &c.model, &layout, c.skin.codes);
        beside(device, move |w, batch: &Batch, at| {
            let done = at.step as f64 / c.train.steps.max(1) as f64;
            loss_of(&net, &c, w, batch, device, Some(done))
        })
    }

    fn pace(&self, step: u64, steps: u64) -> Vec<f64> {
        vec![self.rigger.config.loss.skin_weight(step as f64 / steps.max(1) as f64)]
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

impl Experiment for TokenRigTask {
    fn assets(&self) -> &Assets {
        &self.assets
    }

    fn notes(&self) -> Vec<String> {
        self.left_out.notes(&self.rigger.config.data)
    }

    fn untrainable(&self) -> Option<String> {
        self.left_out.untrainable()
    }

    fn unfit(&self) -> Option<String> {
        let c = &self.rigger.config;
        if c.loss.never_trains_codes(c.train.steps) {
            let [from, to] = c.loss.skin_warmup;
            return Some(format!(
                "loss.skin_warmup = [{from:?}, {to:?}]: codes would have no weight in any of {} steps; give a first share that \
                 comes sooner, or loss.skin = 0, which trains skeletons alone",
                c.train.steps
            ));
        }
        let (fault, up) = (self.rigger.mismatch()?, self.rigger.vae.config().data.up);
        Some(format!("{fault}; give skin.run an auto-encoder of the same axis, or train with --set data.up={up}"))
    }

    fn warnings(&self) -> Vec<String> {
        self.rigger.mismatch().into_iter().collect()
    }

    fn companions(&self) -> Vec<(String, String)> {
        self.rigger.companions()
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
        let (report, rigs) = self.evaluate(weights, progress)?;
        let sheets = self.gallery(&report, &rigs, pictures)?;
        let text = report::lines(&report);
        let checkpoint = checkpoint.clone();
        Examined::of(text, sheets, |s| &s.file, |gallery| Evaluation { checkpoint, report, gallery })
    }
}

/// Read the shape, read the sequence, compare what should follow each token. `training`: the share of the steps that
/// is done; `None` is without what training adds.
///
/// # Errors
/// None at present.
pub fn loss_of(
    net: &TokenRig,
    c: &TokenRigTaskConfig,
    w: &Weights,
    batch: &Batch,
    device: Device,
    training: Option<f64>,
) -> Result<Loss, String> {
    let parts = parts_of(net, c, w, batch, device, training.is_some());
    // One mean over all tokens, each part with its weight, also over those that are left out for want of one.
    let all = (parts.skeleton_tokens + parts.skin_tokens + batch.unasked as i64).max(1) as f64;
    let (skeleton, skin) = match training {
        Some(done) => (c.loss.skeleton, c.loss.skin_weight(done)),
        None => (1.0, 1.0),
    };
    let [of_skeleton, of_skin] = parts.means();
    Ok(Loss::new()
        .term("skeleton", skeleton * parts.skeleton_tokens as f64 / all, of_skeleton)
        .term("skin", skin * parts.skin_tokens as f64 / all, of_skin)
        .note("tokens", batch.shapes.ids.len() as f64)
        .note("skipped_assets", batch.shapes.skipped as f64)
        .note("clamped_joints", batch.shapes.clamped as f64))
}

/// The sums of both parts' losses, and over how many tokens. On the processor rigs are shared out among the threads there
/// are.
fn parts_of(
    net: &TokenRig,
    c: &TokenRigTaskConfig,
    w: &Weights,
    batch: &Batch,
    device: Device,
    training: bool,
) -> Parts {
    let parts: Vec<Batch> = batch.shapes.dealt(device).iter().map(|rigs| batch.some(rigs)).collect();
    let jobs = parts.iter().map(|part| {
        move |w: &Weights| {
            let Parts { skeleton, skeleton_tokens, skin, skin_tokens } = sums_of(net, c, w, part, device, training);
            vec![skeleton, skin, Tensor::from_slice(&[skeleton_tokens, skin_tokens])]
        }
    });
    let found = w.side_by_side(jobs.collect::<Vec<_>>());
    let sum = |k: usize| found.iter().map(|own| own[k].shallow_clone()).reduce(|a, b| a + b).expect("a part");
    let tokens = sum(2);
    let [skeleton_tokens, skin_tokens] = [0, 1].map(|k| tokens.int64_value(&[k]));
    Parts { skeleton: sum(0), skeleton_tokens, skin: sum(1), skin_tokens }
}

/// As [`parts_of`], by this thread.
fn sums_of(
    net: &TokenRig,
    c: &TokenRigTaskConfig,
    w: &Weights,
    batch: &Batch,
    device: Device,
    training: bool,
) -> Parts {
    let shapes = &batch.shapes;
    let (cloud, picks) = shape_tensors(shapes, c.model.shape.tokens, device);
    let prefix = net.condition(w, &cloud, &picks);
    let ids = Tensor::from_slice(&shapes.ids).to_device(device);
    let told = c.model.tell_joint.then(|| Tensor::from_slice(&batch.told).view([ids.size()[0], -1]).to_device(device));
    let sequences = Sequences { ids: &ids, lengths: &shapes.lengths, told: told.as_ref() };
    let hidden = net.forward(w, &prefix, &sequences, training);
    let each = ids.split_with_sizes(&shapes.lengths, 0);
    let targets: Vec<Tensor> = each.iter().map(|own| own.narrow(0, 1, own.size()[0] - 1)).collect();
    let targets = Tensor::cat(&targets, 0);
    let spread = if training { c.loss.spread } else { 0.0 };
    let asked = NextTokens { hidden: &hidden, targets: &targets, bins: i64::from(c.tokenizer.bins), spread };
    net.losses(w, &asked)
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Skeleton, SkinWeights};
    use riglab_geom::CloudSampler;
    use riglab_nn::tokenrig::{Choices, GEOMETRY, Head};
    use riglab_random::stream;

    use super::testing::{tetrahedron, untrained};
    use super::*;
    use crate::assets::Up;
    use crate::unirig_skeleton::batch::shape;

    /// Two joints that hold vertices and one that holds none.
    fn rig() -> Rig {
        let joint = |name: &str, parent, head| Joint { name: name.into(), parent, head };
        let joints = vec![
            joint("root", None, [-0.8; 3]),
            joint("tip", Some(JointId(0)), [0.8, 0.8, -0.8]),
            joint("idle", Some(JointId(0)), [0.1, 0.2, 0.3]),
        ];
        let weights = SkinWeights::normalized([0, 0, 1, 1].map(|j| [(j, 1.0)])).unwrap();
        Rig::new(Skeleton::new(joints).unwrap(), tetrahedron(), weights).unwrap()
    }

    #[test]
    fn codes_are_told_in_drawing_what_they_are_told_in_training() {
        let rigger = untrained(Head::Levels, true);
        let (c, rig, w) = (rigger.config.clone(), rig(), rigger.params.weights());
        let teller = rigger.teller();
        let random = &mut stream(0, "test", &[]);
        let whole = sample::sample(&rigger.tokenizer, &c.skin, &teller, &rig, ("", true), random).unwrap();
        let prompt: Vec<u32> = whole.ids[..whole.skeleton].iter().map(|&id| id as u32).collect();
        let seen = rigger.condition(w, &[(rig.mesh(), 0), (rig.mesh(), 1)]);
        let streams = &mut [0, 1].map(|k| stream(k, "test", &[]));
        let generate = riglab_nn::generate::GenerateConfig { sample: true, ..Default::default() };
        let mut drawn = rigger.draw(w, &seen, &vec![prompt.clone(); 2], &generate, streams).unwrap();
        assert_eq!((&drawn[0].joints, &drawn[1].joints), (&whole.joints, &whole.joints));
        assert!(whole.joints.len() == 3 && whole.joints.iter().any(|told| told.geometry[12] > 0.1));
        assert!(whole.joints.iter().any(|told| !told.rule.is_empty()));

        // And it is told the same place by place: what was drawn is as likely to the one as to the other.
        let own = drawn.swap_remove(0);
        let ids = Tensor::from_slice(&own.ids);
        let of_places = teller.places(&own.ids, own.skeleton.len(), &own.joints);
        let width = of_places.len() / own.ids.len();
        let likely = |of_places: &[f32]| {
            let told = Tensor::from_slice(of_places).view([-1, width as i64]);
            let sequences = Sequences { ids: &ids, lengths: &[own.ids.len() as i64], told: Some(&told) };
            let hidden = rigger.net.forward(w, &seen.prefix().narrow(0, 0, 1), &sequences, false);
            let targets = ids.narrow(0, 1, own.ids.len() as i64 - 1);
            let asked =
                NextTokens { hidden: &hidden, targets: &targets, bins: i64::from(c.tokenizer.bins), spread: 0.0 };
            // A bone is empty, or not, by its first code.
            let coded = own.skeleton.len() - 1..own.ids.len() - 2;
            let empty: Vec<bool> = coded.clone().map(|at| of_places[width * at + GEOMETRY] == 1.0).collect();
            let anything = Tensor::ones([coded.start as i64, teller.layout.skeleton()], (tch::Kind::Bool, Device::Cpu));
            let choices = Choices { skeleton: &anything, empty: &Tensor::from_slice(&empty) };
            let log = rigger.net.likelihood(w, &asked, Some(&choices), 1.0).log;
            log.narrow(0, coded.start as i64, coded.len() as i64).to_kind(tch::Kind::Double)
        };
        // Without all of it but the place, then without geometry alone, and without the rule alone.
        let without = |what: std::ops::Range<usize>| {
            let mut places = of_places.clone();
            places.chunks_mut(width).for_each(|place| place[what.clone()].fill(0.0));
            likely(&places)
        };
        let mut elsewhere = of_places.clone();
        for place in elsewhere.chunks_mut(width) {
            let slot = place[GEOMETRY];
            place.fill(0.0);
            place[GEOMETRY] = slot;
        }
        let (same, other) = (likely(&of_places), likely(&elsewhere));
        let parts = [without(0..GEOMETRY), without(GEOMETRY + 1..width)];
        let sum = same.sum(tch::Kind::Double).double_value(&[]);
        assert!((sum - own.likelihood.0).abs() < 1e-3, "{sum} {}", own.likelihood.0);
        assert!((&same - &other).abs().max().double_value(&[]) > 1e-2, "{same} {other}");
        for other in parts {
            assert!((&same - &other).abs().max().double_value(&[]) > 5e-3, "{same} {other}");
        }
    }

    #[test]
    fn no_training_begins_with_an_auto_encoder_of_another_axis() {
        let dir = tempfile::tempdir().unwrap();
        testing::corpus_of_one(dir.path());
        let rigger = untrained(Head::Levels, true);
        let of = |up| {
            let mut config = rigger.config.clone();
            config.data.corpora = vec![dir.path().join("one.h5")];
            config.data.up = up;
            TokenRigTask::with(config, rigger.shared_vae(), Device::Cpu).unwrap()
        };
        let same = of(Up::Y);
        assert_eq!((same.unfit(), same.warnings()), (None, Vec::new()));
        // One that was begun so is told, and used as it is.
        let other = of(Up::Z);
        let (said, told) = (other.unfit().unwrap(), other.warnings());
        assert!(said.contains("data.up = \"z\"") && said.contains("with data.up = \"y\""), "{said}");
        assert!(said.contains("skin.run") && said.ends_with("--set data.up=y"), "{said}");
        assert!(told.len() == 1 && said.starts_with(&told[0]), "{told:?}");
        // Nor one that would leave codes as they are.
        let mut config = same.rigger.config.clone();
        config.loss.skin_warmup = [1.0, 1.0];
        let never = TokenRigTask::with(config, rigger.shared_vae(), Device::Cpu).unwrap();
        let said = never.unfit().unwrap();
        assert!(said.starts_with("loss.skin_warmup = [1.0, 1.0]") && never.warnings().is_empty(), "{said}");
    }

    #[test]
    fn what_codes_are_told_of_must_be_given() {
        let rigger = untrained(Head::Levels, true);
        let (mesh, w) = (tetrahedron(), rigger.params.weights());
        let blind = Condition::from(rigger.condition(w, &[(&mesh, 0)]).prefix().shallow_clone());
        let (how, streams) = (riglab_nn::generate::GenerateConfig::default(), &mut [stream(0, "test", &[])]);
        let said = rigger.draw(w, &blind, &[rigger.free()], &how, streams).unwrap_err();
        assert!(said.contains("give the meshes"), "{said}");
    }

    #[test]
    fn codes_without_weight_can_be_left_out() {
        for (head, empty) in [(Head::Flat, false), (Head::Levels, false), (Head::Levels, true)] {
            let rigger = untrained(head, empty);
            let (mut c, rig, w) = (rigger.config.clone(), rig(), rigger.params.weights());
            c.loss.skin_warmup = [0.5, 0.75];
            let layout = rigger.net.layout();
            let random = &mut stream(0, "test", &[]);
            let whole = sample::sample(&rigger.tokenizer, &c.skin, &rigger.teller(), &rig, ("", true), random).unwrap();
            let (alone, follow) = sample::skeleton(&rigger.tokenizer, &c.skin, &rig, ("", true)).unwrap();
            assert_eq!((alone.skeleton, &alone.ids[..]), (whole.skeleton, &whole.ids[..whole.skeleton]));
            assert_eq!(alone.ids.len() + follow, whole.ids.len(), "{head:?} {empty}");
            let batch = |sample: &Sample, unasked| {
                let mut batch = Batch { unasked, ..Batch::default() };
                let sampler = CloudSampler::new(rig.mesh(), &c.sampling.cloud);
                let random = &mut stream(1, "test", &[]);
                shape(&c.sampling.cloud, &c.model.shape, &sampler, random, &mut batch.shapes);
                batch.push(sample, &rigger.teller());
                batch
            };
            let gradients = |batch: &Batch, done| {
                let loss = loss_of(&rigger.net, &c, w, batch, Device::Cpu, Some(done)).unwrap().total();
                let of = |t: &Tensor| t.requires_grad().then(|| t.shallow_clone());
                let learned: Vec<Tensor> = w.tensors().iter().filter_map(of).collect();
                let found = Tensor::run_backward(&[loss], &learned, false, false);
                // Undefined where the loss does not know a parameter.
                found
                    .into_iter()
                    .zip(learned)
                    .map(|(g, t)| if g.defined() { g } else { t.zeros_like() })
                    .collect::<Vec<_>>()
            };
            let (whole, alone) = (batch(&whole, 0), batch(&alone, layout.scored(follow)));
            let off = |done| {
                let pairs = gradients(&whole, done).into_iter().zip(gradients(&alone, done));
                pairs.map(|(a, b)| (a - b).abs().max().double_value(&[])).fold(0.0, f64::max)
            };
            assert!(off(0.4) < 1e-6, "{head:?} {empty}: {}", off(0.4));
            assert!(off(0.9) > 1e-3, "they have weight by then");
        }
    }
}
