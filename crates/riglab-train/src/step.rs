//! A step: what it does to the weights, without what is written of it.

use riglab_nn::optim::{Ema, Optimizer, Pace, StepStats};
use riglab_nn::params::{Params, Weights};
use riglab_torch::TorchError;
use tch::{Kind, Tensor};

use crate::config::{Precision, TrainConfig};
use crate::error::TrainError;
use crate::prefetch::Prefetch;
use crate::schedule;
use crate::task::{At, Task};

/// Optimizer and moving average of a run.
pub(crate) struct Stepper<'a> {
    config: &'a TrainConfig,
    pub optimizer: Optimizer,
    pub ema: Option<Ema>,
}

/// What came of a step.
pub(crate) struct Stepped {
    /// The loss.
    pub total: f64,
    /// Names and values for the log.
    pub values: Vec<(String, f64)>,
    /// Whether weights were changed: not where something was not finite.
    pub taken: bool,
}

impl<'a> Stepper<'a> {
    pub fn new(params: &Params, config: &'a TrainConfig) -> Self {
        let optimizer = Optimizer::new(params, config.optim.clone());
        let ema = (config.ema > 0.0).then(|| Ema::new(params, config.ema));
        Self { config, optimizer, ema }
    }

    /// The weights that count: the moving average, where there is one.
    pub fn weights<'b>(&'b self, params: &'b Params) -> &'b Weights {
        self.ema.as_ref().map_or(params.weights(), Ema::weights)
    }

    /// One optimizer step, the one after `step` others.
    pub fn step<T: Task>(
        &mut self,
        task: &T,
        batches: &mut Prefetch<T::Batch>,
        step: u64,
    ) -> Result<Stepped, TrainError> {
        let (config, params) = (self.config, task.params());
        let weights = match config.precision {
            Precision::Bf16 => params.weights().cast(Kind::BFloat16).recomputing(config.recompute),
            _ => params.weights().recomputing(config.recompute),
        };
        let (mut grads, mut values): (Vec<Tensor>, Vec<(String, f64)>) = Default::default();
        let share = 1.0 / config.accumulate as f64;
        let mut total = 0.0;
        for micro in 0..config.accumulate {
            let at = At { seed: config.seed, step, batch: step * config.accumulate + micro };
            let batch = batches.take().map_err(TrainError::Task)?;
            // libtorch's generator is seeded afresh: nothing random has to be saved.
            tch::manual_seed((config.seed ^ at.batch.wrapping_mul(0x9e37_79b9_7f4a_7c15)) as i64);
            let loss = task.loss(&weights, &batch, at).map_err(TrainError::Task)?;
            let sum = loss.total();
            total += sum.double_value(&[]) * share;
            add_values(&mut values, loss.values(), share);
            add_grads(&mut grads, &weights, &sum, share)?;
        }
        // The optimizer moves the master weights: its own memory can be where these were.
        drop(weights);
        let factor = schedule::factor(&config.schedule, step, config.steps);
        let stats = if total.is_finite() {
            let pace = Pace { factor, beta1: schedule::beta1(&config.schedule, step, config.steps) };
            self.optimizer.step_at(params, grads, pace)?
        } else {
            StepStats { grad_norm: f64::NAN, taken: false }
        };
        values.insert(0, ("train/loss".into(), total));
        values.push(("train/grad_norm".into(), stats.grad_norm));
        values.push(("train/lr_factor".into(), factor));
        if !stats.taken {
            values.push(("train/skipped".into(), 1.0));
        } else if let Some(ema) = &mut self.ema {
            ema.update(params, step)?;
        }
        Ok(Stepped { total, values, taken: stats.taken })
    }
}

fn add_values(sums: &mut Vec<(String, f64)>, values: impl Iterator<Item = (&'static str, f64)>, share: f64) {
    for (k, (name, value)) in values.enumerate() {
        match sums.get_mut(k) {
            Some((_, sum)) => *sum += value * share,
            None => sums.push((format!("train/{name}"), value * share)),
        }
    }
}

fn add_grads(sums: &mut Vec<Tensor>, weights: &Weights, loss: &Tensor, share: f64) -> Result<(), TrainError> {
    let scaled = if share == 1.0 { loss.shallow_clone() } else { loss * share };
    let inputs: Vec<&Tensor> = weights.tensors().iter().collect();
    let mut grads = Tensor::f_run_backward(&[scaled], &inputs, false, false)
        .map_err(|e| TrainError::Task(TorchError::from(e).to_string()))?;
    if share != 1.0 {
        // Sums of bfloat16 gradients would lose what later batches add.
        for g in grads.iter_mut().filter(|g| g.defined() && g.kind() == Kind::BFloat16) {
            *g = g.to_kind(Kind::Float);
        }
    }
    if sums.is_empty() {
        *sums = grads;
        return Ok(());
    }
    for (sum, grad) in sums.iter_mut().zip(grads) {
        match (sum.defined(), grad.defined()) {
            (true, true) => *sum = &*sum + grad,
            (false, true) => *sum = grad,
            _ => {}
        }
    }
    Ok(())
}
