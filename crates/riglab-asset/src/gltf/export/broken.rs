//! A file whose rig cannot be read, without it.

use serde_json::Value;

use super::super::{document, split};
use super::draft::{Draft, container, index, remove};
use super::references::items;
use super::remove;
use crate::{ExportFault, Fault};

/// The file without skins, JOINTS_n and WEIGHTS_n, and the nodes that were joints. All else, what its buffers hold too, is
/// as it was.
pub(super) fn without_rig(bytes: &[u8]) -> Result<(Vec<u8>, Vec<usize>), ExportFault> {
    let chunks = split(bytes)?;
    let json: Value = serde_json::from_str(document::text(chunks.json)?)
        .map_err(|e| Fault::Json { path: String::new(), reason: e.to_string() })?;
    let mut draft = Draft::new(json);
    let count = draft.list("nodes").len();
    let joints = draft.list_mut("skins").iter_mut().flat_map(|skin| items(skin.get_mut("joints")));
    let joints = joints.filter_map(|joint| index(joint)).filter(|joint| *joint < count).collect();
    remove(&mut draft.json, "skins");
    for node in draft.list_mut("nodes") {
        remove(node, "skin");
    }
    remove::influences(&mut draft);
    let binary = chunks.binary.unwrap_or_default().to_vec();
    Ok((container(draft.json.to_string().into_bytes(), binary).map_err(ExportFault::TooLong)?, joints))
}
