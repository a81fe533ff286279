//! UniRig's data lists: a folder a line, each with its `raw_data.npz`.

use std::path::{Component, Path, PathBuf};

use super::super::archive::{Archive, Input};
use super::super::fault::{PeerFault, shown};
use super::{Assets, Give, Wanted, unirig};

const FILE: &str = "raw_data.npz";

pub(super) struct DataList {
    /// As the list has them, and where their files are.
    entries: Vec<(String, PathBuf)>,
}

/// The list in a text, if it is one: every line a folder below `folder`, one of them there at least.
pub(super) fn open(text: &str, folder: &Path) -> Option<DataList> {
    let mut entries = Vec::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let below = Path::new(line).components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        if !below || line.len() > 1024 {
            return None;
        }
        entries.push((line.to_owned(), folder.join(line).join(FILE)));
    }
    entries.iter().any(|(_, file)| file.is_file()).then_some(DataList { entries })
}

impl DataList {
    /// The files of its folders, there or not.
    pub(super) fn into_files(self) -> Vec<PathBuf> {
        self.entries.into_iter().map(|(_, file)| file).collect()
    }
}

impl Assets for DataList {
    fn count(&self) -> usize {
        self.entries.len()
    }

    fn each(&mut self, wanted: Wanted, give: Give<'_>) -> Result<(), PeerFault> {
        for (item, (name, file)) in self.entries.iter().enumerate().filter(|(item, _)| wanted.has(*item)) {
            let rig = match file.is_file() {
                true => Archive::open(Input::File(file)).and_then(|mut a| unirig::read(&mut a, wanted.extras)),
                false => Err(PeerFault::field(&shown(name), format!("is listed, but has no {FILE}"))),
            };
            let rig = rig.map(|rig| super::ArrayRig { name: name.clone(), ..rig });
            if give(item, rig).is_break() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_stay_below_their_folder() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("a")).unwrap();
        std::fs::write(dir.path().join("a").join(FILE), b"PK").unwrap();
        assert_eq!(open("a\nmissing/b", dir.path()).unwrap().count(), 2);
        let (list, own) = (dir.path().join("list.txt"), dir.path().join("a").join(FILE));
        std::fs::write(&list, "a\n").unwrap();
        assert_eq!(crate::files_read(&list), [list.clone(), own]);
        assert_eq!(crate::files_of(&list), [list]);
        for text in ["", "b", "a\n../a", "a\n/etc"] {
            assert!(open(text, dir.path()).is_none(), "{text}");
        }
        let mut faults = Vec::new();
        let mut give = |_, rig: Result<_, PeerFault>| {
            faults.push(rig.unwrap_err().to_string());
            std::ops::ControlFlow::Continue(())
        };
        open("a\nmissing/b", dir.path()).unwrap().each(Wanted::default(), &mut give).unwrap();
        assert!(faults[0].contains("zip") && faults[1].contains("`missing/b` is listed"), "{faults:?}");
    }
}
