//! Wheels from the Python package index, checked against known sums and unpacked in part.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use sha2::{Digest, Sha256};

use crate::{preflight, shell};

/// A wheel by its exact version and sum.
pub struct Wheel {
    /// `name==version` as pip takes it.
    pub requirement: &'static str,
    /// SHA-256 of the file, in hexadecimal.
    pub sha256: &'static str,
    /// Size of the download in megabytes, for messages.
    pub megabytes: u32,
}

/// Where wheels come from.
pub enum Source {
    /// `pip download`.
    Pip,
    /// A folder that already holds them.
    Folder(PathBuf),
}

/// Which platform tags to ask for: the wheels wanted carry one of them each.
const PLATFORMS: [&str; 4] =
    ["manylinux_2_28_x86_64", "manylinux_2_25_x86_64", "manylinux2014_x86_64", "manylinux_2_17_x86_64"];

impl Wheel {
    /// Fetches the wheel into `dir` and checks its sum.
    pub fn fetch(&self, source: &Source, dir: &Path) -> Result<PathBuf> {
        match source {
            Source::Folder(from) => self.find(from)?.with_context(|| {
                format!("{}: no wheel of {} with SHA-256 {}", from.display(), self.requirement, self.sha256)
            }),
            Source::Pip => {
                eprintln!("fetching {} ({} MB)", self.requirement, self.megabytes);
                let mut pip = Command::new(preflight::python()?);
                pip.args([
                    "-m",
                    "pip",
                    "download",
                    "--quiet",
                    "--disable-pip-version-check",
                    "--no-deps",
                    "--no-cache-dir",
                ]);
                pip.args([
                    "--only-binary=:all:",
                    "--python-version",
                    "3.11",
                    "--implementation",
                    "cp",
                    "--abi",
                    "cp311",
                    "--abi",
                    "none",
                ]);
                for platform in PLATFORMS {
                    pip.args(["--platform", platform]);
                }
                pip.arg("--dest").arg(dir).arg(self.requirement);
                if let Err(e) = shell::run(&mut pip) {
                    bail!(
                        "{} could not be fetched ({e}); is there a network, and does pip reach its index? \
                         The wheels can be fetched elsewhere and given with `cargo xtask setup --wheels DIR`",
                        self.requirement
                    );
                }
                self.find(dir)?.with_context(|| {
                    format!(
                        "the wheel of {} does not have the SHA-256 {} that this version of riglab expects; nothing was installed",
                        self.requirement, self.sha256
                    )
                })
            }
        }
    }

    /// The file of this wheel in a folder, if one there has the right sum.
    fn find(&self, dir: &Path) -> Result<Option<PathBuf>> {
        let stem = self.requirement.replace("==", "-").replace("nvidia-cuda-", "nvidia_cuda_");
        for entry in fs::read_dir(dir).with_context(|| format!("cannot read {}", dir.display()))? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.starts_with(&stem) && name.ends_with(".whl") && sha256(&path)? == self.sha256 {
                return Ok(Some(path));
            }
        }
        Ok(None)
    }
}

/// Unpacks the members for which `to` names a place. Modes are not kept: who unpacks programs sets theirs.
pub fn unpack(wheel: &Path, mut to: impl FnMut(&str) -> Option<PathBuf>) -> Result<usize> {
    let shown = wheel.display();
    let mut zip = zip::ZipArchive::new(File::open(wheel)?).with_context(|| format!("{shown} is no zip"))?;
    let mut count = 0;
    for i in 0..zip.len() {
        let mut member = zip.by_index(i)?;
        if !member.is_file() {
            continue;
        }
        let Some(target) = to(member.name()) else { continue };
        if let Some(parent) = target.parent() {
            fs::create_dir_all(parent)?;
        }
        let mut out = File::create(&target).with_context(|| format!("cannot write {}", target.display()))?;
        io::copy(&mut member, &mut out)
            .with_context(|| format!("cannot unpack {} to {}", member.name(), target.display()))?;
        count += 1;
    }
    Ok(count)
}

/// Free space of the file system that holds `dir`, in bytes.
pub fn free_space(dir: &Path) -> Result<u64> {
    use std::os::unix::ffi::OsStrExt;
    let c = std::ffi::CString::new(dir.as_os_str().as_bytes())?;
    // SAFETY: statvfs fills the struct it is given when it returns 0.
    let stat = unsafe {
        let mut stat = std::mem::zeroed::<libc::statvfs>();
        if libc::statvfs(c.as_ptr(), &mut stat) != 0 {
            return Err(io::Error::last_os_error())
                .with_context(|| format!("cannot ask {} for free space", dir.display()));
        }
        stat
    };
    #[allow(clippy::unnecessary_cast)] // the fields' width differs between platforms
    Ok(stat.f_bavail as u64 * stat.f_frsize as u64)
}

/// Refuses when `dir` has less than `megabytes` free.
pub fn need_space(dir: &Path, megabytes: u64, what: &str) -> Result<()> {
    let free = free_space(dir)? / 1_000_000;
    if free < megabytes {
        bail!(
            "{what} needs {megabytes} MB in {}, {free} MB are free; make room, or set XDG_CACHE_HOME to a larger disk",
            dir.display()
        );
    }
    Ok(())
}

fn sha256(path: &Path) -> Result<String> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        let n = file.read(&mut buffer)?;
        if n == 0 {
            break;
        }
        hash.update(&buffer[..n]);
    }
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}

/// The folder that all clones of this user share: `$XDG_CACHE_HOME/riglab` or `~/.cache/riglab`.
pub fn cache() -> Result<PathBuf> {
    // A path that is not whole names no place, as the XDG specification says.
    let base = match std::env::var_os("XDG_CACHE_HOME").filter(|v| Path::new(v).is_absolute()) {
        Some(dir) => PathBuf::from(dir),
        None => match std::env::var_os("HOME") {
            Some(home) => Path::new(&home).join(".cache"),
            None => bail!("neither XDG_CACHE_HOME nor HOME is set, so there is no place to keep libtorch"),
        },
    };
    let dir = base.join("riglab");
    fs::create_dir_all(&dir).with_context(|| format!("cannot make the cache folder {}", dir.display()))?;
    Ok(dir)
}

/// A folder of its own to fill, which goes with what is given back. What calls that were broken off left under the same
/// prefix goes first: nothing else ever takes it away.
pub fn temporary(cache: &Path, prefix: &str) -> Result<tempfile::TempDir> {
    remove_stale(cache, prefix, SystemTime::now());
    let made = tempfile::Builder::new().prefix(prefix).tempdir_in(cache);
    made.with_context(|| format!("cannot write to {}; make it writable, or set XDG_CACHE_HOME", cache.display()))
}

/// What is older than this is nobody's any more: a download writes all the time.
const STALE: Duration = Duration::from_secs(24 * 60 * 60);

/// Removes temporary folders that nothing was written into for a day, and none that cannot be looked into.
fn remove_stale(cache: &Path, prefix: &str, now: SystemTime) {
    let Ok(entries) = fs::read_dir(cache) else { return };
    for entry in entries.flatten() {
        // A link is nothing that was made here.
        let own =
            entry.file_name().to_string_lossy().starts_with(prefix) && entry.file_type().is_ok_and(|t| t.is_dir());
        let is_old = |time: SystemTime| now.duration_since(time).is_ok_and(|age| age > STALE);
        if own && last_write(&entry.path()).is_some_and(is_old) {
            // Another call may take it away at the same time.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// When something below a folder was last written; `None` where that cannot be told. Files that were unpacked or installed may
/// have an earlier time than that, their folders have not.
fn last_write(folder: &Path) -> Option<SystemTime> {
    let mut last = fs::symlink_metadata(folder).and_then(|meta| meta.modified()).ok()?;
    for entry in fs::read_dir(folder).ok()? {
        let entry = entry.ok()?;
        let meta = entry.metadata().ok()?;
        let time = if meta.is_dir() { last_write(&entry.path())? } else { meta.modified().ok()? };
        last = last.max(time);
    }
    Some(last)
}

/// Points the link `link` at `target`, replacing an older link in one step.
pub fn symlink(target: &Path, link: &Path) -> Result<()> {
    if fs::read_link(link).is_ok_and(|t| t == target) {
        return Ok(());
    }
    if let Some(parent) = link.parent() {
        fs::create_dir_all(parent)?;
    }
    let new = link.with_file_name(format!(
        "{}.{}.tmp",
        link.file_name().unwrap_or_default().to_string_lossy(),
        std::process::id()
    ));
    std::os::unix::fs::symlink(target, &new).with_context(|| format!("cannot link {}", link.display()))?;
    fs::rename(&new, link).with_context(|| format!("cannot link {}; is something else there?", link.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_broken_calls_left_goes_after_a_day() {
        let cache = tempfile::tempdir().unwrap();
        let made = |name: &str| {
            let lib = cache.path().join(name).join("made");
            fs::create_dir_all(&lib).unwrap();
            fs::write(lib.join("a.whl"), "part").unwrap();
        };
        ["libtorch-2", ".libtorch-old", ".libtorch-held", ".venv-old"].into_iter().for_each(made);
        let there = || {
            let names = fs::read_dir(cache.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
            let mut names: Vec<String> = names.collect();
            names.sort();
            names
        };
        let now = SystemTime::now();
        remove_stale(cache.path(), ".libtorch-", now + STALE / 2);
        assert_eq!(there(), [".libtorch-held", ".libtorch-old", ".venv-old", "libtorch-2"]);
        // Something is still written deep in one of them.
        let file = File::options().write(true).open(cache.path().join(".libtorch-held/made/a.whl")).unwrap();
        file.set_modified(now + STALE).unwrap();
        remove_stale(cache.path(), ".libtorch-", now + STALE + STALE / 2);
        assert_eq!(there(), [".libtorch-held", ".venv-old", "libtorch-2"]);
        let own = temporary(cache.path(), ".venv-").unwrap();
        assert!(own.path().is_dir() && there().contains(&".venv-old".to_owned()));
    }
}
