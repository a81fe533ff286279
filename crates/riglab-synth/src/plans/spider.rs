//! Eight legs and more: spiders, scorpions, crabs.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::{Dice, proportions};
use crate::kit::arthropod::{Leg, claw};
use crate::kit::limbs::horn;
use crate::part::Ring;
use crate::turn::{direction, turned};

proportions! {
    /// Lengths and radii in shares of the forebody's length unless said otherwise.
    Shape {
        /// Length of the forebody, in metres.
        size,
        width,
        height,
        /// Length and half width of the hind body; 0.1 or less for none.
        abdomen,
        abdomen_width,
        stand,
        reach,
        /// Height of the knees above the body, in shares of the reach.
        rise,
        leg,
        /// Size of the pincers; 0.1 or less for none.
        claw,
        /// Length of the tail with its sting; 0.1 or less for none.
        tail,
    }
}

const ARCHETYPES: [Shape; 4] = [
    // A garden spider.
    Shape {
        size: 0.02,
        width: 0.36,
        height: 0.28,
        abdomen: 1.3,
        abdomen_width: 0.62,
        stand: 0.62,
        reach: 1.7,
        rise: 0.32,
        leg: 0.05,
        claw: 0.0,
        tail: 0.0,
    },
    // A tarantula.
    Shape {
        size: 0.06,
        width: 0.44,
        height: 0.34,
        abdomen: 1.2,
        abdomen_width: 0.56,
        stand: 0.5,
        reach: 1.3,
        rise: 0.2,
        leg: 0.105,
        claw: 0.0,
        tail: 0.0,
    },
    // A scorpion.
    Shape {
        size: 0.06,
        width: 0.34,
        height: 0.24,
        abdomen: 0.9,
        abdomen_width: 0.36,
        stand: 0.36,
        reach: 0.85,
        rise: 0.22,
        leg: 0.055,
        claw: 0.5,
        tail: 1.7,
    },
    // A crab.
    Shape {
        size: 0.1,
        width: 0.72,
        height: 0.3,
        abdomen: 0.0,
        abdomen_width: 0.1,
        stand: 0.42,
        reach: 1.25,
        rise: 0.26,
        leg: 0.075,
        claw: 0.6,
        tail: 0.0,
    },
];

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    // Its kinds differ in what they have: no mean between crab and spider, only between spiders.
    let kind = dice.below(5).min(3);
    let other = if kind < 2 { dice.below(2) } else { kind };
    let shape = Shape::draw(&[ARCHETYPES[kind], ARCHETYPES[other]], 0.14, dice);
    let s = shape;
    let mut body = Body::new("body", Vec3::ZERO);
    let middle = Vec3::Y * s.stand;
    body.joints[0].head = (middle - Vec3::Z * 0.12).into();
    let ring = Ring::oval(0.8 * s.width, 0.8 * s.height);
    let nodes = [
        Node::new(middle - Vec3::Z * 0.34, ring).belly(0.2 * s.height),
        Node::new(middle + Vec3::Z * 0.34, ring.scaled(0.9)),
    ];
    body.flesh(&[Body::ROOT], &nodes, Vec3::X);
    head(&mut body, &s, middle, dice);
    let mut end = (Body::ROOT, middle - Vec3::Z * 0.42);
    if s.abdomen > 0.1 {
        let root = middle - Vec3::Z * 0.40;
        let joint = body.joint(Body::ROOT, "abdomen", root);
        let lift = if s.tail > 0.1 { 4.0 } else { dice.between(-4.0, 28.0) };
        let along = direction(180.0, lift);
        body.bone(joint, root + along * 0.2, Ring::round(0.3 * s.height), Ring::round(0.4 * s.abdomen_width), Vec3::X);
        let center = root + along * (0.1 + 0.5 * s.abdomen);
        let tall = if s.tail > 0.1 { 1.1 * s.height } else { 0.9 * s.abdomen_width };
        body.mass(joint, center, along, Vec3::new(s.abdomen_width, tall.min(s.abdomen_width), 0.55 * s.abdomen));
        end = (joint, root + along * (0.05 + s.abdomen));
    }
    if s.tail > 0.1 {
        sting(&mut body, &s, end, dice);
    }
    let pairs = if s.claw > 0.1 { dice.count(3, 4) } else { 4 };
    let joints = if triangles < 2_000 { 2 } else { dice.count(2, 4) };
    for side in Side::BOTH {
        for pair in 0..pairs {
            let t = 1.0 - 2.0 * pair as f32 / (pairs - 1) as f32;
            let leg = Leg {
                root: middle + Vec3::new(0.72 * s.width, -0.15 * s.height, 0.26 * t),
                yaw: 90.0 - 52.0 * t + 5.0 * dice.bell(),
                reach: s.reach * (0.88 + 0.2 * t * t),
                rise: s.rise * s.reach * (1.0 + 0.15 * dice.bell()),
                radius: s.leg,
                joints,
            };
            leg.grow(&mut body, Body::ROOT, side, &format!("leg_{}", pair + 1));
        }
        if s.claw > 0.1 {
            let root = middle + Vec3::new(0.55 * s.width, -0.1 * s.height, 0.36);
            claw(&mut body, Body::ROOT, side, root, 0.9 * s.claw + 0.25, 1.3 * s.leg, s.claw);
        }
    }
    body.scaled(s.size)
}

/// Eyes and jaws, on a joint of their own at times.
fn head(body: &mut Body, s: &Shape, middle: Vec3, dice: &mut Dice) {
    let front = middle + Vec3::Z * (0.40 + 0.5 * s.height);
    let head = if dice.chance(0.5) { body.joint(Body::ROOT, "head", front - Vec3::Z * 0.12) } else { Body::ROOT };
    body.mass(head, front - Vec3::Z * 0.08, Vec3::Z, Vec3::new(0.45 * s.width, 0.6 * s.height, 0.16));
    let stalks = s.claw > 0.1 && s.tail <= 0.1;
    for side in Side::BOTH {
        let rows = if stalks { 1 } else { dice.count(1, 4) };
        for k in 0..rows {
            let out = 0.12 + 0.11 * k as f32;
            let at = front + side.of(Vec3::new(out * s.width * 1.6, 0.45 * s.height - 0.03 * k as f32, 0.02));
            let at = if stalks { at + Vec3::Y * (0.7 * s.height) } else { at };
            if stalks {
                horn(body, head, at - Vec3::Y * (0.9 * s.height), Vec3::Y, Vec3::ZERO, 1.0 * s.height, 0.035);
            }
            body.ball(head, at, 0.05 - 0.006 * k as f32);
        }
        if !stalks {
            let name = format!("fang_{}", side.word().to_lowercase());
            let root = front + side.of(Vec3::new(0.14 * s.width, -0.3 * s.height, 0.0));
            let fang = body.joint(head, name, root);
            horn(body, fang, root, direction(0.0, -55.0), -0.3 * Vec3::Z, 0.3, 0.06);
        }
    }
}

/// A tail that curves over the back.
fn sting(body: &mut Body, s: &Shape, (parent, mut at): (JointId, Vec3), dice: &mut Dice) {
    let n = dice.count(4, 6);
    let mut along = direction(180.0, 8.0);
    let bend = dice.between(150.0, 200.0) / n as f32;
    let mut nodes = vec![Node::round(at, 0.45 * s.height)];
    for k in 1..=n {
        at += along * (s.tail / n as f32);
        along = turned(along, Vec3::X, bend);
        nodes.push(Node::round(at, s.height * (0.42 - 0.15 * k as f32 / n as f32)));
    }
    let chain = body.chain(parent, (1..=n).map(|k| format!("tail_{k}")), &nodes, Vec3::X);
    body.mass(chain[n - 1], at, along, Vec3::new(0.46, 0.46, 0.7) * s.height);
    horn(body, chain[n - 1], at + along * (0.5 * s.height), along, Vec3::ZERO, 0.16 * s.tail, 0.2 * s.height);
}
