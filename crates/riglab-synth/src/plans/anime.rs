//! Avatars in the style of Japanese animation, as VRoid Studio makes them: large heads, slender
//! limbs, hair and a skirt on spring bones, and VRM's map of human bones.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::kit::human::{Figure, Hand, Names, Shape};
use crate::part::Ring;
use crate::springs::{Bumper, Kind};
use crate::turn::{direction, sin_cos};

const ARCHETYPES: [Shape; 3] = [
    // A girl of seven heads.
    Shape {
        height: 1.58,
        head: 0.165,
        head_width: 0.80,
        head_depth: 0.84,
        neck: 0.036,
        neck_radius: 0.020,
        crotch: 0.480,
        shoulders: 0.078,
        chest_depth: 0.052,
        waist: 0.050,
        waist_depth: 0.042,
        hips: 0.082,
        hip_joint: 0.045,
        belly: 0.0,
        upper_arm: 0.150,
        forearm: 0.135,
        hand: 0.095,
        arm_radius: 0.020,
        elbow: 0.0165,
        wrist: 0.0120,
        thigh: 0.044,
        knee: 0.028,
        calf: 0.0070,
        ankle: 0.0170,
        foot: 0.125,
    },
    // A young man.
    Shape {
        height: 1.75,
        head: 0.145,
        head_width: 0.78,
        head_depth: 0.86,
        neck: 0.042,
        neck_radius: 0.027,
        crotch: 0.490,
        shoulders: 0.100,
        chest_depth: 0.060,
        waist: 0.060,
        waist_depth: 0.048,
        hips: 0.078,
        hip_joint: 0.046,
        belly: 0.0,
        upper_arm: 0.160,
        forearm: 0.142,
        hand: 0.102,
        arm_radius: 0.026,
        elbow: 0.0205,
        wrist: 0.0150,
        thigh: 0.044,
        knee: 0.030,
        calf: 0.0080,
        ankle: 0.0195,
        foot: 0.140,
    },
    // A mascot of three heads.
    Shape {
        height: 0.95,
        head: 0.330,
        head_width: 0.92,
        head_depth: 0.88,
        neck: 0.012,
        neck_radius: 0.030,
        crotch: 0.290,
        shoulders: 0.085,
        chest_depth: 0.068,
        waist: 0.075,
        waist_depth: 0.066,
        hips: 0.090,
        hip_joint: 0.048,
        belly: 0.2,
        upper_arm: 0.115,
        forearm: 0.105,
        hand: 0.095,
        arm_radius: 0.027,
        elbow: 0.0240,
        wrist: 0.0210,
        thigh: 0.046,
        knee: 0.036,
        calf: 0.0040,
        ankle: 0.0300,
        foot: 0.135,
    },
];

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.07, dice);
    let mut figure = Figure::new(shape, Names::VRoid, dice);
    (figure.mapped, figure.lopsided) = (true, 0.0);
    figure.hand = if triangles < 3_500 { Hand::Mitten } else { Hand::Four };
    let chest = figure.torso();
    let head = figure.head(chest, dice);
    for side in Side::BOTH {
        figure.arm(chest, side);
        figure.leg(side);
    }
    let detail = if triangles < 2_500 { 0 } else { 1 };
    eyes(&mut figure, head);
    hair(&mut figure, head, detail, dice);
    if dice.chance(0.55) {
        bust(&mut figure, chest, dice);
    }
    if dice.chance(0.7) {
        let length = dice.between(0.25, 0.9);
        figure.skirt(length, dice.count(5, 8 + 2 * detail), dice.count(2, 2 + detail), dice);
    }
    if dice.chance(0.25) {
        ears(&mut figure, head, dice);
    }
    if dice.chance(0.2) {
        tail(&mut figure, dice);
    }
    bumpers(&mut figure, chest, head);
    figure.body.scaled(shape.height)
}

/// Eyes that look around, each on a joint.
fn eyes(figure: &mut Figure, head: JointId) {
    let (middle, size) = figure.skull(head);
    for side in Side::BOTH {
        let at = middle + side.of(Vec3::new(0.40 * size.x, -0.10 * size.y, 0.70 * size.z));
        let eye = figure.body.joint(head, format!("J_Adj_{}_FaceEye", side.letter()), at);
        figure.body.human.extend(format!("{}Eye", side.word().to_lowercase()).parse().ok().map(|bone| (bone, eye)));
        let lens = Vec3::new(0.22 * size.x, 0.30 * size.y, 0.30 * size.z);
        figure.body.oval(eye, at, Vec3::Z, lens);
    }
}

/// A cap and strands: bangs in front, locks at the sides, long ones behind or in tails.
fn hair(figure: &mut Figure, head: JointId, detail: usize, dice: &mut Dice) {
    let (middle, size) = figure.skull(head);
    let back = Vec3::new(0.0, 0.14 * size.y, -0.14 * size.z);
    figure.body.oval(head, middle + back, direction(0.0, 32.0), size * Vec3::new(1.12, 1.02, 1.08));
    let mut strands = Strands { head, middle, size: size * 1.12, count: 0 };
    // Angle from the front, length in heights of the skull, joints, outward lean.
    let bangs = dice.count(2, 3 + detail);
    for k in 0..bangs {
        let angle = 80.0 * ((k as f32 + 0.5) / bangs as f32 - 0.5);
        strands.hang(figure, angle, dice.between(0.55, 0.8), 1 + detail, 0.10, dice);
    }
    for side in [1.0, -1.0] {
        strands.hang(figure, side * 80.0, dice.between(0.9, 2.2), 2 + detail, 0.12, dice);
    }
    let long = dice.between(0.8, 3.6);
    let behind = dice.count(2, 4 + detail);
    for k in 0..behind {
        let angle = 180.0 + 130.0 * ((k as f32 + 0.5) / behind as f32 - 0.5);
        strands.hang(figure, angle, long * dice.between(0.85, 1.1), 2 + detail, 0.15, dice);
    }
    if dice.chance(0.3) {
        for side in [1.0, -1.0] {
            strands.hang(figure, side * 118.0, dice.between(2.5, 4.5), 3 + detail, 0.9, dice);
        }
    }
}

/// Strands around a head.
struct Strands {
    head: JointId,
    middle: Vec3,
    size: Vec3,
    count: usize,
}

impl Strands {
    /// A strand at an angle from the front, as long as `length` half heights of the skull.
    fn hang(&mut self, figure: &mut Figure, angle: f32, length: f32, joints: usize, lean: f32, dice: &mut Dice) {
        self.count += 1;
        let (sin, cos) = sin_cos(angle);
        let out = Vec3::new(sin, 0.0, cos);
        // From near the crown, over the skull, then down.
        let high = 0.62;
        let root = self.middle + self.size * Vec3::new(0.76 * sin, high, 0.76 * cos);
        let down = length * self.size.y * (0.7 + 0.3 * high);
        let width = self.size.x * if lean > 0.5 { 0.26 } else { 0.30 };
        let wave = 0.06 * dice.bell();
        let nodes: Vec<Node> = (0..=joints)
            .map(|k| {
                let t = k as f32 / joints as f32;
                let skull = self.size * Vec3::new(sin, 0.0, cos) * 0.30 * (1.0 - (1.0 - t) * (1.0 - t));
                let away = out * (lean * down * t * (1.4 - t) + wave * down * t);
                let at = root + skull + away - Vec3::Y * (down * t);
                let wide = width * (1.0 - 0.82 * t * t);
                Node::new(at, Ring::oval(wide, 0.45 * wide))
            })
            .collect();
        let number = self.count;
        let names = (1..=joints).map(|k| format!("J_Sec_Hair{k}_{number:02}"));
        let across = Vec3::new(cos, 0.0, -sin);
        let chain = figure.body.strand(self.head, names, &nodes, across);
        figure.body.swings("hair", &chain, Kind::Hair, dice);
    }
}

fn bust(figure: &mut Figure, chest: JointId, dice: &mut Dice) {
    let s = figure.shape;
    let at = figure.body.at(chest);
    let size = dice.between(0.6, 1.0) * s.chest_depth;
    for side in Side::BOTH {
        let root = at + side.of(Vec3::new(0.42 * s.shoulders, 0.005, 0.55 * s.chest_depth));
        let joint = figure.body.joint(chest, format!("J_Sec_{}_Bust1", side.letter()), root);
        let center = root + Vec3::new(0.0, -0.1 * size, 0.35 * s.chest_depth);
        figure.body.mass(joint, center, Vec3::Z, Vec3::new(0.62, 0.60, 0.66) * size);
        figure.body.swings("bust", &[joint], Kind::Bust, dice);
    }
}

/// Ears of a cat or a rabbit on top of the head.
fn ears(figure: &mut Figure, head: JointId, dice: &mut Dice) {
    let (middle, size) = figure.skull(head);
    let length = size.y * dice.between(0.7, 2.2);
    for side in Side::BOTH {
        let root = middle + side.of(Vec3::new(0.62, 0.80, -0.05) * size);
        let lean = side.of(Vec3::new(0.35, 1.0, -0.05)).normalize();
        let wide = 0.34 * size.x;
        let nodes = [0.0, 0.5, 1.0].map(|t: f32| {
            let ring = Ring::oval(wide * (1.0 - 0.85 * t * t), 0.4 * wide * (1.0 - 0.8 * t * t));
            Node::new(root + lean * (length * t), ring)
        });
        let names = (1..=2).map(|k| format!("J_Sec_{}_Ear{k}", side.letter()));
        let chain = figure.body.strand(head, names, &nodes, Vec3::X);
        figure.body.swings("ear", &chain, Kind::Ear, dice);
    }
}

fn tail(figure: &mut Figure, dice: &mut Dice) {
    let s = figure.shape;
    let root = figure.body.at(Body::ROOT) + Vec3::new(0.0, 0.01, -0.65 * s.hips);
    let (n, length) = (dice.count(3, 6), dice.between(0.25, 0.5));
    let rise = dice.between(-30.0, 30.0);
    let thick = dice.between(0.012, 0.03);
    let mut at = root;
    let mut nodes = vec![Node::round(at, 0.7 * thick)];
    for k in 1..=n {
        let t = k as f32 / n as f32;
        at += direction(180.0, rise - 40.0 + 80.0 * t) * (length / n as f32);
        nodes.push(Node::round(at, thick * (0.8 + t * (1.0 - t)) * if k == n { 0.4 } else { 1.0 }));
    }
    let chain = figure.body.strand(Body::ROOT, (1..=n).map(|k| format!("J_Sec_Tail{k}")), &nodes, Vec3::X);
    figure.body.swings("tail", &chain, Kind::Tail, dice);
}

/// Balls in head, chest, hips and thighs that hair and skirt do not enter.
fn bumpers(figure: &mut Figure, chest: JointId, head: JointId) {
    let s = figure.shape;
    let (middle, size) = figure.skull(head);
    let mut add =
        |joint: JointId, center: Vec3, radius: f32| figure.body.bumpers.push(Bumper { joint, center, radius });
    add(head, middle, 0.85 * size.x);
    let (chest_at, hips_at) = (figure.body.joints[chest.index()].head, figure.body.joints[0].head);
    add(chest, chest_at.into(), s.chest_depth);
    add(Body::ROOT, hips_at.into(), 0.85 * s.hips);
    for side in Side::BOTH {
        let thigh = figure.body.named(&figure.names.of(&side.bone("UpperLeg")));
        if let Some(thigh) = thigh {
            let center = figure.body.at(thigh) - Vec3::Y * (1.2 * s.thigh);
            figure.body.bumpers.push(Bumper { joint: thigh, center, radius: 0.85 * s.thigh });
        }
    }
}
