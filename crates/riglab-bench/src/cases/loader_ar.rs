//! Samples for UniRig's skeleton model, against numpy and trimesh: augment, set into the cube, draw 65,536
//! points with normals, tokenise.
//!
//! Both sides keep the assets they have read and make a sample of each in as many workers. Ours are the
//! threads that training waits for, with the batches it gets; theirs are processes of a pool, each of
//! which has read all assets before the clock runs, and what they make stays in them, so the way back is
//! not charged. The points that the encoder picks are left out: the public code picks them on the GPU.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, anyhow, ensure};
use riglab_augment::Recipe;
use riglab_geom::CloudConfig;
use riglab_nn::perceiver::PerceiverConfig;
use riglab_task::unirig_skeleton::{Batch, SkeletonTask, SkeletonTaskConfig};
use riglab_token::Limits;
use riglab_train::{Prefetch, Source};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tch::Device;

use super::Context;
use crate::python::SAMPLES;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const NAME: &str = "loader/ar";
/// How far the mean lengths of sequences may be apart, as a share: draws differ.
const ALIKE: f64 = 0.1;

#[derive(Deserialize, Serialize)]
struct Made {
    seconds: f64,
    tokens: usize,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped(NAME, recipe::NO_RIGS)]) };
    let workers = context.threads;
    let (mut ours, mut theirs) = (context.ours("loader_ar")?, SAMPLES.start("loader_ar.py")?);
    let count: usize = ours.ask(&json!({"do": "load", "corpus": corpus, "workers": workers}))?;
    let assets = theirs.ask::<usize>(&json!({"do": "load", "path": corpus, "workers": workers}))?;
    ensure!(assets >= count, "{assets} assets against {count}");
    let all: Vec<usize> = (0..assets).collect();
    let mut number = 0;
    let mut mine = || -> Result<Made> {
        number += 1;
        ours.ask(&json!({"do": "run", "pass": number}))
    };
    let mut other = || -> Result<Made> {
        let answer: Value = theirs.ask(&json!({"do": "run", "assets": all, "seed": 1}))?;
        ensure!(answer["faults"].as_array().is_some_and(Vec::is_empty), "faults: {}", answer["faults"]);
        Ok(serde_json::from_value(answer)?)
    };
    // The first pass reads on our side; on the other, loading has.
    let (a, b) = (mine()?, other()?);
    let (a, b) = (a.tokens as f64 / count as f64, b.tokens as f64 / assets as f64);
    ensure!((a / b - 1.0).abs() < ALIKE, "sequences of {a:.1} and {b:.1} tokens on average");
    let found =
        in_turn(context.rounds(5), || Ok(count as f64 / mine()?.seconds), || Ok(assets as f64 / other()?.seconds))?;
    let (x, y) = found.medians();
    let note = format!(
        "{count} rigs, 65,536 points, {workers} workers on both sides, assets kept in memory, sequences of {a:.0} and {b:.0} \
         tokens; {}",
        found.spread()
    );
    Ok(vec![Row::new(NAME, x, y, "samples/s", Better::Higher).bar(20.0).note(note)])
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { corpus: PathBuf, workers: usize },
    Run { pass: u64 },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut loaded = None;
    side::serve(|request| match request {
        Request::Load { corpus, workers } => {
            let task = SkeletonTask::new(config(&corpus), Device::Cpu).map_err(|e| anyhow!(e))?;
            let source = task.batches();
            let count = source.epoch_batches();
            loaded = Some((source, count, workers));
            Ok(json!(count))
        }
        Request::Run { pass } => {
            let (source, count, workers) = loaded.as_ref().ok_or_else(|| anyhow!("no corpus yet"))?;
            let start = Instant::now();
            let mut batches =
                Prefetch::new(source.clone() as std::sync::Arc<dyn Source<Batch = Batch>>, pass * count, *workers);
            let mut tokens = 0;
            for _ in 0..*count {
                tokens += batches.take().map_err(|e| anyhow!(e))?.ids.len();
            }
            Ok(json!(Made { seconds: start.elapsed().as_secs_f64(), tokens }))
        }
    })
}

/// UniRig's recipe, a rig a batch, without a network to speak of.
fn config(corpus: &Path) -> SkeletonTaskConfig {
    let mut c = SkeletonTaskConfig::default();
    c.data.corpora = vec![corpus.into()];
    c.data.train = ["train", "val", "test_seen", "test_new"].map(String::from).to_vec();
    c.limits = Limits { joints: 1024, tokens: 8192 };
    c.sampling.rigs = 1;
    c.sampling.cloud = CloudConfig::unirig_ar_training();
    c.augment = Recipe::unirig_ar();
    c.model.shape =
        PerceiverConfig { tokens: 1, drawn: 1, width: 8, heads: 1, layers: 0, ..PerceiverConfig::default() };
    (c.model.decoder.width, c.model.decoder.heads, c.model.decoder.layers) = (8, 1, 0);
    c.model.decoder.positions = 8193;
    c
}
