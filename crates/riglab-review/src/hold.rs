//! One server at a time keeps its decisions in a file.
//!
//! The file is replaced at each decision, and a lock goes with the file, not with its name: the new one is locked before it
//! takes the place. Where there is none yet, a file beside it is locked until the first decision.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use riglab_curate::CurateError;
use riglab_files::Unfinished;

/// A lock, freed when it is dropped or the process ends, however it ends.
pub struct Hold {
    file: File,
    /// What stands for a file that is not there yet.
    beside: Option<PathBuf>,
}

impl Hold {
    /// Takes it.
    ///
    /// # Errors
    /// [`CurateError::Held`], and when neither file can be opened.
    pub fn take(path: &Path) -> Result<Self, CurateError> {
        let fail = |e: io::Error| CurateError::Io { path: path.into(), message: e.to_string() };
        loop {
            let (file, beside) = match File::open(path) {
                Ok(file) => (file, None),
                Err(e) if e.kind() == io::ErrorKind::NotFound => {
                    let beside = beside(path);
                    let open = OpenOptions::new().write(true).create(true).truncate(false).open(&beside);
                    (open.map_err(fail)?, Some(beside))
                }
                Err(e) => return Err(fail(e)),
            };
            // File systems without locks keep nobody out.
            if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
                return Err(CurateError::Held(path.into()));
            }
            // Another may have replaced it, or taken it away, before it was locked.
            if is_at(&file, beside.as_deref().unwrap_or(path)) {
                let hold = Self { file, beside };
                if hold.holds(path) {
                    return Ok(hold);
                }
            }
        }
    }

    /// Whether it is still the file at the path that is held.
    pub fn holds(&self, path: &Path) -> bool {
        match &self.beside {
            Some(beside) => !path.exists() && is_at(&self.file, beside),
            None => is_at(&self.file, path),
        }
    }

    /// Writes the file anew, whole or not at all, and holds the new one.
    ///
    /// # Errors
    /// When the disk refuses; what was there stays, and is held.
    pub fn write(&mut self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let (mut file, unfinished) = Unfinished::beside(path)?;
        // Nobody else knows its name.
        let _ = file.try_lock();
        file.write_all(bytes)?;
        file.sync_all()?;
        unfinished.finish()?;
        // What stood for it goes before its lock does.
        drop(std::mem::replace(self, Self { file, beside: None }));
        Ok(())
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        if let Some(beside) = &self.beside {
            let _ = fs::remove_file(beside);
        }
    }
}

/// What is locked while there are no decisions: `.decisions.tsv.lock`.
fn beside(path: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".lock");
    path.with_file_name(name)
}

/// Whether an open file is the one of that name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let of = |meta: &fs::Metadata| (meta.dev(), meta.ino());
    matches!((file.metadata(), fs::metadata(path)), (Ok(a), Ok(b)) if of(&a) == of(&b))
}

/// Not known here: whoever opened it is believed.
#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_holds_and_the_next_waits_for_its_end() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.tsv");
        let held = || matches!(Hold::take(&path), Err(CurateError::Held(_)));
        let mut hold = Hold::take(&path).unwrap();
        assert!(held() && held() && !path.exists());
        // The lock goes over to each new file, and what stood for it goes.
        for text in ["1", "2"] {
            hold.write(&path, text.as_bytes()).unwrap();
            assert!(held() && hold.holds(&path));
            assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        }
        // Somebody else put another file there.
        fs::write(dir.path().join("new"), "3").unwrap();
        fs::rename(dir.path().join("new"), &path).unwrap();
        assert!(!hold.holds(&path));
        drop(hold);
        assert!(Hold::take(&path).is_ok());
        // Nothing is left of one that wrote nothing.
        let other = dir.path().join("e.tsv");
        drop(Hold::take(&other).unwrap());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
