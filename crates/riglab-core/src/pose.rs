//! Forward kinematics and linear blend skinning.

use glam::{Affine3A, Mat3A, Quat, Vec3A};

use crate::{JointId, Rig, RigError, Skeleton, Vec3};

/// A rotation about each joint's head, in world axes at rest, and a shift of the root.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    rotations: Vec<Mat3A>,
    root_shift: Vec3,
}

impl Pose {
    /// The rest pose of `joints` joints.
    pub fn rest(joints: usize) -> Self {
        Self { rotations: vec![Mat3A::IDENTITY; joints], root_shift: [0.0; 3] }
    }

    /// Turns a joint by a rotation vector (axis times angle in radians), before what turned it so far.
    pub fn rotate(&mut self, joint: JointId, rotation: Vec3) {
        let turn = Mat3A::from_quat(Quat::from_scaled_axis(rotation.into()));
        let now = &mut self.rotations[joint.index()];
        *now = turn * *now;
    }

    /// Shifts the root, and so everything.
    pub fn shift_root(&mut self, by: Vec3) {
        self.root_shift = by;
    }

    /// Forward kinematics: the map of each joint from rest to pose, global_parent * T(j - parent) *
    /// R * T(-j), so that a vertex held by one joint goes through that joint's map.
    ///
    /// # Errors
    /// [`RigError::PoseLength`] when the pose is of another skeleton.
    pub fn transforms(&self, skeleton: &Skeleton) -> Result<Vec<Affine3A>, RigError> {
        if self.rotations.len() != skeleton.len() {
            return Err(RigError::PoseLength { pose: self.rotations.len(), joints: skeleton.len() });
        }
        let mut maps: Vec<Affine3A> = Vec::with_capacity(skeleton.len());
        for joint in skeleton.ids() {
            let head = Vec3A::from(skeleton.head(joint));
            let rotation = self.rotations[joint.index()];
            // T(j) R T(-j): a turn about the head.
            let local = Affine3A { matrix3: rotation, translation: head - rotation * head };
            let above = match skeleton.parent(joint) {
                Some(parent) => maps[parent.index()],
                None => Affine3A::from_translation(self.root_shift.into()),
            };
            maps.push(above * local);
        }
        Ok(maps)
    }
}

/// Linear blend skinning: each vertex is the mean of its images under its joints' maps, weighted.
///
/// # Errors
/// [`RigError::PoseLength`] when the pose is of another skeleton.
pub fn lbs(rig: &Rig, pose: &Pose) -> Result<Vec<Vec3>, RigError> {
    skin(rig, &pose.transforms(rig.skeleton())?)
}

/// Linear blend skinning by the map of each joint from rest to pose, as [`Pose::transforms`] and
/// [`crate::Clip::frame`] give them.
///
/// # Errors
/// [`RigError::PoseLength`] unless there is a map for each joint.
pub fn skin(rig: &Rig, maps: &[Affine3A]) -> Result<Vec<Vec3>, RigError> {
    if maps.len() != rig.skeleton().len() {
        return Err(RigError::PoseLength { pose: maps.len(), joints: rig.skeleton().len() });
    }
    let posed = |(v, &p): (usize, &Vec3)| {
        let p = Vec3A::from(p);
        let (sum, total) = rig.weights().row(v).fold((Vec3A::ZERO, 0.0), |(sum, total), (joint, w)| {
            (sum + w * maps[joint.index()].transform_point3a(p), total + w)
        });
        Vec3::from(sum / total)
    };
    Ok(rig.mesh().positions().iter().enumerate().map(posed).collect())
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use super::*;
    use crate::rig::tests::small;

    fn close(a: Vec3, b: Vec3) -> bool {
        (0..3).all(|k| (a[k] - b[k]).abs() < 1e-5)
    }

    #[test]
    fn rest_pose_changes_nothing() {
        let rig = small();
        let posed = lbs(&rig, &Pose::rest(2)).unwrap();
        assert!(posed.iter().zip(rig.mesh().positions()).all(|(a, b)| close(*a, *b)));
    }

    #[test]
    fn a_turned_joint_turns_its_vertices_about_its_head() {
        let rig = small();
        let mut pose = Pose::rest(2);
        pose.rotate(JointId(1), [0.0, 0.0, FRAC_PI_2]);
        let posed = lbs(&rig, &pose).unwrap();
        assert!(close(posed[0], [0.0; 3]));
        // (0, 3, 1) turned by 90 degrees about z through (0, 4, 0).
        assert!(close(posed[2], [1.0, 4.0, 1.0]), "{:?}", posed[2]);
        // Half held by the root: halfway between (1, 1, 0) and (3, 5, 0).
        assert!(close(posed[1], [2.0, 3.0, 0.0]), "{:?}", posed[1]);
    }

    #[test]
    fn children_follow_their_parent() {
        let rig = small();
        let mut pose = Pose::rest(2);
        pose.rotate(JointId(0), [0.0, 0.0, FRAC_PI_2]);
        pose.shift_root([0.0, 0.0, 5.0]);
        let maps = pose.transforms(rig.skeleton()).unwrap();
        assert!(close(maps[1].transform_point3([0.0, 4.0, 0.0].into()).into(), [-4.0, 0.0, 5.0]));
    }

    #[test]
    fn a_pose_of_another_skeleton_is_refused() {
        assert_eq!(lbs(&small(), &Pose::rest(3)), Err(RigError::PoseLength { pose: 3, joints: 2 }));
    }
}
