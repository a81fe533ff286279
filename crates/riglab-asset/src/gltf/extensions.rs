//! Which extensions a file may require, and those that compress geometry.

use std::collections::BTreeMap;

use serde_json::Value;

use super::document::Document;
use crate::Fault;

/// Compressed primitives.
pub(super) const DRACO: &str = "KHR_draco_mesh_compression";
/// Compressed buffer views; the second is the first with a newer codec, which is read as well.
pub(super) const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// Extensions that are read, or that change nothing about joints, vertices and weights.
const HARMLESS: [&str; 16] = [
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
    "KHR_node_visibility",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
    "VRM",
    "KHR_audio_emitter",
    "KHR_techniques_webgl",
];

/// Families of which all are harmless.
const HARMLESS_FAMILIES: [&str; 5] = ["KHR_materials_", "EXT_materials_", "ADOBE_materials_", "VRMC_", "EXT_lights_"];

/// Refuses files that require what is not known: reading on would give a wrong rig silently.
pub(super) fn check_required(document: &Document) -> Result<(), Fault> {
    for name in &document.extensions_required {
        if !is_known(name) {
            return Err(Fault::RequiredExtension(name.clone()));
        }
    }
    Ok(())
}

/// Whether an extension is read, or changes nothing about rigs.
pub(super) fn is_known(name: &str) -> bool {
    name == DRACO
        || MESHOPT.contains(&name)
        || HARMLESS.contains(&name)
        || HARMLESS_FAMILIES.iter().any(|family| name.starts_with(family))
}

/// The compression of a buffer view and its settings, if there is one.
pub(super) fn meshopt(extensions: &BTreeMap<String, Value>) -> Option<(&'static str, &Value)> {
    MESHOPT.into_iter().find_map(|name| Some((name, extensions.get(name)?)))
}
