//! Temporary files and folders of processes that were killed: told by their names, and removed.
//!
//! A name holds the number of the process and, as other machines and containers have such numbers of their own, where the
//! number counts: a boot of a system, and a namespace of processes. A file of another place is never touched, nor is one
//! of a process that is there.

use std::collections::HashSet;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex};

const PREFIX: &str = ".riglab-";
pub(crate) const SUFFIX: &str = ".tmp";

/// Where the numbers of processes count; `None` where the system does not say it.
static PLACE: LazyLock<Option<String>> = LazyLock::new(|| {
    let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    let namespace = fs::read_link("/proc/self/ns/pid").ok()?;
    let mut hash = DefaultHasher::new();
    (boot, namespace).hash(&mut hash);
    Some(format!("{:016x}", hash.finish()))
});

/// Folders that were looked through: once is enough, and folders of many files are written file by file.
static LOOKED: Mutex<Option<HashSet<PathBuf>>> = Mutex::new(None);

/// What this process' temporary files begin with.
pub(crate) fn prefix() -> String {
    match &*PLACE {
        Some(place) => named(place, std::process::id()),
        None => PREFIX.into(),
    }
}

fn named(place: &str, process: u32) -> String {
    format!("{PREFIX}{place}-{process}-")
}

/// Removes from a folder what processes of this place left that have ended. What cannot be removed stays.
pub(crate) fn remove(folder: &Path) {
    let Some(place) = &*PLACE else { return };
    let real = folder.canonicalize().unwrap_or_else(|_| folder.into());
    let mut looked = LOOKED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if !looked.get_or_insert_default().insert(real) {
        return;
    }
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        if name.to_str().and_then(|name| process(name, place)).is_some_and(has_ended) {
            crate::unfinished::remove(&entry.path());
        }
    }
}

/// The process that a name of this place is of.
fn process(name: &str, place: &str) -> Option<i32> {
    let rest = name.strip_prefix(PREFIX)?.strip_suffix(SUFFIX)?.strip_prefix(place)?;
    rest.strip_prefix('-')?.split_once('-')?.0.parse().ok()
}

/// Whether there is no such process.
#[cfg(unix)]
fn has_ended(process: i32) -> bool {
    let asked = rustix::process::Pid::from_raw(process).map(rustix::process::test_kill_process);
    asked == Some(Err(rustix::io::Errno::SRCH))
}

/// Nobody can be asked here.
#[cfg(not(unix))]
fn has_ended(_: i32) -> bool {
    false
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn files_of_ended_processes_of_this_place_are_removed_and_no_others() {
        let _turn = crate::unfinished::TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let mut child = std::process::Command::new("true").spawn().unwrap();
        child.wait().unwrap();
        let (place, ended) = (PLACE.as_deref().unwrap(), child.id());
        let ours = std::process::id();
        let write = |prefix: &str| {
            let path = dir.path().join(format!("{prefix}x7{SUFFIX}"));
            fs::write(&path, "half").unwrap();
            path
        };
        let left = write(&named(place, ended));
        let folder = dir.path().join(format!("{}x8{SUFFIX}", named(place, ended)));
        fs::create_dir_all(folder.join("deep")).unwrap();
        // Of a process that is at work, of another machine, and by no such name.
        let stay = [named(place, ours), named("0123", ended), PREFIX.into(), format!("{PREFIX}{place}-x-")];
        let stay = stay.map(|prefix| write(&prefix));
        crate::write(&dir.path().join("a"), b"a").unwrap();
        assert!(!left.exists() && !folder.exists() && stay.iter().all(|path| path.exists()));
        assert!(prefix().starts_with(&named(place, ours)));
    }
}
