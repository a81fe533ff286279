//! Why a review cannot begin.

use std::path::PathBuf;

use riglab_curate::CurateError;
use riglab_data::DataError;
use thiserror::Error;

/// What stands in the way. Messages name the file and the remedy.
#[derive(Debug, Error)]
pub enum ReviewError {
    /// The corpus, or the folder of files.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The file of decisions.
    #[error(transparent)]
    Decisions(#[from] CurateError),
    /// The list of a curation holds a line that is none.
    #[error("{path}:{line}: {message}; run `riglab curate` again", path = path.display())]
    List {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// The file system refused.
    #[error("{path}: {message}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What happened.
        message: String,
    },
    /// There is nothing to look at.
    #[error("{path}: nothing to review; {why}", path = path.display())]
    Nothing {
        /// The corpus.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// The port is taken, or the like.
    #[error("port {port} of 127.0.0.1: {message}; give another --port, or none for any that is free")]
    Port {
        /// Which.
        port: u16,
        /// What happened.
        message: String,
    },
    /// The system gives no random numbers for the token.
    #[error("no random numbers for the token of the address: {0}")]
    Random(String),
}
