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

/// What of a file is not in its model, nor so many of its animations; where the model has those of blend shapes
/// (`shapes_move`), it is not the whole of an animation that is missing.
pub(super) fn left(left: Left, animations: usize, shapes_move: bool) -> Vec<SubjectNote> {
    let mut notes: Vec<SubjectNote> = left.missing.into_iter().map(SubjectNote::FileMissing).collect();
    notes.extend(left.other.into_iter().map(SubjectNote::OtherPicture));
    if !left.maps.is_empty() {
        notes.push(SubjectNote::MapsLeft(left.maps.into_iter().collect()));
    }
    let mut things = left.things;
    let whole = counted(animations, "animation", "animations");
    things.extend(whole.map(|all| if shapes_move { format!("the object motions of {all}") } else { all }));
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
        let told = |animations, shapes_move| left(Left::default(), animations, shapes_move);
        assert_eq!(told(2, false), [SubjectNote::ThingsLeft(vec!["2 animations".into()])]);
        assert_eq!(told(2, true), [SubjectNote::ThingsLeft(vec!["the object motions of 2 animations".into()])]);
        assert_eq!(told(0, true), []);
    }
}
