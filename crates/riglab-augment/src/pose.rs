//! A random pose as the new rest.

use glam::{Affine3A, Vec3A};
use riglab_core::JointId;
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::Draft;
use crate::rules::{Fault, inside, probability, range};
use crate::turn::{radians, rotation};

/// Turns every joint at random; the posed rig is at rest afterwards (SkinTokens, 4.1.2: probability
/// 0.5, 30 degrees; UniRig's motion: 60 degrees).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoseConfig {
    /// How often.
    pub probability: f32,
    /// Largest component of each joint's rotation vector, in degrees: about world axes, whatever the
    /// axes of the source's bones. 0 to 180.
    pub degrees: f32,
    /// Smallest and largest scale of each joint's part, which its children inherit. 0.5 to 2.
    pub scale: [f32; 2],
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self { probability: 0.0, degrees: 30.0, scale: [1.0, 1.0] }
    }
}

impl PoseConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("degrees", self.degrees, 0.0, 180.0)?;
        range("scale", self.scale, 0.5, 2.0)
    }

    /// Draws whether and how, and poses.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if !random.chance(self.probability) {
            return;
        }
        let angle = radians(self.degrees);
        let turns = (0..draft.joints()).map(|_| {
            let vector = std::array::from_fn(|_| random.within(-angle, angle));
            let scale = random.within(self.scale[0], self.scale[1]);
            Affine3A { matrix3: rotation(vector) * scale, translation: Vec3A::ZERO }
        });
        let turns: Vec<Affine3A> = turns.collect();
        pose(draft, &turns);
    }
}

/// Poses by a map for each joint: about its head, along the world's axes, before its parent's. For
/// bones with axes of their own, R, give R B R⁻¹ for the local map B. A pose that would reach beyond
/// all numbers, by scales that add up along a long chain, is not taken; gives back whether it was.
pub fn pose(draft: &mut Draft, local: &[Affine3A]) -> bool {
    let maps = kinematics(draft, local);
    maps.iter().all(|m| m.is_finite()) && draft.deform(&maps)
}

/// From rest to pose, by joint; parents come first.
fn kinematics(draft: &Draft, local: &[Affine3A]) -> Vec<Affine3A> {
    let mut maps: Vec<Affine3A> = Vec::with_capacity(local.len());
    for ((&head, parent), own) in draft.heads.iter().zip(&draft.parents).zip(local) {
        let head = Vec3A::from(head);
        let Affine3A { matrix3, translation } = *own;
        // T(head) own T(-head): exact at the head, unlike a product of maps.
        let about = Affine3A { matrix3, translation: head + translation - matrix3 * head };
        let above = parent.map_or(Affine3A::IDENTITY, |p: JointId| maps[p.index()]);
        maps.push(above * about);
    }
    maps
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::{after, chain};
    use crate::turn::about;

    #[test]
    fn vertices_joints_and_tails_turn_about_the_head() {
        let mut local = vec![Affine3A::IDENTITY; 6];
        local[3].matrix3 = about(2, 90.0);
        let done = after(|d| assert!(pose(d, &local)));
        let close = |a: [f32; 3], b: [f32; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
        assert!(close(done.rig.skeleton().head(JointId(4)), [3.0, 1.0, 0.0]));
        assert!(close(done.rig.mesh().positions()[16], [3.5, 1.0, 0.0]));
        assert!(close(done.rig.springs().springs()[0].joints[1].tail.unwrap(), [3.0, 2.0, 0.0]));
        assert_eq!(done.rig.skeleton().head(JointId(2)), [2.0, 0.0, 0.0]);
    }

    #[test]
    fn bones_keep_their_length() {
        let config = PoseConfig { probability: 1.0, degrees: 60.0, ..PoseConfig::default() };
        let rig = after(|d| config.apply(d, &mut stream(1, "test", &[]))).rig;
        let length = |rig: &riglab_core::Rig, a, b| {
            let [a, b] = [a, b].map(|j| Vec3A::from(rig.skeleton().head(JointId(j))));
            (a - b).length()
        };
        for (a, b) in [(0, 1), (1, 2), (2, 3), (3, 4), (1, 5)] {
            assert!((length(&rig, a, b) - 1.0).abs() < 1e-6);
        }
        assert_ne!(rig.skeleton(), chain().skeleton());
    }

    #[test]
    fn a_pose_beyond_all_numbers_is_not_taken() {
        let local = vec![Affine3A { matrix3: glam::Mat3A::IDENTITY * 1e12, translation: Vec3A::ZERO }; 6];
        assert_eq!(after(|d| assert!(!pose(d, &local))).rig, chain());
    }
}
