//! Accessors that several compressed primitives share, though each means something else by them.
//!
//! Exporters write one accessor for all primitives that have as many triangles, for instance, as its type and count are the
//! same. What Draco decoded for one of them is not what it decoded for another: each has its own accessor here.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use super::document::{Accessor, Document, Primitive};
use super::{draco, extensions};

/// Letters of an accessor's type that are kept of it in a copy; no type has more.
const SHAPE: usize = 8;

/// What an accessor stands for: numbers of a view that is decoded (triangles where there is no number of an attribute),
/// or, of a primitive that is plain, what it says itself.
type Meaning = Option<(usize, Option<u32>)>;

/// A primitive's accessor that another took the place of.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Parted {
    pub(super) mesh: usize,
    pub(super) primitive: usize,
    /// The name of the attribute; none for indices.
    pub(super) attribute: Option<String>,
    pub(super) before: usize,
    pub(super) now: usize,
}

/// Gives primitives accessors of their own where another's decoded geometry is for the same; tells which. New accessors
/// come behind the others, in this order, each as the one before it says but for bytes.
pub(super) fn part(document: &mut Document) -> Vec<Parted> {
    let mut parted = Vec::new();
    if !document.meshes.iter().flat_map(|mesh| &mesh.primitives).any(is_compressed) {
        return parted;
    }
    let Document { accessors, meshes, .. } = document;
    let mut meant: HashMap<usize, Meaning> = HashMap::new();
    let mut copies: HashMap<(usize, Meaning), usize> = HashMap::new();
    // Plain primitives keep their accessors, whatever comes before them.
    let plain = meshes.iter().flat_map(|mesh| &mesh.primitives).filter(|primitive| !is_compressed(primitive));
    for &accessor in plain.flat_map(|primitive| primitive.attributes.values().chain(&primitive.indices)) {
        meant.insert(accessor, None);
    }
    for (m, mesh) in meshes.iter_mut().enumerate() {
        for (p, primitive) in mesh.primitives.iter_mut().enumerate() {
            let Some(settings) = settings(primitive) else { continue };
            let own = primitive.attributes.iter_mut().filter_map(|(name, accessor)| {
                settings.attributes.get(name).map(|&number| (Some(name), Some(number), accessor))
            });
            for (attribute, number, accessor) in own.chain(primitive.indices.as_mut().map(|i| (None, None, i))) {
                let before = *accessor;
                let meaning = Some((settings.buffer_view, number));
                // With bytes of its own it is not decoded, and a number too large is told where it is followed.
                let Some(Accessor { buffer_view: None, .. }) = accessors.get(before) else { continue };
                if *meant.entry(before).or_insert(meaning) == meaning {
                    continue;
                }
                let now = match copies.entry((before, meaning)) {
                    Entry::Occupied(known) => *known.get(),
                    Entry::Vacant(new) => {
                        accessors.push(accessors[before].bare_copy(SHAPE));
                        *new.insert(accessors.len() - 1)
                    }
                };
                *accessor = now;
                parted.push(Parted { mesh: m, primitive: p, attribute: attribute.cloned(), before, now });
            }
        }
    }
    parted
}

fn is_compressed(primitive: &Primitive) -> bool {
    primitive.extensions.contains_key(extensions::DRACO)
}

/// Those of a compressed primitive; what is wrong with them is told where it is decoded.
fn settings(primitive: &Primitive) -> Option<draco::Settings> {
    draco::Settings::read(primitive.extensions.get(extensions::DRACO)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Primitives of one mesh: the accessor of positions, that of indices, and the view that is decoded, if one is.
    fn parted(primitives: &[(usize, usize, Option<usize>)]) -> (Vec<(usize, usize)>, usize) {
        let primitives: Vec<_> = primitives
            .iter()
            .map(|&(position, indices, view)| {
                let draco = serde_json::json!({"bufferView": view, "attributes": {"POSITION": 0}});
                let extensions = if view.is_some() {
                    serde_json::json!({ extensions::DRACO: draco })
                } else {
                    serde_json::json!({})
                };
                serde_json::json!({"attributes": {"POSITION": position}, "indices": indices, "extensions": extensions})
            })
            .collect();
        let accessor = serde_json::json!({"componentType": 5126, "type": "VEC3", "count": 3});
        let mut bytes = accessor.clone();
        bytes["bufferView"] = 0.into();
        let json = serde_json::json!({
            "asset": {"version": "2.0"},
            "meshes": [{"primitives": primitives}],
            "accessors": [accessor, accessor, accessor, bytes],
        });
        let mut document = Document::parse(json.to_string().as_bytes()).unwrap();
        part(&mut document);
        let own = document.meshes[0].primitives.iter().map(|p| (p.attributes["POSITION"], p.indices.unwrap()));
        (own.collect(), document.accessors.len())
    }

    #[test]
    fn who_decodes_something_else_has_accessors_of_its_own() {
        // As Blender writes two eyes; three, of which two are the same.
        assert_eq!(parted(&[(0, 1, Some(0)), (2, 1, Some(1))]), (vec![(0, 1), (2, 4)], 5));
        let three = [(0, 1, Some(0)), (0, 1, Some(1)), (0, 1, Some(1))];
        assert_eq!(parted(&three), (vec![(0, 1), (4, 5), (4, 5)], 6));
    }

    #[test]
    fn who_decodes_the_same_or_nothing_keeps_them() {
        assert_eq!(parted(&[(0, 1, Some(0)), (0, 1, Some(0))]), (vec![(0, 1); 2], 4));
        assert_eq!(parted(&[(0, 1, None), (0, 1, None)]), (vec![(0, 1); 2], 4));
        // The plain one, though it comes later; what has bytes, though others decode something.
        assert_eq!(parted(&[(0, 1, Some(0)), (0, 2, None)]), (vec![(4, 1), (0, 2)], 5));
        assert_eq!(parted(&[(0, 3, Some(0)), (2, 3, Some(1)), (99, 99, Some(2))]).1, 4);
    }
}
