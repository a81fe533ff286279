//! From chains that swing to spring bones.

use glam::Vec3;
use riglab_core::{Collider, JointId, Shape, Spring, SpringJoint, Springs, Swing};

use crate::body::Body;
use crate::dice::Dice;
use crate::piece::Piece;
use crate::turn::turned;

/// A chain of joints that swings.
#[derive(Clone, Debug)]
pub(crate) struct Swinging {
    pub name: String,
    /// Parents before children.
    pub joints: Vec<JointId>,
    /// How; the radius is taken from the flesh.
    pub swing: Swing,
    /// Whether bumpers stop it.
    pub stopped: bool,
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

impl Kind {
    /// As artists set it: hair limp, cloth pulled down, ears and tails springy.
    pub fn swing(self, dice: &mut Dice) -> Swing {
        let (stiffness, drag, gravity) = match self {
            Self::Hair => ([0.4, 1.2], [0.3, 0.6], [0.0, 0.2]),
            Self::Cloth => ([0.5, 1.6], [0.3, 0.6], [0.1, 0.5]),
            Self::Tail => ([0.6, 1.6], [0.3, 0.5], [0.0, 0.15]),
            Self::Ear => ([1.0, 2.5], [0.3, 0.5], [0.0, 0.1]),
            Self::Bust => ([1.5, 3.5], [0.4, 0.7], [0.0, 0.0]),
        };
        // Round figures, as in an editor.
        let mut pick = |[low, high]: [f32; 2]| (20.0 * dice.between(low, high) + 0.5).floor() / 20.0;
        Swing { stiffness: pick(stiffness), drag: pick(drag), gravity_power: pick(gravity), ..Swing::default() }
    }
}

impl Body {
    /// Lets a chain swing; gives nothing back for a chain without joints.
    pub fn swings(&mut self, name: &str, joints: &[JointId], kind: Kind, dice: &mut Dice) {
        if !joints.is_empty() {
            let swing = kind.swing(dice);
            let stopped = matches!(kind, Kind::Hair | Kind::Cloth);
            self.swinging.push(Swinging { name: name.into(), joints: joints.to_vec(), swing, stopped });
        }
    }

    /// The far end of what a joint holds, and how thick that is.
    pub fn tip(&self, joint: JointId) -> Option<(Vec3, f32)> {
        let head = self.at(joint);
        let limbs = self.parts.iter().filter(|part| part.joint == joint.0).map(|part| {
            // The far side of an ellipsoid, the far joint of a limb.
            let beyond = if part.a == part.b { (part.b - head).normalize_or_zero() * part.mean() } else { Vec3::ZERO };
            (part.b + beyond, part.mean())
        });
        let lofts = self.pieces.iter().filter_map(|piece| match piece {
            Piece::Loft(loft) => loft.sections.last().filter(|s| s.joint == joint.0).map(|s| (s.at, s.ring.mean())),
            Piece::Sheet(sheet) => {
                let ends = sheet.ribs.iter().filter_map(|rib| rib.last()).filter(|c| c.joint == joint.0);
                let (sum, n) = ends.fold((Vec3::ZERO, 0.0), |(sum, n), c| (sum + c.at, n + 1.0f32));
                (n > 0.0).then(|| (sum / n, sheet.thickness))
            }
            Piece::Ball(ball) => (ball.joint == joint.0).then(|| (ball.center, ball.mean())),
        });
        limbs.chain(lofts).max_by(|a, b| head.distance_squared(a.0).total_cmp(&head.distance_squared(b.0)))
    }
}

/// The springs of a body, in its rest pose.
pub(crate) fn springs(body: &Body) -> Springs {
    let colliders: Vec<Collider> = (body.bumpers.iter())
        .map(|b| Collider { joint: b.joint, shape: Shape::Sphere { center: b.center.into(), radius: b.radius } })
        .collect();
    let groups = if colliders.is_empty() { vec![] } else { vec![(0..colliders.len()).collect::<Vec<_>>()] };
    let springs = body.swinging.iter().map(|chain| {
        let joints = (0..chain.joints.len()).map(|k| {
            let joint = chain.joints[k];
            let tip = body.tip(joint);
            let tail = match chain.joints.get(k + 1) {
                Some(&next) => body.at(next),
                None => tip.map_or(body.at(joint), |(at, _)| at),
            };
            let hit_radius = tip.map_or(0.0, |(_, thick)| thick);
            SpringJoint { joint, tail: Some(tail.into()), swing: Swing { hit_radius, ..chain.swing } }
        });
        let groups = if chain.stopped && !groups.is_empty() { vec![0] } else { vec![] };
        Spring { name: chain.name.clone(), joints: joints.collect(), groups, center: None }
    });
    Springs::new(springs.collect(), colliders, groups.clone()).expect("each joint swings once")
}
