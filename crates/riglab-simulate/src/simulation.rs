//! A rig's springs in time.

use glam::{DAffine3, DMat3, DVec3};
use riglab_core::{Collider, Skeleton, Springs};
use thiserror::Error;

use crate::bone::{Bone, Hold, Lengths, Obstacle};
use crate::order::order;

/// Scales nearer to 1 than this are rounding.
const NO_SCALE: f64 = 1e-5;

/// A motion that cannot be followed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SimulationError {
    /// There is a map for each joint.
    #[error("a pose of {pose} joints for a skeleton of {joints}")]
    PoseLength {
        /// Joints of the pose.
        pose: usize,
        /// Joints of the skeleton.
        joints: usize,
    },
    /// Maps are finite.
    #[error("the pose of joint {0} is not finite")]
    NotFinite(usize),
    /// A step takes some time.
    #[error("a step of {0} seconds; it takes 0 or more")]
    BadStep(f64),
}

/// The springs of a rig in motion.
///
/// ```
/// use glam::DAffine3;
/// use riglab_core::{Joint, JointId, Skeleton, Spring, SpringJoint, Springs, Swing};
/// use riglab_simulate::Simulation;
///
/// let joint = |name: &str, parent, head| Joint { name: name.into(), parent, head };
/// let skeleton =
///     Skeleton::new(vec![joint("root", None, [0.0; 3]), joint("tail", Some(JointId(0)), [0.0, 1.0, 0.0])])?;
/// let swings = SpringJoint { joint: JointId(1), tail: Some([0.0, 2.0, 0.0]), swing: Swing::default() };
/// let springs = Springs::new(vec![Spring { joints: vec![swings], ..Spring::default() }], vec![], vec![])?;
///
/// let mut simulation = Simulation::new(&skeleton, &springs);
/// // The root jumps aside; the tail stays behind.
/// let aside = DAffine3::from_translation([1.0, 0.0, 0.0].into());
/// let maps = simulation.step(&[aside; 2], 1.0 / 60.0)?;
/// assert!(maps[1].transform_point3([0.0, 2.0, 0.0].into()).x < 0.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Simulation {
    parents: Vec<Option<usize>>,
    heads: Vec<DVec3>,
    /// The order in which joints are moved.
    order: Vec<u16>,
    bones: Vec<Option<Bone>>,
    /// Whether one above swings.
    carried: Vec<bool>,
    colliders: Vec<Collider>,
    /// The colliders as they stand, those that springs ask for.
    obstacles: Vec<Obstacle>,
    /// By joint, its colliders.
    carries: Vec<Vec<usize>>,
    lengths: Lengths,
    maps: Vec<DAffine3>,
}

impl Simulation {
    /// At rest. The springs are those of a rig with this skeleton ([`riglab_core::Rig::with_springs`] checks them);
    /// bones without length, and joints without tail, follow the motion.
    ///
    /// # Panics
    /// When a spring or collider names a joint that the skeleton does not have.
    pub fn new(skeleton: &Skeleton, springs: &Springs) -> Self {
        let count = skeleton.len();
        let parents: Vec<Option<usize>> = skeleton.parents().iter().map(|p| p.map(|p| p.index())).collect();
        let heads: Vec<DVec3> = skeleton.heads().iter().map(|h| glam::Vec3::from(*h).as_dvec3()).collect();
        let mut bones: Vec<Option<Bone>> = vec![None; count];
        for spring in springs.springs() {
            let stops: Vec<usize> = spring.groups.iter().flat_map(|&g| &springs.groups()[g]).copied().collect();
            for own in &spring.joints {
                let Some(tail) = own.tail else { continue };
                let joint = own.joint.index();
                let axis = glam::Vec3::from(tail).as_dvec3() - heads[joint];
                bones[joint] = Bone::new(axis, &own.swing, spring.center.map(|c| c.index()), stops.clone());
            }
        }
        let mut carried = vec![false; count];
        for joint in 0..count {
            carried[joint] = parents[joint].is_some_and(|p| carried[p] || bones[p].is_some());
        }
        let mut carries = vec![Vec::new(); count];
        for (number, collider) in springs.colliders().iter().enumerate() {
            carries[collider.joint.index()].push(number);
        }
        let mut made = Self {
            parents,
            heads,
            order: order(skeleton, springs),
            bones,
            carried,
            obstacles: springs.colliders().iter().map(|c| Obstacle::of(c, &DAffine3::IDENTITY)).collect(),
            colliders: springs.colliders().to_vec(),
            carries,
            lengths: Lengths::Rest,
            maps: vec![DAffine3::IDENTITY; count],
        };
        made.advance(&vec![DAffine3::IDENTITY; count], None);
        made
    }

    /// The same with other lengths of bones in motion.
    pub fn with_lengths(self, lengths: Lengths) -> Self {
        Self { lengths, ..self }
    }

    /// How many bones swing.
    pub fn swinging(&self) -> usize {
        self.bones.iter().flatten().count()
    }

    /// The maps from rest to pose, by joint, as the last step left them.
    pub fn maps(&self) -> &[DAffine3] {
        &self.maps
    }

    /// Forgets what was: the rig stands in a pose of the motion, and its springs are at rest there.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn reset(&mut self, motion: &[DAffine3]) -> Result<&[DAffine3], SimulationError> {
        self.check(motion)?;
        self.advance(motion, None);
        Ok(&self.maps)
    }

    /// Goes on by `seconds`, to the pose of the motion given by the map of each joint from rest; gives the maps
    /// with springs. In no time nothing swings, but all is carried along.
    ///
    /// # Errors
    /// Unless there is a finite map for each joint and the time is 0 or more.
    pub fn step(&mut self, motion: &[DAffine3], seconds: f64) -> Result<&[DAffine3], SimulationError> {
        self.check(motion)?;
        if !(seconds >= 0.0 && seconds.is_finite()) {
            return Err(SimulationError::BadStep(seconds));
        }
        self.advance(motion, Some(seconds));
        Ok(&self.maps)
    }

    fn check(&self, motion: &[DAffine3]) -> Result<(), SimulationError> {
        if motion.len() != self.maps.len() {
            return Err(SimulationError::PoseLength { pose: motion.len(), joints: self.maps.len() });
        }
        match motion.iter().position(|map| !map.is_finite()) {
            Some(joint) => Err(SimulationError::NotFinite(joint)),
            None => Ok(()),
        }
    }

    /// Moves all joints; without a time, springs are put to rest.
    fn advance(&mut self, motion: &[DAffine3], seconds: Option<f64>) {
        for at in 0..self.order.len() {
            let joint = usize::from(self.order[at]);
            let map = self.moved(joint, motion, seconds);
            if map.is_finite() {
                self.maps[joint] = map;
            }
            for &number in &self.carries[joint] {
                self.obstacles[number] = Obstacle::of(&self.colliders[number], &self.maps[joint]);
            }
        }
    }

    /// The map of a joint whose parent was moved.
    fn moved(&mut self, joint: usize, motion: &[DAffine3], seconds: Option<f64>) -> DAffine3 {
        let own = motion[joint];
        let parent = self.parents[joint];
        let above = parent.map_or(DAffine3::IDENTITY, |p| self.maps[p]);
        // As its parent carries it.
        let carried = match parent {
            Some(p) if self.carried[joint] => inverse(&motion[p]).map_or(above, |back| above * (back * own)),
            _ => own,
        };
        let head = self.heads[joint];
        let Some(bone) = &mut self.bones[joint] else { return carried };
        let (from_center, to_center) = match bone.center {
            Some(center) => {
                let map = self.maps[center];
                inverse(&map).map_or((DAffine3::IDENTITY, DAffine3::IDENTITY), |back| (map, back))
            }
            None => (DAffine3::IDENTITY, DAffine3::IDENTITY),
        };
        let hold = Hold {
            head: carried.transform_point3(head),
            parent: above.matrix3,
            scale: scale(&above.matrix3, &carried.matrix3),
            from_center,
            to_center,
        };
        match seconds {
            None => bone.place(&hold),
            Some(seconds) if seconds > 0.0 => bone.step(&hold, seconds, self.lengths, &self.obstacles),
            Some(_) => {}
        }
        bone.map(&hold, head)
    }
}

/// The map back; `None` of one that is flat.
fn inverse(map: &DAffine3) -> Option<DAffine3> {
    Some(map.inverse()).filter(|back| back.is_finite())
}

/// By how much one map is larger than another.
fn scale(of: &DMat3, than: &DMat3) -> f64 {
    let scale = libm::cbrt((than.determinant() / of.determinant()).abs());
    if scale.is_finite() && (scale - 1.0).abs() > NO_SCALE { scale } else { 1.0 }
}

#[cfg(test)]
pub(crate) mod tests;
