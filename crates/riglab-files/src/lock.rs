//! Locks that tell whether a process is at work.

use std::fs::{File, TryLockError};
use std::path::Path;

/// Whether a process holds the lock of a file. Of one that is not there, or cannot be asked, nobody does.
pub fn is_locked(path: &Path) -> bool {
    // A shared lock needs no right to write, which network file systems want for the other one.
    let asked = File::open(path).map(|lock| lock.try_lock_shared());
    matches!(asked, Ok(Err(TryLockError::WouldBlock)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_is_held_as_long_as_its_file_is_open() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(".lock");
        assert!(!is_locked(&path));
        let lock = File::create(&path).unwrap();
        assert!(!is_locked(&path));
        lock.lock().unwrap();
        assert!(is_locked(&path));
        drop(lock);
        assert!(!is_locked(&path));
    }
}
