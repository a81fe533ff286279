//! Numbers that are not finite (NaN or infinity) in what a rig has no part in: normals, tangents, texture coordinates,
//! colours, morph targets and motions.
//!
//! glTF allows none, and programs show black surfaces or nothing for them. Of positions, skins and weights the importer
//! takes none. Where all are finite, nothing is changed, and what cannot be read stays as it is.

use std::collections::HashMap;

use serde_json::json;

use super::super::accessor::Accessors;
use super::super::buffers::Buffers;
use super::super::document::{Document, Primitive};
use super::animations;
use super::draft::{ARRAY, Draft, F32, VEC2, VEC4, index, remove};
use crate::budget::Budget;
use crate::{ExportNote, rigging, triangles};

/// How many of each were not finite.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Mended {
    normals: usize,
    coordinates: usize,
    colours: usize,
    offsets: usize,
    tangents: usize,
    channels: usize,
}

/// Mends a document whose bytes are `base`; what is new comes behind them. True where there was something to mend.
pub(super) fn mend(draft: &mut Draft, document: &Document, base: &[u8], notes: &mut Vec<ExportNote>) -> bool {
    let accessors = Accessors::new(document, Buffers::new(document, Some(base), None, Budget::new(base.len())));
    let (known, done, mended) = Default::default();
    let mut mender = Mender { document, accessors, known, done, mended };
    for (m, mesh) in document.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            mender.primitive(draft, (m, p), primitive);
        }
    }
    mender.mended.channels = animations::drop_broken(draft, |accessor| mender.is_broken(accessor));
    let mended = mender.mended;
    let any = mended != Mended::default();
    if any {
        let Mended { normals, coordinates, colours, offsets, tangents, channels } = mended;
        notes.push(ExportNote::NotFinite { normals, coordinates, colours, offsets, tangents, channels });
    }
    any || !draft.binary.is_empty()
}

/// What an accessor is used as.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Use {
    /// Normals at the positions of another.
    Normals(Option<usize>),
    Coordinates,
    Colours,
    /// What morph targets add.
    Offsets,
}

struct Mender<'a> {
    document: &'a Document,
    accessors: Accessors<'a>,
    /// Which accessors have such numbers.
    known: HashMap<usize, bool>,
    /// New accessors, by the old one and its use: primitives share them.
    done: HashMap<(usize, Use), usize>,
    mended: Mended,
}

impl Mender<'_> {
    fn is_broken(&mut self, accessor: usize) -> bool {
        let accessors = &self.accessors;
        *self.known.entry(accessor).or_insert_with(|| accessors.is_broken(accessor))
    }

    fn primitive(&mut self, draft: &mut Draft, (mesh, number): (usize, usize), primitive: &Primitive) {
        for (name, &accessor) in &primitive.attributes {
            let used = match name.as_str() {
                "NORMAL" => Some(Use::Normals(primitive.attributes.get("POSITION").copied())),
                "TANGENT" => None,
                _ if name.starts_with("TEXCOORD_") => Some(Use::Coordinates),
                _ if name.starts_with("COLOR_") => Some(Use::Colours),
                _ => continue,
            };
            if !self.is_broken(accessor) {
                continue;
            }
            let new = used.and_then(|used| self.anew(draft, accessor, used));
            let attributes = &mut draft.list_mut("meshes")[mesh]["primitives"][number]["attributes"];
            match new {
                Some(new) => attributes[name] = json!(new),
                // Programs make them of normals and coordinates.
                None if name == "TANGENT" => {
                    remove(attributes, name);
                    self.still_tangents(draft, (mesh, number), primitive);
                    self.mended.tangents += 1;
                }
                None => {}
            }
        }
        let count = draft.list("meshes")[mesh]["primitives"][number]["targets"].as_array().map_or(0, Vec::len);
        for target in 0..count {
            let own = draft.list("meshes")[mesh]["primitives"][number]["targets"][target].clone();
            for (name, accessor) in own.as_object().into_iter().flatten() {
                let Some(accessor) = index(accessor).filter(|accessor| self.is_broken(*accessor)) else { continue };
                let Some(new) = self.anew(draft, accessor, Use::Offsets) else { continue };
                draft.list_mut("meshes")[mesh]["primitives"][number]["targets"][target][name] = json!(new);
            }
        }
    }

    /// The accessor to be used instead of one that is broken; `None` where that cannot be read.
    fn anew(&mut self, draft: &mut Draft, accessor: usize, used: Use) -> Option<usize> {
        if let Some(&known) = self.done.get(&(accessor, used)) {
            return Some(known);
        }
        let new = match used {
            Use::Normals(position) => self.normals(draft, accessor, position),
            _ => self.vectors(draft, accessor, used),
        }?;
        self.done.insert((accessor, used), new);
        Some(new)
    }

    /// Takes from morph targets what they add to tangents that are no more. One that has nothing else moves nothing, which
    /// it has to say.
    fn still_tangents(&self, draft: &mut Draft, (mesh, number): (usize, usize), primitive: &Primitive) {
        let position = primitive.attributes.get("POSITION").and_then(|&own| self.document.accessors.get(own));
        // Without a view, all elements are 0.
        let still = position.map(|own| {
            let zero = [0.0; 3];
            json!({"componentType": F32, "type": "VEC3", "count": own.count, "min": zero, "max": zero})
        });
        let count = draft.list("meshes")[mesh]["primitives"][number]["targets"].as_array().map_or(0, Vec::len);
        for target in 0..count {
            let own = &mut draft.list_mut("meshes")[mesh]["primitives"][number]["targets"][target];
            let emptied = remove(own, "TANGENT").is_some() && own.as_object().is_some_and(serde_json::Map::is_empty);
            if let Some(still) = still.clone().filter(|_| emptied) {
                let still = draft.push("accessors", still);
                draft.list_mut("meshes")[mesh]["primitives"][number]["targets"][target]["POSITION"] = json!(still);
            }
        }
    }

    /// Those that point nowhere become the mean of the triangles around their places.
    fn normals(&mut self, draft: &mut Draft, accessor: usize, position: Option<usize>) -> Option<usize> {
        let position = position?;
        let mut own = self.accessors.directions(accessor).ok()?;
        let positions = self.accessors.positions(position).ok().filter(|all| all.len() == own.len())?;
        let all = self.document.meshes.iter().flat_map(|mesh| &mesh.primitives);
        let same = all.filter(|p| {
            p.attributes.get("NORMAL") == Some(&accessor) && p.attributes.get("POSITION") == Some(&position)
        });
        let mut around = Vec::new();
        for primitive in same {
            let corners = match primitive.indices {
                Some(indices) => self.accessors.indices(indices).unwrap_or_default(),
                None => (0..own.len() as u32).collect(),
            };
            let faces = triangles::from_indices(&corners, primitive.mode.unwrap_or(4));
            around.extend(faces.into_iter().filter(|face| face.iter().all(|v| (*v as usize) < own.len())));
        }
        let made = rigging::complete_normals(&own, &positions, &around);
        for (own, made) in own.iter_mut().zip(made).filter(|(own, _)| !is_finite(&own[..])) {
            *own = made;
            self.mended.normals += 1;
        }
        Some(draft.vectors(&own, false, Some(ARRAY)))
    }

    /// Those that are not finite become 0, of colours white.
    fn vectors(&mut self, draft: &mut Draft, accessor: usize, used: Use) -> Option<usize> {
        let (mut own, wide) = self.accessors.numbers(accessor).ok()?;
        let (instead, count) = match used {
            Use::Colours => (1.0, &mut self.mended.colours),
            Use::Offsets => (0.0, &mut self.mended.offsets),
            Use::Coordinates | Use::Normals(_) => (0.0, &mut self.mended.coordinates),
        };
        for own in own.chunks_exact_mut(wide).filter(|own| !is_finite(own)) {
            own.fill(instead);
            *count += 1;
        }
        if wide == 3 {
            // Those of positions have bounds, which do no harm to others.
            return Some(draft.vectors(own.as_chunks().0, used == Use::Offsets, Some(ARRAY)));
        }
        let bytes: Vec<u8> = own.iter().flat_map(|x| x.to_le_bytes()).collect();
        Some(draft.accessor(&bytes, if wide == 2 { VEC2 } else { VEC4 }, Some(ARRAY)))
    }
}

fn is_finite(numbers: &[f32]) -> bool {
    numbers.iter().all(|x| x.is_finite())
}
