//! Where a document names accessors, buffer views and nodes by number.
//!
//! Core glTF, and the extensions that are known to. A document with an extension that is not known is
//! never renumbered: it may name anything.

use std::collections::BTreeSet;

use serde_json::Value;

use super::super::extensions;
use super::draft::{Draft, index};

/// What a number counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Accessor,
    View,
    Node,
}

/// Extensions beyond those the importer takes for harmless that name nothing, or are looked into here.
const KNOWN: [&str; 7] = [
    "EXT_mesh_gpu_instancing",
    "MSFT_lod",
    "FB_ngon_encoding",
    "KHR_materials_variants",
    "EXT_texture_procedurals_mx_1_39",
    "GRIFFEL_bim_data",
    SINGLE_ROOT,
];

/// Says by its name alone that node 0 is the only root.
pub(super) const SINGLE_ROOT: &str = "GODOT_single_root";

/// The extensions of a document that are not known and say something, in order: it may be parts of the document, by number.
pub(super) fn unknown(draft: &Draft) -> Vec<String> {
    let used = draft.list("extensionsUsed").iter().filter_map(Value::as_str);
    let unknown: BTreeSet<&str> = used.filter(|name| !KNOWN.contains(name) && !extensions::is_known(name)).collect();
    if unknown.is_empty() {
        return Vec::new();
    }
    let mut there = BTreeSet::new();
    extensions_in(&draft.json, &mut there);
    unknown.into_iter().filter(|name| there.contains(name)).map(str::to_owned).collect()
}

/// The names of the extensions that say something anywhere in a part of a document.
fn extensions_in<'v>(part: &'v Value, names: &mut BTreeSet<&'v str>) {
    let says = |value: &Value| value.as_object().is_none_or(|own| !own.is_empty());
    match part {
        Value::Array(all) => all.iter().for_each(|own| extensions_in(own, names)),
        Value::Object(all) => {
            let own = all.get("extensions").and_then(Value::as_object).into_iter().flatten();
            names.extend(own.filter(|(_, value)| says(value)).map(|(name, _)| name.as_str()));
            // What applications keep for themselves are no extensions.
            all.iter().filter(|(key, _)| *key != "extras").for_each(|(_, own)| extensions_in(own, names));
        }
        _ => {}
    }
}

/// Calls `visit` with every number that names an accessor, a buffer view or a node.
pub(super) fn visit(draft: &mut Draft, visit: &mut dyn FnMut(Kind, &mut Value)) {
    let mut at = |kind: Kind, value: Option<&mut Value>| {
        if let Some(value) = value.filter(|v| index(v).is_some()) {
            visit(kind, value);
        }
    };
    for accessor in draft.list_mut("accessors") {
        at(Kind::View, accessor.get_mut("bufferView"));
        at(Kind::View, accessor.pointer_mut("/sparse/indices/bufferView"));
        at(Kind::View, accessor.pointer_mut("/sparse/values/bufferView"));
    }
    for image in draft.list_mut("images") {
        at(Kind::View, image.get_mut("bufferView"));
    }
    for mesh in draft.list_mut("meshes") {
        for primitive in items(mesh.get_mut("primitives")) {
            values(primitive.get_mut("attributes"), |v| at(Kind::Accessor, Some(v)));
            at(Kind::Accessor, primitive.get_mut("indices"));
            for target in items(primitive.get_mut("targets")) {
                values(Some(target), |v| at(Kind::Accessor, Some(v)));
            }
        }
    }
    for skin in draft.list_mut("skins") {
        at(Kind::Accessor, skin.get_mut("inverseBindMatrices"));
        at(Kind::Node, skin.get_mut("skeleton"));
        items(skin.get_mut("joints")).for_each(|joint| at(Kind::Node, Some(joint)));
    }
    for animation in draft.list_mut("animations") {
        for sampler in items(animation.get_mut("samplers")) {
            at(Kind::Accessor, sampler.get_mut("input"));
            at(Kind::Accessor, sampler.get_mut("output"));
        }
        for channel in items(animation.get_mut("channels")) {
            at(Kind::Node, channel.pointer_mut("/target/node"));
            let pointer = channel.pointer_mut("/target/extensions/KHR_animation_pointer/pointer");
            node_in_pointer(pointer, |node| at(Kind::Node, Some(node)));
        }
    }
    for scene in draft.list_mut("scenes") {
        items(scene.get_mut("nodes")).for_each(|node| at(Kind::Node, Some(node)));
    }
    for node in draft.list_mut("nodes") {
        items(node.get_mut("children")).for_each(|child| at(Kind::Node, Some(child)));
        items(node.pointer_mut("/extensions/MSFT_lod/ids")).for_each(|id| at(Kind::Node, Some(id)));
        values(node.pointer_mut("/extensions/EXT_mesh_gpu_instancing/attributes"), |v| at(Kind::Accessor, Some(v)));
        values(node.pointer_mut("/extensions/VRMC_node_constraint/constraint"), |c| {
            at(Kind::Node, c.get_mut("source"));
        });
    }
    for list in ["KHR_audio_emitter/audio", "EXT_lights_ies/lights", "KHR_techniques_webgl/shaders"] {
        for item in items(draft.json.pointer_mut(&format!("/extensions/{list}"))) {
            at(Kind::View, item.get_mut("bufferView"));
        }
    }
    super::vrm::nodes(&mut draft.json, &mut |node| at(Kind::Node, Some(node)));
}

/// The elements of a list; none of anything else.
pub(super) fn items(list: Option<&mut Value>) -> std::slice::IterMut<'_, Value> {
    list.and_then(Value::as_array_mut).map_or(Default::default(), |list| list.iter_mut())
}

/// The values of an object.
pub(super) fn values(object: Option<&mut Value>, each: impl FnMut(&mut Value)) {
    if let Some(object) = object.and_then(Value::as_object_mut) {
        object.values_mut().for_each(each);
    }
}

/// The node that a pointer like `/nodes/3/rotation` names.
pub(super) fn node_in_pointer(pointer: Option<&mut Value>, mut each: impl FnMut(&mut Value)) {
    let Some(pointer) = pointer else { return };
    let Some((number, rest)) = pointer.as_str().and_then(|p| p.strip_prefix("/nodes/")?.split_once('/')) else {
        return;
    };
    let Ok(number) = number.parse::<usize>() else { return };
    let mut node = Value::from(number);
    let rest = rest.to_owned();
    each(&mut node);
    *pointer = format!("/nodes/{node}/{rest}").into();
}
