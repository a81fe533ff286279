//! Blend shapes that a file shows its meshes with before anything moves: weights that are not 0.

use serde_json::Value;

use super::document::Document;
use crate::Shaped;

/// Letters of a mesh's name that are kept: nodes that show it may be many.
const NAME: usize = 80;

/// The nodes whose meshes are shown so, rising. A node's weights take the place of those of its mesh.
pub(super) fn shaped(document: &Document) -> Vec<Shaped> {
    let of_meshes: Vec<_> = document.meshes.iter().map(|mesh| counts(&mesh.weights)).collect();
    let shown = |(number, node): (usize, &super::document::Node)| {
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
