//! A whole clip.

use glam::{DAffine3, DMat3};
use riglab_core::{Clip, JointMap, Rig};

use crate::{Lengths, Simulation, SimulationError};

/// A clip with the rig's springs: they begin at rest in its first frame, and each frame takes as long as the clip
/// says.
///
/// # Errors
/// [`SimulationError::PoseLength`] for a clip of another skeleton; [`SimulationError::NotFinite`] where poses are as
/// large as numbers go.
pub fn play(rig: &Rig, clip: &Clip, lengths: Lengths) -> Result<Clip, SimulationError> {
    let mut simulation = Simulation::new(rig.skeleton(), rig.springs()).with_lengths(lengths);
    let seconds = 1.0 / f64::from(clip.rate());
    let mut maps: Vec<JointMap> = Vec::with_capacity(clip.maps().len());
    for frame in 0..clip.frames() {
        let pose: Vec<DAffine3> = clip.frame(frame).iter().map(double).collect();
        let moved = match frame {
            0 => simulation.reset(&pose)?,
            _ => simulation.step(&pose, seconds)?,
        };
        maps.extend(moved.iter().map(|m| {
            [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation].map(|v| v.as_vec3().into())
        }));
    }
    // What was within the range of f32 is not always after a swing.
    let whole = |m: &JointMap| m.as_flattened().iter().all(|x| x.is_finite());
    if let Some(at) = maps.iter().position(|m| !whole(m)) {
        return Err(SimulationError::NotFinite(at % clip.joints()));
    }
    Ok(Clip::new(clip.name().into(), clip.rate(), clip.joints(), maps).expect("whole frames of finite maps"))
}

fn double(map: &glam::Affine3A) -> DAffine3 {
    let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(|v| v.as_dvec3());
    DAffine3 { matrix3: DMat3::from_cols(x, y, z), translation: map.translation.as_dvec3() }
}

#[cfg(test)]
mod tests {
    use riglab_core::JointId;

    use super::*;
    use crate::{Motion, MotionKind, generate};

    #[test]
    fn a_creature_swings_and_comes_to_rest() {
        let rig = crate::simulation::tests::creature();
        let motion = Motion { kind: MotionKind::Shake, seconds: 6.0, rate: 30.0, seed: 1 };
        let clip = generate(&rig, &motion);
        let played = play(&rig, &clip, Lengths::Rest).unwrap();
        assert_eq!((played.frames(), played.rate(), played.joints()), (clip.frames(), 30.0, rig.skeleton().len()));
        let swings = rig.springs().by_joint(rig.skeleton().len());
        let off = |frame: usize, joint: JointId| {
            let tail = swings[joint.index()].and_then(|s| s.tail).unwrap_or(rig.skeleton().head(joint));
            let at = |c: &Clip| c.frame(frame)[joint.index()].transform_point3(tail.into());
            at(&played).distance(at(&clip))
        };
        let most = |frame| rig.skeleton().ids().map(|j| off(frame, j)).fold(0.0, f32::max);
        let shaken = (0..clip.frames()).map(most).fold(0.0, f32::max);
        assert!(shaken > 0.02 && shaken.is_finite(), "{shaken}");
        // Nothing but springs and what is below them moves by itself.
        for joint in rig.skeleton().ids() {
            let above = std::iter::successors(Some(joint), |j| rig.skeleton().parent(*j));
            if above.into_iter().all(|j| swings[j.index()].is_none()) {
                assert!((0..clip.frames()).all(|f| off(f, joint) < 1e-6));
            }
        }
        // At the end only gravity bends, and nothing moves.
        let last = clip.frames() - 1;
        let still = |j: JointId| {
            let tail = swings[j.index()].and_then(|s| s.tail).unwrap_or(rig.skeleton().head(j));
            let at = |f: usize| played.frame(f)[j.index()].transform_point3(tail.into());
            at(last).distance(at(last - 1))
        };
        assert!(rig.skeleton().ids().all(|j| still(j) < 1e-3));
    }

    #[test]
    fn a_clip_of_another_skeleton_is_refused() {
        let rig = crate::simulation::tests::creature();
        let clip = Clip::new("c".into(), 30.0, 1, vec![[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]]]);
        assert!(matches!(play(&rig, &clip.unwrap(), Lengths::Rest), Err(SimulationError::PoseLength { pose: 1, .. })));
    }
}
