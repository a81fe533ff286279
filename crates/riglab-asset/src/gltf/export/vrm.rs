//! What VRM 0.x and 1.0 say of nodes, when nodes go or get another number.

use std::collections::HashMap;

use glam::DVec3;
use serde_json::{Value, json};

use super::draft::{Draft, index, remove};
use super::humanoid;
use super::packed::{forget_extension, forget_member_extension};
use super::references::{items, values};
use super::scene::Scene;
use super::springs::Joints;

pub(super) const VRM1: &str = "VRMC_vrm";
pub(super) const SPRINGS: &str = "VRMC_springBone";
const CONSTRAINT: &str = "VRMC_node_constraint";

/// Calls `each` with every number that names a node, -1 and the like left out.
pub(super) fn nodes(json: &mut Value, each: &mut dyn FnMut(&mut Value)) {
    let Some(extensions) = json.get_mut("extensions") else { return };
    let mut at = |value: Option<&mut Value>| {
        if let Some(value) = value.filter(|v| index(v).is_some()) {
            each(value);
        }
    };
    if let Some(vrm) = extensions.get_mut("VRM") {
        items(vrm.pointer_mut("/humanoid/humanBones")).for_each(|bone| at(bone.get_mut("node")));
        at(vrm.pointer_mut("/firstPerson/firstPersonBone"));
        for group in items(vrm.pointer_mut("/secondaryAnimation/boneGroups")) {
            at(group.get_mut("center"));
            items(group.get_mut("bones")).for_each(|bone| at(Some(bone)));
        }
        items(vrm.pointer_mut("/secondaryAnimation/colliderGroups")).for_each(|group| at(group.get_mut("node")));
    }
    if let Some(vrm) = extensions.get_mut(VRM1) {
        values(vrm.pointer_mut("/humanoid/humanBones"), |bone| at(bone.get_mut("node")));
    }
    mesh_nodes(extensions, &mut at);
    values(extensions.pointer_mut("/VRMC_vrm_animation/humanoid/humanBones"), |bone| at(bone.get_mut("node")));
    for kind in ["preset", "custom"] {
        let all = extensions.pointer_mut(&format!("/VRMC_vrm_animation/expressions/{kind}"));
        values(all, |expression| at(expression.get_mut("node")));
    }
    at(extensions.pointer_mut("/VRMC_vrm_animation/lookAt/node"));
    if let Some(springs) = extensions.get_mut(SPRINGS) {
        items(springs.get_mut("colliders")).for_each(|collider| at(collider.get_mut("node")));
        for spring in items(springs.get_mut("springs")) {
            at(spring.get_mut("center"));
            items(spring.get_mut("joints")).for_each(|joint| at(joint.get_mut("node")));
        }
    }
}

/// The numbers in VRM 1.0 that mean the node of a mesh.
fn mesh_nodes(extensions: &mut Value, at: &mut dyn FnMut(Option<&mut Value>)) {
    let Some(vrm) = extensions.get_mut(VRM1) else { return };
    items(vrm.pointer_mut("/firstPerson/meshAnnotations")).for_each(|a| at(a.get_mut("node")));
    for kind in ["preset", "custom"] {
        values(vrm.pointer_mut(&format!("/expressions/{kind}")), |expression| {
            items(expression.get_mut("morphTargetBinds")).for_each(|bind| at(bind.get_mut("node")));
        });
    }
}

/// A mesh went to another node.
pub(super) fn follow_meshes(json: &mut Value, to: impl Fn(usize) -> Option<usize>) {
    let Some(extensions) = json.get_mut("extensions") else { return };
    mesh_nodes(extensions, &mut |value| {
        if let Some((value, new)) = value.and_then(|v| Some((index(v).and_then(&to)?, v))).map(|(n, v)| (v, n)) {
            *value = json!(new);
        }
    });
}

/// Takes humanoid and springs away, and says which of them there were; what is said of materials, expressions and rights
/// stays.
pub(super) fn strip(draft: &mut Draft) -> Vec<&'static str> {
    let mut dropped = Vec::new();
    for (extension, parts) in
        [("VRM", &["humanoid", "firstPerson", "secondaryAnimation"][..]), (VRM1, &["humanoid", "lookAt"])]
    {
        let Some(vrm) = draft.json.pointer_mut(&format!("/extensions/{extension}")) else { continue };
        dropped.extend(parts.iter().filter(|part| remove(vrm, part).is_some()));
    }
    let mut constraints = false;
    for node in draft.list_mut("nodes") {
        constraints |= node["extensions"].get(CONSTRAINT).is_some();
        forget_member_extension(node, &[CONSTRAINT]);
    }
    humanoid::forget_extras(draft);
    let springs = draft.json["extensions"].get(SPRINGS).is_some();
    dropped.extend([(springs, SPRINGS), (constraints, CONSTRAINT)].into_iter().filter(|own| own.0).map(|own| own.1));
    forget_member_extension(&mut draft.json, &[SPRINGS]);
    for name in [SPRINGS, CONSTRAINT] {
        forget_extension(&mut draft.json, name);
    }
    dropped
}

/// How many nodes follow others.
pub(super) fn constrained(draft: &Draft) -> usize {
    draft.list("nodes").iter().filter(|node| node["extensions"].get(CONSTRAINT).is_some()).count()
}

/// Where a viewer's eye is, which is told in the axes of the head's node, told in those of its successor.
pub(super) fn turn_offsets(draft: &mut Draft, scene: &Scene, joints: &Joints<'_>, successors: &HashMap<usize, usize>) {
    // A point in the space of an old node, in that of the new one.
    let turned = |node: &Value, offset: DVec3| -> Option<[f64; 3]> {
        let old = index(node)?;
        let new = successors.get(&old)?;
        let joint = joints.skeleton.ids().find(|&joint| joints.node(joint) == *new)?;
        let at = scene.rests[old].transform_point3(offset).as_vec3();
        at.is_finite().then(|| joints.within(joint, at.to_array()))
    };
    let Some(extensions) = draft.json.get_mut("extensions") else { return };
    let head = extensions[VRM1]["humanoid"]["humanBones"]["head"]["node"].clone();
    if let Some(offset) = extensions.pointer_mut(&format!("/{VRM1}/lookAt/offsetFromHeadBone")) {
        let own: Vec<f64> = offset.as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
        if let &[x, y, z] = &own[..]
            && let Some(new) = turned(&head, DVec3::new(x, y, z))
        {
            *offset = json!(new);
        }
    }
    let Some(first) = extensions.pointer_mut("/VRM/firstPerson") else { return };
    let own = ["x", "y", "z"].map(|axis| first["firstPersonBoneOffset"][axis].as_f64());
    if let [Some(x), Some(y), Some(z)] = own
        && let Some(new) = turned(&first["firstPersonBone"], DVec3::new(x, y, -z))
    {
        first["firstPersonBoneOffset"] = unity(new);
    }
}

/// A vector by names, with the z axis of Unity.
pub(super) fn unity([x, y, z]: [f64; 3]) -> Value {
    json!({"x": x, "y": y, "z": 0.0 - z})
}

/// Gives every named node its successor, and drops what names one that has none: single bones, springs
/// without joints, colliders without a node. How many human bones of a VRM went.
pub(super) fn follow_joints(draft: &mut Draft, to: &dyn Fn(usize) -> Option<usize>) -> usize {
    // Whether the number under `key` still names something.
    let follow = |of: &mut Value, key: &str| -> bool {
        let Some(node) = of.get(key).and_then(index) else { return false };
        match to(node) {
            Some(new) => of[key] = json!(new),
            None => return false,
        }
        true
    };
    let mut bones_lost = 0;
    let follow_bone = |bone: &mut Value, lost: &mut usize| {
        let named = bone.get("node").is_some_and(|node| index(node).is_some());
        let stays = follow(bone, "node");
        *lost += usize::from(named && !stays);
        stays
    };
    if let Some(vrm) = draft.json.pointer_mut("/extensions/VRM") {
        retain(vrm.pointer_mut("/humanoid/humanBones"), |bone| follow_bone(bone, &mut bones_lost));
        let lost = |of: Option<&mut Value>, key: &str| {
            if let Some(of) = of
                && of.get(key).and_then(index).is_some()
                && !follow(of, key)
            {
                // By this format, none.
                of[key] = json!(-1);
            }
        };
        lost(vrm.get_mut("firstPerson"), "firstPersonBone");
        let kept = retain(vrm.pointer_mut("/secondaryAnimation/colliderGroups"), |group| follow(group, "node"));
        retain(vrm.pointer_mut("/secondaryAnimation/boneGroups"), |group| {
            lost(Some(group), "center");
            renumber(group.get_mut("colliderGroups"), &kept);
            retain(group.get_mut("bones"), |bone| match index(bone).and_then(to) {
                Some(new) => {
                    *bone = json!(new);
                    true
                }
                None => false,
            });
            group["bones"].as_array().is_some_and(|bones| !bones.is_empty())
        });
    }
    let bones = draft.json.pointer_mut(&format!("/extensions/{VRM1}/humanoid/humanBones"));
    if let Some(bones) = bones.and_then(Value::as_object_mut) {
        bones.retain(|_, bone| follow_bone(bone, &mut bones_lost));
    }
    if let Some(springs) = draft.json.pointer_mut(&format!("/extensions/{SPRINGS}")) {
        let kept = retain(springs.get_mut("colliders"), |collider| follow(collider, "node"));
        items(springs.get_mut("colliderGroups")).for_each(|group| renumber(group.get_mut("colliders"), &kept));
        retain(springs.get_mut("springs"), |spring| {
            if spring.get("center").is_some() && !follow(spring, "center") {
                remove(spring, "center");
            }
            retain(spring.get_mut("joints"), |joint| follow(joint, "node"));
            spring["joints"].as_array().is_some_and(|joints| !joints.is_empty())
        });
    }
    for node in draft.list_mut("nodes") {
        let mut lost = false;
        values(node.pointer_mut(&format!("/extensions/{CONSTRAINT}/constraint")), |c| lost |= !follow(c, "source"));
        if lost {
            forget_member_extension(node, &[CONSTRAINT]);
        }
    }
    bones_lost
}

/// Keeps some elements of a list; gives the new number of each old one.
fn retain(list: Option<&mut Value>, mut keep: impl FnMut(&mut Value) -> bool) -> Vec<Option<usize>> {
    let Some(list) = list.and_then(Value::as_array_mut) else { return Vec::new() };
    let (mut numbers, mut next) = (Vec::new(), 0);
    list.retain_mut(|element| {
        let kept = keep(element);
        numbers.push(kept.then_some(next));
        next += usize::from(kept);
        kept
    });
    numbers
}

/// Numbers of elements after some were dropped.
fn renumber(list: Option<&mut Value>, kept: &[Option<usize>]) {
    retain(list, |number| match index(number).and_then(|n| kept.get(n).copied().flatten()) {
        Some(new) => {
            *number = json!(new);
            true
        }
        None => false,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bones_follow_their_joints_and_lost_ones_go() {
        let bone = |name: &str, node: i32| json!({"bone": name, "node": node});
        let mut draft = Draft::new(json!({"extensions": {"VRM": {
            "humanoid": {"humanBones": [bone("hips", 1), bone("head", 2)]},
            "firstPerson": {"firstPersonBone": 2},
            "secondaryAnimation": {
                "boneGroups": [{"bones": [1, 2], "center": -1, "colliderGroups": [0, 1]}, {"bones": [2]}],
                "colliderGroups": [{"node": 2}, {"node": 1}],
            },
        }}}));
        follow_joints(&mut draft, &|n| (n == 1).then_some(7));
        assert_eq!(
            draft.json["extensions"]["VRM"],
            json!({
                "humanoid": {"humanBones": [bone("hips", 7)]},
                "firstPerson": {"firstPersonBone": -1},
                "secondaryAnimation": {
                    "boneGroups": [{"bones": [7], "center": -1, "colliderGroups": [0]}],
                    "colliderGroups": [{"node": 7}],
                },
            })
        );
    }

    #[test]
    fn springs_of_1_0_follow_too() {
        let joints = json!([{"node": 1, "stiffness": 0.5}, {"node": 2}]);
        let mut draft = Draft::new(json!({"extensions": {
            "VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 1}, "head": {"node": 2}}}},
            "VRMC_springBone": {
                "colliders": [{"node": 2}, {"node": 1}],
                "colliderGroups": [{"colliders": [0, 1]}],
                "springs": [{"joints": joints, "center": 2}, {"joints": [{"node": 2}]}],
            },
        }}));
        follow_joints(&mut draft, &|n| (n == 1).then_some(7));
        assert_eq!(draft.json["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"], json!({"hips": {"node": 7}}));
        assert_eq!(
            draft.json["extensions"]["VRMC_springBone"],
            json!({
                "colliders": [{"node": 7}],
                "colliderGroups": [{"colliders": [0]}],
                "springs": [{"joints": [{"node": 7, "stiffness": 0.5}]}],
            })
        );
        let mut numbers = vec![];
        nodes(&mut draft.json, &mut |n| numbers.push(n.clone()));
        assert_eq!(numbers, [7, 7, 7].map(Value::from));
    }
}
