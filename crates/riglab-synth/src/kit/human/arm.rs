//! Arms, hands and fingers, and limbs of two bones with joints for their twist.

use glam::Vec3;
use riglab_core::JointId;

use super::{Figure, Hand};
use crate::body::{Node, Side};
use crate::part::Ring;
use crate::turn::{direction, turned};

impl Figure {
    /// Clavicle, arm and hand; gives the hand.
    pub fn arm(&mut self, chest: JointId, side: Side) -> JointId {
        let s = self.shape;
        let x = s.shoulders;
        let shoulder_y = self.neck_y() - 0.022 - self.lower;
        let z = -0.008;
        let r = s.arm_radius;
        let shoulder = Vec3::new(x, shoulder_y, z);
        let root = Vec3::new(0.22 * x, shoulder_y + 0.10 * r, z);
        let clavicle = if self.clavicles { self.bone(chest, &side.bone("Shoulder"), side.of(root)) } else { chest };
        let out = direction(90.0 - self.stance.arms_forward, -self.stance.arms_down);
        let bent = turned(out, Vec3::Y, -self.stance.elbow);
        let elbow = shoulder + out * self.limb(s.upper_arm, side);
        let wrist = elbow + bent * self.limb(s.forearm, side);
        let top = 0.95 * r;
        let ends = [Node::new(side.of(root), Ring::oval(1.1 * top, top)), Node::round(side.of(shoulder), 1.02 * r)];
        self.body.flesh(&[clavicle], &ends, Vec3::Z);
        let nodes = [
            Node::round(side.of(shoulder), 1.04 * r).belly(0.10 * r),
            Node::round(side.of(elbow), s.elbow).belly(0.20 * s.elbow),
            Node::new(side.of(wrist), Ring::oval(0.85 * s.wrist, 1.1 * s.wrist)),
        ];
        let forearm = self.twisted(clavicle, side, ["UpperArm", "LowerArm"], &nodes, Vec3::Y, true);
        // Painters let the shoulder follow the arm far into the chest.
        if self.clavicles {
            self.body.soft.push((clavicle, 1.6));
        }
        self.hand(forearm, side, wrist, bent)
    }

    /// A hand with its palm down, given for the left side.
    fn hand(&mut self, forearm: JointId, side: Side, wrist: Vec3, along: Vec3) -> JointId {
        let s = self.shape;
        let length = self.limb(s.hand, side);
        let (r, front) = (s.wrist, crate::turn::across(along, Vec3::Z));
        let hand = self.bone(forearm, &side.bone("Hand"), side.of(wrist));
        self.after_twist(hand, forearm);
        let up = front.cross(along);
        let up = if up.y < 0.0 { -up } else { up };
        let width = 0.21 * length;
        let knuckles = wrist + along * (0.48 * length);
        let start = Node::new(side.of(wrist), Ring::oval(1.1 * r, 0.85 * r));
        let names: &[(&str, f32)] = match self.hand {
            Hand::Mitten => &[],
            Hand::Three => &[("Index", 0.92), ("Middle", 1.0), ("Little", 0.8)],
            Hand::Four => &[("Index", 0.93), ("Middle", 1.0), ("Ring", 0.94), ("Little", 0.76)],
        };
        if names.is_empty() {
            // Palm and closed fingers in one, the thumb beside.
            let end = Node::new(side.of(wrist + along * (0.82 * length)), Ring::oval(0.75 * width, 0.085 * length));
            self.body.flesh(&[hand], &[start.belly(0.25 * r), end], side.of(front));
            let thumb = wrist + along * (0.30 * length) + front * (0.95 * width);
            let lean = side.of((along + front * 0.55).normalize());
            self.body.mass(hand, side.of(thumb), lean, Vec3::new(0.07 * length, 0.07 * length, 0.22 * length));
            return hand;
        }
        let fingers = names.len() as f32;
        let end = Node::new(side.of(knuckles), Ring::oval(width, 0.095 * length));
        self.body.flesh(&[hand], &[start, end], side.of(front));
        let thick = 0.2 * length / (fingers + 0.2);
        for (k, (finger, reach)) in names.iter().enumerate() {
            // From +1 at the index to -1 at the little finger.
            let off = 1.0 - 2.0 * k as f32 / (fingers - 1.0);
            let root = knuckles + front * (off * (width - 0.6 * thick)) - along * (0.03 * length * off * off);
            let spread = (along + front * (0.24 * off)).normalize();
            self.digit(hand, side, finger, root, spread, -up, reach * 0.5 * length, thick);
        }
        let root = wrist + along * (0.16 * length) + front * (0.75 * width) - up * (0.02 * length);
        let lean = (along + front * 0.85 - up * 0.15).normalize();
        self.digit(hand, side, "Thumb", root, lean, -up, 0.46 * length, 1.15 * thick);
        hand
    }

    /// A finger of three joints that curls a little towards `curl`.
    #[allow(clippy::too_many_arguments)]
    fn digit(
        &mut self,
        hand: JointId,
        side: Side,
        finger: &str,
        root: Vec3,
        along: Vec3,
        curl: Vec3,
        length: f32,
        r: f32,
    ) {
        let mut at = root;
        let mut along = along;
        let mut nodes = vec![Node::round(side.of(at), r)];
        for (share, radius) in [(0.45, 0.94), (0.31, 0.88), (0.24, 0.74)] {
            at += along * (share * length);
            along = (along + curl * 0.10).normalize();
            nodes.push(Node::round(side.of(at), radius * r));
        }
        let parts = if finger == "Thumb" {
            ["Metacarpal", "Proximal", "Distal"]
        } else {
            ["Proximal", "Intermediate", "Distal"]
        };
        let mut above = hand;
        let chain = [0, 1, 2].map(|k| {
            above = self.bone(above, &side.bone(&format!("{finger}{}", parts[k])), nodes[k].at);
            above
        });
        self.body.flesh(&chain, &nodes, Vec3::Z);
    }

    /// A limb of two bones at three nodes; gives the lower bone. Where the figure has twist joints each
    /// bone's far half is held by one, the lower bone's only if `both`.
    pub fn twisted(
        &mut self,
        parent: JointId,
        side: Side,
        bones: [&str; 2],
        nodes: &[Node; 3],
        hint: Vec3,
        both: bool,
    ) -> JointId {
        let upper = self.bone(parent, &side.bone(bones[0]), nodes[0].at);
        if !self.twists {
            let lower = self.bone(upper, &side.bone(bones[1]), nodes[1].at);
            self.body.flesh(&[upper, lower], nodes, hint);
            return lower;
        }
        let half = |k: usize| {
            let (a, b) = (nodes[k], nodes[k + 1]);
            let ring = |a: f32, b: f32| 0.5 * (a + b) + a.min(b).min(nodes[k].belly);
            Node::new(0.5 * (a.at + b.at), Ring::oval(ring(a.ring.side, b.ring.side), ring(a.ring.up, b.ring.up)))
        };
        let bare = |node: Node| Node { belly: 0.0, ..node };
        let twist = |bone: &str| self.names.twist(&side.bone(bone)) + &self.suffix;
        let (first, second) = (twist(bones[0]), twist(bones[1]));
        let upper_twist = self.body.joint(upper, first, half(0).at);
        let lower = self.bone(upper, &side.bone(bones[1]), nodes[1].at);
        self.body.grown.push((lower, upper_twist));
        let mut chain = vec![upper, upper_twist, lower];
        let mut all = vec![bare(nodes[0]), half(0), bare(nodes[1])];
        if both {
            chain.push(self.body.joint(lower, second, half(1).at));
            all.push(half(1));
        } else {
            all[2] = nodes[1];
        }
        all.push(bare(nodes[2]));
        self.body.flesh(&chain, &all, hint);
        lower
    }

    /// The flesh of a hand grows from the twist joint of its forearm, where it has one.
    fn after_twist(&mut self, hand: JointId, forearm: JointId) {
        let twist = hand.0.checked_sub(1).map(JointId).filter(|&j| self.twists && j != forearm);
        self.body.grown.extend(twist.map(|twist| (hand, twist)));
    }
}
