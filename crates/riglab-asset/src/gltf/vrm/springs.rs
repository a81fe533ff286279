//! Spring bones: `VRMC_springBone` of VRM 1.0 and `secondaryAnimation` of VRM 0.x.

use std::collections::HashSet;

use glam::{DAffine3, DVec3};
use riglab_core::{Collider, JointId, Shape, Spring, SpringJoint, Springs, Swing, Vec3};
use serde_json::Value;

use super::{Dropped, Scene, shown};
use crate::gltf::nodes::Nodes;

/// How far the tail of a leaf stands from its head in VRM 0.x, in metres.
pub(in crate::gltf) const LEAF: f64 = 0.07;

/// What VRM 0.x takes for absent values.
const SWING0: Swing =
    Swing { stiffness: 1.0, drag: 0.4, gravity_power: 0.0, gravity_direction: [0.0, -1.0, 0.0], hit_radius: 0.02 };

impl Scene<'_> {
    /// VRM 1.0: chains of nodes, each but the last with a tail at the next; colliders in groups.
    pub(super) fn springs1(&self, extension: &Value, dropped: &mut Dropped) -> Springs {
        let mut colliders = Vec::new();
        // Where each collider of the file went.
        let mut kept: Vec<Option<usize>> = Vec::new();
        for (number, entry) in list(&extension["colliders"], "colliders", dropped).iter().enumerate() {
            let collider = self.collider1(entry);
            kept.push(collider.map(|_| colliders.len()));
            match collider {
                Some(collider) => colliders.push(collider),
                None => dropped.add(format!("collider {number} has no shape, or hangs on no joint of a skin")),
            }
        }
        let mut groups = Vec::new();
        for (number, group) in list(&extension["colliderGroups"], "colliderGroups", dropped).iter().enumerate() {
            let mut group_of = Vec::new();
            for entry in list(&group["colliders"], "colliders", dropped) {
                match index(entry, kept.len()) {
                    Some(collider) => group_of.extend(kept[collider]),
                    None => dropped.add(format!("collider group {number} names no collider ({})", shown(entry))),
                }
            }
            group_of.sort_unstable();
            group_of.dedup();
            groups.push(group_of);
        }
        let (mut springs, mut taken) = (Vec::new(), HashSet::new());
        for (number, entry) in list(&extension["springs"], "springs", dropped).iter().enumerate() {
            let joints = self.chain1(number, &entry["joints"], &mut taken, dropped);
            if joints.is_empty() {
                dropped.add(format!("spring {number} has no joints"));
                continue;
            }
            springs.push(self.spring(number, entry, "name", joints, groups.len(), dropped));
        }
        // What is unsound was left out above; should anything remain, no spring is better than no rig.
        Springs::new(springs, colliders, groups).unwrap_or_default()
    }

    /// The joints of a chain up to the first that is broken.
    fn chain1(
        &self,
        spring: usize,
        entries: &Value,
        taken: &mut HashSet<JointId>,
        dropped: &mut Dropped,
    ) -> Vec<SpringJoint> {
        let mut nodes: Vec<(usize, &Value)> = Vec::new();
        for entry in list(entries, "joints", dropped) {
            let Some(node) = self.node(&entry["node"]) else {
                dropped.add(format!("spring {spring} names no node ({})", shown(&entry["node"])));
                break;
            };
            if nodes.last().is_some_and(|&(above, _)| !self.nodes.is_below(node, above)) {
                dropped.add(format!("spring {spring}: node {node} does not lie below the joint before it"));
                break;
            }
            nodes.push((node, entry));
        }
        let mut joints = Vec::new();
        for (at, &(node, entry)) in nodes.iter().enumerate() {
            let Some(joint) = self.joint(node) else { continue };
            if !taken.insert(joint) {
                // Chains that branch share the joint where they part; the first keeps it.
                continue;
            }
            let tail = nodes.get(at + 1).and_then(|&(next, _)| self.point(next));
            let numbers = ["stiffness", "dragForce", "gravityPower", "hitRadius"].map(|key| float(&entry[key]));
            let direction = triple(&entry["gravityDir"]);
            let swing = self.swing(spring, Swing::default(), numbers, direction, dropped);
            joints.push(SpringJoint { joint, tail, swing });
        }
        joints
    }

    fn collider1(&self, entry: &Value) -> Option<Collider> {
        let node = self.node(&entry["node"])?;
        let (sphere, capsule) = (&entry["shape"]["sphere"], &entry["shape"]["capsule"]);
        let own = if sphere.is_object() { sphere } else { capsule };
        let point = |key: &str| triple(&own[key]).unwrap_or_default();
        let (center, radius) = self.ball(node, point("offset"), float(&own["radius"]).unwrap_or(0.0))?;
        let shape = match (sphere.is_object(), capsule.is_object()) {
            (true, _) => Shape::Sphere { center, radius },
            (false, true) => Shape::Capsule { from: center, to: self.ball(node, point("tail"), 0.0)?.0, radius },
            (false, false) => return None,
        };
        Some(Collider { joint: self.above[node]?, shape })
    }

    /// VRM 0.x: all nodes below some roots swing alike, each about its first child; leaves about a
    /// point that continues the way from their parent. Vectors have the z axis of Unity, against
    /// that of glTF.
    pub(super) fn springs0(&self, extension: &Value, dropped: &mut Dropped) -> Springs {
        if extension.is_null() {
            return Springs::default();
        }
        if !extension.is_object() {
            dropped.wrong_type("secondaryAnimation", extension);
            return Springs::default();
        }
        let (mut colliders, mut groups) = (Vec::new(), Vec::new());
        for (number, group) in list(&extension["colliderGroups"], "colliderGroups", dropped).iter().enumerate() {
            let before = colliders.len();
            for entry in list(&group["colliders"], "colliders", dropped) {
                match self.collider0(&group["node"], entry) {
                    Some(collider) => colliders.push(collider),
                    None => dropped
                        .add(format!("collider group {number} has a collider without radius, or hangs on no joint")),
                }
            }
            groups.push((before..colliders.len()).collect::<Vec<_>>());
        }
        let entries = list(&extension["boneGroups"], "boneGroups", dropped);
        let mut springs = Vec::new();
        for (number, (entry, nodes)) in entries.iter().zip(self.groups0(entries, dropped)).enumerate() {
            // A group without bones is what Unity's exporter writes where there is nothing to swing.
            if nodes.is_empty() {
                continue;
            }
            let numbers = ["stiffiness", "dragForce", "gravityPower", "hitRadius"].map(|key| float(&entry[key]));
            let direction = entry["gravityDir"].is_object().then(|| unity(&entry["gravityDir"]));
            let swing = self.swing(number, SWING0, numbers, direction, dropped);
            let joint = |&node: &usize| Some(SpringJoint { joint: self.joint(node)?, tail: self.tail0(node), swing });
            let joints = nodes.iter().filter_map(joint).collect();
            springs.push(self.spring(number, entry, "comment", joints, groups.len(), dropped));
        }
        Springs::new(springs, colliders, groups).unwrap_or_default()
    }

    /// The nodes of each group that are joints, parents first: those at or below its roots, unless
    /// the root of another lies between.
    fn groups0(&self, entries: &[Value], dropped: &mut Dropped) -> Vec<Vec<usize>> {
        let mut owner = vec![None; self.nodes.len() + 1];
        for (group, entry) in entries.iter().enumerate() {
            for bone in list(&entry["bones"], "bones", dropped) {
                match self.node(bone) {
                    Some(node) => drop(owner[node].get_or_insert(group)),
                    None => dropped.add(format!("spring {group} names no node ({})", shown(bone))),
                }
            }
        }
        let mut joints = vec![Vec::new(); entries.len()];
        for &node in self.nodes.order() {
            owner[node] = owner[node].or(owner[self.nodes.parent(node)]);
            if let Some(group) = owner[node].filter(|_| self.joint(node).is_some()) {
                joints[group].push(node);
            }
        }
        joints
    }

    fn tail0(&self, node: usize) -> Option<Vec3> {
        finite(tail0(self.nodes, &self.rests, node)?)
    }

    fn collider0(&self, node: &Value, entry: &Value) -> Option<Collider> {
        let node = self.node(node)?;
        let (center, radius) = self.ball(node, unity(&entry["offset"]), float(&entry["radius"])?)?;
        Some(Collider { joint: self.above[node]?, shape: Shape::Sphere { center, radius } })
    }

    /// A spring of sound joints in a file with so many groups of colliders.
    fn spring(
        &self,
        number: usize,
        entry: &Value,
        name: &str,
        joints: Vec<SpringJoint>,
        count: usize,
        dropped: &mut Dropped,
    ) -> Spring {
        let mut groups = Vec::new();
        for group in list(&entry["colliderGroups"], "colliderGroups", dropped) {
            match index(group, count) {
                Some(group) => groups.push(group),
                None => dropped.add(format!("spring {number} names no collider group ({})", shown(group))),
            }
        }
        groups.sort_unstable();
        groups.dedup();
        let center = self.node(&entry["center"]).and_then(|node| self.above[node]);
        Spring { name: entry[name].as_str().unwrap_or_default().into(), joints, groups, center }
    }

    /// Stiffness, drag, power and radius where given; what is out of range is brought into it.
    fn swing(
        &self,
        spring: usize,
        default: Swing,
        [stiffness, drag, power, radius]: [Option<f64>; 4],
        direction: Option<[f64; 3]>,
        dropped: &mut Dropped,
    ) -> Swing {
        let mut within = |value: Option<f64>, default: f32, most: f32, what: &str| {
            let value = value.map_or(default, |v| v as f32);
            if !(0.0..=most).contains(&value) {
                dropped.add(format!("spring {spring} has a {what} of {value}"));
            }
            value.clamp(0.0, most)
        };
        Swing {
            stiffness: within(stiffness, default.stiffness, f32::MAX, "stiffness"),
            drag: within(drag, default.drag, 1.0, "drag"),
            gravity_power: power.map_or(default.gravity_power, |p| p.clamp(-1e6, 1e6) as f32),
            gravity_direction: direction
                .and_then(|d| DVec3::from(d).try_normalize())
                .map_or(default.gravity_direction, |d| d.as_vec3().into()),
            // As three-vrm has it, and files of scaled nodes: in units of the scene. UniVRM scales it by the node.
            hit_radius: within(radius, default.hit_radius, f32::MAX, "hit radius"),
        }
    }

    /// Where a node stands at rest.
    fn point(&self, node: usize) -> Option<Vec3> {
        finite(self.rests[node].translation)
    }

    /// A ball in the space of a node, at rest.
    fn ball(&self, node: usize, offset: [f64; 3], radius: f64) -> Option<(Vec3, f32)> {
        let rest = self.rests[node];
        let radius = (radius * rest.matrix3.determinant().abs().cbrt()) as f32;
        let center = finite(rest.transform_point3(offset.into()))?;
        (radius.is_finite() && radius >= 0.0).then_some((center, radius))
    }
}

/// Where VRM 0.x takes the tail of a node to be: at the first node below it, or behind a leaf.
pub(in crate::gltf) fn tail0(nodes: &Nodes, rests: &[DAffine3], node: usize) -> Option<DVec3> {
    if let [_, child, ..] = nodes.subtree(node) {
        return Some(rests[*child].translation);
    }
    let [own, above] = [node, nodes.parent(node)].map(|n| rests[n].translation);
    Some(own + LEAF * (own - above).try_normalize()?)
}

fn finite(point: DVec3) -> Option<Vec3> {
    let point = point.as_vec3();
    point.is_finite().then(|| point.into())
}

/// The entries of a list; what is no list is told and has none.
fn list<'a>(value: &'a Value, what: &str, dropped: &mut Dropped) -> &'a [Value] {
    match value.as_array() {
        Some(list) => list,
        None => {
            dropped.wrong_type(what, value);
            &[]
        }
    }
}

fn index(value: &Value, count: usize) -> Option<usize> {
    value.as_u64().and_then(|n| usize::try_from(n).ok()).filter(|n| *n < count)
}

fn float(value: &Value) -> Option<f64> {
    value.as_f64().filter(|x| x.is_finite())
}

fn triple(value: &Value) -> Option<[f64; 3]> {
    let [x, y, z] = value.as_array()?.as_slice() else { return None };
    Some([float(x)?, float(y)?, float(z)?])
}

/// A vector by names, z turned about.
fn unity(value: &Value) -> [f64; 3] {
    let [x, y, z] = ["x", "y", "z"].map(|key| float(&value[key]).unwrap_or(0.0));
    [x, y, 0.0 - z]
}
