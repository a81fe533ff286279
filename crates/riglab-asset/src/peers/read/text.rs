//! Texts of rigs, and the OBJ files that belong to them.

use std::path::{Path, PathBuf};

use super::super::array_rig::ArrayRig;
use super::super::fault::PeerFault;
use super::{Assets, One, bytes, data_list, obj, rig_text, skeleton_text};
use crate::Fault;
use crate::format::Reads;
use crate::marked::unmarked;
use crate::peers::Source;

/// Text of joints and weights (RigNet, Puppeteer), or a list of folders (UniRig).
pub(crate) struct RigText;

impl Reads for RigText {
    fn name(&self) -> &'static str {
        "rig text"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["txt"]
    }

    fn has_models(&self) -> bool {
        false
    }

    fn short(&self) -> Option<&'static str> {
        Some("rignet")
    }

    /// Of two texts for one OBJ, the one with weights. Any text may lie in a folder.
    fn is_rig(&self, path: &Path) -> bool {
        let mesh = || mesh_of(path, path.parent()?);
        let chosen = || mesh().and_then(|mesh| beside_obj(&mesh, mesh.parent()?));
        starts_as_rig(path) && chosen().is_none_or(|chosen| chosen == path)
    }

    fn beside(&self, path: &Path, folder: &Path) -> Vec<PathBuf> {
        mesh_of(path, folder).into_iter().collect()
    }

    fn listed(&self, path: &Path, folder: &Path) -> Vec<PathBuf> {
        let text = std::fs::read(path).ok();
        let text = text.as_deref().and_then(|bytes| std::str::from_utf8(unmarked(bytes)).ok());
        text.and_then(|text| list(text, folder)).map_or_else(Vec::new, data_list::DataList::into_files)
    }

    /// A list does not say it.
    fn holds_several(&self) -> bool {
        false
    }

    fn open<'a>(&self, file: &Source<'a>, _: bool) -> Result<Box<dyn Assets + 'a>, Fault> {
        let bytes = bytes(file.input)?;
        let text = || std::str::from_utf8(unmarked(&bytes)).ok();
        match file.folder.and_then(|folder| list(text()?, folder)) {
            Some(list) => Ok(Box::new(list)),
            None => Ok(One::boxed(read(file.path, &bytes, file.folder)?)),
        }
    }
}

/// What is put between the common part of a pair's names and `.txt`; the one with weights comes before
/// the one without.
const SUFFIXES: [&str; 4] = ["_rig", "_skin", "", "_skel"];

/// The list in a text. Each line of one is looked for as a folder, and a rig has one for each of its vertices: a text whose
/// first line is one of a rig is none. A folder may be called as such a line begins.
fn list(text: &str, folder: &Path) -> Option<data_list::DataList> {
    let first = text.lines().map(str::trim).find(|line| !line.is_empty())?;
    let has_words = first.contains(char::is_whitespace);
    let is_rig = has_words && (rig_text::is_one(first) || skeleton_text::is_one(first));
    if is_rig { None } else { data_list::open(text, folder) }
}

/// A rig text and the OBJ beside it. A text without OBJ is read without mesh.
fn read(path: &Path, bytes: &[u8], folder: Option<&Path>) -> Result<ArrayRig, Fault> {
    let text = utf8(bytes)?;
    if !rig_text::is_one(text) {
        if skeleton_text::is_one(text) {
            return Ok(skeleton_text::read(text)?);
        }
        return Err(PeerFault::NoRigText.into());
    }
    let Some(folder) = folder else { return Ok(rig_text::read(text, None)?) };
    match mesh_of(path, folder) {
        Some(mesh) => joined(text, &read_file(&mesh)?),
        None => {
            let rig = rig_text::read(text, None)?;
            // Weights count vertices, and there is no telling of which mesh.
            if rig.weights.is_some() {
                let names: Vec<_> = obj_names(path).iter().map(|n| format!("`{n}`")).collect();
                return Err(PeerFault::NoObjBeside(names.join(", ")).into());
            }
            Ok(rig)
        }
    }
}

/// The OBJ of a rig text: beside it or, as RigNet's data set has it, in `obj` beside `rig_info` and in
/// `obj_remesh` beside `rig_info_remesh`.
fn mesh_of(path: &Path, folder: &Path) -> Option<PathBuf> {
    let name = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let other = name.strip_prefix("rig_info").map(|rest| folder.with_file_name(format!("obj{rest}")));
    let names = obj_names(path);
    let places = std::iter::once(folder.to_path_buf()).chain(other);
    places
        .into_iter()
        .flat_map(|place| names.iter().map(move |n| place.join(n)).collect::<Vec<_>>())
        .find(|p| p.is_file())
}

/// An OBJ with the rig text beside it.
pub(crate) fn open_pair<'a>(file: &Source<'a>) -> Result<Box<dyn Assets + 'a>, Fault> {
    Ok(One::boxed(with_obj(file.path, &bytes(file.input)?, file.folder)?))
}

/// An OBJ and the rig text beside it.
fn with_obj(path: &Path, bytes: &[u8], folder: Option<&Path>) -> Result<ArrayRig, Fault> {
    let text = match folder.and_then(|folder| beside_obj(path, folder)) {
        Some(text) => read_file(&text)?,
        None => return Err(PeerFault::NoRigText.into()),
    };
    joined(utf8(&text)?, bytes)
}

/// The rig text that belongs to an OBJ: the same name, with or without `_rig` or `_skin`.
pub(crate) fn beside_obj(path: &Path, folder: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let candidates = SUFFIXES.iter().map(|suffix| folder.join(format!("{stem}{suffix}.txt")));
    // Any text may have the name of a mesh: a note about it, for example.
    candidates.into_iter().find(|p| p.is_file() && starts_as_rig(p))
}

/// Whether a file is a rig text, by its start.
pub(crate) fn starts_as_rig(path: &Path) -> bool {
    use std::io::Read;
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|f| f.take(4096).read_to_end(&mut start));
    read.is_ok() && rig_text::is_one(&String::from_utf8_lossy(unmarked(&start)))
}

/// Names that the OBJ of a rig text may have.
fn obj_names(path: &Path) -> Vec<String> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let bases = SUFFIXES.iter().filter_map(|suffix| stem.strip_suffix(suffix));
    let mut names: Vec<String> = bases.map(|base| format!("{base}.obj")).collect();
    names.sort();
    names.dedup();
    // The same name first.
    names.sort_by_key(|name| *name != format!("{stem}.obj"));
    names
}

fn joined(text: &str, mesh: &[u8]) -> Result<ArrayRig, Fault> {
    let (vertices, faces) = obj::read(utf8(mesh)?).map_err(|e| Fault::Obj(e.to_string()))?;
    let mut rig = rig_text::read(text, Some(vertices.len()))?;
    (rig.vertices, rig.faces) = (vertices, faces);
    Ok(rig)
}

fn read_file(path: &Path) -> Result<Vec<u8>, Fault> {
    std::fs::read(path).map_err(|e| Fault::Unreadable(format!("{}: {e}", path.display())))
}

fn utf8(bytes: &[u8]) -> Result<&str, PeerFault> {
    std::str::from_utf8(unmarked(bytes)).map_err(|e| PeerFault::NotUtf8(e.valid_up_to()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_half_of_a_pair_finds_the_other() {
        assert_eq!(obj_names(Path::new("x/7_rig.txt")), ["7_rig.obj", "7.obj"]);
        assert_eq!(obj_names(Path::new("7.txt")), ["7.obj"]);
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
        write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
        write("a.txt", "made by hand\n");
        assert_eq!(beside_obj(&dir.path().join("a.obj"), dir.path()), None);
        write("a_rig.txt", "joints a 0 0 0\nroot a\nskin 0 a 1\n");
        let found = beside_obj(&dir.path().join("a.obj"), dir.path()).unwrap();
        assert_eq!(found, dir.path().join("a_rig.txt"));
        let rig = read(&found, &std::fs::read(&found).unwrap(), Some(dir.path())).unwrap();
        assert_eq!((rig.vertices.len(), rig.weights.unwrap().rows()), (3, 3));
    }

    #[test]
    fn lines_of_a_rig_are_not_looked_for_as_folders() {
        let dir = tempfile::tempdir().unwrap();
        let found = |first: &str| {
            // Were it looked for, it would be there.
            std::fs::create_dir_all(dir.path().join(first)).unwrap();
            std::fs::write(dir.path().join(first).join("raw_data.npz"), "PK").unwrap();
            list(&format!("\n{first}\n"), dir.path()).is_some()
        };
        assert_eq!(["joints a 0 0 0", "0 root 0 0 0 None"].map(found), [false; 2]);
        assert_eq!(["root", "skin", "rigs/joints 7"].map(found), [true; 3]);
    }

    #[test]
    fn meshes_of_the_data_set_lie_in_a_folder_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let (texts, meshes) = (dir.path().join("rig_info_remesh"), dir.path().join("obj_remesh"));
        std::fs::create_dir(&texts).unwrap();
        std::fs::create_dir(&meshes).unwrap();
        assert_eq!(mesh_of(&texts.join("7.txt"), &texts), None);
        std::fs::write(meshes.join("7.obj"), "").unwrap();
        assert_eq!(mesh_of(&texts.join("7.txt"), &texts), Some(meshes.join("7.obj")));
    }
}
