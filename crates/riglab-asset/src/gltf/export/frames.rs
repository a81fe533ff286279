//! How joints are turned at rest.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use riglab_core::{JointId, Skeleton};

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
        let above = parent.map_or(DQuat::IDENTITY, |parent| rotations[parent.index()]);
        rotations.push(along.map_or(above, |along| turned(along, above)));
    }
    rotations.iter().enumerate().map(|(j, q)| DAffine3::from_rotation_translation(*q, head(j))).collect()
}

/// The rotation of a bone that points along a unit vector.
///
/// z looks along the scene's z as far as it can: then bones that point down, as legs do, have no freedom that rounding
/// decides, as the shortest turn from y would give them, and left and right are mirror images. Bones within 25 degrees
/// of the scene's z go on from their parent by the shortest turn.
fn turned(along: DVec3, above: DQuat) -> DQuat {
    const NEAR_Z: f64 = 0.9;
    if along.z.abs() > NEAR_Z {
        return (DQuat::from_rotation_arc(above * DVec3::Y, along) * above).normalize();
    }
    let z = DVec3::Z.reject_from_normalized(along).normalize();
    DQuat::from_mat3(&DMat3::from_cols(along.cross(z), along, z)).normalize()
}

/// Adds a node for each joint, named after it; gives the number of the first, the root's. Those of `loose` hang on no
/// other.
pub(super) fn add_joints(draft: &mut Draft, skeleton: &Skeleton, frames: &[DAffine3], loose: &[JointId]) -> usize {
    let first = draft.list("nodes").len();
    for (joint, children) in skeleton.ids().zip(skeleton.children()) {
        let frame = frames[joint.index()];
        let mut node = json!({"name": skeleton.name(joint)});
        let parent = skeleton.parent(joint).filter(|_| !loose.contains(&joint));
        let above = parent.map(|p| frames[p.index()]);
        let local = above.map_or(frame, |above| above.inverse() * frame);
        // Without turns the difference of two f32 needs no inverse, and is exact to the last bit.
        let translation = match (parent, frame.matrix3 == DMat3::IDENTITY) {
            (Some(parent), true) if above.is_some_and(|a| a.matrix3 == DMat3::IDENTITY) => {
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
        let children: Vec<Value> =
            children.iter().filter(|c| !loose.contains(c)).map(|c| json!(first + c.index())).collect();
        if !children.is_empty() {
            node["children"] = children.into();
        }
        draft.push("nodes", node);
    }
    first
}

/// The inverse bind matrices of joints as bytes.
pub(super) fn inverse_binds(frames: &[DAffine3]) -> Vec<u8> {
    matrices(frames.iter().map(DAffine3::inverse))
}

/// Matrices as bytes, column by column.
pub(super) fn matrices(all: impl Iterator<Item = DAffine3>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(64 * all.size_hint().0);
    for inverse in all {
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
    use riglab_core::Joint;

    #[test]
    fn rolls_are_steady_and_mirror_each_other() {
        // Legs that point down but for rounding.
        for off in [[1e-9, 0.0], [-1e-9, 1e-9], [0.0, -1e-9], [0.0, 0.0]] {
            let z = turned(DVec3::new(off[0], -1.0, off[1]).normalize(), DQuat::IDENTITY) * DVec3::Z;
            assert!((z - DVec3::Z).length() < 1e-6, "{z}");
        }
        let arm = DVec3::new(0.8, -0.6, 0.1).normalize();
        let mirror = DVec3::new(-1.0, 1.0, 1.0);
        let [left, right] = [arm, mirror * arm].map(|along| turned(along, DQuat::IDENTITY));
        assert!((left * DVec3::Z * mirror - right * DVec3::Z).length() < 1e-12);
        // A foot goes on from its shin.
        let shin = turned(DVec3::NEG_Y, DQuat::IDENTITY);
        let foot = turned(DVec3::new(0.0, -0.1, 1.0).normalize(), shin);
        assert!((foot * DVec3::X - shin * DVec3::X).length() < 1e-9);
    }

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
        add_joints(&mut draft, &skeleton, &frames, &[]);
        assert_eq!(draft.json["nodes"][2]["children"], json!([3]));
        let [_, _, z] = [0, 1, 2].map(|k| draft.json["nodes"][3]["translation"][k].as_f64().unwrap());
        // 3 along the spine's own y.
        assert!(z.abs() < 1e-6 && (draft.json["nodes"][3]["translation"][1].as_f64().unwrap() - 3.0).abs() < 1e-6);

        // The spine by itself, with what hangs on it.
        let mut draft = Draft::new(json!({}));
        add_joints(&mut draft, &skeleton, &of(&skeleton, JointFrames::Parallel), &[JointId(2)]);
        assert_eq!(
            (&draft.json["nodes"][0]["children"], &draft.json["nodes"][2]["children"]),
            (&json!([1]), &json!([3]))
        );
        assert_eq!(draft.json["nodes"][2]["translation"], json!([0.0, 2.0, 0.0]));
    }
}
