//! Reading rigged files, against Blender's importer.
//!
//! `import`: one thread against one process of Blender; `import/all_cores`: as many threads against
//! as many processes. Blender's scene is emptied between files outside the time that counts.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Result, ensure};
use riglab_asset::{ImportOptions, import};
use riglab_data::rigged_files;
use serde::Deserialize;
use serde_json::{Value, json};

use super::Context;
use crate::python::BLENDER;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side::{self, Side};

/// Files unless all are asked for: Blender takes a minute for a few hundred.
const SAMPLE: usize = 60;

/// What a side says of reading files.
#[derive(Deserialize)]
pub(super) struct Read {
    /// For all of them.
    pub(super) seconds: f64,
    /// Files that gave nothing.
    pub(super) refused: Vec<PathBuf>,
    memory_mb: f64,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(rigs) = recipe::rigs() else { return Ok(vec![Row::skipped("import", recipe::NO_RIGS)]) };
    let every = rigged_files(&rigs)?;
    let files = if context.all { every.clone() } else { sample(&every, SAMPLE) };
    let (mut ours, mut theirs) = (context.ours("import")?, BLENDER.start("import_gltf.py")?);
    // The first time fills the page cache, and finds files that a side refuses.
    let one = json!({"do": "read", "files": files, "threads": 1});
    let (a, b): (Read, Read) = (ours.ask(&one)?, theirs.ask(&json!({"do": "read", "files": files}))?);
    let files: Vec<&PathBuf> = files.iter().filter(|f| !a.refused.contains(f) && !b.refused.contains(f)).collect();
    ensure!(!files.is_empty(), "no file is read by both sides");
    let note = format!(
        "{} of {} files; refused by ours {}, by theirs {}",
        files.len(),
        every.len(),
        a.refused.len(),
        b.refused.len()
    );
    let per_file = |seconds: f64| 1e3 * seconds / files.len() as f64;
    let one = json!({"do": "read", "files": files, "threads": 1});
    let plain = json!({"do": "read", "files": files});
    let mut memory = (0.0f64, 0.0f64);
    let found = in_turn(
        context.rounds(3),
        || {
            let r: Read = ours.ask(&one)?;
            memory.0 = r.memory_mb;
            Ok(per_file(r.seconds))
        },
        || {
            let r: Read = theirs.ask(&plain)?;
            memory.1 = r.memory_mb;
            Ok(per_file(r.seconds))
        },
    )?;
    let (a, b) = found.medians();
    let mut rows = vec![
        Row::new("import", a, b, "ms/file", Better::Lower).bar(20.0).note(format!("{note}; {}", found.spread())),
        Row::new("import/memory", memory.0, memory.1, "MB", Better::Lower),
    ];
    if context.threads > 1 {
        rows.push(all_cores(context, &files, ours, theirs)?);
    }
    Ok(rows)
}

fn all_cores(context: &Context, files: &[&PathBuf], mut ours: Side, first: Side) -> Result<Row> {
    let n = context.threads;
    let mut others: Vec<Side> = vec![first];
    for _ in 1..n {
        others.push(BLENDER.start("import_gltf.py")?);
    }
    let parts: Vec<Value> =
        (0..n).map(|k| json!({"do": "read", "files": files.iter().skip(k).step_by(n).collect::<Vec<_>>()})).collect();
    let shared = json!({"do": "read", "files": files, "threads": n});
    let per_file = |seconds: f64| 1e3 * seconds / files.len() as f64;
    let mut theirs = || {
        others.iter_mut().zip(&parts).try_for_each(|(side, part)| side.send(part))?;
        let reads: Vec<Read> = others.iter_mut().map(Side::answer).collect::<Result<_>>()?;
        // The slowest decides.
        Ok(per_file(reads.iter().map(|r| r.seconds).fold(0.0, f64::max)))
    };
    theirs()?; // the new processes' first files
    let found = in_turn(context.rounds(3), || Ok(per_file(ours.ask::<Read>(&shared)?.seconds)), theirs)?;
    let (a, b) = found.medians();
    let note = format!("{n} threads against {n} processes; {}", found.spread());
    Ok(Row::new("import/all_cores", a, b, "ms/file", Better::Lower).note(note))
}

/// `count` files spread over all, the same ones each time: sorted by name, every n-th.
fn sample(files: &[PathBuf], count: usize) -> Vec<PathBuf> {
    if files.len() <= count {
        return files.to_vec();
    }
    (0..count).map(|i| files[i * files.len() / count].clone()).collect()
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Read { files: Vec<PathBuf>, threads: usize },
}

/// riglab's side: each file read, checked and made a valid rig.
pub fn serve() -> Result<()> {
    side::serve(|Request::Read { files, threads }| {
        let (next, start) = (AtomicUsize::new(0), Instant::now());
        let work = || {
            let mut refused = Vec::new();
            while let Some(file) = files.get(next.fetch_add(1, Ordering::Relaxed)) {
                if import(file, &ImportOptions::default()).and_then(riglab_asset::Imported::into_asset).is_err() {
                    refused.push(file.clone());
                }
            }
            refused
        };
        let refused: Vec<PathBuf> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
            threads.into_iter().flat_map(|t| t.join().expect("import does not panic")).collect()
        });
        let seconds = start.elapsed().as_secs_f64();
        Ok(json!({"seconds": seconds, "refused": refused, "memory_mb": side::peak_memory_mb()}))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_spread_and_without_repeats() {
        let files: Vec<PathBuf> = (0..311).map(|i| format!("{i:03}").into()).collect();
        let mut some = sample(&files, 60);
        assert_eq!((some.len(), some[0].clone()), (60, files[0].clone()));
        some.dedup();
        assert_eq!(some.len(), 60);
        assert_eq!(sample(&files[..3], 60), files[..3]);
    }
}
