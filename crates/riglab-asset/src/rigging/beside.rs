//! Files that a model names: material libraries and pictures.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// The largest that is read: 256 MiB.
const LARGEST: u64 = 256 << 20;

/// The contents of a file that a model names, looked for in the model's folder alone, below it as named, else
/// by the last part of the name: exporters write paths of their own machine. `None` where there is none.
///
/// Nothing is opened before it is sure to be a file of the folder, or below it.
pub(super) fn read(folder: Option<&Path>, name: &str) -> Option<Vec<u8>> {
    let folder = folder?.canonicalize().ok()?;
    let name = name.trim().trim_matches('"').replace('\\', "/");
    if name.contains('\0') {
        return None;
    }
    let last = name.rsplit('/').next().unwrap_or_default();
    [name.as_str(), last].into_iter().filter_map(below).find_map(|path| {
        let path = folder.join(path).canonicalize().ok().filter(|path| path.starts_with(&folder))?;
        let about = path.metadata().ok()?;
        if !about.is_file() || about.len() > LARGEST {
            return None;
        }
        let mut bytes = Vec::new();
        File::open(&path).ok()?.take(LARGEST).read_to_end(&mut bytes).ok()?;
        Some(bytes)
    })
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
        let found = |name: &str| read(Some(&inner), name);
        assert_eq!(found("tex\\a b.png"), Some(b"1".to_vec()));
        assert_eq!(found("\"./tex/a b.png\""), Some(b"1".to_vec()));
        for name in ["c.png", "C:\\work\\c.png", "/home/someone/c.png", "../elsewhere/c.png"] {
            assert_eq!(found(name), Some(b"2".to_vec()), "{name}");
        }
        for name in ["../secret", "secret", "", "tex", "/etc/passwd", "a\0b", ".."] {
            assert_eq!(found(name), None, "{name}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(folder.path().join("secret"), inner.join("link")).unwrap();
            assert_eq!(found("link"), None);
        }
        assert_eq!(read(None, "c.png"), None);
    }
}
