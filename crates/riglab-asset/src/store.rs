//! Files written whole or not at all.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// Writes under a temporary name in the same folder, syncs, renames: a kill at any moment leaves what was
/// there. A link is followed; what is there and no plain file, a device for example, is never replaced.
pub(crate) fn store(path: &Path, bytes: &[u8]) -> io::Result<()> {
    // Of a link the file it leads to; where nothing is yet, the path itself.
    let real = match fs::canonicalize(path) {
        Ok(real) if !fs::metadata(&real)?.is_file() => return Err(io::Error::other("it is there, and no plain file")),
        Ok(real) => real,
        Err(_) => path.to_path_buf(),
    };
    let folder = real.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; this one is to be as any other.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut temp = builder.prefix(".riglab-").suffix(".tmp").tempfile_in(folder).map_err(plain)?;
    temp.write_all(bytes).map_err(plain)?;
    temp.as_file().sync_all()?;
    temp.persist(&real).map_err(|e| e.error)?;
    File::open(folder)?.sync_all()
}

/// Without the name of the temporary file, which says nothing to a user.
fn plain(e: io::Error) -> io::Error {
    io::Error::new(e.kind(), e.kind().to_string())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn links_are_followed_and_devices_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("a.glb"), dir.path().join("link.glb"));
        store(&file, b"one").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        store(&link, b"two").unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"two");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(store(dir.path(), b"x").unwrap_err().to_string().contains("no plain file"));
        assert!(store(&dir.path().join("nowhere/a.glb"), b"x").is_err());
        // Nothing else stays behind.
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }
}
