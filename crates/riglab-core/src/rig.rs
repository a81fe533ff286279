//! A mesh bound to a skeleton.

use crate::{Humanoid, Mesh, RigError, Skeleton, SkinWeights, Springs, Vec3};

/// A mesh bound to a skeleton at rest: the only thing that crosses between files, corpora, tokens,
/// metrics and rewards.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    skeleton: Skeleton,
    mesh: Mesh,
    weights: SkinWeights,
    humanoid: Humanoid,
    springs: Springs,
}

impl Rig {
    /// Checks that the parts fit together. The rig has no humanoid map and no springs yet.
    ///
    /// # Errors
    /// [`RigError::RowCount`] unless there is a row of weights for each vertex,
    /// [`RigError::JointOutOfRange`] for a weight on a joint that does not exist.
    pub fn new(skeleton: Skeleton, mesh: Mesh, weights: SkinWeights) -> Result<Self, RigError> {
        if weights.rows() != mesh.positions().len() {
            return Err(RigError::RowCount { rows: weights.rows(), vertices: mesh.positions().len() });
        }
        let joints = skeleton.len();
        if let Some(at) = weights.joints().iter().position(|&j| usize::from(j) >= joints) {
            let vertex = weights.offsets().partition_point(|&o| o as usize <= at) - 1;
            return Err(RigError::JointOutOfRange { vertex, joint: weights.joints()[at], joints });
        }
        Ok(Self { skeleton, mesh, weights, humanoid: Humanoid::default(), springs: Springs::default() })
    }

    /// The same rig with another humanoid map.
    ///
    /// # Errors
    /// [`RigError::HumanBoneOutOfRange`] for a joint that does not exist.
    pub fn with_humanoid(self, humanoid: Humanoid) -> Result<Self, RigError> {
        let joints = self.skeleton.len();
        if let Some((bone, joint)) = humanoid.iter().find(|(_, joint)| joint.index() >= joints) {
            return Err(RigError::HumanBoneOutOfRange { bone, joint: joint.0, joints });
        }
        Ok(Self { humanoid, ..self })
    }

    /// The same rig with other springs.
    ///
    /// # Errors
    /// [`RigError::BadSpring`] or [`RigError::BadCollider`] for joints that do not exist or are out of
    /// order.
    pub fn with_springs(self, springs: Springs) -> Result<Self, RigError> {
        springs.check(&self.skeleton)?;
        Ok(Self { springs, ..self })
    }

    /// The skeleton.
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The weights, one row a vertex.
    pub fn weights(&self) -> &SkinWeights {
        &self.weights
    }

    /// Which joints are human bones.
    pub fn humanoid(&self) -> &Humanoid {
        &self.humanoid
    }

    /// What swings, and what stops it.
    pub fn springs(&self) -> &Springs {
        &self.springs
    }

    /// The parts every rig has.
    pub fn into_parts(self) -> (Skeleton, Mesh, SkinWeights) {
        (self.skeleton, self.mesh, self.weights)
    }

    /// All parts.
    pub fn into_all(self) -> (Skeleton, Mesh, SkinWeights, Humanoid, Springs) {
        (self.skeleton, self.mesh, self.weights, self.humanoid, self.springs)
    }

    /// The box around vertices and joints.
    pub fn bounds(&self) -> Bounds {
        let points = self.mesh.positions().iter().chain(self.skeleton.heads());
        Bounds::of(points.copied()).expect("a rig has a vertex")
    }

    /// Moves and scales the rig uniformly so that the box around vertices *and* joints is centred
    /// and its longest side runs from -1 to 1. Gives the map that was applied.
    pub fn normalized(&self) -> (Self, Similarity) {
        let map = Similarity::into_cube(self.bounds());
        (self.transformed(map).expect("what is in its own cube is finite"), map)
    }

    /// The rig under a similarity.
    ///
    /// # Errors
    /// [`RigError::JointNotFinite`] or [`RigError::VertexNotFinite`] where it is taken beyond the greatest numbers.
    pub fn transformed(&self, map: Similarity) -> Result<Self, RigError> {
        let all = |points: &[Vec3]| points.iter().map(|&p| map.apply(p)).collect::<Vec<_>>();
        let skeleton = self.skeleton.with_heads(all(self.skeleton.heads()))?;
        let mesh = self.mesh.with_positions(all(self.mesh.positions()))?;
        let springs = self.springs.transformed(map);
        Ok(Self { skeleton, mesh, weights: self.weights.clone(), humanoid: self.humanoid.clone(), springs })
    }

    /// The same rig with other weights.
    ///
    /// # Errors
    /// As [`Rig::new`].
    pub fn with_weights(&self, weights: SkinWeights) -> Result<Self, RigError> {
        let plain = Self::new(self.skeleton.clone(), self.mesh.clone(), weights)?;
        Ok(Self { humanoid: self.humanoid.clone(), springs: self.springs.clone(), ..plain })
    }

    /// The joints that carry a weight above `threshold` on some vertex.
    pub fn skinned_joints(&self, threshold: f32) -> Vec<crate::JointId> {
        let mut used = vec![false; self.skeleton.len()];
        for (&j, &w) in self.weights.joints().iter().zip(self.weights.weights()) {
            used[usize::from(j)] |= w > threshold;
        }
        self.skeleton.ids().filter(|j| used[j.index()]).collect()
    }
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: Vec3,
    /// Largest coordinates.
    pub max: Vec3,
}

impl Bounds {
    /// The box around points; `None` without points.
    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Option<Self> {
        points.into_iter().map(|p| Self { min: p, max: p }).reduce(|a, b| Self {
            min: std::array::from_fn(|k| a.min[k].min(b.min[k])),
            max: std::array::from_fn(|k| a.max[k].max(b.max[k])),
        })
    }

    /// The middle.
    pub fn center(&self) -> Vec3 {
        std::array::from_fn(|k| 0.5 * self.min[k] + 0.5 * self.max[k])
    }

    /// Side lengths.
    pub fn size(&self) -> Vec3 {
        std::array::from_fn(|k| self.max[k] - self.min[k])
    }

    /// Length of the diagonal.
    pub fn diagonal(&self) -> f32 {
        glam::Vec3::from(self.size()).length()
    }
}

/// A box whose centre is farther from the origin, in halves of its longest side, is not scaled: points of it might overflow.
const FARTHEST: f32 = 1e30;

/// A uniform scale, then a shift: p -> scale * p + shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Scale; positive.
    pub scale: f32,
    /// Shift, after the scale.
    pub shift: Vec3,
}

impl Similarity {
    /// All stays where it is.
    pub const NONE: Self = Self { scale: 1.0, shift: [0.0; 3] };

    /// The map that centres a box and gives its longest side the length 2. A box without extent is
    /// only centred, and so is one that has next to none for how far from the origin it is.
    pub fn into_cube(bounds: Bounds) -> Self {
        // Halves: a box may be wider than the greatest number.
        let half = (0..3).map(|k| 0.5 * bounds.max[k] - 0.5 * bounds.min[k]).fold(0.0f32, f32::max);
        let (mut scale, center) = (1.0 / half, bounds.center());
        // Of the widest boxes it is so small that it has few digits: rounded up it has an inverse.
        if scale > 0.0 && (1.0 / scale).is_infinite() {
            scale = scale.next_up();
        }
        if !(half > 0.0 && center.iter().all(|c| (c * scale).abs() < FARTHEST)) {
            scale = 1.0;
        }
        Self { scale, shift: center.map(|c| -c * scale) }
    }

    /// The image of a point.
    pub fn apply(&self, p: Vec3) -> Vec3 {
        std::array::from_fn(|k| self.scale * p[k] + self.shift[k])
    }

    /// The map back.
    pub fn inverse(&self) -> Self {
        Self { scale: 1.0 / self.scale, shift: self.shift.map(|s| -s / self.scale) }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{Joint, JointId};

    /// Two triangles on two joints.
    pub(crate) fn small() -> Rig {
        let joints = [("root", None, [0.0, 0.0, 0.0]), ("tip", Some(JointId(0)), [0.0, 4.0, 0.0])];
        let joints = joints.map(|(name, parent, head)| Joint { name: name.into(), parent, head });
        let skeleton = Skeleton::new(joints.to_vec()).unwrap();
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 1.0, 0.0], [0.0, 3.0, 1.0]], vec![[0, 1, 2], [2, 1, 0]]).unwrap();
        let weights = SkinWeights::normalized([vec![(0, 1.0)], vec![(0, 1.0), (1, 1.0)], vec![(1, 1.0)]]).unwrap();
        Rig::new(skeleton, mesh, weights).unwrap()
    }

    #[test]
    fn normalised_box_includes_joints() {
        let (rig, map) = small().normalized();
        let b = rig.bounds();
        assert_eq!((b.min[1], b.max[1]), (-1.0, 1.0));
        assert_eq!(rig.skeleton().head(JointId(1)), [-0.25, 1.0, -0.25]);
        let back = map.inverse().apply(rig.skeleton().head(JointId(1)));
        assert!((back[1] - 4.0).abs() < 1e-6);
    }

    #[test]
    fn a_point_like_rig_is_centred_and_finite() {
        let skeleton = Skeleton::new(vec![Joint { name: "a".into(), parent: None, head: [1.0; 3] }]).unwrap();
        let mesh = Mesh::new(vec![[1.0; 3]], vec![[0; 3]]).unwrap();
        let rig = Rig::new(skeleton, mesh, SkinWeights::normalized([vec![(0, 1.0)]]).unwrap()).unwrap();
        assert_eq!(rig.normalized().0.skeleton().heads(), [[0.0; 3]]);
    }

    #[test]
    fn boxes_of_any_size_go_into_the_cube_and_back() {
        let most = f32::MAX;
        for (min, max) in [
            ([-most; 3], [most; 3]),
            ([-most, 0.0, 0.0], [0.9 * most, 1.0, most]),
            ([0.0, most, -1.0], [1e-38, most, 1.0]),
            ([0.0, most, 0.0], [1e-38, most, 0.0]),
            ([0.0; 3], [1e-45, 0.0, 0.0]),
        ] {
            let (small, map) = (small().into_parts(), Similarity::into_cube(Bounds { min, max }));
            let back = map.inverse();
            let finite =
                |map: Similarity| map.scale > 0.0 && map.scale.is_finite() && map.shift.iter().all(|x| x.is_finite());
            assert!(finite(map) && finite(back), "{min:?} {max:?}: {map:?} {back:?}");
            let corners = [min, max].map(|p| map.apply(p));
            assert!(corners.as_flattened().iter().all(|x| x.abs() <= 1.0 + 1e-5), "{min:?} {max:?}: {corners:?}");
            // Whole rigs, too.
            let mesh = Mesh::new(vec![min, max, min], vec![[0, 1, 2]]).unwrap();
            let rig = Rig::new(small.0.with_heads(vec![min, max]).unwrap(), mesh, small.2).unwrap();
            assert!(rig.normalized().0.bounds().size().iter().all(|x| *x <= 2.0 + 1e-5));
        }
        // Beyond the greatest numbers there is none.
        let far = Similarity { scale: most, shift: [0.0; 3] };
        assert!(matches!(small().transformed(far), Err(RigError::JointNotFinite { .. })));
    }

    #[test]
    fn parts_that_do_not_fit_are_refused() {
        let (skeleton, mesh, _) = small().into_parts();
        let short = SkinWeights::normalized([vec![(0, 1.0)]]).unwrap();
        assert!(matches!(Rig::new(skeleton.clone(), mesh.clone(), short), Err(RigError::RowCount { .. })));
        let far = SkinWeights::normalized([vec![(0, 1.0)], vec![(0, 1.0), (5, 1.0)], vec![(0, 1.0)]]).unwrap();
        assert_eq!(Rig::new(skeleton, mesh, far), Err(RigError::JointOutOfRange { vertex: 1, joint: 5, joints: 2 }));
    }
}
