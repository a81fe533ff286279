//! Spring bones: joints that swing behind the motion of the body, and what they bump into.

use serde::{Deserialize, Serialize};

use crate::{JointId, RigError, Similarity, Skeleton, Vec3};

/// How a joint swings; the attributes of VRM 1.0's `VRMC_springBone`, which UniRig predicts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Swing {
    /// Pull back to the rest direction; 0 and above.
    pub stiffness: f32,
    /// Share of the velocity lost in a step, 0 to 1.
    pub drag: f32,
    /// Strength of gravity.
    pub gravity_power: f32,
    /// Where gravity pulls, in the rig's axes.
    pub gravity_direction: Vec3,
    /// Radius of the ball at the tail that bumps into colliders, in the rig's units.
    pub hit_radius: f32,
}

impl Default for Swing {
    /// What VRM 1.0 takes for absent values.
    fn default() -> Self {
        Self { stiffness: 1.0, drag: 0.5, gravity_power: 0.0, gravity_direction: [0.0, -1.0, 0.0], hit_radius: 0.0 }
    }
}

/// A joint of a spring.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpringJoint {
    /// Which one.
    pub joint: JointId,
    /// Where the end that swings is at rest; `None` for a joint that only marks the tail of the one
    /// before it.
    pub tail: Option<Vec3>,
    /// How it swings.
    pub swing: Swing,
}

/// Joints that swing together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spring {
    /// What the source calls it; may be empty.
    pub name: String,
    /// Its joints, parents before children. Not always one chain: VRM 0.x groups several.
    pub joints: Vec<SpringJoint>,
    /// Which groups of colliders stop it, each once.
    pub groups: Vec<usize>,
    /// The joint whose motion it does not feel; `None` for none.
    pub center: Option<JointId>,
}

/// Something that springs do not enter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Collider {
    /// The joint it moves with.
    pub joint: JointId,
    /// Its shape at rest.
    pub shape: Shape,
}

/// A shape at rest, in the rig's axes and units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// All points within `radius` of `center`.
    Sphere {
        /// Its middle.
        center: Vec3,
        /// 0 and above.
        radius: f32,
    },
    /// All points within `radius` of the segment from `from` to `to`.
    Capsule {
        /// One end.
        from: Vec3,
        /// The other.
        to: Vec3,
        /// 0 and above.
        radius: f32,
    },
}

/// The springs of a rig and what stops them. No joint is in two springs, or twice in one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct Springs {
    springs: Vec<Spring>,
    colliders: Vec<Collider>,
    groups: Vec<Vec<usize>>,
}

/// As stored, before it is checked.
#[derive(Deserialize)]
struct Unchecked {
    springs: Vec<Spring>,
    colliders: Vec<Collider>,
    groups: Vec<Vec<usize>>,
}

impl TryFrom<Unchecked> for Springs {
    type Error = RigError;

    fn try_from(Unchecked { springs, colliders, groups }: Unchecked) -> Result<Self, RigError> {
        Self::new(springs, colliders, groups)
    }
}

impl Springs {
    /// Checks all but the joints' numbers, which [`crate::Rig::with_springs`] does.
    ///
    /// # Errors
    /// [`RigError::BadSpring`] or [`RigError::BadCollider`] with what is wrong.
    pub fn new(springs: Vec<Spring>, colliders: Vec<Collider>, groups: Vec<Vec<usize>>) -> Result<Self, RigError> {
        let mut seen = std::collections::HashSet::new();
        for (number, spring) in springs.iter().enumerate() {
            let bad = |what| Err(RigError::BadSpring { spring: number, what });
            if spring.joints.is_empty() {
                return bad("no joints");
            }
            if spring.joints.iter().any(|j| !seen.insert(j.joint)) {
                return bad("a joint that is in a spring already");
            }
            if !spring.joints.iter().all(|j| j.swing.is_sound() && j.tail.iter().flatten().all(|x| x.is_finite())) {
                return bad("a value out of range");
            }
            if !distinct_below(&spring.groups, groups.len()) {
                return bad("a group of colliders that does not exist or comes twice");
            }
        }
        if let Some(group) = groups.iter().position(|g| !distinct_below(g, colliders.len())) {
            return Err(RigError::BadColliderGroup(group));
        }
        match colliders.iter().position(|c| !c.shape.is_sound()) {
            Some(collider) => Err(RigError::BadCollider { collider, what: "a shape that is not finite" }),
            None => Ok(Self { springs, colliders, groups }),
        }
    }

    /// The springs.
    pub fn springs(&self) -> &[Spring] {
        &self.springs
    }

    /// What they do not enter.
    pub fn colliders(&self) -> &[Collider] {
        &self.colliders
    }

    /// The colliders of each group, each once.
    pub fn groups(&self) -> &[Vec<usize>] {
        &self.groups
    }

    /// What stops a spring.
    pub fn stops(&self, spring: usize) -> impl Iterator<Item = &Collider> {
        self.springs[spring].groups.iter().flat_map(|&g| &self.groups[g]).map(|&c| &self.colliders[c])
    }

    /// Springs, colliders and their groups, as [`Self::new`] takes them.
    pub fn into_parts(self) -> (Vec<Spring>, Vec<Collider>, Vec<Vec<usize>>) {
        (self.springs, self.colliders, self.groups)
    }

    /// The same over joints that got new numbers, `joint_of` by old number.
    ///
    /// # Panics
    /// When there is no new number for a joint.
    pub fn renumbered(mut self, joint_of: impl Fn(JointId) -> JointId) -> Self {
        for spring in &mut self.springs {
            spring.joints.iter_mut().for_each(|j| j.joint = joint_of(j.joint));
            spring.joints.sort_unstable_by_key(|j| j.joint);
            spring.center = spring.center.map(&joint_of);
        }
        self.colliders.iter_mut().for_each(|c| c.joint = joint_of(c.joint));
        self
    }

    /// Whether there are neither springs nor colliders.
    pub fn is_empty(&self) -> bool {
        self.springs.is_empty() && self.colliders.is_empty()
    }

    /// How each joint of a skeleton of `joints` swings; `None` for those that do not.
    pub fn by_joint(&self, joints: usize) -> Vec<Option<SpringJoint>> {
        let mut all = vec![None; joints];
        for own in self.springs.iter().flat_map(|s| &s.joints).filter(|j| j.tail.is_some()) {
            all[own.joint.index()] = Some(*own);
        }
        all
    }

    /// Whether all joints are in the skeleton, and parents before children.
    pub(crate) fn check(&self, skeleton: &Skeleton) -> Result<(), RigError> {
        let count = skeleton.len();
        for (number, spring) in self.springs.iter().enumerate() {
            let all = spring.joints.iter().map(|j| j.joint).chain(spring.center);
            if all.clone().any(|j| j.index() >= count) {
                return Err(RigError::BadSpring { spring: number, what: "a joint that does not exist" });
            }
            if spring.joints.windows(2).any(|w| w[0].joint > w[1].joint) {
                return Err(RigError::BadSpring { spring: number, what: "joints that are not in their order" });
            }
        }
        match self.colliders.iter().position(|c| c.joint.index() >= count) {
            Some(collider) => Err(RigError::BadCollider { collider, what: "a joint that does not exist" }),
            None => Ok(()),
        }
    }

    /// The same under a similarity.
    pub(crate) fn transformed(&self, map: Similarity) -> Self {
        let mut moved = self.clone();
        for joint in moved.springs.iter_mut().flat_map(|s| &mut s.joints) {
            joint.tail = joint.tail.map(|t| map.apply(t));
            joint.swing.hit_radius *= map.scale;
        }
        for collider in &mut moved.colliders {
            collider.shape = match collider.shape {
                Shape::Sphere { center, radius } => {
                    Shape::Sphere { center: map.apply(center), radius: map.scale * radius }
                }
                Shape::Capsule { from, to, radius } => {
                    Shape::Capsule { from: map.apply(from), to: map.apply(to), radius: map.scale * radius }
                }
            };
        }
        moved
    }
}

/// Whether all numbers are less than `count` and unlike.
fn distinct_below(numbers: &[usize], count: usize) -> bool {
    let mut sorted = numbers.to_vec();
    sorted.sort_unstable();
    sorted.windows(2).all(|w| w[0] < w[1]) && sorted.last().is_none_or(|&n| n < count)
}

impl Swing {
    fn is_sound(&self) -> bool {
        let Self { stiffness, drag, gravity_power, gravity_direction, hit_radius } = *self;
        let finite = [stiffness, gravity_power, hit_radius].into_iter().chain(gravity_direction).all(f32::is_finite);
        finite && stiffness >= 0.0 && hit_radius >= 0.0 && (0.0..=1.0).contains(&drag)
    }
}

impl Shape {
    fn is_sound(&self) -> bool {
        let (points, radius) = match *self {
            Self::Sphere { center, radius } => ([center; 2], radius),
            Self::Capsule { from, to, radius } => ([from, to], radius),
        };
        points.as_flattened().iter().all(|x| x.is_finite()) && radius.is_finite() && radius >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::tests::small;

    fn spring(joints: &[u16]) -> Spring {
        let joint = |&j: &u16| SpringJoint { joint: JointId(j), tail: Some([0.0, 5.0, 0.0]), swing: Swing::default() };
        Spring { joints: joints.iter().map(joint).collect(), ..Spring::default() }
    }

    fn ball(joint: u16) -> Collider {
        Collider { joint: JointId(joint), shape: Shape::Sphere { center: [0.0, 1.0, 0.0], radius: 0.5 } }
    }

    #[test]
    fn springs_move_and_scale_with_their_rig() {
        let springs =
            Springs::new(vec![Spring { groups: vec![0], ..spring(&[1]) }], vec![ball(0)], vec![vec![0]]).unwrap();
        let rig = small().with_springs(springs).unwrap();
        let moved = rig.transformed(Similarity { scale: 2.0, shift: [1.0, 0.0, 0.0] }).unwrap();
        assert_eq!(moved.springs().springs()[0].joints[0].tail, Some([1.0, 10.0, 0.0]));
        assert_eq!(moved.springs().stops(0).count(), 1);
        assert_eq!(moved.springs().colliders()[0].shape, Shape::Sphere { center: [1.0, 2.0, 0.0], radius: 1.0 });
        let stored = serde_json::to_string(rig.springs()).unwrap();
        assert_eq!(&serde_json::from_str::<Springs>(&stored).unwrap(), rig.springs());
        assert!(serde_json::from_str::<Springs>(&stored.replace("\"groups\":[0]", "\"groups\":[7]")).is_err());
        assert!(rig.springs().by_joint(2)[1].is_some() && rig.springs().by_joint(2)[0].is_none());
    }

    #[test]
    fn each_fault_has_its_error() {
        let refused = |springs: Vec<Spring>, colliders: Vec<Collider>, groups: &[usize]| {
            let springs = Springs::new(springs, colliders, vec![groups.to_vec()]);
            springs.and_then(|s| small().with_springs(s)).unwrap_err().to_string()
        };
        let stopped = |by: &[usize]| Spring { groups: by.to_vec(), ..spring(&[1]) };
        let mut wild = spring(&[1]);
        wild.joints[0].swing.drag = 1.5;
        let none: &[usize] = &[];
        for (text, springs, colliders, groups) in [
            ("no joints", vec![spring(&[])], vec![], none),
            ("in a spring already", vec![spring(&[1]), spring(&[1])], vec![], none),
            ("out of range", vec![wild], vec![], none),
            ("a group of colliders", vec![stopped(&[1])], vec![], none),
            ("a group of colliders", vec![stopped(&[0, 0])], vec![], none),
            ("collider group 0", vec![], vec![ball(0)], &[0, 0]),
            ("does not exist", vec![spring(&[2])], vec![], none),
            ("does not exist", vec![], vec![ball(7)], none),
            ("in their order", vec![spring(&[1, 0])], vec![], none),
        ] {
            let error = refused(springs, colliders, groups);
            assert!(error.contains(text), "{error} / {text}");
        }
    }
}
