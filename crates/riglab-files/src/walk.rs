//! Files of a folder and those below it.

use std::path::{Path, PathBuf};

use walkdir::WalkDir;

/// What is below a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Below {
    /// Wanted files, sorted by path.
    pub files: Vec<PathBuf>,
    /// Folders and links that could not be followed, with the reason.
    pub unread: Vec<(PathBuf, String)>,
}

/// The files of a folder and those below it that are `wanted`. Links are followed, as data sets are
/// often put together from them; one that leads back above itself is not. A folder that cannot be read
/// is told and does not end the walk.
pub fn below(folder: &Path, wanted: impl Fn(&Path) -> bool) -> Below {
    let mut found = Below::default();
    for entry in WalkDir::new(folder).follow_links(true) {
        match entry {
            Ok(entry) if entry.file_type().is_file() && wanted(entry.path()) => found.files.push(entry.into_path()),
            Ok(_) => {}
            Err(e) => {
                let path = e.path().unwrap_or(folder).to_path_buf();
                let reason = match (e.loop_ancestor(), e.io_error()) {
                    (Some(above), _) => format!("it leads back to {}", above.display()),
                    (_, Some(io)) => io.to_string(),
                    _ => e.to_string(),
                };
                found.unread.push((path, reason));
            }
        }
    }
    found.files.sort();
    found.unread.sort();
    found
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_are_followed_but_not_in_circles() {
        let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let at = |name: &str| dir.path().join(name);
        fs::create_dir(at("a")).unwrap();
        for file in ["b.glb", "a/c.glb", "a/d.txt"] {
            fs::write(at(file), b"").unwrap();
        }
        fs::write(other.path().join("e.glb"), b"").unwrap();
        symlink(other.path(), at("linked")).unwrap();
        symlink(dir.path(), at("a/up")).unwrap();
        symlink(at("nowhere"), at("broken.glb")).unwrap();
        let found = below(dir.path(), |p| p.extension().is_some_and(|e| e == "glb"));
        assert_eq!(found.files, ["a/c.glb", "b.glb", "linked/e.glb"].map(at));
        let unread: Vec<_> = found.unread.iter().map(|(p, _)| p.clone()).collect();
        assert_eq!(unread, [at("a/up"), at("broken.glb")]);
        assert!(found.unread[0].1.contains("leads back"), "{}", found.unread[0].1);
    }
}
