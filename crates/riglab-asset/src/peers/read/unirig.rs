//! UniRig: `raw_data.npz`, and what its two stages predict.

use super::super::archive::Archive;
use super::super::array_rig::{ArrayRig, Up};
use super::super::fault::PeerFault;
use super::super::fields;
use super::super::pickle::{self, View};

/// Reads whichever members there are.
pub(super) fn read(archive: &mut Archive<'_>, extras: bool) -> Result<ArrayRig, PeerFault> {
    let mut rig = ArrayRig { up: Up::Z, ..ArrayRig::default() };
    if let Some(vertices) = archive.numbers("vertices")? {
        rig.vertices = vertices.rows("vertices")?;
    }
    if let Some(faces) = archive.numbers("faces")? {
        rig.faces = fields::faces(&faces.int_rows("faces")?, rig.vertices.len())?;
    }
    if let Some(joints) = archive.numbers("joints")? {
        rig.joints = joints.rows("joints")?;
    }
    if let Some(tails) = archive.numbers("tails")? {
        rig.tails = tails.rows("tails")?;
    }
    rig.names = archive.texts("names")?.unwrap_or_default();
    if archive.has("parents") {
        rig.parents = parents(archive, rig.joints.len())?;
    }
    if let Some((columns, weights)) = archive.sparse("skin")? {
        if columns != rig.joints.len() {
            return Err(PeerFault::field("skin", format!("has {columns} columns for {} joints", rig.joints.len())));
        }
        rig.weights = Some(weights);
    }
    if extras {
        for field in ["vertex_normals", "matrix_local"] {
            if let Some(values) = archive.numbers(field)? {
                rig.extras.insert(field.to_owned(), values.array(field)?);
            }
        }
    }
    Ok(rig)
}

/// An array of objects, `None` for the root, or of numbers, -1 for the root; or a lone `None`.
fn parents(archive: &mut Archive<'_>, joints: usize) -> Result<Vec<Option<usize>>, PeerFault> {
    const FIELD: &str = "parents";
    let objects = archive.objects(FIELD, |header, input, budget| {
        if header.dtype.kind != b'O' {
            return Ok(None);
        }
        let read = pickle::read(FIELD, input, budget, None)?;
        let (nodes, id) = read.ok_or_else(|| PeerFault::field(FIELD, "is empty"))?;
        let view = View { nodes: &nodes, id };
        let members = view.members().ok_or_else(|| PeerFault::field(FIELD, "is no list"))?;
        let number = |v: View<'_>| match v.int() {
            None if !v.is_none() => Err(PeerFault::field(FIELD, "has an entry that is neither a number nor None")),
            n => Ok(n),
        };
        let all: Vec<Option<i64>> = members.map(number).collect::<Result<_, _>>()?;
        Ok(Some(if header.shape.is_empty() { None } else { Some(all) }))
    })?;
    match objects {
        // Of a file without armature.
        Some(None) => Ok(Vec::new()),
        Some(Some(all)) => fields::parents(all, joints),
        None => fields::parents(archive.required(FIELD)?.ints(FIELD)?.into_iter().map(Some), joints),
    }
}
