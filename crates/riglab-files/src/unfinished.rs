//! Files under a temporary name.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use crate::stale;

/// Temporary files of this process that have not got their name yet. A file is made, and removed, while
/// this is held, so that whoever leaves the process sees every one that is there.
static OPEN: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A file or folder beside the place where it will stand. Dropped before [`Unfinished::finish`], it is gone.
#[derive(Debug)]
pub struct Unfinished {
    temp: PathBuf,
    /// Of a link the file it leads to.
    place: PathBuf,
    /// What may be done with the file that is there, and then with this one.
    mode: Option<fs::Permissions>,
}

impl Unfinished {
    /// An empty file in the folder of `path`, readable for others as the user's mask has it, or as the file that is there is,
    /// where it can be given to the same user. A link is followed; what is there and no plain file, a device for example, is
    /// never replaced, nor is what is write-protected ([`may_replace`]).
    ///
    /// # Errors
    /// Those of the file system, without the temporary name, which says nothing to a user.
    pub fn beside(path: &Path) -> io::Result<(File, Self)> {
        may_replace(path)?;
        let (place, there) = match fs::canonicalize(path) {
            Ok(real) => {
                let there = fs::metadata(&real)?;
                if !there.is_file() {
                    return Err(io::Error::other("it is there, and no plain file"));
                }
                (real, Some(there))
            }
            // Nothing is there yet, where a link leads or here.
            Err(_) => (led(path)?, None),
        };
        let mut open = open();
        stale::remove(folder(&place));
        let mut made = temporary(folder(&place), there.is_some())?;
        let mode = there.as_ref().and_then(|there| taken_over(made.as_file(), there));
        if there.is_some() && mode.is_none() {
            made = temporary(folder(&place), false)?;
        }
        let (file, temp) = made.keep().map_err(|e| plain(&e.error))?;
        open.push(temp.clone());
        Ok((file, Self { temp, place, mode }))
    }

    /// An empty folder beside `path`, where a folder is to stand; what is there is not looked at.
    ///
    /// # Errors
    /// As [`Self::beside`].
    pub fn folder_beside(path: &Path) -> io::Result<Self> {
        let place = path.to_path_buf();
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(0o777));
        }
        let prefix = stale::prefix();
        builder.prefix(&prefix).suffix(stale::SUFFIX);
        let mut open = open();
        stale::remove(folder(&place));
        let temp = builder.tempdir_in(folder(&place)).map_err(|e| plain(&e))?.keep();
        open.push(temp.clone());
        Ok(Self { temp, place, mode: None })
    }

    /// Its temporary name.
    pub fn path(&self) -> &Path {
        &self.temp
    }

    /// Where it will stand: of a link the file it leads to.
    pub(crate) fn place(&self) -> &Path {
        &self.place
    }

    /// Has the file made anew by who does not take one that is there, while nobody leaves: it would come back behind the
    /// back of whoever has just taken it away.
    pub fn made_by<T>(&self, make: impl FnOnce(&Path) -> T) -> T {
        let _open = open();
        make(&self.temp)
    }

    /// Gives the file its name, in place of what was there, and makes that durable. What was written must
    /// have been synced before.
    ///
    /// # Errors
    /// Those of the file system; what was there still is.
    pub fn finish(self) -> io::Result<()> {
        // Some file systems have one mode for all and refuse to be asked for it.
        if let Some(mode) =
            self.mode.as_ref().filter(|mode| fs::metadata(&self.temp).is_ok_and(|m| m.permissions() != **mode))
        {
            fs::set_permissions(&self.temp, mode.clone())?;
        }
        let kept = fs::rename(&self.temp, &self.place);
        kept.and_then(|()| crate::sync_folder(folder(&self.place)))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let mut open = open();
        // Under its own name by now, it is no longer there under this one.
        remove(&self.temp);
        open.retain(|path| *path != self.temp);
    }
}

/// A new file under a name that tells whose it is: private, or as the user's mask has it.
fn temporary(folder: &Path, private: bool) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    // Temporary files are private by default.
    #[cfg(unix)]
    if !private {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let prefix = stale::prefix();
    builder.prefix(&prefix).suffix(stale::SUFFIX).tempfile_in(folder).map_err(|e| plain(&e))
}

/// Gives a new file to the user and group of the one that it replaces, and says what may then be done with it: what that one
/// said would be about somebody else where this fails.
#[cfg(unix)]
fn taken_over(new: &File, there: &fs::Metadata) -> Option<fs::Permissions> {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
    let (made, mode) = (new.metadata().ok()?, there.permissions());
    let is_same = (made.uid(), made.gid()) == (there.uid(), there.gid());
    // Root may give files away, and everybody to a group of his.
    if is_same || fchown(new, Some(there.uid()), Some(there.gid())).is_ok() {
        return Some(mode);
    }
    (made.uid() == there.uid()).then(|| fs::Permissions::from_mode(for_another_group(mode.mode())))
}

#[cfg(not(unix))]
fn taken_over(_: &File, there: &fs::Metadata) -> Option<fs::Permissions> {
    Some(there.permissions())
}

/// A mode by which the group may do no more than all others.
#[cfg(unix)]
fn for_another_group(mode: u32) -> u32 {
    (mode & !0o070) | (mode & ((mode & 0o007) << 3))
}

fn open() -> MutexGuard<'static, Vec<PathBuf>> {
    OPEN.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Ends the process with this code, and takes its unfinished files along.
///
/// Nothing is torn down: threads are still at work, and libraries' destructors under them crash. What
/// fails while this goes on is not told either.
pub fn leave(code: i32) -> ! {
    let _silence = io::stderr().lock();
    let _no_more = remove_unfinished();
    // SAFETY: `_exit` ends the process and touches no memory of it.
    unsafe { libc::_exit(code) }
}

/// While what this returns is held, no further file is begun.
fn remove_unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    let mut open = open();
    open.drain(..).for_each(|path| remove(&path));
    open
}

/// Removes a file or a folder. It may be gone already, and there is nobody to tell.
pub(crate) fn remove(path: &Path) {
    if !path.is_dir() {
        let _ = fs::remove_file(path);
        return;
    }
    // Whoever still writes into it by its name finds it no more.
    let gone = path.with_extension(format!("gone{}", stale::SUFFIX));
    let path = if fs::rename(path, &gone).is_ok() { &gone } else { path };
    let _ = fs::remove_dir_all(path);
}

/// Refuses a file that is write-protected: whoever may write into its folder could replace it all the same. What is there is
/// asked, not whether this user may write, as root may everywhere.
///
/// # Errors
/// Says so, without the file's name.
pub fn may_replace(path: &Path) -> io::Result<()> {
    match path.metadata() {
        Ok(there) if there.is_file() && there.permissions().readonly() => {
            let why = "is there already and write-protected; allow writing, or give another name";
            Err(io::Error::new(io::ErrorKind::PermissionDenied, why))
        }
        _ => Ok(()),
    }
}

/// Where links lead, though nothing may be there.
fn led(path: &Path) -> io::Result<PathBuf> {
    /// As many as systems follow.
    const LINKS: usize = 40;
    let mut at = path.to_path_buf();
    for _ in 0..LINKS {
        match fs::read_link(&at) {
            Ok(to) => at = folder(&at).join(to),
            Err(_) => return Ok(at),
        }
    }
    Err(io::Error::other("it is a link that leads in a circle"))
}

pub(crate) fn folder(path: &Path) -> &Path {
    path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

pub(crate) fn plain(e: &io::Error) -> io::Error {
    // Of a file that is to be made, its folder alone can be missing.
    let kind = e.kind();
    io::Error::new(kind, if kind == io::ErrorKind::NotFound { "no such folder".into() } else { kind.to_string() })
}

/// Asks a process to leave (SIGTERM), as [`leave`] answers; one that has ended meanwhile needs no word.
#[cfg(unix)]
pub fn ask_to_leave(child: &std::process::Child) {
    if let Some(id) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
        let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
    }
}

/// Nothing here: there is no such signal.
#[cfg(not(unix))]
pub fn ask_to_leave(_: &std::process::Child) {}

/// Tests of this crate take turns: one of them removes what is unfinished, whosever it is.
#[cfg(test)]
pub(crate) static TURN: Mutex<()> = Mutex::new(());

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_leaves_takes_the_unfinished_with_him() {
        let _turn = TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let count = || fs::read_dir(dir.path()).unwrap().count();
        let (_file, dropped) = Unfinished::beside(&dir.path().join("a")).unwrap();
        drop(dropped);
        assert_eq!(count(), 0);
        let (_file, done) = Unfinished::beside(&dir.path().join("b")).unwrap();
        done.finish().unwrap();
        let (_file, left) = Unfinished::beside(&dir.path().join("b")).unwrap();
        assert_eq!(count(), 2);
        drop(remove_unfinished());
        assert_eq!(count(), 1);
        assert!(left.finish().is_err());
        assert!(dir.path().join("b").exists());
    }

    #[cfg(unix)]
    #[test]
    fn files_stay_with_their_users() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
        let _turn = TURN.lock().unwrap();
        assert_eq!([0o600, 0o640, 0o664, 0o644].map(for_another_group), [0o600, 0o600, 0o644, 0o644]);
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a");
        fs::write(&file, "one").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        // Only root may.
        if chown(&file, Some(4711), Some(4712)).is_err() {
            return;
        }
        crate::write(&file, b"two").unwrap();
        let now = file.metadata().unwrap();
        assert_eq!((now.uid(), now.gid(), now.permissions().mode() & 0o777), (4711, 4712, 0o640));
    }

    #[test]
    fn folders_go_with_whoever_leaves_and_get_their_name_at_the_end() {
        let _turn = TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let count = || fs::read_dir(dir.path()).unwrap().count();
        let (whole, broken) = (dir.path().join("whole"), dir.path().join("broken"));
        let begun = Unfinished::folder_beside(&whole).unwrap();
        fs::write(begun.path().join("a"), "a").unwrap();
        begun.finish().unwrap();
        assert!(whole.join("a").exists() && count() == 1);
        let begun = || {
            let begun = Unfinished::folder_beside(&broken).unwrap();
            fs::create_dir(begun.path().join("deep")).unwrap();
            fs::write(begun.path().join("deep/a"), "a").unwrap();
            begun
        };
        drop(begun());
        assert_eq!(count(), 1);
        let left = begun();
        drop(remove_unfinished());
        assert_eq!(count(), 1);
        assert!(fs::write(left.path().join("deep/b"), "b").is_err() && left.finish().is_err());
    }

    #[test]
    fn what_is_made_anew_is_not_made_while_somebody_leaves() {
        let _turn = TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let count = || fs::read_dir(dir.path()).unwrap().count();
        let (_file, begun) = Unfinished::beside(&dir.path().join("a")).unwrap();
        let leaving = remove_unfinished();
        std::thread::scope(|s| {
            let made = s.spawn(|| begun.made_by(|path| fs::write(path, "anew")));
            std::thread::sleep(std::time::Duration::from_millis(50));
            assert_eq!(count(), 0);
            drop(leaving);
            made.join().unwrap().unwrap();
        });
        assert_eq!(count(), 1);
    }

    #[test]
    fn a_file_is_either_known_or_not_there() {
        let _turn = TURN.lock().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|s| {
            s.spawn(|| {
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    drop(Unfinished::beside(&dir.path().join("a")).unwrap());
                }
            });
            let mut left = 0;
            for _ in 0..500 {
                let no_more = remove_unfinished();
                left += fs::read_dir(dir.path()).unwrap().count();
                drop(no_more);
            }
            over.store(true, std::sync::atomic::Ordering::Relaxed);
            assert_eq!(left, 0);
        });
    }
}
