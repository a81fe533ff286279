//! Whose a mesh is: nodes that share one and are to differ get their own.

use std::collections::HashMap;

use serde_json::json;

use super::draft::{Draft, index};

/// The meshes of a document while some nodes' meshes are rewritten.
pub(super) struct Meshes {
    /// How many nodes still share a mesh unchanged.
    sharers: HashMap<usize, usize>,
}

impl Meshes {
    pub(super) fn new(draft: &Draft) -> Self {
        let mut sharers = HashMap::new();
        for mesh in draft.list("nodes").iter().filter_map(|node| index(&node["mesh"])) {
            *sharers.entry(mesh).or_insert(0) += 1;
        }
        Self { sharers }
    }

    /// The mesh of a node for it alone. To be asked once a node.
    ///
    /// While others share it the node gets a copy; the last one keeps the mesh itself.
    pub(super) fn own(&mut self, draft: &mut Draft, node: usize) -> Option<usize> {
        let mesh = index(&draft.list("nodes")[node]["mesh"])?;
        let sharers = self.sharers.entry(mesh).or_insert(1);
        *sharers -= 1;
        if *sharers == 0 {
            return Some(mesh);
        }
        let copy = draft.list("meshes").get(mesh)?.clone();
        let copy = draft.push("meshes", copy);
        draft.list_mut("nodes")[node]["mesh"] = json!(copy);
        Some(copy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_to_ask_keeps_the_mesh() {
        let nodes = json!([{"mesh": 0}, {"mesh": 1}, {"mesh": 0}]);
        let mut draft = Draft::new(json!({"nodes": nodes, "meshes": [{"name": "a"}, {"name": "b"}]}));
        let mut meshes = Meshes::new(&draft);
        assert_eq!([0, 2, 1].map(|node| meshes.own(&mut draft, node)), [Some(2), Some(0), Some(1)]);
        assert_eq!(draft.json["nodes"], json!([{"mesh": 2}, {"mesh": 1}, {"mesh": 0}]));
        assert_eq!(draft.json["meshes"], json!([{"name": "a"}, {"name": "b"}, {"name": "a"}]));
    }
}
