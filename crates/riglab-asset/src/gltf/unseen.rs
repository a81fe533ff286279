//! Meshes that a file holds and does not show.
//!
//! What no node of its scene leads to (the shapes of an editor's controls, other scenes), what a node hides
//! (`KHR_node_visibility`), and coarser forms of what is shown (`MSFT_lod`).

use std::collections::HashSet;

use serde_json::Value;

use super::document::{Document, Node};

/// The nodes that hold them, rising; none where nothing would be left to see.
pub(super) fn unseen(document: &Document) -> Vec<usize> {
    let coarser: HashSet<usize> = document.nodes.iter().flat_map(coarser_forms).collect();
    let mut seen = vec![false; document.nodes.len()];
    let mut open = roots(document);
    while let Some(number) = open.pop() {
        let Some(node) = document.nodes.get(number).filter(|node| !hides(node)) else { continue };
        if !coarser.contains(&number) && !std::mem::replace(&mut seen[number], true) {
            open.extend(&node.children);
        }
    }
    let holds = |number: &usize| document.nodes[*number].mesh.is_some();
    let (seen, unseen): (Vec<usize>, Vec<usize>) = (0..seen.len()).filter(holds).partition(|&number| seen[number]);
    if seen.is_empty() { Vec::new() } else { unseen }
}

/// Where a scene begins: the one that is told, else the first; a file without scenes shows all that it has.
fn roots(document: &Document) -> Vec<usize> {
    match document.scenes.get(index(&document.scene).unwrap_or(0)) {
        Some(scene) => scene["nodes"].as_array().into_iter().flatten().filter_map(index).collect(),
        None => (0..document.nodes.len()).collect(),
    }
}

pub(super) fn hides(node: &Node) -> bool {
    node.extensions["KHR_node_visibility"]["visible"] == false
}

fn coarser_forms(node: &Node) -> impl Iterator<Item = usize> {
    node.extensions["MSFT_lod"]["ids"].as_array().into_iter().flatten().filter_map(index)
}

fn index(value: &Value) -> Option<usize> {
    usize::try_from(value.as_u64()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(scenes: &str, nodes: &str) -> Vec<usize> {
        let text = format!(r#"{{"asset": {{"version": "2.0"}}, {scenes} "nodes": [{nodes}]}}"#);
        unseen(&Document::parse(text.as_bytes()).unwrap())
    }

    #[test]
    fn meshes_of_other_scenes_and_of_none_are_not_seen() {
        let nodes = r#"{"children": [1]}, {"mesh": 0}, {"mesh": 1}, {"mesh": 2}"#;
        let two = r#""scenes": [{"nodes": [0]}, {"nodes": [2]}],"#;
        assert_eq!(of(two, nodes), [2, 3]);
        assert_eq!(of(&format!(r#""scene": 1, {two}"#), nodes), [1, 3]);
        assert_eq!(of("", nodes), [0usize; 0], "a library of meshes");
        assert_eq!(of(r#""scenes": [{}],"#, nodes), [0usize; 0], "a scene of nothing");
    }

    #[test]
    fn hidden_nodes_and_coarser_forms_are_not_seen() {
        let hidden = r#""extensions": {"KHR_node_visibility": {"visible": false}}"#;
        let scene = r#""scenes": [{"nodes": [0, 1, 2]}],"#;
        let nodes = format!(r#"{{"mesh": 0}}, {{"children": [3], {hidden}}}, {{"mesh": 0}}, {{"mesh": 0}}"#);
        assert_eq!(of(scene, &nodes), [3], "what a node hides is all below it");
        let nodes = r#"{"mesh": 0, "extensions": {"MSFT_lod": {"ids": [2]}}}, {}, {"mesh": 1}"#;
        assert_eq!(of(scene, nodes), [2]);
        assert_eq!(of(scene, &format!(r#"{{"mesh": 0, {hidden}}}, {{}}, {{}}"#)), [0usize; 0], "nothing else is left");
    }

    #[test]
    fn circles_end() {
        assert_eq!(
            of(r#""scenes": [{"nodes": [0, 9]}],"#, r#"{"mesh": 0, "children": [0, 1]}, {"children": [0]}"#),
            [0usize; 0]
        );
    }
}
