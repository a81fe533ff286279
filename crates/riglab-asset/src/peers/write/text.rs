//! Rig texts and the OBJ beside them. Numbers are written so that reading them gives the same f32.

use std::collections::VecDeque;
use std::fmt::Write;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use riglab_core::{Asset, JointId, Mesh, Rig};

use super::target::{Writes, Written};
use super::{WriteError, WriteNote};
use crate::maker::MAKER;
use crate::names::Names;
use crate::peers::starts_as_rig;

/// RigNet's text, `_rig.txt`, with an OBJ.
pub(super) struct RigNet;

/// Puppeteer's text with an OBJ.
pub(super) struct Puppeteer;

impl Writes for RigNet {
    fn name(&self) -> &'static str {
        "rignet"
    }

    fn suffix(&self) -> &'static str {
        "_rig.txt"
    }

    fn is_at(&self, path: &Path, start: &[u8]) -> bool {
        is_half(path, start)
    }

    fn is_own(&self, path: &Path, start: &[u8]) -> bool {
        is_own_half(path, start)
    }

    fn beside(&self, path: &Path) -> Option<PathBuf> {
        Some(mesh_path(path))
    }

    fn files(&self, assets: &[Asset], notes: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        Ok(pair(assets, notes, |of| [of.joints, of.root, of.skin, of.hier]))
    }
}

impl Writes for Puppeteer {
    fn name(&self) -> &'static str {
        "puppeteer"
    }

    fn suffix(&self) -> &'static str {
        ".txt"
    }

    /// RigNet's are texts, too.
    fn is_told_by(&self, _: &str) -> bool {
        false
    }

    fn is_at(&self, path: &Path, start: &[u8]) -> bool {
        is_half(path, start)
    }

    fn is_own(&self, path: &Path, start: &[u8]) -> bool {
        is_own_half(path, start)
    }

    fn beside(&self, path: &Path) -> Option<PathBuf> {
        Some(mesh_path(path))
    }

    fn files(&self, assets: &[Asset], notes: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        Ok(pair(assets, notes, |of| [of.joints, of.root, of.hier, of.skin]))
    }
}

/// Whether a file is a rig text or the mesh of one.
fn is_half(path: &Path, start: &[u8]) -> bool {
    match path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("txt")) {
        true => starts_as_rig(path),
        false => is_obj(start),
    }
}

/// Whether a file that starts like this is an OBJ.
pub(super) fn is_obj(start: &[u8]) -> bool {
    let vertex = |line: &[u8]| matches!(line.trim_ascii_start(), [b'v', b' ' | b'\t', ..]);
    start.split(|b| *b == b'\n').any(vertex)
}

/// Whether riglab wrote an OBJ that starts like this.
pub(super) fn is_own_obj(start: &[u8]) -> bool {
    start.starts_with(b"# riglab ")
}

/// Whether riglab wrote a rig text, or the mesh of one. A text is as it was if its mesh says so: readers of texts know no
/// comments.
fn is_own_half(path: &Path, start: &[u8]) -> bool {
    if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("txt")) {
        return is_own_obj(start);
    }
    is_mesh_of(&mesh_path(path), path)
}

/// Whether an OBJ that riglab wrote says in its first line that it is of a rig text, which is as it was then.
pub(crate) fn is_mesh_of(mesh: &Path, text: &Path) -> bool {
    let mut start = Vec::new();
    let read = File::open(mesh).and_then(|file| file.take(1 << 10).read_to_end(&mut start));
    let said = start.split(|b| *b == b'\n').next().unwrap_or_default();
    read.is_ok() && is_own_obj(said) && std::fs::read(text).is_ok_and(|text| said.ends_with(digest(&text).as_bytes()))
}

/// Whether two rig texts say the same, in whatever order.
pub(crate) fn same_lines(a: &Path, b: &Path) -> bool {
    matches!((std::fs::read(a), std::fs::read(b)), (Ok(a), Ok(b)) if digest(&a) == digest(&b))
}

/// What tells a text from others, in hexadecimal digits: by its lines in whatever order, so that the two formats, which have
/// the same lines, may have one mesh.
fn digest(text: &[u8]) -> String {
    let mut lines: Vec<&[u8]> = text.split(|b| *b == b'\n').collect();
    lines.sort_unstable();
    blake3::hash(&lines.join(&b'\n')).to_hex()[..16].to_owned()
}

/// An OBJ without the line that says that riglab wrote it.
pub(super) fn bare_obj(obj: &[u8]) -> &[u8] {
    let end = obj.iter().position(|b| *b == b'\n').filter(|_| is_own_obj(obj));
    &obj[end.map_or(0, |end| end + 1)..]
}

/// The meshes of assets.
pub(super) fn objs(assets: &[Asset]) -> Vec<u8> {
    assets.iter().flat_map(|asset| obj(asset.rig.mesh()).into_bytes()).collect()
}

/// A text with its blocks in an order, and the mesh.
fn pair(assets: &[Asset], notes: &mut Vec<WriteNote>, order: fn(Blocks) -> [String; 4]) -> Written {
    let file: Vec<u8> =
        assets.iter().flat_map(|asset| order(blocks(&asset.rig, notes)).concat().into_bytes()).collect();
    let of_text = format!("of the rig text {}", digest(&file));
    let beside = assets.iter().flat_map(|asset| obj_saying(&of_text, asset.rig.mesh()).into_bytes()).collect();
    Written { file, beside: Some(beside) }
}

/// Where the mesh of a rig text goes.
fn mesh_path(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{}.obj", stem.strip_suffix("_rig").unwrap_or(&stem)))
}

/// The mesh with normals, in a form that all the peers' readers take.
pub(super) fn obj(mesh: &Mesh) -> String {
    obj_saying("a mesh", mesh)
}

/// The same, with what it is in its first line, a comment.
fn obj_saying(what: &str, mesh: &Mesh) -> String {
    let mut out = format!("# {MAKER}: {what}\n");
    let rows = [("v", mesh.positions().to_vec()), ("vn", mesh.vertex_normals())];
    for (word, points) in rows {
        for [x, y, z] in points {
            let _ = writeln!(out, "{word} {x} {y} {z}");
        }
    }
    for t in mesh.triangles() {
        let [a, b, c] = t.map(|v| u64::from(v) + 1);
        let _ = writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}");
    }
    out
}

/// What a rig text says.
struct Blocks {
    joints: String,
    root: String,
    hier: String,
    skin: String,
}

/// Names as words, each of its own: those that are words stay, whatever the others become.
fn words(names: &[String]) -> Vec<String> {
    let ends = |c: char| c.is_whitespace() || c.is_control();
    let mut unique = Names::default();
    let mut words = vec![String::new(); names.len()];
    let (others, own): (Vec<_>, Vec<_>) = words.iter_mut().zip(names).partition(|(_, name)| name.contains(ends));
    for (word, name) in own.into_iter().chain(others) {
        *word = unique.unique(&name.replace(ends, "_"), || "joint".to_owned());
    }
    words
}

fn blocks(rig: &Rig, notes: &mut Vec<WriteNote>) -> Blocks {
    let skeleton = rig.skeleton();
    let names = words(skeleton.names());
    let changed = names.iter().zip(skeleton.names()).filter(|(word, name)| word != name).count();
    if changed > 0 {
        notes.push(WriteNote::Blanks { joints: changed });
    }
    let name = |joint: JointId| &names[joint.index()];
    let (mut joints, mut hier, mut skin) = (String::new(), String::new(), String::new());
    for joint in skeleton.ids() {
        let [x, y, z] = skeleton.head(joint);
        let _ = writeln!(joints, "joints {} {x} {y} {z}", name(joint));
    }
    // Breadth first, as RigNet's own writer.
    let children = skeleton.children();
    let mut open = VecDeque::from([JointId(0)]);
    while let Some(parent) = open.pop_front() {
        for &child in &children[parent.index()] {
            let _ = writeln!(hier, "hier {} {}", name(parent), name(child));
            open.push_back(child);
        }
    }
    for vertex in 0..rig.weights().rows() {
        let _ = write!(skin, "skin {vertex}");
        for (joint, weight) in rig.weights().row(vertex) {
            let _ = write!(skin, " {} {weight}", name(joint));
        }
        skin.push('\n');
    }
    let root = format!("root {}\n", names[0]);
    Blocks { joints, root, hier, skin }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_without_blanks_stay() {
        let names = ["a b", "a_b", "a\tb", "a_b.001", "c"].map(String::from);
        assert_eq!(words(&names), ["a_b.002", "a_b", "a_b.003", "a_b.001", "c"]);
    }
}
