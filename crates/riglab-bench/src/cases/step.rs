//! A training step, against the same network in PyTorch.
//!
//! Both sides start from the same weights, take the same batches in the same order and share the
//! recipe: forward pass, loss, backward pass, clipping, Muon and AdamW, moving average. Before times
//! are taken, the losses of all batches are compared; since both train on in lockstep, so are those
//! of the last steps.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, ensure};
use riglab_task::fsq_cvae::FsqCvaeTask;
use riglab_train::{Precision, Source, Task};
use serde::Deserialize;
use serde_json::{Value, json};
use tch::{Device, Kind, Tensor};

use super::Context;
use super::training::{Plan, Training, lockstep};
use crate::python::TORCH;
use crate::recipe;
use crate::row::{Better, Row};
use crate::side::{self, PATIENCE, Side};

/// Batches that steps go through in turn; their prefix lengths differ.
const BATCHES: usize = 8;
/// Timed passes after which losses are compared. Later the few batches are known by heart and rounding
/// has grown: either side with one thread is 3 to 5 % from itself with two after 88 steps (ours 1.93
/// and 1.84, theirs 1.66 and 1.61), while after 40 all four lie within 1 %.
const COMPARED: usize = 3;
/// How far losses of equal weights and batches may be apart.
const NEAR: [(Precision, f64); 2] = [(Precision::Fp32, 1e-3), (Precision::Bf16, 5e-2)];
/// How far the losses of that pass may be apart, as a share: rounding to codes turns the least
/// difference into another path.
const NEAR_AT_END: f64 = 0.03;
/// What `torch.compile` may take for its first passes.
const COMPILE_LIMIT: Duration = Duration::from_secs(900);

/// What was measured in one precision.
#[derive(Clone)]
pub struct Times {
    /// Milliseconds a step.
    pub ours: f64,
    /// Milliseconds a step.
    pub theirs: f64,
    /// Floating point operations of matrix products in a step.
    pub flops: f64,
    /// The fastest matrix products of this machine, operations a second.
    pub peak: f64,
    rows: Vec<Row>,
}

/// What rows call a precision.
pub fn name(precision: Precision) -> &'static str {
    match precision {
        Precision::Fp32 => "fp32",
        Precision::Bf16 => "bf16",
        Precision::Auto => "auto",
    }
}

pub fn run(context: &mut Context, precision: Precision) -> Result<Vec<Row>> {
    match measured(context, precision)? {
        Some(times) => Ok(times.rows),
        None => Ok(vec![Row::skipped(format!("step/fsq_cvae/{}", name(precision)), recipe::NO_RIGS)]),
    }
}

/// Measures, or gives what was measured before; `None` without rigs.
pub fn measured(context: &mut Context, precision: Precision) -> Result<Option<Times>> {
    if let Some((_, times)) = context.steps.iter().find(|(p, _)| *p == precision) {
        return Ok(Some(times.clone()));
    }
    let Some(corpus) = context.corpus()? else { return Ok(None) };
    let times = measure(context, &corpus, precision)?;
    context.steps.push((precision, times.clone()));
    Ok(Some(times))
}

fn measure(context: &Context, corpus: &Path, precision: Precision) -> Result<Times> {
    let label = format!("step/fsq_cvae/{}", name(precision));
    let file = context.path(&format!("{}.safetensors", name(precision)));
    let config = recipe::config(corpus, precision)?;
    let open_theirs = |fused: bool, compile: Option<&Path>| {
        json!({"do": "open", "file": file, "config": config, "precision": name(precision),
               "threads": context.threads, "fused": fused, "compile": compile})
    };
    let mut ours = context.ours("step")?;
    let a: Vec<f64> = ours.ask(&json!({"do": "open", "file": file, "corpus": corpus, "precision": precision,
                                       "threads": context.threads}))?;
    // What only has to be known once is found out by a process whose memory does not count.
    let mut probe = TORCH.start("step.py")?;
    let b: Vec<f64> = probe.ask(&open_theirs(true, None))?;
    let near = NEAR.iter().find(|(p, _)| *p == precision).map_or(0.0, |(_, near)| *near);
    let apart = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!("  losses of {} batches: {} and {}; {apart:.1e} apart", a.len(), shown(&a), shown(&b));
    ensure!(a.len() == b.len() && apart <= near, "the two networks differ: losses {a:?} and {b:?}");
    let fused: bool = probe.ask(&json!({"do": "fused_is_faster"}))?;
    let flops: f64 = probe.ask(&json!({"do": "flops"}))?;
    drop(probe);

    let mut theirs = TORCH.start("step.py")?;
    let _: Vec<f64> = theirs.ask(&open_theirs(fused, None))?;
    let plan = |rounds| Plan { batches: BATCHES, rounds: context.rounds(rounds), compared: COMPARED };
    let found = lockstep(&mut ours, &mut theirs, plan(9), PATIENCE)?;
    let [la, lb] = found.compared;
    let steps = plan(9).steps_compared();
    eprintln!("  mean loss of {BATCHES} steps, after {steps}: {la:.4} and {lb:.4}");
    ensure!((la / lb - 1.0).abs() <= NEAR_AT_END, "the two trainings drift apart: {la} and {lb} after {steps} steps");
    let (milliseconds, reference) = found.wall.medians();
    let memory = json!({"do": "memory"});
    let memory = Row::new(format!("{label}/memory"), ours.ask(&memory)?, theirs.ask(&memory)?, "MB", Better::Lower);
    drop(theirs);
    let attention = if fused { "the fused kernel" } else { "plain products" };
    let note = format!(
        "{} threads, loss {apart:.0e} apart at the start, {la:.4} and {lb:.4} after {steps} steps; theirs takes \
         {attention} for attention, the faster one; {}",
        context.threads,
        found.wall.spread()
    );
    let (a, b) = found.cpu.medians();
    let mut rows = vec![
        Row::new(&label, milliseconds, reference, "ms/step", Better::Lower).bar(1.0).note(note),
        Row::new(format!("{label}/cpu"), a, b, "ms/step", Better::Lower)
            .note("processor time of all threads: tells more than the clock where the machine is shared"),
        memory.bar(1.0).note("peak of the whole process"),
    ];
    if context.compile {
        let made = context.path(&format!("compiled-{}", name(precision)));
        rows.push(compiled(context, &format!("{label}/compile"), &mut ours, &open_theirs(fused, Some(&made))));
    }
    let peak = ours.ask(&json!({"do": "peak", "precision": precision}))?;
    Ok(Times { ours: milliseconds, theirs: reference, flops, peak, rows })
}

/// Against `torch.compile`, which needs a compiler and patience.
fn compiled(context: &Context, label: &str, ours: &mut Side, open: &Value) -> Row {
    let mut measure = || -> Result<Row> {
        let mut theirs = TORCH.start("step.py")?;
        let _: Vec<f64> = theirs.ask(open)?;
        let start = Instant::now();
        let plan = Plan { batches: BATCHES, rounds: context.rounds(5), compared: COMPARED };
        let found = lockstep(ours, &mut theirs, plan, COMPILE_LIMIT).context("torch.compile")?;
        let (a, b) = found.wall.medians();
        let busy = start.elapsed().saturating_sub(found.rested).as_secs_f64();
        let compiling = (busy - 1e-3 * (a + b) * found.steps as f64).max(0.0);
        let note =
            format!("the network in torch.compile, about {compiling:.0} s of compiling; {}", found.wall.spread());
        Ok(Row::new(label, a, b, "ms/step", Better::Lower).note(note))
    };
    measure().unwrap_or_else(|e| {
        let text = format!("{e:#}");
        let line = text.lines().next().unwrap_or_default();
        eprintln!("  {label} skipped: {text}");
        Row::skipped(label, format!("skipped: {line}"))
    })
}

fn shown(values: &[f64]) -> String {
    let some: Vec<String> = values.iter().take(3).map(|v| format!("{v:.5}")).collect();
    some.join(" ") + " .."
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { file: PathBuf, corpus: PathBuf, precision: Precision, threads: usize },
    Run { steps: usize },
    Memory,
    Peak { precision: Precision },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut training: Option<Training<FsqCvaeTask>> = None;
    side::serve(|request| match (request, &mut training) {
        (Request::Open { file, corpus, precision, threads }, training) => {
            riglab_torch::init(riglab_torch::Settings { threads });
            let made = training.insert(self::training(&corpus, precision)?);
            dump(made, &file)?;
            Ok(json!(losses(made)?))
        }
        (Request::Run { steps }, Some(training)) => training.run(steps),
        (Request::Memory, _) => Ok(json!(side::peak_memory_mb())),
        (Request::Peak { precision }, _) => Ok(json!(peak(precision))),
        (Request::Run { .. }, None) => Err(anyhow!("open first")),
    })
}

/// The task with its batches.
fn training(corpus: &Path, precision: Precision) -> Result<Training<FsqCvaeTask>> {
    let task = FsqCvaeTask::new(recipe::config(corpus, precision)?, Device::Cpu).map_err(|e| anyhow!(e))?;
    let source = task.batches();
    let batches: Result<_, String> = (0..BATCHES as u64).map(|n| source.batch(n)).collect();
    let train = task.config().train.clone();
    Ok(Training::new(task, train, batches.map_err(|e| anyhow!(e))?))
}

/// Weights and batches for the other side.
fn dump(training: &Training<FsqCvaeTask>, file: &Path) -> Result<()> {
    let c = training.task.config();
    let mut tensors = training.weights();
    for (n, b) in training.batches.iter().enumerate() {
        let floats = |v: &[f32], size: &[i64]| Tensor::from_slice(v).view(size);
        let (r, m) = (b.rigs as i64, b.bones as i64);
        let each = [
            ("shape", floats(&b.shape, &[r, -1, 6])),
            ("shape_queries", Tensor::from_slice(&b.shape_queries).view([r, -1])),
            ("skin", floats(&b.skin, &[m, -1, 6])),
            ("skin_weights", floats(&b.skin_weights, &[m, -1])),
            ("skin_queries", Tensor::from_slice(&b.skin_queries).view([m, c.model.skin_tokens as i64])),
            ("points", floats(&b.points, &[m, -1, 6])),
            ("targets", floats(&b.targets, &[m, -1])),
            ("prefix", Tensor::from_slice(&[b.prefix as i64])),
        ];
        tensors.extend(each.into_iter().map(|(name, t)| (format!("{n}/{name}"), t)));
    }
    riglab_nn::io::write(file, tensors.iter().map(|(n, t)| (n.as_str(), t)))?;
    Ok(())
}

/// The loss of each batch under the present weights.
fn losses(training: &Training<FsqCvaeTask>) -> Result<Vec<f64>> {
    training.each(|weights, batch, at| Ok(training.task.loss(weights, batch, at)?.total()))
}

/// Operations a second of large matrix products, the best of several sizes and rounds.
fn peak(precision: Precision) -> f64 {
    let kind = if precision == Precision::Bf16 { Kind::BFloat16 } else { Kind::Float };
    let mut best = 0.0f64;
    for n in [1024i64, 2048] {
        let a = Tensor::rand([n, n], (Kind::Float, Device::Cpu)).to_kind(kind);
        for _ in 0..8 {
            let start = Instant::now();
            let _product = a.matmul(&a);
            best = best.max(2.0 * (n as f64).powi(3) / start.elapsed().as_secs_f64());
        }
    }
    best
}
