//! Animations, when nodes lose their motion.

use std::collections::HashSet;

use serde_json::{Value, json};

use super::draft::{Draft, index, remove};
use super::references::{items, node_in_pointer};

/// Drops the channels that move a node `moved` says yes to, then animations without channels and samplers
/// without use; gives how many channels went. Morph weights follow their mesh to the node `mesh_at` says.
pub(super) fn drop_motion(
    draft: &mut Draft,
    moved: impl Fn(usize) -> bool,
    mesh_at: impl Fn(usize) -> Option<usize>,
) -> usize {
    let mut dropped = 0;
    for animation in draft.list_mut("animations") {
        let Some(channels) = animation.get_mut("channels").and_then(Value::as_array_mut) else { continue };
        channels.retain_mut(|channel| {
            let (mut stays, mut weights) = (true, channel["target"]["path"] == "weights");
            let pointer = channel.pointer_mut("/target/extensions/KHR_animation_pointer/pointer");
            weights |= pointer.as_ref().is_some_and(|p| p.as_str().is_some_and(|p| p.contains("/weights")));
            let mut follow = |node: &mut Value| {
                let Some(number) = index(node) else { return };
                match weights {
                    true => *node = json!(mesh_at(number).unwrap_or(number)),
                    false => stays = !moved(number),
                }
            };
            node_in_pointer(pointer, &mut follow);
            channel.pointer_mut("/target/node").map(follow);
            dropped += usize::from(!stays);
            stays
        });
        drop_samplers(animation);
    }
    if dropped > 0 {
        drop_empty(draft);
    }
    dropped
}

/// Drops the channels over accessors of keys or values that `broken` says yes to, then animations without channels and
/// samplers without use; gives how many channels went.
pub(super) fn drop_broken(draft: &mut Draft, mut broken: impl FnMut(usize) -> bool) -> usize {
    let mut dropped = 0;
    for animation in draft.list_mut("animations") {
        let accessors = |sampler: &Value| ["input", "output"].map(|key| index(&sampler[key]));
        let samplers = items(animation.get_mut("samplers"));
        let bad: Vec<bool> = samplers.map(|s| accessors(s).into_iter().flatten().any(&mut broken)).collect();
        let Some(channels) = animation.get_mut("channels").and_then(Value::as_array_mut) else { continue };
        let before = channels.len();
        channels.retain(|channel| !index(&channel["sampler"]).and_then(|s| bad.get(s)).is_some_and(|bad| *bad));
        if channels.len() < before {
            dropped += before - channels.len();
            drop_samplers(animation);
        }
    }
    if dropped > 0 {
        drop_empty(draft);
    }
    dropped
}

/// Drops animations without channels.
fn drop_empty(draft: &mut Draft) {
    let Some(animations) = draft.json.get_mut("animations").and_then(Value::as_array_mut) else { return };
    animations.retain(|a| a["channels"].as_array().is_none_or(|channels| !channels.is_empty()));
    if animations.is_empty() {
        remove(&mut draft.json, "animations");
    }
}

/// The nodes that some animation moves, turns or scales.
pub(super) fn moved_nodes(draft: &Draft) -> HashSet<usize> {
    let channels = draft.list("animations").iter().filter_map(|a| a["channels"].as_array()).flatten();
    let place = |path: &Value| ["translation", "rotation", "scale"].iter().any(|own| path == own);
    channels.map(|c| &c["target"]).filter(|t| place(&t["path"])).filter_map(|t| index(&t["node"])).collect()
}

/// Drops the samplers that no channel uses.
fn drop_samplers(animation: &mut Value) {
    let mut used: Vec<usize> = items(animation.get_mut("channels")).filter_map(|c| index(&c["sampler"])).collect();
    used.sort_unstable();
    used.dedup();
    let Some(samplers) = animation.get_mut("samplers").and_then(Value::as_array_mut) else { return };
    if used.len() == samplers.len() || used.last().is_some_and(|last| *last >= samplers.len()) {
        return;
    }
    let kept: Vec<Value> = used.iter().map(|&n| samplers[n].take()).collect();
    *samplers = kept;
    for channel in items(animation.get_mut("channels")) {
        if let Some(new) = index(&channel["sampler"]).and_then(|n| used.binary_search(&n).ok()) {
            channel["sampler"] = json!(new);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_a_node_is_told_from_what_changes_its_shape() {
        let of = |node: usize, path: &str| json!({"sampler": 0, "target": {"node": node, "path": path}});
        let all = [of(3, "translation"), of(4, "weights"), json!({"target": {"path": "scale"}}), of(5, "rotation")];
        let draft = Draft::new(json!({"animations": [{"channels": all, "samplers": ["a"]}]}));
        assert_eq!(moved_nodes(&draft), HashSet::from([3, 5]));
    }

    #[test]
    fn motion_of_a_joint_goes_and_morphs_follow_their_mesh() {
        let channel = |sampler: usize, node: usize, path: &str| json!({"sampler": sampler, "target": {"node": node, "path": path}});
        let mut draft = Draft::new(json!({"animations": [
            {"channels": [channel(0, 1, "rotation"), channel(1, 2, "weights"), channel(2, 3, "translation")], "samplers": ["a", "b", "c"]},
            {"channels": [channel(0, 1, "scale")], "samplers": ["d"]},
        ]}));
        assert_eq!(drop_motion(&mut draft, |n| n < 3, |n| (n == 2).then_some(9)), 2);
        assert_eq!(
            draft.json["animations"],
            json!([
                {"channels": [channel(0, 9, "weights"), channel(1, 3, "translation")], "samplers": ["b", "c"]},
            ])
        );
    }
}
