//! GRPO (SkinTokens 3.4): a trained TokenRig draws groups of rigs for meshes, geometric rewards say which of a group
//! are better, and the policy learns to draw those, held to where it started. UniRig's skeleton model can be refined as
//! well, by the rewards of joints and bones.
//!
//! The one idea: **the trainer's own likelihood is the only one that counts.** Rigs are drawn by the fast sampler, then
//! asked again with the network, which also gives the gradient, so that the ratio between new and old policy is 1 before
//! the first update; how far the sampler's own differs is logged.
//!
//! Holds: true rigs of the training split are never looked at, but by steps of `augment` that need skeletons; a run resumes exactly, in the middle of a rollout too; the
//! reward alone never makes a checkpoint the best one (see [`GuardConfig`]).

mod batch;
mod config;
mod evaluate;
mod judges;
mod lineage;
mod policy;
mod report;
mod rollout;
mod score;

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use riglab_core::Rig;
use riglab_data::Mixture;
use riglab_nn::grpo::{Policies, objective};
use riglab_nn::params::{Params, Weights};
use riglab_random::{Draw, stream};
use riglab_report::counted;
use riglab_train::{At, Better, Checkpoint, Loss, Source, State, Task, Validation};
use tch::{Device, Kind, Tensor};

pub use batch::{Batch, BatchSource, Subject};
pub use config::{Dead, GrpoTaskConfig, GuardConfig, RolloutConfig, StartConfig};
use evaluate::JudgedMesh;
pub(crate) use lineage::{descends, refined, same_start};
use lineage::{startable, started};
pub use report::{AssetRow, AssetScore, Evaluation, Report, Row};
use rollout::{GAP, floats, settle};
pub use rollout::{Rollout, Sequence, noted};
pub use score::{JudgeSettings, candidates, rewards};

use crate::assets::{Assets, Cache, DataConfig};
use crate::experiment::{Examined, Experiment};
use crate::settings::{Settings, TaskSettings};
use crate::tokenrig::{Card, Rigger, TokenRigTask, TokenRigTaskConfig};
use crate::unirig_skeleton::{self, SkeletonTask, SkeletonTaskConfig, Trained};
use policy::Policy;

/// What the model that a run starts from has on the validation split.
#[derive(Clone, Copy, Debug)]
struct First {
    /// Its J2J over the meshes whose true rig is known, with 1 for a draw that is no skeleton.
    j2j: f64,
    /// Its mean reward.
    reward: f64,
}

impl First {
    /// What it is kept as. Under `first.j2j` earlier versions kept a mean over all meshes, which says nothing of this one.
    const NAMES: [&str; 2] = ["first.j2j_of_known", "first.reward"];

    fn tensors(self) -> impl Iterator<Item = (String, Tensor)> {
        Self::NAMES
            .into_iter()
            .zip([self.j2j, self.reward])
            .map(|(name, value)| (name.to_string(), Tensor::from(value)))
    }

    /// What was kept; `None` where it is to be measured anew.
    fn of(kept: &BTreeMap<String, Tensor>) -> Option<Self> {
        let [j2j, reward] = Self::NAMES.map(|name| kept.get(name).map(|t| t.double_value(&[])));
        Some(Self { j2j: j2j?, reward: reward? })
    }
}

/// The task, with its policy and data.
pub struct GrpoTask {
    config: GrpoTaskConfig,
    /// What is refined.
    policy: Box<dyn Policy>,
    /// Where it started, and what it is held to.
    start: Weights,
    /// What that is called, and how long it was trained; nothing where nobody asks.
    begins: Option<String>,
    /// What is gone over.
    rollout: RefCell<Option<Rollout>>,
    /// The start on the validation split, once it is known.
    first: Cell<Option<First>>,
    /// What is trained on, as far as there is memory for it.
    meshes: Arc<Cache<Rig>>,
    /// The same of the validation split, voxelised.
    held: Cache<JudgedMesh>,
}

impl GrpoTask {
    /// Opens the corpora and the model to start from. The config was validated.
    ///
    /// # Errors
    /// A sentence: a model or a corpus that cannot be read, or a split without assets.
    pub fn new(config: GrpoTaskConfig, device: Device) -> Result<Self, String> {
        let (task, card) = match Start::open(&config, device)? {
            Start::Rigs(start, card) => (Self::with(config, &start, device)?, card),
            Start::Skeletons(start) => {
                if config.reward.weights.judge_weights() {
                    return Err(UNJUDGED.into());
                }
                config.suits(&start.config.tokenizer)?;
                let policy = SkeletonTask::on_meshes(skeleton_config(&config, &start.config), device)?;
                (Self::of(config, Box::new(policy), &start.params)?, start.card)
            }
        };
        let (name, steps) = (card.name, counted(card.state.step as usize, "step"));
        let begins = format!("it starts from start.model, {name}, which was trained for {steps}");
        Ok(Self { begins: Some(begins), ..task })
    }

    /// As [`Self::new`], with the model to start from.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with(config: GrpoTaskConfig, start: &Rigger, device: Device) -> Result<Self, String> {
        config.suits(&start.config().tokenizer)?;
        let policy = TokenRigTask::on_meshes(policy_config(&config, start), start.shared_vae(), device)?;
        Self::of(config, Box::new(policy), start.params())
    }

    fn of(config: GrpoTaskConfig, policy: Box<dyn Policy>, start: &Params) -> Result<Self, String> {
        let named = start.named(start.weights()).map(|(n, t)| (n.to_string(), t.detach().copy())).collect();
        policy.params().load(&named).map_err(|e| e.to_string())?;
        let start = policy.params().weights().detached_copy();
        let (meshes, held) = (Arc::new(Cache::of(&config.data, 2)), Cache::of(&config.data, 2));
        Ok(Self {
            config,
            policy,
            start,
            begins: None,
            rollout: RefCell::default(),
            first: Cell::new(None),
            meshes,
            held,
        })
    }

    /// Whether a run's settings are of skeletons alone: of a model that makes no weights.
    ///
    /// # Errors
    /// A sentence: the model to start from cannot be read.
    pub fn of_skeletons(settings: &Settings, device: Device) -> Result<bool, String> {
        let config: GrpoTaskConfig = settings.get()?;
        Ok(matches!(Start::open(&config, device)?, Start::Skeletons(_)))
    }

    /// The policy as a model that makes rigs; `None` where it draws skeletons alone.
    pub fn rigger(&self) -> Option<&Rigger> {
        self.policy.rigger()
    }

    /// The places of a step's sequences in the rollout: all of them, or a part in an order of its own each time they are
    /// gone over.
    fn dealt(&self, rollout: &Rollout, at: At) -> Vec<usize> {
        let parts = self.config.rollout.minibatches;
        let mut order: Vec<usize> = (0..rollout.sequences.len()).collect();
        if parts == 1 {
            return order;
        }
        stream(at.seed, "rollout order", &[at.batch / parts as u64]).shuffled(&mut order);
        let part = (at.batch % parts as u64) as usize;
        let (from, to) = (part * order.len() / parts, (part + 1) * order.len() / parts);
        order[from..to].to_vec()
    }

    /// The loss of some sequences of a rollout. Those that were not asked yet how likely they were are remembered.
    fn loss_of(&self, w: &Weights, rollout: &mut Rollout, places: &[usize]) -> Result<Loss, String> {
        let (c, device) = (&self.config, self.policy.device());
        // Where nothing counts, a loss of 0 with a gradient of 0 is left of the whole.
        let counted: Vec<usize> = places.iter().copied().filter(|&k| rollout.sequences[k].counts).collect();
        let share = if counted.is_empty() { 0.0 } else { 1.0 };
        let places = if counted.is_empty() { places } else { &counted };
        let sequences: Vec<&Sequence> = places.iter().map(|&k| &rollout.sequences[k]).collect();
        let temperature = f64::from(c.rollout.temperature);
        let (likely, lengths) = self.policy.likely(w, &rollout.shapes, &sequences, temperature);
        if c.rollout.updates() == 1 && sequences.iter().all(|s| s.old.is_empty()) {
            let gap = settle(&mut rollout.sequences, places, &floats(&likely.log), &lengths);
            noted().zip(&mut rollout.notes).filter(|(name, _)| *name == GAP).for_each(|(_, note)| *note = gap);
            // As many numbers of each: a checkpoint keeps both side by side.
            rollout.sequences.iter_mut().filter(|s| s.old.is_empty()).for_each(|s| s.reference.clear());
        }
        let sequences: Vec<&Sequence> = places.iter().map(|&k| &rollout.sequences[k]).collect();
        let known = |of: fn(&Sequence) -> &Vec<f32>| {
            let flat: Vec<f32> = sequences.iter().flat_map(|s| of(s)).copied().collect();
            Tensor::from_slice(&flat).to_kind(likely.log.kind()).to_device(device)
        };
        let (old, reference) = (known(|s| &s.old), known(|s| &s.reference));
        if old.size() != likely.log.size() || reference.size() != likely.log.size() {
            return Err("the rollout that was kept is of another model or grammar".into());
        }
        let policies = Policies { now: &likely.log, old: &old, reference: &reference };
        let groups: Vec<usize> = sequences.iter().map(|s| s.mesh).collect();
        let advantages: Vec<f64> = sequences.iter().map(|s| s.advantage).collect();
        let own = objective(&policies, &lengths, &groups, &advantages, &c.objective);
        let mean = |t: &Tensor| if t.numel() == 0 { 0.0 } else { t.mean(Kind::Double).double_value(&[]) };
        let divergence = mean(&own.k3);
        if divergence > c.guard.divergence {
            return Err(format!(
                "the policy has left the model it started from: the divergence of this step is {divergence:.3} nats a \
                 token, guard.divergence = {}. Lower train.optim.adamw_lr and muon_lr, or raise objective.beta; the \
                 checkpoints so far are whole",
                c.guard.divergence
            ));
        }
        let rest = &own.loss - &own.policy;
        let mut loss = Loss::new()
            .term("policy", 1.0, own.policy * share)
            .term("held", 1.0, rest * share)
            .note("divergence", divergence)
            .note("clip_fraction", own.clip_fraction)
            .note("ratio", if own.ratio.numel() == 0 { 1.0 } else { mean(&own.ratio) })
            .note("entropy", mean(&likely.entropy));
        for (name, value) in noted().zip(&rollout.notes) {
            loss = loss.note(name, *value);
        }
        Ok(loss)
    }
}

const UNJUDGED: &str = "reward.weights: start.model is a skeleton model, which draws no weights to be judged: set \
                        reward.weights.skinning and reward.weights.motion to 0, as unirig/skeleton_grpo.toml does";

/// The model that a config starts from.
enum Start {
    Rigs(Box<Rigger>, Card),
    Skeletons(Box<Trained>),
}

impl Start {
    fn open(config: &GrpoTaskConfig, device: Device) -> Result<Self, String> {
        let path = &config.start.model;
        if path.as_os_str().is_empty() {
            return Rigger::shipped(device).map(Self::rigs);
        }
        match Trained::open(path, device)? {
            Some(skeletons) => Ok(Self::Skeletons(Box::new(skeletons))),
            None => startable(path).and_then(|()| Rigger::open(path, device)).map(Self::rigs),
        }
    }

    fn rigs((rigger, card): (Rigger, Card)) -> Self {
        Self::Rigs(Box::new(rigger), card)
    }
}

/// The settings of the policy: its model as it started, on this run's data.
fn policy_config(config: &GrpoTaskConfig, start: &Rigger) -> TokenRigTaskConfig {
    TokenRigTaskConfig {
        data: DataConfig { up: start.config().data.up, ..config.data.clone() },
        augment: config.augment.clone(),
        train: config.train.clone(),
        eval: config.eval.clone(),
        ..start.config().clone()
    }
}

/// As [`policy_config`], of a skeleton model.
fn skeleton_config(config: &GrpoTaskConfig, start: &SkeletonTaskConfig) -> SkeletonTaskConfig {
    let eval = &config.eval;
    SkeletonTaskConfig {
        data: DataConfig { up: start.data.up, ..config.data.clone() },
        augment: config.augment.clone(),
        train: config.train.clone(),
        eval: unirig_skeleton::EvalConfig {
            parents: eval.parents,
            rows: eval.rows,
            seed: eval.seed,
            ..start.eval.clone()
        },
        ..start.clone()
    }
}

/// The model of a run of this task, at a checkpoint: `best`, `last` or `step-N`.
///
/// # Errors
/// A sentence: what cannot be read, or another model where the run started.
pub(crate) fn of_run(
    run: &Path,
    settings: &Settings,
    checkpoint: &str,
    device: Device,
) -> Result<(Rigger, Card), String> {
    descends(run)?;
    let config: GrpoTaskConfig = settings.get()?;
    let Start::Rigs(start, card) = Start::open(&config, device)? else {
        return Err(format!(
            "{}: refines a skeleton model, which makes no weights and so no rigs; `riglab eval` shows its skeletons",
            run.display()
        ));
    };
    same_start(run, start.params())?;
    let file = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let corpora = config.data.corpora.iter().filter_map(file).collect::<Vec<_>>().join(", ");
    let splits = config.data.train.iter().map(|split| format!("`{split}`")).collect::<Vec<_>>().join(", ");
    // It rigs as the model that it started from; `config.eval` says how rewards are told.
    let config = TokenRigTaskConfig { eval: start.config().eval.clone(), ..policy_config(&config, &start) };
    let rigger = Rigger::blank(config, start.shared_vae(), device)?;
    let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map_err(|e| e.to_string())?;
    checkpoint.load_weights(rigger.params()).map_err(|e| e.to_string())?;
    let name = run.display().to_string();
    // A folder's path is of use on one machine only.
    let start = Path::new(&card.name).file_name().map_or(card.name.clone(), |n| n.to_string_lossy().into_owned());
    let mut text = format!("{start}, refined by geometric rewards (GRPO) on meshes of {corpora} (splits {splits}).");
    if !card.text.trim().is_empty() {
        text += " It has no card of its own: what follows describes the model that it started from, whose scores, data and \
                 licence are not those of this one.\n\n";
        text += &card.text;
    }
    let text = text.trim_end().to_string();
    Ok((rigger, Card { name, state: checkpoint.state().clone(), text }))
}

impl Task for GrpoTask {
    type Batch = Batch;

    fn name(&self) -> &'static str {
        GrpoTaskConfig::TASK
    }

    fn params(&self) -> &Params {
        self.policy.params()
    }

    fn source(&self) -> Arc<dyn Source<Batch = Batch>> {
        let (pool, (cloud, model)) = (self.policy.pool(), self.policy.reads());
        Arc::new(BatchSource {
            config: self.config.clone(),
            cloud,
            model: model.clone(),
            assets: pool.assets.clone(),
            cache: self.meshes.clone(),
            meshes: Mixture::new(self.config.train.seed, pool.train.to_vec()),
        })
    }

    fn period(&self) -> u64 {
        self.config.rollout.updates()
    }

    fn loss(&self, w: &Weights, batch: &Batch, at: At) -> Result<Loss, String> {
        if !batch.subjects.is_empty() {
            let made = self.roll(w, batch, at.batch / self.config.rollout.updates())?;
            self.rollout.replace(Some(made));
        }
        let mut rollout = self.rollout.borrow_mut();
        let rollout = rollout.as_mut().ok_or("the checkpoint lacks the rollout that this step goes over")?;
        let places = self.dealt(rollout, at);
        self.loss_of(w, rollout, &places)
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
        self.validation(w, at)
    }

    fn objective(&self) -> (&'static str, Better) {
        ("guarded_reward@val", Better::Higher)
    }

    fn kept(&self) -> BTreeMap<String, Tensor> {
        let mut all = self.rollout.borrow().as_ref().map(Rollout::tensors).unwrap_or_default();
        all.extend(self.first.get().into_iter().flat_map(First::tensors));
        all
    }

    fn resume(&self, kept: &BTreeMap<String, Tensor>) -> Result<(), String> {
        self.first.set(First::of(kept));
        self.rollout.replace(Rollout::of(kept));
        Ok(())
    }
}

impl Experiment for GrpoTask {
    fn assets(&self) -> &Assets {
        self.policy.pool().assets
    }

    fn notes(&self) -> Vec<String> {
        let (c, policy) = (&self.config, &self.policy);
        let idle = config::idle(c, policy.vae().is_some(), policy.up());
        let begins = self.begins.clone().into_iter();
        begins.chain(policy.notes()).chain(config::unread(&c.eval)).chain(idle).collect()
    }

    fn warnings(&self) -> Vec<String> {
        let told = |fault| format!("start.model: {fault}");
        self.policy.rigger().and_then(Rigger::mismatch).map(told).into_iter().collect()
    }

    fn companions(&self) -> Vec<(String, String)> {
        started(self.params(), &self.start)
    }

    fn examination_steps(&self) -> Result<usize, String> {
        self.examined()
    }

    fn examine(
        &self,
        weights: &Weights,
        checkpoint: &State,
        pictures: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Examined, String> {
        let (report, sheets) = self.compare(weights, pictures, progress)?;
        let text = report::lines(&report);
        let checkpoint = checkpoint.clone();
        Examined::of(
            text,
            sheets,
            |s| &s.file,
            |gallery| Evaluation { checkpoint, report, gallery, other_models: Vec::new() },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_earlier_versions_measured_of_the_start_is_measured_anew() {
        let mut kept: BTreeMap<String, Tensor> = First { j2j: 0.25, reward: 4.0 }.tensors().collect();
        assert_eq!(First::of(&kept).map(|first| (first.j2j, first.reward)), Some((0.25, 4.0)));
        let j2j = kept.remove(First::NAMES[0]).unwrap();
        kept.insert("first.j2j".into(), j2j);
        assert!(First::of(&kept).is_none());
    }
}
