//! Texts of rigs, and the OBJ files that belong to them.

use std::path::{Path, PathBuf};

use super::super::array_rig::ArrayRig;
use super::super::fault::PeerFault;
use super::{Assets, One, bytes, data_list, obj, rig_text, skeleton_text};
use crate::Fault;
use crate::export::folder as folder_of;
use crate::format::Reads;
use crate::marked::unmarked;
use crate::peers::Source;
use crate::peers::write::{is_mesh_of, same_lines};

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

    /// Of two texts for one OBJ, the one with weights; both where both have some of their own. Any text may lie in a folder.
    fn is_rig(&self, path: &Path) -> bool {
        let mesh = || mesh_of(path, path.parent()?);
        let chosen = || mesh().and_then(|mesh| beside_obj(&mesh, mesh.parent()?));
        let adds = |chosen: PathBuf| is_same(&chosen, path) || has_weights(path) && !same_lines(&chosen, path);
        starts_as_rig(path) && chosen().is_none_or(adds)
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
                let names: Vec<_> = bases(path).iter().map(|base| format!("`{base}.obj`")).collect();
                return Err(PeerFault::NoObjBeside(names.join(", ")).into());
            }
            Ok(rig)
        }
    }
}

/// The OBJ of a rig text: beside it or, as RigNet's data set has it, in `obj` beside `rig_info` and in
/// `obj_remesh` beside `rig_info_remesh`. Of several that are called so the one that says it is, as those that riglab wrote
/// do; one that says it is another text's only where there is none else and the numbers of vertices do not speak against it.
fn mesh_of(path: &Path, folder: &Path) -> Option<PathBuf> {
    let name = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let other = name.strip_prefix("rig_info").map(|rest| folder.with_file_name(format!("obj{rest}")));
    let bases = bases(path);
    let cased_names =
        |base: &String| cased("obj").into_iter().map(|ending| format!("{base}.{ending}")).collect::<Vec<_>>();
    let names: Vec<String> = bases.iter().flat_map(cased_names).collect();
    let places = std::iter::once(folder.to_path_buf()).chain(other);
    let all = places.flat_map(|place| names.iter().map(move |name| place.join(name)));
    let there: Vec<PathBuf> = all.filter(|path| path.is_file()).collect();
    let own = there.iter().find(|mesh| there.len() > 1 && is_mesh_of(mesh, path));
    let free = || there.iter().find(|mesh| !is_of_another(mesh, path));
    // A second text of one mesh: joints alone, or other weights.
    own.or_else(free).or_else(|| there.iter().find(|mesh| fits(path, mesh))).cloned()
}

/// Whether a rig text has weights for as many vertices as an OBJ has, or none.
fn fits(text: &Path, mesh: &Path) -> bool {
    let fit = || -> Result<bool, Fault> {
        let weights = rig_text::read(utf8(&read_file(text)?)?, None)?.weights;
        let vertices = || obj::read(&read_file(mesh)?).map_err(|e| Fault::Obj(e.to_string()));
        Ok(weights.is_none_or(|weights| vertices().is_ok_and(|(vertices, _)| vertices.len() == weights.rows())))
    };
    fit().unwrap_or(false)
}

/// Whether an OBJ says that it is of another text than this one.
fn is_of_another(mesh: &Path, text: &Path) -> bool {
    let mut others = texts_of(mesh, folder_of(mesh));
    others.retain(|other| !is_same(other, text));
    !others.is_empty() && !is_mesh_of(mesh, text) && others.iter().any(|other| is_mesh_of(mesh, other))
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

/// The rig text that belongs to an OBJ: the same name, with or without `_rig` or `_skin`. Of several the one that the OBJ says,
/// else the first whose mesh it is.
pub(crate) fn beside_obj(path: &Path, folder: &Path) -> Option<PathBuf> {
    let texts = texts_of(path, folder);
    let said = texts.iter().find(|text| texts.len() > 1 && is_mesh_of(path, text));
    let is_mine = |text: &&PathBuf| mesh_of(text, folder).is_some_and(|mesh| is_same(&mesh, path));
    said.or_else(|| texts.iter().find(is_mine)).cloned()
}

/// The rig texts that are called as those of an OBJ are.
fn texts_of(mesh: &Path, folder: &Path) -> Vec<PathBuf> {
    let stem = mesh.file_stem().unwrap_or_default().to_string_lossy();
    let endings = cased("txt");
    let suffixes = SUFFIXES.iter().flat_map(|suffix| cased(suffix));
    let names =
        suffixes.flat_map(|suffix| endings.iter().map(|end| format!("{stem}{suffix}.{end}")).collect::<Vec<_>>());
    // Any text may have the name of a mesh: a note about it, for example.
    names.map(|name| folder.join(name)).filter(|p| p.is_file() && starts_as_rig(p)).collect()
}

/// A part of a name as it is written and in capitals. A look into the folder would tell of other ways, but once for every file
/// of it.
fn cased(word: &str) -> Vec<String> {
    let mut cases = vec![word.to_owned(), word.to_ascii_uppercase()];
    cases.dedup();
    cases
}

/// Whether two paths are of one name in one folder.
fn is_same(a: &Path, b: &Path) -> bool {
    a.file_name() == b.file_name() && folder_of(a) == folder_of(b)
}

/// Whether a rig text has a line of weights.
fn has_weights(path: &Path) -> bool {
    let text = std::fs::read(path).unwrap_or_default();
    text.split(|b| *b == b'\n')
        .any(|line| matches!(line.trim_ascii_start(), [b's', b'k', b'i', b'n', b' ' | b'\t', ..]))
}

/// Whether a file is a rig text, by its start.
pub(crate) fn starts_as_rig(path: &Path) -> bool {
    use std::io::Read;
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|f| f.take(4096).read_to_end(&mut start));
    read.is_ok() && rig_text::is_one(&String::from_utf8_lossy(unmarked(&start)))
}

/// What the OBJ of a rig text may be called, without the ending.
fn bases(path: &Path) -> Vec<String> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let base = |suffix: &&str| {
        let (base, end) = stem.split_at_checked(stem.len().checked_sub(suffix.len())?)?;
        end.eq_ignore_ascii_case(suffix).then(|| base.to_owned())
    };
    let mut bases: Vec<String> = SUFFIXES.iter().filter_map(base).collect();
    bases.sort();
    bases.dedup();
    // The same name first.
    bases.sort_by_key(|base| *base != stem);
    bases
}

fn joined(text: &str, mesh: &[u8]) -> Result<ArrayRig, Fault> {
    let (vertices, faces) = obj::read(mesh).map_err(|e| Fault::Obj(e.to_string()))?;
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
        assert_eq!(bases(Path::new("x/7_rig.txt")), ["7_rig", "7"]);
        assert_eq!(bases(Path::new("7.txt")), ["7"]);
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
    fn halves_find_each_other_in_small_letters_and_in_capitals() {
        for (text, mesh) in
            [("b_rig.txt", "b.OBJ"), ("b_rig.TXT", "b.obj"), ("B_RIG.TXT", "B.OBJ"), ("b_SKIN.txt", "b.obj")]
        {
            let dir = tempfile::tempdir().unwrap();
            let [text, mesh] = [text, mesh].map(|name| dir.path().join(name));
            std::fs::write(&text, "joints a 0 0 0\nroot a\nskin 0 a 1\n").unwrap();
            std::fs::write(&mesh, "v 0 0 0\n").unwrap();
            assert_eq!(mesh_of(&text, dir.path()).as_ref(), Some(&mesh), "{text:?}");
            assert_eq!(beside_obj(&mesh, dir.path()).as_ref(), Some(&text), "{mesh:?}");
            assert!(RigText.is_rig(&text));
        }
    }

    #[test]
    fn pairs_whose_names_could_be_each_others_are_kept_apart() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let write = |name: &str, text: &str| std::fs::write(at(name), text).unwrap();
        let rig = |joint: &str| format!("joints {joint} 0 0 0\nroot {joint}\nskin 0 {joint} 1\n");
        // Nothing in them says whose they are: each is of one only.
        for (name, joint) in [("a.txt", "a"), ("a_skin.txt", "b")] {
            write(name, &rig(joint));
            write(&name.replace(".txt", ".obj"), "v 0 0 0\n");
        }
        let found = ["a.obj", "a_skin.obj"].map(|name| beside_obj(&at(name), dir.path()).unwrap());
        assert_eq!(found, ["a.txt", "a_skin.txt"].map(at));
        assert!(found.iter().all(|text| RigText.is_rig(text)));
        // A text with weights of its own is one more rig of the mesh; one of joints alone is not, nor is the same once more.
        write("c.obj", "v 0 0 0\n");
        write("c_rig.txt", &rig("a"));
        for (text, counts) in [(rig("b"), true), ("joints b 0 0 0\nroot b\n".into(), false), (rig("a"), false)] {
            write("c_skel.txt", &text);
            assert_eq!(RigText.is_rig(&at("c_skel.txt")), counts, "{text}");
        }
        assert!(RigText.is_rig(&at("c_rig.txt")));
    }

    #[test]
    fn a_mesh_that_says_whose_it_is_serves_other_texts_that_have_none() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let write = |name: &str, text: &str| std::fs::write(at(name), text).unwrap();
        let mesh = riglab_core::Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let joints = vec![riglab_core::Joint { name: "a".into(), parent: None, head: [0.0; 3] }];
        let weights = riglab_core::SkinWeights::normalized((0..3).map(|_| vec![(0, 1.0)])).unwrap();
        let rig = riglab_core::Rig::new(riglab_core::Skeleton::new(joints).unwrap(), mesh, weights).unwrap();
        let asset = riglab_core::Asset { name: "c".into(), rig, clips: vec![], provenance: Default::default() };
        crate::write(&[asset], at("c_rig.txt"), crate::Target::RIGNET).unwrap();
        let skin = |vertices: usize| (0..vertices).map(|v| format!("skin {v} b 1\n")).collect::<String>();
        for (name, vertices, is_rig) in [("c_skel.txt", 0, false), ("c_skin.txt", 3, true)] {
            write(name, &format!("joints b 0 0 0\nroot b\n{}", skin(vertices)));
            assert_eq!(
                (mesh_of(&at(name), dir.path()), RigText.is_rig(&at(name))),
                (Some(at("c.obj")), is_rig),
                "{name}"
            );
            let rig = read(&at(name), &std::fs::read(at(name)).unwrap(), Some(dir.path())).unwrap();
            assert_eq!(rig.vertices.len(), 3, "{name}");
        }
        // Of as many vertices it is not.
        write("c_skin.txt", &format!("joints b 0 0 0\nroot b\n{}", skin(2)));
        assert_eq!(mesh_of(&at("c_skin.txt"), dir.path()), None);
        // One that nobody claims comes first.
        write("c_skel.obj", "v 0 0 0\n");
        assert_eq!(mesh_of(&at("c_skel.txt"), dir.path()), Some(at("c_skel.obj")));
        assert_eq!(beside_obj(&at("c.obj"), dir.path()), Some(at("c_rig.txt")));
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
