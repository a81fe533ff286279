//! The loop.

use std::time::{Duration, Instant};

use riglab_nn::params::Params;
use riglab_ranks::Ranks;

use crate::Precision;
use crate::checkpoint::{Checkpoint, State, Store};
use crate::config::TrainConfig;
use crate::error::TrainError;
use crate::interrupt::Interrupt;
use crate::logs::Logs;
use crate::prefetch::Prefetch;
use crate::progress::{Progress, tell};
use crate::run::{Run, RunInfo};
use crate::step::{Stepped, Stepper};
use crate::task::{At, Task, Validation};

/// How a run ended without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// All steps are done.
    Finished,
    /// Someone asked it to stop; it can be resumed.
    Interrupted,
}

/// What a run came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// How it ended.
    pub ended: Ended,
    /// Steps done in all.
    pub step: u64,
    /// Step and value of the best validation.
    pub best: Option<(u64, f64)>,
    /// Steps skipped because something was not finite.
    pub skipped: u64,
    /// Seconds of this part of the run.
    pub seconds: f64,
    /// Share of the time spent waiting for batches.
    pub waiting: f64,
}

/// Trains a task in a run folder, from its last checkpoint if it has one, together with the other ranks. The first
/// writes; the others only read its checkpoints, so they must see its folder.
///
/// # Errors
/// See [`TrainError`]. Checkpoints and logs written before an error stay and can be resumed from. Other ranks may wait
/// for this one: whoever gets an error ends them ([`Ranks::end`]).
pub fn train<T: Task>(
    task: &T,
    config: &TrainConfig,
    run: &Run,
    interrupt: &Interrupt,
    ranks: &Ranks,
) -> Result<Outcome, TrainError> {
    config.validate().map_err(|(key, message)| TrainError::Config { key, message })?;
    let mut stepper = Stepper::new(task, config, ranks)?;
    let latest = if ranks.leads() { Checkpoint::latest(run, config)? } else { None };
    let store = if ranks.leads() { Some(Store::new(run.path("checkpoints"), config.ema > 0.0)?) } else { None };
    if let (Some(damage), Some(latest)) = (store.as_ref().and_then(Store::damage), &latest) {
        tell(format_args!("warning: {damage}; going on from step {}", latest.state().step));
    }
    let last = match ranks.told(latest.as_ref().map(|c| c.state().step))? {
        Some(step) if latest.is_none() => Some(Checkpoint::of_step(run, step)?),
        _ => latest,
    };
    let mut state =
        State { task: task.name().into(), step: 0, seed: config.seed, skipped: 0, skipped_in_a_row: 0, best: None };
    if let Some(last) = last {
        last.restore(task.params(), &mut stepper.optimizer, stepper.ema.as_ref())?;
        state = last.state().clone();
        if state.task != task.name() || state.seed != config.seed {
            let message = format!(
                "is of task `{}` with seed {}, not of `{}` with {}",
                state.task,
                state.seed,
                task.name(),
                config.seed
            );
            return Err(TrainError::Checkpoint { path: last.path().into(), message });
        }
        let path = last.path().to_path_buf();
        task.resume(&last.kept()?).map_err(|message| TrainError::Checkpoint { path, message })?;
    }
    let mut writes = None;
    if let Some(store) = store {
        store.link_again(&state)?;
        let mut logs = Logs::open(run, state.step)?;
        if state.step == 0 {
            let text = std::fs::read_to_string(run.path("config.toml")).unwrap_or_default();
            logs.settings(&text, &format!("eval/{}", task.objective().0));
        }
        let before = RunInfo::of(run.dir()).map_or(0.0, |info| info.seconds);
        writes = Some(Writes { store, logs, run, before, start: Instant::now() });
    }
    let mut trainer = Trainer { config, ranks, writes, stepper, state, window: Window::default() };
    trainer.run(task, interrupt)
}

struct Trainer<'a, T: Task> {
    config: &'a TrainConfig,
    ranks: &'a Ranks,
    /// Nothing on ranks that only compute.
    writes: Option<Writes<'a>>,
    stepper: Stepper<'a, T>,
    state: State,
    window: Window,
}

/// What is written of a run.
struct Writes<'a> {
    store: Store,
    logs: Logs,
    run: &'a Run,
    /// Seconds of training before this part of the run, and when that began.
    before: f64,
    start: Instant,
}

/// Times since the last line of `perf.jsonl`.
struct Window {
    start: Instant,
    steps: u64,
}

impl Default for Window {
    fn default() -> Self {
        Self { start: Instant::now(), steps: 0 }
    }
}

impl<T: Task> Trainer<'_, T> {
    fn run(&mut self, task: &T, interrupt: &Interrupt) -> Result<Outcome, TrainError> {
        let (config, start) = (self.config, Instant::now());
        let mut batches = self.stepper.batches(task, self.state.step);
        let mut progress = match self.writes {
            Some(_) if self.state.step < config.steps => Progress::new("training", config.steps, self.state.step),
            // A run that is finished has nothing to tell of.
            _ => Progress::silent(),
        };
        let (mut waited, mut ended) = (Duration::ZERO, Ended::Finished);
        let mut objective: Option<f64> = None;
        while self.state.step < config.steps {
            // How long the others take follows from the first.
            let first = progress.is_new().then(|| progress.during(&format!("step {}", self.state.step + 1)));
            let loss = self.step(task, &mut batches)?;
            drop(first);
            let step = self.state.step;
            let last = step == config.steps;
            if last || (config.validate_every > 0 && step.is_multiple_of(config.validate_every)) {
                objective = self.validate(task, &mut progress)?.filter(|x| x.is_finite()).or(objective);
            }
            // One that is asked to stop stops all, after the same step.
            let asked = self.ranks.gather(&interrupt.raised())?;
            let stop = asked.contains(&true) && !last;
            if last || stop || (config.save_every > 0 && step.is_multiple_of(config.save_every)) || self.best_is_now() {
                self.save(task)?;
            }
            if step.is_multiple_of(config.log_every) || last {
                let pause = batches.take_waited();
                waited += pause;
                self.perf(pause)?;
            }
            progress.set(step, || match objective {
                Some(x) => format!("loss {loss:.4}  {}", task.told(x)),
                None => format!("loss {loss:.4}"),
            });
            if stop {
                ended = Ended::Interrupted;
                break;
            }
        }
        progress.finish();
        if ended == Ended::Finished && self.state.skipped == self.state.step {
            return Err(TrainError::NotFinite(format!(
                "no step was taken: none of {} gave a finite loss and gradient, so the weights are those that it began \
                 with. Lower train.optim.muon_lr and train.optim.adamw_lr{}",
                self.state.step,
                self.in_full()
            )));
        }
        let seconds = start.elapsed().as_secs_f64();
        Ok(Outcome {
            ended,
            step: self.state.step,
            best: self.state.best,
            skipped: self.state.skipped,
            seconds,
            waiting: waited.as_secs_f64() / seconds.max(1e-9),
        })
    }

    /// One optimizer step; gives the loss.
    fn step(&mut self, task: &T, batches: &mut Prefetch<T::Batch>) -> Result<f64, TrainError> {
        let (config, params) = (self.config, task.params());
        let Stepped { total, values, taken } = self.stepper.step(task, batches, self.state.step)?;
        self.state.step += 1;
        if taken {
            self.state.skipped_in_a_row = 0;
        } else {
            self.state.skipped += 1;
            self.state.skipped_in_a_row += 1;
        }
        let step = self.state.step;
        if let Some(Writes { logs, .. }) = &mut self.writes {
            logs.metrics(step, &values)?;
            if step.is_multiple_of(config.log_every) {
                logs.board(|b| values.iter().try_for_each(|(name, value)| b.scalar(name, *value, step)));
            }
        }
        if config.histogram_every > 0 && self.state.step.is_multiple_of(config.histogram_every) {
            self.histograms(params);
        }
        self.window.steps += 1;
        if self.state.skipped_in_a_row > config.patience {
            return Err(self.not_finite(&values));
        }
        Ok(total)
    }

    /// The further remedy of one that computes in fewer bits.
    fn in_full(&self) -> &'static str {
        if self.config.precision == Precision::Fp32 { "" } else { ", or try train.precision = \"fp32\"" }
    }

    fn not_finite(&self, values: &[(String, f64)]) -> TrainError {
        let parts: Vec<&str> = values.iter().filter(|(_, v)| !v.is_finite()).map(|(n, _)| n.as_str()).collect();
        let kept = match self.writes.as_ref().and_then(|w| w.store.latest()) {
            Some(c) => format!("the last checkpoint is {}", c.path().display()),
            None => "no checkpoint was written yet".into(),
        };
        TrainError::NotFinite(format!(
            "stopped at step {}: {} steps in a row gave no finite loss and gradient (not finite now: {}); {kept}. \
             Lower train.optim.muon_lr and train.optim.adamw_lr, lengthen train.schedule.warmup{}",
            self.state.step,
            self.state.skipped_in_a_row,
            parts.join(", "),
            self.in_full()
        ))
    }

    /// Validates the moving average, or the weights without one; gives the objective.
    fn validate(&mut self, task: &T, progress: &mut Progress) -> Result<Option<f64>, TrainError> {
        let step = self.state.step;
        let weights = self.stepper.weights(task.params());
        let at = At { seed: self.config.seed, step, batch: step * self.config.accumulate, ranks: self.ranks };
        let mut found: Validation = {
            let _no_grad = tch::no_grad_guard();
            let _told = progress.during(&format!("validation at step {step}"));
            task.validate(weights, at).map_err(|e| TrainError::Task(format!("validation at step {step}: {e}")))?
        };
        // What follows from it must be the same on machines that differ.
        found.metrics = self.ranks.told(found.metrics)?;
        let values: Vec<(String, f64)> = found.metrics.iter().map(|(n, v)| (format!("eval/{n}"), *v)).collect();
        if let Some(Writes { logs, .. }) = &mut self.writes {
            logs.metrics(step, &values)?;
            logs.board(|b| {
                values.iter().try_for_each(|(name, value)| b.scalar(name, *value, step))?;
                found.pictures.iter().try_for_each(|(tag, w, h, png)| b.picture(tag, *w, *h, png, step))?;
                b.flush()
            });
        }
        found.warnings.iter().for_each(|warning| progress.line(&format!("warning: step {step}: {warning}")));
        let (name, better) = task.objective();
        let value = found.metrics.iter().find(|(n, _)| n == name).map(|(_, v)| *v);
        // A task that names what it does not measure would have no best checkpoint, and nobody would be told.
        if value.is_none() && !found.metrics.is_empty() {
            return Err(TrainError::Task(format!(
                "the validation measures no `{name}`, by which checkpoints are chosen"
            )));
        }
        if let Some(value) = value.filter(|v| v.is_finite()) {
            if self.state.best.is_none_or(|(_, best)| better.than(value, best)) {
                self.state.best = Some((step, value));
            }
            progress.line(&format!("step {step}: {}", task.told(value)));
        }
        Ok(value)
    }

    fn best_is_now(&self) -> bool {
        self.state.best.is_some_and(|(step, _)| step == self.state.step)
    }

    fn save(&mut self, task: &T) -> Result<(), TrainError> {
        let Some(Writes { store, logs, run, before, start }) = &mut self.writes else { return Ok(()) };
        logs.sync()?;
        let (optimizer, ema) = (&self.stepper.optimizer, self.stepper.ema.as_ref());
        store.save(task.params(), optimizer, ema, &self.state, &task.kept(), self.config.keep)?;
        run.note_seconds(*before + start.elapsed().as_secs_f64())
    }

    fn perf(&mut self, waited: Duration) -> Result<(), TrainError> {
        let seconds = self.window.start.elapsed().as_secs_f64();
        let values = [
            ("perf/steps_per_s".to_string(), self.window.steps as f64 / seconds.max(1e-9)),
            ("perf/waiting_share".into(), waited.as_secs_f64() / seconds.max(1e-9)),
            ("perf/peak_memory_mb".into(), peak_memory_mb()),
        ];
        self.window = Window::default();
        let step = self.state.step;
        let Some(Writes { logs, .. }) = &mut self.writes else { return Ok(()) };
        logs.perf(step, &values)?;
        logs.board(|b| {
            values.iter().try_for_each(|(name, value)| b.scalar(name, *value, step))?;
            b.flush()
        });
        Ok(())
    }

    fn histograms(&mut self, params: &Params) {
        let step = self.state.step;
        let Some(Writes { logs, .. }) = &mut self.writes else { return };
        logs.board(|b| {
            for (name, tensor) in params.named(params.weights()) {
                let values = Vec::<f32>::try_from(tensor.detach().flatten(0, -1)).unwrap_or_default();
                b.histogram(&format!("weights/{name}"), &values, step)?;
            }
            Ok(())
        });
    }
}

/// Peak memory of this process so far, in MB.
pub(crate) fn peak_memory_mb() -> f64 {
    status_mb("VmHWM:")
}

/// A line of what the system says of this process's memory, in MB.
pub(crate) fn status_mb(key: &str) -> f64 {
    megabytes(&std::fs::read_to_string("/proc/self/status").unwrap_or_default(), key)
}

/// A line of such a text, in MB of 1e6 bytes: the kernel's "kB" are 1024.
fn megabytes(text: &str, key: &str) -> f64 {
    let line = text.lines().find_map(|l| l.strip_prefix(key));
    line.and_then(|l| l.trim().split(' ').next()?.parse::<f64>().ok()).map_or(f64::NAN, |kib| kib * 1.024 / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_kilobytes_are_1024_bytes() {
        let text = "VmPeak:\t  9 kB\nVmHWM:\t  125000 kB\n";
        assert_eq!(megabytes(text, "VmHWM:"), 128.0);
        assert!(megabytes(text, "VmRSS:").is_nan());
    }
}
