//! The four rewards of a group of 24 rigs of one mesh, against the same by numpy.
//!
//! Both get the same cells, edges, rigs and poses, as arrays, and the same threads; ours voxelises the mesh as well,
//! theirs does not have to. Rewards are compared. Theirs shares rigs out among its threads, or takes one after the other
//! and lets numpy and scipy use the threads: whichever is faster here.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use riglab_core::Rig;
use riglab_random::{Draw, stream};
use riglab_reward::{Candidate, RewardConfig, Rewards, Scorer, random_poses};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::Context;
use super::geodesic::of_size;
use crate::python::SAMPLES;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side::{self, Side};

const ROUNDS: usize = 3;
/// Rigs of a group, SkinTokens' G.
const GROUP: u64 = 24;
const VERTICES: usize = 20_000;

#[derive(Deserialize, Serialize)]
struct Loaded {
    vertices: usize,
    joints: usize,
    cells: usize,
}

#[derive(Deserialize, Serialize)]
struct Scored {
    seconds: f64,
    rewards: Vec<[f64; 4]>,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let folder = context.path("rewards");
    std::fs::create_dir_all(&folder)?;
    let (mut ours, mut theirs) = (context.ours("rewards")?, SAMPLES.start("rewards.py")?);
    let mesh: Loaded = ours.ask(&json!({"do": "load", "folder": folder}))?;
    let config = RewardConfig::default();
    theirs.ask::<usize>(&json!({"do": "load", "folder": folder, "joints": mesh.joints, "config": config,
                                "threads": context.threads}))?;
    let pooled = pool_is_faster(&mut theirs)?;
    let (ask, other) = (json!({"do": "score"}), json!({"do": "score", "pooled": pooled}));
    let (a, b): (Scored, Scored) = (ours.ask(&ask)?, theirs.ask(&other)?);
    let pairs = a.rewards.as_flattened().iter().zip(b.rewards.as_flattened());
    let apart = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    ensure!(a.rewards.len() == b.rewards.len() && apart < 1e-5, "rewards are {apart:e} apart");
    let found = in_turn(
        context.rounds(ROUNDS),
        || Ok(ours.ask::<Scored>(&ask)?.seconds),
        || Ok(theirs.ask::<Scored>(&other)?.seconds),
    )?;
    let (a, b) = found.medians();
    let Loaded { vertices, joints, cells } = mesh;
    let note = format!(
        "{} threads, {vertices} vertices, {joints} joints, {cells} cells; rewards {apart:.0e} apart; theirs takes {}, the \
         faster one; {}",
        context.threads,
        if pooled { "rigs side by side" } else { "one rig after the other, with threads within each" },
        found.spread()
    );
    Ok(vec![Row::new("rewards/24", a, b, "s", Better::Lower).bar(20.0).note(note)])
}

/// Whether the other side is faster with its rigs shared out among threads.
fn pool_is_faster(theirs: &mut Side) -> Result<bool> {
    let mut best = [f64::INFINITY; 2];
    for _ in 0..2 {
        for pooled in [true, false] {
            let found: Scored = theirs.ask(&json!({"do": "score", "pooled": pooled}))?;
            let best = &mut best[usize::from(pooled)];
            *best = best.min(found.seconds);
        }
    }
    Ok(best[1] <= best[0])
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { folder: PathBuf },
    Score,
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut loaded: Option<(Rig, Vec<Option<Candidate>>)> = None;
    side::serve(|request| match request {
        Request::Load { folder } => {
            let rig = of_size(VERTICES, 50)?;
            let group = (0..GROUP).map(|k| varied(&rig, k)).collect::<Result<Vec<_>>>()?;
            let cells = store(&rig, &group, &folder)?;
            let (vertices, joints) = (rig.mesh().positions().len(), rig.skeleton().len());
            loaded = Some((rig, group.into_iter().map(Some).collect()));
            Ok(json!(Loaded { vertices, joints, cells }))
        }
        Request::Score => {
            let (rig, group) = loaded.as_ref().context("no group yet")?;
            let start = Instant::now();
            let rewards = Scorer::new(rig.mesh(), &RewardConfig::default()).score_group(group);
            let seconds = start.elapsed().as_secs_f64();
            Ok(json!(Scored { seconds, rewards: rewards.iter().map(Rewards::parts).collect() }))
        }
    })
}

/// The rig with its joints moved a little.
fn varied(rig: &Rig, number: u64) -> Result<Candidate> {
    let mut random = stream(number, "bench/rewards", &[]);
    let sound = Candidate::of(rig);
    let heads = sound.heads().iter().map(|p| p.map(|x| x + 0.1 * (f64::from(random.unit()) - 0.5))).collect();
    Ok(Candidate::new(heads, sound.parents().to_vec(), sound.weights().clone())?)
}

/// Writes the arrays that the other side starts from; the number of cells.
fn store(rig: &Rig, group: &[Candidate], folder: &Path) -> Result<usize> {
    let floats = |name: &str, all: Vec<f64>| {
        std::fs::write(folder.join(name), all.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
    };
    let wholes = |name: &str, all: Vec<i64>| {
        std::fs::write(folder.join(name), all.into_iter().flat_map(i64::to_le_bytes).collect::<Vec<u8>>())
    };
    let config = RewardConfig::default();
    let scorer = Scorer::new(rig.mesh(), &config);
    let (voxels, joints) = (scorer.voxels(), rig.skeleton().len());
    floats("vertices.f64", rig.mesh().positions().iter().flatten().map(|x| f64::from(*x)).collect())?;
    floats("heads.f64", group.iter().flat_map(|c| c.heads()).flatten().copied().collect())?;
    let poses = random_poses(joints, config.poses, config.pose_degrees, config.seed);
    floats("turns.f64", poses.into_iter().flatten().flatten().collect())?;
    let lattice = voxels.lattice();
    floats("lattice.f64", [&lattice.origin[..], &[lattice.cell]].concat())?;
    wholes("cells.i64", voxels.places().flatten().map(|x| x as i64).collect())?;
    wholes("faces.i64", rig.mesh().triangles().iter().flatten().map(|v| i64::from(*v)).collect())?;
    wholes("parents.i64", group[0].parents().iter().map(|p| p.map_or(-1, |p| p as i64)).collect())?;
    let mut table = vec![0.0; rig.weights().rows() * joints];
    for (v, row) in table.chunks_exact_mut(joints).enumerate() {
        rig.weights().row(v).for_each(|(j, w)| row[j.index()] = f64::from(w));
    }
    floats("weights.f64", table)?;
    Ok(voxels.count())
}
