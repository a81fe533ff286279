//! How joints are turned at rest.

use glam::{DAffine3, DQuat, DVec3};
use riglab_core::Skeleton;

use super::draft::Draft;
use crate::JointFrames;
use serde_json::{Value, json};

/// From the space of each joint to that of the mesh.
pub(super) fn of(skeleton: &Skeleton, frames: JointFrames) -> Vec<DAffine3> {
    let head = |joint: usize| glam::Vec3::from(skeleton.heads()[joint]).as_dvec3();
    if frames == JointFrames::Parallel {
        return (0..skeleton.len()).map(|j| DAffine3::from_translation(head(j))).collect();
    }
    // Joints at and below each one; children come after their parents.
    let mut weight = vec![1usize; skeleton.len()];
    let mut main: Vec<Option<usize>> = vec![None; skeleton.len()];
    for (joint, parent) in skeleton.parents().iter().enumerate().rev() {
        let Some(parent) = parent.map(|p| p.index()) else { continue };
        weight[parent] += weight[joint];
        // Backwards, so that the first of equals stays; a child in the same place gives no direction.
        let best = main[parent].map_or(0, |m| weight[m]);
        if weight[joint] >= best && head(joint) != head(parent) {
            main[parent] = Some(joint);
        }
    }
    let mut rotations: Vec<DQuat> = Vec::with_capacity(skeleton.len());
    for (joint, parent) in skeleton.parents().iter().enumerate() {
        let along = main[joint].and_then(|child| (head(child) - head(joint)).try_normalize());
        rotations.push(match (along, parent) {
            (Some(along), _) => DQuat::from_rotation_arc(DVec3::Y, along),
            (None, Some(parent)) => rotations[parent.index()],
            (None, None) => DQuat::IDENTITY,
        });
    }
    rotations.iter().enumerate().map(|(j, q)| DAffine3::from_rotation_translation(*q, head(j))).collect()
}

/// Adds a node for each joint, named after it; gives the number of the first, the root's.
pub(super) fn add_joints(draft: &mut Draft, skeleton: &Skeleton, frames: &[DAffine3]) -> usize {
    let first = draft.list("nodes").len();
    for (joint, children) in skeleton.ids().zip(skeleton.children()) {
        let frame = frames[joint.index()];
        let mut node = json!({"name": skeleton.name(joint)});
        let above = skeleton.parent(joint).map(|p| frames[p.index()]);
        let local = above.map_or(frame, |above| above.inverse() * frame);
        // Without turns the difference of two f32 needs no inverse, and is exact to the last bit.
        let translation = match (skeleton.parent(joint), frame.matrix3 == glam::DMat3::IDENTITY) {
            (Some(parent), true) if above.is_some_and(|a| a.matrix3 == glam::DMat3::IDENTITY) => {
                let (from, to) = (skeleton.head(parent), skeleton.head(joint));
                std::array::from_fn(|k| to[k] - from[k])
            }
            _ => local.translation.as_vec3().to_array(),
        };
        node["translation"] = json!(translation);
        let rotation = DQuat::from_mat3(&local.matrix3).normalize();
        if rotation != DQuat::IDENTITY {
            node["rotation"] = json!(rotation.as_quat().to_array());
        }
        if !children.is_empty() {
            node["children"] = children.iter().map(|c| json!(first + c.index())).collect::<Vec<Value>>().into();
        }
        draft.push("nodes", node);
    }
    first
}

/// The inverse bind matrices as bytes, column by column.
pub(super) fn inverse_binds(frames: &[DAffine3]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(64 * frames.len());
    for frame in frames {
        let inverse = frame.inverse();
        for (column, last) in [inverse.matrix3.x_axis, inverse.matrix3.y_axis, inverse.matrix3.z_axis]
            .into_iter()
            .zip([0.0f32; 3])
            .chain([(inverse.translation, 1.0)])
        {
            // + 0, for the zero of -x would be negative.
            for x in column.as_vec3().to_array() {
                bytes.extend((x + 0.0).to_le_bytes());
            }
            bytes.extend(last.to_le_bytes());
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use riglab_core::{Joint, JointId};

    #[test]
    fn bones_point_to_the_child_with_most_joints_below() {
        let joint =
            |name: &str, parent: Option<u16>, head| Joint { name: name.into(), parent: parent.map(JointId), head };
        let skeleton = Skeleton::new(vec![
            joint("hips", None, [0.0; 3]),
            joint("tail", Some(0), [0.0, 0.0, -1.0]),
            joint("spine", Some(0), [0.0, 2.0, 0.0]),
            joint("head", Some(2), [0.0, 2.0, 3.0]),
            joint("twin", Some(3), [0.0, 2.0, 3.0]),
        ])
        .unwrap();
        let frames = of(&skeleton, JointFrames::AlongBone);
        let along = |j: usize| frames[j].matrix3.y_axis;
        for (j, expected) in [(0, DVec3::Y), (1, DVec3::Y), (2, DVec3::Z), (3, DVec3::Z), (4, DVec3::Z)] {
            assert!((along(j) - expected).length() < 1e-12, "{j}: {}", along(j));
        }
        let mut draft = Draft::new(json!({}));
        add_joints(&mut draft, &skeleton, &frames);
        assert_eq!(draft.json["nodes"][2]["children"], json!([3]));
        let [_, _, z] = [0, 1, 2].map(|k| draft.json["nodes"][3]["translation"][k].as_f64().unwrap());
        // 3 along the spine's own y.
        assert!(z.abs() < 1e-6 && (draft.json["nodes"][3]["translation"][1].as_f64().unwrap() - 3.0).abs() < 1e-6);
    }
}
