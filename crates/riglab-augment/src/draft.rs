//! A rig taken apart, for changes that would be checked and copied one by one otherwise.

use glam::{Affine3A, Vec3A};
use riglab_core::{
    Bounds, Clip, Collider, HumanBone, Humanoid, Joint, JointId, JointMap, Mesh, Rig, RigError, Similarity, Skeleton,
    SkinWeights, Spring, Springs, Vec3,
};

/// A rig whose parts change in place. Every step of this crate leaves it such that [`Draft::close`]
/// gives a rig again.
pub struct Draft {
    pub(crate) names: Vec<String>,
    pub(crate) parents: Vec<Option<JointId>>,
    pub(crate) heads: Vec<Vec3>,
    pub(crate) positions: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) offsets: Vec<u32>,
    pub(crate) joints: Vec<u16>,
    pub(crate) weights: Vec<f32>,
    pub(crate) humanoid: Vec<(HumanBone, JointId)>,
    pub(crate) springs: Vec<Spring>,
    pub(crate) colliders: Vec<Collider>,
    pub(crate) groups: Vec<Vec<usize>>,
    pub(crate) normals: Option<Normals>,
    pub(crate) motion: Motion,
}

/// Unit normals that are not those of the geometry: they carry noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Normals {
    /// At the vertices.
    pub vertices: Vec<Vec3>,
    /// Of the triangles.
    pub triangles: Vec<Vec3>,
}

/// Where the rig's joints come from and where they went, for what was recorded of the rig before.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Which joint of the first rig each joint was.
    pub origins: Vec<JointId>,
    /// What took each joint, with all it holds, from its old rest to its new one.
    pub rest: Vec<Affine3A>,
    /// What took the space around the rig along.
    pub world: Affine3A,
}

/// A rig with what augmentation knows of it besides.
#[derive(Clone, Debug, PartialEq)]
pub struct Augmented {
    /// The rig.
    pub rig: Rig,
    /// Normals with noise; `None` where those of the geometry hold.
    pub normals: Option<Normals>,
    /// From the first rig to this one.
    pub motion: Motion,
}

/// Coordinates beyond this are scaled down before anything is done, so that no step overflows.
const HUGE: f32 = 1e15;

impl Draft {
    /// Takes a rig apart. One of astronomic size is scaled into [-1, 1]³ first.
    pub fn open(rig: Rig) -> Self {
        let (skeleton, mesh, weights, humanoid, springs) = rig.into_all();
        let (names, parents, heads) = skeleton.into_parts();
        let (positions, triangles) = mesh.into_parts();
        let (offsets, joints, weights) = weights.into_parts();
        let (springs, colliders, groups) = springs.into_parts();
        let motion = Motion {
            origins: (0..heads.len() as u16).map(JointId).collect(),
            rest: vec![Affine3A::IDENTITY; heads.len()],
            world: Affine3A::IDENTITY,
        };
        let humanoid = humanoid.iter().collect();
        let normals = None;
        let mut draft = Self {
            names,
            parents,
            heads,
            positions,
            triangles,
            offsets,
            joints,
            weights,
            humanoid,
            springs,
            colliders,
            groups,
            normals,
            motion,
        };
        if !draft.is_moderate() {
            let map = Similarity::into_cube(draft.bounds());
            draft.transform(Affine3A::from_mat3_translation(
                glam::Mat3::from_diagonal(glam::Vec3::splat(map.scale)),
                map.shift.into(),
            ));
        }
        draft
    }

    /// Puts the rig together again.
    ///
    /// # Errors
    /// Whatever the constructors of [`riglab_core`] find; the steps of this crate give them no reason.
    pub fn close(self) -> Result<Augmented, RigError> {
        let joints = self.names.into_iter().zip(self.parents).zip(self.heads);
        let joints = joints.map(|((name, parent), head)| Joint { name, parent, head }).collect();
        let mesh = Mesh::new(self.positions, self.triangles)?;
        let weights = SkinWeights::new(self.offsets, self.joints, self.weights)?;
        let mut humanoid = Humanoid::default();
        for (bone, joint) in self.humanoid {
            humanoid.insert(bone, joint);
        }
        let rig = Rig::new(Skeleton::new(joints)?, mesh, weights)?
            .with_humanoid(humanoid)?
            .with_springs(Springs::new(self.springs, self.colliders, self.groups)?)?;
        Ok(Augmented { rig, normals: self.normals, motion: self.motion })
    }

    /// How many joints.
    pub fn joints(&self) -> usize {
        self.heads.len()
    }

    /// How many vertices.
    pub fn vertices(&self) -> usize {
        self.positions.len()
    }

    /// The box around vertices and joints.
    pub(crate) fn bounds(&self) -> Bounds {
        Bounds::of(self.positions.iter().chain(&self.heads).copied()).expect("a rig has a vertex")
    }

    /// Whether no coordinate is so large that steps might overflow.
    fn is_moderate(&self) -> bool {
        moderate(&self.positions) && moderate(&self.heads) && self.springs_are_moderate()
    }

    /// The joints of a vertex and their weights.
    pub(crate) fn row(&self, vertex: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let span = self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize;
        self.joints[span.clone()].iter().zip(&self.weights[span]).map(|(&j, &w)| (usize::from(j), w))
    }

    /// The sum of weights of each joint.
    pub(crate) fn held(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.joints()];
        for (&j, &w) in self.joints.iter().zip(&self.weights) {
            sums[usize::from(j)] += f64::from(w);
        }
        sums
    }

    /// The children of each joint.
    pub(crate) fn children(&self) -> Vec<Vec<usize>> {
        let mut children = vec![Vec::new(); self.joints()];
        for (joint, parent) in self.parents.iter().enumerate() {
            if let Some(parent) = parent {
                children[parent.index()].push(joint);
            }
        }
        children
    }
}

/// Whether all coordinates are finite and of a size that no step makes overflow.
pub(crate) fn moderate(points: &[Vec3]) -> bool {
    points.as_flattened().iter().all(|x| x.abs() <= HUGE)
}

impl Augmented {
    /// A clip of the first rig as a clip of this one: the motion of the joints that are left, about
    /// their new places at rest.
    ///
    /// # Errors
    /// [`RigError::BadClip`] for a clip of another rig.
    pub fn clip(&self, clip: &Clip) -> Result<Clip, RigError> {
        let Motion { origins, rest, world } = &self.motion;
        let back: Vec<Affine3A> = rest.iter().map(Affine3A::inverse).collect();
        let mut maps: Vec<JointMap> = Vec::with_capacity(clip.frames() * origins.len());
        if origins.iter().any(|j| j.index() >= clip.joints()) {
            return Err(RigError::BadClip { name: clip.name().into(), what: "fewer joints than the rig" });
        }
        for frame in 0..clip.frames() {
            let old = clip.frame(frame);
            maps.extend(origins.iter().zip(&back).map(|(origin, back)| {
                let Affine3A { matrix3: m, translation } = *world * old[origin.index()] * *back;
                [m.x_axis, m.y_axis, m.z_axis, translation].map(|column: Vec3A| column.into())
            }));
        }
        Clip::new(clip.name().into(), clip.rate(), origins.len(), maps)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use riglab_core::{Shape, SpringJoint, Swing};

    use super::*;

    /// A chain of five joints at x = 0, 1, 2, 3, 4 with a leaf on joint 1, and a strip of triangles whose
    /// vertices at x hold on to the joint there, those at x + 1/2 on to two. The leaf has no weight.
    pub(crate) fn chain() -> Rig {
        let joint = |(j, (parent, head)): (usize, (Option<u16>, Vec3))| Joint {
            name: format!("joint {j}"),
            parent: parent.map(JointId),
            head,
        };
        let at = |x: f32| [x, 0.0, 0.0];
        let joints = [(None, at(0.0)), (Some(0), at(1.0)), (Some(1), at(2.0)), (Some(2), at(3.0)), (Some(3), at(4.0))];
        let joints = joints.into_iter().chain([(Some(1), [1.0, 1.0, 0.0])]);
        let skeleton = Skeleton::new(joints.enumerate().map(joint).collect()).unwrap();
        let places = || (0..9).map(|k| 0.5 * k as f32).flat_map(|x| [(x, -0.5), (x, 0.5)]);
        let triangles = (0..8).flat_map(|k| [[2 * k, 2 * k + 2, 2 * k + 1], [2 * k + 1, 2 * k + 2, 2 * k + 3]]);
        let mesh = Mesh::new(places().map(|(x, y)| [x, y, 0.0]).collect(), triangles.collect()).unwrap();
        let row = |(x, _): (f32, f32)| [(x.floor() as u16, 1.0), (x.ceil() as u16, 1.0)];
        let weights = SkinWeights::normalized(places().map(row)).unwrap();
        let mut humanoid = Humanoid::default();
        for (bone, joint) in [("hips", 0), ("leftUpperLeg", 2), ("leftFoot", 4)] {
            assert!(humanoid.insert(bone.parse().unwrap(), JointId(joint)));
        }
        let swinging =
            |j: u16| SpringJoint { joint: JointId(j), tail: Some(at(f32::from(j) + 1.0)), swing: Swing::default() };
        let ball =
            |j: u16| Collider { joint: JointId(j), shape: Shape::Sphere { center: at(f32::from(j)), radius: 0.25 } };
        let hair = Spring {
            joints: vec![swinging(3), swinging(4)],
            groups: vec![0],
            center: Some(JointId(2)),
            ..Spring::default()
        };
        let springs = Springs::new(vec![hair], vec![ball(0), ball(2), ball(5)], vec![vec![0, 1, 2]]).unwrap();
        let rig = Rig::new(skeleton, mesh, weights).unwrap();
        rig.with_humanoid(humanoid).unwrap().with_springs(springs).unwrap()
    }

    pub(crate) fn after(step: impl FnOnce(&mut Draft)) -> Augmented {
        let mut draft = Draft::open(chain());
        step(&mut draft);
        draft.close().unwrap()
    }

    pub(crate) fn origins(done: &Augmented) -> Vec<u16> {
        done.motion.origins.iter().map(|j| j.0).collect()
    }

    #[test]
    fn taken_apart_and_put_together_it_is_the_same_rig() {
        assert_eq!(after(|_| ()).rig, chain());
    }

    #[test]
    fn a_rig_of_astronomic_size_is_scaled_first() {
        let (skeleton, mesh, weights) = chain().into_parts();
        let far = |p: &[Vec3]| p.iter().map(|p| p.map(|x| x * 5e37)).collect::<Vec<_>>();
        let (skeleton, mesh) =
            (skeleton.with_heads(far(skeleton.heads())).unwrap(), mesh.with_positions(far(mesh.positions())).unwrap());
        let done = Draft::open(Rig::new(skeleton, mesh, weights).unwrap()).close().unwrap();
        let x = |v: usize| done.rig.mesh().positions()[v][0];
        assert_eq!((x(0), x(16)), (-1.0, 1.0));
    }
}
