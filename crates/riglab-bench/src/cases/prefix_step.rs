//! A training step of a decoder behind a shape's tokens (UniRig's skeleton model, TokenRig), against the same in
//! PyTorch with transformers' OPT or Qwen3.
//!
//! Both sides start from the same weights, take the same batches in the same order and share the recipe:
//! forward pass, loss, backward pass, clipping, Muon and AdamW, moving average. `step` has sequences of one
//! length, so that nobody pads; `packed` has them as they come, which the other side pads to the longest of
//! the batch, as the public code does. Losses are compared before times are taken, without dropout, and after
//! some steps.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, ensure};
use riglab_task::unirig_skeleton::Batch;
use riglab_train::Precision;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tch::Tensor;

use super::Context;
use super::step::name;
use super::subject::Subject;
use super::training::{Plan, Training, compared};
use crate::python::TRANSFORMERS;
use crate::recipe;
use crate::row::{Better, Row};
use crate::side;

/// Batches that steps go through in turn: about an epoch of the rigs.
const BATCHES: usize = 16;
/// How far losses of equal weights and batches may be apart.
const NEAR: [(Precision, f64); 2] = [(Precision::Fp32, 1e-3), (Precision::Bf16, 5e-2)];
/// How far the losses after some steps may be apart, as a share: what is dropped differs.
const NEAR_AT_END: f64 = 0.05;

/// What is measured.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub enum Kind {
    /// Steps over sequences of one length.
    Even(Precision),
    /// Tokens a second over sequences as they come, in the recipe's precision.
    Mixed,
}

#[derive(Deserialize, Serialize)]
struct Opened {
    losses: Vec<f64>,
    /// Of all batches.
    tokens: usize,
    /// With what the other side pads.
    padded: usize,
    vocabulary: usize,
    rigs: usize,
    settings: Value,
}

pub fn run<S: Subject>(context: &mut Context, kind: Kind) -> Result<Vec<Row>> {
    let (label, precision) = match kind {
        Kind::Even(precision) => (format!("step/{}/{}", S::NAME, name(precision)), precision),
        Kind::Mixed => (format!("packed/{}", S::NAME), recipe::skeleton_precision()?.resolved()),
    };
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped(label, recipe::NO_RIGS)]) };
    let file = context.path(&format!("{}.safetensors", label.replace('/', "-")));
    let mut ours = context.ours(S::SIDES[0])?;
    let open = json!({"do": "open", "file": file, "corpus": corpus, "precision": precision, "kind": kind,
                      "threads": context.threads});
    let a: Opened = ours.ask(&open)?;
    let open = |fused: bool| {
        json!({"do": "open", "model": S::NAME, "file": file, "config": a.settings, "precision": name(precision),
               "threads": context.threads, "fused": fused, "vocabulary": a.vocabulary})
    };
    // What only has to be known once is found out by a process whose memory does not count.
    let mut probe = TRANSFORMERS.start("unirig_step.py")?;
    let b: Vec<f64> = probe.ask(&open(true))?;
    let near = NEAR.iter().find(|(p, _)| *p == precision).map_or(0.0, |(_, near)| *near);
    let apart = a.losses.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!("  losses of {} batches: {:.4?} and {:.4?}; {apart:.1e} apart", b.len(), &a.losses[..2], &b[..2]);
    ensure!(a.losses.len() == b.len() && apart <= near, "the two networks differ: losses {:?} and {b:?}", a.losses);
    let fused: bool = probe.ask(&json!({"do": "fused_is_faster"}))?;
    drop(probe);
    let mut theirs = TRANSFORMERS.start("unirig_step.py")?;
    let _: Vec<f64> = theirs.ask(&open(fused))?;
    let plan = Plan { batches: BATCHES, rounds: context.rounds(5), compared: 2 };
    let (found, memory) = compared(&label, &mut ours, &mut theirs, plan, NEAR_AT_END)?;
    let ([la, lb], steps) = (found.compared, plan.steps_compared());
    let Opened { tokens, padded, rigs, .. } = a;
    let note = format!(
        "{}{} threads, {rigs} rigs a batch, {} tokens, {} with padding; loss {apart:.0e} apart at the start, {la:.4} and \
         {lb:.4} after {steps} steps; theirs takes {} for attention, the faster one; ms a step: {}",
        if matches!(kind, Kind::Mixed) { format!("{}, ", name(precision)) } else { String::new() },
        context.threads,
        tokens / BATCHES,
        padded / BATCHES,
        if fused { "the fused kernel" } else { "plain products" },
        found.wall.spread()
    );
    let (x, y) = found.wall.medians();
    let (cpu_x, cpu_y) = found.cpu.medians();
    let cpu = |unit, x, y, better| {
        Row::new(format!("{label}/cpu"), x, y, unit, better)
            .note("by the processor time of all threads: tells more than the clock where the machine is shared")
    };
    Ok(match kind {
        Kind::Even(_) => vec![
            Row::new(&label, x, y, "ms/step", Better::Lower).bar(1.0).note(note),
            cpu("ms/step", cpu_x, cpu_y, Better::Lower),
            memory,
        ],
        Kind::Mixed => {
            let rate = |milliseconds: f64| 1e3 * tokens as f64 / BATCHES as f64 / milliseconds;
            vec![
                Row::new(&label, rate(x), rate(y), "tokens/s", Better::Higher).bar(1.8).note(note),
                cpu("tokens/s", rate(cpu_x), rate(cpu_y), Better::Higher),
                memory,
            ]
        }
    })
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { file: PathBuf, corpus: PathBuf, precision: Precision, kind: Kind, threads: usize },
    Run { steps: usize },
    Memory,
}

/// riglab's side.
pub fn serve<S: Subject>() -> Result<()> {
    let mut training: Option<Training<S>> = None;
    side::serve(|request| match (request, &mut training) {
        (Request::Open { file, corpus, precision, kind, threads }, training) => {
            riglab_torch::init(riglab_torch::Settings { threads });
            let made = training.insert(self::training(&corpus, precision, kind)?);
            dump(made, &file)?;
            Ok(json!(opened(made)?))
        }
        (Request::Run { steps }, Some(training)) => training.run(steps),
        (Request::Memory, _) => Ok(json!(side::peak_memory_mb())),
        (Request::Run { .. }, None) => Err(anyhow!("open first")),
    })
}

fn training<S: Subject>(corpus: &Path, precision: Precision, kind: Kind) -> Result<Training<S>> {
    let task = S::open(corpus, precision, None)?;
    let source = task.source();
    let batch = |n: usize| source.batch(n as u64).map_err(|e| anyhow!(e));
    let batches = match kind {
        Kind::Mixed => (0..BATCHES).map(batch).collect::<Result<_>>()?,
        Kind::Even(_) => {
            let mut even = Even { rigs: task.rigs(), length: S::EVEN, full: Vec::new(), next: Batch::default() };
            let mut number = 0;
            while even.full.len() < BATCHES {
                even.add(S::shapes(&batch(number)?));
                number += 1;
                ensure!(number < 100 * BATCHES, "too few sequences of {} tokens", S::EVEN);
            }
            even.full.truncate(BATCHES);
            even.full.into_iter().map(S::batch).collect()
        }
    };
    let train = task.train().clone();
    Ok(Training::new(task, train, batches))
}

/// Batches of sequences cut to so many tokens, from those that are so long.
struct Even {
    rigs: usize,
    length: usize,
    full: Vec<Batch>,
    next: Batch,
}

impl Even {
    fn add(&mut self, from: &Batch) {
        let (cloud, picks) = (from.cloud.len() / from.rigs, from.picks.len() / from.rigs);
        let mut start = 0;
        for (rig, &length) in from.lengths.iter().enumerate() {
            if length as usize >= self.length {
                let next = &mut self.next;
                next.rigs += 1;
                next.cloud.extend(&from.cloud[rig * cloud..(rig + 1) * cloud]);
                next.picks.extend(&from.picks[rig * picks..(rig + 1) * picks]);
                next.ids.extend(&from.ids[start..start + self.length]);
                next.lengths.push(self.length as i64);
            }
            if self.next.rigs == self.rigs {
                self.full.push(std::mem::take(&mut self.next));
            }
            start += length as usize;
        }
    }
}

/// Weights and batches for the other side.
fn dump<S: Subject>(training: &Training<S>, file: &Path) -> Result<()> {
    let mut tensors = training.weights();
    for (n, b) in training.batches.iter().map(S::shapes).enumerate() {
        let rigs = b.rigs as i64;
        let each = [
            ("cloud", Tensor::from_slice(&b.cloud).view([rigs, -1, 6])),
            ("picks", Tensor::from_slice(&b.picks).view([rigs, -1])),
            ("ids", Tensor::from_slice(&b.ids)),
            ("lengths", Tensor::from_slice(&b.lengths)),
        ];
        tensors.extend(each.into_iter().map(|(name, t)| (format!("{n}/{name}"), t)));
    }
    riglab_nn::io::write(file, tensors.iter().map(|(n, t)| (n.as_str(), t)))?;
    Ok(())
}

fn opened<S: Subject>(training: &Training<S>) -> Result<Value> {
    let task = &training.task;
    let losses = training.each(|w, b, at| task.first_loss(w, b, at))?;
    let shapes = || training.batches.iter().map(S::shapes);
    let padded = |b: &Batch| b.rigs * b.lengths.iter().max().map_or(0, |n| *n as usize);
    Ok(json!(Opened {
        losses,
        tokens: shapes().map(|b| b.ids.len()).sum(),
        padded: shapes().map(padded).sum(),
        vocabulary: task.vocabulary(),
        rigs: task.rigs(),
        settings: task.settings(),
    }))
}
