//! FBX with its materials, as a document.

use std::path::Path;

use super::{SubjectNote, beside};
use crate::Fault;
use crate::gltf::export::model::Model;

/// Reads an FBX without its rig; pictures that it does not hold are looked for in `folder`, if at all. Metres, y up.
pub(super) fn read(
    name: &str,
    bytes: &[u8],
    folder: Option<&Path>,
    notes: &mut Vec<SubjectNote>,
) -> Result<Model, Fault> {
    let (model, left) = crate::fbx::model(name, bytes, |picture| beside::read(folder, picture))?;
    notes.extend(left.missing.into_iter().map(SubjectNote::FileMissing));
    notes.extend(left.other.into_iter().map(SubjectNote::OtherPicture));
    if !left.maps.is_empty() {
        notes.push(SubjectNote::MapsLeft(left.maps.into_iter().collect()));
    }
    if !left.things.is_empty() {
        notes.push(SubjectNote::ThingsLeft(left.things));
    }
    Ok(model)
}
