//! Why a training run ends early.

use std::path::{Path, PathBuf};

use riglab_nn::NnError;
use riglab_ranks::RanksError;
use thiserror::Error;

/// A run that could not begin or go on. What was written before stays.
#[derive(Debug, Error)]
pub enum TrainError {
    /// The file system refused.
    #[error("{path}: {message}", path = path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What happened, and what can be done.
        message: String,
    },
    /// A setting that cannot be.
    #[error("{message}")]
    Config {
        /// The key it is about, relative to `train`.
        key: String,
        /// What is wrong.
        message: String,
    },
    /// The network or libtorch refused.
    #[error(transparent)]
    Nn(#[from] NnError),
    /// A checkpoint that cannot be continued from.
    #[error("{path}: {message}", path = path.display())]
    Checkpoint {
        /// The checkpoint or run.
        path: PathBuf,
        /// What is wrong, and what can be done.
        message: String,
    },
    /// The loss or its gradient stayed not finite.
    #[error("{0}")]
    NotFinite(String),
    /// The task refused.
    #[error("{0}")]
    Task(String),
    /// Another rank ended, or cannot be understood.
    #[error(transparent)]
    Ranks(#[from] RanksError),
}

impl TrainError {
    pub(crate) fn io(path: &Path, doing: &str, e: &std::io::Error) -> Self {
        let full = e.kind() == std::io::ErrorKind::StorageFull;
        let hint = if full { "; free space and resume the run" } else { "" };
        Self::Io { path: path.into(), message: format!("cannot {doing} ({e}){hint}") }
    }
}
