//! The human bones of a rig, written where they are looked for.
//!
//! A VRM has a place for them. A rig alone becomes a VRM 1.0 when what that format insists on is known:
//! all bones that a humanoid must have, a body that looks along +z, an author, and that the author chose the
//! licence of VRM, the only one that viewers open. Its permissions are not stated, so that the strictest
//! apply. Nothing of this is ever made up: else, and in other documents, each bone is told by the `extras` of
//! its node, which programs that know nothing of it keep.

use std::collections::HashSet;

use glam::Vec3;
use riglab_core::{HumanBone, Humanoid, JointId, Provenance, Rig};
use serde_json::{Map, Value, json};

use super::super::vrm::BONE_EXTRA;
use super::draft::{Draft, index, remove};
use super::vrm::VRM1;
use crate::ExportNote;

/// The licence whose terms the fields of VRM 1.0 fill in.
const LICENCE: &str = "https://vrm.dev/licenses/1.0/";

/// Whether a document is a VRM.
pub(super) fn is_vrm(draft: &Draft) -> bool {
    [VRM1, "VRM"].iter().any(|name| draft.json["extensions"][name].is_object())
}

/// Writes the human bones of a rig in the words of the document. A rig without any leaves those that the
/// document has. `node` gives the node of a joint; bones of a VRM on nodes that are no joints (`is_joint`), of which a rig says
/// nothing, stay.
pub(super) fn set(draft: &mut Draft, humanoid: &Humanoid, node: impl Fn(JointId) -> usize, is_joint: &[bool]) {
    let bones: Vec<(&str, usize)> = humanoid.iter().map(|(bone, joint)| (bone.name(), node(joint))).collect();
    if bones.is_empty() {
        return;
    }
    forget_extras(draft);
    let has = |draft: &Draft, name: &str| draft.json["extensions"][name].is_object();
    let stays = |name: Option<&str>, bone: &Value, names: fn(&str) -> &str| {
        let known = name.is_some_and(|name| bones.iter().all(|(own, _)| names(own) != name));
        known && index(&bone["node"]).is_some_and(|node| is_joint.get(node) == Some(&false))
    };
    if has(draft, VRM1) {
        let mut own = in_1(&bones);
        let before = draft.json["extensions"][VRM1]["humanoid"]["humanBones"].as_object();
        let others = before.into_iter().flatten().filter(|(name, bone)| stays(Some(name.as_str()), bone, |name| name));
        others.for_each(|(name, bone)| own["humanBones"][name] = bone.clone());
        draft.json["extensions"][VRM1]["humanoid"] = own;
    } else if has(draft, "VRM") {
        let own = &mut draft.json["extensions"]["VRM"]["humanoid"];
        // What else it says of the body, such as the stretch of arms, stays.
        if !own.is_object() {
            *own = json!({});
        }
        let bone = |&(name, node)| json!({"bone": name_in_0(name), "node": node, "useDefaultValues": true});
        let before = own["humanBones"].as_array().map_or(&[][..], Vec::as_slice);
        let others = before.iter().filter(|bone| stays(bone["bone"].as_str(), bone, name_in_0)).cloned();
        own["humanBones"] = bones.iter().map(bone).chain(others).collect();
    } else {
        set_extras(draft, &bones);
    }
}

/// The human bones that a VRM must have and this one lacks; none of what is no VRM.
pub(super) fn lacking_of_vrm(draft: &Draft) -> Vec<String> {
    let extensions = &draft.json["extensions"];
    let own: HashSet<&str> = match (&extensions[VRM1], &extensions["VRM"]) {
        (Value::Object(vrm), _) => {
            let bones = vrm.get("humanoid").and_then(|own| own["humanBones"].as_object());
            bones.into_iter().flatten().map(|(name, _)| name.as_str()).collect()
        }
        (_, Value::Object(vrm)) => {
            let bones = vrm.get("humanoid").and_then(|own| own["humanBones"].as_array());
            bones.into_iter().flatten().filter_map(|bone| bone["bone"].as_str()).collect()
        }
        _ => return Vec::new(),
    };
    let needed = HumanBone::all().filter(|bone| bone.is_required());
    needed.map(HumanBone::name).filter(|name| !own.contains(name)).map(str::to_owned).collect()
}

/// Writes the human bones of a rig that stands alone.
pub(super) fn set_alone(
    draft: &mut Draft,
    name: &str,
    rig: &Rig,
    from: &Provenance,
    node: impl Fn(JointId) -> usize,
    notes: &mut Vec<ExportNote>,
) {
    let bones: Vec<(&str, usize)> = rig.humanoid().iter().map(|(bone, joint)| (bone.name(), node(joint))).collect();
    if bones.is_empty() {
        return;
    }
    match lacking(rig, from) {
        None => {
            let meta = json!({"name": name, "authors": [from.author], "licenseUrl": LICENCE});
            draft.extend_with(VRM1, json!({"specVersion": "1.0", "meta": meta, "humanoid": in_1(&bones)}));
        }
        Some(lacking) => {
            notes.push(ExportNote::NoVrm { lacking });
            set_extras(draft, &bones);
        }
    }
}

/// What keeps a rig from being a VRM 1.0.
fn lacking(rig: &Rig, from: &Provenance) -> Option<&'static str> {
    let head = |name: &str| {
        let joint = name.parse().ok().and_then(|bone| rig.humanoid().joint(bone));
        joint.map_or(Vec3::ZERO, |joint| rig.skeleton().head(joint).into())
    };
    let to_left = head("leftUpperLeg") - head("rightUpperLeg");
    if !rig.humanoid().is_complete() {
        Some("not all human bones that it asks for are there")
    } else if to_left.x <= to_left.y.abs().max(to_left.z.abs()) {
        // VRM 0.x looks the other way.
        Some("the body does not look along +z")
    } else if from.author.is_empty() {
        Some("no author is known")
    } else if from.licence.trim_end_matches('/') != LICENCE.trim_end_matches('/') {
        Some("its licence is not https://vrm.dev/licenses/1.0/")
    } else {
        None
    }
}

fn in_1(bones: &[(&str, usize)]) -> Value {
    let all: Map<String, Value> = bones.iter().map(|&(name, node)| (name.to_owned(), json!({"node": node}))).collect();
    json!({"humanBones": all})
}

fn set_extras(draft: &mut Draft, bones: &[(&str, usize)]) {
    for &(name, node) in bones {
        let Some(node) = draft.list_mut("nodes").get_mut(node) else { continue };
        if !node["extras"].is_object() {
            node["extras"] = json!({});
        }
        node["extras"][BONE_EXTRA] = json!(name);
    }
}

/// Takes the bones away that `extras` tell.
pub(super) fn forget_extras(draft: &mut Draft) {
    for node in draft.list_mut("nodes") {
        let Some(extras) = node.get_mut("extras") else { continue };
        if remove(extras, BONE_EXTRA).is_some() && extras.as_object().is_some_and(Map::is_empty) {
            remove(node, "extras");
        }
    }
}

/// VRM 1.0 moved the names of the thumb's bones by one.
fn name_in_0(name: &str) -> &str {
    match name {
        "leftThumbMetacarpal" => "leftThumbProximal",
        "leftThumbProximal" => "leftThumbIntermediate",
        "rightThumbMetacarpal" => "rightThumbProximal",
        "rightThumbProximal" => "rightThumbIntermediate",
        same => same,
    }
}
