//! Springs and colliders of a rig, written as VRM says them.
//!
//! A VRM 0.x keeps its own form ([`super::springs0`]); everything else gets `VRMC_springBone` of VRM 1.0,
//! which needs no humanoid beside it. There a spring is a chain: what branches becomes several springs of
//! one name. A chain ends with a node that marks the tail of the joint before; where no joint stands in
//! that place, a node is added.

use std::collections::HashMap;

use glam::{DAffine3, DVec3, Vec3};
use riglab_core::{JointId, Shape, Skeleton, Spring, SpringJoint, Springs, Swing};
use serde_json::{Value, json};

use super::draft::Draft;
use super::scene::Scene;
use super::springs0;
use super::vrm::{SPRINGS, VRM1};
use crate::ExportNote;

/// Joints in one place that are looked at for a tail.
const MOST_ALIKE: usize = 64;

/// The joints of a rig in a document.
pub(super) struct Joints<'a> {
    pub(super) skeleton: &'a Skeleton,
    /// The node of each.
    pub(super) nodes: Vec<usize>,
    /// From the space of each node to the scene, at rest.
    pub(super) frames: Vec<DAffine3>,
    /// What the nodes are of, where they were there before and others may hang on them.
    pub(super) scene: Option<&'a Scene>,
}

impl Joints<'_> {
    pub(super) fn node(&self, joint: JointId) -> usize {
        self.nodes[joint.index()]
    }

    /// A point at rest, in the space of a joint's node.
    pub(super) fn within(&self, joint: JointId, point: [f32; 3]) -> [f64; 3] {
        let local = self.frames[joint.index()].inverse().transform_point3(Vec3::from(point).as_dvec3());
        // Without turns and scale the difference needs no inverse, and -0 says nothing.
        let exact = Vec3::from(point).as_dvec3() - self.frames[joint.index()].translation;
        let plain = self.frames[joint.index()].matrix3 == glam::DMat3::IDENTITY;
        let local = (if plain { exact } else { local }) + DVec3::ZERO;
        if local.is_finite() { local.to_array() } else { [0.0; 3] }
    }

    /// A length at rest, in the space of a joint's node.
    pub(super) fn length_within(&self, joint: JointId, length: f32) -> f64 {
        let scale = self.frames[joint.index()].matrix3.determinant().abs().cbrt();
        let own = f64::from(length) / scale;
        if own.is_finite() { own } else { 0.0 }
    }

    /// Adds a node where the tail of a joint is.
    pub(super) fn add_tail(&self, draft: &mut Draft, joint: JointId, tail: [f32; 3]) -> usize {
        let name = format!("{}_tail", self.skeleton.name(joint));
        draft.push("nodes", json!({"name": name, "translation": self.within(joint, tail)}))
    }
}

/// Writes the springs and colliders of a rig in the words of the document. A rig without any leaves those
/// that the document has.
pub(super) fn set(draft: &mut Draft, springs: &Springs, joints: &Joints<'_>, notes: &mut Vec<ExportNote>) {
    if springs.is_empty() {
        return;
    }
    let has = |name: &str| draft.json["extensions"][name].is_object();
    if has("VRM") && !has(VRM1) && !has(SPRINGS) {
        let (written, lost) = springs0::write(draft, springs, joints);
        draft.json["extensions"]["VRM"]["secondaryAnimation"] = written;
        notes.extend(lost);
    } else {
        let written = write(draft, springs, joints);
        draft.extend_with(SPRINGS, written);
    }
}

/// `VRMC_springBone`.
fn write(draft: &mut Draft, springs: &Springs, joints: &Joints<'_>) -> Value {
    let colliders: Vec<Value> = springs
        .colliders()
        .iter()
        .map(|collider| {
            let at = |point| json!(joints.within(collider.joint, point));
            let far = |radius| json!(joints.length_within(collider.joint, radius));
            let shape = match collider.shape {
                Shape::Sphere { center, radius } => json!({"sphere": {"offset": at(center), "radius": far(radius)}}),
                Shape::Capsule { from, to, radius } => {
                    json!({"capsule": {"offset": at(from), "tail": at(to), "radius": far(radius)}})
                }
            };
            json!({"node": joints.node(collider.joint), "shape": shape})
        })
        .collect();
    // Lists in this format are not empty: a group without colliders stops nothing, and goes.
    let mut groups: Vec<Value> = Vec::new();
    let mut number_of: Vec<Option<usize>> = Vec::new();
    for group in springs.groups() {
        number_of.push((!group.is_empty()).then_some(groups.len()));
        if !group.is_empty() {
            groups.push(json!({"colliders": group}));
        }
    }
    let next = Chains::new(joints.skeleton, springs.springs()).next;
    let mut all: Vec<Value> = Vec::new();
    for spring in springs.springs() {
        let stops: Vec<usize> = spring.groups.iter().filter_map(|&g| number_of[g]).collect();
        for chain in chains(spring, &next) {
            let mut entries: Vec<Value> = chain.iter().map(|own| entry(own, joints)).collect();
            let last = chain[chain.len() - 1];
            if let Some(tail) = last.tail {
                let end = match next[last.joint.index()] {
                    // A joint that does not swing marks the tail as well as a node would.
                    Some(end) => joints.node(end),
                    None => {
                        let end = joints.add_tail(draft, last.joint, tail);
                        draft.add_child(joints.node(last.joint), end, false);
                        end
                    }
                };
                entries.push(json!({"node": end}));
            }
            let mut written = json!({"joints": entries});
            if !spring.name.is_empty() {
                written["name"] = json!(spring.name);
            }
            if !stops.is_empty() {
                written["colliderGroups"] = json!(stops);
            }
            if let Some(center) = spring.center {
                written["center"] = json!(joints.node(center));
            }
            all.push(written);
        }
    }
    let mut out = json!({"specVersion": "1.0"});
    for (key, list) in [("colliders", colliders), ("colliderGroups", groups), ("springs", all)] {
        if !list.is_empty() {
            out[key] = list.into();
        }
    }
    out
}

fn entry(own: &SpringJoint, joints: &Joints<'_>) -> Value {
    let Swing { stiffness, drag, gravity_power, gravity_direction, hit_radius } = own.swing;
    let mut entry = json!({
        "node": joints.node(own.joint),
        "stiffness": stiffness,
        "dragForce": drag,
        "gravityPower": gravity_power,
        "hitRadius": hit_radius,
    });
    if gravity_direction == [0.0; 3] {
        // Nowhere is no direction here.
        entry["gravityPower"] = json!(0.0);
    } else {
        entry["gravityDir"] = json!(gravity_direction);
    }
    entry
}

/// Which joint stands where the tail of another is.
struct Chains {
    /// By joint; each at most once. Joints of other springs are none.
    next: Vec<Option<JointId>>,
}

impl Chains {
    fn new(skeleton: &Skeleton, springs: &[Spring]) -> Self {
        let place = |point: [f32; 3]| point.map(|x| (x + 0.0).to_bits());
        let mut at: HashMap<[u32; 3], Vec<JointId>> = HashMap::new();
        skeleton.ids().for_each(|joint| at.entry(place(skeleton.head(joint))).or_default().push(joint));
        let mut spring_of = vec![None; skeleton.len()];
        for (number, spring) in springs.iter().enumerate() {
            spring.joints.iter().for_each(|own| spring_of[own.joint.index()] = Some(number));
        }
        let below = below(skeleton);
        let mut next = vec![None; skeleton.len()];
        let mut taken = vec![false; skeleton.len()];
        for (number, spring) in springs.iter().enumerate() {
            for own in &spring.joints {
                let alike = own.tail.and_then(|tail| at.get(&place(tail))).map_or(&[][..], Vec::as_slice);
                let free = alike.iter().copied().take(MOST_ALIKE).filter(|&k| below(k, own.joint) && !taken[k.index()]);
                let of = |owner: Option<usize>| free.clone().find(|k| spring_of[k.index()] == owner);
                if let Some(found) = of(Some(number)).or_else(|| of(None)) {
                    next[own.joint.index()] = Some(found);
                    taken[found.index()] = true;
                }
            }
        }
        Self { next }
    }
}

/// Whether a joint lies below another.
fn below(skeleton: &Skeleton) -> impl Fn(JointId, JointId) -> bool + use<> {
    // Depth first, a joint and all below it are an unbroken run.
    let mut size = vec![1; skeleton.len()];
    for (joint, parent) in skeleton.parents().iter().enumerate().rev() {
        if let Some(parent) = parent {
            size[parent.index()] += size[joint];
        }
    }
    let (mut start, mut free) = (vec![0; skeleton.len()], vec![1; skeleton.len()]);
    for (joint, parent) in skeleton.parents().iter().enumerate() {
        if let Some(parent) = parent.map(JointId::index) {
            start[joint] = free[parent];
            free[parent] += size[joint];
            free[joint] = start[joint] + 1;
        }
    }
    move |joint, above| {
        let [joint, above] = [joint, above].map(JointId::index);
        start[above] < start[joint] && start[joint] < start[above] + size[above]
    }
}

/// The joints of a spring, each with those that follow it.
fn chains<'s>(spring: &'s Spring, next: &[Option<JointId>]) -> Vec<Vec<&'s SpringJoint>> {
    let own: HashMap<JointId, &SpringJoint> = spring.joints.iter().map(|own| (own.joint, own)).collect();
    let follow = |own_joint: &SpringJoint| next[own_joint.joint.index()].and_then(|n| own.get(&n).copied());
    let followers: std::collections::HashSet<JointId> =
        spring.joints.iter().filter_map(follow).map(|f| f.joint).collect();
    let starts = spring.joints.iter().filter(|own| !followers.contains(&own.joint));
    starts.map(|start| std::iter::successors(Some(start), |own| follow(own)).collect()).collect()
}
