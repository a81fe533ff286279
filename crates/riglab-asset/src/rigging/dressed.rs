//! A rigged FBX as a GLB: rig, looks and motions.

use std::collections::HashMap;
use std::path::Path;

use riglab_core::{Rig, RigError, SkinWeights, Springs};

use super::looks::Row;
use super::{SubjectNote, fbx};
use crate::assemble::{loose_roots, ordered_sets};
use crate::export::{self, ExportError, ExportFault, ExportOptions, Exported};
use crate::fbx::Origin;
use crate::{Binding, Fault, ImportOptions, Reading, Resample, VertexSet, gltf, import_from};

/// The rigged FBX at `path` as a GLB: the meshes that its rig holds with their materials, pictures, normals, texture
/// coordinates, colours and blend shapes, bound as the importer reads it, and its motions of joints and blend shapes, sampled at
/// the file's own rate. `springs` are of its joints; FBX has none. With it what of the file is not in the GLB.
///
/// # Errors
/// What is wrong with the file; [`Fault::NothingBound`] without a rig.
pub fn dressed(
    path: &Path,
    options: &ImportOptions,
    springs: &Springs,
    how: &ExportOptions,
) -> Result<(Exported, Vec<SubjectNote>), ExportError> {
    let fail = |fault: ExportFault| ExportError { file: path.to_string_lossy().into_owned(), fault };
    let source = |fault: Fault| fail(fault.into());
    let invalid = |e: RigError| source(e.into());
    let bytes = std::fs::read(path).map_err(|e| source(Fault::unreadable(&e)))?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut taken = fbx::read(&name, &bytes, Some(export::folder(path))).map_err(source)?;
    let clips = Some(Resample::whole(taken.rate));
    let imported = import_from(path, &bytes, None, &ImportOptions { clips, ..options.clone() });
    let imported = imported.map_err(|e| source(e.fault))?;
    let old = imported.rig().ok_or_else(|| source(Fault::NothingBound))?;

    // What hangs on no joint is no part of the rig.
    let held: Vec<bool> =
        taken.origins.iter().map(|of| imported.reading.parts.iter().any(|part| part.node == of.node)).collect();
    let (mut objects, mut origins) = (held.iter(), held.iter());
    taken.model.objects.retain(|_| objects.next() == Some(&true));
    taken.origins.retain(|_| origins.next() == Some(&true));
    // Each one's number among those that stay.
    let count = |kept: &mut usize, held: &bool| {
        let number = *kept;
        *kept += usize::from(*held);
        Some(number)
    };
    let numbers: Vec<usize> = held.iter().scan(0, count).collect();
    for swing in &mut taken.model.swings {
        swing.weights.retain(|(object, _)| held[*object]);
        swing.weights.iter_mut().for_each(|(object, _)| *object = numbers[*object]);
    }
    taken.model.swings.retain(|swing| !swing.weights.is_empty());

    let parts = taken.model.drop_unplaced_pictures();
    let shapes_move = !taken.model.swings.is_empty();
    let glb = taken.model.into_glb().map_err(|found| fail(ExportFault::TooLong(found)))?;
    let bare = import_from(path, &glb, None, &ImportOptions::default()).map_err(|e| source(e.fault))?;
    let weights = weights(old, &imported.reading, &taken.origins, &bare.reading).map_err(invalid)?;
    let rig = Rig::new(old.skeleton().clone(), bare.mesh().clone(), weights).map_err(invalid)?;
    let rig = rig.with_springs(springs.clone()).map_err(invalid)?;
    let loose = loose_roots(&imported.reading, old.skeleton());
    let exported = gltf::export::onto(&glb, None, &bare, &rig, [0.0; 3], &loose, how).map_err(fail)?;
    let exported = gltf::export::with_motions(exported, old.skeleton(), &imported.clips).map_err(fail)?;
    // Of those that move no joint, and those that could not be read, of which the importer warned.
    let unread = taken.animations.saturating_sub(imported.clips.len());
    let part_motions = taken.part_motions.min(imported.clips.len());
    let mut notes = fbx::left(taken.left, unread, part_motions, shapes_move);
    notes.extend((parts > 0).then_some(SubjectNote::Unplaced { parts }));
    Ok((exported, notes))
}

/// The weights of a rig for the vertices of the document that its file's model became.
fn weights(old: &Rig, of: &Reading, origins: &[Origin], document: &Reading) -> Result<SkinWeights, RigError> {
    let (mut offsets, mut joints, mut shares) = (vec![0u32], Vec::new(), Vec::new());
    for row in rows(of, origins, document) {
        // All are there: both ways read the same corners.
        for (joint, share) in row.into_iter().flat_map(|row| old.weights().row(row.number)) {
            joints.push(joint.0);
            shares.push(share);
        }
        offsets.push(joints.len() as u32);
    }
    SkinWeights::new(offsets, joints, shares)
}

/// Which row of a rig each vertex of the document is that its file's model became; none of what hangs on no joint.
pub(super) fn rows(of: &Reading, origins: &[Origin], document: &Reading) -> Vec<Option<Row>> {
    // Where the vertices of each node begin in the rig, and which control points they are.
    let mut sets: HashMap<usize, (usize, &VertexSet)> = HashMap::new();
    let mut start = 0;
    for (number, set) in ordered_sets(of) {
        for part in of.parts.iter().filter(|part| part.vertex_set == number) {
            sets.insert(part.node, (start, set));
        }
        start += set.positions.len();
    }
    let mut rows = Vec::new();
    for (number, set) in ordered_sets(document) {
        let part = document.parts.iter().find(|part| part.vertex_set == number);
        let from = part.and_then(|part| {
            let origin = origins.get(part.node)?;
            Some((sets.get(&origin.node)?, origin.controls.get(part.primitive)?))
        });
        rows.extend(set.numbers.iter().map(|&vertex| {
            let (&(start, old), controls) = from?;
            let at = old.numbers.binary_search(controls.get(vertex as usize)?).ok()?;
            Some(Row { number: start + at, rigid: old.binding == Binding::Rigid })
        }));
    }
    rows
}
