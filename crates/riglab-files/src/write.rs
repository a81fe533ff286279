//! Whole files from bytes.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use crate::unfinished::{Unfinished, folder, plain};

/// Writes under a temporary name in the same folder, syncs, renames: a kill at any moment leaves what was
/// there. A link is followed; what is there and no plain file, a device for example, is never replaced, nor is what is
/// write-protected. What replaces a file may be read and written by the same users, where it can be given to them.
///
/// # Errors
/// Those of the file system, without the name of the temporary file.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_with(path, |file| file.write_all(bytes).map_err(|e| plain(&e)))
}

/// As [`write`], of what `fill` writes: for contents that are not to be in memory as a whole.
///
/// # Errors
/// Those of the file system, without the name of the temporary file, and those of `fill`.
pub fn write_with(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let (mut file, unfinished) = Unfinished::beside(path)?;
    fill(&mut file)?;
    file.sync_all()?;
    unfinished.finish()
}

/// As [`write`], but where a file is there, that one stays: of several processes that write one at the same time, the first is
/// heard, and the others read it.
///
/// # Errors
/// As [`write`].
pub fn write_first(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if path.exists() {
        return Ok(());
    }
    let (mut file, unfinished) = Unfinished::beside(path)?;
    file.write_all(bytes).map_err(|e| plain(&e))?;
    file.sync_all()?;
    // A link whose file is not there yet is itself no such file.
    match std::fs::hard_link(unfinished.path(), unfinished.place()) {
        Ok(()) => sync_folder(folder(unfinished.place())),
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists || path.exists() => Ok(()),
        // A disk without such links.
        Err(_) => unfinished.finish(),
    }
}

/// Tries whether files can be written into a folder, which is made where it is not there yet: told before the work, not
/// after it. Nothing stays behind.
///
/// # Errors
/// Those of the file system, with the folder that refuses.
pub fn may_write(folder: &Path) -> io::Result<()> {
    let there = folder.ancestors().find(|above| above.exists()).filter(|above| !above.as_os_str().is_empty());
    let there = there.unwrap_or(Path::new("."));
    let named = |e: io::Error| io::Error::new(e.kind(), format!("{}: {}", there.display(), plain(&e)));
    if !there.is_dir() {
        return Err(named(io::ErrorKind::NotADirectory.into()));
    }
    Unfinished::beside(&there.join(".riglab-probe")).map(drop).map_err(named)
}

/// Makes renames in a folder durable, where that can be asked for: not of a folder that may be written into and not read, nor
/// of file systems that sync no folders.
///
/// # Errors
/// Those of the file system.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    use io::ErrorKind::{InvalidInput, PermissionDenied, Unsupported};
    match std::fs::File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(e) if matches!(e.kind(), InvalidInput | PermissionDenied | Unsupported) => Ok(()),
        done => done,
    }
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
    fn the_first_of_several_that_write_is_heard() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("said");
        write_first(&path, b"one").unwrap();
        write_first(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"one");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "nothing unfinished stays");
        assert!(write_first(&dir.path().join("gone/said"), b"one").is_err());
        // Where a link leads to a file that is not there yet, it is written.
        let link = dir.path().join("link");
        std::os::unix::fs::symlink("later", &link).unwrap();
        write_first(&link, b"three").unwrap();
        write_first(&link, b"four").unwrap();
        assert_eq!(fs::read(dir.path().join("later")).unwrap(), b"three");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }

    #[test]
    fn folders_are_tried_and_left_as_they_were() {
        use std::os::unix::fs::PermissionsExt;
        let _turn = crate::unfinished::TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let (file, closed) = (dir.path().join("a"), dir.path().join("closed"));
        may_write(&dir.path().join("not/there/yet")).unwrap();
        may_write(Path::new("")).unwrap();
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
        fs::write(&file, "").unwrap();
        let said = may_write(&file.join("b")).unwrap_err().to_string();
        assert!(said.contains(&file.display().to_string()), "{said}");
        fs::create_dir(&closed).unwrap();
        fs::set_permissions(&closed, fs::Permissions::from_mode(0o500)).unwrap();
        // Root may write everywhere.
        if fs::write(closed.join("probe"), b"").is_err() {
            let e = may_write(&closed.join("b/c")).unwrap_err();
            assert!(e.kind() == io::ErrorKind::PermissionDenied && e.to_string().contains("closed"), "{e}");
        }
    }

    #[test]
    fn files_keep_who_may_read_them_and_what_is_protected_stays() {
        use std::os::unix::fs::PermissionsExt;
        let _turn = crate::unfinished::TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("a.glb"), dir.path().join("link.glb"));
        let mode = || fs::metadata(&file).unwrap().permissions().mode() & 0o777;
        let set = |mode| fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
        write(&file, b"one").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        let usual = mode();
        for (mine, now) in [(0o600, "two"), (0o664, "three"), (0o200, "four"), (usual, "five")] {
            set(mine);
            write(&link, now.as_bytes()).unwrap();
            assert_eq!(mode(), mine);
        }
        assert_eq!(fs::read(&file).unwrap(), b"five");
        // While it is written, nobody else may read it either.
        set(0o600);
        let (open, unfinished) = Unfinished::beside(&file).unwrap();
        assert_eq!(open.metadata().unwrap().permissions().mode() & 0o077, 0);
        drop(unfinished);
        set(0o444);
        for path in [&file, &link] {
            let said = write(path, b"six").unwrap_err();
            assert!(said.kind() == io::ErrorKind::PermissionDenied && said.to_string().contains("write-protected"));
        }
        write_first(&file, b"seven").unwrap();
        assert_eq!((fs::read(&file).unwrap(), mode()), (b"five".to_vec(), 0o444));
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "nothing unfinished stays");
    }

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
        // One whose file is not there yet, by a way from where it is; and one that leads to itself.
        fs::create_dir(dir.path().join("far")).unwrap();
        let (early, round) = (dir.path().join("early.glb"), dir.path().join("round.glb"));
        std::os::unix::fs::symlink("far/later.glb", &early).unwrap();
        std::os::unix::fs::symlink("round.glb", &round).unwrap();
        write(&early, b"three").unwrap();
        assert_eq!(fs::read(dir.path().join("far/later.glb")).unwrap(), b"three");
        assert!(fs::symlink_metadata(&early).unwrap().is_symlink());
        assert!(write(&round, b"x").unwrap_err().to_string().contains("circle"));
        for link in [&early, &round] {
            fs::remove_file(link).unwrap();
        }
        fs::remove_dir_all(dir.path().join("far")).unwrap();
        assert!(write(dir.path(), b"x").unwrap_err().to_string().contains("no plain file"));
        let deep = dir.path().join("no/where/a.glb");
        assert!(write(&deep, b"x").is_err());
        let fault = write_with(&file, |part| part.write_all(b"half").and(Err(io::Error::other("no more"))));
        assert!(fault.is_err_and(|e| e.to_string() == "no more") && fs::read(&file).unwrap() == b"two");
        // Nothing else stays behind.
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
        make_folder_of(&deep).unwrap();
        write(&deep, b"x").unwrap();
        let faulty = make_folder_of(&file.join("b/c")).unwrap_err().to_string();
        assert!(faulty.contains("a.glb/b"), "{faulty}");
    }
}
