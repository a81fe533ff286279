//! FBX with its materials, as a document.

use std::path::Path;

use super::beside::Beside;
use super::dressed::rows;
use super::looks::{Looks, Motions, RowsOf, Unrigged};
use super::subject::stood;
use super::{SubjectNote, UpAxis};
use crate::assemble::loose_roots;
use crate::fbx::{Left, Taken, counted};
use crate::{Content, Fault, ImportOptions, Imported, Resample, import_from};

/// Reads an FBX as a model, with its rig and motions where they are kept.
pub(crate) fn looks(file: &Unrigged<'_>, notes: &mut Vec<SubjectNote>) -> Result<Looks, Fault> {
    let taken = read(&file.name, file.bytes, file.folder)?;
    let old = old_rig(file, taken.rate, notes)?;
    let motions = old.as_ref().and_then(motions);
    let loose = old.as_ref().and_then(|old| Some(loose_roots(&old.reading, old.rig()?.skeleton()))).unwrap_or_default();
    let rig = old.as_ref().and_then(|old| old.rig().cloned());
    let origins = taken.origins;
    let rows = old.map(|old| -> RowsOf { Box::new(move |document| rows(&old.reading, &origins, document)) });
    let kept = motions.as_ref().map_or(0, |motions| motions.clips.len());
    let missing = taken.animations.saturating_sub(kept);
    notes.extend(left(taken.left, missing, taken.part_motions.min(kept), !taken.model.swings.is_empty()));
    Ok(Looks { model: taken.model, rig, rows, loose, motions, animations: taken.animations })
}

/// Of a rig, if it has any.
fn motions(imported: &Imported) -> Option<Motions> {
    let rig = imported.rig().filter(|_| !imported.clips.is_empty())?;
    Some(Motions { skeleton: rig.skeleton().clone(), clips: imported.clips.clone() })
}

/// The rig of a file, if it has one, with its motions at a rate: kept, or told that it is not.
fn old_rig(file: &Unrigged<'_>, rate: f32, notes: &mut Vec<SubjectNote>) -> Result<Option<Imported>, Fault> {
    let options = file.options;
    // Those of a model that is turned would have to be turned as well.
    let clips = (options.keep_rig && options.up == UpAxis::Y).then(|| Resample::whole(rate));
    match import_from(file.path, file.bytes, None, &ImportOptions { clips, ..options.import.clone() }) {
        Ok(mut imported) if options.keep_rig && imported.rig().is_some() => {
            if let Content::Rigged(rig) = &mut imported.content {
                *rig = stood(rig, options.up)?;
            }
            Ok(Some(imported))
        }
        Ok(Imported { content: Content::Rigged(rig), .. }) => {
            notes.push(SubjectNote::RigIgnored { joints: rig.skeleton().len() });
            Ok(None)
        }
        // A rig that cannot be read is of no matter where it is not kept.
        Ok(_) => Ok(None),
        Err(e) if options.keep_rig => Err(e.fault),
        Err(_) => Ok(None),
    }
}

/// Reads an FBX without its rig; pictures that it does not hold are looked for in `folder`, if at all. Metres, y up.
pub(super) fn read(name: &str, bytes: &[u8], folder: Option<&Path>) -> Result<Taken, Fault> {
    let beside = Beside::new(folder);
    crate::fbx::model(name, bytes, |picture| beside.read(picture))
}

/// What of a file is not in its model, nor so many of its animations, nor what as many as `part_motions` of the others say of
/// parts that hang on joints; where the model has those of blend shapes (`shapes_move`), it is not the whole of an animation that
/// is missing.
pub(super) fn left(left: Left, animations: usize, part_motions: usize, shapes_move: bool) -> Vec<SubjectNote> {
    let mut notes: Vec<SubjectNote> = left.missing.into_iter().map(SubjectNote::FileMissing).collect();
    notes.extend(left.other.into_iter().map(SubjectNote::OtherPicture));
    if !left.maps.is_empty() {
        notes.push(SubjectNote::MapsLeft(left.maps.into_iter().collect()));
    }
    let mut things = left.things;
    let (whole, of_objects) = match shapes_move {
        true => (0, animations + part_motions),
        false => (animations, part_motions),
    };
    let counted = |n| counted(n, "animation", "animations");
    things.extend(counted(whole));
    things.extend(counted(of_objects).map(|all| format!("the object motions of {all}")));
    if !things.is_empty() {
        notes.push(SubjectNote::ThingsLeft(things));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_animations_whose_shapes_move_the_motions_of_objects_are_left() {
        let told = |animations, parts, shapes_move| left(Left::default(), animations, parts, shapes_move);
        let things = |all: &[&str]| [SubjectNote::ThingsLeft(all.iter().map(|&of| of.into()).collect())];
        assert_eq!(told(2, 0, false), things(&["2 animations"]));
        assert_eq!(told(2, 0, true), things(&["the object motions of 2 animations"]));
        assert_eq!(told(2, 1, false), things(&["2 animations", "the object motions of 1 animation"]));
        assert_eq!(told(2, 1, true), things(&["the object motions of 3 animations"]));
        assert_eq!(told(0, 0, true), []);
    }
}
