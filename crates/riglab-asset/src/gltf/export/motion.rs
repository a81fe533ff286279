//! A motion of a rig as an animation of its document: a key a frame.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use riglab_core::{Clip, Skeleton};
use serde_json::{Value, json};

use super::super::document::Document;
use super::super::nodes::parts;
use super::draft::{Draft, Layout, VEC3, VEC4, remove};
use super::scene::Scene;
use crate::maps::{FLAT, is_flat};
use crate::{ExportFault, ExportNote, Reading};

/// Turns and scales that differ by less are the same.
const SAME: f64 = 1e-6;

/// A property of a node over time: what to call it, how its keys lie, the keys, and whether they say more than the
/// node does.
type Channel = (&'static str, Layout, Vec<u8>, bool);

/// Adds the clip, whose joints are those of `skeleton`, before all other animations; tells which of it no nodes can show.
pub(super) fn add(
    draft: &mut Draft,
    document: &Document,
    scene: &Scene,
    reading: &Reading,
    skeleton: &Skeleton,
    clip: &Clip,
) -> Result<Option<ExportNote>, ExportFault> {
    let named: HashMap<&str, usize> = skeleton.names().iter().map(String::as_str).zip(0..).collect();
    let mut joint_of: Vec<Option<usize>> = vec![None; scene.nodes.len() + 1];
    for joint in &reading.joints {
        let number = named.get(joint.name.as_str());
        let number = number.ok_or_else(|| ExportFault::OtherMotion(format!("it has no joint `{}`", joint.name)))?;
        joint_of[joint.node] = Some(*number);
    }
    // Parents first, since each stands within the one above.
    let nodes: Vec<usize> = scene.nodes.order().iter().copied().filter(|&n| joint_of[n].is_some()).collect();
    let (Some(&first), true) = (nodes.first(), clip.joints() == skeleton.len()) else {
        let what = format!("{} joints move, {} are in the file", clip.joints(), nodes.len());
        return Err(ExportFault::OtherMotion(what));
    };
    let mut locals: Vec<Vec<DAffine3>> = vec![Vec::with_capacity(clip.frames()); nodes.len()];
    let mut globals: Vec<DAffine3> = (0..=scene.nodes.len()).map(|n| *scene.nodes.global(n)).collect();
    // What stands between joints goes along with the one above.
    let carried: Vec<usize> = scene.nodes.order().iter().copied().filter(|&n| scene.below_joint(n)).collect();
    // Those that are seen where what they hang on is nothing.
    let mut swallowed = vec![false; nodes.len()];
    for frame in 0..clip.frames() {
        let maps = clip.frame(frame);
        for &node in &carried {
            let above = globals[scene.nodes.parent(node)];
            globals[node] = match joint_of[node] {
                Some(joint) => double(&maps[joint]) * scene.rests[node],
                None => above * *scene.nodes.local(node),
            };
        }
        for ((own, swallowed), &node) in locals.iter_mut().zip(&mut swallowed).zip(&nodes) {
            let local = globals[scene.nodes.parent(node)].inverse() * globals[node];
            *swallowed |= !local.is_finite() && !is_flat(&globals[node].matrix3, FLAT);
            own.push(if local.is_finite() { local } else { *scene.nodes.local(node) });
        }
    }

    let input = draft.times(clip.frames(), clip.rate());
    let (mut samplers, mut channels): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
    for (&node, locals) in nodes.iter().zip(&locals) {
        let (scale, rest, place) = parts(&document.nodes[node]);
        for (path, layout, bytes, says) in keys(locals, scale, rest, place) {
            // An animation has a channel.
            let needed = says || (node == first && path == "rotation");
            if !needed {
                continue;
            }
            let own = &mut draft.list_mut("nodes")[node];
            if remove(own, "matrix").is_some() {
                // What moves has no matrix.
                own["translation"] = json!(place.as_vec3().to_array());
                own["rotation"] = json!(rest.as_quat().to_array());
                own["scale"] = json!(scale.as_vec3().to_array());
            }
            let output = draft.accessor(&bytes, layout, None);
            channels.push(json!({"sampler": samplers.len(), "target": {"node": node, "path": path}}));
            samplers.push(json!({"input": input, "output": output, "interpolation": "LINEAR"}));
        }
    }
    draft.push("animations", json!({"name": clip.name(), "samplers": samplers, "channels": channels}));
    // Viewers play the first.
    if let Some(all) = draft.json.get_mut("animations").and_then(Value::as_array_mut) {
        all.rotate_right(1);
    }
    let joints = swallowed.into_iter().filter(|swallowed| *swallowed).count();
    Ok((joints > 0).then(|| ExportNote::MotionSwallowed { motion: clip.name().to_owned(), joints }))
}

/// Makes motions of blend shapes part of the animation before them that is called the same, as programs that play one
/// animation at a time expect; of several called the same each takes one.
pub(super) fn join_weights(draft: &mut Draft) {
    let Some(all) = draft.json.get_mut("animations").and_then(Value::as_array_mut) else { return };
    let list = |of: &Value, name: &str| of[name].as_array().cloned().unwrap_or_default();
    let moves_shapes = |channel: &Value| channel["target"]["path"] == "weights";
    let shapes_only = |of: &Value| list(of, "channels").iter().all(moves_shapes);
    let mut joined: Vec<Value> = Vec::with_capacity(all.len());
    for own in all.drain(..) {
        let alike =
            |known: &&mut Value| known["name"] == own["name"] && !list(known, "channels").iter().any(moves_shapes);
        let Some(body) = joined.iter_mut().find(alike).filter(|_| shapes_only(&own)) else {
            joined.push(own);
            continue;
        };
        let first = list(body, "samplers").len();
        let samplers = [list(body, "samplers"), list(&own, "samplers")].concat();
        let channels = list(&own, "channels").into_iter().map(|mut channel| {
            channel["sampler"] = json!(first as u64 + channel["sampler"].as_u64().unwrap_or(0));
            channel
        });
        body["channels"] = list(body, "channels").into_iter().chain(channels).collect();
        body["samplers"] = json!(samplers);
    }
    *all = joined;
}

/// The channels of a node that goes through some places, and stands elsewhere by itself.
fn keys(locals: &[DAffine3], scale: DVec3, rest: DQuat, place: DVec3) -> [Channel; 3] {
    let mut before = rest.normalize();
    let (mut turns, mut shifts, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    let (mut turned, mut shifted, mut scaled) = (false, false, false);
    let far = SAME * place.length().max(1e-3);
    for local in locals {
        let (own_scale, turn, shift) = local.to_scale_rotation_translation();
        // Of a flat map there is no turn.
        let turn = if turn.is_finite() && turn.length_squared() > 0.5 { turn.normalize() } else { before };
        // The short way from key to key.
        let turn = if turn.dot(before) < 0.0 { -turn } else { turn };
        turned |= turn.dot(rest.normalize()).abs() < 1.0 - 1e-9;
        shifted |= shift.distance(place) > far;
        scaled |= (own_scale - scale).abs().max_element() > 1e3 * SAME * scale.abs().max_element();
        before = turn;
        put(&mut turns, turn.as_quat().normalize().to_array());
        put(&mut shifts, shift.as_vec3().to_array());
        put(&mut scales, own_scale.as_vec3().to_array());
    }
    [("rotation", VEC4, turns, turned), ("translation", VEC3, shifts, shifted), ("scale", VEC3, scales, scaled)]
}

fn put<const N: usize>(bytes: &mut Vec<u8>, values: [f32; N]) {
    values.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
}

fn double(map: &glam::Affine3A) -> DAffine3 {
    let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(|v| v.as_dvec3());
    DAffine3 { matrix3: DMat3::from_cols(x, y, z), translation: map.translation.as_dvec3() }
}
