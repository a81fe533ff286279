//! Whether a rig behaves when what swings is let go (an extension; no reward of [`crate::Scorer`]).

use glam::DAffine3;
use riglab_core::{Clip, Rig};
use riglab_simulate::{Lengths, play};

use crate::{RawWeights, stretches};

/// Plausibility under a simulation: the rig's springs are played behind a motion, by VRM's rule.
///
/// ```text
/// R_ph = 1 / (1 + v) · (1 + s) / (1 + s E_frames[ max_edges max(1, l(LBS(e)) / (l(e) + 1e-6)) ])
/// ```
///
/// v is how fast the fastest tail still moves against the body in the last frame, in sizes of the rig (the diagonal of
/// its box) a second: springs that are meant to swing come to rest where the body stands, as in the last third of
/// [`riglab_simulate::generate`]'s motions. The second factor is [`crate::motion`] on the poses that the simulation
/// takes, 1 where nothing is stretched; leave out edges without length. In [0, 1], the better the larger; 0 for a motion of
/// another skeleton, 1 for a rig without springs that moves as a whole.
pub fn physics(rig: &Rig, edges: &[[u32; 2]], motion: &Clip, scale: f64) -> f64 {
    let Ok(played) = play(rig, motion, Lengths::Rest) else { return 0.0 };
    let poses = |clip: &Clip, frame: usize| -> Vec<DAffine3> { clip.frame(frame).iter().map(double).collect() };
    let all: Vec<Vec<DAffine3>> = (0..played.frames()).map(|frame| poses(&played, frame)).collect();
    let positions: Vec<[f64; 3]> = rig.mesh().positions().iter().map(|p| p.map(f64::from)).collect();
    let mean =
        stretches(&positions, edges, &RawWeights::of(rig.weights()), &all).iter().sum::<f64>() / all.len() as f64;
    let whole = (1.0 + scale) / (1.0 + scale * mean);
    // A tail against the body: where it is less where the motion alone would take it.
    let last = played.frames() - 1;
    let off = |frame: usize| {
        let body = poses(motion, frame);
        let springs = rig.springs().springs().iter().flat_map(|s| &s.joints);
        let tails = springs.filter_map(|s| Some((s.joint.index(), glam::Vec3::from(s.tail?).as_dvec3())));
        let apart =
            |(j, tail): (usize, glam::DVec3)| all[frame][j].transform_point3(tail) - body[j].transform_point3(tail);
        tails.map(apart).collect::<Vec<_>>()
    };
    let moved = off(last).into_iter().zip(off(last.saturating_sub(1))).map(|(a, b)| a.distance(b)).fold(0.0, f64::max);
    let size = f64::from(rig.bounds().diagonal()).max(f64::from(f32::MIN_POSITIVE));
    let speed = moved * f64::from(played.rate()) / size;
    let score = whole / (1.0 + speed);
    if score.is_finite() { score.clamp(0.0, 1.0) } else { 0.0 }
}

fn double(map: &glam::Affine3A) -> DAffine3 {
    let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(|v| v.as_dvec3());
    DAffine3 { matrix3: glam::DMat3::from_cols(x, y, z), translation: map.translation.as_dvec3() }
}

#[cfg(test)]
mod tests {
    use riglab_core::{SkinWeights, Spring, SpringJoint, Springs, Swing};
    use riglab_simulate::{Motion, MotionKind, generate};
    use riglab_synth::{Options, Plan, creature};

    use super::*;

    fn edges(rig: &Rig) -> Vec<[u32; 2]> {
        let all = rig.mesh().triangles().iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let at = |v: u32| glam::Vec3::from(rig.mesh().positions()[v as usize]);
        all.filter(|[a, b]| at(*a).distance(at(*b)) > 1e-3).collect()
    }

    /// The springs with other attributes.
    fn swinging(rig: &Rig, swing: impl Fn(Swing) -> Swing) -> Rig {
        let (springs, colliders, groups) = rig.springs().clone().into_parts();
        let changed = |s: Spring| {
            let joints = s.joints.iter().map(|j| SpringJoint { swing: swing(j.swing), ..*j }).collect();
            Spring { joints, ..s }
        };
        let springs = Springs::new(springs.into_iter().map(changed).collect(), colliders, groups).unwrap();
        rig.clone().with_springs(springs).unwrap()
    }

    #[test]
    fn torn_skins_and_restless_springs_cost() {
        let options = Options { plans: vec![Plan::Anime], triangles: 800..=1200 };
        let rig = creature(1, 0, &options).rig;
        let motion = generate(&rig, &Motion { kind: MotionKind::Shake, seconds: 4.0, rate: 20.0, seed: 0 });
        let of = |rig: &Rig| physics(rig, &edges(rig), &motion, 0.1);
        let sound = of(&rig);
        assert!(sound > 0.2 && sound < 1.0, "{sound}");
        let restless = swinging(&rig, |s| Swing { drag: 0.0, ..s });
        assert!(of(&restless) < sound - 0.01, "{} {sound}", of(&restless));
        // Every vertex on the joint after its own.
        let joints = rig.skeleton().len() as u16;
        let rows = (0..rig.weights().rows())
            .map(|v| rig.weights().row(v).map(|(j, w)| ((j.0 + 1) % joints, f64::from(w))).collect::<Vec<_>>());
        let torn = rig.with_weights(SkinWeights::normalized(rows.collect::<Vec<_>>()).unwrap()).unwrap();
        assert!(of(&torn) < sound - 0.01, "{} {sound}", of(&torn));
        // Without springs the body moves as a whole, but for rounding.
        let stiff = rig.clone().with_springs(Springs::default()).unwrap();
        assert!(of(&stiff) > 0.99, "{}", of(&stiff));
    }

    #[test]
    fn a_motion_of_another_skeleton_is_worth_nothing() {
        let of = |k| creature(1, k, &Options { plans: vec![Plan::Anime, Plan::Fish], triangles: 500..=800 }).rig;
        let (rig, other) = (of(0), of(1));
        let motion = generate(&other, &Motion { kind: MotionKind::Turn, seconds: 1.0, rate: 10.0, seed: 0 });
        assert_eq!(physics(&rig, &edges(&rig), &motion, 0.1), 0.0);
    }
}
