//! What can go wrong with a curation as a whole; what is wrong with one asset is a line of the report.

use std::io;
use std::path::{Path, PathBuf};

use riglab_data::DataError;
use thiserror::Error;

use crate::decisions::Decision;

/// Why a curation cannot go on. Messages name the file and the remedy.
#[derive(Debug, Error)]
pub enum CurateError {
    /// Files or corpora.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The file system refused.
    #[error("{path}: {message}", path = path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What happened.
        message: String,
    },
    /// The disk is full, or nobody may write there.
    #[error("{path}: cannot be written ({message}); {remedy}", path = path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What happened.
        message: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A file of decisions with a line that is none.
    #[error("{path}:{line}: {message}", path = path.display())]
    Decision {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// Another server keeps its decisions in the file.
    #[error("{path}: another `riglab review` keeps its decisions here; use its page, end it, or give another --decisions", path = .0.display())]
    Held(PathBuf),
    /// Somebody else decided about an asset meanwhile.
    #[error("`{name}` was decided elsewhere in the meantime")]
    Newer {
        /// The asset.
        name: String,
        /// What was decided.
        decision: Box<Decision>,
    },
    /// A corpus that is to be merged as a shard, without the journal of its curation.
    #[error("{path}: there is no journal of a curation; --merge takes the corpora of `riglab curate --shard`, with what it wrote beside them: `riglab dataset merge` takes any", path = .0.display())]
    NoJournal(PathBuf),
    /// Two assets of one name that are not of one file.
    #[error("{first} and {second} each have an asset `{name}`, of different files; --merge takes the shards of one folder: `riglab dataset merge --prefix` takes the corpora of several, or curate a folder that holds both", first = first.display(), second = second.display())]
    Unlike {
        /// The asset.
        name: String,
        /// One corpus.
        first: PathBuf,
        /// Another.
        second: PathBuf,
    },
    /// Files that were others when they were read for the second time.
    #[error("{path}: {count} changed while they were curated, `{first}` for one; run the same command again", path = path.display())]
    Changed {
        /// The corpus.
        path: PathBuf,
        /// How many, in words.
        count: String,
        /// One of the assets.
        first: String,
        /// The files.
        files: Vec<String>,
    },
    /// A corpus that is to be merged, with a journal of later files beside it.
    #[error("{path}: holds `{name}` as it was before its file or the settings changed, as a curation that was broken off leaves it; run that curation again to its end, then merge", path = path.display())]
    Older {
        /// The corpus.
        path: PathBuf,
        /// One of the assets.
        name: String,
    },
    /// The folder beside the corpus is that of another corpus.
    #[error("{path}: {work} beside it is that of {other}, whose journal and report would be lost; give another --out, or move these two away", path = path.display(), work = work.display(), other = other.display())]
    OfAnother {
        /// The corpus.
        path: PathBuf,
        /// The folder.
        work: PathBuf,
        /// The corpus whose it is.
        other: PathBuf,
    },
    /// Another run works in the folder.
    #[error("{path}: another curation is at work here; wait for it, or give another --out", path = .0.display())]
    Busy(PathBuf),
    /// Nothing passed all stages.
    #[error("none of the {assets} assets passed; {report} says why{stays}", report = report.display(), stays = stays(.older.as_deref()))]
    NothingLeft {
        /// How many there were.
        assets: usize,
        /// The report.
        report: PathBuf,
        /// The corpus of an earlier curation, which is still there.
        older: Option<PathBuf>,
    },
    /// The report cannot be made.
    #[error(transparent)]
    Report(#[from] riglab_report::ReportError),
}

/// What is said of an older corpus beside a newer report.
fn stays(older: Option<&Path>) -> String {
    older.map_or_else(String::new, |corpus| {
        format!("; {} is of an earlier curation and stays, though the report is not about it", corpus.display())
    })
}

impl CurateError {
    pub(crate) fn io(path: &Path, e: impl std::fmt::Display) -> Self {
        Self::Io { path: path.into(), message: e.to_string() }
    }

    /// What the file system refused to write.
    pub fn write(path: &Path, e: &io::Error) -> Self {
        use io::ErrorKind::{NotADirectory, PermissionDenied, ReadOnlyFilesystem};
        // In words alone, where it is the system's.
        let message = e.raw_os_error().map_or_else(|| e.to_string(), |_| e.kind().to_string());
        let remedy = match e.kind() {
            PermissionDenied | ReadOnlyFilesystem | NotADirectory => {
                "give a place where you may write, or make this one so"
            }
            _ => "what is finished is kept, so make room and run the same command again",
        };
        Self::Write { path: path.into(), message, remedy }
    }
}
