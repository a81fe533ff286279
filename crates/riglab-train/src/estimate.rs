//! What a run will take, found by beginning it without writing anything.

use std::time::{Duration, Instant};

use riglab_nn::params::Params;
use riglab_ranks::ALONE;
use serde::Serialize;
use tch::{Device, Kind};

use crate::config::{Precision, TrainConfig};
use crate::error::TrainError;
use crate::step::{Stepped, Stepper};
use crate::task::{At, Task};
use crate::trainer::{peak_memory_mb, status_mb};

/// Steps before any is timed: the first of a size prepare kernels and memory. One where steps take long.
const WARM: u64 = 2;
/// Steps that are timed at least and at most, and how long they take together at least.
const TIMED: std::ops::Range<u64> = 3..100;
const SECONDS: f64 = 12.0;

/// A run's needs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Numbers in the network, frozen ones included.
    pub parameters: usize,
    /// The same by part of the network.
    pub parts: Vec<(String, usize)>,
    /// Megabytes by what they are for; together the most that the process had while it went through steps. The last is
    /// what is left of that: activations, and the batches that are ready.
    pub memory_mb: Vec<(String, f64)>,
    /// The most that the process had, reading the corpus and a validation included: what a run would have.
    pub peak_memory_mb: f64,
    /// Tokens of a step, of tasks that have sequences.
    pub tokens: Option<f64>,
    /// Operations of products of matrices in a step, backward included.
    pub flops: f64,
    /// Seconds of a step, without waiting for batches.
    pub step_seconds: f64,
    /// Share of the time that it waited for them, caches being empty.
    pub waiting: f64,
    /// Seconds of the first validation, which also does what is done once: what it makes ready is kept.
    pub first_validation_seconds: f64,
    /// Seconds of each that follows; of the only one where none does.
    pub validation_seconds: f64,
    /// Seconds of the whole run.
    pub seconds: f64,
    /// Steps that were timed.
    pub timed: u64,
}

/// Goes through a few steps and two validations, or the only one. Nothing is written; the task's weights are changed.
///
/// # Errors
/// What [`crate::train`] would stop at.
pub fn estimate<T: Task>(task: &T, config: &TrainConfig) -> Result<Estimate, TrainError> {
    config.validate().map_err(|(key, message)| TrainError::Config { key, message })?;
    let (before, start_mb) = (peak_memory_mb(), status_mb("VmRSS:"));
    forget_peak();
    let params = task.params();
    let mut stepper = Stepper::new(task, config, &ALONE)?;
    // As the last steps are: parts of a loss that the first ones do without have their weights there.
    let mut step = config.steps.saturating_sub(WARM + 1 + TIMED.end);
    step -= step % task.period().max(1);
    let mut batches = stepper.batches(task, step);
    let (mut warm, begin) = (0, Instant::now());
    while warm == 0 || (warm < WARM && begin.elapsed().as_secs_f64() < SECONDS) {
        stepper.step(task, &mut batches, step)?;
        (step, warm) = (step + 1, warm + 1);
    }
    batches.take_waited();
    let start = Instant::now();
    let (counted, flops) = riglab_torch::count_flops(|| stepper.step(task, &mut batches, step))
        .map_err(|e| TrainError::Task(e.to_string()))?;
    let mut tokens = tokens_of(&counted?, config);
    step += 1;
    // Counting slows a step of many small products; of one that takes this long it is nothing.
    let (mut took, mut waited, mut timed) = (start.elapsed(), batches.take_waited(), 1);
    if took.as_secs_f64() < SECONDS {
        let start = Instant::now();
        (waited, timed) = (Duration::ZERO, 0);
        while timed < TIMED.start || (timed < TIMED.end && start.elapsed().as_secs_f64() < SECONDS) {
            let stepped = stepper.step(task, &mut batches, step)?;
            (step, timed) = (step + 1, timed + 1);
            waited += batches.take_waited();
            tokens = tokens.zip(tokens_of(&stepped, config)).map(|(mean, own)| mean + (own - mean) / timed as f64);
        }
        took = start.elapsed();
    }
    drop(batches);
    let memory_mb = memory(params, config, &stepper, start_mb, peak_memory_mb());
    let step_seconds = took.saturating_sub(waited).as_secs_f64() / timed as f64;
    // The last step is validated in any case.
    let validations = if config.validate_every == 0 { 1 } else { config.steps.div_ceil(config.validate_every) };
    let validate = || {
        let start = Instant::now();
        let _no_grad = tch::no_grad_guard();
        let at = At { seed: config.seed, step, batch: step * config.accumulate, ranks: &ALONE };
        task.validate(stepper.weights(params), at).map_err(TrainError::Task)?;
        Ok::<_, TrainError>(start.elapsed().as_secs_f64())
    };
    let first_validation_seconds = validate()?;
    let validation_seconds = if validations > 1 { validate()? } else { first_validation_seconds };
    let validating = first_validation_seconds + (validations - 1) as f64 * validation_seconds;
    let seconds = config.steps as f64 * step_seconds + validating;
    Ok(Estimate {
        parameters: params.numel(),
        parts: parts(params),
        memory_mb,
        peak_memory_mb: before.max(peak_memory_mb()),
        tokens,
        flops: flops as f64,
        step_seconds,
        waiting: waited.as_secs_f64() / took.as_secs_f64().max(1e-9),
        first_validation_seconds,
        validation_seconds,
        seconds,
        timed,
    })
}

/// Parameters by the first part of their names, in order.
fn parts(params: &Params) -> Vec<(String, usize)> {
    let mut parts: Vec<(String, usize)> = Vec::new();
    for (name, tensor) in params.named(params.weights()) {
        let part = name.split('.').next().unwrap_or_default();
        match parts.iter_mut().find(|(known, _)| known == part) {
            Some((_, count)) => *count += tensor.numel(),
            None => parts.push((part.into(), tensor.numel())),
        }
    }
    parts
}

/// Tokens of a step: tasks note the mean over its batches.
fn tokens_of(step: &Stepped, config: &TrainConfig) -> Option<f64> {
    let mean = step.values.iter().find(|(name, _)| name == "train/tokens")?.1;
    Some(mean * config.accumulate as f64)
}

/// What `most` MB of steps were, of which `start` were there before them, the weights included.
fn memory<T: Task>(
    params: &Params,
    config: &TrainConfig,
    stepper: &Stepper<'_, T>,
    start: f64,
    most: f64,
) -> Vec<(String, f64)> {
    let mb = |bytes: usize| bytes as f64 / 1e6;
    let all = params.numel();
    // What is frozen (`train.frozen`) gets no gradient.
    let learnt = params.ids().filter(|&id| params.learns(id)).map(|id| params.weights()[id].numel()).sum::<usize>();
    let half = config.precision == Precision::Bf16;
    let state = stepper.optimizer.state(params);
    let kept: usize = state.values().map(|t| t.numel() * t.kind().elt_size_in_bytes()).sum();
    let mut memory = vec![("weights".to_string(), mb(4 * all))];
    if half {
        memory.push(("weights in bfloat16".into(), mb(2 * all)));
    }
    // Those of bfloat16 weights come as such, and are widened one by one.
    let sets = stepper.sets();
    memory.push(("gradients".into(), mb(sets * if half && config.accumulate == 1 { 2 } else { 4 } * learnt)));
    memory.push(("optimizer".into(), mb(kept)));
    if stepper.ema.is_some() {
        memory.push(("moving average".into(), mb(4 * all)));
    }
    memory.insert(0, ("program and data".into(), (start - mb(4 * all)).max(0.0)));
    let known: f64 = memory.iter().map(|(_, mb)| mb).sum();
    memory.push(("activations, batches".into(), (most - known).max(0.0)));
    memory
}

/// Operations a second of a large product of matrices on a device, in single precision or bfloat16: what steps can be held
/// against.
pub fn product_speed(precision: Precision, device: Device) -> f64 {
    let kind = if precision == Precision::Bf16 { Kind::BFloat16 } else { Kind::Float };
    let n = if device == Device::Cpu { 1536i64 } else { 8192 };
    let a = tch::Tensor::ones([n, n], (kind, device));
    let ready = || {
        if let Device::Cuda(number) = device {
            tch::Cuda::synchronize(number as i64);
        }
    };
    ready();
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        let _ = a.matmul(&a);
        ready();
        least = least.min(start.elapsed().as_secs_f64());
    }
    2.0 * (n as f64).powi(3) / least
}

/// Lets the peak of memory begin anew, where the system can.
fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
