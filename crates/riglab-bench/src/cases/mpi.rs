//! What sharing a step costs: TokenRig trained by two processes of one thread each, against one process of two threads.
//!
//! Both sides are the program as a user starts it, with the same config, so the same batches, and in the end the same
//! loss. What is compared is the speed that the runs log, loading and start left out.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use super::Context;
use super::rig::program;
use crate::rounds::in_turn;
use crate::row::{Better, Row};

const NAME: &str = "mpi/2ranks";
/// Why it was not measured.
const NO_MPI: &str = "skipped: this riglab was built without MPI; `cargo xtask bench mpi` builds one with it";
const CREATURES: &str = "120";
/// Steps before the first line of speed, and in the second, which counts.
const STEPS: [u64; 2] = [4, 12];

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let program = program()?;
    let told = Command::new(&program).args(["doctor", "--json"]).output()?;
    let told: Value = serde_json::from_slice(&told.stdout).context("riglab doctor said no JSON")?;
    if told["mpi"].is_null() {
        return Ok(vec![Row::skipped(NAME, NO_MPI)]);
    }
    let folder = context.path("mpi");
    std::fs::create_dir_all(&folder)?;
    must(Command::new(&program).current_dir(&folder).args(["synth", "--count", CREATURES, "-o", "creatures.h5"]))?;
    let coder = ["train", "quickstart/demo.toml", "--run", "coder", "--set", "data.corpora=['creatures.h5']"];
    must(Command::new(&program).current_dir(&folder).args(coder).args(["--set", "train.steps=3"]))?;
    let side = Side { program: &program, folder: &folder, runs: Cell::new(0) };
    let ours = || side.speed(&["mpirun", "-n", "2"], "1");
    let rounds = in_turn(context.rounds(3), ours, || side.speed(&[], "2"))?;
    let (ours, theirs) = rounds.medians();
    let note = format!(
        "{} steps of 2 x 6 rigs counted; final weights are {}; {}",
        STEPS[1],
        if side.same()? { "equal bit for bit" } else { "not equal bit for bit (threads add up in another order)" },
        rounds.spread()
    );
    Ok(vec![Row::new(NAME, ours, theirs, "steps/s", Better::Higher).bar(0.9).note(note)])
}

/// Who trains, and where.
struct Side<'a> {
    program: &'a Path,
    folder: &'a Path,
    runs: Cell<usize>,
}

impl Side<'_> {
    fn run(&self, number: usize) -> PathBuf {
        self.folder.join(format!("run-{number}"))
    }

    /// Trains; gives the logged steps a second.
    fn speed(&self, launcher: &[&str], threads: &str) -> Result<f64> {
        self.runs.set(self.runs.get() + 1);
        let run = self.run(self.runs.get());
        let mut words = launcher.iter().map(|w| w.to_string()).chain([self.program.display().to_string()]);
        let mut command = Command::new(words.next().unwrap_or_default());
        command.args(words).current_dir(self.folder).args(["--threads", threads, "train", "quickstart/tokenrig.toml"]);
        // Started as root or with more processes than processors, Open MPI wants to be told that it is meant.
        command.envs([("OMPI_ALLOW_RUN_AS_ROOT", "1"), ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")]);
        command.arg("--run").arg(&run);
        let [before, counted] = STEPS;
        for set in [
            "data.corpora=['creatures.h5']".to_string(),
            "skin.run='coder'".into(),
            "sampling.rigs=6".into(),
            "train.accumulate=2".into(),
            "train.precision='fp32'".into(),
            "train.validate_every=0".into(),
            "train.save_every=0".into(),
            "eval.validation_assets=1".into(),
            format!("train.steps={}", before + counted),
            "train.log_every=1".into(),
        ] {
            command.args(["--set", &set]);
        }
        must(&mut command)?;
        let text = std::fs::read_to_string(run.join("perf.jsonl"))?;
        let mut seconds = 0.0;
        // The last step is followed by a validation.
        for line in text.lines().skip(before as usize).take(counted as usize - 1) {
            let line: Value = serde_json::from_str(line)?;
            seconds += 1.0 / line["perf/steps_per_s"].as_f64().context("perf.jsonl without steps_per_s")?;
        }
        Ok((counted - 1) as f64 / seconds)
    }

    /// Whether the first runs of both sides ended with the same weights.
    fn same(&self) -> Result<bool> {
        let weights = |n| std::fs::read(self.run(n).join("checkpoints/last/model.safetensors"));
        Ok(weights(1)? == weights(2)?)
    }
}

fn must(command: &mut Command) -> Result<()> {
    let out = command.output().with_context(|| format!("{command:?}"))?;
    ensure!(out.status.success(), "{command:?}: {}", String::from_utf8_lossy(&out.stderr));
    Ok(())
}
