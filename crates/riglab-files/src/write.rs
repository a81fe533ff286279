//! Whole files from bytes.

use std::io::{self, Write};
use std::path::Path;

use crate::unfinished::{Unfinished, folder, plain};

/// Writes under a temporary name in the same folder, syncs, renames: a kill at any moment leaves what was
/// there. A link is followed; what is there and no plain file, a device for example, is never replaced.
///
/// # Errors
/// Those of the file system, without the name of the temporary file.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let (mut file, unfinished) = Unfinished::beside(path)?;
    file.write_all(bytes).map_err(|e| plain(&e))?;
    file.sync_all()?;
    unfinished.finish()
}

/// Makes renames in a folder durable.
///
/// # Errors
/// Those of the file system.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    std::fs::File::open(folder)?.sync_all()
}

/// Makes the folder that a file is to stand in, with those above it.
///
/// # Errors
/// Those of the file system, with the folder's name.
pub fn make_folder_of(path: &Path) -> io::Result<()> {
    let folder = folder(path);
    std::fs::create_dir_all(folder).map_err(|e| io::Error::new(e.kind(), format!("{}: {e}", folder.display())))
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn links_are_followed_and_devices_left_alone() {
        let _turn = crate::unfinished::TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("a.glb"), dir.path().join("link.glb"));
        write(&file, b"one").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write(&link, b"two").unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"two");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(write(dir.path(), b"x").unwrap_err().to_string().contains("no plain file"));
        let deep = dir.path().join("no/where/a.glb");
        assert!(write(&deep, b"x").is_err());
        // Nothing else stays behind.
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
        make_folder_of(&deep).unwrap();
        write(&deep, b"x").unwrap();
        let faulty = make_folder_of(&file.join("b/c")).unwrap_err().to_string();
        assert!(faulty.contains("a.glb/b"), "{faulty}");
    }
}
