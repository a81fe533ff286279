//! Whose a mesh is: nodes that share one and are to differ get their own.

use std::collections::HashMap;

use serde_json::{Value, json};

use super::draft::{Draft, index};
use super::references::items;

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
        tell_of_copy(draft, mesh, copy);
        Some(copy)
    }
}

/// Has what is said of a mesh by its number said of its copy, too.
fn tell_of_copy(draft: &mut Draft, mesh: usize, copy: usize) {
    let of_mesh = |entry: &Value| index(&entry["mesh"]) == Some(mesh);
    let to_copy = |entry: &mut Value| entry["mesh"] = json!(copy);
    if let Some(vrm) = draft.json.pointer_mut("/extensions/VRM") {
        repeat(vrm.pointer_mut("/firstPerson/meshAnnotations"), of_mesh, to_copy);
        for group in items(vrm.pointer_mut("/blendShapeMaster/blendShapeGroups")) {
            repeat(group.get_mut("binds"), of_mesh, to_copy);
        }
    }
    const POINTER: &str = "/target/extensions/KHR_animation_pointer/pointer";
    let [own, new] = [mesh, copy].map(|mesh| format!("/meshes/{mesh}/"));
    let part = |channel: &Value| Some(channel.pointer(POINTER)?.as_str()?.strip_prefix(&own)?.to_owned());
    for animation in draft.list_mut("animations") {
        repeat(
            animation.get_mut("channels"),
            |channel| part(channel).is_some(),
            |channel| {
                if let (Some(part), Some(pointer)) = (part(channel), channel.pointer_mut(POINTER)) {
                    *pointer = json!(format!("{new}{part}"));
                }
            },
        );
    }
}

/// Adds those of a list that are wanted to it once more, changed.
fn repeat(list: Option<&mut Value>, wanted: impl Fn(&Value) -> bool, change: impl Fn(&mut Value)) {
    let Some(list) = list.and_then(Value::as_array_mut) else { return };
    let mut more: Vec<Value> = list.iter().filter(|own| wanted(own)).cloned().collect();
    more.iter_mut().for_each(change);
    list.extend(more);
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

    #[test]
    fn what_is_said_of_a_mesh_is_said_of_its_copy() {
        let bind = |mesh: usize| json!({"mesh": mesh, "index": 3, "weight": 100});
        let channel = |pointer: &str| json!({"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}});
        let mut draft = Draft::new(json!({
            "nodes": [{"mesh": 1}, {"mesh": 1}],
            "meshes": [{}, {}],
            "animations": [{"channels": [channel("/meshes/1/weights/0"), channel("/meshes/10/weights"), channel("/nodes/1/scale")]}],
            "extensions": {"VRM": {
                "blendShapeMaster": {"blendShapeGroups": [{"binds": [bind(1), bind(0)]}, {"binds": "none"}]},
                "firstPerson": {"meshAnnotations": [bind(1)]},
            }},
        }));
        Meshes::new(&draft).own(&mut draft, 0);
        let vrm = &draft.json["extensions"]["VRM"];
        assert_eq!(vrm["blendShapeMaster"]["blendShapeGroups"][0]["binds"], json!([bind(1), bind(0), bind(2)]));
        assert_eq!(vrm["firstPerson"]["meshAnnotations"], json!([bind(1), bind(2)]));
        let channels = draft.json["animations"][0]["channels"].as_array().unwrap();
        assert_eq!((channels.len(), &channels[3]), (4, &channel("/meshes/2/weights/0")));
    }
}
