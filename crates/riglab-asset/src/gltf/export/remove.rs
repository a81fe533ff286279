//! A rig taken out of a document: skins that bind nothing any more, their joints, and motion of them.

use std::collections::HashMap;

use serde_json::{Value, json};

use super::super::nodes::Nodes;
use super::draft::{Draft, index, remove};
use super::place::{Moved, drop_from};
use super::references::{self, items};
use super::scene::Scene;
use super::{animations, finish, vrm};
use crate::ExportNote;

/// Extensions of a node that are nothing without a rig, or nothing that is seen.
const IDLE: [&str; 4] =
    ["VRMC_node_constraint", "KHR_node_visibility", "KHR_node_selectability", "KHR_node_hoverability"];

/// What takes the place of what goes.
#[derive(Default)]
pub(super) struct Successors {
    /// The new node of a joint, by its old one.
    pub(super) joints: HashMap<usize, usize>,
    /// The new node of a mesh, by its old one.
    pub(super) meshes: Moved,
}

/// What went with a rig.
pub(super) struct Lost {
    /// By node.
    pub(super) nodes: Vec<bool>,
    /// Human bones of a VRM.
    pub(super) bones: usize,
    /// Nodes that were to follow others.
    pub(super) constraints: usize,
}

/// Drops skins that no node has any more, and the nodes that were for their joints alone.
pub(super) fn old_rig(draft: &mut Draft, scene: &Scene, successors: &Successors, notes: &mut Vec<ExportNote>) -> Lost {
    let nodes = &scene.nodes;
    let kept_skins = drop_skins(draft);
    let mut is_joint = scene.is_joint.clone();
    for skin in kept_skins {
        scene.skins.get(skin).into_iter().flatten().for_each(|&node| is_joint[node] = false);
    }
    let still_bound: Vec<bool> = scene.is_joint.iter().zip(&is_joint).map(|(was, is)| *was && !is).collect();
    let near = near_joints(nodes, &is_joint);
    let mut gone = vec![false; nodes.len()];
    for &node in nodes.order().iter().rev() {
        let own = &draft.list("nodes")[node];
        let children = own.get("children").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let all_gone = children.iter().filter_map(index).all(|c| gone.get(c).copied().unwrap_or(false));
        gone[node] = near[node] && all_gone && !still_bound[node] && !carries(own);
    }
    keep_named(draft, &mut gone, notes);
    let above = above_joints(nodes, &is_joint);
    let old = |node: usize| gone.get(node).copied().unwrap_or(false);
    // A node that its mesh left alone moves what hangs on it still.
    let stands = |node: usize| successors.meshes.get(&node) == Some(&node);
    let moves_rig = |node: usize| old(node) || above.get(node).copied().unwrap_or(false) || stands(node);
    let mesh_at = |node: usize| successors.meshes.get(&node).copied();
    let channels = animations::drop_motion(draft, moves_rig, mesh_at);
    if channels > 0 {
        notes.push(ExportNote::MotionDropped { channels });
    }
    vrm::follow_meshes(&mut draft.json, mesh_at);
    let constrained = vrm::constrained(draft);
    let bones = vrm::follow_joints(draft, &|node| {
        let lost = old(node) || is_joint.get(node).copied().unwrap_or(false);
        successors.joints.get(&node).copied().or((!lost).then_some(node))
    });
    for node in draft.list_mut("nodes") {
        drop_from(node, "children", old);
        if let Some(lod) = node.pointer_mut("/extensions/MSFT_lod") {
            drop_from(lod, "ids", old);
        }
    }
    for shown in draft.list_mut("scenes") {
        drop_from(shown, "nodes", old);
    }
    finish::drop_nodes(draft, &gone);
    let constraints = constrained - vrm::constrained(draft);
    Lost { nodes: gone, bones, constraints }
}

/// Keeps all nodes in a document of which not all that may name nodes is known, and tells so.
fn keep_named(draft: &Draft, gone: &mut [bool], notes: &mut Vec<ExportNote>) {
    let extensions = references::unknown(draft);
    let nodes = gone.iter().filter(|gone| **gone).count();
    if nodes > 0 && !extensions.is_empty() {
        gone.fill(false);
        notes.push(ExportNote::JointsStay { nodes, extensions });
    }
}

/// Tells what hung on joints, by `Scene::carried`, and went with them.
pub(super) fn tell_hung(hung: &[usize], lost: &Lost, notes: &mut Vec<ExportNote>) {
    let nodes = hung.iter().filter(|&&node| lost.nodes[node]).count();
    if nodes + lost.bones + lost.constraints > 0 {
        notes.push(ExportNote::HungLost { nodes, bones: lost.bones, constraints: lost.constraints });
    }
}

/// Drops the skins without a node; gives the old numbers of those that stay.
fn drop_skins(draft: &mut Draft) -> Vec<usize> {
    let mut used: Vec<usize> = draft.list("nodes").iter().filter_map(|node| index(&node["skin"])).collect();
    used.sort_unstable();
    used.dedup();
    for node in draft.list_mut("nodes") {
        if let Some(new) = index(&node["skin"]).and_then(|skin| used.binary_search(&skin).ok()) {
            node["skin"] = json!(new);
        }
    }
    let mut number = 0..;
    if let Some(skins) = draft.json.get_mut("skins").and_then(Value::as_array_mut) {
        skins.retain(|_| number.next().is_some_and(|n: usize| used.binary_search(&n).is_ok()));
        if skins.is_empty() {
            remove(&mut draft.json, "skins");
        }
    }
    used
}

/// Whether a node is for more than holding others.
fn carries(node: &Value) -> bool {
    let idle = |extensions: &Value| {
        extensions.as_object().is_none_or(|all| all.keys().all(|name| IDLE.contains(&name.as_str())))
    };
    ["mesh", "camera", "skin"].iter().any(|key| node.get(key).is_some()) || !node.get("extensions").is_none_or(idle)
}

/// Nodes that are joints or above them.
fn above_joints(nodes: &Nodes, is_joint: &[bool]) -> Vec<bool> {
    let mut above = is_joint.to_vec();
    above.push(false);
    for &node in nodes.order().iter().rev() {
        above[nodes.parent(node)] |= above[node];
    }
    above.pop();
    above
}

/// Nodes that are joints, or above or below them.
fn near_joints(nodes: &Nodes, is_joint: &[bool]) -> Vec<bool> {
    let mut below = is_joint.to_vec();
    below.push(false);
    for &node in nodes.order() {
        below[node] |= below[nodes.parent(node)];
    }
    above_joints(nodes, is_joint).iter().zip(&below).map(|(above, below)| *above || *below).collect()
}

/// Takes JOINTS_n and WEIGHTS_n away from all meshes.
pub(super) fn influences(draft: &mut Draft) {
    for mesh in draft.list_mut("meshes") {
        for primitive in items(mesh.get_mut("primitives")) {
            if let Some(attributes) = primitive.get_mut("attributes").and_then(Value::as_object_mut) {
                attributes.retain(|name, _| !name.starts_with("JOINTS_") && !name.starts_with("WEIGHTS_"));
            }
        }
    }
}
