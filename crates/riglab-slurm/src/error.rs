//! Why Slurm does not do what is asked.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why Slurm does not do what is asked.
#[derive(Debug, Error)]
pub enum SlurmError {
    /// A program of Slurm's is not there.
    #[error(
        "there is no Slurm on this machine: `{0}` is not in the path\n\nhint: call it where jobs are submitted, a login \
         node for one, or leave out `--on slurm`"
    )]
    Missing(&'static str),
    /// A program of Slurm's said no.
    #[error("{program} refuses: {said}")]
    Refused {
        /// The program.
        program: &'static str,
        /// Its words.
        said: String,
    },
    /// A program of Slurm's said what cannot be understood.
    #[error("{program} answered `{said}`, which is not understood")]
    Unclear {
        /// The program.
        program: &'static str,
        /// Its words.
        said: String,
    },
    /// The cluster takes no arrays.
    #[error("this Slurm takes no job arrays (MaxArraySize is {0}); ask its administrators, or run here without --on")]
    NoArrays(usize),
    /// A path that a job script cannot name.
    #[error("{0:?} cannot stand in a job script: a name there may have no line ends and must be UTF-8")]
    Unnamable(PathBuf),
    /// A file of ours.
    #[error("{path} cannot be {what}: {reason}")]
    Io {
        /// The file.
        path: PathBuf,
        /// `read`, `written`.
        what: &'static str,
        /// The system's words.
        reason: String,
    },
}

impl SlurmError {
    pub(crate) fn io(path: &Path, what: &'static str, e: &io::Error) -> Self {
        Self::Io { path: path.into(), what, reason: e.to_string() }
    }
}
