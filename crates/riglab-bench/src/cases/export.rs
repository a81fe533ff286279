//! Rigs written as GLB, against the libraries that Python users write their arrays with.
//!
//! Ours starts from a rig: it makes normals, inverse bind matrices, springs and rows of influences, then
//! bytes. Theirs starts from the arrays of what ours wrote: all of them by pygltflib and numpy, or positions,
//! normals and triangles alone by trimesh. What they write is read once, and has to be the same.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use riglab_asset::{ImportOptions, Imported, import, to_glb};
use riglab_core::Asset;
use riglab_data::rigged_files;
use serde::Deserialize;
use serde_json::{Value, json};

use super::Context;
use crate::python::ARRAYS;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const ROUNDS: usize = 5;

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(rigs) = recipe::rigs() else { return Ok(vec![Row::skipped("export", recipe::NO_RIGS)]) };
    let folder = context.path("export");
    std::fs::create_dir_all(&folder)?;
    let (mut ours, mut theirs) = (context.ours("export")?, ARRAYS.start("export_arrays.py")?);
    let written: Vec<PathBuf> = ours.ask(&json!({"do": "load", "files": rigged_files(&rigs)?, "folder": folder}))?;
    ensure!(!written.is_empty(), "no file gives a rig");
    theirs.ask::<usize>(&json!({"do": "load", "files": written}))?;
    let per_rig = |seconds: f64| 1e3 * seconds / written.len() as f64;
    let mut rows = Vec::new();
    for writer in ["pygltflib", "trimesh"] {
        // The first time warms up, too.
        let files: Vec<PathBuf> = written.iter().map(|own| own.with_extension(format!("{writer}.glb"))).collect();
        theirs.ask::<Value>(&json!({"do": "store", "writer": writer, "files": files}))?;
        let alone = writer == "trimesh";
        ours.ask::<Value>(&json!({"do": "compare", "ours": written, "theirs": files, "mesh_alone": alone}))?;
        let found = in_turn(
            context.rounds(ROUNDS),
            || Ok(per_rig(ours.ask::<f64>(&json!({"do": "write"}))?)),
            || Ok(per_rig(theirs.ask::<f64>(&json!({"do": "write", "writer": writer}))?)),
        )?;
        let (a, b) = found.medians();
        let what = if alone { "theirs the mesh alone" } else { "the same arrays" };
        let note = format!("{} rigs, {what}; {}", written.len(), found.spread());
        rows.push(Row::new(format!("export/{writer}"), a, b, "ms/rig", Better::Lower).note(note));
    }
    Ok(rows)
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { files: Vec<PathBuf>, folder: PathBuf },
    Compare { ours: Vec<PathBuf>, theirs: Vec<PathBuf>, mesh_alone: bool },
    Write,
}

/// riglab's side: a rig in memory made bytes in memory.
pub fn serve() -> Result<()> {
    let mut loaded: Vec<Asset> = Vec::new();
    side::serve(|request| match request {
        Request::Load { files, folder } => {
            let read = |file: &PathBuf| import(file, &ImportOptions::default()).and_then(Imported::into_asset).ok();
            loaded = files.iter().filter_map(read).collect();
            let store = |(number, asset): (usize, &Asset)| {
                let path = folder.join(format!("{number}.glb"));
                std::fs::write(&path, to_glb(asset)).map(|()| path)
            };
            Ok(json!(loaded.iter().enumerate().map(store).collect::<std::io::Result<Vec<_>>>()?))
        }
        Request::Compare { ours, theirs, mesh_alone } => {
            for (a, b) in ours.iter().zip(&theirs) {
                let [one, other] = [a, b].map(|file| import(file, &ImportOptions::default()));
                let (one, other) = (one?, other?);
                ensure!(one.mesh() == other.mesh(), "{} has another mesh", b.display());
                if mesh_alone {
                    continue;
                }
                let rigs = one.rig().zip(other.rig());
                let (one, other) = rigs.with_context(|| format!("{} has no rig", b.display()))?;
                ensure!(one.skeleton() == other.skeleton(), "{} has another skeleton", b.display());
                ensure!(one.weights() == other.weights(), "{} has other weights", b.display());
            }
            Ok(json!(ours.len()))
        }
        Request::Write => {
            let start = Instant::now();
            for asset in &loaded {
                std::hint::black_box(to_glb(asset));
            }
            Ok(json!(start.elapsed().as_secs_f64()))
        }
    })
}
