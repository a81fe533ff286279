//! Files of several assets, filled one by one: in memory is the one that is added.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use riglab_core::Asset;
use riglab_files::Unfinished;

use super::target::{Reach, Target};
use super::{WriteError, WriteNote};

/// A file of a format that is being filled.
pub(crate) trait Fills {
    /// What no file of the format holds of any asset.
    fn lacks(&self) -> Option<&'static str> {
        None
    }

    /// Writes what comes of the next asset, or keeps it; what is not in the file is told in `notes`.
    fn add(&mut self, asset: &Asset, notes: &mut Vec<WriteNote>) -> Result<(), Fault>;

    /// Writes what comes last; `count` assets were added.
    fn end(self: Box<Self>, count: usize) -> Result<File, Fault>;
}

/// How a format begins a file that will stand at a path.
pub(crate) type Begin = fn(File, &Path) -> io::Result<Box<dyn Fills>>;

/// Why a file is not filled.
pub(crate) enum Fault {
    /// The format cannot say it.
    Cannot(String),
    /// The file system refused.
    Io(io::Error),
}

impl From<io::Error> for Fault {
    fn from(e: io::Error) -> Self {
        Self::Io(e)
    }
}

/// A file of several assets that is filled one by one. It is at its path once it is whole; dropped before, it leaves nothing.
pub struct Filling {
    target: Target,
    path: PathBuf,
    file: Box<dyn Fills>,
    unfinished: Unfinished,
    notes: Vec<WriteNote>,
    count: usize,
    reach: Reach,
}

impl Filling {
    /// Without assets.
    ///
    /// # Errors
    /// [`WriteError::One`] for a format of one asset a file, [`WriteError::Io`] when the file system refuses.
    pub fn new(path: impl AsRef<Path>, target: Target) -> Result<Self, WriteError> {
        let path = path.as_ref();
        let Some(begin) = target.writes().filled() else { return Err(WriteError::One { format: target, count: 0 }) };
        let io = |e: io::Error| WriteError::Io { path: path.into(), message: e.to_string() };
        let (file, unfinished) = Unfinished::beside(path).map_err(io)?;
        let file = begin(file, path).map_err(io)?;
        let notes = file.lacks().map(WriteNote::Lacks).into_iter().collect();
        Ok(Self { target, path: path.into(), file, unfinished, notes, count: 0, reach: Reach::default() })
    }

    /// With one more asset.
    ///
    /// # Errors
    /// [`WriteError::Cannot`] for a rig that the format has no form for, [`WriteError::Io`] when the file system refuses.
    pub fn add(&mut self, asset: &Asset) -> Result<(), WriteError> {
        self.reach.add(self.target, &asset.rig);
        self.count += 1;
        let added = self.file.add(asset, &mut self.notes);
        added.map_err(|fault| in_words(fault, &asset.name, self.target, &self.path))
    }

    /// Gives the file its name, and tells what the format does not hold, once a kind.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn end(self) -> Result<Vec<WriteNote>, WriteError> {
        let Self { target, path, file, unfinished, mut notes, count, reach } = self;
        let ended = || -> Result<(), Fault> {
            file.end(count)?.sync_all()?;
            Ok(unfinished.finish()?)
        };
        ended().map_err(|fault| in_words(fault, "", target, &path))?;
        notes.splice(0..0, target.beyond(&reach));
        Ok(notes)
    }
}

fn in_words(fault: Fault, asset: &str, format: Target, path: &Path) -> WriteError {
    match fault {
        Fault::Cannot(reason) => WriteError::Cannot { asset: asset.into(), format, reason },
        // Without the name of the temporary file, which says nothing to a user.
        Fault::Io(e) => WriteError::Io { path: path.into(), message: e.kind().to_string() },
    }
}
