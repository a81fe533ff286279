//! A folder of creatures that is not complete yet.

use std::collections::{BTreeSet, HashSet};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use riglab_asset::Target;
use riglab_files::write_first;

use super::MANIFEST;

/// Says in a folder what its creatures follow from, until all are there.
const NAME: &str = ".riglab-synth.json";

/// A folder that this process fills, from its beginning or from where an earlier call was broken off.
pub struct Begun {
    folder: PathBuf,
    // Unlocked when the process ends, however it ends.
    _lock: File,
}

impl Begun {
    /// Takes an empty folder, or one that a call with the same settings (by their names) was broken off in.
    ///
    /// # Errors
    /// When it holds something else, another process fills it, or it cannot be written.
    pub fn open(folder: &Path, settings: &[(String, String)]) -> Result<Self> {
        let shown = folder.display();
        fs::create_dir_all(folder).with_context(|| format!("{shown} cannot be made"))?;
        let path = folder.join(NAME);
        if !path.exists() {
            let mut entries = fs::read_dir(folder).with_context(|| format!("{shown} cannot be read"))?;
            if entries.next().is_some() {
                bail!(
                    "{shown} is not empty; give another folder, so that nothing is overwritten (creatures that were \
                     finished get no more)"
                );
            }
            // Another that begins at the same time may be the first.
            let written = write_first(&path, &serde_json::to_vec(settings)?);
            written.with_context(|| format!("{} cannot be written", path.display()))?;
        }
        let bytes = fs::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        let before: Vec<(String, String)> = serde_json::from_slice(&bytes)
            .with_context(|| format!("{} is damaged: empty the folder, or give another", path.display()))?;
        same(&before, settings).with_context(|| shown.to_string())?;
        let lock = File::open(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        let held = match lock.try_lock() {
            Ok(()) => !is_at(&lock, &path),
            Err(TryLockError::WouldBlock) => true,
            Err(TryLockError::Error(e)) => {
                return Err(e).with_context(|| format!("{} cannot be locked", path.display()));
            }
        };
        if held {
            bail!("{shown}: another process makes creatures here; wait for it, or give another folder");
        }
        Ok(Self { folder: folder.into(), _lock: lock })
    }

    /// Which of the files that there are to be are there, whole; what else an earlier call left half-written is taken away.
    ///
    /// # Errors
    /// When there is a file that is none of them.
    pub fn files(&self, wanted: impl Iterator<Item = String>) -> Result<BTreeSet<String>> {
        let wanted: HashSet<String> = wanted.collect();
        let shown = self.folder.display();
        let mut there = BTreeSet::new();
        let mut unfinished = Vec::new();
        for entry in fs::read_dir(&self.folder).with_context(|| format!("{shown} cannot be read"))? {
            let path = entry.with_context(|| format!("{shown} cannot be read"))?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if wanted.contains(&name) {
                if Target::GLB.is_whole(&path) {
                    there.insert(name);
                }
            } else if name.starts_with(".riglab-") && name.ends_with(".tmp") {
                unfinished.push(path);
            } else if ![NAME, MANIFEST].contains(&name.as_str()) {
                bail!(
                    "{} is none of the creatures that are made here; move it away to go on, or give another folder",
                    path.display()
                );
            }
        }
        for path in unfinished {
            fs::remove_file(&path).with_context(|| format!("{} cannot be removed", path.display()))?;
        }
        Ok(there)
    }

    /// Says no more that it is not complete.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn finish(self) -> Result<()> {
        let path = self.folder.join(NAME);
        fs::remove_file(&path).with_context(|| format!("{} cannot be removed", path.display()))
    }
}

/// Whether an open file is the one at a path: a process that has just finished takes its own away.
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let of = |meta: std::io::Result<fs::Metadata>| meta.ok().map(|meta| (meta.dev(), meta.ino()));
    of(file.metadata()) == of(path.metadata())
}

/// Refuses other settings than those that a folder was begun with.
fn same(before: &[(String, String)], now: &[(String, String)]) -> Result<()> {
    let Some(((name, had), (_, has))) = before.iter().zip(now).find(|(a, b)| a != b) else {
        if before.len() != now.len() {
            bail!("begun by another version of riglab; give another folder");
        }
        return Ok(());
    };
    if name.starts_with("--") {
        bail!("begun with {name} {had}, and not {has}: go on with the same, or give another folder");
    }
    bail!(
        "begun by {name} {had}, and this is {has}, which may make other creatures: go on with that, or give another folder"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(seed: u64) -> Vec<(String, String)> {
        [("--seed", seed.to_string()), ("riglab", "1".into())].map(|(n, v)| (n.to_owned(), v)).into()
    }

    /// A GLB of a header alone.
    fn glb() -> Vec<u8> {
        [b"glTF\x02\0\0\0".as_slice(), &12u32.to_le_bytes()].concat()
    }

    #[test]
    fn a_folder_goes_on_with_what_is_whole_and_with_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let wanted = || ["a.glb", "b.glb", "c.glb"].map(String::from).into_iter();
        let begun = Begun::open(dir.path(), &settings(0)).unwrap();
        assert!(begun.files(wanted()).unwrap().is_empty());
        let said = Begun::open(dir.path(), &settings(0)).err().unwrap().to_string();
        assert!(said.contains("another process"), "{said}");
        drop(begun);
        fs::write(at("a.glb"), glb()).unwrap();
        fs::write(at("b.glb"), &glb()[..11]).unwrap();
        fs::write(at(".riglab-x1.tmp"), "half").unwrap();
        let begun = Begun::open(dir.path(), &settings(0)).unwrap();
        assert_eq!(begun.files(wanted()).unwrap(), BTreeSet::from(["a.glb".to_owned()]));
        assert!(!at(".riglab-x1.tmp").exists());
        // What is somebody else's stays, and ends it before anything is taken away.
        fs::write(at(".riglab-x2.tmp"), "half").unwrap();
        fs::write(at("mine.glb"), glb()).unwrap();
        let said = begun.files(wanted()).unwrap_err().to_string();
        assert!(said.contains("mine.glb is none of the creatures") && at(".riglab-x2.tmp").exists(), "{said}");
        drop(begun);
        let said = format!("{:#}", Begun::open(dir.path(), &settings(1)).err().unwrap());
        assert!(said.contains("begun with --seed 0, and not 1"), "{said}");
        // A complete one is not begun.
        fs::remove_file(at("mine.glb")).unwrap();
        Begun::open(dir.path(), &settings(0)).unwrap().finish().unwrap();
        let said = Begun::open(dir.path(), &settings(0)).err().unwrap().to_string();
        assert!(said.contains("not empty"), "{said}");
    }

    #[test]
    fn a_file_that_is_there_no_more_is_not_held() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(NAME);
        write_first(&path, b"[]").unwrap();
        let mine = File::open(&path).unwrap();
        assert!(is_at(&mine, &path));
        riglab_files::write(&path, b"[]").unwrap();
        assert!(!is_at(&mine, &path) && !is_at(&mine, &dir.path().join("gone")));
    }

    #[test]
    fn another_version_makes_other_creatures() {
        let other = [("--seed".to_owned(), "0".to_owned()), ("riglab".into(), "2".into())];
        let said = same(&settings(0), &other).unwrap_err().to_string();
        assert!(said.contains("begun by riglab 1, and this is 2"), "{said}");
        assert!(same(&settings(0), &other[..1]).is_err() && same(&settings(0), &settings(0)).is_ok());
    }
}
