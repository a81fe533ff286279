//! Attempts that failed, and wishes to try again: the one thing of a job that its run folder cannot tell.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Job, Plan, State, SweepError};

/// What stands for the stage in a line by which a job is tried again.
const RETRY: &str = "retry";

/// An attempt that failed, or the wish to try again, after which a job's attempts before count no more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// The job's number.
    pub job: usize,
    /// `train` or `eval`; `slurm` where the cluster ended it; `retry` for the wish.
    pub stage: String,
    /// Why.
    pub reason: String,
    /// Whether it is the last, however few there were.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub given_up: bool,
}

fn file(folder: &Path) -> PathBuf {
    folder.join("attempts.jsonl")
}

/// Those of a sweep; a line that was cut off by a kill is left out, so that its attempt is made again.
pub fn attempts(folder: &Path) -> Vec<Attempt> {
    let text = std::fs::read_to_string(file(folder)).unwrap_or_default();
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// Those of a job that count: what failed since it was last asked for.
pub(crate) fn counted(attempts: &[Attempt], job: usize) -> Vec<&Attempt> {
    let own: Vec<&Attempt> = attempts.iter().filter(|a| a.job == job).collect();
    let asked = own.iter().rposition(|a| a.stage == RETRY);
    own[asked.map_or(0, |k| k + 1)..].to_vec()
}

/// Has failed jobs tried again; how many they are. The lines of what failed stay: submissions to a cluster count them.
///
/// # Errors
/// When the list cannot be written.
pub fn retry(folder: &Path, plan: &Plan) -> Result<usize, SweepError> {
    let known = attempts(folder);
    let failed = plan.jobs.iter().filter(|job| matches!(State::of(folder, plan, job, &known), State::Failed(_)));
    let mut count = 0;
    for job in failed {
        again(folder, job)?;
        count += 1;
    }
    Ok(count)
}

/// Has a job tried again, whatever has become of it.
pub(crate) fn again(folder: &Path, job: &Job) -> Result<(), SweepError> {
    record(folder, &Attempt { job: job.number, stage: RETRY.into(), reason: String::new(), given_up: false })
}

/// Adds one to the sweep's list. Several processes, of several machines, may do so at a time.
///
/// # Errors
/// When the list cannot be written.
pub fn record(folder: &Path, attempt: &Attempt) -> Result<(), SweepError> {
    let path = file(folder);
    let opened = OpenOptions::new().create(true).append(true).open(&path);
    let mut list = opened.map_err(|e| SweepError::io(&path, "written", &e))?;
    // Where it is shared by machines, appending alone may overwrite; where it cannot be locked, there is one machine.
    let _ = list.lock();
    // A line that was cut off must not swallow this one.
    let whole = std::fs::read(&path).map_or(true, |bytes| bytes.last().is_none_or(|b| *b == b'\n'));
    let line = serde_json::to_string(attempt).map_err(|e| SweepError::Invalid(e.to_string()))?;
    let line = format!("{}{line}\n", if whole { "" } else { "\n" });
    let written = list.write_all(line.as_bytes()).and_then(|()| list.sync_data());
    written.map_err(|e| SweepError::io(&path, "written", &e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_cut_off_costs_nothing_but_itself() {
        let dir = tempfile::tempdir().unwrap();
        let attempt = |job| Attempt { job, stage: "train".into(), reason: "a \"b\"".into(), given_up: job == 3 };
        record(dir.path(), &attempt(1)).unwrap();
        std::fs::OpenOptions::new().append(true).open(file(dir.path())).unwrap().write_all(b"{\"job\":2").unwrap();
        record(dir.path(), &attempt(3)).unwrap();
        assert_eq!(attempts(dir.path()), [attempt(1), attempt(3)]);
    }
}
