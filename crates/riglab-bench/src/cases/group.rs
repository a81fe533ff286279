//! Many sequences of one mesh against one: what a group for GRPO, or `riglab rig --samples`, costs.
//!
//! Ours against ours: the mesh is read once and its keys and values serve all rows, rows go through the decoder
//! together, and those that end leave. The other side's column holds so many times one sequence as a group may take.
//! The network is the experiment's own, with a softmax for each level of a code and all that codes are told, and starting
//! weights: no two rows have one skeleton, so that what their codes are told is made for each.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, anyhow, ensure};
use riglab_core::Mesh;
use riglab_data::SplitNames;
use riglab_nn::generate::GenerateConfig;
use riglab_random::stream;
use riglab_task::Experiment;
use riglab_task::tokenrig::TokenRigTask;
use riglab_train::{Precision, Task};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::Context;
use super::subject::{Subject, open_tokenrig};
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

/// Sequences of a group, and how many times one it may take.
const GROUP: (usize, f64) = (24, 6.0);

#[derive(Deserialize, Serialize)]
struct Drawn {
    seconds: f64,
    tokens: usize,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let (count, times) = GROUP;
    let label = format!("group{count}/tokenrig");
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped(label, recipe::NO_RIGS)]) };
    let mut ours = context.ours("group")?;
    let _: usize = ours.ask(&json!({"do": "open", "corpus": corpus, "threads": context.threads}))?;
    let (mut seed, mut tokens) = (0, [0usize; 2]);
    let mut draw = |samples: usize| -> Result<f64> {
        seed += 1;
        let drawn: Drawn = ours.ask(&json!({"do": "draw", "samples": samples, "seed": seed}))?;
        ensure!(drawn.tokens > samples, "sequences without tokens");
        tokens[usize::from(samples > 1)] += drawn.tokens;
        Ok(drawn.seconds)
    };
    // The first ones warm up.
    draw(count)?;
    draw(1)?;
    let rounds = context.rounds(9);
    let draw = std::cell::RefCell::new(draw);
    let found = in_turn(rounds, || (draw.borrow_mut())(count), || Ok(times * (draw.borrow_mut())(1)?))?;
    let (x, y) = found.medians();
    let note = format!(
        "{} threads; theirs is {times} times our time of one sequence; {:.0} tokens a sequence in groups, {:.0} alone, \
         starting weights, reading of the mesh counted; {}",
        context.threads,
        tokens[1] as f64 / (count * (rounds + 1)) as f64,
        tokens[0] as f64 / (rounds + 1) as f64,
        found.spread()
    );
    Ok(vec![Row::new(label, x, y, "s", Better::Lower).bar(1.0).note(note)])
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { corpus: PathBuf, threads: usize },
    Draw { samples: usize, seed: u64 },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut loaded: Option<Group> = None;
    side::serve(|request| match (request, &mut loaded) {
        (Request::Open { corpus, threads }, loaded) => {
            riglab_torch::init(riglab_torch::Settings { threads });
            *loaded = Some(Group::open(&corpus)?);
            Ok(json!(1))
        }
        (Request::Draw { samples, seed }, Some(group)) => Ok(json!(group.draw(samples, seed)?)),
        (Request::Draw { .. }, None) => Err(anyhow!("open first")),
    })
}

/// The network, and the mesh that groups are drawn for.
struct Group {
    task: TokenRigTask,
    mesh: Mesh,
}

impl Group {
    fn open(corpus: &Path) -> Result<Self> {
        let mut config = recipe::tokenrig(corpus, Precision::Fp32)?;
        (config.limits, config.sampling.rigs) = (TokenRigTask::LIMITS, 1);
        let task = open_tokenrig(config, corpus)?;
        let first = task.assets().split(SplitNames::TRAIN)?.into_iter().next().context("no rig to train on")?;
        let (rig, _) = task.assets().read(first)?.rig.normalized();
        Ok(Self { mesh: rig.mesh().clone(), task })
    }

    fn draw(&self, samples: usize, seed: u64) -> Result<Drawn> {
        let _no_grad = tch::no_grad_guard();
        let start = Instant::now();
        let (rigger, w) = (self.task.rigger(), self.task.params().weights());
        let seen = rigger.condition(w, &[(&self.mesh, 0)]);
        let mut streams: Vec<_> = (0..samples as u64).map(|row| stream(seed, "bench group", &[row])).collect();
        let how = GenerateConfig { sample: true, tokens: rigger.config().limits.tokens, ..Default::default() };
        let drawn = rigger.draw(w, &seen, &vec![rigger.free(); samples], &how, &mut streams);
        let drawn = drawn.map_err(|e| anyhow!(e))?;
        let seconds = start.elapsed().as_secs_f64();
        // An empty bone has one token.
        let codes = |own: &Option<Vec<i64>>| own.as_ref().map_or(1, Vec::len);
        let tokens = drawn.iter().map(|d| d.skeleton.len() + d.codes.iter().map(codes).sum::<usize>()).sum();
        Ok(Drawn { seconds, tokens })
    }
}

#[cfg(test)]
mod tests {
    use riglab_data::CorpusWriter;
    use riglab_synth::{Options, Plan, creatures};

    use super::*;

    #[test]
    fn groups_are_drawn_by_the_network_of_the_experiment_as_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let corpus = dir.path().join("corpus.h5");
        let mut writer = CorpusWriter::create(&corpus).unwrap();
        let small = Options { plans: vec![Plan::Fixture], triangles: 500..=600 };
        creatures(0, 0..2, &small).iter().for_each(|asset| writer.add(asset).unwrap());
        writer.finish(&[SplitNames::TRAIN, SplitNames::VAL]).unwrap();
        // Programs that tests beside this one begin hold a file that was being written for as long as they run.
        let freed = (0..100).any(|_| {
            let open = riglab_data::Corpus::open(&corpus).is_ok();
            std::thread::sleep(std::time::Duration::from_millis(if open { 0 } else { 100 }));
            open
        });
        assert!(freed);
        let drawn = Group::open(&corpus).unwrap().draw(2, 1).unwrap();
        assert!(drawn.tokens > 2 && drawn.seconds > 0.0);
    }
}
