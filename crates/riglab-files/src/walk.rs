//! Files of a folder and those below it.

use std::collections::{BTreeSet, HashMap};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use walkdir::WalkDir;

/// What is below a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Below {
    /// Wanted files, sorted by path.
    pub files: Vec<PathBuf>,
    /// Folders and links that could not be followed, with the reason.
    pub unread: Vec<(PathBuf, String)>,
    /// Hidden folders, whatever is in them, and hidden files that would have been wanted: left aside.
    pub hidden: Vec<PathBuf>,
}

impl Below {
    /// A sentence on what is hidden, where there is any.
    pub fn left_aside(&self) -> Option<String> {
        let first = self.hidden.first()?;
        let name = first.display();
        Some(match self.hidden.len() - 1 {
            0 => format!("hidden and not taken: {name}"),
            more => format!("hidden and not taken: {name} and {more} more"),
        })
    }
}

/// Whether a name is hidden, or of a folder where macOS's archives keep what is none of their files.
fn is_hidden(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(b".") || name == "__MACOSX"
}

/// The files of a folder and those below it that are `wanted`. Links are followed, as data sets are
/// often put together from them; one that leads back above itself is not, nor is one to a folder that is
/// read already: each folder is read once, by its own place where that is below, else by the first link to it.
/// A folder that cannot be read is told and does not end the walk, and so is what has a file's name and is neither file nor
/// folder. What is hidden below the folder is left aside: a `.git`, or the `._a.glb` that macOS puts beside an `a.glb`.
pub fn below(folder: &Path, wanted: impl Fn(&Path) -> bool) -> Below {
    let mut walk = Walk { wanted, found: Below::default(), read: HashMap::new(), links: BTreeSet::new() };
    walk.tree(folder);
    // Links come after all that has a place of its own, in an order that no file system chooses.
    while let Some(link) = walk.links.pop_first() {
        walk.link(&link);
    }
    let mut found = walk.found;
    found.files.sort();
    found.unread.sort();
    found.hidden.sort();
    found
}

struct Walk<W> {
    wanted: W,
    found: Below,
    /// Folders that were read: the path that they were read by, by the real one.
    read: HashMap<PathBuf, PathBuf>,
    /// Links to folders that are still to be followed.
    links: BTreeSet<PathBuf>,
}

impl<W: Fn(&Path) -> bool> Walk<W> {
    /// Follows a link to a folder, unless that was read.
    fn link(&mut self, link: &Path) {
        let real = match link.canonicalize() {
            Ok(real) => real,
            Err(e) => return self.found.unread.push((link.into(), e.to_string())),
        };
        let within = link.parent().and_then(|above| above.canonicalize().ok());
        if within.is_some_and(|within| within.starts_with(&real)) {
            let told = self.read.get(&real).map_or(real.as_path(), PathBuf::as_path).display();
            self.found.unread.push((link.into(), format!("it leads back to {told}")));
        } else if !self.read.contains_key(&real) {
            self.tree(link);
        }
    }

    /// Reads a folder and those below it that were not read yet, links aside.
    fn tree(&mut self, folder: &Path) {
        let real = folder.canonicalize().unwrap_or_else(|_| folder.into());
        let mut entries = WalkDir::new(folder).into_iter();
        while let Some(entry) = entries.next() {
            let entry = match entry {
                Ok(entry) => entry,
                Err(e) => {
                    let path = e.path().unwrap_or(folder).to_path_buf();
                    let reason = e.io_error().map_or_else(|| e.to_string(), ToString::to_string);
                    self.found.unread.push((path, reason));
                    continue;
                }
            };
            let path = entry.path();
            let hidden = entry.depth() > 0 && is_hidden(entry.file_name());
            // What a link leads to, and what is given may be one.
            let kind = match entry.path_is_symlink() {
                true => path.metadata().map(|meta| meta.file_type()).map_err(|e| e.to_string()),
                false => Ok(entry.file_type()),
            };
            match kind {
                Ok(kind) if hidden && kind.is_dir() => {
                    if !entry.path_is_symlink() {
                        entries.skip_current_dir();
                    }
                    self.found.hidden.push(path.into());
                }
                Ok(_) if hidden && (self.wanted)(path) => self.found.hidden.push(path.into()),
                _ if hidden => {}
                Ok(kind) if kind.is_dir() && entry.path_is_symlink() && entry.depth() > 0 => {
                    self.links.insert(path.into());
                }
                Ok(kind) if kind.is_dir() => {
                    // Nothing on the way down is a link.
                    let own = path.strip_prefix(folder).map_or_else(|_| real.clone(), |below| real.join(below));
                    let known = self.read.contains_key(&own);
                    if known {
                        entries.skip_current_dir();
                    } else {
                        self.read.insert(own, path.into());
                    }
                }
                Ok(kind) if (self.wanted)(path) => match kind.is_file() {
                    true => self.found.files.push(path.into()),
                    false => self.found.unread.push((path.into(), "it is no plain file".into())),
                },
                Ok(_) => {}
                Err(reason) => self.found.unread.push((path.into(), reason)),
            }
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    fn models(folder: &Path) -> Below {
        below(folder, |p| p.extension().is_some_and(|e| e == "glb"))
    }

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
        let found = models(dir.path());
        assert_eq!(found.files, ["a/c.glb", "b.glb", "linked/e.glb"].map(at));
        let unread: Vec<_> = found.unread.iter().map(|(p, _)| p.clone()).collect();
        assert_eq!(unread, [at("a/up"), at("broken.glb")]);
        assert!(found.unread[0].1.contains("leads back"), "{}", found.unread[0].1);
        // The folder itself may be a link.
        symlink(dir.path(), other.path().join("all")).unwrap();
        assert_eq!(models(&other.path().join("all")).files.len(), 3);
    }

    #[test]
    fn what_is_hidden_and_what_is_no_plain_file_is_told_and_not_taken() {
        let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        // The folder itself may be hidden.
        let root = dir.path().join(".models");
        let at = |name: &str| root.join(name);
        ["a/.git", "__MACOSX"].iter().for_each(|name| fs::create_dir_all(at(name)).unwrap());
        for file in ["a/b.glb", "a/.git/c.glb", "__MACOSX/d.glb", "._b.glb", ".notes"] {
            fs::write(at(file), b"").unwrap();
        }
        symlink(other.path(), at(".linked")).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("e.glb")).unwrap();
        let found = models(&root);
        assert_eq!(found.files, [at("a/b.glb")]);
        assert_eq!(found.hidden, ["._b.glb", ".linked", "__MACOSX", "a/.git"].map(at));
        let told = found.left_aside().unwrap();
        assert!(told.ends_with("._b.glb and 3 more"), "{told}");
        assert_eq!(found.unread, [(at("e.glb"), "it is no plain file".to_owned())]);
        assert_eq!(Below::default().left_aside(), None);
    }

    #[test]
    fn each_folder_is_read_once_however_many_links_lead_to_it() {
        let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let at = |name: &str| dir.path().join(name);
        fs::create_dir_all(at("in/sub")).unwrap();
        fs::create_dir_all(other.path().join("far")).unwrap();
        for file in [at("out.glb"), at("in/a.glb"), at("in/sub/b.glb"), other.path().join("far/c.glb")] {
            fs::write(file, b"").unwrap();
        }
        // Above the input, from one folder to another, and two links to one place, which itself leads back.
        symlink("..", at("in/loop")).unwrap();
        symlink("sub", at("in/again")).unwrap();
        symlink(other.path(), at("in/x")).unwrap();
        symlink(other.path().join("far"), at("in/y")).unwrap();
        symlink(at("in"), other.path().join("back")).unwrap();
        let found = models(&at("in"));
        assert_eq!(found.files, ["in/a.glb", "in/sub/b.glb", "in/x/far/c.glb"].map(at));
        let told: Vec<_> = found.unread.iter().map(|(path, reason)| (path.clone(), reason.as_str())).collect();
        // Of what is read by another way nothing is missing.
        let [up] = &told[..] else { panic!("{told:?}") };
        assert!(up.0 == at("in/loop") && up.1.starts_with("it leads back to "), "{told:?}");
    }
}
