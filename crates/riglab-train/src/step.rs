//! A step: what it does to the weights, without what is written of it.

use std::collections::HashMap;
use std::sync::Arc;

use riglab_nn::optim::{Ema, Optimizer, Pace, StepStats};
use riglab_nn::params::{Params, Weights};
use riglab_ranks::Ranks;
use riglab_torch::TorchError;
use tch::{Kind, Tensor};

use crate::beside::Hands;
use crate::config::{Precision, TrainConfig};
use crate::error::TrainError;
use crate::prefetch::Prefetch;
use crate::schedule;
use crate::task::{At, Loss, Task};
use crate::together::{Buckets, Deal, Dealt, folds};

/// Optimizer and moving average of a run. They are the same on every rank.
pub(crate) struct Stepper<'a, T: Task> {
    config: &'a TrainConfig,
    ranks: &'a Ranks,
    deal: Deal,
    /// Threads that compute batches of a step beside this one.
    hands: Hands<T::Batch>,
    /// Where gradients of several ranks meet.
    buckets: Option<Buckets>,
    pub optimizer: Optimizer,
    pub ema: Option<Ema>,
}

/// Names and values for the log.
type Values = Vec<(String, f64)>;

/// What is told of a batch: its loss, and what is logged of it.
type Found = (f64, Values);

/// What a batch gave: the gradients of its share of the loss, and what is told of it.
pub(crate) type Given = (Vec<Tensor>, Found);

/// What came of a step.
pub(crate) struct Stepped {
    /// The loss.
    pub total: f64,
    /// Names and values for the log.
    pub values: Values,
    /// Whether weights were changed: not where something was not finite.
    pub taken: bool,
}

impl<'a, T: Task> Stepper<'a, T> {
    pub fn new(task: &T, config: &'a TrainConfig, ranks: &'a Ranks) -> Result<Self, TrainError> {
        let params = task.params();
        params.freeze(&config.frozen)?;
        let deal = Deal::new(config.accumulate, ranks).map_err(|(key, message)| TrainError::Config { key, message })?;
        let optimizer = Optimizer::new(params, config.optim.clone());
        let ema = (config.ema > 0.0).then(|| Ema::new(params, config.ema));
        let buckets = (ranks.size() > 1).then(|| Buckets::new(params));
        let hands = Hands::of(task, config, ranks);
        Ok(Self { config, ranks, deal, hands, buckets, optimizer, ema })
    }

    /// Batches from a step on, as many ahead as the config says.
    pub fn batches(&self, task: &T, step: u64) -> Prefetch<T::Batch> {
        let source = Arc::new(Dealt { deal: self.deal.clone(), source: task.source() });
        Prefetch::new(source, step * self.deal.each(), self.config.workers)
    }

    /// How many batches are computed at a time.
    pub fn sides(&self) -> usize {
        self.hands.sides()
    }

    /// Sets of gradients that there are at once at most: those of batches that are computed beside each other, and the sums
    /// that wait for theirs.
    pub fn sets(&self) -> usize {
        most_sets(self.deal.each(), self.sides() as u64)
    }

    /// The weights that count: the moving average, where there is one.
    pub fn weights<'b>(&'b self, params: &'b Params) -> &'b Weights {
        self.ema.as_ref().map_or(params.weights(), Ema::weights)
    }

    /// One optimizer step, the one after `step` others.
    pub fn step(&mut self, task: &T, batches: &mut Prefetch<T::Batch>, step: u64) -> Result<Stepped, TrainError> {
        let (config, params) = (self.config, task.params());
        let leaves = match config.precision {
            Precision::Bf16 => Some(params.weights().cast(Kind::BFloat16)),
            // Leaves of this pass alone, of the same memory: their gradients are listened to.
            _ => self.buckets.is_some().then(|| params.weights().cast(Kind::Float)),
        };
        let weights = &leaves.as_ref().unwrap_or(params.weights()).recomputing(config.recompute);
        let share = 1.0 / config.accumulate as f64;
        let (own, ranks) = (self.deal.own(), self.ranks);
        // Sums of gradients that wait for others, and what is told of each batch.
        let (mut sums, mut found): (Vec<Vec<Tensor>>, Vec<Found>) = (Vec::new(), Vec::new());
        let mut micro = own.start;
        while micro < own.end {
            let at = At { seed: config.seed, step, batch: step * config.accumulate + micro, ranks };
            let together = (own.end - micro).min(self.hands.sides() as u64);
            let taken: Result<Vec<_>, String> = (0..together).map(|_| batches.take()).collect();
            let mut taken = taken.map_err(TrainError::Task)?;
            let loss = |batch: &T::Batch| {
                tch::manual_seed(at.generator_seed() as i64);
                task.loss(weights, batch, at)
            };
            match &mut self.buckets {
                Some(buckets) if micro + 1 == own.end => {
                    let (scaled, told) = scaled(share, || loss(&taken.remove(0)))?;
                    sums = vec![buckets.sum(ranks, &scaled, weights, &sums)?];
                    found.push(told);
                }
                _ => {
                    let first = |batch| given(weights, share, || loss(&batch));
                    for (k, given) in (micro..).zip(self.hands.compute(weights, taken, at, share, first)) {
                        let (mut sum, told) = given?;
                        for _ in 0..folds(self.deal.each(), k - own.start) {
                            sum = sums.pop().into_iter().fold(sum, |sum, earlier| add(earlier, sum));
                        }
                        sums.push(sum);
                        found.push(told);
                    }
                }
            }
            micro += together;
        }
        let grads = sums.pop().unwrap_or_default();
        let found: Vec<Found> = ranks.gather(&found)?.concat();
        let total = found.iter().map(|(total, _)| total * share).sum::<f64>();
        let mut values = mean(found.into_iter().map(|(_, values)| values), share);
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

/// See [`Stepper::sets`]; of so many batches a step, as many at a time as there are sides.
fn most_sets(batches: u64, sides: u64) -> usize {
    let (mut waiting, mut most) = (0, 0);
    for k in 0..batches {
        if k % sides == 0 {
            most = most.max(waiting + (batches - k).min(sides) as usize);
        }
        waiting = waiting + 1 - folds(batches, k);
    }
    most
}

/// The share of a batch's loss, and what is told of it.
fn scaled(share: f64, loss: impl FnOnce() -> Result<Loss, String>) -> Result<(Tensor, Found), TrainError> {
    let loss = loss().map_err(TrainError::Task)?;
    let total = loss.total();
    let values = loss.values().map(|(name, value)| (format!("train/{name}"), value));
    let found = (total.double_value(&[]), values.collect::<Values>());
    Ok((if share == 1.0 { total } else { total * share }, found))
}

/// What a batch gives by its loss.
pub(crate) fn given(
    weights: &Weights,
    share: f64,
    loss: impl FnOnce() -> Result<Loss, String>,
) -> Result<Given, TrainError> {
    let (scaled, found) = scaled(share, loss)?;
    Ok((gradients(weights, &scaled, share != 1.0)?, found))
}

/// Of each name the mean over the batches that have it, in the order in which names first come; `share` is one by the
/// number of batches. A batch may leave a part out, or have others before it.
fn mean(all: impl Iterator<Item = Values>, share: f64) -> Values {
    let (mut sums, mut places, mut batches) = (Values::new(), HashMap::new(), 0usize);
    let mut counts = Vec::new();
    for values in all {
        batches += 1;
        for (name, value) in values {
            match places.get(&name) {
                Some(&place) => {
                    let (_, sum): &mut (String, f64) = &mut sums[place];
                    *sum += value * share;
                    counts[place] += 1;
                }
                None => {
                    places.insert(name.clone(), sums.len());
                    sums.push((name, value * share));
                    counts.push(1usize);
                }
            }
        }
    }
    for ((_, sum), count) in sums.iter_mut().zip(counts).filter(|(_, count)| *count != batches) {
        *sum *= batches as f64 / count as f64;
    }
    sums
}

/// Gradients of a loss; in single precision where others are `added` to them: sums of bfloat16 would lose what comes
/// later.
fn gradients(weights: &Weights, loss: &Tensor, added: bool) -> Result<Vec<Tensor>, TrainError> {
    // Of frozen weights there are none, nor of a batch that only those were asked of.
    let inputs: Vec<&Tensor> = weights.tensors().iter().filter(|t| t.requires_grad() && loss.requires_grad()).collect();
    let mut found = match inputs.as_slice() {
        [] => Vec::new(),
        inputs => Tensor::f_run_backward(&[loss], inputs, false, false)
            .map_err(|e| TrainError::Task(TorchError::from(e).to_string()))?,
    }
    .into_iter();
    let of = |t: &Tensor| t.requires_grad().then(|| found.next()).flatten().unwrap_or_else(Tensor::new);
    let mut grads: Vec<Tensor> = weights.tensors().iter().map(of).collect();
    if added {
        for g in grads.iter_mut().filter(|g| g.defined() && g.kind() == Kind::BFloat16) {
            *g = g.to_kind(Kind::Float);
        }
    }
    Ok(grads)
}

/// The sums of two lists.
fn add(earlier: Vec<Tensor>, later: Vec<Tensor>) -> Vec<Tensor> {
    let sum = |(mut a, b): (Tensor, Tensor)| match (a.defined(), b.defined()) {
        (true, true) => a.g_add_(&b),
        (false, true) => b,
        _ => a,
    };
    earlier.into_iter().zip(later).map(sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(values: &[(&str, f64)]) -> Values {
        values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
    }

    #[test]
    fn a_sum_waits_for_each_halving() {
        assert_eq!([1, 2, 4, 16].map(|batches| most_sets(batches, 1)), [1, 2, 3, 5]);
        // Two that are computed at once are one sum before the next two.
        assert_eq!([2, 4, 16].map(|batches| most_sets(batches, 2)), [2, 3, 5]);
        assert_eq!([(3, 2), (5, 3), (4, 4)].map(|(batches, sides)| most_sets(batches, sides)), [3, 4, 4]);
    }

    #[test]
    fn logged_values_of_batches_are_paired_by_name() {
        let all = [batch(&[("loss/bce", 1.0), ("tokens", 10.0)]), batch(&[("tokens", 30.0), ("loss/bce", 2.0)])];
        assert_eq!(mean(all.into_iter(), 0.5), batch(&[("loss/bce", 1.5), ("tokens", 20.0)]));
    }

    #[test]
    fn what_a_batch_leaves_out_is_the_mean_of_the_others() {
        let all = [batch(&[("tokens", 10.0)]), batch(&[("springs", 3.0), ("tokens", 30.0)])];
        assert_eq!(mean(all.into_iter(), 0.5), batch(&[("tokens", 20.0), ("springs", 3.0)]));
        assert_eq!(mean(std::iter::empty(), 1.0), batch(&[]));
    }

    #[test]
    fn the_sum_of_one_order_keeps_its_bits() {
        let (values, share) = ([0.1, 0.2, 0.3], 1.0 / 3.0);
        let sum = values.iter().fold(0.0, |sum, value| sum + value * share);
        assert_eq!(mean(values.iter().map(|v| batch(&[("x", *v)])), share)[0].1.to_bits(), f64::to_bits(sum));
    }
}
