//! 270 skeletons and skins, the size of ModelsResource's test set, under all conventions, against the peers' formulas
//! by numpy and scipy.
//!
//! Both get the same arrays, dense weights among them; every figure is compared.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use riglab_metric::{
    Joints, Poses, Rows, SkeletonConvention, SkinConvention, Skins, match_joints, motion, motion_poses, nearest_shares,
    tree_edit_distance,
};
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::Context;
use crate::python::SAMPLES;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const ROUNDS: usize = 3;
const ASSETS: u64 = 270;

#[derive(Deserialize, Serialize)]
struct Loaded {
    /// Joints, true joints, vertices, edges and poses of each.
    counts: Vec<[usize; 5]>,
}

#[derive(Deserialize, Serialize)]
struct Scored {
    seconds: f64,
    #[serde(default)]
    parts: BTreeMap<String, f64>,
    values: Vec<Vec<Option<f64>>>,
}

/// A prediction and its truth.
struct Pair {
    predicted: Joints,
    truth: Joints,
    tolerances: Vec<f64>,
    vertices: Vec<[f64; 3]>,
    edges: Vec<[u32; 2]>,
    poses: Poses,
    skins: [Vec<f32>; 2],
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let folder = context.path("metrics");
    std::fs::create_dir_all(&folder)?;
    let (mut ours, mut theirs) = (context.ours("metrics")?, SAMPLES.start("metrics.py")?);
    let loaded: Loaded = ours.ask(&json!({"do": "load", "folder": folder}))?;
    theirs.ask::<usize>(&json!({"do": "load", "folder": folder, "counts": loaded.counts}))?;
    let ask = json!({"do": "score"});
    let (a, b): (Scored, Scored) = (ours.ask(&ask)?, theirs.ask(&ask)?);
    let figures = compare(&a, &b)?;
    let found = in_turn(
        context.rounds(ROUNDS),
        || Ok(ours.ask::<Scored>(&ask)?.seconds),
        || Ok(theirs.ask::<Scored>(&ask)?.seconds),
    )?;
    let (ours, twin) = found.medians();
    let parts: Vec<String> = b.parts.iter().map(|(name, s)| format!("{name} {s:.2} s")).collect();
    let note = format!(
        "{} threads against numpy's own, {ASSETS} assets, {figures} figures each, all equal; theirs: {}; {}",
        context.threads,
        parts.join(", "),
        found.spread()
    );
    Ok(vec![Row::new("metrics/270", ours, twin, "s", Better::Lower).bar(20.0).note(note)])
}

/// How many figures an asset has, all of them equal on both sides.
fn compare(a: &Scored, b: &Scored) -> Result<usize> {
    ensure!(a.values.len() == b.values.len(), "{} and {} assets", a.values.len(), b.values.len());
    for (asset, (a, b)) in a.values.iter().zip(&b.values).enumerate() {
        ensure!(a.len() == b.len(), "asset {asset}: {} and {} figures", a.len(), b.len());
        for (k, (a, b)) in a.iter().zip(b).enumerate() {
            let (a, b) = (a.unwrap_or(f64::NAN), b.unwrap_or(f64::NAN));
            let equal = (a.is_nan() && b.is_nan()) || (a - b).abs() <= 1e-6 + 1e-6 * b.abs();
            ensure!(equal, "asset {asset}, figure {k}: {a} and {b}");
        }
    }
    Ok(a.values.first().map_or(0, Vec::len))
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { folder: PathBuf },
    Score,
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut pairs: Option<Vec<Pair>> = None;
    side::serve(|request| match request {
        Request::Load { folder } => {
            let made: Vec<Pair> = (0..ASSETS).map(pair).collect();
            let counts = store(&made, &folder)?;
            pairs = Some(made);
            Ok(json!(Loaded { counts }))
        }
        Request::Score => {
            let pairs = pairs.as_ref().context("nothing loaded yet")?;
            let start = Instant::now();
            let values: Vec<Vec<f64>> = pairs.par_iter().map(figures).collect();
            let seconds = start.elapsed().as_secs_f64();
            let values = values.iter().map(|row| row.iter().map(|v| v.is_finite().then_some(*v)).collect()).collect();
            Ok(json!(Scored { seconds, parts: BTreeMap::new(), values }))
        }
    })
}

fn figures(pair: &Pair) -> Vec<f64> {
    let (a, b) = (&pair.predicted, &pair.truth);
    let mut out: Vec<f64> = SkeletonConvention::ALL
        .into_iter()
        .flat_map(|convention| {
            let d = convention.distances(a, b);
            [d.j2j, d.j2b, d.b2b]
        })
        .collect();
    for tolerances in [&pair.tolerances[..], &[0.1]] {
        let m = match_joints(&a.positions, &b.positions, tolerances);
        out.extend([m.dice(), m.precision(), m.recall(), m.iou()]);
    }
    out.extend(nearest_shares(&a.positions, &b.positions, 0.1));
    out.push(tree_edit_distance(&a.parents, &b.parents).map_or(f64::NAN, |edits| edits as f64));
    let [truth, predicted] = &pair.skins;
    let columns = b.positions.len();
    let (truth, predicted) = (Rows::dense(truth, columns), Rows::dense(predicted, columns));
    let skins = Skins { truth: &truth, predicted: &predicted, edges: &pair.edges };
    for convention in SkinConvention::ALL {
        out.extend(convention.figures(&skins).into_iter().map(|(_, value)| value));
    }
    let m = motion(&pair.vertices, b, &pair.poses, &truth, &predicted);
    out.extend([m.mean, m.max, m.mean_max, m.mse, m.rms]);
    out
}

/// As large as ModelsResource's: 20 joints and 1,300 vertices in the mean.
fn pair(number: u64) -> Pair {
    let mut random = stream(number, "bench/metrics", &[]);
    let at = |random: &mut riglab_random::Stream| [(); 3].map(|()| f64::from(2.0 * random.unit() - 1.0));
    let joints = 8 + random.below(25);
    let mut truth = Joints::default();
    for j in 0..joints {
        let parent = (j > 0).then(|| j - 1 - random.below(j.min(3)));
        let head = match parent {
            Some(p) => std::array::from_fn(|k| truth.positions[p][k] + 0.3 * at(&mut random)[k]),
            None => [0.0; 3],
        };
        truth.positions.push(head);
        truth.parents.push(parent);
    }
    // The last joints are missing, the others moved.
    let kept = joints - random.below(3);
    let moved = |p: &[f64; 3], random: &mut riglab_random::Stream| {
        let by = at(random);
        std::array::from_fn(|k| p[k] + 0.05 * by[k])
    };
    let predicted = Joints {
        positions: truth.positions[..kept].iter().map(|p| moved(p, &mut random)).collect(),
        parents: truth.parents[..kept].to_vec(),
    };
    let vertices: Vec<[f64; 3]> = (0..500 + random.below(1_600)).map(|_| at(&mut random)).collect();
    let (mut a, mut b) = (vec![0.0f32; vertices.len() * joints], vec![0.0f32; vertices.len() * joints]);
    for (a, b) in a.chunks_exact_mut(joints).zip(b.chunks_exact_mut(joints)) {
        for _ in 0..1 + random.below(4) {
            let j = random.below(joints);
            a[j] += 0.05 + random.unit();
            b[j] += 0.05 + random.unit();
        }
        b[random.below(joints)] += 0.1 * random.unit();
        for row in [a, b] {
            let sum: f32 = row.iter().sum();
            row.iter_mut().for_each(|w| *w /= sum);
        }
    }
    let edge = |random: &mut riglab_random::Stream| [(); 2].map(|()| random.below(vertices.len()) as u32);
    let edges = (0..6 * vertices.len()).map(|_| edge(&mut random)).collect();
    Pair {
        tolerances: (0..joints).map(|_| f64::from(0.02 + 0.1 * random.unit())).collect(),
        poses: motion_poses(&number.to_string(), &truth.parents),
        edges,
        vertices,
        skins: [a, b],
        predicted,
        truth,
    }
}

/// Writes the arrays that the other side starts from.
fn store(pairs: &[Pair], folder: &Path) -> Result<Vec<[usize; 5]>> {
    let (mut floats, mut wholes): (Vec<f64>, Vec<i64>) = (Vec::new(), Vec::new());
    for p in pairs {
        floats.extend(p.predicted.positions.as_flattened());
        floats.extend(p.truth.positions.as_flattened());
        floats.extend(&p.tolerances);
        floats.extend(p.vertices.as_flattened());
        // By rows.
        floats.extend(p.poses.iter().flatten().flat_map(|m| m.transpose().to_cols_array()));
        floats.extend(p.skins.iter().flatten().map(|w| f64::from(*w)));
        let parents = |of: &Joints| of.parents.iter().map(|p| p.map_or(-1, |p| p as i64)).collect::<Vec<_>>();
        wholes.extend(parents(&p.predicted).into_iter().chain(parents(&p.truth)));
        wholes.extend(p.edges.as_flattened().iter().map(|v| i64::from(*v)));
    }
    std::fs::write(folder.join("floats.f64"), floats.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>())?;
    std::fs::write(folder.join("wholes.i64"), wholes.into_iter().flat_map(i64::to_le_bytes).collect::<Vec<u8>>())?;
    let count = |p: &Pair| {
        [p.predicted.positions.len(), p.truth.positions.len(), p.vertices.len(), p.edges.len(), p.poses.len()]
    };
    Ok(pairs.iter().map(count).collect())
}
