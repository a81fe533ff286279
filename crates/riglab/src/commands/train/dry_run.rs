//! `riglab train --dry-run`

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use riglab_report::counted;
use riglab_task::Experiment;
use riglab_torch::memory_gb;
use riglab_train::{estimate, product_speed};
use tch::Device;

use super::{begin, freeze, known_tests, overlap};
use crate::registry::{TaskConfig, Visitor};

/// A run that is only begun.
pub(super) struct DryRun<'a> {
    pub(super) config: &'a TaskConfig,
    pub(super) threads: usize,
    pub(super) device: Device,
    pub(super) json: bool,
}

impl Visitor for DryRun<'_> {
    type Out = ExitCode;

    fn visit<T: Experiment>(self, task: T) -> Result<ExitCode> {
        let train = self.config.train();
        task.assets().trainable(self.config.data()).map_err(|e| anyhow!(e))?;
        known_tests(self.config.data(), task.assets())?;
        tell!("{}: {:.2} M parameters; trying a few steps", task.name(), task.params().numel() as f64 / 1e6);
        let mut begun = begin(&task, &train.start)?;
        begun.extend(freeze(&task, train)?);
        begun.iter().chain(&task.notes()).chain(&overlap(self.config)?).for_each(|note| tell!("note: {note}"));
        let guard = Guard::new();
        let found = estimate(&task, train)?;
        drop(guard);
        if self.json {
            say!("{}", serde_json::to_string(&found)?);
            return Ok(ExitCode::SUCCESS);
        }
        say!("parameters          {:>12}", found.parameters);
        found.parts.iter().for_each(|(name, count)| say!("  {name:18}{count:>12}"));
        let gpu = self.device != Device::Cpu;
        // What a GPU holds is not seen.
        let where_it_is = if gpu { ", beside the GPU's" } else { "" };
        say!("memory              {:>9.0} MB at the peak{where_it_is}; allow 20 % more", found.peak_memory_mb);
        let in_steps: f64 = found.memory_mb.iter().map(|(_, mb)| mb).sum();
        let rest = ("reading, validation".to_string(), found.peak_memory_mb - in_steps);
        let parts = found.memory_mb.iter().chain(Some(&rest).filter(|(_, mb)| *mb >= 0.5));
        parts.filter(|_| !gpu).for_each(|(name, mb)| say!("  {name:20}{mb:>7.0} MB"));
        let (speed, most) = (found.flops / found.step_seconds, product_speed(train.precision, self.device));
        say!("a step              {:>9.3} s (mean of {})", found.step_seconds, found.timed);
        if let Some(tokens) = found.tokens {
            say!("  tokens            {tokens:>12.0}");
        }
        say!(
            "  matrix products   {:>9.2} GFLOP, {:.0} GFLOP/s: {:.*} % of what large ones reach here{}",
            found.flops / 1e9,
            speed / 1e9,
            usize::from(gpu),
            100.0 * speed / most,
            if gpu { String::new() } else { format!(" with {}", counted(self.threads, "thread")) }
        );
        say!("a validation        {:>9.1} s", found.validation_seconds);
        say!("the run             {:>9} for {} steps", time(found.seconds), train.steps);
        if found.waiting > 0.05 {
            say!(
                "{:.0} % of the time went into waiting for batches, as caches were empty; that is not counted.",
                100.0 * found.waiting
            );
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// Seconds in the unit that suits them.
fn time(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

/// Ends a dry run before it has taken what the machine has left: the system would end it, or another program, without a
/// word.
struct Guard(Arc<AtomicBool>);

/// How often memory is looked at: a batch of a large network takes gigabytes in a second.
const LOOKS: Duration = Duration::from_millis(50);

impl Guard {
    fn new() -> Self {
        let done = Arc::new(AtomicBool::new(false));
        let (seen, begin) = (done.clone(), Instant::now());
        std::thread::spawn(move || {
            while !seen.load(Ordering::Relaxed) {
                if is_short(memory_gb("MemAvailable"), memory_gb("MemTotal")) {
                    tell!("error: {}", too_much(begin.elapsed().as_secs_f64(), memory_gb("MemTotal").unwrap_or(0.0)));
                    riglab_files::leave(1);
                }
                std::thread::sleep(LOOKS);
            }
        });
        Self(done)
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Whether so little of all memory is left, in GB, that programs are about to be ended. Where the system does not say it is
/// not.
fn is_short(left: Option<f64>, all: Option<f64>) -> bool {
    left.zip(all).is_some_and(|(left, all)| left < (0.04 * all).min(1.0))
}

fn too_much(seconds: f64, all: f64) -> String {
    format!(
        "stopped after {}, as next to nothing is left of this machine's {all:.0} GB: the run takes more than is free; make \
         its batches smaller (`sampling`, train.accumulate) or its network, or give it a machine with more memory",
        time(seconds)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_short_before_none_is_left() {
        let of = |left, all| is_short(Some(left), Some(all));
        assert_eq!([of(0.9, 24.0), of(1.1, 24.0), of(0.1, 2.0), of(0.0, 2.0)], [true, false, false, true]);
        assert!(of(0.07, 2.0) && of(0.99, 512.0) && !of(1.0, 512.0));
        assert!(!is_short(None, Some(24.0)) && !is_short(Some(0.0), None));
        assert!(
            too_much(75.0, 24.4).starts_with("stopped after 75 s, as next to nothing is left of this machine's 24 GB")
        );
    }
}
