//! A training step of UniRig's skin stage, against the same network in PyTorch.
//!
//! Both sides start from the same weights, take the same batches in the same order and share the recipe: forward pass,
//! divergence with frozen bones and attributes, backward pass, clipping, Muon and AdamW, moving average. Without the
//! simulation: what it costs is riglab's own. Losses are compared before times are taken, and after some steps.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, ensure};
use riglab_task::unirig_skin::{Batch, RigBatch, SkinTask, SkinTaskConfig};
use riglab_train::Task;
use serde::Deserialize;
use serde_json::json;
use tch::{Device, Tensor};

use super::Context;
use super::training::{Plan, Training, compared};
use crate::python::TRANSFORMERS;
use crate::recipe;
use crate::row::{Better, Row};
use crate::side;

const LABEL: &str = "step/unirig_skin/fp32";
/// Batches that steps go through in turn.
const BATCHES: usize = 8;
/// How far losses of equal weights and batches may be apart.
const NEAR: f64 = 1e-3;
/// How far the losses after some steps may be apart, as a share: rounding grows with steps.
const NEAR_AT_END: f64 = 0.03;

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(corpus) = context.corpus()? else {
        return Ok(vec![Row::skipped(LABEL.to_string(), recipe::NO_RIGS)]);
    };
    let file = context.path("step-unirig_skin.safetensors");
    let mut ours = context.ours("skin_step")?;
    let open = json!({"do": "open", "file": file, "corpus": corpus, "threads": context.threads});
    let a: Vec<f64> = ours.ask(&open)?;
    let config = recipe::unirig_skin(&corpus)?;
    let open =
        |fused: bool| json!({"do": "open", "file": file, "config": config, "threads": context.threads, "fused": fused});
    // What only has to be known once is found out by a process whose memory does not count.
    let mut probe = TRANSFORMERS.start("skin_step.py")?;
    let b: Vec<f64> = probe.ask(&open(true))?;
    let apart = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!("  losses of {} batches: {:.4?} and {:.4?}; {apart:.1e} apart", b.len(), &a[..2], &b[..2]);
    ensure!(a.len() == b.len() && apart <= NEAR, "the two networks differ: losses {a:?} and {b:?}");
    let fused: bool = probe.ask(&json!({"do": "fused_is_faster"}))?;
    drop(probe);
    let mut theirs = TRANSFORMERS.start("skin_step.py")?;
    let _: Vec<f64> = theirs.ask(&open(fused))?;
    let plan = Plan { batches: BATCHES, rounds: context.rounds(5), compared: 2 };
    let (found, memory) = compared(LABEL, &mut ours, &mut theirs, plan, NEAR_AT_END)?;
    let ([la, lb], steps) = (found.compared, plan.steps_compared());
    let note = format!(
        "{} threads, {} rigs a batch, without the simulation of springs; loss {apart:.0e} apart at the start, {la:.4} and \
         {lb:.4} after {steps} steps; theirs takes {} for attention, the faster one; ms a step: {}",
        context.threads,
        config.sampling.rigs,
        if fused { "the fused kernel" } else { "plain products" },
        found.wall.spread()
    );
    let (x, y) = found.wall.medians();
    let (cpu_x, cpu_y) = found.cpu.medians();
    Ok(vec![
        Row::new(LABEL, x, y, "ms/step", Better::Lower).bar(1.0).note(note),
        Row::new(format!("{LABEL}/cpu"), cpu_x, cpu_y, "ms/step", Better::Lower)
            .note("by the processor time of all threads: tells more than the clock where the machine is shared"),
        memory,
    ])
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { file: PathBuf, corpus: PathBuf, threads: usize },
    Run { steps: usize },
    Memory,
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut training: Option<Training<SkinTask>> = None;
    side::serve(|request| match (request, &mut training) {
        (Request::Open { file, corpus, threads }, training) => {
            riglab_torch::init(riglab_torch::Settings { threads });
            let made = training.insert(open(recipe::unirig_skin(&corpus)?)?);
            dump(made, &file)?;
            Ok(json!(made.each(|w, b, at| Ok(made.task.loss(w, b, at)?.total()))?))
        }
        (Request::Run { steps }, Some(training)) => training.run(steps),
        (Request::Memory, _) => Ok(json!(side::peak_memory_mb())),
        (Request::Run { .. }, None) => Err(anyhow!("open first")),
    })
}

fn open(config: SkinTaskConfig) -> Result<Training<SkinTask>> {
    let train = config.train.clone();
    let task = SkinTask::new(config, Device::Cpu).map_err(|e| anyhow!(e))?;
    let source = task.source();
    let batches: Vec<Batch> =
        (0..BATCHES as u64).map(|n| source.batch(n)).collect::<Result<_, String>>().map_err(|e| anyhow!(e))?;
    Ok(Training::new(task, train, batches))
}

/// Weights and batches for the other side.
fn dump(training: &Training<SkinTask>, file: &Path) -> Result<()> {
    let mut tensors = training.weights();
    for (n, batch) in training.batches.iter().enumerate() {
        for (k, rig) in batch.rigs.iter().enumerate() {
            tensors.extend(parts(rig).into_iter().map(|(name, t)| (format!("{n}/{k}/{name}"), t)));
        }
    }
    riglab_nn::io::write(file, tensors.iter().map(|(n, t)| (n.as_str(), t)))?;
    Ok(())
}

fn parts(rig: &RigBatch) -> Vec<(&'static str, Tensor)> {
    let (j, q) = (rig.count as i64, rig.queries as i64);
    let floats = |values: &[f32], size: &[i64]| Tensor::from_slice(values).view(size);
    let flags = |values: &[bool]| Tensor::from_slice(&values.iter().map(|f| i64::from(*f)).collect::<Vec<_>>());
    let mut parts = vec![
        ("cloud", floats(&rig.cloud, &[1, -1, 6])),
        ("picks", Tensor::from_slice(&rig.picks).unsqueeze(0)),
        ("bones", floats(&rig.bones, &[1, j, -1])),
        ("pairs", floats(&rig.pairs, &[1, q, j, -1])),
        ("truth", floats(&rig.truth, &[q, j])),
        ("swings", floats(&rig.swings, &[j, -1])),
        ("swinging", flags(&rig.swinging)),
    ];
    if !rig.frozen.is_empty() {
        parts.push(("frozen", flags(&rig.frozen)));
    }
    parts
}
