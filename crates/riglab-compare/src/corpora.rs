//! Corpora of riglab among the files of others.

use std::path::Path;

use riglab_data::{Corpus, DataError};

/// A file as a corpus of riglab; `None` where it is of another kind. Puppeteer's files have the same ending.
///
/// # Errors
/// When it is a corpus that cannot be read, or an HDF5 file that was cut off, which nothing else reads either.
pub(crate) fn corpus_at(path: &Path) -> Result<Option<Corpus>, DataError> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if !path.is_file() || !["h5", "hdf5"].contains(&ending.as_str()) {
        return Ok(None);
    }
    match Corpus::open(path) {
        Ok(corpus) => Ok(Some(corpus)),
        Err(DataError::OtherHdf5(_)) => Ok(None),
        Err(e) => Err(e),
    }
}
