//! A file as one run of bytes: buffers, pictures and what was compressed.
//!
//! External files and data URIs are brought in, pictures as they are, byte for byte; compressed
//! geometry (Draco, meshopt) is written plain, so that what is added to it can be.

use std::collections::HashSet;
use std::path::Path;

use serde_json::{Value, json};

use super::super::buffers::{Buffers, Outside};
use super::super::document::{self, Document};
use super::super::parted::{self, Parted};
use super::super::{draco, extensions, split};
use super::draft::{ARRAY, Draft, ELEMENTS, U8, U16, U32, remove};
use crate::budget::Budget;
use crate::{ExportNote, Fault};

/// Pictures beside a file, each.
const MOST_PICTURE: u64 = 1 << 28;

/// Takes a file apart and packs it. Accessors, views and all else keep their numbers; [`part`] adds accessors. Gives the
/// accessors of weights that were compressed, too.
pub(super) fn open(
    bytes: &[u8],
    folder: Option<&Path>,
    notes: &mut Vec<ExportNote>,
) -> Result<(Draft, HashSet<usize>), Fault> {
    let chunks = split(bytes)?;
    let text = document::text(chunks.json)?;
    let mut typed = Document::parse(chunks.json)?;
    let parted = parted::part(&mut typed);
    extensions::check_required(&typed)?;
    let json: Value =
        serde_json::from_str(text).map_err(|e| Fault::Json { path: String::new(), reason: e.to_string() })?;
    let buffers = Buffers::new(&typed, chunks.binary, folder, Budget::new(bytes.len()));
    let mut draft = Draft::new(json);
    part(&mut draft, &typed, &parted);
    views(&mut draft, &typed, &buffers)?;
    let weights = plain_primitives(&mut draft, &typed, &buffers)?;
    pictures(&mut draft, &buffers, notes)?;
    for name in [extensions::DRACO].into_iter().chain(extensions::MESHOPT) {
        forget_extension(&mut draft.json, name);
    }
    Ok((draft, weights))
}

/// Gives the JSON the accessors that primitives of the typed document got of their own.
fn part(draft: &mut Draft, typed: &Document, parted: &[Parted]) {
    for Parted { mesh, primitive, attribute, before, now } in parted {
        // The first that has it.
        if *now == draft.list("accessors").len() {
            let own = &typed.accessors[*now];
            let mut copy = json!({"componentType": own.component_type, "type": own.shape, "count": own.count});
            if own.normalized {
                copy["normalized"] = json!(true);
            }
            // Bounds are asked for of positions; what is decoded has its own.
            for key in ["min", "max"].into_iter().filter(|key| draft.list("accessors")[*before].get(key).is_some()) {
                copy[key] = Value::Null;
            }
            draft.push("accessors", copy);
        }
        let own = &mut draft.list_mut("meshes")[*mesh]["primitives"][*primitive];
        match attribute {
            Some(name) => own["attributes"][name] = json!(now),
            None => own["indices"] = json!(now),
        }
    }
}

/// Puts the buffers one after another, and what meshopt compressed behind them.
fn views(draft: &mut Draft, typed: &Document, buffers: &Buffers<'_>) -> Result<(), Fault> {
    let mut starts: Vec<Option<usize>> = vec![None; typed.buffers.len()];
    for (number, view) in typed.buffer_views.iter().enumerate() {
        let start = if extensions::meshopt(&view.extensions).is_some() {
            let plain = buffers.view(number, String::new)?.bytes;
            let start = append(&mut draft.binary, plain);
            draft.list_mut("bufferViews")[number]["byteLength"] = json!(plain.len());
            start as u64
        } else {
            let start = match starts.get(view.buffer) {
                Some(Some(start)) => *start,
                _ => append(&mut draft.binary, buffers.bytes(view.buffer, number)?),
            };
            starts[view.buffer] = Some(start);
            (start as u64).saturating_add(view.byte_offset)
        };
        let view = &mut draft.list_mut("bufferViews")[number];
        view["buffer"] = json!(0);
        view["byteOffset"] = json!(start);
        forget_member_extension(view, &extensions::MESHOPT);
        // 0 is not allowed, and written by some to say that there is none.
        if view.get("byteStride").and_then(Value::as_u64) == Some(0) {
            remove(view, "byteStride");
        }
    }
    let mut first = draft.list("buffers").first().cloned().unwrap_or_else(|| json!({}));
    remove(&mut first, "uri");
    forget_member_extension(&mut first, &extensions::MESHOPT);
    draft.json["buffers"] = json!([first]);
    Ok(())
}

/// A multiple of 8 as start keeps every alignment that was.
fn append(binary: &mut Vec<u8>, bytes: &[u8]) -> usize {
    binary.resize(binary.len().next_multiple_of(8), 0);
    binary.extend_from_slice(bytes);
    binary.len() - bytes.len()
}

/// Writes what Draco compressed as plain accessors; gives those of weights.
fn plain_primitives(draft: &mut Draft, typed: &Document, buffers: &Buffers<'_>) -> Result<HashSet<usize>, Fault> {
    let mut weights = HashSet::new();
    for (m, mesh) in typed.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let Some(settings) = primitive.extensions.get(extensions::DRACO) else { continue };
            let what = format!("mesh {m}, primitive {p}");
            let failed = |reason| Fault::Compressed { what: what.clone(), extension: extensions::DRACO, reason };
            let own = &mut draft.list_mut("meshes")[m]["primitives"][p];
            forget_member_extension(own, &[extensions::DRACO]);
            let accessors = &typed.accessors;
            let bare = |n: &usize| {
                let accessor = accessors.get(*n).ok_or_else(|| Fault::Reference {
                    from: what.clone(),
                    to: "accessor",
                    index: *n,
                    count: accessors.len(),
                })?;
                Ok::<_, Fault>(accessor.buffer_view.is_none().then_some(accessor))
            };
            // With a plain copy beside, the compressed one is not needed.
            let Some(position) = primitive.attributes.get("POSITION") else { continue };
            if bare(position)?.is_none() {
                continue;
            }
            // Decoded triangles stand one by one.
            if primitive.mode == Some(5) {
                own["mode"] = json!(4);
            }
            let settings = draco::Settings::read(settings).map_err(failed)?;
            let decoded = settings.attributes.keys().filter_map(|name| primitive.attributes.get(name));
            let is_filled = |draft: &Draft, n: usize| {
                draft.list("accessors").get(n).is_some_and(|accessor| accessor.get("bufferView").is_some())
            };
            // Another primitive has the same geometry.
            if decoded.chain(&primitive.indices).all(|&n| is_filled(draft, n)) {
                continue;
            }
            let bytes = buffers.view(settings.buffer_view, || what.clone())?.bytes;
            // Each has three numbers of four bytes.
            let mesh = draco::Decoded::new(bytes, buffers.budget().left(12)).map_err(failed)?;
            buffers.budget().spend(mesh.points() * settings.attributes.len().max(1), 16)?;
            if let Some(indices) = primitive.indices
                && let Some(accessor) = bare(&indices)?
                && !is_filled(draft, indices)
            {
                let corners = mesh.corners();
                // The largest number of a type is none that the format allows.
                let most = corners.iter().max().copied().unwrap_or(0);
                let bytes: Vec<u8> = match accessor.component_type {
                    U8 if most < u8::MAX.into() => corners.iter().map(|c| *c as u8).collect(),
                    U16 if most < u16::MAX.into() => corners.iter().flat_map(|c| (*c as u16).to_le_bytes()).collect(),
                    _ => {
                        draft.list_mut("accessors")[indices]["componentType"] = json!(U32);
                        corners.iter().flat_map(|c| c.to_le_bytes()).collect()
                    }
                };
                fill(draft, indices, &bytes, corners.len(), Some(ELEMENTS), None);
            }
            for (name, &number) in &settings.attributes {
                let Some(accessor_number) = primitive.attributes.get(name) else { continue };
                let Some(accessor) = bare(accessor_number)?.filter(|_| !is_filled(draft, *accessor_number)) else {
                    continue;
                };
                let values = mesh.values(number, &accessor.shape).map_err(failed)?;
                let components = values.len() / mesh.points().max(1);
                let (bytes, stride) = draco::element_bytes(&values, components, accessor.component_type);
                fill(draft, *accessor_number, &bytes, mesh.points(), Some(ARRAY), stride);
                renew_bounds(&mut draft.list_mut("accessors")[*accessor_number], &values, components);
                if name.starts_with("WEIGHTS_") {
                    weights.insert(*accessor_number);
                }
            }
        }
    }
    Ok(weights)
}

/// Bounds that are stated become those of what was decoded, which is rounded.
fn renew_bounds(accessor: &mut Value, values: &[f32], components: usize) {
    for (key, pick) in [("min", f32::min as fn(f32, f32) -> f32), ("max", f32::max)] {
        if values.is_empty() && accessor.get(key).is_some_and(Value::is_null) {
            remove(accessor, key);
        } else if accessor.get(key).is_some() && !values.is_empty() {
            let bound = |k: usize| values.iter().skip(k).step_by(components).copied().reduce(pick);
            accessor[key] = (0..components).map(|k| json!(bound(k))).collect();
        }
    }
}

/// Gives an accessor bytes of its own.
fn fill(draft: &mut Draft, accessor: usize, bytes: &[u8], count: usize, target: Option<u32>, stride: Option<usize>) {
    let view = draft.view(bytes, target, stride);
    let accessor = &mut draft.list_mut("accessors")[accessor];
    accessor["bufferView"] = json!(view);
    accessor["count"] = json!(count);
    remove(accessor, "byteOffset");
    remove(accessor, "sparse");
}

/// Brings pictures in from data URIs and from files beside this one. Those that are not there stay named.
fn pictures(draft: &mut Draft, buffers: &Buffers<'_>, notes: &mut Vec<ExportNote>) -> Result<(), Fault> {
    for number in 0..draft.list("images").len() {
        let image = &draft.list("images")[number];
        let Some(uri) = image.get("uri").and_then(Value::as_str) else { continue };
        if image.get("bufferView").is_some() {
            continue;
        }
        let found = buffers.outside(number, uri, MOST_PICTURE);
        let stated = image.get("mimeType").and_then(Value::as_str).map(str::to_owned);
        let outside = matches!(found, Err(Fault::UriOutside { .. }));
        let packed = match found {
            Ok(Outside { bytes, kind }) => {
                let stated = stated.or(kind.filter(|k| k.starts_with("image/")));
                picture_type(&bytes).map(str::to_owned).or(stated).map(|kind| (bytes, kind))
            }
            Err(_) => None,
        };
        let Some((bytes, kind)) = packed else {
            notes.push(ExportNote::PictureLeft { image: number, uri: uri.chars().take(200).collect(), outside });
            continue;
        };
        let view = draft.view(&bytes, None, None);
        let image = &mut draft.list_mut("images")[number];
        remove(image, "uri");
        image["bufferView"] = json!(view);
        image["mimeType"] = json!(kind);
    }
    Ok(())
}

/// By the first bytes.
pub(super) fn picture_type(bytes: &[u8]) -> Option<&'static str> {
    if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP") {
        return Some("image/webp");
    }
    const MAGICS: [(&[u8], &str); 4] = [
        (b"\x89PNG", "image/png"),
        (b"\xff\xd8\xff", "image/jpeg"),
        (b"\xabKTX 20", "image/ktx2"),
        (b"DDS ", "image/vnd-ms.dds"),
    ];
    MAGICS.iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, kind)| *kind)
}

/// Takes extensions away from a part of the document.
pub(super) fn forget_member_extension(of: &mut Value, names: &[&str]) {
    let Some(all) = of.get_mut("extensions") else { return };
    for name in names {
        remove(all, name);
    }
    if all.as_object().is_some_and(serde_json::Map::is_empty) {
        remove(of, "extensions");
    }
}

/// Takes an extension off the lists of those that are used and required.
pub(super) fn forget_extension(json: &mut Value, name: &str) {
    for list in ["extensionsUsed", "extensionsRequired"] {
        let Some(names) = json.get_mut(list).and_then(Value::as_array_mut) else { continue };
        names.retain(|n| n != name);
        if names.is_empty() {
            remove(json, list);
        }
    }
}
