//! Toes, tails, horns, spikes: what many animals have at their ends.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::part::Ring;
use crate::piece::Loft;
use crate::turn::{direction, turned};

/// Toes or fingers that fan out from a foot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Toes {
    pub count: usize,
    pub length: f32,
    pub radius: f32,
    /// Degrees between the outermost.
    pub fan: f32,
    /// What they are called: `toe`, `finger`.
    pub name: &'static str,
    /// Joints of each: 0 to 2.
    pub joints: usize,
    /// Whether one more points back, as birds' do.
    pub back: bool,
}

impl Toes {
    /// Adds them to a foot at `ball`, pointing `ahead`.
    pub fn grow(self, body: &mut Body, foot: JointId, side: Side, ball: Vec3, ahead: Vec3) {
        let all = self.count + usize::from(self.back);
        for k in 0..all {
            let (angle, length) = match k < self.count {
                true if self.count > 1 => {
                    let t = k as f32 / (self.count - 1) as f32 - 0.5;
                    (self.fan * t, self.length * (1.0 - 0.5 * t * t))
                }
                true => (0.0, self.length),
                false => (180.0, 0.6 * self.length),
            };
            let along = turned(ahead, Vec3::Y, angle);
            let r = self.radius;
            let at = |t: f32| side.of(ball + along * (length * t) - Vec3::Y * (0.35 * r * t * t));
            let name = |j: usize| format!("{}_{}_{j}_{}", self.name, k + 1, side.word().to_lowercase());
            let wide = |t: f32| Ring::round(r * (1.05 - 0.75 * t * t));
            let places = [0.0, 0.45, 0.8, 1.0];
            let mut held = [foot; 4];
            for j in 1..=self.joints {
                let start = if self.joints == 1 { 0.2 } else { [0.15, 0.55][j - 1] };
                let joint = body.joint(held[3], name(j), at(start));
                // The first joint takes the toe from its root on.
                let from = if self.joints == 1 { 1 } else { j };
                held[from..].fill(joint);
            }
            let points: Vec<_> = places.iter().zip(held).map(|(&t, joint)| (at(t), wide(t), joint.0)).collect();
            body.loft(Loft::through(&points, Vec3::X));
        }
    }
}

/// A tail.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tail {
    pub joints: usize,
    pub length: f32,
    /// Half extents at its root and its tip.
    pub thick: [f32; 2],
    /// How much higher than wide it is.
    pub tall: f32,
    /// Degrees above the horizontal at its root, and by how much each joint rises over the last.
    pub rise: f32,
    pub curl: f32,
    /// Degrees by which each joint bends to the left.
    pub sway: f32,
}

impl Tail {
    /// Adds it; gives its joints.
    pub fn grow(self, body: &mut Body, parent: JointId, name: &str, root: Vec3) -> Vec<JointId> {
        let (mut at, mut rise, mut yaw) = (root, self.rise, 180.0);
        let ring = |t: f32| {
            let r = self.thick[0] + (self.thick[1] - self.thick[0]) * t * (1.4 - 0.4 * t);
            Ring::oval(r, r * self.tall)
        };
        let mut nodes = vec![Node::new(at, ring(0.0))];
        for k in 1..=self.joints {
            at += direction(yaw, rise.clamp(-88.0, 88.0)) * (self.length / self.joints as f32);
            (rise, yaw) = (rise + self.curl, yaw - self.sway);
            nodes.push(Node::new(at, ring(k as f32 / self.joints as f32)));
        }
        body.chain(parent, (1..=self.joints).map(|k| format!("{name}_{k}")), &nodes, Vec3::X)
    }
}

/// A curved cone that follows one joint: a horn, a claw, a tusk.
pub(crate) fn horn(body: &mut Body, joint: JointId, root: Vec3, out: Vec3, bend: Vec3, length: f32, radius: f32) {
    let points = [0.0, 0.35, 0.7, 1.0].map(|t: f32| {
        let at = root + out * (length * t) + bend * (length * t * t);
        (at, Ring::round(radius * (1.0 - 0.93 * t)), joint.0)
    });
    body.loft(Loft::through(&points, Vec3::X));
}

/// A flat plate or spike that stands on a place of the back and follows one joint.
pub(crate) fn spike(body: &mut Body, joint: JointId, root: Vec3, out: Vec3, height: f32, along: f32, thick: f32) {
    let points = [(0.0, 0.9), (0.45, 1.0), (0.8, 0.5), (1.0, 0.08)].map(|(t, wide): (f32, f32)| {
        (root + out * (height * t), Ring::oval(along * wide, thick * (1.0 - 0.8 * t)), joint.0)
    });
    body.loft(Loft::through(&points, Vec3::Z));
}
