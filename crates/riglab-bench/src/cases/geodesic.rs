//! Distances from bones to vertices through a body, against a search over the released graph by scipy.
//!
//! Both get the same cells. Theirs measures along edges between cells, which is off by up to three quarters of
//! a way's length, and the largest part of it is a compiled Dijkstra search; ours measures ways that turn at any
//! angle.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result};
use riglab_core::Rig;
use riglab_geom::geodesic::GeodesicSolver;
use riglab_geom::voxel::{SolidConfig, Voxels, solid};
use riglab_synth::{Options, creature};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::Context;
use crate::python::SAMPLES;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const ROUNDS: usize = 3;

#[derive(Deserialize, Serialize)]
struct Loaded {
    cell: f64,
    cells: usize,
    vertices: usize,
    bones: usize,
    voxels_ms: f64,
}

#[derive(Deserialize)]
struct Found {
    seconds: f64,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    // The bar of speed, and that of small rigs: 4,000 vertices and 50 bones at 128.
    for (name, resolution, vertices, bones) in [("geodesic/196", 196, 20_000, 60), ("geodesic/128", 128, 4_000, 50)] {
        let folder = context.path(&name.replace('/', "-"));
        std::fs::create_dir_all(&folder)?;
        let (mut ours, mut theirs) = (context.ours("geodesic")?, SAMPLES.start("geodesic.py")?);
        let load =
            json!({"do": "load", "folder": folder, "resolution": resolution, "vertices": vertices, "bones": bones});
        let body: Loaded = ours.ask(&load)?;
        theirs.ask::<usize>(&json!({"do": "load", "folder": folder, "cell": body.cell}))?;
        let ask = json!({"do": "distances"});
        let found = in_turn(
            context.rounds(ROUNDS),
            || Ok(ours.ask::<Found>(&ask)?.seconds),
            || Ok(theirs.ask::<Found>(&ask)?.seconds),
        )?;
        let (a, b) = found.medians();
        let Loaded { cells, vertices, bones, voxels_ms, .. } = body;
        let note = format!(
            "{} threads against one, {cells} cells, {vertices} vertices, {bones} bones; voxels {voxels_ms:.0} ms besides; {}",
            context.threads,
            found.spread()
        );
        rows.push(Row::new(name, a, b, "s", Better::Lower).bar(if resolution == 196 { 20.0 } else { 1.0 }).note(note));
    }
    Ok(rows)
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { folder: PathBuf, resolution: usize, vertices: usize, bones: usize },
    Distances,
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut loaded: Option<(Rig, Voxels, usize)> = None;
    side::serve(|request| match request {
        Request::Load { folder, resolution, vertices, bones } => {
            let rig = of_size(vertices, bones)?;
            let start = Instant::now();
            let voxels = solid(rig.mesh(), &SolidConfig { resolution, ..SolidConfig::DEFAULT });
            let voxels_ms = 1e3 * start.elapsed().as_secs_f64();
            store(&rig, &voxels, bones, &folder)?;
            let vertices = rig.mesh().positions().len();
            let body = Loaded { cell: voxels.lattice().cell, cells: voxels.count(), vertices, bones, voxels_ms };
            loaded = Some((rig, voxels, bones));
            Ok(json!(body))
        }
        Request::Distances => {
            let (rig, voxels, bones) = loaded.as_ref().context("no body yet")?;
            let start = Instant::now();
            let segments = rig.skeleton().segments();
            let found = GeodesicSolver::of(voxels).distances(&segments[..*bones], rig.mesh().positions());
            let mean = found.iter().map(|d| f64::from(*d)).sum::<f64>() / found.len() as f64;
            Ok(json!({"seconds": start.elapsed().as_secs_f64(), "mean": mean}))
        }
    })
}

/// A creature with about as many vertices and at least as many joints.
pub(super) fn of_size(vertices: usize, joints: usize) -> Result<Rig> {
    let triangles = 2 * vertices as u32;
    let options = Options { triangles: triangles..=triangles, ..Options::default() };
    let mut of = (0..2000).map(|i| creature(1, i, &options).rig).filter(|rig| rig.skeleton().len() >= joints);
    Ok(of.next().context("no creature has as many joints")?.normalized().0)
}

/// Writes the arrays that the other side starts from.
fn store(rig: &Rig, voxels: &Voxels, bones: usize, folder: &Path) -> Result<()> {
    let floats = |name: &str, all: Vec<f64>| {
        std::fs::write(folder.join(name), all.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
    };
    floats("vertices.f64", rig.mesh().positions().iter().flatten().map(|x| f64::from(*x)).collect())?;
    floats("joints.f64", rig.skeleton().heads()[..bones].iter().flatten().map(|x| f64::from(*x)).collect())?;
    floats("cells.f64", voxels.places().flat_map(|place| voxels.lattice().center(place)).collect())?;
    let corners = rig.mesh().triangles().iter().flatten().flat_map(|v| i64::from(*v).to_le_bytes());
    std::fs::write(folder.join("faces.i64"), corners.collect::<Vec<u8>>())?;
    Ok(())
}
