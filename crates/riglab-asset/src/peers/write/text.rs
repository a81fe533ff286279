//! Rig texts and the OBJ beside them. Numbers are written so that reading them gives the same f32.

use std::collections::VecDeque;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use riglab_core::{JointId, Mesh, Rig};

use super::Target;
use crate::names::Names;

/// Where the mesh of a rig text goes.
pub(super) fn mesh_path(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{}.obj", stem.strip_suffix("_rig").unwrap_or(&stem)))
}

/// The mesh with normals, in a form that all the peers' readers take.
pub(super) fn obj(mesh: &Mesh) -> String {
    let mut out = String::new();
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

/// Joints, root, tree and weights in the order of blocks of `target`.
pub(super) fn rig(rig: &Rig, target: Target, notes: &mut Vec<String>) -> String {
    let skeleton = rig.skeleton();
    let mut unique = Names::default();
    let mut changed = 0;
    let names: Vec<String> = (skeleton.names().iter())
        .map(|name| {
            let word: String = name.chars().map(|c| if c.is_whitespace() { '_' } else { c }).collect();
            changed += usize::from(word != *name);
            unique.unique(&word, || "joint".to_owned())
        })
        .collect();
    if changed > 0 {
        notes.push(format!("blanks in the names of {changed} joints became `_`: words of the text end at blanks"));
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
    match target {
        Target::Puppeteer => joints + &root + &hier + &skin,
        _ => joints + &root + &skin + &hier,
    }
}
