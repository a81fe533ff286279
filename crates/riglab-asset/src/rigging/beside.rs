//! Files that a model names: material libraries and pictures.

use std::cell::OnceCell;
use std::collections::HashMap;
use std::fs::{DirEntry, File};
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use super::SubjectNote;
use super::obj::stem;
use crate::gltf::export::model::Picture;
use crate::pictures::for_gltf;

/// The largest that is read: 256 MiB.
const LARGEST: u64 = 256 << 20;

/// Folders in a folder that are looked through; where there are more, they are not those of one model.
const FOLDERS: usize = 32;

/// What lies in a model's folder.
pub(super) struct Beside {
    /// `None` where nothing is looked for.
    folder: Option<PathBuf>,
    /// The files of the folder and of its folders, by their names in small letters; `None` where several have one. Made when a
    /// name is not found as it is.
    names: OnceCell<HashMap<String, Option<PathBuf>>>,
}

impl Beside {
    pub(super) fn new(folder: Option<&Path>) -> Self {
        Self { folder: folder.and_then(|folder| folder.canonicalize().ok()), names: OnceCell::new() }
    }

    /// The contents of a file that a model names, looked for in the model's folder alone, below it as named, else
    /// by the last part of the name: exporters write paths of their own machine. Then in the folders of that folder, where
    /// letters may be large or small: those who share models sort pictures into folders. `None` where there is none, or where
    /// several folders have one.
    ///
    /// Nothing is opened before it is sure to be a file of the folder, or below it.
    pub(super) fn read(&self, name: &str) -> Option<Vec<u8>> {
        let folder = self.folder.as_ref()?;
        let name = name.trim().trim_matches('"').replace('\\', "/");
        if name.contains('\0') {
            return None;
        }
        let last = name.rsplit('/').next().unwrap_or_default();
        let open = |path: PathBuf| {
            let path = path.canonicalize().ok().filter(|path| path.starts_with(folder))?;
            let about = path.metadata().ok()?;
            if !about.is_file() || about.len() > LARGEST {
                return None;
            }
            let mut bytes = Vec::new();
            File::open(&path).ok()?.take(LARGEST).read_to_end(&mut bytes).ok()?;
            Some(bytes)
        };
        let named = || [name.as_str(), last].into_iter().filter_map(below).find_map(|path| open(folder.join(path)));
        let alike = || self.names.get_or_init(|| names(folder)).get(&last.to_lowercase())?.clone();
        named().or_else(|| open(alike()?))
    }

    /// A picture that a model names, looked for as by [`Self::read`]; else what to tell.
    pub(super) fn picture(&self, name: &str) -> Result<Picture, SubjectNote> {
        let bytes = self.read(name).ok_or_else(|| SubjectNote::FileMissing(name.to_owned()))?;
        let bytes = for_gltf(name, bytes).ok_or_else(|| SubjectNote::OtherPicture(name.to_owned()))?;
        Ok(Picture { name: stem(name), bytes })
    }
}

/// See [`Beside::names`]; what lies in the folder itself counts before what lies in its folders.
fn names(folder: &Path) -> HashMap<String, Option<PathBuf>> {
    // All, however many: in which order a folder tells them is chance.
    let entries = |of: &Path| {
        let found = std::fs::read_dir(of).into_iter().flatten().flatten();
        // What a folder tells with the name: to look at each of many is slow.
        let is_folder = |entry: &DirEntry| {
            let of_name = entry.file_type().ok().filter(|kind| !kind.is_symlink());
            of_name.map_or_else(|| entry.path().is_dir(), |kind| kind.is_dir())
        };
        let mut all: Vec<(PathBuf, bool)> = found.map(|entry| (entry.path(), is_folder(&entry))).collect();
        all.sort_unstable();
        all
    };
    let called = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let (folders, files): (Vec<_>, Vec<_>) = entries(folder).into_iter().partition(|(_, is_folder)| *is_folder);
    let mut names = HashMap::new();
    if folders.len() <= FOLDERS {
        for (path, _) in folders.iter().filter(|(path, _)| !path.is_symlink()).flat_map(|(path, _)| entries(path)) {
            names.entry(called(&path)).and_modify(|known| *known = None).or_insert(Some(path));
        }
    }
    // The first of several that differ in large and small letters.
    names.extend(files.into_iter().rev().map(|(path, _)| (called(&path), Some(path))));
    names
}

/// A relative path that does not leave where it starts.
fn below(name: &str) -> Option<PathBuf> {
    let path = Path::new(name);
    let plain = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    (!name.is_empty() && !name.contains(':') && path.components().all(plain)).then(|| path.to_path_buf())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_folder_are_found_and_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("model");
        std::fs::create_dir_all(inner.join("tex")).unwrap();
        std::fs::write(folder.path().join("secret"), b"s").unwrap();
        std::fs::write(inner.join("tex/a b.png"), b"1").unwrap();
        std::fs::write(inner.join("c.png"), b"2").unwrap();
        let found = |name: &str| Beside::new(Some(&inner)).read(name);
        assert_eq!(found("tex\\a b.png"), Some(b"1".to_vec()));
        assert_eq!(found("\"./tex/a b.png\""), Some(b"1".to_vec()));
        for name in ["c.png", "C:\\work\\c.png", "/home/someone/c.png", "../elsewhere/c.png"] {
            assert_eq!(found(name), Some(b"2".to_vec()), "{name}");
        }
        // In a folder of the folder, and in letters that other systems take for the same.
        for name in ["/home/someone/a b.png", "A B.PNG", "textures\\a b.png", "TEX/A b.png"] {
            assert_eq!(found(name), Some(b"1".to_vec()), "{name}");
        }
        assert_eq!(found("C.png"), Some(b"2".to_vec()));
        std::fs::create_dir(inner.join("other")).unwrap();
        std::fs::write(inner.join("other/A b.png"), b"3").unwrap();
        assert_eq!((found("A b.png"), found("tex/a b.png")), (None, Some(b"1".to_vec())));
        for name in ["../secret", "secret", "", "tex", "TEX", "/etc/passwd", "a\0b", ".."] {
            assert_eq!(found(name), None, "{name}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(folder.path().join("secret"), inner.join("link")).unwrap();
            std::os::unix::fs::symlink(folder.path(), inner.join("out")).unwrap();
            for name in ["link", "LINK", "out/secret", "SECRET"] {
                assert_eq!(found(name), None, "{name}");
            }
        }
        assert_eq!(Beside::new(None).read("c.png"), None);
    }

    #[test]
    fn however_many_files_there_are_all_are_looked_through() {
        let folder = tempfile::tempdir().unwrap();
        let all = 0..5000;
        all.clone().for_each(|n| std::fs::write(folder.path().join(format!("{n}.Png")), n.to_string()).unwrap());
        let beside = Beside::new(Some(folder.path()));
        assert!(all.clone().all(|n| beside.read(&format!("{n}.png")) == Some(n.to_string().into())));
    }
}
