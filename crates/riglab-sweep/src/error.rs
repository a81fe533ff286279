//! Why a sweep cannot go on.

use std::io;
use std::path::{Path, PathBuf};

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
    /// The folder belongs to another sweep.
    #[error(
        "{folder} holds another sweep: {difference}\n\nhint: go on with that one by `riglab sweep {folder}`, or \
         give this one a folder of its own with -o"
    )]
    Another {
        /// The folder.
        folder: PathBuf,
        /// What differs first.
        difference: String,
    },
    /// Two processes at one sweep.
    #[error("{0}: another process is at this sweep; look at it with --status")]
    Held(PathBuf),
}

impl SweepError {
    pub(crate) fn io(path: &Path, what: &'static str, e: &io::Error) -> Self {
        Self::Io { path: path.into(), what, reason: e.to_string() }
    }
}
