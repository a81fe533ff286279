//! Settings of a training run.

use std::path::PathBuf;

use riglab_nn::optim::OptimConfig;
use riglab_ranks::Ranks;
use serde::{Deserialize, Serialize};

use crate::together::Deal;

/// How a run trains. The defaults are sound for a small run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Seeds everything random.
    pub seed: u64,
    /// Weights to start from, instead of randomly initialised ones.
    pub start: StartConfig,
    /// Parts of the network that stay as they began, by the beginning of their parameters' names, as `mesh_encoder`.
    pub frozen: Vec<String>,
    /// Optimizer steps of the run.
    pub steps: u64,
    /// Batches whose gradients are summed (as a mean) for one step. Tasks of plain losses compute them side by side,
    /// each on a share of the threads ([`crate::Task::beside`]): two small batches keep two processors busier than one.
    /// Processes that train together share them. Gradients are summed by halves, so that one, two, four or eight processes
    /// of a thread give the same bits, which takes as many sets of gradients as this number has halvings, and one for
    /// each batch that is computed beside.
    pub accumulate: u64,
    /// How many of them are computed at a time at most, in as many times the memory; 0 for as many as there are
    /// threads.
    pub side_by_side: u64,
    /// Whether blocks of deep stacks keep only what they read, and are computed again in the backward pass (activation
    /// checkpointing): a third more work for a fraction of the memory, and the same numbers.
    pub recompute: bool,
    /// What is computed with; weights, optimizer and losses stay fp32.
    pub precision: Precision,
    /// Learning rate over the run.
    pub schedule: ScheduleConfig,
    /// Optimizers.
    pub optim: OptimConfig,
    /// Decay of the moving average of weights that is validated and kept; 0 for none.
    pub ema: f64,
    /// Threads that make batches. Any number gives the same run; 0 makes them between steps.
    pub workers: usize,
    /// Steps between validations; 0 for none but the last.
    pub validate_every: u64,
    /// Steps between checkpoints; 0 for none but the last.
    pub save_every: u64,
    /// Checkpoints kept, besides the best.
    pub keep: usize,
    /// Steps between points on TensorBoard and in `perf.jsonl`.
    pub log_every: u64,
    /// Steps between histograms of weights on TensorBoard; 0 for none.
    pub histogram_every: u64,
    /// Steps in a row that may be skipped because loss or gradient is not finite.
    pub patience: u64,
}

/// Weights of another training, to go on from (fine-tuning) or to build on (a backbone). They are read once, when the
/// run begins; what is not taken is drawn as always.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartConfig {
    /// Where they are: a run's folder (its best checkpoint), safetensors, or a checkpoint of torch or Lightning. Empty
    /// for none.
    pub from: PathBuf,
    /// Parts of the network that take theirs, by the beginning of their parameters' names, as `mesh_encoder`; the whole
    /// network if none is named. What stands before the names in the file is found out.
    pub parts: Vec<String>,
}

impl StartConfig {
    /// Whether all weights are drawn.
    pub fn is_none(&self) -> bool {
        self.from.as_os_str().is_empty()
    }
}

/// What a step computes with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32 bits.
    Fp32,
    /// bfloat16 with fp32 master weights: faster where the processor has it.
    Bf16,
    /// The faster of the two on the processor of the machine that begins the run: told by what that is, as what a timing says
    /// hangs on how busy it is. The run's config has what was chosen, so that resuming elsewhere changes nothing.
    Auto,
}

impl Precision {
    /// What [`Precision::Auto`] comes to on this machine ([`riglab_torch::multiplies_bf16`]); the others stay.
    #[must_use]
    pub fn resolved(self) -> Self {
        match self {
            Self::Auto if riglab_torch::multiplies_bf16() => Self::Bf16,
            Self::Auto => Self::Fp32,
            chosen => chosen,
        }
    }
}

/// Learning rate over the run, as a factor of the peak.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScheduleConfig {
    /// Shape after warm-up.
    pub kind: ScheduleKind,
    /// Steps of linear warm-up from 0 (not for `one_cycle`).
    pub warmup: u64,
    /// Factor at the last step (not for `constant`).
    pub end: f64,
    /// The rise of `one_cycle`.
    pub one_cycle: OneCycleConfig,
}

/// How `one_cycle` rises, and what it does to momentum. The defaults are those of UniRig's public code.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OneCycleConfig {
    /// Share of the run's steps in which the rate rises to its peak.
    pub rise: f64,
    /// Factor at the first step.
    pub start: f64,
    /// AdamW's decay of first moments at the ends of the run, and at the peak of the rate: it goes down while the
    /// rate goes up, in place of the optimizer's own.
    pub beta1: [f64; 2],
}

impl Default for OneCycleConfig {
    fn default() -> Self {
        Self { rise: 0.1, start: 0.2, beta1: [0.95, 0.85] }
    }
}

/// Shapes of the schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScheduleKind {
    /// Half a cosine down to `end`.
    Cosine,
    /// A straight line down to `end`.
    Linear,
    /// The peak throughout.
    Constant,
    /// Half a cosine up to the peak and half a cosine down to `end`, with momentum the other way (PyTorch's
    /// `OneCycleLR`, which UniRig trains with).
    #[serde(rename = "one_cycle")]
    OneCycle,
}

impl Default for ScheduleConfig {
    fn default() -> Self {
        Self { kind: ScheduleKind::Cosine, warmup: 100, end: 0.01, one_cycle: OneCycleConfig::default() }
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            start: StartConfig::default(),
            frozen: Vec::new(),
            steps: 1000,
            accumulate: 1,
            side_by_side: 0,
            recompute: false,
            precision: Precision::Fp32,
            schedule: ScheduleConfig::default(),
            optim: OptimConfig::default(),
            ema: 0.998,
            workers: 2,
            validate_every: 500,
            save_every: 500,
            keep: 2,
            log_every: 10,
            histogram_every: 0,
            patience: 20,
        }
    }
}

impl TrainConfig {
    /// Checks that ranks can share the batches of a step.
    ///
    /// # Errors
    /// (key, message) where they cannot.
    pub fn shared_by(&self, ranks: &Ranks) -> Result<(), (String, String)> {
        Deal::new(self.accumulate, ranks).map(drop)
    }

    /// Checks ranges and relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let fault = |key: &str, message: String| Err((key.to_string(), message));
        for (key, value) in [("steps", self.steps), ("accumulate", self.accumulate), ("log_every", self.log_every)] {
            if value == 0 {
                return fault(key, format!("{key} must be at least 1"));
            }
        }
        if self.start.is_none() && !self.start.parts.is_empty() {
            return fault("start.parts", "parts of which file or run? Name it in train.start.from".into());
        }
        if self.keep == 0 {
            return fault("keep", "keep must be at least 1: a run resumes from its last checkpoint".into());
        }
        if !(0.0..1.0).contains(&self.ema) {
            return fault("ema", format!("ema = {} must be at least 0 and below 1", self.ema));
        }
        if !(0.0..=1.0).contains(&self.schedule.end) {
            return fault("schedule.end", format!("end = {} must lie in [0, 1]", self.schedule.end));
        }
        let OneCycleConfig { rise, start, beta1 } = self.schedule.one_cycle;
        if !(0.0..1.0).contains(&rise) {
            return fault("schedule.one_cycle.rise", format!("rise = {rise} must be at least 0 and below 1"));
        }
        if !(0.0..=1.0).contains(&start) {
            return fault("schedule.one_cycle.start", format!("start = {start} must lie in [0, 1]"));
        }
        if let Some(beta) = beta1.iter().find(|b| !(0.0..1.0).contains(*b)) {
            return fault("schedule.one_cycle.beta1", format!("{beta} must be at least 0 and below 1"));
        }
        if self.workers > 256 {
            return fault("workers", format!("{} workers: at most 256", self.workers));
        }
        self.optim.validate().map_err(|(key, message)| (format!("optim.{key}"), message))
    }
}
