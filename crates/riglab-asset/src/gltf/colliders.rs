//! Meshes that are there for what bumps into a model, not to be seen.
//!
//! glTF has no word for them; engines go by the names of nodes, and so does this: Decentraland's `..._collider`, Unreal's
//! `UCX_...` (a box, a sphere, a capsule or a hull), Godot's `...-colonly`, and whatever calls itself a collider. A mesh of
//! that name which is no coarser than the model is taken for the model.

use super::document::{Document, Node};

/// What Unreal's begin with.
const BEGINNINGS: [&str; 4] = ["ucx_", "ubx_", "usp_", "ucp_"];
/// What Godot's end with where nothing of them is shown.
const ENDS: [&str; 2] = ["-colonly", "-convcolonly"];

/// Triangles that a collider may have however few the model has, and how many times fewer than the model it has beyond that.
const COARSE: (u64, u64) = (64, 4);

/// The nodes that hold colliders, rising.
pub(super) fn colliders(document: &Document) -> Vec<usize> {
    let named = |node: &Node| node.name.as_deref().is_some_and(is_named);
    let shown = document.nodes.iter().filter(|node| !named(node)).map(|node| triangles(document, node)).sum::<u64>();
    let coarse = |node: &Node| {
        let own = triangles(document, node);
        own < shown && own <= COARSE.0.max(shown / COARSE.1)
    };
    let nodes = document.nodes.iter().enumerate();
    nodes.filter(|(_, node)| node.mesh.is_some() && named(node) && coarse(node)).map(|(number, _)| number).collect()
}

/// About how many a node's mesh has.
fn triangles(document: &Document, node: &Node) -> u64 {
    let primitives = node.mesh.and_then(|mesh| document.meshes.get(mesh)).map_or(&[][..], |mesh| &mesh.primitives);
    let corners = |accessor: &usize| document.accessors.get(*accessor).map_or(0, |a| a.count);
    primitives.iter().map(|p| p.indices.as_ref().or(p.attributes.get("POSITION")).map_or(0, corners) / 3).sum()
}

/// Whether a node of this name holds no part of the model.
fn is_named(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let bare = name.trim_end_matches(|c: char| c.is_ascii_digit() || c == '.');
    name.contains("collider")
        || name.contains("collision")
        || BEGINNINGS.iter().any(|b| name.starts_with(b))
        || ENDS.iter().any(|e| bare.ends_with(e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colliders_are_known_by_the_names_that_engines_go_by() {
        let colliders =
            ["Bear_collider", "Tree_collider.003", "Dispenser_collider_box", "UCX_Rock_01", "ubx_a", "wall-colonly"];
        for name in colliders.into_iter().chain(["wall-convcolonly.001", "CollisionMesh"]) {
            assert!(is_named(name), "{name}");
        }
        for name in ["collar", "Bear", "wall-col", "column", "", "dog_collie"] {
            assert!(!is_named(name), "{name}");
        }
    }
}
