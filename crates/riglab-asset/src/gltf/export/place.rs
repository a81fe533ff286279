//! Meshes where the rest pose shows them: geometry in the scene, on nodes at its top.

use std::collections::{HashMap, HashSet};

use glam::DAffine3;
use serde_json::{Value, json};

use super::super::accessor::Accessors;
use super::super::nodes::Nodes;
use super::bake::Baker;
use super::draft::{Draft, ELEMENTS, Layout, U16, U32, index, remove};
use super::scene::{Scene, Surface};
use crate::maps::{FLAT, is_flat};
use crate::{Fault, triangles};

/// Whether the positions of a surface, as stored, are those of the rig bit for bit.
pub(super) fn stands(surface: &Surface, placed: &[[f32; 3]], through: impl Fn([f32; 3]) -> [f32; 3]) -> bool {
    let same =
        |(&v, at): (&u32, &[f32; 3])| through(surface.stored[v as usize]).map(f32::to_bits) == at.map(f32::to_bits);
    surface.numbers.iter().zip(placed).all(same)
}

/// Moves a surface to where the rig has it.
///
/// Vertices of the rig take its positions; those that no triangle uses go by the map. Meshes on a node that
/// mirrors have their triangles turned, as it did when they were drawn; true for those.
pub(super) fn bake(
    draft: &mut Draft,
    accessors: &Accessors<'_>,
    baker: &mut Baker<'_, '_>,
    mesh: usize,
    surface: &Surface,
    placed: &[[f32; 3]],
) -> Result<bool, Fault> {
    let moved = |p: &[f32; 3]| {
        let at = surface.map.transform_point3(glam::Vec3::from(*p).as_dvec3()).as_vec3();
        if at.is_finite() { at.to_array() } else { [0.0; 3] }
    };
    let mut positions: Vec<[f32; 3]> = surface.stored.iter().map(moved).collect();
    for (&v, at) in surface.numbers.iter().zip(placed) {
        positions[v as usize] = *at;
    }
    let positions = draft.vectors(&positions, true, Some(super::draft::ARRAY));
    for &primitive in &surface.primitives {
        baker.primitive(draft, (mesh, primitive), Some(positions))?;
        if surface.turned {
            turn(draft, accessors, (mesh, primitive), surface.stored.len())?;
        }
    }
    Ok(surface.turned)
}

/// Makes the triangles of a primitive face the other way.
fn turn(
    draft: &mut Draft,
    accessors: &Accessors<'_>,
    (mesh, primitive): (usize, usize),
    vertices: usize,
) -> Result<(), Fault> {
    let own = &draft.list("meshes")[mesh]["primitives"][primitive];
    let mode = own.get("mode").and_then(Value::as_u64).unwrap_or(4);
    let indices = match own.get("indices").and_then(index) {
        Some(indices) => accessors.indices(indices)?,
        None => (0..vertices as u32).collect(),
    };
    let corners = triangles::from_indices(&indices, mode as u32).into_iter().flat_map(|[a, b, c]| [a, c, b]);
    // The largest number of a type is none that the format allows.
    let (bytes, layout): (Vec<u8>, _) = match vertices < 1 << 16 {
        true => (
            corners.flat_map(|v| (v as u16).to_le_bytes()).collect(),
            Layout { component: U16, shape: "SCALAR", size: 2 },
        ),
        false => (corners.flat_map(u32::to_le_bytes).collect(), Layout { component: U32, shape: "SCALAR", size: 4 }),
    };
    let indices = draft.accessor(&bytes, layout, Some(ELEMENTS));
    let own = &mut draft.list_mut("meshes")[mesh]["primitives"][primitive];
    own["indices"] = json!(indices);
    own["mode"] = json!(4);
    Ok(())
}

/// Nodes whose mesh was put at the top of the scene: the node that holds it now, by the one that did.
pub(super) type Moved = HashMap<usize, usize>;

/// Puts the mesh of a node at the top of the scene, with nothing moving it. A node that others hang on stays
/// where it is, without the mesh.
pub(super) fn to_top(draft: &mut Draft, nodes: &Nodes, node: usize, moved: &mut Moved) {
    let hidden = is_hidden(draft, nodes, node);
    let at = if holds_others(draft, node) {
        let own = &mut draft.list_mut("nodes")[node];
        let mut new = json!({});
        for key in ["mesh", "skin", "weights"] {
            if let Some(value) = remove(own, key) {
                new[key] = value;
            }
        }
        if let Some(name) = own.get("name") {
            new["name"] = name.clone();
        }
        take_levels(own, &mut new);
        draft.push("nodes", new)
    } else {
        stand(draft, node);
        if nodes.parent(node) == nodes.top() {
            moved.insert(node, node);
            return;
        }
        let above = &mut draft.list_mut("nodes")[nodes.parent(node)];
        drop_from(above, "children", |child| child == node);
        node
    };
    if hidden {
        hide(draft, at);
    }
    moved.insert(node, at);
    add_to_scenes(draft, nodes, &[node], at);
}

/// Gives what a node says of simpler meshes to another, which has its mesh now.
fn take_levels(node: &mut Value, to: &mut Value) {
    const LEVELS: &str = "MSFT_lod";
    // The shares of the screen at which they are shown are told beside it.
    for (members, key) in [("extensions", LEVELS), ("extras", "MSFT_screencoverage")] {
        let Some(own) = node.get_mut(members).and_then(|own| remove(own, key)) else { continue };
        to[members] = json!({key: own});
        if node[members].as_object().is_some_and(serde_json::Map::is_empty) {
            remove(node, members);
        }
    }
}

/// The extension by which a node hides its mesh and all below it.
const VISIBILITY: &str = "KHR_node_visibility";

/// Whether a node, or one above it, hides its mesh.
fn is_hidden(draft: &Draft, nodes: &Nodes, mut node: usize) -> bool {
    while node != nodes.top() {
        if draft.list("nodes")[node]["extensions"][VISIBILITY]["visible"] == false {
            return true;
        }
        node = nodes.parent(node);
    }
    false
}

pub(super) fn hide(draft: &mut Draft, node: usize) {
    draft.uses(VISIBILITY);
    let own = &mut draft.list_mut("nodes")[node];
    // Files have other things in its place, which say nothing.
    if !own["extensions"].is_object() {
        own["extensions"] = json!({});
    }
    own["extensions"][VISIBILITY] = json!({"visible": false});
}

/// Takes from the node of a skinned mesh what moves it. One that others hang on keeps that, and its mesh goes to the top.
pub(super) fn in_place(draft: &mut Draft, nodes: &Nodes, node: usize, moved: &mut Moved) {
    if holds_others(draft, node) {
        return to_top(draft, nodes, node, moved);
    }
    stand(draft, node);
    moved.insert(node, node);
}

fn holds_others(draft: &Draft, node: usize) -> bool {
    draft.list("nodes")[node].get("children").and_then(Value::as_array).is_some_and(|c| !c.is_empty())
}

/// Takes from a node what moves it within the one above.
fn stand(draft: &mut Draft, node: usize) {
    for key in ["matrix", "translation", "rotation", "scale"] {
        remove(&mut draft.list_mut("nodes")[node], key);
    }
}

/// Lists a node in every scene that shows one of `beside`.
pub(super) fn add_to_scenes(draft: &mut Draft, nodes: &Nodes, beside: &[usize], node: usize) {
    let roots: Vec<usize> = beside.iter().map(|&n| root(nodes, n)).collect();
    for scene in draft.list_mut("scenes") {
        let Some(listed) = scene.get_mut("nodes").and_then(Value::as_array_mut) else { continue };
        let shown = listed.iter().filter_map(index).any(|n| roots.contains(&n));
        if shown && !listed.iter().any(|n| index(n) == Some(node)) {
            listed.push(json!(node));
        }
    }
}

/// The node that a new skeleton has to hang on, so that motions which carry the whole model, such as a walk across the scene,
/// carry it still: skinned meshes go with their joints alone. The deepest that an animation moves of those above all holders
/// of meshes; none in a file that has skins, whose joints tell.
pub(super) fn carrier(scene: &Scene, holders: &[usize], moved: &HashSet<usize>) -> Option<usize> {
    let nodes = &scene.nodes;
    if !scene.skins.is_empty() {
        return None;
    }
    let mut node = nodes.common(holders.iter().copied());
    // A mesh below which its own joints hang is more than programs expect.
    while node != nodes.top() && (holders.contains(&node) || !moved.contains(&node)) {
        node = nodes.parent(node);
    }
    let flat = |node: usize| is_flat(&nodes.global(node).matrix3, FLAT);
    (node != nodes.top() && !flat(node)).then_some(node)
}

/// How many nodes that hold meshes, and how many above those, are moved by animations that move these meshes no more, as they
/// are skinned: all but those that carry the new skeleton.
pub(super) fn idle(scene: &Scene, holders: &[usize], moved: &HashSet<usize>, carrier: Option<usize>) -> (usize, usize) {
    let nodes = &scene.nodes;
    let mut seen = HashSet::new();
    // Nodes from one up that were not met before.
    let mut climb = |mut node: usize| -> Vec<usize> {
        let mut met = Vec::new();
        while node != nodes.top() && seen.insert(node) {
            met.push(node);
            node = nodes.parent(node);
        }
        met
    };
    carrier.map(&mut climb);
    let own: HashSet<usize> = holders.iter().copied().collect();
    let idle = holders.iter().flat_map(|&holder| climb(holder)).filter(|node| moved.contains(node));
    let (holding, above): (Vec<usize>, Vec<usize>) = idle.partition(|node| own.contains(node));
    (holding.len(), above.len())
}

/// Hangs a node on another, where it stays in its place in the scene.
pub(super) fn hang(draft: &mut Draft, nodes: &Nodes, node: usize, on: usize) {
    let back = nodes.global(on).inverse();
    if back != DAffine3::IDENTITY {
        let [x, y, z] = [back.matrix3.x_axis, back.matrix3.y_axis, back.matrix3.z_axis].map(|axis| axis.extend(0.0));
        let columns = [x, y, z, back.translation.extend(1.0)].map(|column| column.as_vec4().to_array());
        draft.list_mut("nodes")[node]["matrix"] = json!(columns.as_flattened());
    }
    add_child(&mut draft.list_mut("nodes")[on], node);
}

pub(super) fn add_child(node: &mut Value, child: usize) {
    match node.get_mut("children").and_then(Value::as_array_mut) {
        Some(children) => children.push(json!(child)),
        None => node["children"] = json!([child]),
    }
}

fn root(nodes: &Nodes, mut node: usize) -> usize {
    while nodes.parent(node) != nodes.top() {
        node = nodes.parent(node);
    }
    node
}

/// Drops numbers from a list, and the list when it is empty, as the format asks for.
pub(super) fn drop_from(of: &mut Value, key: &str, mut gone: impl FnMut(usize) -> bool) {
    let Some(list) = of.get_mut(key).and_then(Value::as_array_mut) else { return };
    list.retain(|value| !index(value).is_some_and(&mut gone));
    if list.is_empty() {
        remove(of, key);
    }
}

/// Takes JOINTS_n and WEIGHTS_n away from a primitive, and gives it others.
pub(super) fn set_influences(draft: &mut Draft, (mesh, primitive): (usize, usize), new: &[(String, Value)]) {
    let own = &mut draft.list_mut("meshes")[mesh]["primitives"][primitive];
    let Some(attributes) = own.get_mut("attributes").and_then(Value::as_object_mut) else { return };
    attributes.retain(|name, _| !name.starts_with("JOINTS_") && !name.starts_with("WEIGHTS_"));
    attributes.extend(new.iter().cloned());
}
