//! A motion that bends every joint, for a person to see whether a rig works.

use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use super::super::document::Document;
use super::super::nodes::{Nodes, parts};
use super::draft::{Draft, F32, Layout, VEC4, remove};
use crate::Fault;

/// Sine and cosine of half the angle at the end of a swing (25 degrees) and halfway (17.7): as numbers, since the
/// platform's functions differ in their last bit.
const FULL: (f64, f64) = (0.216_439_613_938_102_9, 0.976_296_007_119_933_4);
const HALFWAY: (f64, f64) = (0.153_655_616_863_611_23, 0.988_124_461_495_748_6);
/// From rest to one side and the other: where a swing is, at steady steps.
const SWING: [(f64, (f64, f64)); 9] = [
    (0.0, (0.0, 1.0)),
    (1.0, HALFWAY),
    (1.0, FULL),
    (1.0, HALFWAY),
    (0.0, (0.0, 1.0)),
    (-1.0, HALFWAY),
    (-1.0, FULL),
    (-1.0, HALFWAY),
    (0.0, (0.0, 1.0)),
];
/// Seconds that a swing takes.
const WINDOW: f64 = 1.0;

/// Adds the motion: the joints of all skins, in their order, each a little after the one before.
pub(super) fn add(draft: &mut Draft, document: &Document) -> Result<(), Fault> {
    let nodes = Nodes::new(document)?;
    let mut joints: Vec<usize> = Vec::new();
    let mut is_joint = vec![false; nodes.len()];
    for &joint in document.skins.iter().flat_map(|skin| &skin.joints).filter(|&&j| j < nodes.len()) {
        if !std::mem::replace(&mut is_joint[joint], true) {
            joints.push(joint);
        }
    }
    if joints.is_empty() {
        return Ok(());
    }
    let mut first_child: Vec<Option<usize>> = vec![None; nodes.len() + 1];
    for &node in nodes.order().iter().filter(|&&n| is_joint[n]) {
        first_child[nodes.parent(node)].get_or_insert(node);
    }
    let whole = (2.0 + 0.06 * joints.len() as f64).clamp(2.5, 8.0);
    let apart = (whole - WINDOW) / (joints.len().max(2) - 1) as f64;
    let (mut samplers, mut channels): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
    for (number, &joint) in joints.iter().enumerate() {
        let (scale, rest, place) = parts(&document.nodes[joint]);
        let own = &mut draft.list_mut("nodes")[joint];
        if remove(own, "matrix").is_some() {
            // What moves has no matrix.
            own["translation"] = json!(place.as_vec3().to_array());
            own["rotation"] = json!(rest.as_quat().to_array());
            own["scale"] = json!(scale.as_vec3().to_array());
        }
        let along = first_child[joint].map_or(DVec3::Y, |child| nodes.local(child).translation);
        // Across the bone: about x, or about z for bones along x.
        let axis = if along.x.abs() > 0.8 * along.length() { DVec3::Z } else { DVec3::X };
        let start = apart * number as f64;
        let (mut times, mut turns) = (Vec::new(), Vec::new());
        for (step, (sign, (sin, cos))) in SWING.into_iter().enumerate() {
            times.extend(((start + WINDOW * step as f64 / 8.0) as f32).to_le_bytes());
            let swing = DQuat::from_xyzw(axis.x * sin * sign, axis.y * sin * sign, axis.z * sin * sign, cos);
            let turn = (rest.normalize() * swing).normalize().as_quat();
            turns.extend(turn.to_array().into_iter().flat_map(f32::to_le_bytes));
        }
        let input = draft.accessor(&times, Layout { component: F32, shape: "SCALAR", size: 4 }, None);
        draft.list_mut("accessors")[input]["min"] = json!([start as f32]);
        draft.list_mut("accessors")[input]["max"] = json!([(start + WINDOW) as f32]);
        let output = draft.accessor(&turns, VEC4, None);
        samplers.push(json!({"input": input, "output": output, "interpolation": "LINEAR"}));
        channels.push(json!({"sampler": number, "target": {"node": joint, "path": "rotation"}}));
    }
    draft.push("animations", json!({"name": "riglab preview", "samplers": samplers, "channels": channels}));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn swings_are_turns_of_25_degrees() {
        for (sin, cos) in [FULL, HALFWAY] {
            assert!((sin * sin + cos * cos - 1.0).abs() < 1e-12, "{sin} {cos}");
        }
        assert!((2.0 * FULL.1.acos().to_degrees() - 25.0).abs() < 1e-9);
        assert!((2.0 * HALFWAY.1.acos().to_degrees() - 25.0 * 0.5f64.sqrt()).abs() < 1e-9);
    }
}
