//! 65,536 points of a surface with normals and skinning weights, against trimesh and against numpy.
//!
//! Both start from a mesh without areas or normals, as training does after each augmentation. Ours gives
//! weights as sparse rows, theirs as a table, which is what the public code of UniRig and SkinTokens works
//! on. Draws differ; the means of positions, normals and weights are compared.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use riglab_core::Rig;
use riglab_geom::{By, CloudConfig, CloudSampler};
use riglab_random::stream;
use riglab_synth::{Options, creature};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::Context;
use crate::python::ARRAYS;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const ROUNDS: usize = 7;
/// Points of a cloud.
const POINTS: usize = 65_536;
/// Triangles of the mesh, about.
const TRIANGLES: u32 = 10_000;
/// Clouds that are timed together.
const TIMES: u64 = 5;
/// How far means may be apart: six deviations of the mean of so many numbers in [-1, 1].
const NEAR: f64 = 0.025;

#[derive(Deserialize, Serialize)]
struct Loaded {
    folder: PathBuf,
    vertices: usize,
    triangles: usize,
    joints: usize,
}

#[derive(Deserialize, Serialize)]
struct Drawn {
    seconds: f64,
    means: Vec<f64>,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let folder = context.path("sample");
    std::fs::create_dir_all(&folder)?;
    let (mut ours, mut theirs) = (context.ours("sample")?, ARRAYS.start("sample.py")?);
    let mesh: Loaded = ours.ask(&json!({"do": "load", "folder": folder}))?;
    theirs.ask::<usize>(&json!({"do": "load", "folder": folder, "joints": mesh.joints}))?;
    let per_cloud = |drawn: Drawn| 1e3 * drawn.seconds / TIMES as f64;
    let mut rows = Vec::new();
    for way in ["trimesh", "numpy"] {
        let one = json!({"do": "draw", "points": POINTS, "times": TIMES, "seed": 1});
        let other = json!({"do": "draw", "way": way, "points": POINTS, "times": TIMES, "seed": 1});
        // The first time warms up, too.
        let (a, b): (Drawn, Drawn) = (ours.ask(&one)?, theirs.ask(&other)?);
        ensure!(a.means.len() == b.means.len(), "{} means against {}", a.means.len(), b.means.len());
        let apart = a.means.iter().zip(&b.means).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        ensure!(apart < NEAR, "the clouds' means are {apart:.3} apart");
        let found =
            in_turn(context.rounds(ROUNDS), || Ok(per_cloud(ours.ask(&one)?)), || Ok(per_cloud(theirs.ask(&other)?)))?;
        let (a, b) = found.medians();
        let Loaded { vertices, triangles, joints, .. } = mesh;
        let note = format!(
            "one thread, {vertices} vertices, {triangles} triangles, {joints} joints; means {apart:.4} apart; {}",
            found.spread()
        );
        rows.push(Row::new(format!("sample/{POINTS}/{way}"), a, b, "ms/cloud", Better::Lower).note(note));
    }
    Ok(rows)
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { folder: PathBuf },
    Draw { points: usize, times: u64, seed: u64 },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut loaded: Option<Rig> = None;
    side::serve(|request| match request {
        Request::Load { folder } => {
            let options = Options { triangles: TRIANGLES..=TRIANGLES, ..Options::default() };
            let (rig, _) = creature(1, 0, &options).rig.normalized();
            store(&rig, &folder)?;
            let (vertices, triangles) = (rig.mesh().positions().len(), rig.mesh().triangles().len());
            let joints = rig.skeleton().len();
            loaded = Some(rig);
            Ok(json!(Loaded { folder, vertices, triangles, joints }))
        }
        Request::Draw { points, times, seed } => {
            let rig = loaded.as_ref().context("no mesh yet")?;
            let config = CloudConfig { points, vertices: 0, by: By::Area };
            let mut first = None;
            let start = Instant::now();
            for k in 0..times {
                let cloud = CloudSampler::new(rig.mesh(), &config).draw(&mut stream(seed, "sample", &[k]));
                let weights = cloud.weights(rig.mesh(), rig.weights())?;
                first.get_or_insert((cloud, weights));
            }
            let seconds = start.elapsed().as_secs_f64();
            let (cloud, weights) = first.context("no cloud")?;
            let mean = |all: &[[f32; 3]], k: usize| all.iter().map(|p| f64::from(p[k])).sum::<f64>() / points as f64;
            let mut means: Vec<f64> =
                [&cloud.positions, &cloud.normals].iter().flat_map(|all| (0..3).map(|k| mean(all, k))).collect();
            let mut sums = vec![0.0; rig.skeleton().len()];
            for (&joint, &w) in weights.joints().iter().zip(weights.weights()) {
                sums[usize::from(joint)] += f64::from(w) / points as f64;
            }
            means.extend(sums);
            Ok(json!(Drawn { seconds, means }))
        }
    })
}

/// Writes the arrays that the other side starts from.
fn store(rig: &Rig, folder: &Path) -> Result<()> {
    let joints = rig.skeleton().len();
    let mut table = vec![0.0f32; rig.weights().rows() * joints];
    for (v, row) in table.chunks_exact_mut(joints).enumerate() {
        rig.weights().row(v).for_each(|(j, w)| row[j.index()] = w);
    }
    let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let indices = rig.mesh().triangles().as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    std::fs::write(folder.join("positions.f32"), floats(rig.mesh().positions().as_flattened()))?;
    std::fs::write(folder.join("triangles.u32"), indices)?;
    std::fs::write(folder.join("weights.f32"), floats(&table))?;
    Ok(())
}
