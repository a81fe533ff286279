//! `riglab train --dry-run`

use std::process::ExitCode;

use anyhow::Result;
use riglab_report::counted;
use riglab_task::Experiment;
use riglab_train::{Spinner, estimate, product_speed};
use tch::Device;

use super::guard::Guard;
use super::{begin, freeze, known_tests, overlap, trainable};
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
        trainable(&task, self.config, true)?;
        known_tests(self.config.data(), task.assets())?;
        tell!("{}: {:.2} M parameters; trying a few steps", task.name(), task.params().numel() as f64 / 1e6);
        let mut begun = begin(&task, &train.start)?;
        begun.extend(freeze(&task, train)?);
        task.warnings().iter().for_each(|warning| tell!("warning: {warning}"));
        begun.iter().chain(&task.notes()).chain(&overlap(self.config)?).for_each(|note| tell!("note: {note}"));
        let (guard, trying) = (Guard::until(|| false), Spinner::new("trying"));
        let found = estimate(&task, train)?;
        drop((trying, guard));
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
        // Their times differ where the first makes something ready for all.
        let (first, each) = (found.first_validation_seconds, found.validation_seconds);
        let apart =
            if first > 1.2 * each && first - each > 0.1 { format!(", the first {first:.1} s") } else { String::new() };
        say!("a validation        {each:>9.1} s{apart}");
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
pub(super) fn time(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}
