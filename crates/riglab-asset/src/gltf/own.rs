//! Which GLBs riglab wrote, and what of.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde_json::{Value, json};

use super::export::container;
use super::glb::chunks;
use crate::maker::{MAKER, is_maker};

/// Where a document that another program made says in its asset's `extras` who wrote this file: its generator stays, as
/// loaders know by it how to read what that program wrote.
const WRITER: &str = "writer";

/// Where a document says in its asset's `extras` which file a model was rigged of.
const MADE_OF: &str = "madeOf";

/// Marks a document as written by riglab. One whose `extras` are no object stays without a mark.
pub(super) fn mark(document: &mut Value) {
    if said_by(&document["asset"]["generator"]) {
        return;
    }
    let Some(asset) = document["asset"].as_object_mut() else { return };
    if let Some(extras) = asset.entry("extras").or_insert_with(|| json!({})).as_object_mut() {
        extras.insert(WRITER.into(), json!(MAKER));
    }
}

/// Whether a GLB says that riglab wrote it.
pub(crate) fn is_own(glb: &Path) -> bool {
    asset(glb).is_some_and(|asset| said_by(&asset["generator"]) || said_by(&asset["extras"][WRITER]))
}

/// What a GLB says of itself.
fn asset(glb: &Path) -> Option<Value> {
    let mut file = File::open(glb).ok()?;
    let mut head = [0; 20];
    file.read_exact(&mut head).ok()?;
    let length = u32::from_le_bytes(*head[12..].first_chunk()?);
    // A chunk may say that it is longer than its file.
    let mut chunk = Vec::new();
    file.take(length.into()).read_to_end(&mut chunk).ok()?;
    Some(serde_json::from_slice::<Value>(&chunk).ok()?.get_mut("asset")?.take())
}

/// The file that a GLB says it was made of.
pub(crate) fn made_of(glb: &Path) -> Option<String> {
    asset(glb)?["extras"][MADE_OF].as_str().map(str::to_owned)
}

/// The same of a GLB's bytes.
#[cfg(feature = "fbx")]
pub(crate) fn said_made_of(glb: &[u8]) -> Option<String> {
    let document: Value = serde_json::from_slice(chunks(glb).ok()?.json).ok()?;
    document["asset"]["extras"][MADE_OF].as_str().map(str::to_owned)
}

/// A GLB that says which file it was made of. One whose `extras` are no object has no place for it.
pub(crate) fn say_made_of(glb: &[u8], name: &str) -> Option<Vec<u8>> {
    let chunks = chunks(glb).ok()?;
    let mut document: Value = serde_json::from_slice(chunks.json).ok()?;
    let asset = document.get_mut("asset")?.as_object_mut()?;
    let extras = asset.entry("extras").or_insert_with(|| json!({})).as_object_mut()?;
    extras.insert(MADE_OF.into(), json!(name));
    container(document.to_string().into_bytes(), chunks.binary.unwrap_or_default().to_vec()).ok()
}

fn said_by(value: &Value) -> bool {
    value.as_str().is_some_and(|said| is_maker(said.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_of_others_are_marked_beside_their_generator() {
        let of = |asset: Value| {
            let mut document = json!({ "asset": asset });
            mark(&mut document);
            document["asset"].take()
        };
        let blender = of(json!({"generator": "Blender", "extras": {"author": "A"}}));
        assert_eq!(blender, json!({"generator": "Blender", "extras": {"author": "A", "writer": MAKER}}));
        assert_eq!(of(json!({"version": "2.0"}))["extras"]["writer"], MAKER);
        for stays in [json!({"generator": MAKER}), json!({"extras": "mine"})] {
            assert_eq!(of(stays.clone()), stays);
        }
    }
}
