//! Files written whole or not at all, and told as this crate tells.

use std::path::Path;

use crate::CurateError;

pub(crate) fn store(path: &Path, bytes: &[u8]) -> Result<(), CurateError> {
    riglab_files::write(path, bytes).map_err(|e| CurateError::write(path, &e))
}
