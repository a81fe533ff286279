//! Supervision through physics (UniRig 4.3): λ_X·Σ_t ‖X_t - X̂_t‖².
//!
//! A short motion that begins at rest moves the rig twice, spring bones behind it: once with true weights and
//! attributes, once with predicted ones. The paper takes motions of its models; here all joints turn and the rig goes
//! somewhere, evenly over the poses, so that every rig has a motion and every bone is seen.

use riglab_augment::AffineMap;
use riglab_core::{JointId, Pose, Shape, Vec3};
use riglab_nn::simulate::{Maps, Obstacle, Springs, Tree, physics_loss, skin};
use riglab_nn::skin_stage::ATTRIBUTES;
use riglab_random::{Draw, Stream};
use tch::Tensor;

use super::batch::{Bones, scale};
use super::config::PhysicsConfig;
use super::ready::Ready;

/// A motion of j bones, and what holds and stops those that swing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motion {
    /// The bone above each; parents come first.
    pub parents: Vec<Option<usize>>,
    /// [j, 3]
    pub heads: Vec<f32>,
    /// [j, 3]: where what swings ends.
    pub tails: Vec<f32>,
    /// [t + 1, j, 3, 4]: from rest to each pose, at rest in the first.
    pub maps: Vec<f32>,
    /// Each with the bones that it stops.
    pub obstacles: Vec<(Obstacle, Vec<bool>)>,
    /// The bone whose motion each does not feel.
    pub centers: Vec<Option<usize>>,
}

impl Motion {
    /// Draws one for a rig as it lies under a map.
    ///
    /// # Errors
    /// For a skeleton that cannot be posed.
    pub fn draw(
        c: &PhysicsConfig,
        ready: &Ready,
        bones: &Bones,
        map: &AffineMap,
        random: &mut Stream,
    ) -> Result<Self, String> {
        let (skeleton, springs) = (ready.rig.rig.skeleton(), ready.rig.rig.springs());
        let seats = bones.joints(ready);
        let tails = springs.by_joint(skeleton.len());
        let mut out = Self { parents: bones.parents(ready), ..Self::default() };
        for (own, joint) in bones.of.iter().zip(&seats) {
            let seat = &ready.seats[own[0]];
            out.heads.extend(map.exact(seat.head));
            out.tails.extend(map.exact(tails[joint.index()].and_then(|s| s.tail).unwrap_or(seat.tail)));
        }
        let strengths: Vec<f32> = (0..=c.frames).map(|t| t as f32 / c.frames as f32).collect();
        out.maps = poses(ready, bones, map, [c.degrees, c.shift], &strengths, random)?;
        if springs.is_empty() {
            return Ok(out);
        }
        // The bone that a joint is part of, or goes with: itself, or the next one above that holds something.
        let mut part = vec![None; skeleton.len()];
        for (b, own) in bones.of.iter().enumerate() {
            own.iter().for_each(|&k| part[ready.rig.bones[k].joint.index()] = Some(b));
        }
        for joint in skeleton.ids() {
            part[joint.index()] = part[joint.index()].or_else(|| skeleton.parent(joint).and_then(|p| part[p.index()]));
        }
        out.centers = vec![None; seats.len()];
        let size = f64::from(scale(map));
        for (k, spring) in springs.springs().iter().enumerate() {
            let held = |b: usize| spring.joints.iter().any(|j| j.joint == seats[b]);
            let stopped: Vec<bool> = (0..seats.len()).map(held).collect();
            if let Some(center) = spring.center.and_then(|c| part[c.index()]) {
                stopped.iter().zip(&mut out.centers).filter(|(s, _)| **s).for_each(|(_, own)| *own = Some(center));
            }
            for collider in springs.stops(k) {
                let Some(joint) = part[collider.joint.index()] else { continue };
                let (from, to, radius) = match collider.shape {
                    Shape::Sphere { center, radius } => (center, center, radius),
                    Shape::Capsule { from, to, radius } => (from, to, radius),
                };
                let end = |p: Vec3| map.exact(p).map(f64::from);
                let obstacle = Obstacle { joint, from: end(from), to: end(to), radius: size * f64::from(radius) };
                match out.obstacles.iter_mut().find(|(o, _)| *o == obstacle) {
                    Some((_, all)) => all.iter_mut().zip(&stopped).for_each(|(a, s)| *a |= s),
                    None => out.obstacles.push((obstacle, stopped.clone())),
                }
            }
        }
        Ok(out)
    }

    /// The loss of predicted shares [n, j] and rows of attributes [j, 7] against true ones, at positions [n, 3];
    /// `swinging` bones swing, if there are attributes for them. Predicted attributes count as the rule could have them:
    /// nothing below 0, and drag at most 1.
    pub fn loss(&self, c: &PhysicsConfig, found: Moving<'_>, truth: Moving<'_>, swinging: &[bool]) -> Tensor {
        let shares = found.shares;
        let (device, kind, j) = (shares.device(), shares.kind(), self.parents.len() as i64);
        let of = |values: &[f32]| Tensor::from_slice(values).to_kind(kind).to_device(device);
        let motion = Maps::of(&of(&self.maps).view([-1, j, 3, 4]));
        let frames = c.frames as i64;
        let after_rest = Maps { matrix: motion.matrix.narrow(0, 1, frames), shift: motion.shift.narrow(0, 1, frames) };
        let springs = (found.attributes.is_some() && swinging.contains(&true)).then(|| {
            let point = |values| of(values).view([j, 3]);
            let springs = Springs::new(Tree::new(&self.parents), &point(&self.heads), &point(&self.tails), swinging);
            springs.with_obstacles(self.obstacles.clone()).with_centers(&self.centers)
        });
        let places = |of: &Moving<'_>| match (&springs, of.attributes) {
            (Some(springs), Some(rows)) => {
                let maps = springs.run(&motion, &possible(rows).to_kind(kind), c.seconds);
                skin(of.positions, of.shares, &maps)
            }
            _ => skin(of.positions, of.shares, &after_rest),
        };
        let wanted = tch::no_grad(|| places(&truth));
        physics_loss(&places(&found), &wanted)
    }
}

/// Weights and attributes that a motion is played with.
pub struct Moving<'a> {
    /// [n, 3]
    pub positions: &'a Tensor,
    /// [n, j]
    pub shares: &'a Tensor,
    /// [j, 7]
    pub attributes: Option<&'a Tensor>,
}

/// Attributes as VRM's rule takes them.
fn possible(rows: &Tensor) -> Tensor {
    let part = |from: i64, count: i64| rows.narrow(-1, from, count);
    Tensor::cat(&[&part(0, 1).clamp_min(0.0), &part(1, 1).clamp(0.0, 1.0), &part(2, ATTRIBUTES as i64 - 2)], -1)
}

/// Maps [strengths, j, 3, 4] from rest, of the rig as it lies under a map, to a pose with random turns of every joint
/// about each axis, up to so many degrees, and a random way of the whole up to so far: each by so much of it.
pub fn poses(
    ready: &Ready,
    bones: &Bones,
    map: &AffineMap,
    [degrees, shift]: [f32; 2],
    strengths: &[f32],
    random: &mut Stream,
) -> Result<Vec<f32>, String> {
    let named = |e: &dyn std::fmt::Display| format!("{}: {e}", ready.rig.name);
    let skeleton = ready.rig.rig.skeleton();
    let heads = skeleton.heads().iter().map(|&p| map.exact(p)).collect();
    let skeleton = skeleton.with_heads(heads).map_err(|e| named(&e))?;
    let most = degrees.to_radians();
    let ids: Vec<JointId> = skeleton.ids().collect();
    let turns: Vec<Vec3> = ids.iter().map(|_| std::array::from_fn(|_| random.within(-most, most))).collect();
    let way: Vec3 = if shift > 0.0 { std::array::from_fn(|_| random.within(-shift, shift)) } else { [0.0; 3] };
    let joints = bones.joints(ready);
    let mut out = Vec::with_capacity(strengths.len() * joints.len() * 12);
    for &strength in strengths {
        let mut pose = Pose::rest(skeleton.len());
        pose.shift_root(way.map(|x| x * strength));
        ids.iter().zip(&turns).for_each(|(&joint, turn)| pose.rotate(joint, turn.map(|x| x * strength)));
        let all = pose.transforms(&skeleton).map_err(|e| named(&e))?;
        for joint in &joints {
            let (m, t) = (all[joint.index()].matrix3, all[joint.index()].translation.to_array());
            let rows = m.transpose().to_cols_array_2d();
            (0..3).for_each(|k| out.extend([rows[k][0], rows[k][1], rows[k][2], t[k]]));
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use riglab_core::{Collider, Joint, Mesh, Rig, Skeleton, SkinWeights, Spring, SpringJoint, Swing};
    use riglab_random::stream;
    use tch::Kind;

    use super::*;
    use crate::fsq_cvae::Prepared;
    use crate::unirig_skin::ready::row;

    /// A rod along x held by joints at 0, 1, 2 and 3, of which the last two swing and a ball of the first stops them; the
    /// second holds nothing.
    fn ready() -> Ready {
        let corners: Vec<Vec3> = (0..40).map(|i| [i as f32 / 10.0, (i % 2) as f32 / 4.0, 0.0]).collect();
        let mesh = Mesh::new(corners.clone(), (0..38).map(|i| [i, i + 1, i + 2]).collect()).unwrap();
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: (k > 0).then(|| JointId(k - 1)),
            head: [f32::from(k), 0.1, 0.0],
        };
        let skeleton = Skeleton::new((0..4).map(joint).collect()).unwrap();
        let holder = |p: &Vec3| [0, 0, 2, 3][(p[0] as usize).min(3)];
        let weights = SkinWeights::normalized(corners.iter().map(|p| [(holder(p), 1.0)])).unwrap();
        let swing = |k: u16| SpringJoint {
            joint: JointId(k),
            tail: Some([f32::from(k) + 1.0, 0.1, 0.0]),
            swing: Swing { stiffness: 0.5, drag: 0.3, gravity_power: 1.0, hit_radius: 0.1, ..Swing::default() },
        };
        let spring = Spring { name: "tail".into(), joints: vec![swing(2), swing(3)], groups: vec![0], center: None };
        let ball = Collider { joint: JointId(1), shape: Shape::Sphere { center: [3.5, -0.4, 0.0], radius: 0.3 } };
        let springs = riglab_core::Springs::new(vec![spring], vec![ball], vec![vec![0]]).unwrap();
        let rig = Rig::new(skeleton, mesh, weights).unwrap().with_springs(springs).unwrap();
        let rig = Prepared::of("rod".into(), rig.normalized().0, false);
        Ready::pooled(
            rig,
            &riglab_geom::CloudConfig { points: 64, vertices: 32, ..Default::default() },
            crate::unirig_skin::ready::Measured { resolution: 24, heat: false },
            &mut stream(1, "test", &[]),
        )
    }

    fn drawn(ready: &Ready) -> Motion {
        let map = riglab_augment::AffineConfig::default().draw(1, &mut stream(2, "test", &[]));
        let c = PhysicsConfig::default();
        Motion::draw(&c, ready, &Bones::all(ready), &map, &mut stream(3, "test", &[])).unwrap()
    }

    /// The loss of shares and attributes against the true ones.
    fn loss(ready: &Ready, motion: &Motion, shares: &Tensor, rows: &Tensor, truth: &Tensor) -> Tensor {
        let kind = shares.kind();
        let flat: Vec<f32> = ready.points.iter().flat_map(|p| p.position).collect();
        let positions = Tensor::from_slice(&flat).view([-1, 3]).to_kind(kind);
        let swinging: Vec<bool> = ready.seats.iter().map(|s| s.swing.is_some()).collect();
        let moving = |shares, rows| Moving { positions: &positions, shares, attributes: Some(rows) };
        motion.loss(&PhysicsConfig::default(), moving(shares, rows), moving(truth, &true_rows(ready, kind)), &swinging)
    }

    fn true_rows(ready: &Ready, kind: Kind) -> Tensor {
        let flat: Vec<f32> = ready.seats.iter().flat_map(|s| row(&s.swing.unwrap_or_default())).collect();
        Tensor::from_slice(&flat).view([-1, 7]).to_kind(kind)
    }

    fn true_shares(ready: &Ready, kind: Kind) -> Tensor {
        let rig = &ready.rig;
        let flat: Vec<f32> = ready.points.iter().flat_map(|p| rig.bones.iter().map(|b| rig.weight(b, p))).collect();
        Tensor::from_slice(&flat).view([-1, ready.seats.len() as i64]).to_kind(kind)
    }

    #[test]
    fn it_begins_at_rest_and_what_swings_is_held_and_stopped() {
        let ready = ready();
        let motion = drawn(&ready);
        assert_eq!(motion.parents, [None, Some(0), Some(1)], "through the joint that holds nothing");
        assert_eq!((motion.heads.len(), motion.tails.len(), motion.maps.len()), (9, 9, 4 * 3 * 12));
        let rest = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        assert!(motion.maps[..36].iter().zip(rest.iter().cycle()).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(motion.maps[3 * 36..].iter().zip(rest.iter().cycle()).any(|(a, b)| (a - b).abs() > 0.05));
        // The ball's joint holds nothing: the ball goes with the one above.
        assert_eq!(motion.obstacles.len(), 1);
        assert_eq!((motion.obstacles[0].0.joint, &motion.obstacles[0].1[..]), (0, &[false, true, true][..]));
    }

    #[test]
    fn nothing_is_lost_at_the_truth_and_each_part_of_it_matters() {
        let ready = ready();
        let motion = drawn(&ready);
        let (shares, rows) = (true_shares(&ready, Kind::Float), true_rows(&ready, Kind::Float));
        let of = |s: &Tensor, r: &Tensor| loss(&ready, &motion, s, r, &shares).double_value(&[]);
        assert_eq!(of(&shares, &rows), 0.0);
        let other = (&shares + 0.2) / 1.6;
        assert!(of(&other, &rows) > 1e-4);
        for k in [0, 1, 2, 4, 6] {
            let changed = rows.copy();
            let _ = changed.narrow(1, k, 1).fill_(if k == 4 { 0.5 } else { 0.9 });
            assert!(of(&shares, &changed) > 1e-9, "attribute {k}");
        }
        // What the rule could not have is taken as the nearest that it could.
        let beyond = rows.copy();
        let _ = beyond.narrow(1, 1, 1).fill_(7.0);
        let most = rows.copy();
        let _ = most.narrow(1, 1, 1).fill_(1.0);
        assert_eq!(of(&shares, &beyond), of(&shares, &most));
    }

    #[test]
    fn gradients_match_finite_differences() {
        let ready = ready();
        let motion = drawn(&ready);
        let truth = true_shares(&ready, Kind::Double);
        let (logits, rows) = (&truth * 2.0, true_rows(&ready, Kind::Double) * 0.8 + 0.05);
        let of = |l: &Tensor, r: &Tensor| loss(&ready, &motion, &l.softmax(-1, None::<Kind>), r, &truth);
        let leaves = [logits.copy().set_requires_grad(true), rows.copy().set_requires_grad(true)];
        let gradients = Tensor::run_backward(&[of(&leaves[0], &leaves[1])], &leaves, false, false);
        for (which, gradient) in gradients.iter().enumerate() {
            let at = [&logits, &rows][which];
            let along = |k: i64| {
                let moved = |by: f64| {
                    let there = at.copy();
                    let _ = there.view(-1).get(k).f_add_scalar_(by).unwrap();
                    let pair = if which == 0 { [&there, &rows] } else { [&logits, &there] };
                    of(pair[0], pair[1]).double_value(&[])
                };
                (moved(1e-5) - moved(-1e-5)) / 2e-5
            };
            let numeric: Vec<f64> = (0..at.numel() as i64).map(along).collect();
            let numeric = Tensor::from_slice(&numeric);
            let size = numeric.norm().double_value(&[]);
            assert!(size > 1e-6);
            let off = (gradient.view(-1) - numeric).norm().double_value(&[]) / size;
            assert!(off <= 1e-6, "input {which}: relative error {off:.1e}");
        }
    }
}
