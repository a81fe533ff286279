//! What VRM files say of a body: which joints are human bones, what swings, and what stops it.
//!
//! VRM in the wild is loose in its types and references: what is broken is left out, one by one, and
//! told. References to nodes that are no joints of a skin have no place in a rig: a human bone or a
//! swinging node of that kind is left out, the tail of a spring stays as a point.
//!
//! Files that are no VRM may tell human bones by the `extras` of nodes, as [`crate::export`] writes them.

mod springs;

use glam::DAffine3;
use riglab_core::{HumanBone, Humanoid, JointId};
use serde_json::Value;

use super::document::Document;
use super::nodes::Nodes;
use super::placing;
use super::skins::Skins;
use crate::{Body, Warning};
pub(super) use springs::{LEAF, tail0};

/// The member of a node's `extras` that tells which human bone it is, in files that are no VRM.
pub(super) const BONE_EXTRA: &str = "riglabHumanBone";

/// The spelling of bones in VRM 0.x where VRM 1.0 has another: thumbs count from the palm there.
const THUMBS: [(&str, &str); 4] = [
    ("leftThumbProximal", "leftThumbMetacarpal"),
    ("leftThumbIntermediate", "leftThumbProximal"),
    ("rightThumbProximal", "rightThumbMetacarpal"),
    ("rightThumbIntermediate", "rightThumbProximal"),
];

/// What is needed to follow references.
struct Scene<'a> {
    nodes: &'a Nodes,
    skins: &'a Skins,
    /// From each node to the scene at rest.
    rests: Vec<DAffine3>,
    /// The nearest joint at or above each node.
    above: Vec<Option<JointId>>,
}

/// Whether a file says that it is a VRM, of either version.
pub(super) fn is_one(document: &Document) -> bool {
    ["VRMC_vrm", "VRM"].iter().any(|name| document.extensions[name].is_object())
}

/// Whether a model of the file faces -z: VRM 0.x says so, VRM 1.0 that it faces +z, as glTF does.
pub(super) fn faces_back(document: &Document) -> bool {
    document.extensions["VRMC_vrm"].is_null() && !document.extensions["VRM"].is_null()
}

/// The body of a VRM file, by joints of the reading; empty for other files.
pub(super) fn read(document: &Document, file: &placing::Scene<'_, '_>, warnings: &mut Vec<Warning>) -> Body {
    let &placing::Scene { nodes, skins, binds, .. } = file;
    let [one, springs, zero] = ["VRMC_vrm", "VRMC_springBone", "VRM"].map(|name| &document.extensions[name]);
    let extras = |node: usize| &document.nodes[node].extras[BONE_EXTRA];
    let bare = [one, zero].iter().all(|e| e.is_null());
    if bare && springs.is_null() && (0..nodes.len()).all(|node| extras(node).is_null()) {
        return Body::default();
    }
    let mut above = vec![None; nodes.len() + 1];
    for &node in nodes.order() {
        above[node] = skins.joint_of_node(node).map(JointId).or(above[nodes.parent(node)]);
    }
    let scene = Scene { nodes, skins, rests: binds.rests(nodes), above };
    let (mut human, mut spring) = (Dropped::default(), Dropped::default());
    let humanoid = match (one.is_null(), zero.is_null()) {
        (false, _) => scene.humanoid1(one, &mut human),
        (true, false) => scene.humanoid0(zero, &mut human),
        (true, true) => scene.humanoid_of_extras(extras, &mut human),
    };
    let springs = match springs.is_null() && one.is_null() {
        false => scene.springs1(springs, &mut spring),
        true => scene.springs0(&zero["secondaryAnimation"], &mut spring),
    };
    if humanoid.is_empty() && human.elsewhere > 0 {
        human.add(format!("none of its {} bones is a joint of a skin", human.elsewhere));
    }
    warnings.extend(human.warning("humanoid"));
    warnings.extend(spring.warning("springs"));
    Body { vrm: !bare, humanoid, springs }
}

impl Scene<'_> {
    fn humanoid1(&self, extension: &Value, dropped: &mut Dropped) -> Humanoid {
        let mut humanoid = Humanoid::default();
        let Some(bones) = bones(extension, Value::as_object, dropped) else { return humanoid };
        for (name, entry) in bones {
            self.human_bone(name, name, &entry["node"], &mut humanoid, dropped);
        }
        humanoid
    }

    fn humanoid0(&self, extension: &Value, dropped: &mut Dropped) -> Humanoid {
        let mut humanoid = Humanoid::default();
        let Some(bones) = bones(extension, Value::as_array, dropped) else { return humanoid };
        for entry in bones {
            let name = entry["bone"].as_str().unwrap_or_default();
            let own = THUMBS.iter().find(|(old, _)| *old == name).map_or(name, |(_, new)| new);
            self.human_bone(own, name, &entry["node"], &mut humanoid, dropped);
        }
        humanoid
    }

    /// What [`crate::export`] writes where the file is no VRM.
    fn humanoid_of_extras<'v>(&self, extras: impl Fn(usize) -> &'v Value, dropped: &mut Dropped) -> Humanoid {
        let mut humanoid = Humanoid::default();
        for node in 0..self.nodes.len() {
            if let Some(name) = extras(node).as_str() {
                self.human_bone(name, name, &node.into(), &mut humanoid, dropped);
            }
        }
        humanoid
    }

    /// Adds a bone, which the file calls `stated`.
    fn human_bone(&self, name: &str, stated: &str, node: &Value, humanoid: &mut Humanoid, dropped: &mut Dropped) {
        let Ok(bone) = name.parse::<HumanBone>() else {
            return dropped.add(format!("`{stated}` is no human bone"));
        };
        let Some(node) = self.node(node) else {
            return dropped.add(format!("`{stated}` names no node ({})", shown(node)));
        };
        // Eyes and the like may be nodes that no skin moves.
        let Some(joint) = self.joint(node) else {
            dropped.elsewhere += 1;
            return;
        };
        if humanoid.joint(bone).is_some() {
            dropped.add(format!("`{stated}` comes twice"));
        } else if !humanoid.insert(bone, joint) {
            dropped.add(format!("`{stated}` is node {node}, which is another bone already"));
        }
    }

    /// The node that a value names.
    fn node(&self, value: &Value) -> Option<usize> {
        value.as_u64().and_then(|n| usize::try_from(n).ok()).filter(|n| *n < self.nodes.len())
    }

    fn joint(&self, node: usize) -> Option<JointId> {
        self.skins.joint_of_node(node).map(JointId)
    }
}

/// The list of human bones; what stands in its place is told.
fn bones<'a, T>(extension: &'a Value, cast: fn(&'a Value) -> Option<&'a T>, dropped: &mut Dropped) -> Option<&'a T> {
    let humanoid = &extension["humanoid"];
    let (what, value) = match humanoid.is_object() {
        true => ("humanBones", &humanoid["humanBones"]),
        false => ("humanoid", humanoid),
    };
    let found = if humanoid.is_object() { cast(value) } else { None };
    if found.is_none() {
        dropped.wrong_type(what, value);
    }
    found
}

/// What was left out, a phrase each.
#[derive(Default)]
struct Dropped {
    phrases: Vec<String>,
    /// Human bones on nodes that are no joints.
    elsewhere: usize,
}

impl Dropped {
    fn add(&mut self, what: String) {
        self.phrases.push(what);
    }

    /// Something else stands where `what` should. What is absent is not told.
    fn wrong_type(&mut self, what: &str, found: &Value) {
        if !found.is_null() {
            self.add(format!("`{what}` is {}", shown(found)));
        }
    }

    fn warning(self, part: &'static str) -> Option<Warning> {
        (!self.phrases.is_empty()).then_some(Warning::Vrm { part, dropped: self.phrases })
    }
}

/// A value for a message.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "none given".into(),
        Value::Array(_) => "a list".into(),
        Value::Object(_) => "an object".into(),
        other => other.to_string().chars().take(40).collect(),
    }
}
