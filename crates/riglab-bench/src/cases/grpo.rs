//! A whole step of GRPO, against the same with transformers' `generate`, numpy and scipy.
//!
//! Both sides start from the same weights and one mesh, and do in a step: read the shape, draw 24 rigs under the strict
//! grammar at temperature 1 without filters, turn their codes into weights by the auto-encoder (at some vertices, the
//! others told by their neighbours), take the four rewards and their advantages within the group, ask the policy and the
//! frozen reference how likely the free tokens were, and move the policy by the clipped objective. All in fp32. The recipe
//! is `experiments/skintokens/grpo_quick.toml`, its model in the form that transformers has. Ours is the product's own
//! way: the loss of the task, then the optimizer.
//!
//! What loader threads make ready is outside of both steps: the mesh's cloud, its voxels and edges. The other side is
//! given the voxels, and, for what ours draws in its step, the vertices that are asked and the auto-encoder's cloud. Rigs
//! are gone over once, so neither side asks the policy that drew them a second time.
//!
//! The weights are those of the start of a training: sequences end where the limits make them, weights hold everywhere.
//! Before times are taken, both sides judge the same rigs, which must give the same rewards, log-probabilities, gradient
//! and, at other weights, loss; and our strict grammar must take what theirs has drawn.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, anyhow, ensure};
use riglab_core::{Joint, Mesh, Rig, Skeleton, SkinWeights};
use riglab_geom::farthest_points;
use riglab_random::{Draw, stream};
use riglab_reward::{Rewards, Scorer, random_poses};
use riglab_task::fsq_cvae::{Frozen, Prepared};
use riglab_task::grpo::{Batch, GrpoTask, GrpoTaskConfig, JudgeSettings, candidates, rewards};
use riglab_task::tokenrig::{RigSample, Rigger, TokenRigTask};
use riglab_token::{Tokenizer, TokenizerConfig, Vocabulary};
use riglab_train::{Precision, Task};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use tch::{Device, Tensor};

use super::Context;
use super::generate::named;
use super::subject::Subject;
use super::training::{Plan, Training, lockstep};
use crate::python::TRANSFORMERS;
use crate::recipe;
use crate::rounds::median;
use crate::row::{Better, Row};
use crate::side::{self, PATIENCE, Side};

const LABEL: &str = "step/grpo";
/// Rigs of the group, SkinTokens' G.
const GROUP: usize = 24;
/// Meshes of which the one with the middle number of vertices is taken.
const MESHES: u64 = 9;
/// How far rewards, log-probabilities and losses of the same rigs may be apart, and the gradient's norm as a share.
const NEAR: f64 = 1e-3;
/// What weights are multiplied by where losses are compared: at the start all policies are one, and it is 0.
const ELSEWHERE: f64 = 1.25;
/// The share of a step that rewards may take, in percent.
const SHARE: f64 = 20.0;
/// What a step consists of: rigs are drawn, their codes decoded, judged; the reference says how likely they were; the
/// policy learns.
const PARTS: [&str; 5] = ["draw", "decode", "judge", "likelihoods", "update"];
const DECODE: usize = 1;
const JUDGE: usize = 2;

#[derive(Deserialize, Serialize)]
struct Opened {
    config: GrpoTaskConfig,
    settings: Value,
    skin: Value,
    tokenizer: TokenizerConfig,
    ends: Map<String, Value>,
    lattice: [f64; 4],
    turns: Vec<Vec<[f64; 3]>>,
    vertices: usize,
    cells: usize,
}

/// What a side says of the same rigs.
#[derive(Deserialize, Serialize)]
struct Checked {
    rewards: Vec<[f64; 4]>,
    /// Log-probabilities of the free tokens.
    log: Vec<f64>,
    /// Of the gradient at the start.
    norm: f64,
    /// Elsewhere.
    loss: f64,
}

/// Seconds of our step.
#[derive(Deserialize, Serialize)]
struct Parts {
    /// As [`PARTS`] are called.
    inside: [f64; PARTS.len()],
    /// What the loader makes for the rewards.
    voxels: f64,
}

#[derive(Deserialize)]
struct Told {
    ids: Vec<Vec<u32>>,
    parts: Vec<[f64; PARTS.len()]>,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped(LABEL, recipe::NO_RIGS)]) };
    let file = context.path("grpo.safetensors");
    let (mut ours, mut theirs) = (context.ours("grpo")?, TRANSFORMERS.start("grpo.py")?);
    let a: Opened = ours.ask(&json!({"do": "open", "file": file, "corpus": corpus, "threads": context.threads}))?;
    let tokenizer = Tokenizer::new(a.tokenizer);
    let mut vocabulary = named(tokenizer.vocabulary());
    vocabulary.extend(a.ends);
    vocabulary.insert("templates".into(), json!(templates(tokenizer.vocabulary())));
    let open = json!({"do": "open", "file": file, "config": a.config, "settings": a.settings, "skin": a.skin,
                      "vocabulary": vocabulary, "lattice": a.lattice, "turns": a.turns, "threads": context.threads});
    theirs.ask::<Value>(&open)?;
    let apart = check(&mut ours, &mut theirs)?;
    let fused: Map<String, Value> = theirs.ask(&json!({"do": "faster"}))?;
    let plan = Plan { batches: 1, rounds: context.rounds(3), compared: 0 };
    let found = lockstep(&mut ours, &mut theirs, plan, PATIENCE)?;
    let told: Told = theirs.ask(&json!({"do": "told"}))?;
    for ids in &told.ids {
        TokenRigTask::check(&a.settings, &tokenizer, ids)?;
    }
    // With the start, as ours count.
    let length = told.ids.iter().map(|ids| 1.0 + ids.len() as f64).sum::<f64>() / told.ids.len() as f64;
    let own_length: f64 = ours.ask(&json!({"do": "length"}))?;
    let mut all: Vec<Parts> = Vec::new();
    for _ in 0..plan.rounds {
        all.push(ours.ask(&json!({"do": "parts"}))?);
    }
    let plain: Vec<&str> = fused.iter().filter(|(_, is)| **is == json!(false)).map(|(name, _)| name.as_str()).collect();
    let note = format!(
        "{} threads, {} vertices of which {} are asked, {} cells; sequences of {own_length:.0} and {length:.0} tokens on \
         average; same rigs: rewards {:.0e}, log-probabilities {:.0e}, gradient {:.0e}, loss {:.0e} apart; batches made \
         before; theirs takes the faster attention for each part, plain products for: {}; ms a step: {}",
        context.threads,
        a.vertices,
        a.config.rollout.vertices.min(a.vertices),
        a.cells,
        apart[0],
        apart[1],
        apart[2],
        apart[3],
        if plain.is_empty() { "none".into() } else { plain.join(", ") },
        found.wall.spread()
    );
    let ((x, y), (cpu_x, cpu_y)) = (found.wall.medians(), found.cpu.medians());
    let mut rows = vec![
        Row::new(LABEL, x, y, "ms/step", Better::Lower).bar(3.0).note(note),
        Row::new(format!("{LABEL}/cpu"), cpu_x, cpu_y, "ms/step", Better::Lower)
            .note("by the processor time of all threads: tells more than the clock where the machine is shared"),
    ];
    let timed = &told.parts[told.parts.len() - plan.rounds..];
    rows.extend(PARTS.iter().enumerate().map(|(k, name)| {
        let ours = median(&all.iter().map(|p| 1e3 * p.inside[k]).collect::<Vec<_>>());
        let theirs = median(&timed.iter().map(|p| 1e3 * p[k]).collect::<Vec<_>>());
        Row::new(format!("{LABEL}/{name}"), ours, theirs, "ms/step", Better::Lower)
    }));
    let share = |of: &dyn Fn(&Parts) -> f64| {
        let shares: Vec<f64> = all.iter().map(|p| 100.0 * of(p) / p.inside.iter().sum::<f64>()).collect();
        median(&shares)
    };
    let of_rewards = format!(
        "the four rewards, and the mesh's voxels and edges that loader threads make; theirs is what they may take; \
         without those {:.1} %; decoding takes {:.1} % besides. Our parts are of {} more steps, in each of which the \
         rigs are drawn, decoded and judged once more by themselves; likelihoods are a pass without a gradient, the \
         update is what is left",
        share(&|p| p.inside[JUDGE]),
        share(&|p| p.inside[DECODE]),
        all.len()
    );
    let whole = share(&|p| p.inside[JUDGE] + p.voxels);
    rows.push(Row::new(format!("{LABEL}/rewards"), whole, SHARE, "%", Better::Lower).bar(1.0).note(of_rewards));
    Ok(rows)
}

/// By class and part: the place of its first joint in the template, and on which places its joints hang.
fn templates(ids: &Vocabulary) -> Vec<(u32, u32, usize, &'static [Option<u8>])> {
    let parts = |(k, name): (usize, &String)| {
        let own = ids.parts_of(name).into_iter();
        own.map(|(number, part)| (ids.class(k), ids.part(number), part.first, part.parents)).collect::<Vec<_>>()
    };
    ids.classes().iter().enumerate().flat_map(parts).collect()
}

/// Lets both sides judge the rigs that ours draws; how far they are apart.
fn check(ours: &mut Side, theirs: &mut Side) -> Result<[f64; 4]> {
    let (rows, a): (Vec<Vec<u32>>, Checked) = ours.ask(&json!({"do": "check"}))?;
    let b: Checked = theirs.ask(&json!({"do": "check", "rows": rows, "scale": ELSEWHERE}))?;
    ensure!(a.rewards.len() == b.rewards.len() && a.log.len() == b.log.len(), "other rigs or other free tokens");
    let most = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let apart = [
        most(a.rewards.as_flattened(), b.rewards.as_flattened()),
        most(&a.log, &b.log),
        (a.norm / b.norm - 1.0).abs(),
        (a.loss - b.loss).abs(),
    ];
    eprintln!(
        "  {} free tokens; gradients {:.4} and {:.4}; losses {:.4} and {:.4}; apart {apart:?}",
        a.log.len(),
        a.norm,
        b.norm,
        a.loss,
        b.loss
    );
    ensure!(apart.iter().all(|x| *x <= NEAR), "the two sides differ by {apart:?}");
    Ok(apart)
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { file: PathBuf, corpus: PathBuf, threads: usize },
    Check,
    Run { steps: usize },
    Parts,
    Length,
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let (mut training, mut tokens): (Option<Training<GrpoTask>>, Vec<usize>) = Default::default();
    let mut settings: Option<GrpoTaskConfig> = None;
    side::serve(|request| match (request, &mut training, &mut settings) {
        (Request::Open { file, corpus, threads }, training, settings) => {
            riglab_torch::init(riglab_torch::Settings { threads });
            let config = recipe::grpo(&corpus)?;
            ensure!((config.rollout.meshes, config.rollout.group) == (1, GROUP), "the recipe has another group");
            let (made, opened) = open(&config, &corpus, &file)?;
            (*training, *settings) = (Some(made), Some(config));
            Ok(json!(opened))
        }
        (Request::Check, Some(training), Some(c)) => Ok(json!(checked(training, c)?)),
        (Request::Run { steps }, Some(training), _) => {
            let ran = training.run(steps)?;
            tokens.push(training.task.kept().get("rollout.ids").map_or(0, Tensor::numel));
            Ok(ran)
        }
        (Request::Parts, Some(training), Some(c)) => Ok(json!(parts(training, c)?)),
        (Request::Length, ..) => Ok(json!(tokens.iter().sum::<usize>() as f64 / (tokens.len() * GROUP) as f64)),
        _ => Err(anyhow!("open first")),
    })
}

fn open(config: &GrpoTaskConfig, corpus: &Path, file: &Path) -> Result<(Training<GrpoTask>, Opened)> {
    let start = <TokenRigTask as Subject>::open(corpus, Precision::Fp32, Some(GROUP))?;
    let task = GrpoTask::with(config.clone(), start.rigger(), Device::Cpu).map_err(|e| anyhow!(e))?;
    let source = task.source();
    let mut batches: Vec<Batch> =
        (0..MESHES).map(|n| source.batch(n)).collect::<Result<_, String>>().map_err(|e| anyhow!(e))?;
    batches.sort_by_key(|b| b.subjects[0].mesh.positions().len());
    let batch = batches.swap_remove(MESHES as usize / 2);
    let (subject, reward) = (&batch.subjects[0], &config.reward);
    let voxels = subject.scorer.voxels();
    let lattice = voxels.lattice();
    let opened = Opened {
        settings: start.settings(),
        skin: json!(start.rigger().vae().config().model),
        tokenizer: start.tokenizer().clone(),
        ends: start.ends().as_object().cloned().unwrap_or_default(),
        lattice: [lattice.origin[0], lattice.origin[1], lattice.origin[2], lattice.cell],
        turns: random_poses(TokenRigTask::LIMITS.joints, reward.poses, reward.pose_degrees, reward.seed),
        vertices: subject.mesh.positions().len(),
        cells: voxels.count(),
        config: config.clone(),
    };
    let places: Vec<i64> = voxels.places().flatten().map(|x| x as i64).collect();
    let (points, tokens) = (batch.shapes.cloud.as_slice(), batch.shapes.picks.as_slice());
    let mut mesh = vec![
        ("cells", Tensor::from_slice(&places).view([-1, 3])),
        ("cloud", Tensor::from_slice(points).view([1, -1, 6])),
        ("picks", Tensor::from_slice(tokens).view([1, -1])),
    ];
    mesh.extend(asked(start.rigger().vae(), &subject.mesh, subject.key, config)?);
    let training = Training::new(task, config.train.clone(), vec![batch]);
    let mut tensors = training.weights();
    tensors.extend(start.rigger().vae().tensors().into_iter().map(|(n, t)| (format!("v/{n}"), t)));
    tensors.extend(mesh.into_iter().map(|(n, t)| (format!("mesh/{n}"), t)));
    riglab_nn::io::write(file, tensors.iter().map(|(n, t)| (n.as_str(), t)))?;
    Ok((training, opened))
}

/// The mesh, the vertices that are asked for weights and the cloud that the auto-encoder reads, as
/// `riglab_task::tokenrig::Skinner` draws them; the check shows that they are the same.
fn asked(vae: &Frozen, mesh: &Mesh, key: u64, c: &GrpoTaskConfig) -> Result<Vec<(&'static str, Tensor)>> {
    let mut random = stream(c.train.seed, "skin rewards", &[key]);
    let n = mesh.positions().len();
    let mut chosen: Vec<u32> = (0..n as u32).collect();
    if n > c.rollout.vertices {
        random.shuffled(&mut chosen);
        chosen.truncate(c.rollout.vertices);
    }
    let root = Skeleton::new(vec![Joint { name: "root".into(), parent: None, head: [0.0; 3] }])?;
    let rig = Rig::new(root, mesh.clone(), SkinWeights::normalized((0..n).map(|_| [(0, 1.0)]))?)?;
    let prepared = Prepared::of(String::new(), rig, false);
    let flat = |points: &[riglab_task::fsq_cvae::Point]| {
        let all: Vec<f32> = points.iter().flat_map(|p| p.position.into_iter().chain(p.normal)).collect();
        Tensor::from_slice(&all).view([-1, 6])
    };
    let points: Vec<_> = chosen.iter().map(|&v| prepared.vertex(v)).collect();
    let cloud: Vec<_> = (0..vae.config().sampling.shape_points).map(|_| prepared.surface(&mut random)).collect();
    let places: Vec<_> = cloud.iter().map(|p| p.position).collect();
    let picks = farthest_points(&places, vae.config().model.shape_tokens, 0);
    let picks: Vec<i64> = picks.into_iter().map(|i| i as i64).collect();
    let faces: Vec<i64> = mesh.triangles().iter().flatten().map(|v| i64::from(*v)).collect();
    Ok(vec![
        ("points", flat(&points)),
        ("skin_cloud", flat(&cloud).unsqueeze(0)),
        ("skin_picks", Tensor::from_slice(&picks).view([1, -1])),
        ("vertices", Tensor::from_slice(mesh.positions().as_flattened()).view([-1, 3])),
        ("faces", Tensor::from_slice(&faces).view([-1, 3])),
    ])
}

fn policy(task: &GrpoTask) -> Result<&Rigger> {
    task.rigger().context("a policy that makes rigs")
}

/// The rigs that the next step draws.
fn drawn(training: &Training<GrpoTask>) -> Result<Vec<RigSample>> {
    let (task, batch, at) = (&training.task, &training.batches[0], training.at());
    let (rigger, key) = (policy(task)?, batch.subjects[0].key);
    let _no_grad = tch::no_grad_guard();
    let w = rigger.params().weights();
    let each = 0..GROUP as u64;
    let mut streams: Vec<_> = each.map(|k| stream(at.seed, "rollout draws", &[at.batch, key, 0, k])).collect();
    let prompts = vec![rigger.free(); GROUP];
    let how = GrpoTaskConfig::default().draws();
    rigger.draw(w, &rigger.prefix(w, &batch.shapes).into(), &prompts, &how, &mut streams).map_err(|e| anyhow!(e))
}

fn judged(c: &GrpoTaskConfig) -> JudgeSettings {
    JudgeSettings { vertices: c.rollout.vertices, cut: c.eval.cut, half: false, seed: c.train.seed }
}

/// What ours says of the rigs that its next step draws, and their tokens after the start.
fn checked(training: &Training<GrpoTask>, c: &GrpoTaskConfig) -> Result<(Vec<Vec<u32>>, Checked)> {
    let (task, batch, at) = (&training.task, &training.batches[0], training.at());
    let drawn = drawn(training)?;
    let found = rewards(Some(policy(task)?.vae()), &batch.subjects[0], &drawn, &judged(c)).map_err(|e| anyhow!(e))?;
    let weights = task.params().weights();
    let loss = task.loss(weights, batch, at).map_err(|e| anyhow!(e))?.total();
    let inputs: Vec<&Tensor> = weights.tensors().iter().collect();
    let grads = Tensor::run_backward(&[loss], &inputs, false, false);
    let squares = grads.iter().filter(|g| g.defined()).map(|g| g.square().sum(tch::Kind::Double).double_value(&[]));
    let norm = squares.sum::<f64>().sqrt();
    let kept = task.kept();
    let flat = |name: &str| kept.get(name).map(|t| t.to_kind(tch::Kind::Double)).unwrap_or_default();
    let ids: Vec<f64> = drawn.iter().flat_map(|d| &d.ids).map(|id| *id as f64).collect();
    ensure!(Vec::<f64>::try_from(flat("rollout.ids"))? == ids, "the step draws other rigs");
    let _no_grad = tch::no_grad_guard();
    let elsewhere = weights.detached_copy();
    elsewhere.tensors().iter().for_each(|t| _ = t.shallow_clone().g_mul_scalar_(ELSEWHERE));
    // Without meshes: once more over the same rigs.
    let loss = task.loss(&elsewhere, &Batch::default(), at).map_err(|e| anyhow!(e))?.total().double_value(&[]);
    let rows = drawn.iter().map(|d| d.ids[1..].iter().map(|id| *id as u32).collect()).collect();
    let log = Vec::<f64>::try_from(flat("rollout.old"))?;
    Ok((rows, Checked { rewards: found.iter().map(Rewards::parts).collect(), log, norm, loss }))
}

/// Seconds of the next step by part: what comes first is done once more by itself, the same rigs are drawn.
fn parts(training: &mut Training<GrpoTask>, c: &GrpoTaskConfig) -> Result<Parts> {
    let timed = |start: Instant| start.elapsed().as_secs_f64();
    let start = Instant::now();
    let drawn = drawn(training)?;
    let draw = timed(start);
    let (task, subject) = (&training.task, &training.batches[0].subjects[0]);
    let start = Instant::now();
    let (made, _) = candidates(Some(policy(task)?.vae()), subject, &drawn, &judged(c)).map_err(|e| anyhow!(e))?;
    let decode = timed(start);
    let start = Instant::now();
    ensure!(subject.scorer.score_group(&made).len() == GROUP, "rigs without rewards");
    let judge = timed(start);
    let start = Instant::now();
    ensure!(Scorer::new(&subject.mesh, &c.reward).voxels().count() > 0, "a mesh without a cell");
    let voxels = timed(start);
    let start = Instant::now();
    training.run(1)?;
    let step = timed(start);
    // A pass without a gradient, as of the reference.
    let start = Instant::now();
    tch::no_grad(|| {
        let w = training.task.params().weights();
        training.task.loss(w, &Batch::default(), training.at()).map(|l| l.total().double_value(&[]))
    })
    .map_err(|e| anyhow!(e))?;
    let likely = timed(start);
    Ok(Parts { inside: [draw, decode, judge, likely, step - draw - decode - judge - likely], voxels })
}
