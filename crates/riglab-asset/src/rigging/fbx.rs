//! FBX with its materials, as a document.

use std::path::Path;

use super::SubjectNote;
use super::beside::Beside;
use crate::Fault;
use crate::fbx::{Left, Taken, counted};

/// Reads an FBX without its rig; pictures that it does not hold are looked for in `folder`, if at all. Metres, y up.
pub(super) fn read(name: &str, bytes: &[u8], folder: Option<&Path>) -> Result<Taken, Fault> {
    let beside = Beside::new(folder);
    crate::fbx::model(name, bytes, |picture| beside.read(picture))
}

/// What of a file is not in its model, nor so many of its animations.
pub(super) fn left(left: Left, animations: usize) -> Vec<SubjectNote> {
    let mut notes: Vec<SubjectNote> = left.missing.into_iter().map(SubjectNote::FileMissing).collect();
    notes.extend(left.other.into_iter().map(SubjectNote::OtherPicture));
    if !left.maps.is_empty() {
        notes.push(SubjectNote::MapsLeft(left.maps.into_iter().collect()));
    }
    let mut things = left.things;
    things.extend(counted(animations, "animation", "animations"));
    if !things.is_empty() {
        notes.push(SubjectNote::ThingsLeft(things));
    }
    notes
}
