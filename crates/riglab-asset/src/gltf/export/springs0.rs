//! Springs as VRM 0.x says them: `secondaryAnimation`.
//!
//! All joints below some roots swing alike, each about the first node below it; a leaf about a point that
//! continues the way from its parent. So joints are gathered by how they swing, and a node is added as
//! the first one below a joint whose tail is elsewhere. What cannot be said so: a joint that stands still
//! below one that swings, and capsules, which become spheres in a row.

use std::collections::HashMap;

use glam::Vec3;
use riglab_core::{Collider, JointId, Shape, Spring, SpringJoint, Springs, Swing};
use serde_json::{Value, json};

use super::super::vrm::{LEAF, tail0};
use super::draft::Draft;
use super::springs::Joints;
use super::vrm::unity;
use crate::ExportNote;

/// Spheres that stand for a capsule at most.
const MOST_SPHERES: usize = 16;

/// How far a tail may be from where the format puts it by itself, as a share of its place.
const SAME: f64 = 5e-7;

/// The springs in this form, with a word of what it cannot say.
pub(super) fn write(draft: &mut Draft, springs: &Springs, joints: &Joints<'_>) -> (Value, Option<ExportNote>) {
    let (colliders, numbers, capsules) = colliders(springs, joints);
    let mut groups: Vec<Value> = Vec::new();
    let mut group_of: HashMap<(usize, [u32; 7]), usize> = HashMap::new();
    let mut wanted: Vec<Option<(usize, &SpringJoint)>> = vec![None; joints.skeleton.len()];
    for (number, spring) in springs.springs().iter().enumerate() {
        for own in spring.joints.iter().filter(|own| own.tail.is_some()) {
            wanted[own.joint.index()] = Some((number, own));
        }
    }
    let children = joints.skeleton.children();
    // The group that swings each joint: its own, or that of the joint above.
    let mut owner: Vec<Option<usize>> = vec![None; joints.skeleton.len()];
    let mut dragged = 0;
    for joint in joints.skeleton.ids() {
        let above = joints.skeleton.parent(joint).and_then(|parent| owner[parent.index()]);
        let Some((number, own)) = wanted[joint.index()] else {
            owner[joint.index()] = above;
            dragged += usize::from(above.is_some());
            continue;
        };
        let group = *group_of.entry((number, key(&own.swing))).or_insert_with(|| {
            let spring = &springs.springs()[number];
            let stops: Vec<usize> = spring.groups.iter().flat_map(|&g| numbers[g].iter().copied()).collect();
            groups.push(group(spring, own, joints, stops));
            groups.len() - 1
        });
        if above != Some(group)
            && let Some(roots) = groups[group]["bones"].as_array_mut()
        {
            roots.push(json!(joints.node(joint)));
        }
        owner[joint.index()] = Some(group);
        if let Some(tail) = own.tail
            && !by_itself(joints, &children, own, tail)
        {
            let end = joints.add_tail(draft, joint, tail);
            draft.add_child(joints.node(joint), end, true);
        }
    }
    let lost = (dragged > 0 || capsules > 0).then_some(ExportNote::SpringsChanged { joints: dragged, capsules });
    (json!({"boneGroups": groups, "colliderGroups": colliders}), lost)
}

/// What makes two swings one.
fn key(swing: &Swing) -> [u32; 7] {
    let Swing { stiffness, drag, gravity_power, gravity_direction: [x, y, z], hit_radius } = *swing;
    [stiffness, drag, gravity_power, x, y, z, hit_radius].map(f32::to_bits)
}

fn group(spring: &Spring, own: &SpringJoint, joints: &Joints<'_>, stops: Vec<usize>) -> Value {
    let Swing { stiffness, drag, gravity_power, gravity_direction, hit_radius } = own.swing;
    json!({
        "comment": spring.name,
        // The format's own spelling.
        "stiffiness": stiffness,
        "dragForce": drag,
        "gravityPower": gravity_power,
        "gravityDir": unity(gravity_direction.map(f64::from)),
        "hitRadius": hit_radius,
        "center": spring.center.map_or(json!(-1), |center| json!(joints.node(center))),
        "bones": [],
        "colliderGroups": stops,
    })
}

/// Whether the tail of a joint is where the format puts it without more: at the first child, or behind a leaf.
fn by_itself(joints: &Joints<'_>, children: &[Vec<JointId>], own: &SpringJoint, tail: [f32; 3]) -> bool {
    let place = |point: [f32; 3]| Vec3::from(point).as_dvec3();
    let head = |joint| place(joints.skeleton.head(joint));
    let of_leaf = || {
        let way = head(own.joint) - head(joints.skeleton.parent(own.joint)?);
        Some(head(own.joint) + LEAF * way.try_normalize()?)
    };
    let point = match (joints.scene, children[own.joint.index()].first()) {
        // The first child may be a node that is no joint.
        (Some(scene), _) => tail0(&scene.nodes, &scene.rests, joints.node(own.joint)),
        (None, Some(&child)) => Some(head(child)),
        (None, None) => of_leaf(),
    };
    let size = head(own.joint).length() + place(tail).distance(head(own.joint));
    point.is_some_and(|point| point.distance(place(tail)) <= SAME * size)
}

/// The colliders, a group for each joint of each group; which these are; and how many were capsules.
fn colliders(springs: &Springs, joints: &Joints<'_>) -> (Vec<Value>, Vec<Vec<usize>>, usize) {
    let mut written: Vec<Value> = Vec::new();
    let mut numbers = Vec::new();
    for group in springs.groups() {
        let mut own: Vec<usize> = Vec::new();
        let mut at_joint: HashMap<usize, usize> = HashMap::new();
        for collider in group.iter().map(|&c| &springs.colliders()[c]) {
            let number = *at_joint.entry(collider.joint.index()).or_insert_with(|| {
                written.push(json!({"node": joints.node(collider.joint), "colliders": []}));
                own.push(written.len() - 1);
                written.len() - 1
            });
            if let Some(list) = written[number]["colliders"].as_array_mut() {
                list.extend(spheres(collider, joints));
            }
        }
        numbers.push(own);
    }
    let capsule = |c: &&Collider| matches!(c.shape, Shape::Capsule { .. });
    (written, numbers, springs.colliders().iter().filter(capsule).count())
}

fn spheres(collider: &Collider, joints: &Joints<'_>) -> Vec<Value> {
    let sphere = |center: Vec3, radius: f32| {
        let offset = unity(joints.within(collider.joint, center.to_array()));
        json!({"offset": offset, "radius": joints.length_within(collider.joint, radius)})
    };
    match collider.shape {
        Shape::Sphere { center, radius } => vec![sphere(center.into(), radius)],
        Shape::Capsule { from, to, radius } => {
            let (from, to) = (Vec3::from(from), Vec3::from(to));
            // A radius apart, so that they overlap well.
            let steps = (from.distance(to) / radius).ceil().clamp(1.0, (MOST_SPHERES - 1) as f32) as usize;
            // Nothing over nothing is no number.
            let steps = steps.max(1);
            (0..=steps).map(|k| sphere(from.lerp(to, k as f32 / steps as f32), radius)).collect()
        }
    }
}
