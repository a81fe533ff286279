//! Meshes that are drawn several times by `EXT_mesh_gpu_instancing`.
//!
//! They are told, not read: a copy has no node of its own, so nothing could say in the document which of them a joint
//! moves. A file that requires the extension is refused.

use serde_json::Value;

use super::document::{Document, Node};
use super::nodes::Nodes;
use crate::Warning;

/// The warning about them, where there are some.
pub(super) fn told(document: &Document, nodes: &Nodes) -> Option<Warning> {
    let all = document.nodes.iter().enumerate().filter(|(_, node)| node.mesh.is_some());
    let drawn: Vec<(usize, u64)> = all.filter_map(|(number, node)| Some((number, times(document, node)?))).collect();
    let times = drawn.iter().map(|(_, times)| *times).collect();
    (!drawn.is_empty()).then(|| Warning::Instanced { nodes: nodes.named(drawn.iter().map(|(n, _)| *n)), times })
}

/// How often a node's mesh is drawn: all accessors of a node are of one length.
fn times(document: &Document, node: &Node) -> Option<u64> {
    let attributes = node.extensions["EXT_mesh_gpu_instancing"]["attributes"].as_object()?;
    let accessor = attributes.values().find_map(Value::as_u64)?;
    document.accessors.get(usize::try_from(accessor).ok()?).map(|accessor| accessor.count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_draw_their_mesh_several_times_are_told() {
        let by = |accessor: usize| {
            format!(r#""extensions": {{"EXT_mesh_gpu_instancing": {{"attributes": {{"TRANSLATION": {accessor}}}}}}}"#)
        };
        let text = format!(
            r#"{{"asset": {{"version": "2.0"}}, "accessors": [{{"componentType": 5126, "count": 4, "type": "VEC3"}}],
                "nodes": [{{"mesh": 0}}, {{"mesh": 0, "name": "leg", {}}}, {{{}}}, {{"mesh": 0, {}}}]}}"#,
            by(0),
            by(0),
            by(7)
        );
        let document = Document::parse(text.as_bytes()).unwrap();
        let warning = told(&document, &Nodes::new(&document).unwrap()).unwrap().to_string();
        assert!(warning.contains("(node 1 `leg`: 4 times)"), "{warning}");
        let plain = Document::parse(br#"{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]}"#).unwrap();
        assert_eq!(told(&plain, &Nodes::new(&plain).unwrap()), None);
    }
}
