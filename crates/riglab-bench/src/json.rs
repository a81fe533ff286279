//! Rows in a file.

use std::path::Path;

use anyhow::{Context, Result};

use crate::row::Row;

/// Writes a list of rows, a line each; the file is complete or as it was.
pub fn write(path: &Path, rows: &[Row]) -> Result<()> {
    let lines: Result<Vec<String>, _> = rows.iter().map(serde_json::to_string).collect();
    let text = format!("[\n{}\n]\n", lines?.join(",\n"));
    riglab_files::write(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}
