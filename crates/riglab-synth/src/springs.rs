//! From chains that swing to spring bones.

use glam::Vec3;
use riglab_core::{Collider, JointId, Shape, Spring, SpringJoint, Springs, Swing};

use crate::body::Body;
use crate::dice::Dice;
use crate::part::Part;
use crate::piece::Piece;
use crate::turn::turned;

/// A chain of joints that swings.
#[derive(Clone, Debug)]
pub(crate) struct Swinging {
    pub name: String,
    /// Parents before children.
    pub joints: Vec<JointId>,
    pub kind: Kind,
    /// How far stiffness, drag and gravity are from what the kind and the flesh say, as shares of [`Kind::ranges`].
    pub taste: [f32; 3],
}

/// A ball that stops what swings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bumper {
    pub joint: JointId,
    pub center: Vec3,
    pub radius: f32,
}

impl Bumper {
    pub fn scale(&mut self, by: f32) {
        (self.center, self.radius) = (self.center * by, self.radius * by);
    }

    pub fn turn(&mut self, moves: &dyn Fn(u16) -> bool, center: Vec3, axis: Vec3, degrees: f32) {
        if moves(self.joint.0) {
            self.center = center + turned(self.center - center, axis, degrees);
        }
    }
}

/// What swings, and so how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    Hair,
    Cloth,
    Tail,
    Ear,
    Bust,
}

/// Beside its flesh, a chain is as thick as this share of the creature: nothing swings like a wire.
const WEARS: f32 = 0.01;
/// How thick a rib of cloth of one layer is taken to be, as a share of the way to the next: two to four centimetres for
/// a skirt, about what artists let stop it.
const SPACED: f32 = 0.15;
/// How much of a range is taste: two artists do not set the same chain alike.
const TASTE: f32 = 0.1;

impl Kind {
    /// Stiffness, drag and power of gravity, each from what is short and thick to what is long and thin. As artists set
    /// it: hair limp, cloth pulled down, ears and tails springy; and the longer and thinner a chain is, the limper, the
    /// more it hangs and the sooner the air stops it.
    fn ranges(self) -> [[f32; 2]; 3] {
        match self {
            Self::Hair => [[1.2, 0.4], [0.3, 0.6], [0.0, 0.2]],
            Self::Cloth => [[1.6, 0.5], [0.3, 0.6], [0.1, 0.5]],
            Self::Tail => [[1.6, 0.6], [0.3, 0.5], [0.0, 0.15]],
            Self::Ear => [[2.5, 1.0], [0.3, 0.5], [0.0, 0.1]],
            Self::Bust => [[3.5, 1.5], [0.4, 0.7], [0.0, 0.0]],
        }
    }

    /// Length over thickness at the ends of [`Self::ranges`]: nine of ten creatures' chains lie between.
    fn slenderness(self) -> [f32; 2] {
        match self {
            Self::Hair => [2.5, 15.0],
            Self::Cloth => [6.0, 18.0],
            Self::Tail => [5.0, 35.0],
            Self::Ear => [2.6, 8.0],
            Self::Bust => [1.0, 1.6],
        }
    }

    /// How a chain swings that is so many times as long as thick; the radius is not said.
    fn swing(self, slenderness: f32, taste: [f32; 3]) -> Swing {
        let [thick, thin] = self.slenderness();
        // Flattening as a logarithm does, in arithmetic that is the same on every machine.
        let t = ((1.0 - thick / slenderness.max(1e-3)) / (1.0 - thick / thin)).clamp(0.0, 1.0);
        let ranges = self.ranges();
        let value = |k: usize| {
            let [from, to] = ranges[k];
            let own = (t + TASTE * taste[k]).clamp(0.0, 1.0);
            // Round figures, as in an editor.
            (20.0 * (from + (to - from) * own) + 0.5).floor() / 20.0
        };
        Swing { stiffness: value(0), drag: value(1), gravity_power: value(2), ..Swing::default() }
    }

    /// Whether bumpers stop it.
    fn stopped(self) -> bool {
        matches!(self, Self::Hair | Self::Cloth)
    }
}

impl Body {
    /// Lets a chain swing; gives nothing back for a chain without joints.
    pub fn swings(&mut self, name: &str, joints: &[JointId], kind: Kind, dice: &mut Dice) {
        if !joints.is_empty() {
            let taste = [(); 3].map(|()| dice.between(-1.0, 1.0));
            self.swinging.push(Swinging { name: name.into(), joints: joints.to_vec(), kind, taste });
        }
    }

    /// The far end of what a joint holds; nothing where that goes on beyond another joint.
    pub fn tip(&self, joint: JointId) -> Option<Vec3> {
        let head = self.at(joint);
        let limbs = self.parts.iter().filter(|part| part.joint == joint.0).map(|part| {
            // The far side of an ellipsoid, the far joint of a limb.
            let beyond = if part.a == part.b { (part.b - head).normalize_or_zero() * part.mean() } else { Vec3::ZERO };
            part.b + beyond
        });
        let apart = self.pieces.iter().filter_map(|piece| match piece {
            Piece::Loft(loft) => loft.sections.last().filter(|s| s.joint == joint.0).map(|s| s.at),
            Piece::Sheet(sheet) => {
                let ends = sheet.ribs.iter().filter_map(|rib| rib.last()).filter(|c| c.joint == joint.0);
                let (sum, n) = ends.fold((Vec3::ZERO, 0.0), |(sum, n), c| (sum + c.at, n + 1.0f32));
                (n > 0.0).then(|| sum / n)
            }
            Piece::Ball(ball) => (ball.joint == joint.0).then_some(ball.center),
        });
        limbs.chain(apart).max_by(|a, b| head.distance_squared(*a).total_cmp(&head.distance_squared(*b)))
    }

    /// Half extent of the thickest thing a joint holds; 0 if it holds nothing.
    fn thickness(&self, joint: JointId) -> f32 {
        let limbs = self.parts.iter().filter(|part| part.joint == joint.0).map(Part::mean);
        let apart = self.pieces.iter().filter_map(|piece| match piece {
            Piece::Loft(loft) => loft.thickness_at(joint.0),
            Piece::Sheet(sheet) if sheet.thickness > 0.0 => sheet.holds(joint.0).then_some(sheet.thickness),
            Piece::Sheet(sheet) => sheet.spacing_at(joint.0).map(|gap| SPACED * gap),
            Piece::Ball(ball) => (ball.joint == joint.0).then(|| ball.mean()),
        });
        limbs.chain(apart).fold(0.0, f32::max)
    }
}

/// The springs of a body, in its rest pose.
pub(crate) fn springs(body: &Body) -> Springs {
    let colliders: Vec<Collider> = (body.bumpers.iter())
        .map(|b| Collider { joint: b.joint, shape: Shape::Sphere { center: b.center.into(), radius: b.radius } })
        .collect();
    let groups = if colliders.is_empty() { vec![] } else { vec![(0..colliders.len()).collect::<Vec<_>>()] };
    let heads = || body.joints.iter().map(|joint| Vec3::from(joint.head));
    let (low, high) = heads().fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(p), high.max(p)));
    let size = (high - low).max_element().max(f32::MIN_POSITIVE);
    let springs = body.swinging.iter().map(|chain| {
        // Each joint with its tail and how thick it is.
        let bones = chain.joints.iter().enumerate().map(|(k, &joint)| {
            let tail = match chain.joints.get(k + 1) {
                Some(&next) => body.at(next),
                None => body.tip(joint).unwrap_or(body.at(joint)),
            };
            (joint, tail, body.thickness(joint))
        });
        let bones: Vec<(JointId, Vec3, f32)> = bones.collect();
        let length: f32 = bones.iter().map(|(joint, tail, _)| body.at(*joint).distance(*tail)).sum();
        let thickness = bones.iter().map(|(_, _, thick)| thick).sum::<f32>() / bones.len() as f32;
        let swing = chain.kind.swing(length / (thickness + WEARS * size), chain.taste);
        let joint = |(joint, tail, hit_radius): (JointId, Vec3, f32)| SpringJoint {
            joint,
            tail: Some(tail.into()),
            swing: Swing { hit_radius, ..swing },
        };
        let groups = if chain.kind.stopped() && !groups.is_empty() { vec![0] } else { vec![] };
        Spring { name: chain.name.clone(), joints: bones.into_iter().map(joint).collect(), groups, center: None }
    });
    Springs::new(springs.collect(), colliders, groups.clone()).expect("each joint swings once")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Plan;

    /// Twenty bodies of a plan before they are varied.
    fn bodies(plan: Plan) -> impl Iterator<Item = Body> {
        (0..20).map(move |k| plan.body(&mut Dice::new(riglab_random::stream(8, "springs", &[k])), 4_000))
    }

    #[test]
    fn what_swings_is_as_thick_as_it_looks() {
        for plan in Plan::ALL {
            for body in bodies(plan) {
                let springs = springs(&body);
                for spring in springs.springs() {
                    let bones: f32 = (spring.joints.iter())
                        .map(|j| body.at(j.joint).distance(Vec3::from(j.tail.expect("each has one"))))
                        .sum();
                    for joint in &spring.joints {
                        let r = joint.swing.hit_radius;
                        // A bust is a ball on a short bone, a banner's cloth may be wider than long.
                        let of = format!("{} {}: {r} of {bones}", plan.name(), spring.name);
                        assert!(r > 0.004 * bones && r < bones, "{of}");
                    }
                }
            }
        }
    }

    #[test]
    fn inner_bones_of_a_strand_are_as_thick_as_their_sections() {
        let mut body = Body::new("head", Vec3::ZERO);
        let nodes = [0.3, 0.2, 0.1, 0.0].map(|r| crate::body::Node::round(Vec3::Y * (1.0 - r), r));
        let chain = body.strand(Body::ROOT, ["a", "b", "c"].map(String::from), &nodes, Vec3::X);
        let thick = chain.iter().map(|&joint| body.thickness(joint));
        assert!(thick.zip([0.25, 0.15, 0.05]).all(|(found, r)| (found - r).abs() < 1e-6));
    }

    #[test]
    fn most_chains_use_their_ranges() {
        // Were chains taken for thinner than they are, all would be as limp as their kind may be, or the other way round.
        for (plan, name) in [(Plan::Anime, "hair"), (Plan::Anime, "skirt")] {
            let swings: Vec<(Kind, Swing)> = bodies(plan)
                .flat_map(|body| {
                    let of = |k: usize| (body.swinging[k].kind, body.swinging[k].name == name);
                    let springs = springs(&body);
                    let these = springs.springs().iter().enumerate().filter(|(k, _)| of(*k).1);
                    these.map(|(k, s)| (of(k).0, s.joints[0].swing)).collect::<Vec<_>>()
                })
                .collect();
            let [from, to] = swings[0].0.ranges()[0];
            let inner = swings.iter().filter(|(_, s)| s.stiffness < from - 0.02 && s.stiffness > to + 0.02).count();
            assert!(swings.iter().all(|(_, s)| (to - 0.03..from + 0.03).contains(&s.stiffness)));
            assert!(2 * inner > swings.len(), "{name}: {inner} of {} between the ends", swings.len());
        }
    }

    #[test]
    fn what_is_longer_and_thinner_is_limper() {
        for kind in [Kind::Hair, Kind::Cloth, Kind::Tail, Kind::Ear, Kind::Bust] {
            let [thick, thin] = kind.slenderness();
            let of = |slenderness: f32| kind.swing(slenderness, [0.0; 3]);
            let (a, b, c) = (of(thick), of((thick * thin).sqrt()), of(thin));
            assert!(a.stiffness > b.stiffness && b.stiffness > c.stiffness && a.drag < c.drag, "{kind:?}");
            assert!(a.gravity_power <= c.gravity_power && of(0.0).stiffness == a.stiffness, "{kind:?}");
            assert!((of(f32::INFINITY).stiffness - c.stiffness).abs() < 1e-6, "{kind:?}");
        }
    }
}
