//! Which axis points up in what a network sees.

use riglab_core::{Clip, JointMap, Mesh, Rig, RigError, Shape, Skeleton, Springs, Vec3};
use serde::{Deserialize, Serialize};

/// An axis that points up. Rigs have y up; a network may have learnt from others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Up {
    /// As riglab's rigs.
    #[default]
    Y,
    /// As Blender's.
    Z,
}

impl std::fmt::Display for Up {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Y => "y",
            Self::Z => "z",
        })
    }
}

impl Up {
    /// Its number: 1 for y, 2 for z.
    pub fn axis(self) -> usize {
        match self {
            Self::Y => 1,
            Self::Z => 2,
        }
    }

    /// A point of a rig as the network sees it. Nothing is rounded or mirrored.
    pub fn turn(self, [x, y, z]: Vec3) -> Vec3 {
        match self {
            Self::Y => [x, y, z],
            Self::Z => [x, -z, y],
        }
    }

    /// The turn back.
    pub fn back(self, [x, y, z]: Vec3) -> Vec3 {
        match self {
            Self::Y => [x, y, z],
            Self::Z => [x, z, -y],
        }
    }

    /// A mesh as the network sees it.
    ///
    /// # Errors
    /// None for the points of a mesh.
    pub fn mesh(self, mesh: &Mesh) -> Result<Mesh, RigError> {
        mesh.with_positions(mesh.positions().iter().map(|&p| self.turn(p)).collect())
    }

    /// A skeleton as the network sees it.
    ///
    /// # Errors
    /// None for the joints of a skeleton.
    pub fn skeleton(self, skeleton: &Skeleton) -> Result<Skeleton, RigError> {
        skeleton.with_heads(skeleton.heads().iter().map(|&p| self.turn(p)).collect())
    }

    /// A rig as the network sees it, with its springs.
    ///
    /// # Errors
    /// None for a rig.
    pub fn rig(self, rig: &Rig) -> Result<Rig, RigError> {
        if self == Self::Y {
            return Ok(rig.clone());
        }
        let (skeleton, mesh) = (self.skeleton(rig.skeleton())?, self.mesh(rig.mesh())?);
        Rig::new(skeleton, mesh, rig.weights().clone())?
            .with_humanoid(rig.humanoid().clone())?
            .with_springs(self.springs(rig.springs())?)
    }

    /// Springs as the network sees them: where they end, where gravity pulls them and what stops them turn with their rig.
    fn springs(self, springs: &Springs) -> Result<Springs, RigError> {
        let (mut springs, mut colliders, groups) = springs.clone().into_parts();
        for own in springs.iter_mut().flat_map(|spring| &mut spring.joints) {
            own.tail = own.tail.map(|p| self.turn(p));
            own.swing.gravity_direction = self.turn(own.swing.gravity_direction);
        }
        for own in &mut colliders {
            own.shape = match own.shape {
                Shape::Sphere { center, radius } => Shape::Sphere { center: self.turn(center), radius },
                Shape::Capsule { from, to, radius } => {
                    Shape::Capsule { from: self.turn(from), to: self.turn(to), radius }
                }
            };
        }
        Springs::new(springs, colliders, groups)
    }

    /// A clip of a rig as the network sees it.
    ///
    /// # Errors
    /// None for a clip.
    pub fn clip(self, clip: &Clip) -> Result<Clip, RigError> {
        // Of a map its columns: where it takes the axes that the network sees is the turn of where it takes those of
        // the rig that lie there.
        let turned = |m: &JointMap| match self {
            Self::Y => *m,
            Self::Z => [self.turn(m[0]), self.turn(m[2]).map(|x| -x), self.turn(m[1]), self.turn(m[3])],
        };
        Clip::new(clip.name().into(), clip.rate(), clip.joints(), clip.maps().iter().map(turned).collect())
    }

    /// What the network sees as it is shown to people: y up again.
    ///
    /// # Errors
    /// None for a rig.
    pub fn upright(self, rig: &Rig) -> Result<Rig, RigError> {
        let mesh = rig.mesh().with_positions(rig.mesh().positions().iter().map(|&p| self.back(p)).collect())?;
        Rig::new(self.upright_skeleton(rig.skeleton())?, mesh, rig.weights().clone())
    }

    /// As [`Self::upright`].
    ///
    /// # Errors
    /// None for a skeleton.
    pub fn upright_skeleton(self, skeleton: &Skeleton) -> Result<Skeleton, RigError> {
        skeleton.with_heads(skeleton.heads().iter().map(|&p| self.back(p)).collect())
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, SkinWeights};

    use super::*;

    #[test]
    fn what_is_up_comes_to_lie_along_z_and_back() {
        assert_eq!(Up::Z.turn([1.0, 2.0, 3.0]), [1.0, -3.0, 2.0]);
        assert_eq!(Up::Z.back(Up::Z.turn([1.0, 2.0, 3.0])), [1.0, 2.0, 3.0]);
        assert_eq!(Up::Y.turn([1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
        let joint = Joint { name: "a".into(), parent: None, head: [0.1, 0.2, 0.3] };
        let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
        let rig =
            Rig::new(Skeleton::new(vec![joint]).unwrap(), crate::tokenrig::testing::tetrahedron(), weights).unwrap();
        assert_eq!(Up::Z.rig(&rig).unwrap().skeleton().heads(), [[0.1, -0.3, 0.2]]);
        let shown = Up::Z.upright(&Up::Z.rig(&rig).unwrap()).unwrap();
        assert_eq!(shown.mesh().positions(), rig.mesh().positions());
        assert_eq!(shown.skeleton().heads(), rig.skeleton().heads());
        // A turned rig in a turned clip stands where the rig in the clip does, turned.
        let map = [[0.5, 0.1, 0.2], [0.3, -0.7, 0.4], [0.6, 0.9, 1.1], [1.0, 2.0, 3.0]];
        let clip = Clip::new("c".into(), 30.0, 1, vec![map]).unwrap();
        let posed = |rig: &Rig, clip: &Clip| riglab_core::skin(rig, &clip.frame(0)).unwrap();
        let turned = posed(&Up::Z.rig(&rig).unwrap(), &Up::Z.clip(&clip).unwrap());
        for (turned, at) in turned.iter().zip(posed(&rig, &clip)) {
            assert!(turned.iter().zip(Up::Z.turn(at)).all(|(a, b)| (a - b).abs() < 1e-6), "{turned:?} {at:?}");
        }
        assert_eq!(Up::Y.clip(&clip).unwrap(), clip);
    }

    #[test]
    fn springs_turn_with_their_rig() {
        use riglab_core::{Collider, JointId, Spring, SpringJoint, Swing};
        let joint = Joint { name: "tail".into(), parent: None, head: [0.0; 3] };
        let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
        let swing = Swing { gravity_power: 1.0, ..Swing::default() };
        let joints = vec![SpringJoint { joint: JointId(0), tail: Some([0.0, 0.5, 0.25]), swing }];
        let spring = Spring { name: "tail".into(), joints, groups: vec![0], center: None };
        let ball = Shape::Sphere { center: [0.0, 1.0, 0.0], radius: 0.1 };
        let rod = Shape::Capsule { from: [0.0; 3], to: [0.0, 1.0, 2.0], radius: 0.2 };
        let colliders = [ball, rod].map(|shape| Collider { joint: JointId(0), shape }).to_vec();
        let rig = Rig::new(Skeleton::new(vec![joint]).unwrap(), crate::tokenrig::testing::tetrahedron(), weights)
            .and_then(|rig| rig.with_springs(Springs::new(vec![spring], colliders, vec![vec![0, 1]])?))
            .unwrap();
        let turned = Up::Z.rig(&rig).unwrap();
        let own = turned.springs().springs()[0].joints[0];
        assert_eq!((own.tail, own.swing.gravity_direction), (Some([0.0, -0.25, 0.5]), [0.0, 0.0, -1.0]));
        assert_eq!((own.swing.gravity_power, turned.springs().stops(0).count()), (1.0, 2));
        let shapes: Vec<Shape> = turned.springs().colliders().iter().map(|c| c.shape).collect();
        assert_eq!(shapes[0], Shape::Sphere { center: [0.0, 0.0, 1.0], radius: 0.1 });
        assert_eq!(shapes[1], Shape::Capsule { from: [0.0; 3], to: [0.0, -2.0, 1.0], radius: 0.2 });
    }
}
