//! Near-duplicates among many descriptions of rigs, against comparing all pairs by numpy.
//!
//! Both sides get the same descriptions, real ones varied: a tenth are near copies. Theirs compares blocks of
//! rows, one number after another, and leaves a pair at the first that differs: the fastest that numpy does.

use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use riglab_asset::{ImportOptions, import};
use riglab_curate::{Shape, TOLERANCE, pairs};
use riglab_data::rigged_files;
use riglab_random::{Draw, stream};
use serde::Deserialize;
use serde_json::json;

use super::Context;
use crate::python::ARRAYS;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const ROUNDS: usize = 3;
/// Rigs compared by both sides; all pairs of many more take minutes.
const RIGS: usize = 10_000;
/// Rigs that ours compares besides, for how its cost grows.
const MANY: usize = 100_000;

/// Seconds, and pairs found.
#[derive(Deserialize)]
struct Found {
    seconds: f64,
    pairs: usize,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(rigs) = recipe::rigs() else { return Ok(vec![Row::skipped("curate/dedup", recipe::NO_RIGS)]) };
    let path = context.path("shapes.i32");
    let (mut ours, mut theirs) = (context.ours("dedup")?, ARRAYS.start("dedup.py")?);
    let columns: usize = ours.ask(&json!({"do": "make", "rigs": rigs, "path": path, "count": RIGS}))?;
    theirs.ask::<usize>(&json!({"do": "load", "path": path, "columns": columns}))?;
    let find = json!({"do": "find", "count": RIGS});
    let plain = json!({"do": "find", "tolerance": (f64::from(TOLERANCE) * 1e6) as i64});
    let (a, b): (Found, Found) = (ours.ask(&find)?, theirs.ask(&plain)?);
    ensure!(a.pairs == b.pairs && a.pairs >= RIGS / 20, "ours finds {} pairs, theirs {}", a.pairs, b.pairs);
    let found = in_turn(
        context.rounds(ROUNDS),
        || Ok(ours.ask::<Found>(&find)?.seconds),
        || Ok(theirs.ask::<Found>(&plain)?.seconds),
    )?;
    let many: Found = ours.ask(&json!({"do": "find", "count": MANY}))?;
    let (a, b) = found.medians();
    let note = format!("{RIGS} rigs; ours takes {:.2} s for {MANY}; {}", many.seconds, found.spread());
    Ok(vec![Row::new("curate/dedup", a, b, "s", Better::Lower).note(note)])
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Make { rigs: std::path::PathBuf, path: std::path::PathBuf, count: usize },
    Find { count: usize },
}

/// riglab's side: descriptions in memory, pairs found.
pub fn serve() -> Result<()> {
    let mut shapes: Vec<Shape> = Vec::new();
    side::serve(|request| match request {
        Request::Make { rigs, path, count } => {
            let files = rigged_files(&rigs)?;
            let read = |file| import(file, &ImportOptions::default()).ok()?.rig().map(Shape::of);
            shapes = varied(&files.iter().filter_map(read).collect::<Vec<_>>(), MANY);
            let columns = shapes.first().context("no file gives a rig")?.values.len() + 1;
            let row = |s: &Shape| [vec![s.joints as i32], s.values.clone()].concat();
            let bytes: Vec<u8> = shapes[..count].iter().flat_map(row).flat_map(i32::to_le_bytes).collect();
            std::fs::write(path, bytes)?;
            Ok(json!(columns))
        }
        Request::Find { count } => {
            let start = Instant::now();
            let found = pairs(&shapes[..count.min(shapes.len())], TOLERANCE);
            Ok(json!({"seconds": start.elapsed().as_secs_f64(), "pairs": found.len()}))
        }
    })
}

/// Many descriptions of a few: each number moved by up to a tenth of a unit, a tenth of them near copies of
/// the one before.
fn varied(real: &[Shape], count: usize) -> Vec<Shape> {
    let mut all: Vec<Shape> = Vec::with_capacity(count);
    for i in 0..count {
        let mut rng = stream(0, "bench/dedup", &[i as u64]);
        let (of, reach) = if i % 10 == 9 { (&all[i - 1], 500.0) } else { (&real[i % real.len()], 100_000.0) };
        let values = of.values.iter().map(|v| v + (reach * (rng.unit() - 0.5)) as i32).collect();
        all.push(Shape { joints: of.joints, values });
    }
    all
}
