//! One bone that swings.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use riglab_core::{Collider, Shape, Swing};

/// Which length a bone has while its parent moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lengths {
    /// That at rest, as VRM has it.
    #[default]
    Rest,
    /// From its head, moved already, to its tail as the last frame left it. So three-vrm's manager measures it (up to
    /// 3.5.5 at least), and bones that move fast get longer for a frame; for comparisons with it.
    Lagging,
}

/// A bone that swings, and where its tail is.
#[derive(Clone, Debug)]
pub(crate) struct Bone {
    /// From head to tail at rest.
    axis: DVec3,
    /// The same, of length 1.
    direction: DVec3,
    stiffness: f64,
    drag: f64,
    gravity: DVec3,
    radius: f64,
    /// The joint whose motion it does not feel.
    pub(crate) center: Option<usize>,
    /// Numbers of the colliders that stop it.
    pub(crate) stops: Vec<usize>,
    /// Where the tail is and was a step before, as its center sees it.
    now: DVec3,
    before: DVec3,
    /// Where the tail is in the scene.
    tail: DVec3,
    /// From rest, as its parent sees it.
    turn: DMat3,
}

/// What holds a bone in a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hold {
    /// The head in the scene.
    pub(crate) head: DVec3,
    /// Turn and scale of the parent's map.
    pub(crate) parent: DMat3,
    /// By how much the motion scales the bone itself.
    pub(crate) scale: f64,
    /// From the space of the center to the scene; of a center that is flat, or of none, the identity.
    pub(crate) from_center: DAffine3,
    /// And back.
    pub(crate) to_center: DAffine3,
}

impl Bone {
    /// `None` for a bone without length, which has no direction to swing in.
    pub(crate) fn new(axis: DVec3, swing: &Swing, center: Option<usize>, stops: Vec<usize>) -> Option<Self> {
        let direction = axis.try_normalize()?;
        Some(Self {
            axis,
            direction,
            stiffness: swing.stiffness.into(),
            drag: swing.drag.into(),
            gravity: glam::Vec3::from(swing.gravity_direction).as_dvec3() * f64::from(swing.gravity_power),
            radius: swing.hit_radius.into(),
            center,
            stops,
            now: DVec3::ZERO,
            before: DVec3::ZERO,
            tail: DVec3::ZERO,
            turn: DMat3::IDENTITY,
        })
    }

    /// As at rest, and still.
    pub(crate) fn place(&mut self, hold: &Hold) {
        self.turn = DMat3::IDENTITY;
        self.tail = hold.head + hold.parent * self.axis * hold.scale;
        self.now = hold.to_center.transform_point3(self.tail);
        self.before = self.now;
    }

    /// A step of `seconds`, above 0; `obstacles` as they stand now.
    pub(crate) fn step(&mut self, hold: &Hold, seconds: f64, lengths: Lengths, obstacles: &[Obstacle]) {
        let Some(to_rest) = (hold.parent * self.direction).try_normalize() else { return };
        let length = match lengths {
            Lengths::Rest => (hold.parent * (self.turn * self.axis)).length() * hold.scale,
            Lengths::Lagging => hold.head.distance(self.tail),
        };
        let kept = self.now + (self.now - self.before) * (1.0 - self.drag);
        let aim =
            hold.from_center.transform_point3(kept) + to_rest * (self.stiffness * seconds) + self.gravity * seconds;
        let mut way = (aim - hold.head).try_normalize().unwrap_or(to_rest);
        for &number in &self.stops {
            let Some((out, depth)) = obstacles[number].hit(hold.head + way * length, self.radius, way) else {
                continue;
            };
            way = (way * length + out * depth).try_normalize().unwrap_or(way);
        }
        let tail = hold.head + way * length;
        let now = hold.to_center.transform_point3(tail);
        let Some(turn) = (hold.parent.inverse() * way).try_normalize().map(|to| shortest(self.direction, to)) else {
            return;
        };
        if now.is_finite() && turn.is_finite() {
            (self.before, self.now) = (self.now, now);
            self.turn = DMat3::from_quat(turn);
        }
    }

    /// The map from rest to pose, of a joint that stands at `head` at rest.
    pub(crate) fn map(&mut self, hold: &Hold, head: DVec3) -> DAffine3 {
        let matrix3 = hold.parent * self.turn * hold.scale;
        self.tail = hold.head + matrix3 * self.axis;
        DAffine3 { matrix3, translation: hold.head - matrix3 * head }
    }
}

/// The shortest turn between unit vectors; about some axis across where they are opposite.
fn shortest(from: DVec3, to: DVec3) -> DQuat {
    let real = from.dot(to) + 1.0;
    let turn = match real < 1e-8 {
        false => DQuat::from_xyzw(0.0, 0.0, 0.0, real) + DQuat::from_vec4(from.cross(to).extend(0.0)),
        true if from.x.abs() > from.z.abs() => DQuat::from_xyzw(-from.y, from.x, 0.0, 0.0),
        true => DQuat::from_xyzw(0.0, -from.z, from.y, 0.0),
    };
    turn.normalize()
}

/// A collider in a frame: all points within `radius` of a segment, whose ends are one point for a ball.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Obstacle {
    from: DVec3,
    along: DVec3,
    radius: f64,
}

impl Obstacle {
    /// A collider moved by the map of its joint.
    pub(crate) fn of(collider: &Collider, map: &DAffine3) -> Self {
        let (from, to, radius) = match collider.shape {
            Shape::Sphere { center, radius } => (center, center, radius),
            Shape::Capsule { from, to, radius } => (from, to, radius),
        };
        let [from, to] = [from, to].map(|p| map.transform_point3(glam::Vec3::from(p).as_dvec3()));
        Self { from, along: to - from, radius: radius.into() }
    }

    /// Which way and how far a ball has to go to be outside; `None` for one that is. From the very middle `away`.
    fn hit(&self, ball: DVec3, radius: f64, away: DVec3) -> Option<(DVec3, f64)> {
        let to = ball - self.from;
        let (dot, square) = (self.along.dot(to), self.along.length_squared());
        let to = match dot {
            _ if dot <= 0.0 => to,
            _ if dot >= square => to - self.along,
            _ => to - self.along * (dot / square),
        };
        let depth = radius + self.radius - to.length();
        (depth > 0.0).then(|| (to.try_normalize().unwrap_or(away), depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_turn_takes_one_direction_to_the_other() {
        for (from, to) in [(DVec3::X, DVec3::Y), (DVec3::X, -DVec3::X), (DVec3::Z, -DVec3::Z), (-DVec3::Y, DVec3::Y)] {
            assert!((shortest(from, to) * from).distance(to) < 1e-12, "{from} {to}");
        }
    }

    #[test]
    fn a_capsule_is_round_at_its_ends() {
        let shape = Shape::Capsule { from: [0.0; 3], to: [0.0, 2.0, 0.0], radius: 0.5 };
        let of = |ball: [f64; 3]| {
            let collider = Collider { joint: riglab_core::JointId(0), shape };
            Obstacle::of(&collider, &DAffine3::IDENTITY).hit(ball.into(), 0.25, DVec3::Z)
        };
        assert_eq!(of([0.5, 1.0, 0.0]), Some((DVec3::X, 0.25)));
        assert_eq!(of([0.0, 2.5, 0.0]), Some((DVec3::Y, 0.25)));
        assert_eq!(of([0.0, -0.5, 0.0]), Some((-DVec3::Y, 0.25)));
        assert_eq!(of([0.75, 1.0, 0.0]), None);
        assert_eq!(of([0.0, 1.0, 0.0]), Some((DVec3::Z, 0.75)), "from the middle");
    }
}
