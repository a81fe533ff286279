//! Training steps of both sides, one at a time and in turn.

use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, ensure};
use riglab_nn::optim::{Ema, Optimizer, Pace};
use riglab_nn::params::Weights;
use riglab_ranks::ALONE;
use riglab_train::{At, Precision, Task, TrainConfig};
use serde::Deserialize;
use serde_json::{Value, json};
use tch::{Kind, Tensor};

use crate::rounds::{Rounds, in_turn, rested};
use crate::row::{Better, Row};
use crate::side::{self, PATIENCE, Side};

/// Passes over the batches before times count.
const WARM_UP: usize = 2;

/// How long both sides train.
#[derive(Clone, Copy)]
pub struct Plan {
    /// Batches that steps go through in turn.
    pub batches: usize,
    /// Timed passes over them, after the warm-up.
    pub rounds: usize,
    /// Timed passes after which losses are compared.
    pub compared: usize,
}

impl Plan {
    /// Steps before the losses that are compared.
    pub fn steps_compared(&self) -> usize {
        (WARM_UP + self.compared.min(self.rounds)) * self.batches
    }
}

#[derive(Deserialize)]
struct Ran {
    seconds: f64,
    cpu_seconds: f64,
    losses: Vec<f64>,
}

/// Both sides' times of a step, and their losses.
pub struct Lockstep {
    /// Milliseconds a step, a value a pass.
    pub wall: Rounds,
    /// So, of all threads' processor time.
    pub cpu: Rounds,
    /// Mean losses, ours and theirs, of the pass after those that the plan says.
    pub compared: [f64; 2],
    /// Steps in all.
    pub steps: usize,
    /// How long both sides rested between them.
    pub rested: Duration,
}

/// Lets both sides take steps in turn, one at a time. Values are means over the batches, one a pass. The other
/// side's warm-up may take `limit`.
pub fn lockstep(ours: &mut Side, theirs: &mut Side, plan: Plan, limit: Duration) -> Result<Lockstep> {
    let Plan { batches, rounds, compared } = plan;
    let start = Instant::now();
    for _ in 0..WARM_UP {
        let _: Ran = ours.ask(&json!({"do": "run", "steps": batches}))?;
        let left = limit.saturating_sub(start.elapsed());
        let _: Ran = theirs.ask_within(left, &json!({"do": "run", "steps": batches}))?;
    }
    let one = json!({"do": "run", "steps": 1});
    let (mut a, mut b): (Vec<Ran>, Vec<Ran>) = Default::default();
    let ask = |side: &mut Side, all: &mut Vec<Ran>| -> Result<f64> {
        all.push(side.ask(&one)?);
        Ok(0.0)
    };
    in_turn(rounds * batches, || ask(ours, &mut a), || ask(theirs, &mut b))?;
    let passes = |all: &[Ran], value: fn(&Ran) -> f64| -> Vec<f64> {
        all.chunks(batches).map(|pass| pass.iter().map(value).sum::<f64>() / batches as f64).collect()
    };
    let both = |value| Rounds { ours: passes(&a, value), theirs: passes(&b, value) };
    let losses = both(|r| r.losses[0]);
    Ok(Lockstep {
        wall: both(|r| 1e3 * r.seconds),
        cpu: both(|r| 1e3 * r.cpu_seconds),
        compared: [&losses.ours, &losses.theirs]
            .map(|l| l.iter().take(compared).next_back().copied().unwrap_or(f64::NAN)),
        steps: (WARM_UP + rounds) * batches,
        rested: rested(rounds * batches),
    })
}

/// As [`lockstep`], with losses that may drift apart by such a share; and a row of the memory that both took.
pub fn compared(label: &str, ours: &mut Side, theirs: &mut Side, plan: Plan, near: f64) -> Result<(Lockstep, Row)> {
    let found = lockstep(ours, theirs, plan, PATIENCE)?;
    let ([la, lb], steps) = (found.compared, plan.steps_compared());
    eprintln!("  mean loss of {} steps, after {steps}: {la:.4} and {lb:.4}", plan.batches);
    ensure!((la / lb - 1.0).abs() <= near, "the two trainings drift apart: {la} and {lb} after {steps} steps");
    let memory = json!({"do": "memory"});
    let row = Row::new(format!("{label}/memory"), ours.ask(&memory)?, theirs.ask(&memory)?, "MB", Better::Lower);
    Ok((found, row.note("peak of the whole process")))
}

/// What `riglab_train` does in a step, on batches made before.
pub struct Training<T: Task> {
    /// The task.
    pub task: T,
    /// The batches, which steps go through in turn.
    pub batches: Vec<T::Batch>,
    config: TrainConfig,
    optimizer: Optimizer,
    ema: Ema,
    step: u64,
}

impl<T: Task> Training<T> {
    /// From the task's present weights on.
    pub fn new(task: T, config: TrainConfig, batches: Vec<T::Batch>) -> Self {
        let optimizer = Optimizer::new(task.params(), config.optim.clone());
        let ema = Ema::new(task.params(), config.ema);
        Self { batches, optimizer, ema, step: 0, task, config }
    }

    /// The weights by name, as the other side reads them.
    pub fn weights(&self) -> Vec<(String, Tensor)> {
        let params = self.task.params();
        params.named(params.weights()).map(|(name, t)| (format!("w/{name}"), t.detach())).collect()
    }

    /// A loss of each batch under the present weights.
    pub fn each(&self, loss: impl Fn(&Weights, &T::Batch, At) -> Result<Tensor, String>) -> Result<Vec<f64>> {
        let _no_grad = tch::no_grad_guard();
        let half = self.half();
        let weights = half.as_ref().unwrap_or(self.task.params().weights());
        let one = |b: &T::Batch| loss(weights, b, self.at()).map(|l| l.double_value(&[]));
        self.batches.iter().map(one).collect::<Result<_, String>>().map_err(|e| anyhow!(e))
    }

    /// Some more steps: `{seconds, cpu_seconds, losses}`.
    pub fn run(&mut self, steps: usize) -> Result<Value> {
        let (start, cpu) = (Instant::now(), side::cpu_seconds());
        let losses: Vec<f64> = (0..steps).map(|_| self.step()).collect::<Result<_>>()?;
        let (seconds, cpu) = (start.elapsed().as_secs_f64(), side::cpu_seconds() - cpu);
        Ok(json!({"seconds": seconds, "cpu_seconds": cpu, "losses": losses}))
    }

    /// Where the next step is.
    pub fn at(&self) -> At<'static> {
        At { seed: self.config.seed, step: self.step, batch: self.step, ranks: &ALONE }
    }

    fn half(&self) -> Option<Weights> {
        let bf16 = self.config.precision == Precision::Bf16;
        bf16.then(|| self.task.params().weights().cast(Kind::BFloat16))
    }

    fn step(&mut self) -> Result<f64> {
        let params = self.task.params();
        let half = self.half();
        let weights = half.as_ref().unwrap_or(params.weights());
        let batch = &self.batches[self.step as usize % self.batches.len()];
        let loss = self.task.loss(weights, batch, self.at()).map_err(|e| anyhow!(e))?.total();
        let value = loss.double_value(&[]);
        let inputs: Vec<&Tensor> = weights.tensors().iter().collect();
        let grads = Tensor::run_backward(&[loss], &inputs, false, false);
        let (schedule, steps) = (&self.config.schedule, self.config.steps);
        let factor = riglab_train::factor(schedule, self.step, steps);
        let beta1 = riglab_train::beta1(schedule, self.step, steps);
        self.optimizer.step_at(params, grads, Pace { factor, beta1 })?;
        self.ema.update(params, self.step)?;
        self.step += 1;
        Ok(value)
    }
}
