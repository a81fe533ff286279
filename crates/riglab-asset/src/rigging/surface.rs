//! A mesh of a format without materials, as a document.

use std::path::Path;

use super::beside::Beside;
use super::mended::{Mender, is_sound};
use super::{SubjectNote, normals};
use crate::gltf::export::model::{Look, Model, Object, Patch};
use crate::surface::Surface;

/// A model of one mesh. Its picture is looked for in `folder`, if at all. Normals that are missing are the mean of the
/// triangles around each place; a vertex whose colour or texture coordinates are broken costs the others nothing.
pub(crate) fn model(name: &str, of: Surface, folder: Option<&Path>, notes: &mut Vec<SubjectNote>) -> Model {
    let mut model = Model { name: name.into(), ..Model::default() };
    if !of.left.is_empty() {
        notes.push(SubjectNote::ThingsLeft(of.left));
    }
    if of.triangles.is_empty() {
        return model;
    }
    let normals = normals::complete(&of.normals, &of.positions, &of.triangles);
    let mut patch = Patch { normals, ..Patch::default() };
    let mut mender = Mender::default();
    let coordinates = mender.coordinates(&of.coordinates).into_iter();
    patch.coordinates = coordinates.map(|[u, v]| [u, 1.0 - v]).collect();
    // Nothing of a surface that is seen through everywhere would be: not meant.
    let hidden = of.colours.iter().filter(|c| is_sound(&c[..])).all(|c| c[3] == 0.0);
    let alpha = |a: f32| if hidden { 1.0 } else { a };
    let colours = mender.colours(&of.colours).into_iter();
    patch.colours = colours.map(|[r, g, b, a]| [linear(r), linear(g), linear(b), alpha(a)]).collect();
    mender.tell(notes);
    // A mesh has one look, and so one picture.
    if of.pictures.len() > 1 {
        let others = of.pictures[1..].iter().map(|name| format!("the picture `{name}`"));
        notes.push(SubjectNote::ThingsLeft(others.collect()));
    }
    match of.pictures.first().map(|named| (named, patch.coordinates.is_empty())) {
        None => {}
        Some((_, true)) => notes.push(SubjectNote::Unplaced { parts: 1 }),
        Some((named, false)) => match Beside::new(folder).picture(named) {
            Ok(picture) => model.pictures.push(picture),
            Err(note) => notes.push(note),
        },
    }
    let picture = (!model.pictures.is_empty()).then_some(0);
    // What is grey by itself would darken both.
    if picture.is_some() || !patch.colours.is_empty() {
        let transparent = patch.colours.iter().any(|c| c[3] < 1.0);
        model.looks.push(Look { colour: [1.0; 4], picture, transparent, ..Look::plain(name) });
        patch.look = Some(0);
    }
    patch.positions = of.positions;
    patch.indices = of.triangles.into_flattened();
    model.objects.push(Object {
        name: name.into(),
        group: None,
        hidden: false,
        patches: vec![patch],
        shapes: Vec::new(),
    });
    model
}

/// A share of light as glTF has those of vertices, from one as pictures have it (IEC 61966-2-1).
pub(crate) fn linear(share: f32) -> f32 {
    if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
}

/// The way back.
#[cfg(feature = "fbx")]
pub(crate) fn encoded(share: f32) -> f32 {
    let share = share.max(0.0);
    if share <= 0.003_130_8 { share * 12.92 } else { 1.055 * share.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(feature = "fbx")]
    #[test]
    fn light_comes_back_as_it_was() {
        for share in [0.0, 0.002, 0.04, 0.5, 1.0, 3.0] {
            assert!((linear(encoded(share)) - share).abs() < 1e-5, "{share}");
        }
    }

    fn triangle() -> Surface {
        Surface {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Surface::default()
        }
    }

    #[test]
    fn colours_become_those_of_gltf_and_show_on_white() {
        let colours = vec![[0.0, 0.04, 0.5, 1.0], [1.0; 4], [1.0, 1.0, 1.0, 0.5]];
        let model = model("a", Surface { colours, ..triangle() }, None, &mut Vec::new());
        let [first, second, third] = model.objects[0].patches[0].colours[..] else { panic!() };
        assert!((first[2] - 0.2140).abs() < 1e-4 && (first[1] - 0.0031).abs() < 1e-4 && first[0] == 0.0, "{first:?}");
        assert_eq!((second, third[3]), ([1.0; 4], 0.5));
        assert_eq!((model.looks[0].colour, model.looks[0].transparent), ([1.0; 4], true));
        assert_eq!(model.objects[0].patches[0].normals, [[0.0, 0.0, 1.0]; 3]);
        assert!(super::model("a", triangle(), None, &mut Vec::new()).looks.is_empty());
        // All of it hidden: not meant.
        let colours = vec![[1.0, 1.0, 1.0, 0.0]; 3];
        let model = super::model("a", Surface { colours, ..triangle() }, None, &mut Vec::new());
        assert!(!model.looks[0].transparent && model.objects[0].patches[0].colours == [[1.0; 4]; 3]);
    }

    #[test]
    fn one_broken_vertex_costs_no_other_its_colour_or_place_in_the_picture() {
        let mut notes = Vec::new();
        let colours = vec![[0.0, 1.0, 0.0, 0.0], [0.0, f32::NAN, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0]];
        let coordinates = vec![[0.5, 0.25], [0.5, 1.0], [f32::INFINITY, 0.0]];
        let model = model("a", Surface { colours, coordinates, ..triangle() }, None, &mut notes);
        let patch = &model.objects[0].patches[0];
        assert_eq!(patch.colours, [[0.0, 1.0, 0.0, 1.0], [1.0; 4], [1.0, 1.0, 0.0, 1.0]]);
        assert_eq!(patch.coordinates, [[0.5, 0.75], [0.5, 0.0], [0.0, 1.0]]);
        assert_eq!(notes, [SubjectNote::Mended { coordinates: 1, colours: 1 }]);
        let told = "of vertices that have none, or no finite number, while others do, 1 texture coordinate was set to 0, \
                    1 colour was set to white";
        assert_eq!(notes[0].to_string(), told);
    }

    #[test]
    fn a_picture_is_found_beside_the_file_where_there_are_coordinates_for_it() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.png"), b"\x89PNG\r\n\x1a\n and so on").unwrap();
        let mut notes = Vec::new();
        let mut of = |picture: &str, u: f32| {
            let coordinates = vec![[u, 0.25]; 3];
            let surface = Surface { coordinates, pictures: vec![picture.into()], ..triangle() };
            model("a", surface, Some(folder.path()), &mut notes)
        };
        let seen = of("C:\\scans\\a b.png", 0.5);
        assert_eq!((seen.pictures[0].name.as_str(), seen.looks[0].picture), ("a b", Some(0)));
        assert_eq!(seen.objects[0].patches[0].coordinates, [[0.5, 0.75]; 3]);
        assert!(of("a b.png", f32::NAN).looks.is_empty());
        assert!(of("gone.png", 0.5).looks.is_empty());
        assert_eq!(notes, [SubjectNote::Unplaced { parts: 1 }, SubjectNote::FileMissing("gone.png".into())]);
        notes.clear();
        let pictures = vec!["a b.png".into(), "b.png".into()];
        let surface = Surface { coordinates: vec![[0.5; 2]; 3], pictures, ..triangle() };
        model("a", surface, Some(folder.path()), &mut notes);
        assert_eq!(notes, [SubjectNote::ThingsLeft(vec!["the picture `b.png`".into()])]);
    }
}
