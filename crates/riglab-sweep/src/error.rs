//! Why a sweep cannot go on.

use std::io;
use std::path::{Path, PathBuf};

use riglab_report::shell::command;
use thiserror::Error;

/// Why a sweep cannot begin or go on.
#[derive(Debug, Error)]
pub enum SweepError {
    /// A file of the sweep's folder.
    #[error("{path} cannot be {what}: {reason}")]
    Io {
        /// The file.
        path: PathBuf,
        /// `read`, `written`, `started`.
        what: &'static str,
        /// The system's words.
        reason: String,
    },
    /// A file of the sweep's folder that makes no sense.
    #[error("{path} cannot be understood: {reason}")]
    Unclear {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The sweep file.
    #[error("{0}")]
    Invalid(String),
    /// A key of the sweep file.
    #[error("`sweep.{key}`: {message}")]
    Key {
        /// The key, below `sweep`.
        key: String,
        /// What is wrong with it.
        message: String,
    },
    /// The folder belongs to another sweep.
    #[error(
        "{folder} holds another sweep: {difference}\n\nhint: arms and seeds can be added to it, and arms of which \
         every job failed be changed, under the same name; go on with that one by `{again}`, or give this one a folder of \
         its own with -o",
        again = command(["sweep", &folder.to_string_lossy()])
    )]
    Another {
        /// The folder.
        folder: PathBuf,
        /// What differs first.
        difference: String,
    },
    /// Jobs of the folder were written with other settings than they would be now.
    #[error(
        "{folder} holds jobs of other settings: {job} has {before}, where it would now have {after}; put the old value \
         back, go on as it was by `{again}`, or give the sweep a folder of its own with -o",
        again = command(["sweep", &folder.to_string_lossy()])
    )]
    Changed {
        /// The folder.
        folder: PathBuf,
        /// The first such job.
        job: String,
        /// What it has.
        before: String,
        /// What it would have.
        after: String,
    },
    /// A corpus is not what jobs have read already.
    #[error(
        "{corpus} has changed: {read} read it when its checksum was {before}, and {left} would read it with {after}; put \
         the old file back, or give the sweep a folder of its own with -o"
    )]
    Corpus {
        /// The corpus.
        corpus: String,
        /// A job that has read it.
        read: String,
        /// Its checksum then.
        before: String,
        /// A job that is still to be done.
        left: String,
        /// Its checksum now.
        after: String,
    },
    /// Two processes at one sweep.
    #[error("{0}: another process is running this sweep; --status shows how far it is")]
    Held(PathBuf),
    /// Two processes at the evaluation of one run.
    #[error(
        "{0}: another process is evaluating this run, and would write over what this one finds; wait until it has ended, \
         or give another file with --out"
    )]
    Evaluated(PathBuf),
}

impl SweepError {
    pub(crate) fn io(path: &Path, what: &'static str, e: &io::Error) -> Self {
        Self::Io { path: path.into(), what, reason: e.to_string() }
    }
}
