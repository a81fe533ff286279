//! Ends of bones, which rigs do not have and files of the peers do.

use riglab_core::{Skeleton, Vec3};

/// The end of each joint's bone: the head of its only child, the middle of the heads of several; past a
/// leaf, half its own bone's length on. Never the head itself.
pub(super) fn tails(skeleton: &Skeleton) -> Vec<Vec3> {
    let children = skeleton.children();
    let bounds = riglab_core::Bounds::of(skeleton.heads().iter().copied());
    let step = bounds.map_or(0.0, |b| 0.05 * b.diagonal()).max(0.01);
    let end = |joint: riglab_core::JointId| {
        let head = skeleton.head(joint);
        let below = &children[joint.index()];
        let sum = below.iter().fold([0.0f64; 3], |sum, c| {
            let p = skeleton.head(*c);
            std::array::from_fn(|k| sum[k] + f64::from(p[k]))
        });
        // One child's head comes out exactly.
        let middle: Vec3 = sum.map(|x| (x / below.len().max(1) as f64) as f32);
        if !below.is_empty() && middle != head {
            return middle;
        }
        let from = skeleton.parent(joint).map(|p| skeleton.head(p));
        let onward: Vec3 = from.map_or(head, |from| std::array::from_fn(|k| head[k] + 0.5 * (head[k] - from[k])));
        if onward != head { onward } else { [head[0], head[1] + step, head[2]] }
    };
    skeleton.ids().map(end).collect()
}

/// The rest matrix of a bone, by rows: its second axis along the bone, its origin at the head.
pub(super) fn rest(head: Vec3, tail: Vec3) -> [f32; 16] {
    let [from, to] = [head, tail].map(glam::Vec3::from);
    let along = (to - from).try_normalize().unwrap_or(glam::Vec3::Y);
    let turn = glam::Mat3::from_quat(glam::Quat::from_rotation_arc(glam::Vec3::Y, along));
    let m = glam::Mat4::from_mat3(turn)
        + glam::Mat4::from_cols_array(&[
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, head[0], head[1], head[2], 0.0,
        ]);
    m.transpose().to_cols_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use riglab_core::{Joint, JointId};

    #[test]
    fn bones_end_where_the_next_begin_or_a_little_on() {
        let joints =
            [(None, [0.0; 3]), (Some(0), [0.0, 2.0, 0.0]), (Some(1), [1.0, 3.0, 0.0]), (Some(1), [-1.0, 3.0, 0.0])];
        let joints = joints.iter().enumerate().map(|(i, &(parent, head))| Joint {
            name: i.to_string(),
            parent: parent.map(JointId),
            head,
        });
        let ends = tails(&Skeleton::new(joints.collect()).unwrap());
        assert_eq!(ends, [[0.0, 2.0, 0.0], [0.0, 3.0, 0.0], [1.5, 3.5, 0.0], [-1.5, 3.5, 0.0]]);
        let m = rest([1.0, 2.0, 3.0], [2.0, 2.0, 3.0]);
        assert_eq!([m[3], m[7], m[11], m[15]], [1.0, 2.0, 3.0, 1.0]);
        assert!((m[1] - 1.0).abs() < 1e-6 && m[5].abs() < 1e-6);
    }
}
