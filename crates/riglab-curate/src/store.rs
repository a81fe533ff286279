//! Files written whole or not at all.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use crate::CurateError;

/// Writes under a temporary name in the same folder, syncs, renames: a kill at any moment leaves what was
/// there.
pub(crate) fn store(path: &Path, bytes: &[u8]) -> Result<(), CurateError> {
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let put = || -> std::io::Result<()> {
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut temp = builder.prefix(".riglab-").suffix(".tmp").tempfile_in(folder)?;
        temp.write_all(bytes)?;
        temp.as_file().sync_all()?;
        temp.persist(path).map_err(|e| e.error)?;
        File::open(folder)?.sync_all()
    };
    put().map_err(|e| CurateError::write(path, e.kind()))
}
