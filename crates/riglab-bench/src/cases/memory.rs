//! What a step of the paper's TokenRig needs: forward and backward pass over a long sequence in bfloat16, blocks
//! computed again in the backward pass on both sides.
//!
//! The other side is Qwen3 as transformers has it, with its gradient checkpointing, behind the shape encoder of the
//! other cases with `torch.utils.checkpoint` around its blocks. Without optimizers, whose states are plain fp32 on both
//! sides and would hide the difference; weights are random, since nothing depends on them. Each number is the peak of a
//! process that did nothing else.

use anyhow::{Result, anyhow, ensure};
use riglab_nn::params::{Builder, Weights};
use riglab_nn::tokenrig::{Layout, NextTokens, Sequences, TokenRig, TokenRigConfig};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tch::{Device, Kind, Tensor};

use super::Context;
use crate::python::TRANSFORMERS;
use crate::recipe;
use crate::row::{Better, Row};
use crate::side::{self, Side};

const LABEL: &str = "memory/tokenrig_paper";
/// Ids of the released skeletons, and levels of the paper's 64,000 codes.
const SKELETON: usize = 267;
const LEVELS: [i64; 6] = [8, 8, 8, 5, 5, 5];
/// Tokens of a sequence: the longest that the paper's training takes.
const TOKENS: i64 = 1536;
/// Points of the shape.
const POINTS: i64 = 16_384;

/// What one process found.
#[derive(Deserialize, Serialize)]
struct Found {
    /// MB before the passes, weights included, and at most.
    before: f64,
    most: f64,
    seconds: f64,
    loss: f64,
    parameters: usize,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let config = recipe::tokenrig_paper()?;
    let ask = |mut side: Side, again: bool| -> Result<Found> {
        let request = json!({"do": "pass", "config": config, "again": again, "threads": context.threads,
            "vocabulary": SKELETON as i64 + LEVELS.iter().product::<i64>() + 1, "tokens": TOKENS, "points": POINTS});
        side.ask(&request)
    };
    let again = ask(context.ours("memory")?, true)?;
    let kept = ask(context.ours("memory")?, false)?;
    // Scored in runs, the sums differ by rounding.
    ensure!((again.loss - kept.loss).abs() < 1e-3 * kept.loss, "losses {} and {}", again.loss, kept.loss);
    let note = |found: &Found| format!("{:.0} MB before the passes, {:.1} s", found.before, found.seconds);
    let about = format!(
        "{} threads, {:.0} M parameters in bfloat16, a sequence of {} tokens behind {} of the shape",
        context.threads,
        again.parameters as f64 / 1e6,
        TOKENS,
        config.shape.tokens
    );
    let own = Row::new(format!("{LABEL}/kept"), again.most, kept.most, "MB", Better::Lower)
        .note(format!("theirs is ours with all activations kept ({}); {about}", note(&kept)));
    let theirs = match TRANSFORMERS.start("memory.py").and_then(|side| ask(side, true)) {
        Ok(theirs) => theirs,
        Err(e) => return Ok(vec![Row::failed(LABEL, format!("{e:#}")), own]),
    };
    ensure!(theirs.parameters == again.parameters, "{} and {} parameters", again.parameters, theirs.parameters);
    let text = format!("{about}; ours: {}; theirs: {}", note(&again), note(&theirs));
    Ok(vec![Row::new(LABEL, again.most, theirs.most, "MB", Better::Lower).bar(1.0).note(text), own])
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Pass { config: Box<TokenRigConfig>, again: bool, threads: usize, tokens: i64, points: i64 },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    side::serve(|Request::Pass { mut config, again, threads, tokens, points }| {
        riglab_torch::init(riglab_torch::Settings { threads });
        if !again {
            config.scored_at_once = 0;
        }
        let mut builder = Builder::default();
        let net = TokenRig::new(builder.root(), &config, &Layout::new(SKELETON, &LEVELS, config.head), 4);
        let params = builder.finish(0, Kind::BFloat16, Device::Cpu)?;
        // Drawing took memory of its own.
        side::forget_peak();
        let (before, start) = (side::peak_memory_mb(), std::time::Instant::now());
        let w = params.weights().recomputing(again);
        let loss = pass(&net, &w, config.shape.tokens as i64, tokens, points)?;
        let seconds = start.elapsed().as_secs_f64();
        let found = Found { before, most: side::peak_memory_mb(), seconds, loss, parameters: params.numel() };
        Ok(serde_json::to_value(found)?)
    })
}

/// Loss and gradients of one sequence, half skeleton and half codes.
fn pass(net: &TokenRig, w: &Weights, picked: i64, tokens: i64, points: i64) -> Result<f64> {
    tch::manual_seed(0);
    let picks = Tensor::arange(picked, (Kind::Int64, Device::Cpu)).unsqueeze(0);
    let cloud = Tensor::rand([1, points, 6], (Kind::Float, Device::Cpu)) * 2.0 - 1.0;
    let half = tokens / 2;
    let ids = |from: i64, to: i64, n: i64| Tensor::randint_low(from, to, [n], (Kind::Int64, Device::Cpu));
    let (first, codes) = (net.layout().skeleton(), net.layout().codes());
    let ids = Tensor::cat(&[ids(0, first, half), ids(first, first + codes, tokens - half)], 0);
    let hidden = net.forward(
        w,
        &net.condition(w, &cloud, &picks),
        &Sequences { ids: &ids, lengths: &[tokens], told: None },
        true,
    );
    let targets = ids.narrow(0, 1, tokens - 1);
    let parts = net.losses(w, &NextTokens { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 });
    let loss = (parts.skeleton + parts.skin) / (tokens - 1) as f64;
    let leaves: Vec<&Tensor> = w.tensors().iter().collect();
    let value = loss.double_value(&[]);
    let _gradients = Tensor::f_run_backward(&[loss], &leaves, false, false).map_err(|e| anyhow!(e))?;
    Ok(value)
}
