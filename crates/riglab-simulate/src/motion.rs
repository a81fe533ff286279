//! Motions for rigs that have none: the whole body is moved, so that what swings has a reason to.

use glam::{DMat3, DQuat, DVec3};
use riglab_core::{Clip, JointMap, Rig};
use riglab_random::{Draw, stream};

/// Most frames of a motion that is made.
const MOST_FRAMES: f64 = 1e6;
/// The share of the time in which the body moves; then it stands, and the springs come to rest.
const MOVING: f64 = 0.7;

/// What a body does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionKind {
    /// To and fro along the ground.
    Shake,
    /// About the axis that points up.
    Turn,
    /// Off the ground.
    Hop,
}

impl MotionKind {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 3] = [("shake", Self::Shake), ("turn", Self::Turn), ("hop", Self::Hop)];

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// A motion to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// What.
    pub kind: MotionKind,
    /// For how long.
    pub seconds: f64,
    /// Frames a second; above 0.
    pub rate: f32,
    /// How fast, how far and which way is drawn from it.
    pub seed: u64,
}

/// The motion for a rig, in sizes of that rig. It begins and ends at rest; in the last three tenths the body stands.
///
/// At least one frame; a million at most.
pub fn generate(rig: &Rig, motion: &Motion) -> Clip {
    let Motion { kind, seconds, rate, seed } = *motion;
    let bounds = rig.bounds();
    let size = f64::from(bounds.diagonal());
    let mut draw = stream(seed, "motion", &[kind as u64]);
    let mut pick = |low: f32, high: f32| f64::from(draw.within(low, high));
    // Times a second, of two waves that do not meet; a share of the size; a direction.
    let (slow, fast, far, way) = (pick(0.6, 1.0), pick(1.4, 2.2), pick(0.8, 1.2), pick(0.0, 1.0));
    let (rate, frames) = match f64::from(rate) {
        r if r > 0.0 && r.is_finite() => (r, (seconds * r).clamp(0.0, MOST_FRAMES).round() as usize + 1),
        _ => (30.0, 1),
    };
    let wave = |time: f64, often: f64| libm::sin(std::f64::consts::TAU * often * time);
    let head = glam::Vec3::from(rig.skeleton().heads()[0]).as_dvec3();
    let map = |frame: usize| -> JointMap {
        let time = frame as f64 / rate;
        let strength = envelope(time / (seconds * MOVING));
        let (mut turn, mut shift) = (0.0, DVec3::ZERO);
        match kind {
            MotionKind::Shake => {
                let angle = std::f64::consts::TAU * way;
                let (along, across) = (wave(time, slow), 0.4 * wave(time, fast));
                let (sin, cos) = (libm::sin(angle), libm::cos(angle));
                shift = 0.08
                    * far
                    * size
                    * strength
                    * DVec3::new(cos * along - sin * across, 0.0, sin * along + cos * across);
            }
            MotionKind::Turn => turn = 1.2 * far * strength * (wave(time, slow) + 0.3 * wave(time, fast)),
            MotionKind::Hop => {
                // A body in the air falls as a stone does.
                let phase = (time * slow * 2.0).fract();
                shift.y = 0.12 * far * size * strength * 4.0 * phase * (1.0 - phase);
                turn = 0.3 * far * strength * wave(time, slow * way);
            }
        }
        let rotation = DMat3::from_quat(DQuat::from_xyzw(0.0, libm::sin(0.5 * turn), 0.0, libm::cos(0.5 * turn)));
        let translation = head + shift - rotation * head;
        [rotation.x_axis, rotation.y_axis, rotation.z_axis, translation].map(|v| v.as_vec3().into())
    };
    let joints = rig.skeleton().len();
    let maps = (0..frames).flat_map(|frame| std::iter::repeat_n(map(frame), joints)).collect();
    let clip = Clip::new(kind.name().into(), rate as f32, joints, maps);
    clip.unwrap_or_else(|_| still(kind, rate as f32, joints))
}

/// Where a rig is as large as numbers go, nothing can be moved.
fn still(kind: MotionKind, rate: f32, joints: usize) -> Clip {
    let rest: JointMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
    Clip::new(kind.name().into(), rate, joints, vec![rest; joints]).expect("a frame of finite maps")
}

/// From 0 up to 1 and back, smoothly, over 0 to 1; 0 outside.
fn envelope(t: f64) -> f64 {
    let smooth = |x: f64| {
        let x = x.clamp(0.0, 1.0);
        x * x * (3.0 - 2.0 * x)
    };
    if t.is_finite() { smooth(t / 0.2) * smooth((1.0 - t) / 0.1) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::tests::creature;

    #[test]
    fn motions_begin_and_end_at_rest_and_are_those_of_their_seed() {
        let rig = creature();
        for (name, kind) in MotionKind::ALL {
            let motion = Motion { kind, seconds: 3.0, rate: 24.0, seed: 5 };
            let clip = generate(&rig, &motion);
            assert_eq!((clip.name(), clip.frames()), (name, 73));
            let rest = clip.maps()[0];
            assert!(
                rest.as_flattened().iter().zip(clip.maps()[72 * clip.joints()].as_flattened()).all(|(a, b)| a == b)
            );
            let far = |m: &JointMap| {
                (0..4)
                    .flat_map(|k| (0..3).map(move |i| (k, i)))
                    .map(|(k, i)| (m[k][i] - rest[k][i]).abs())
                    .fold(0.0, f32::max)
            };
            assert!(clip.maps().iter().map(far).fold(0.0, f32::max) > 0.05, "{name}");
            assert_eq!(clip, generate(&rig, &motion));
            assert_ne!(clip, generate(&rig, &Motion { seed: 6, ..motion }));
        }
    }

    #[test]
    fn odd_times_give_a_frame() {
        let rig = creature();
        for seconds in [0.0, -1.0, f64::NAN] {
            assert_eq!(generate(&rig, &Motion { kind: MotionKind::Hop, seconds, rate: 30.0, seed: 0 }).frames(), 1);
        }
        assert_eq!(generate(&rig, &Motion { kind: MotionKind::Turn, seconds: 1.0, rate: 0.0, seed: 0 }).frames(), 1);
    }
}
