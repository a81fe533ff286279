//! What a task is.

use std::collections::BTreeMap;
use std::sync::Arc;

use riglab_nn::params::{Params, Weights};
use riglab_random::{Stream, stream};
use riglab_ranks::Ranks;
use tch::{Kind, Tensor};

use crate::prefetch::Source;

/// When something happens in a run, and the seed: the key of everything random.
#[derive(Clone, Copy)]
pub struct At<'a> {
    /// The run's seed.
    pub seed: u64,
    /// The optimizer step, from 0.
    pub step: u64,
    /// The batch, from 0: `step * accumulate` and up.
    pub batch: u64,
    /// Those who train together. They validate together too: what takes long can be shared ([`Ranks::share`]). A loss,
    /// though, is this rank's own.
    pub ranks: &'a Ranks,
}

impl At<'_> {
    /// What libtorch's generator is seeded with before this batch: nothing random has to be saved.
    pub(crate) fn generator_seed(&self) -> u64 {
        self.seed ^ self.batch.wrapping_mul(0x9e37_79b9_7f4a_7c15)
    }

    /// The stream of random numbers for a purpose at this batch.
    pub fn stream(&self, purpose: &str) -> Stream {
        stream(self.seed, purpose, &[self.batch])
    }
}

/// A loss by its parts.
#[derive(Default)]
pub struct Loss {
    terms: Vec<(&'static str, f64, Tensor)>,
    notes: Vec<(&'static str, f64)>,
}

impl Loss {
    /// Without parts.
    pub fn new() -> Self {
        Self::default()
    }

    /// With a part: a scalar tensor and its weight in the sum. A weight of 0 logs it only.
    pub fn term(mut self, name: &'static str, weight: f64, value: Tensor) -> Self {
        self.terms.push((name, weight, value));
        self
    }

    /// With a number to log beside.
    pub fn note(mut self, name: &'static str, value: f64) -> Self {
        self.notes.push((name, value));
        self
    }

    /// The weighted sum.
    pub fn total(&self) -> Tensor {
        let parts = self.terms.iter().filter(|(_, w, _)| *w != 0.0).map(|(_, w, t)| t.to_kind(Kind::Float) * *w);
        parts.reduce(|a, b| a + b).unwrap_or_else(|| Tensor::from(0f32))
    }

    /// The values of the parts and notes, by name.
    pub fn values(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        self.terms.iter().map(|(n, _, t)| (*n, t.double_value(&[]))).chain(self.notes.iter().copied())
    }
}

/// Which of two values of a metric is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// The larger.
    Higher,
    /// The smaller.
    Lower,
}

impl Better {
    /// Whether `a` is better than `b`.
    pub fn than(self, a: f64, b: f64) -> bool {
        match self {
            Self::Higher => a > b,
            Self::Lower => a < b,
        }
    }
}

/// What a validation found.
#[derive(Default)]
pub struct Validation {
    /// Metrics by path, e.g. `iou@val`; logged below `eval/`.
    pub metrics: Vec<(String, f64)>,
    /// Pictures for TensorBoard: tag, width, height and a PNG file.
    pub pictures: Vec<(String, u32, u32, Vec<u8>)>,
    /// Sentences that someone who watches should read now.
    pub warnings: Vec<String>,
}

/// [`Task::loss`] by itself, for a thread of its own.
pub type LossOf<B> = Box<dyn Fn(&Weights, &B, At) -> Result<Loss, String> + Send>;

/// Something to train: the only thing the loop knows about rigs, networks and losses.
pub trait Task {
    /// What a step learns from: plain data, made by other threads.
    type Batch: Send + 'static;

    /// Its name in logs and checkpoints.
    fn name(&self) -> &'static str;

    /// The parameters that are trained.
    fn params(&self) -> &Params;

    /// Where batches come from.
    fn source(&self) -> Arc<dyn Source<Batch = Self::Batch>>;

    /// The loss of a batch under these weights (master weights, or their bfloat16 copy).
    ///
    /// # Errors
    /// A sentence; the run ends with it.
    fn loss(&self, weights: &Weights, batch: &Self::Batch, at: At) -> Result<Loss, String>;

    /// [`Self::loss`] for another thread, once for each that is started: batches of a step (`train.accumulate`) are
    /// then computed side by side on the processors there are. What it draws at random it draws by [`At::stream`] or by
    /// `riglab_torch::dropout`. `None`: one batch after another, on all processors.
    fn beside(&self) -> Option<LossOf<Self::Batch>> {
        None
    }

    /// How many steps belong together, from the first on: a run begins, or goes on without what was kept, at the first of
    /// them only.
    fn period(&self) -> u64 {
        1
    }

    /// What its loss takes that follows from how far a run is, at a step of a run of so many, such as weights that rise;
    /// most have nothing of the kind. Runs of other lengths are the same as long as it is, and the learning rate.
    fn pace(&self, _step: u64, _steps: u64) -> Vec<f64> {
        Vec::new()
    }

    /// Validates weights.
    ///
    /// # Errors
    /// A sentence; the run ends with it.
    fn validate(&self, weights: &Weights, at: At) -> Result<Validation, String>;

    /// The metric of [`Self::validate`] by which the best checkpoint is chosen.
    fn objective(&self) -> (&'static str, Better);

    /// A value of the objective as people are told it: its name, and the value in the unit that tables have.
    fn told(&self, value: f64) -> String {
        format!("{} {value:.4}", self.objective().0)
    }

    /// What it keeps from one step to the next besides its parameters, for checkpoints. Most keep nothing.
    fn kept(&self) -> BTreeMap<String, Tensor> {
        BTreeMap::new()
    }

    /// Goes on with what [`Self::kept`] gave.
    ///
    /// # Errors
    /// A sentence: what is missing or of another task.
    fn resume(&self, _kept: &BTreeMap<String, Tensor>) -> Result<(), String> {
        Ok(())
    }
}
