//! Bipeds: people, children, heroes, brutes and cartoon figures, with Mixamo's joint names.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::{Dice, proportions};
use crate::part::Ring;
use crate::piece::{Ball, Piece};
use crate::turn::{direction, turned};

proportions! {
    /// Lengths and half widths in shares of the body height unless said otherwise.
    Shape {
        /// Body height in metres.
        height,
        /// Head height.
        head,
        /// Head width and depth in shares of its height.
        head_width,
        head_depth,
        neck,
        neck_radius,
        /// Height of the crotch.
        crotch,
        /// From the middle to the shoulder joint.
        shoulders,
        chest_depth,
        waist,
        waist_depth,
        hips,
        /// From the middle to the hip joint.
        hip_joint,
        belly,
        upper_arm,
        forearm,
        hand,
        /// Radii: at the shoulder, elbow, wrist.
        arm_radius,
        elbow,
        wrist,
        thigh,
        knee,
        calf,
        ankle,
        foot,
    }
}

const ARCHETYPES: [Shape; 5] = [
    // A woman.
    Shape {
        height: 1.67,
        head: 0.135,
        head_width: 0.70,
        head_depth: 0.86,
        neck: 0.045,
        neck_radius: 0.027,
        crotch: 0.475,
        shoulders: 0.098,
        chest_depth: 0.062,
        waist: 0.066,
        waist_depth: 0.050,
        hips: 0.096,
        hip_joint: 0.052,
        belly: 0.0,
        upper_arm: 0.165,
        forearm: 0.142,
        hand: 0.105,
        arm_radius: 0.026,
        elbow: 0.020,
        wrist: 0.0135,
        thigh: 0.049,
        knee: 0.030,
        calf: 0.0085,
        ankle: 0.0195,
        foot: 0.140,
    },
    // A broad man.
    Shape {
        height: 1.82,
        head: 0.130,
        head_width: 0.72,
        head_depth: 0.88,
        neck: 0.040,
        neck_radius: 0.036,
        crotch: 0.465,
        shoulders: 0.120,
        chest_depth: 0.076,
        waist: 0.078,
        waist_depth: 0.060,
        hips: 0.090,
        hip_joint: 0.052,
        belly: 0.1,
        upper_arm: 0.170,
        forearm: 0.148,
        hand: 0.108,
        arm_radius: 0.035,
        elbow: 0.026,
        wrist: 0.0170,
        thigh: 0.050,
        knee: 0.033,
        calf: 0.0110,
        ankle: 0.0220,
        foot: 0.152,
    },
    // A child.
    Shape {
        height: 1.15,
        head: 0.190,
        head_width: 0.78,
        head_depth: 0.88,
        neck: 0.022,
        neck_radius: 0.033,
        crotch: 0.410,
        shoulders: 0.098,
        chest_depth: 0.070,
        waist: 0.076,
        waist_depth: 0.066,
        hips: 0.084,
        hip_joint: 0.052,
        belly: 0.35,
        upper_arm: 0.150,
        forearm: 0.130,
        hand: 0.105,
        arm_radius: 0.029,
        elbow: 0.025,
        wrist: 0.0190,
        thigh: 0.048,
        knee: 0.034,
        calf: 0.0070,
        ankle: 0.0240,
        foot: 0.150,
    },
    // A cartoon figure.
    Shape {
        height: 1.05,
        head: 0.330,
        head_width: 0.88,
        head_depth: 0.86,
        neck: 0.010,
        neck_radius: 0.036,
        crotch: 0.270,
        shoulders: 0.105,
        chest_depth: 0.080,
        waist: 0.098,
        waist_depth: 0.088,
        hips: 0.104,
        hip_joint: 0.058,
        belly: 0.5,
        upper_arm: 0.130,
        forearm: 0.115,
        hand: 0.120,
        arm_radius: 0.034,
        elbow: 0.031,
        wrist: 0.0290,
        thigh: 0.051,
        knee: 0.043,
        calf: 0.0040,
        ankle: 0.0380,
        foot: 0.170,
    },
    // A brute.
    Shape {
        height: 2.40,
        head: 0.112,
        head_width: 0.80,
        head_depth: 0.92,
        neck: 0.012,
        neck_radius: 0.048,
        crotch: 0.400,
        shoulders: 0.165,
        chest_depth: 0.112,
        waist: 0.112,
        waist_depth: 0.092,
        hips: 0.104,
        hip_joint: 0.066,
        belly: 0.6,
        upper_arm: 0.190,
        forearm: 0.175,
        hand: 0.135,
        arm_radius: 0.052,
        elbow: 0.040,
        wrist: 0.0310,
        thigh: 0.062,
        knee: 0.045,
        calf: 0.0140,
        ankle: 0.0320,
        foot: 0.165,
    },
];

/// How the rest pose holds its limbs, in degrees.
struct Stance {
    /// Arms below the horizontal: 0 is a T-pose, 45 an A-pose.
    arms_down: f32,
    /// Arms before the body's plane.
    arms_forward: f32,
    elbow: f32,
    /// Legs outwards from the vertical.
    legs_apart: f32,
    knee: f32,
    toes_out: f32,
}

impl Stance {
    fn draw(dice: &mut Dice) -> Self {
        let arms_down = match dice.below(3) {
            0 => dice.between(0.0, 6.0),
            1 => dice.between(35.0, 52.0),
            _ => dice.between(0.0, 62.0),
        };
        Self {
            arms_down,
            arms_forward: dice.between(-4.0, 8.0),
            elbow: dice.between(0.0, 16.0),
            legs_apart: dice.between(1.5, 11.0),
            knee: dice.between(0.0, 8.0),
            toes_out: dice.between(0.0, 16.0),
        }
    }
}

/// How many bones of the hand the skin can show.
#[derive(Clone, Copy, PartialEq)]
enum Hand {
    /// One joint.
    Mitten,
    /// Thumb and two to four fingers of three joints each.
    Fingers(usize),
}

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.08, dice);
    let stance = Stance::draw(dice);
    let hand = match dice.below(4) {
        0 => Hand::Mitten,
        _ if triangles < 2_500 => Hand::Mitten,
        1 => Hand::Fingers(3),
        _ => Hand::Fingers(4),
    };
    let lopsided = if dice.chance(0.3) { dice.between(0.0, 0.05) } else { 0.0 };
    Builder { shape, stance, hand, lopsided, body: Body::new("mixamorig:Hips", Vec3::ZERO) }.build(dice)
}

struct Builder {
    shape: Shape,
    stance: Stance,
    hand: Hand,
    /// By how much the left limbs are longer and the right ones shorter.
    lopsided: f32,
    body: Body,
}

impl Builder {
    fn build(mut self, dice: &mut Dice) -> Body {
        let chest = self.torso();
        self.head(chest, dice);
        for side in Side::BOTH {
            self.arm(chest, side);
            self.leg(side);
        }
        self.body.scaled(self.shape.height)
    }

    fn limb(&self, length: f32, side: Side) -> f32 {
        length * (1.0 + side.sign() * self.lopsided)
    }

    fn hips_y(&self) -> f32 {
        self.shape.crotch + 0.045
    }

    fn neck_y(&self) -> f32 {
        1.0 - self.shape.head - self.shape.neck
    }

    /// Hips to chest; gives the chest.
    fn torso(&mut self) -> JointId {
        let s = self.shape;
        let (low, high) = (self.hips_y(), self.neck_y());
        let y = |t: f32| low + (high - low) * t;
        // The spine curves: the belly before it, the chest behind.
        let at = |t: f32, z: f32| Vec3::new(0.0, y(t), z);
        let ring = |side: f32, up: f32| Ring::oval(side, up);
        let ribs = 0.82 * s.shoulders;
        let nodes = [
            Node::new(at(0.0, 0.0), ring(s.hips, 0.72 * s.hips)),
            Node::new(at(0.20, 0.004), ring(0.5 * (s.waist + s.hips), s.waist_depth + 0.1 * s.belly * s.waist)),
            Node::new(at(0.42, 0.003), ring(s.waist, s.waist_depth + 0.12 * s.belly * s.waist)),
            Node::new(at(0.66, -0.003), ring(ribs, s.chest_depth)),
            Node::new(at(0.90, -0.008), ring(0.72 * ribs, 0.62 * s.chest_depth)),
        ];
        self.body.joints[0].head = nodes[0].at.into();
        let mut chain = vec![Body::ROOT];
        for (name, node) in ["Spine", "Spine1", "Spine2"].into_iter().zip(&nodes[1..]) {
            let above = *chain.last().expect("the root");
            chain.push(self.body.joint(above, format!("mixamorig:{name}"), node.at));
        }
        self.body.flesh(&chain, &nodes, Vec3::X);
        if s.belly > 0.05 {
            let r = Vec3::new(s.waist * 0.95, (high - low) * 0.24, s.waist_depth * 0.9);
            let center = at(0.26, 0.35 * s.belly * s.waist_depth + 0.01);
            self.body.mass(chain[1], center, Vec3::Z, r);
        }
        chain[3]
    }

    fn head(&mut self, chest: JointId, dice: &mut Dice) {
        let s = self.shape;
        let h = s.head;
        let base = Vec3::new(0.0, self.neck_y(), -0.008);
        let skull = Vec3::new(0.0, 1.0 - s.head + 0.12 * h, -0.002);
        let r = s.neck_radius;
        let neck = self.body.joint(chest, "mixamorig:Neck", base);
        let low = base - Vec3::Y * (0.5 * r);
        let nodes = [Node::round(low, 1.25 * r), Node::round(skull, r)];
        self.body.flesh(&[neck], &nodes, Vec3::X);
        let head = self.body.joint(neck, "mixamorig:Head", skull);
        let (w, d) = (0.5 * s.head_width * h, 0.5 * s.head_depth * h);
        // Skull, face with jaw, nose, ears.
        let crown = skull + Vec3::new(0.0, 0.44 * h, 0.02 * h);
        self.body.mass(head, crown, Vec3::Z, Vec3::new(w, 0.44 * h, d));
        let jaw = skull + Vec3::new(0.0, 0.16 * h, 0.24 * d);
        let jaw_size = dice.between(0.62, 0.82);
        self.body.mass(head, jaw, Vec3::Z, Vec3::new(jaw_size * w, 0.26 * h, 0.72 * d));
        let nose = dice.between(0.06, 0.10) * h;
        let tip = skull + Vec3::new(0.0, 0.30 * h, 0.99 * d);
        self.body.mass(head, tip, direction(0.0, -30.0), Vec3::new(0.7 * nose, 0.9 * nose, 1.3 * nose));
        let ear = dice.between(0.10, 0.15) * h;
        for side in Side::BOTH {
            let at = skull + side.of(Vec3::new(0.98 * w, 0.38 * h, -0.08 * h));
            let lean = side.of(Vec3::new(0.8, 0.0, -0.6));
            self.body.mass(head, at, lean, Vec3::new(0.5 * ear, 1.2 * ear, 0.8 * ear));
        }
        if dice.chance(0.6) {
            let radius = dice.between(0.055, 0.075) * h;
            for side in Side::BOTH {
                let center = skull + side.of(Vec3::new(0.42 * w, 0.44 * h, 0.84 * d));
                self.body.pieces.push(Piece::Ball(Ball { joint: head.0, center, radius }));
            }
        }
    }

    fn arm(&mut self, chest: JointId, side: Side) {
        let s = self.shape;
        let name = |part: &str| format!("mixamorig:{}{part}", side.word());
        let x = s.shoulders;
        let shoulder_y = self.neck_y() - 0.022;
        let z = -0.008;
        let r = s.arm_radius;
        let shoulder = Vec3::new(x, shoulder_y, z);
        let root = Vec3::new(0.22 * x, shoulder_y + 0.10 * r, z);
        let clavicle = self.body.joint(chest, name("Shoulder"), side.of(root));
        let out = direction(90.0 - self.stance.arms_forward, -self.stance.arms_down);
        let bent = turned(out, Vec3::Y, -self.stance.elbow);
        let elbow = shoulder + out * self.limb(s.upper_arm, side);
        let wrist = elbow + bent * self.limb(s.forearm, side);
        let top = 0.95 * r;
        self.body.bone(clavicle, side.of(shoulder), Ring::oval(1.1 * top, top), Ring::round(1.02 * r), Vec3::Z);
        let nodes = [
            Node::round(side.of(shoulder), 1.04 * r).belly(0.10 * r),
            Node::round(side.of(elbow), s.elbow).belly(0.20 * s.elbow),
            Node::new(side.of(wrist), Ring::oval(0.85 * s.wrist, 1.1 * s.wrist)),
        ];
        let arm = self.body.chain(clavicle, [name("Arm"), name("ForeArm")], &nodes, Vec3::Y);
        self.hand(arm[1], side, wrist, bent);
    }

    /// A hand with its palm down, given for the left side.
    fn hand(&mut self, forearm: JointId, side: Side, wrist: Vec3, along: Vec3) {
        let s = self.shape;
        let name = |part: String| format!("mixamorig:{}Hand{part}", side.word());
        let length = self.limb(s.hand, side);
        let (r, front) = (s.wrist, crate::turn::across(along, Vec3::Z));
        let hand = self.body.joint(forearm, name(String::new()), side.of(wrist));
        let up = front.cross(along);
        let up = if up.y < 0.0 { -up } else { up };
        let width = 0.21 * length;
        let knuckles = wrist + along * (0.48 * length);
        let start = Node::new(side.of(wrist), Ring::oval(1.1 * r, 0.85 * r));
        let Hand::Fingers(fingers) = self.hand else {
            // Palm and closed fingers in one, the thumb beside.
            let end = Node::new(side.of(wrist + along * (0.82 * length)), Ring::oval(0.75 * width, 0.085 * length));
            self.body.flesh(&[hand], &[start.belly(0.25 * r), end], side.of(front));
            let thumb = wrist + along * (0.30 * length) + front * (0.95 * width);
            let lean = side.of((along + front * 0.55).normalize());
            self.body.mass(hand, side.of(thumb), lean, Vec3::new(0.07 * length, 0.07 * length, 0.22 * length));
            return;
        };
        let end = Node::new(side.of(knuckles), Ring::oval(width, 0.095 * length));
        self.body.flesh(&[hand], &[start, end], side.of(front));
        let thick = 0.2 * length / (fingers as f32 + 0.2);
        let names: &[(&str, f32)] = match fingers {
            3 => &[("Index", 0.92), ("Middle", 1.0), ("Pinky", 0.8)],
            _ => &[("Index", 0.93), ("Middle", 1.0), ("Ring", 0.94), ("Pinky", 0.76)],
        };
        for (k, (finger, reach)) in names.iter().enumerate() {
            // From +1 at the index to -1 at the little finger.
            let off = 1.0 - 2.0 * k as f32 / (fingers as f32 - 1.0);
            let root = knuckles + front * (off * (width - 0.6 * thick)) - along * (0.03 * length * off * off);
            let spread = (along + front * (0.24 * off)).normalize();
            self.digit(hand, side, finger, root, spread, -up, reach * 0.5 * length, thick);
        }
        let root = wrist + along * (0.16 * length) + front * (0.75 * width) - up * (0.02 * length);
        let lean = (along + front * 0.85 - up * 0.15).normalize();
        self.digit(hand, side, "Thumb", root, lean, -up, 0.46 * length, 1.15 * thick);
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
        let names = (1..=3).map(|k| format!("mixamorig:{}Hand{finger}{k}", side.word()));
        self.body.chain(hand, names, &nodes, Vec3::Z);
    }

    fn leg(&mut self, side: Side) {
        let s = self.shape;
        let name = |part: &str| format!("mixamorig:{}{part}", side.word());
        let hip = Vec3::new(s.hip_joint, self.hips_y() - 0.012, 0.0);
        let ankle_y = 0.62 * s.ankle + 0.022;
        let reach = hip.y - ankle_y;
        // Down and apart, the knee before the line from hip to ankle.
        let apart = turned(-Vec3::Y, Vec3::Z, self.stance.legs_apart);
        let knee_share = 0.515;
        let length = self.limb(reach, side);
        let forward = crate::turn::sin_cos(self.stance.knee).0 * 0.25 * length;
        let knee = hip + apart * (knee_share * length) + Vec3::Z * (forward + 0.01 * length);
        let ankle = hip + apart * length - Vec3::Z * (0.02 * length);
        let (thigh, calf) = (s.thigh, s.calf);
        let nodes = [
            Node::round(side.of(hip), thigh).belly(0.04 * thigh),
            Node::round(side.of(knee), s.knee).belly(calf),
            Node::round(side.of(ankle), s.ankle),
        ];
        let leg = self.body.chain(Body::ROOT, [name("UpLeg"), name("Leg")], &nodes, Vec3::X);
        // The foot: ankle to ball, ball to toes, and the heel behind.
        let size = s.foot;
        let toes = direction(self.stance.toes_out, 0.0);
        let r = s.ankle;
        let sole = ankle.y - ankle_y;
        let ball = Vec3::new(ankle.x, sole + 0.115 * size, ankle.z) + toes * (0.46 * size);
        let tip = Vec3::new(ankle.x, sole + 0.095 * size, ankle.z) + toes * (0.66 * size);
        let nodes = [
            Node::round(side.of(ankle), 1.0 * r),
            Node::new(side.of(ball), Ring::oval(0.20 * size, 0.115 * size)),
            Node::new(side.of(tip), Ring::oval(0.17 * size, 0.095 * size)),
        ];
        let foot = self.body.chain(leg[1], [name("Foot"), name("ToeBase")], &nodes, Vec3::X);
        let heel = Vec3::new(ankle.x, sole + 0.14 * size, ankle.z) - toes * (0.06 * size);
        self.body.mass(foot[0], side.of(heel), side.of(toes), Vec3::new(0.15 * size, 0.14 * size, 0.21 * size));
    }
}
