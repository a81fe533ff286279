//! Why nothing can be compared.

use std::path::PathBuf;

use riglab_data::DataError;
use thiserror::Error;

/// Why a comparison cannot begin.
#[derive(Debug, Error)]
pub enum CompareError {
    /// The corpus, or the folder of true rigs.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The folder of predictions.
    #[error("{0}: no such folder or file of predictions")]
    NoPredictions(PathBuf),
    /// A folder without a file of the kind asked for.
    #[error("{folder}: no {kind} file below it; --format auto takes glb, gltf, vrm, fbx, rig texts, npz, h5 and pt")]
    NothingOfKind {
        /// The folder.
        folder: PathBuf,
        /// The kind.
        kind: &'static str,
    },
    /// A file that is not called like one of the kind asked for.
    #[error("{file}: by its name this is no {kind} file; leave --format out to have it read as what it is")]
    OtherKind {
        /// The file.
        file: PathBuf,
        /// The kind.
        kind: &'static str,
    },
    /// No true rig.
    #[error("{0}: no true rig to compare with{1}")]
    NoTruth(PathBuf, String),
    /// A split of files, which have none.
    #[error(
        "--split: only a corpus has splits, and {path} is none; leave --split out, or make a corpus of the files: \
         riglab dataset import FOLDER -o truth.h5", path = .0.display()
    )]
    NoSplits(PathBuf),
    /// A split that the corpus does not have.
    #[error("{path}: no split `{split}` in this corpus; {there}", path = path.display())]
    NoSplit {
        /// The corpus.
        path: PathBuf,
        /// The split.
        split: String,
        /// Those that it has, in words.
        there: String,
    },
    /// Not one name of the truth among the predictions.
    #[error(
        "{folder}: none of its {found} is named like a true asset: it has for instance `{theirs}`, \
         the truth `{ours}`; files are matched by their path without the extension, or by their name only{elsewhere}"
    )]
    NothingMatches {
        /// The folder.
        folder: PathBuf,
        /// How many predictions there are, in words.
        found: String,
        /// One of them.
        theirs: String,
        /// A true asset.
        ours: String,
        /// How many of the predictions are of other splits of the corpus, if some are, in words.
        elsewhere: String,
    },
}
