//! Blend shapes that a file shows its meshes with before anything moves: weights that are not 0.

use serde_json::Value;

use super::accessor::Accessors;
use super::document::{Document, Node};
use super::primitives::Sources;
use crate::Shaped;

/// Letters of a mesh's name that are kept: nodes that show it may be many.
const NAME: usize = 80;

/// Vertices that shapes may move, and weights that are gone through: half a second. Nodes that show one mesh may be many.
const MAX_MOVED: usize = 1 << 27;

/// Moves vertices to where the shapes that a file shows its meshes with have them. Whether all of them could be; where one
/// cannot, what follows stays.
pub(super) fn apply(document: &Document, accessors: &Accessors<'_>, sources: &mut Sources) -> bool {
    let mut room = MAX_MOVED;
    sources.sets.iter_mut().all(|set| {
        let (node, mesh) = (&document.nodes[set.place.node], &document.meshes[set.place.mesh]);
        let Some(weights) = node.weights.as_array().or_else(|| mesh.weights.as_array()) else { return true };
        let Some(left) = room.checked_sub(weights.len()) else { return false };
        room = left;
        let targets = mesh.primitives[set.place.primitive].targets.as_array();
        let mut moved: Option<Vec<[f32; 3]>> = None;
        for (number, weight) in weights.iter().enumerate() {
            let weight = weight.as_f64().unwrap_or(0.0) as f32;
            // What moves no positions may move normals.
            let target = targets.and_then(|all| all.get(number)).and_then(|target| target.get("POSITION"));
            let (true, Some(target)) = (weight != 0.0, target) else { continue };
            let accessor = target.as_u64().and_then(|number| usize::try_from(number).ok());
            let Some(left) = room.checked_sub(set.positions.len()) else { return false };
            room = left;
            let Some(Ok(by)) = accessor.map(|number| accessors.directions(number)) else { return false };
            if by.len() != set.positions.len() {
                return false;
            }
            let all = moved.get_or_insert_with(|| set.positions.to_vec());
            for (x, by) in all.as_flattened_mut().iter_mut().zip(by.as_flattened()) {
                let to = *x + weight * by;
                if !to.is_finite() {
                    return false;
                }
                *x = to;
            }
        }
        if let Some(moved) = moved {
            set.positions = moved.into();
        }
        true
    })
}

/// The nodes whose meshes are shown so, rising. A node's weights take the place of those of its mesh.
pub(super) fn shaped(document: &Document) -> Vec<Shaped> {
    let of_meshes: Vec<_> = document.meshes.iter().map(|mesh| counts(&mesh.weights)).collect();
    let shown = |(number, node): (usize, &Node)| {
        let mesh = node.mesh?;
        let (weighted, shapes) =
            counts(&node.weights).or(*of_meshes.get(mesh)?).filter(|(weighted, _)| *weighted > 0)?;
        let name = document.meshes[mesh].name.as_str().filter(|name| !name.is_empty());
        let name = name.map_or_else(|| format!("mesh {mesh}"), |name| name.chars().take(NAME).collect());
        Some(Shaped { node: number, mesh: name, weighted, shapes })
    };
    document.nodes.iter().enumerate().filter_map(shown).collect()
}

/// How many weights are not 0, and how many there are; `None` where nothing is said.
fn counts(weights: &Value) -> Option<(usize, usize)> {
    let all = weights.as_array()?;
    Some((all.iter().filter(|weight| weight.as_f64().is_some_and(|w| w != 0.0)).count(), all.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_node_says_counts_before_its_mesh() {
        let json = br#"{"asset": {"version": "2.0"},
            "meshes": [{"name": "face", "weights": [0, 0.5, 1]}, {"weights": [1]}, {"weights": [0, 0.0]}, {"weights": "x"}],
            "nodes": [{"mesh": 0}, {"mesh": 0, "weights": [0, 0, 0]}, {"mesh": 1}, {"mesh": 2}, {"mesh": 3}, {"mesh": 9}]}"#;
        let of = |node, mesh: &str, weighted, shapes| Shaped { node, mesh: mesh.into(), weighted, shapes };
        let document = Document::parse(json).unwrap();
        assert_eq!(shaped(&document), [of(0, "face", 2, 3), of(2, "mesh 1", 1, 1)]);
    }
}
