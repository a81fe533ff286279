//! SkinTokens: an npz per asset, joints as matrices.

use super::super::archive::Archive;
use super::super::array_rig::{Array, ArrayRig, Up};
use super::super::fault::PeerFault;
use super::super::fields;

/// Reads vertices and faces, and a skeleton and weights where there are some.
pub(super) fn read(archive: &mut Archive<'_>, extras: bool) -> Result<ArrayRig, PeerFault> {
    let mut rig = ArrayRig { up: Up::Z, ..ArrayRig::default() };
    rig.vertices = archive.required("vertices")?.rows("vertices")?;
    rig.faces = fields::faces(&archive.required("faces")?.int_rows("faces")?, rig.vertices.len())?;
    let Some(matrices) = archive.numbers("matrix_local")? else { return Ok(rig) };
    let [joints, 4, 4] = matrices.shape[..] else {
        return Err(PeerFault::field(
            "matrix_local",
            format!("has the shape {:?}, not [joints, 4, 4]", matrices.shape),
        ));
    };
    let all = matrices.floats("matrix_local")?;
    let matrices: &[[f32; 16]] = all.as_chunks().0;
    // By rows: the position is the last column, the bone's axis the second.
    rig.joints = matrices.iter().map(|m| [m[3], m[7], m[11]]).collect();
    rig.names = archive.texts("joint_names")?.unwrap_or_default();
    let parents = archive.required("parents")?.ints("parents")?;
    rig.parents = fields::parents(parents.into_iter().map(Some), joints)?;
    if let Some(lengths) = archive.numbers("lengths")? {
        let lengths = lengths.floats("lengths")?;
        if lengths.len() != joints {
            return Err(PeerFault::field("lengths", format!("has {} entries for {joints} joints", lengths.len())));
        }
        rig.tails = matrices
            .iter()
            .zip(&lengths)
            .map(|(m, l)| std::array::from_fn(|k| m[4 * k + 3] + l * m[4 * k + 1]))
            .collect();
        if extras {
            rig.extras.insert("lengths".into(), Array { shape: vec![joints], data: lengths });
        }
    }
    if let Some((columns, weights)) = archive.sparse("skin")? {
        if columns != joints {
            return Err(PeerFault::field("skin", format!("has {columns} columns for {joints} joints")));
        }
        rig.weights = Some(weights);
    }
    Ok(rig)
}
