//! Legs, feelers and claws of what wears its skeleton outside.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::piece::Loft;
use crate::turn::direction;

/// A leg of two to four joints that rises to its knee and comes down to the ground.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg {
    pub root: Vec3,
    /// Degrees from the front towards the left.
    pub yaw: f32,
    /// Reach to the side, and how high the knee is above the root.
    pub reach: f32,
    pub rise: f32,
    pub radius: f32,
    pub joints: usize,
}

impl Leg {
    pub fn grow(self, body: &mut Body, parent: JointId, side: Side, name: &str) -> Vec<JointId> {
        let out = direction(self.yaw, 0.0);
        let foot = Vec3::new(self.root.x, self.radius, self.root.z) + out * self.reach;
        let knee = self.root + out * (0.46 * self.reach) + Vec3::Y * self.rise;
        let ankle = knee + (foot - knee) * 0.68 + out * (0.04 * self.reach);
        let hip = self.root + (knee - self.root) * 0.16;
        let all = [(self.root, 1.0), (hip, 1.15), (knee, 0.85), (ankle, 0.55), (foot, 0.25)];
        let kept: &[usize] = match self.joints {
            2 => &[0, 2, 4],
            3 => &[0, 2, 3, 4],
            _ => &[0, 1, 2, 3, 4],
        };
        let nodes: Vec<Node> = kept.iter().map(|&k| Node::round(side.of(all[k].0), all[k].1 * self.radius)).collect();
        let names = (1..nodes.len()).map(|k| format!("{name}_{k}_{}", side.word().to_lowercase()));
        body.strand(parent, names, &nodes, Vec3::Y)
    }
}

/// A feeler that curves up and out, of `joints` joints; with none it follows its parent.
pub(crate) fn feeler(
    body: &mut Body,
    head: JointId,
    side: Side,
    root: Vec3,
    [length, radius]: [f32; 2],
    joints: usize,
    dice: &mut Dice,
) {
    let (out, up) = (direction(dice.between(20.0, 55.0), dice.between(15.0, 60.0)), dice.between(-0.3, 0.4));
    let at = |t: f32| side.of(root + out * (length * t) + Vec3::Y * (up * length * t * t));
    let steps = joints.max(2);
    let nodes: Vec<Node> =
        (0..=steps).map(|k| k as f32 / steps as f32).map(|t| Node::round(at(t), radius * (1.0 - 0.6 * t))).collect();
    if joints == 0 {
        let points: Vec<_> = nodes.iter().map(|node| (node.at, node.ring, head.0)).collect();
        return body.loft(Loft::through(&points, Vec3::Y));
    }
    let names = (1..=joints).map(|k| format!("antenna_{k}_{}", side.word().to_lowercase()));
    let nodes = if joints == 1 { vec![nodes[0], nodes[2]] } else { nodes };
    body.strand(head, names, &nodes, Vec3::Y);
}

/// An arm with pincers: two joints of arm, one of hand, one of the moving finger.
pub(crate) fn claw(body: &mut Body, parent: JointId, side: Side, root: Vec3, reach: f32, radius: f32, size: f32) {
    let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
    let elbow = root + direction(65.0, 25.0) * (0.5 * reach);
    let wrist = elbow + direction(8.0, -18.0) * (0.5 * reach);
    let ahead = direction(-6.0, 0.0);
    let nodes = [
        Node::round(side.of(root), radius),
        Node::round(side.of(elbow), 1.2 * radius),
        Node::round(side.of(wrist), 0.9 * radius),
    ];
    let arm = body.strand(parent, ["claw_upper", "claw_fore"].map(name), &nodes, Vec3::Y);
    let hand = body.joint(arm[1], name("claw_hand"), side.of(wrist));
    let middle = wrist + ahead * (0.5 * size);
    body.oval(hand, side.of(middle), Vec3::Z, Vec3::new(0.30, 0.22, 0.5) * size);
    let hinge = wrist + ahead * (0.75 * size);
    let finger = body.joint(hand, name("claw_finger"), side.of(hinge + Vec3::X * (0.16 * size)));
    for (joint, x) in [(hand, -0.14), (finger, 0.16)] {
        let at = |t: f32| {
            side.of(hinge + Vec3::X * (size * (x + 0.5 * x * t - 1.3 * x * t * t)) + ahead * (0.75 * size * t))
        };
        let points =
            [(0.0, 0.11), (0.5, 0.09), (1.0, 0.015)].map(|(t, r)| (at(t), crate::part::Ring::round(r * size), joint.0));
        body.loft(Loft::through(&points, Vec3::Y));
    }
}
