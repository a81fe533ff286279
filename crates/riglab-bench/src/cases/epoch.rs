//! An epoch, against DataLoader and numpy.
//!
//! Ours is `riglab_train::train` as `riglab train` calls it: opening the corpus, preparing rigs,
//! sampling and augmenting in prefetch threads, steps, logs. The other side reads the same corpus
//! through h5py, samples in vectorised numpy in as many worker processes and takes the steps of the
//! twin. The first epoch of a fresh run counts, so preparation is in it; the second, before which
//! every worker has all rigs prepared, is reported beside.
//!
//! Random numbers differ between the sides, so sampling is compared by means over an epoch.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, anyhow, ensure};
use riglab_nn::params::{Params, Weights};
use riglab_ranks::ALONE;
use riglab_task::fsq_cvae::{Batch, FsqCvaeTask, FsqCvaeTaskConfig};
use riglab_train::{At, Better as Objective, Interrupt, Loss, Precision, Run, Source, Task, Validation, train};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tch::Device;

use super::Context;
use crate::python::TORCH;
use crate::recipe;
use crate::rounds::{in_turn, median};
use crate::row::{Better, Row};
use crate::side;

const NAME: &str = "epoch/fsq_cvae";
/// Epochs of each run.
const EPOCHS: u64 = 2;
/// How far means of the sides' batches may be apart, as a share.
const ALIKE: f64 = 0.05;
/// The same for the mean loss of an epoch.
const NEAR: f64 = 0.1;

#[derive(Deserialize, Serialize)]
struct Opened {
    /// Of an epoch.
    steps: u64,
    /// What the recipe's comes to on this machine, for both sides.
    precision: Precision,
}

/// An epoch's batches, made one after the other.
#[derive(Deserialize, Serialize)]
struct Batches {
    milliseconds: f64,
    means: BTreeMap<String, f64>,
}

#[derive(Deserialize, Serialize)]
struct Epoch {
    seconds: f64,
    loss: f64,
    steps: usize,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped(NAME, recipe::NO_RIGS)]) };
    let weights = context.path("epoch.safetensors");
    let (mut ours, mut theirs) = (context.ours("epoch")?, TORCH.start("epoch.py")?);
    let Opened { steps, precision } =
        ours.ask(&json!({"do": "open", "file": weights, "corpus": corpus, "threads": context.threads}))?;
    let config = config(&corpus, steps, precision)?;
    // The fused attention kernel is the faster one in fp32 only; the steps' cases time both.
    let fused = precision == Precision::Fp32;
    let open = json!({"do": "open", "file": weights, "threads": context.threads, "fused": fused});
    theirs.ask::<Value>(&open)?;
    let (mine, other) =
        (json!({"do": "batches", "corpus": corpus}), json!({"do": "batches", "corpus": corpus, "config": config}));
    let (a, b): (Batches, Batches) = (ours.ask(&mine)?, theirs.ask(&other)?);
    same_sampling(&a.means, &b.means)?;
    let loading = in_turn(
        context.rounds(3),
        || Ok(ours.ask::<Batches>(&mine)?.milliseconds),
        || Ok(theirs.ask::<Batches>(&other)?.milliseconds),
    )?;
    let run = context.path("run");
    let mine = json!({"do": "epochs", "corpus": corpus, "run": run, "steps": steps, "precision": precision});
    let other = json!({"do": "epochs", "corpus": corpus, "config": config, "count": EPOCHS});
    let (mut a, mut b): (Vec<Vec<Epoch>>, Vec<Vec<Epoch>>) = Default::default();
    let first = |epochs: Vec<Epoch>, all: &mut Vec<Vec<Epoch>>| {
        let seconds = epochs[0].seconds;
        all.push(epochs);
        seconds
    };
    let found =
        in_turn(context.rounds(3), || Ok(first(ours.ask(&mine)?, &mut a)), || Ok(first(theirs.ask(&other)?, &mut b)))?;
    let (x, y) = found.medians();
    let loss = |all: &[Vec<Epoch>]| median(&all.iter().map(|e| e[0].loss).collect::<Vec<_>>());
    let (la, lb) = (loss(&a), loss(&b));
    eprintln!("  mean loss of the epoch: {la:.4} and {lb:.4}");
    ensure!((la / lb - 1.0).abs() <= NEAR, "the two epochs learn differently: mean loss {la} and {lb}");
    ensure!(a[0][0].steps == b[0][0].steps, "epochs of {} and {} steps", a[0][0].steps, b[0][0].steps);
    let note = format!(
        "{steps} steps in {precision:?}, {} threads and {} workers on both sides, rigs read and prepared on the way, mean loss {la:.3} \
         and {lb:.3}; {}",
        context.threads,
        config.train.workers,
        found.spread()
    );
    let later = |all: &[Vec<Epoch>]| median(&all.iter().map(|e| e[1].seconds).collect::<Vec<_>>());
    let (later_a, later_b) = (later(&a), later(&b));
    let (a, b) = loading.medians();
    Ok(vec![
        Row::new(NAME, x, y, "s/epoch", Better::Lower).bar(2.0).note(note),
        Row::new(format!("{NAME}/second"), later_a, later_b, "s/epoch", Better::Lower)
            .note("the next epoch, all rigs prepared before, on the other side by each of its workers"),
        Row::new(format!("{NAME}/batches"), a, b, "ms/batch", Better::Lower)
            .note(format!("made in one thread, rigs prepared before; {}", loading.spread())),
    ])
}

/// The recipe over a run of a few epochs.
fn config(corpus: &Path, steps: u64, precision: Precision) -> Result<FsqCvaeTaskConfig> {
    let mut config = recipe::config(corpus, precision)?;
    config.train.steps = EPOCHS * steps;
    (config.train.validate_every, config.train.save_every) = (0, 0);
    Ok(config)
}

fn same_sampling(ours: &BTreeMap<String, f64>, theirs: &BTreeMap<String, f64>) -> Result<()> {
    let apart: Vec<String> = ours
        .iter()
        .filter(|(name, x)| theirs.get(*name).is_none_or(|y| (*x / y - 1.0).abs() > ALIKE))
        .map(|(name, x)| format!("{name}: {x} and {:?}", theirs.get(name)))
        .collect();
    eprintln!("  means of batches: {ours:.4?} and {theirs:.4?}");
    ensure!(apart.is_empty(), "the sides draw different batches (means of {})", apart.join(", "));
    Ok(())
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { file: PathBuf, corpus: PathBuf, threads: usize },
    Batches { corpus: PathBuf },
    Epochs { corpus: PathBuf, run: PathBuf, steps: u64, precision: Precision },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    side::serve(|request| match request {
        Request::Open { file, corpus, threads } => {
            riglab_torch::init(riglab_torch::Settings { threads });
            let task = task(&corpus, 1, Precision::Fp32)?;
            let params = task.params();
            let named: Vec<(String, tch::Tensor)> =
                params.named(params.weights()).map(|(n, t)| (format!("w/{n}"), t.detach())).collect();
            riglab_nn::io::write(&file, named.iter().map(|(n, t)| (n.as_str(), t)))?;
            let (steps, precision) = (task.batches().epoch_batches(), recipe::precision()?.resolved());
            Ok(json!(Opened { steps, precision }))
        }
        Request::Batches { corpus } => Ok(json!(batches(&task(&corpus, 1, Precision::Fp32)?)?)),
        Request::Epochs { corpus, run, steps, precision } => Ok(json!(epochs(&corpus, &run, steps, precision)?)),
    })
}

fn task(corpus: &Path, steps: u64, precision: Precision) -> Result<FsqCvaeTask> {
    FsqCvaeTask::new(config(corpus, steps, precision)?, Device::Cpu).map_err(|e| anyhow!(e))
}

/// Means of absolute values over an epoch's batches, and the time to make them once more.
fn batches(task: &FsqCvaeTask) -> Result<Batches> {
    let source = task.batches();
    let count = source.epoch_batches();
    let make = |n| source.batch(n).map_err(|e| anyhow!(e));
    let mut means: BTreeMap<String, f64> = BTreeMap::new();
    for n in 0..count {
        let b = make(n)?;
        let floats = [
            ("shape", &b.shape),
            ("skin", &b.skin),
            ("skin_weights", &b.skin_weights),
            ("points", &b.points),
            ("targets", &b.targets),
        ];
        for (name, values) in floats {
            let mean = values.iter().map(|v| f64::from(v.abs())).sum::<f64>() / values.len() as f64;
            *means.entry(name.into()).or_default() += mean / count as f64;
        }
    }
    let start = Instant::now();
    (count..2 * count).try_for_each(|n| make(n).map(drop))?;
    Ok(Batches { milliseconds: 1e3 * start.elapsed().as_secs_f64() / count as f64, means })
}

fn epochs(corpus: &Path, folder: &Path, steps: u64, precision: Precision) -> Result<Vec<Epoch>> {
    let run = Run::create(folder, "")?;
    let start = Instant::now();
    let timed = Timed { task: task(corpus, steps, precision)?, steps, ends: RefCell::default() };
    train(&timed, &timed.task.config().train, &run, &Interrupt::default(), &ALONE)?;
    let losses = losses(&run.path("metrics.jsonl"))?;
    drop(run);
    std::fs::remove_dir_all(folder)?;
    let ends = timed.ends.into_inner();
    let starts = std::iter::once(start).chain(ends.iter().copied());
    let epochs = starts.zip(&ends).zip(losses.chunks(steps as usize)).map(|((start, end), losses)| Epoch {
        seconds: (*end - start).as_secs_f64(),
        loss: losses.iter().sum::<f64>() / losses.len() as f64,
        steps: losses.len(),
    });
    Ok(epochs.collect())
}

fn losses(metrics: &Path) -> Result<Vec<f64>> {
    let text = std::fs::read_to_string(metrics)?;
    let lines = text.lines().map(serde_json::from_str::<Value>).collect::<Result<Vec<_>, _>>()?;
    Ok(lines.iter().filter_map(|l| l["train/loss"].as_f64()).collect())
}

/// The task, with a look at the clock at the end of each epoch and no validation.
struct Timed {
    task: FsqCvaeTask,
    steps: u64,
    ends: RefCell<Vec<Instant>>,
}

impl Task for Timed {
    type Batch = Batch;

    fn name(&self) -> &'static str {
        self.task.name()
    }

    fn params(&self) -> &Params {
        self.task.params()
    }

    fn source(&self) -> Arc<dyn Source<Batch = Batch>> {
        self.task.source()
    }

    fn loss(&self, weights: &Weights, batch: &Batch, at: At) -> Result<Loss, String> {
        if at.step > 0 && at.step.is_multiple_of(self.steps) {
            self.ends.borrow_mut().push(Instant::now());
        }
        self.task.loss(weights, batch, at)
    }

    /// The loop validates after the last step.
    fn validate(&self, _: &Weights, _: At) -> Result<Validation, String> {
        self.ends.borrow_mut().push(Instant::now());
        Ok(Validation::default())
    }

    fn objective(&self) -> (&'static str, Objective) {
        self.task.objective()
    }
}
