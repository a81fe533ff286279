//! What can go wrong with a corpus.

use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::schema::FORMAT;

/// Why a corpus cannot be written or read. Messages name the file and the remedy.
#[derive(Debug, Error)]
pub enum DataError {
    /// No such file or folder.
    #[error("{path}: no such {what}{from}", path = .0.display(), what = .1, from = looked_from(.0))]
    Missing(PathBuf, &'static str),
    /// A folder where a corpus is asked for.
    #[error("{path}: a folder, not a corpus; make one of the files in it: riglab dataset import {quoted} -o corpus.h5", path = .0.display(), quoted = shell_words::quote(&.0.display().to_string()))]
    NoCorpus(PathBuf),
    /// A file where a folder is asked for.
    #[error("{path}: a file; give the folder it is in", path = .0.display())]
    NoFolder(PathBuf),
    /// The file system refused.
    #[error("{path}: {message}", path = path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What happened.
        message: String,
    },
    /// HDF5 refused to write.
    #[error("{path}: the corpus cannot be written ({message}); is the disk full?", path = path.display())]
    Write {
        /// The corpus.
        path: PathBuf,
        /// HDF5's message.
        message: String,
    },
    /// No HDF5 file, or one that was cut off.
    #[error("{path}: no readable HDF5 file ({message}); it may be cut off: import it again", path = path.display())]
    NotHdf5 {
        /// The file.
        path: PathBuf,
        /// HDF5's message.
        message: String,
    },
    /// A file of another kind.
    #[error("{path}: not a corpus; `riglab dataset import FOLDER -o corpus.h5` makes one of rigged files", path = .0.display())]
    OtherKind(PathBuf),
    /// An HDF5 file of another kind, as Puppeteer's.
    #[error("{path}: an HDF5 file, but no corpus (attribute `format` is not `{FORMAT}`); `riglab dataset import` makes one", path = .0.display())]
    OtherHdf5(PathBuf),
    /// A corpus of another version, or with parts that are missing.
    #[error("{path}: an HDF5 file, but no corpus that this version reads ({message}); `riglab dataset import` makes one", path = path.display())]
    NotCorpus {
        /// The file.
        path: PathBuf,
        /// What is missing.
        message: String,
    },
    /// A dataset that claims far more rows than the file has.
    #[error("{path}: its dataset `{name}` is damaged: it claims the shape {shape:?}, of which {stored} bytes are stored; import the corpus again", path = path.display())]
    Overstated {
        /// The file.
        path: PathBuf,
        /// The dataset.
        name: String,
        /// What it says.
        shape: Vec<usize>,
        /// Bytes that are there.
        stored: u64,
    },
    /// An asset whose rows cannot be read or are no rig.
    #[error("{path}: asset {index} (`{name}`) is damaged: {message}; import the corpus again", path = path.display())]
    Damaged {
        /// The corpus.
        path: PathBuf,
        /// The asset's number.
        index: usize,
        /// Its name.
        name: String,
        /// What is wrong.
        message: String,
    },
    /// An asset that could not be changed as asked.
    #[error("{path}: asset `{name}`: {message}", path = path.display())]
    Refused {
        /// The corpus.
        path: PathBuf,
        /// The asset.
        name: String,
        /// Why.
        message: String,
    },
    /// A corpus that would be written over itself.
    #[error("{path}: this corpus is the input; give another file to write", path = .0.display())]
    Same(PathBuf),
    /// Two assets of one name.
    #[error("two assets are named `{0}`; `riglab dataset merge --prefix` puts its corpus' name before each asset's")]
    DuplicateName(String),
    /// Two assets of one name in one corpus.
    #[error("{path}: two assets in it are named `{name}`, and names tell assets apart; import the corpus again, or merge those it was made of", path = path.display())]
    NamedTwice {
        /// The corpus.
        path: PathBuf,
        /// The name.
        name: String,
    },
    /// A folder without a file to import.
    #[error("{path}: no rigged file (GLB, glTF, VRM, FBX, rig text with OBJ, npz, h5, pt) in this folder or below it; `riglab dataset import --meshes` takes models without a rig", path = .0.display())]
    NothingToImport(PathBuf),
    /// No model in a folder.
    #[error("{path}: no model in it (GLB, glTF, VRM, FBX, OBJ, PLY or STL)", path = .0.display())]
    NoModels(PathBuf),
    /// Every file was refused.
    #[error("{path}: none of the {count} files could be imported; the first: {first}", path = path.display())]
    AllRefused {
        /// The folder.
        path: PathBuf,
        /// How many.
        count: usize,
        /// The first refusal.
        first: String,
    },
    /// A split file that is no split file.
    #[error("{path}: {message}; expected JSON like {{\"train\": [\"a.glb\", ...], \"val\": [...]}}", path = path.display())]
    BadSplit {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
}

/// Where a path leads from that is none from the root.
fn looked_from(path: &Path) -> String {
    match std::env::current_dir() {
        Ok(here) if path.is_relative() => format!(" (looked for from the folder {})", here.display()),
        _ => String::new(),
    }
}

impl DataError {
    pub(crate) fn io(path: &Path, e: impl std::fmt::Display) -> Self {
        Self::Io { path: path.into(), message: e.to_string() }
    }

    pub(crate) fn damaged(path: &Path, index: usize, name: &str, e: impl std::fmt::Display) -> Self {
        Self::Damaged { path: path.into(), index, name: name.into(), message: e.to_string() }
    }
}
