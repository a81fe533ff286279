//! Reading rigged files, against the libraries that Python users read their arrays with.
//!
//! Ours makes valid rigs: placed at rest, checked, one tree. Theirs stop at the arrays: all of them by
//! pygltflib and numpy, or positions and triangles by trimesh and the rest by numpy.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use riglab_data::rigged_files;
use serde_json::json;

use super::Context;
use super::import::Read;
use crate::python::ARRAYS;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};

/// Rounds over all files: 311 files four times are the thousand imports of the bar.
const ROUNDS: usize = 4;

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(rigs) = recipe::rigs() else { return Ok(vec![Row::skipped("import/trimesh", recipe::NO_RIGS)]) };
    let every = rigged_files(&rigs)?;
    let (mut ours, mut theirs) = (context.ours("import")?, ARRAYS.start("import_arrays.py")?);
    let mut rows = Vec::new();
    for reader in ["trimesh", "pygltflib"] {
        // The first time fills the page cache, and finds files that a side refuses.
        let a: Read = ours.ask(&json!({"do": "read", "files": every, "threads": 1}))?;
        let b: Read = theirs.ask(&json!({"do": "read", "reader": reader, "files": every}))?;
        let files: Vec<&PathBuf> = every.iter().filter(|f| !a.refused.contains(f) && !b.refused.contains(f)).collect();
        ensure!(!files.is_empty(), "no file is read by both sides");
        let per_file = |seconds: f64| 1e3 * seconds / files.len() as f64;
        let one = json!({"do": "read", "files": files, "threads": 1});
        let plain = json!({"do": "read", "reader": reader, "files": files});
        let found = in_turn(
            context.rounds(ROUNDS),
            || Ok(per_file(ours.ask::<Read>(&one)?.seconds)),
            || Ok(per_file(theirs.ask::<Read>(&plain)?.seconds)),
        )?;
        let (a, b) = found.medians();
        let note = format!("{} of {} files, those that both read; {}", files.len(), every.len(), found.spread());
        rows.push(Row::new(format!("import/{reader}"), a, b, "ms/file", Better::Lower).bar(5.0).note(note));
    }
    Ok(rows)
}
