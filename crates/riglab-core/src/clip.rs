//! Motion: poses of a skeleton in time.

use glam::{Affine3A, Mat3A, Vec3A};

use crate::{RigError, Similarity, Vec3};

/// An affine map: where it takes the axes (without shift), then where it takes the origin.
pub type JointMap = [Vec3; 4];

/// A motion sampled at a steady rate: for each frame the map of every joint from rest to pose, which
/// is all that skinning needs. Maps may turn, shift and scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    name: String,
    rate: f32,
    joints: usize,
    maps: Vec<JointMap>,
}

impl Clip {
    /// A clip of `joints` joints at `rate` frames a second, maps frame by frame in joint order.
    ///
    /// # Errors
    /// [`RigError::BadClip`] for a rate that is not above 0, maps that are not whole frames or not
    /// finite.
    pub fn new(name: String, rate: f32, joints: usize, maps: Vec<JointMap>) -> Result<Self, RigError> {
        let what = if !(rate > 0.0 && rate.is_finite()) {
            "a rate that is not above 0"
        } else if joints == 0 || maps.is_empty() || !maps.len().is_multiple_of(joints) {
            "maps that are not whole frames"
        } else if !maps.as_flattened().as_flattened().iter().all(|x| x.is_finite()) {
            "a map that is not finite"
        } else {
            return Ok(Self { name, rate, joints, maps });
        };
        Err(RigError::BadClip { name, what })
    }

    /// What the source calls it; may be empty.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Frames a second.
    pub fn rate(&self) -> f32 {
        self.rate
    }

    /// How many joints move.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// How many frames; at least 1.
    pub fn frames(&self) -> usize {
        self.maps.len() / self.joints
    }

    /// All maps, frame by frame.
    pub fn maps(&self) -> &[JointMap] {
        &self.maps
    }

    /// The maps of a frame in joint order, for [`crate::skin()`].
    pub fn frame(&self, frame: usize) -> Vec<Affine3A> {
        let own = &self.maps[frame * self.joints..][..self.joints];
        let affine = |m: &JointMap| Affine3A {
            matrix3: Mat3A::from_cols(m[0].into(), m[1].into(), m[2].into()),
            translation: Vec3A::from(m[3]),
        };
        own.iter().map(affine).collect()
    }

    /// The same motion of the rig under a similarity.
    ///
    /// # Errors
    /// [`RigError::BadClip`] where it is taken beyond the greatest numbers.
    pub fn transformed(&self, map: Similarity) -> Result<Self, RigError> {
        // s (A p + t) + d, of p = (q - d) / s, is A q + s t + d - A d.
        let shift = Vec3A::from(map.shift);
        let moved = |m: &JointMap| {
            let matrix = Mat3A::from_cols(m[0].into(), m[1].into(), m[2].into());
            let t = map.scale * Vec3A::from(m[3]) + shift - matrix * shift;
            [m[0], m[1], m[2], t.into()]
        };
        Self::new(self.name.clone(), self.rate, self.joints, self.maps.iter().map(moved).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::tests::small;
    use crate::skin;

    const STILL: JointMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];

    #[test]
    fn a_moved_rig_moves_alike() {
        let rig = small();
        // The tip turns by 90 degrees about z and shifts.
        let turned = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 2.0, 3.0]];
        let clip = Clip::new("nod".into(), 30.0, 2, vec![STILL, STILL, STILL, turned]).unwrap();
        assert_eq!((clip.frames(), skin(&rig, &clip.frame(0)).unwrap()), (2, rig.mesh().positions().to_vec()));
        let map = Similarity { scale: 0.5, shift: [3.0, -1.0, 2.0] };
        let (small, large) = (rig.transformed(map).unwrap(), clip.transformed(map).unwrap());
        let posed = skin(&rig, &clip.frame(1)).unwrap();
        for (a, b) in skin(&small, &large.frame(1)).unwrap().iter().zip(posed) {
            assert!((0..3).all(|k| (a[k] - map.apply(b)[k]).abs() < 1e-5), "{a:?} {b:?}");
        }
    }

    #[test]
    fn each_fault_has_its_error() {
        let refused = |rate: f32, joints: usize, maps: Vec<JointMap>| {
            Clip::new("c".into(), rate, joints, maps).unwrap_err().to_string()
        };
        assert!(refused(0.0, 1, vec![STILL]).contains("rate"));
        assert!(refused(1.0, 2, vec![STILL]).contains("whole frames"));
        assert!(refused(1.0, 1, vec![]).contains("whole frames"));
        assert!(refused(1.0, 1, vec![[[f32::NAN; 3]; 4]]).contains("finite"));
        let far = Similarity { scale: f32::MAX, shift: [f32::MAX; 3] };
        let moved = Clip::new("c".into(), 1.0, 1, vec![[[2.0; 3], [2.0; 3], [2.0; 3], [2.0; 3]]]).unwrap();
        assert!(moved.transformed(far).is_err());
    }
}
