//! A motion of a rig as an animation of its document: a key a frame.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use riglab_core::{Clip, Skeleton};
use serde_json::{Value, json};

use super::super::document::Document;
use super::super::nodes::parts;
use super::draft::{Draft, Layout, VEC3, VEC4, remove};
use super::scene::Scene;
use super::sheared::{Drift, nearest};
use crate::maps::{FLAT, is_flat};
use crate::{ExportFault, ExportNote, Reading};

/// Turns and scales that differ by less are the same.
const SAME: f64 = 1e-6;

/// What hangs on a joint that shrinks one direction to less than this share of another cannot be set right against it.
const NEARLY_FLAT: f64 = 1e-4;

/// A property of a node over time: what to call it, how its keys lie, the keys, and whether they say more than the
/// node does.
type Channel = (&'static str, Layout, Vec<u8>, bool);

/// Scale, turn and place of a node below the one above it.
type Local = (DVec3, DQuat, DVec3);

/// Adds the clip, whose joints are those of `skeleton`, before all other animations; tells which of it no nodes can show.
pub(super) fn add(
    draft: &mut Draft,
    document: &Document,
    scene: &Scene,
    reading: &Reading,
    skeleton: &Skeleton,
    clip: &Clip,
) -> Result<Vec<ExportNote>, ExportFault> {
    let named: HashMap<&str, usize> = skeleton.names().iter().map(String::as_str).zip(0..).collect();
    let number = |name: &str| {
        let number = named.get(name).copied();
        number.ok_or_else(|| ExportFault::OtherMotion(format!("it has no joint `{name}`")))
    };
    let numbers = reading.joints.iter().map(|joint| number(&joint.name)).collect::<Result<Vec<_>, _>>()?;
    let mut joint_of: Vec<Option<usize>> = vec![None; scene.nodes.len() + 1];
    reading.joints.iter().zip(&numbers).for_each(|(joint, number)| joint_of[joint.node] = Some(*number));
    // Parents first, since each stands within the one above.
    let nodes: Vec<usize> = scene.nodes.order().iter().copied().filter(|&n| joint_of[n].is_some()).collect();
    let (Some(&first), true) = (nodes.first(), clip.joints() == skeleton.len()) else {
        let what = format!("{} joints move, {} are in the file", clip.joints(), nodes.len());
        return Err(ExportFault::OtherMotion(what));
    };
    let mut locals: Vec<Vec<Local>> = vec![Vec::with_capacity(clip.frames()); nodes.len()];
    let mut globals: Vec<DAffine3> = (0..=scene.nodes.len()).map(|n| *scene.nodes.global(n)).collect();
    // What stands between joints goes along with the one above.
    let carried: Vec<usize> = scene.nodes.order().iter().copied().filter(|&n| scene.below_joint(n)).collect();
    let track_of: HashMap<usize, usize> = nodes.iter().copied().zip(0..).collect();
    // Those that are seen where what they hang on is nothing.
    let mut swallowed = vec![false; nodes.len()];
    let mut drift = Drift::new(reading, &numbers, clip.joints());
    let mut off = vec![DAffine3::ZERO; clip.joints()];
    for frame in 0..clip.frames() {
        let maps = clip.frame(frame);
        for &node in &carried {
            // Where its node takes it, not where it should be, so that no error adds to the next.
            let above = globals[scene.nodes.parent(node)];
            let (Some(joint), Some(&track)) = (joint_of[node], track_of.get(&node)) else {
                globals[node] = above * *scene.nodes.local(node);
                continue;
            };
            let map = double(&maps[joint]);
            let goal = map * scene.rests[node];
            let local = above.inverse() * goal;
            off[joint] = DAffine3::ZERO;
            if !local.is_finite() || is_flat(&above.matrix3, NEARLY_FLAT) {
                swallowed[track] |= !is_flat(&goal.matrix3, FLAT);
                let (scale, turn, place) = parts(&document.nodes[node]);
                locals[track].push((scale, turn, place));
                globals[node] = above * *scene.nodes.local(node);
                continue;
            }
            let (scale, turn, place) = nearest(&local);
            locals[track].push((scale, turn, place));
            let stands = above * DAffine3::from_scale_rotation_translation(scale, turn, place);
            // Of a flat map there is no turn.
            globals[node] = if stands.is_finite() { stands } else { goal };
            let made = globals[node] * scene.rests[node].inverse();
            if made.is_finite() {
                let (matrix3, translation) = (made.matrix3 - map.matrix3, made.translation - map.translation);
                off[joint] = DAffine3 { matrix3, translation };
            }
        }
        drift.frame(&off);
    }

    let input = draft.times(clip.frames(), clip.rate());
    let (mut samplers, mut channels): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
    for (&node, locals) in nodes.iter().zip(&locals) {
        let (scale, rest, place) = parts(&document.nodes[node]);
        for (path, layout, bytes, says) in keys(locals, (scale, rest, place)) {
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
    let motion = || clip.name().to_owned();
    let joints = swallowed.into_iter().filter(|swallowed| *swallowed).count();
    let swallowed = (joints > 0).then(|| ExportNote::MotionSwallowed { motion: motion(), joints, others: 0 });
    let sheared = drift.told().map(|share| ExportNote::MotionSheared { motion: motion(), share, others: 0 });
    Ok(swallowed.into_iter().chain(sheared).collect())
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
fn keys(locals: &[Local], (scale, rest, place): Local) -> [Channel; 3] {
    let mut before = rest.normalize();
    let (mut turns, mut shifts, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    let (mut turned, mut shifted, mut scaled) = (false, false, false);
    let far = SAME * place.length().max(1e-3);
    for &(own_scale, turn, shift) in locals {
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
