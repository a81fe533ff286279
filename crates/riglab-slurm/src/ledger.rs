//! Which jobs were submitted for a folder.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::SlurmError;

/// A job that was submitted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Submission {
    /// Its id.
    pub job: String,
    /// What it does: `sweep`, `train`, `curate`, `merge`.
    pub what: String,
    /// What is added to the numbers of its array's tasks to have those of the work.
    #[serde(default)]
    pub offset: usize,
    /// Numbers of the work that its tasks do.
    #[serde(default)]
    pub numbers: Vec<usize>,
    /// Failed attempts that were known when it was submitted.
    #[serde(default)]
    pub failures: usize,
}

/// Those that a file lists, in order.
pub fn submissions(file: &Path) -> Vec<Submission> {
    lines(file)
}

/// Adds one to a file.
///
/// # Errors
/// When it cannot be written.
pub fn record(file: &Path, submission: &Submission) -> Result<(), SlurmError> {
    append(file, submission)
}

/// What a file of JSON lines holds; a line that was cut off is left out.
pub(crate) fn lines<T: DeserializeOwned>(file: &Path) -> Vec<T> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// Appends a line; a folder that is not there is made.
pub(crate) fn append(file: &Path, line: &impl Serialize) -> Result<(), SlurmError> {
    let fault = |e: std::io::Error| SlurmError::io(file, "written", &e);
    riglab_files::make_folder_of(file).map_err(fault)?;
    let text = serde_json::to_string(line).map_err(|e| fault(e.into()))?;
    // A line that was cut off must not swallow this one.
    let whole = std::fs::read(file).map_or(true, |bytes| bytes.last().is_none_or(|b| *b == b'\n'));
    let text = format!("{}{text}\n", if whole { "" } else { "\n" });
    let opened = OpenOptions::new().create(true).append(true).open(file);
    opened.and_then(|mut f| f.write_all(text.as_bytes()).and_then(|()| f.sync_data())).map_err(fault)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn submissions_are_kept_in_order_and_a_cut_line_costs_only_itself() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("slurm/jobs.jsonl");
        let job =
            |id: &str| Submission { job: id.into(), what: "sweep".into(), offset: 0, numbers: vec![1, 2], failures: 3 };
        assert!(submissions(&file).is_empty());
        record(&file, &job("7")).unwrap();
        OpenOptions::new().append(true).open(&file).unwrap().write_all(b"{\"job\":\"8\"").unwrap();
        record(&file, &job("9")).unwrap();
        assert_eq!(submissions(&file), [job("7"), job("9")]);
    }
}
