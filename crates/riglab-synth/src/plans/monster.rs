//! Monsters: a figure with more arms, horns, tails, wings and eyes than people have, on legs or
//! tentacles.

use glam::Vec3;
use riglab_core::JointId;

use super::biped;
use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::kit::human::{Figure, Hand, Names, Shape};
use crate::kit::limbs::{Tail, horn, spike};
use crate::kit::wings::Wing;
use crate::springs::Kind;
use crate::turn::{direction, sin_cos};

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = deformed(Shape::draw(&biped::ARCHETYPES, 0.15, dice), dice);
    let names = if dice.chance(0.5) { Names::Mixamo } else { Names::Blender };
    let mut figure = Figure::new(shape, names, dice);
    figure.hand = match triangles {
        0..4_500 => Hand::Mitten,
        _ if dice.count(3, 4) == 3 => Hand::Three,
        _ => Hand::Four,
    };
    figure.spine = dice.count(2, 3);
    let chest = figure.torso();
    let head = figure.head(chest, dice);
    let pairs = 1 + dice.below(if triangles < 3_000 { 2 } else { 3 });
    for pair in 0..pairs {
        figure.suffix = if pair > 0 { format!("_{}", pair + 1) } else { String::new() };
        figure.lower = 0.085 * pair as f32;
        if pair > 0 {
            figure.stance.arms_down += dice.between(12.0, 25.0);
            figure.hand = if triangles < 8_000 || dice.chance(0.5) { Hand::Mitten } else { figure.hand };
        }
        for side in Side::BOTH {
            figure.arm(chest, side);
        }
    }
    (figure.suffix, figure.lower) = (String::new(), 0.0);
    if dice.chance(0.75) {
        Side::BOTH.into_iter().for_each(|side| {
            figure.leg(side);
        });
    } else {
        tentacles(&mut figure, triangles, dice);
    }
    for k in 0..dice.below(3) {
        tail(&mut figure, k, dice);
    }
    horns_and_eyes(&mut figure, head, dice);
    if triangles > 2_500 && dice.chance(0.3) {
        wings(&mut figure, chest, dice);
    }
    if dice.chance(0.4) {
        spikes(&mut figure, chest, dice);
    }
    figure.body.scaled(shape.height)
}

/// A figure with some of its proportions out of the usual.
fn deformed(shape: Shape, dice: &mut Dice) -> Shape {
    let long = dice.between(0.8, 1.5);
    let thick = dice.between(0.8, 1.5);
    let wide = dice.between(0.9, 1.4);
    Shape {
        height: shape.height * dice.between(0.6, 2.5),
        head_width: shape.head_width * dice.between(0.8, 1.35),
        upper_arm: shape.upper_arm * long,
        forearm: shape.forearm * long * dice.between(0.9, 1.25),
        hand: shape.hand * dice.between(0.9, 1.6),
        arm_radius: shape.arm_radius * thick,
        elbow: shape.elbow * thick,
        wrist: shape.wrist * thick * dice.between(1.0, 1.4),
        shoulders: shape.shoulders * wide,
        chest_depth: shape.chest_depth * wide,
        belly: shape.belly + dice.between(0.0, 0.6),
        foot: shape.foot * dice.between(0.8, 1.4),
        ..shape
    }
}

/// Arms of an octopus instead of legs.
fn tentacles(figure: &mut Figure, triangles: u32, dice: &mut Dice) {
    let s = figure.shape;
    let more = if triangles < 5_000 { 0 } else { 3 };
    let (count, joints) = (dice.count(3, 5 + more), dice.count(3, 3 + more));
    let root = figure.body.at(Body::ROOT);
    for k in 0..count {
        let (sin, cos) = sin_cos(360.0 * (k as f32 + 0.5) / count as f32);
        let out = Vec3::new(sin, 0.0, cos);
        let spread = dice.between(0.5, 1.1);
        let nodes: Vec<Node> = (0..=joints)
            .map(|j| j as f32 / joints as f32)
            .map(|t| {
                let r = 0.55 * s.hips * (1.0 - 0.8 * t);
                let fall = root.y * (1.0 - (1.0 - t) * (1.0 - t));
                Node::round(root + out * (0.55 * s.hips + spread * root.y * t * t) - Vec3::Y * (fall - r * t), r)
            })
            .collect();
        figure.body.chain(Body::ROOT, (1..=joints).map(|j| format!("tentacle_{}_{j}", k + 1)), &nodes, Vec3::Y);
    }
}

fn tail(figure: &mut Figure, number: usize, dice: &mut Dice) {
    let s = figure.shape;
    let aside = if number > 0 { 0.5 } else { 0.0 };
    let root = figure.body.at(Body::ROOT) + Vec3::new(aside * s.hips, 0.02 * number as f32, -0.45 * s.hips);
    let tail = Tail {
        joints: dice.count(3, 7),
        length: dice.between(0.3, 0.8),
        thick: [dice.between(0.25, 0.5) * s.hips, 0.012],
        tall: 1.0,
        rise: dice.between(-60.0, 10.0),
        curl: dice.between(0.0, 16.0),
        sway: if number > 0 { 12.0 } else { 8.0 * dice.bell() },
    };
    let name = if number > 0 { format!("tail{}", number + 1) } else { "tail".into() };
    let chain = tail.grow(&mut figure.body, Body::ROOT, &name, root);
    if dice.chance(0.5) {
        figure.body.swings("tail", &chain, Kind::Tail, dice);
    }
}

fn horns_and_eyes(figure: &mut Figure, head: JointId, dice: &mut Dice) {
    let (middle, size) = figure.skull(head);
    let pairs = dice.below(3);
    for pair in 0..pairs {
        let high = 0.75 - 0.5 * pair as f32;
        let (length, bend) = (dice.between(0.5, 2.0) * size.y, dice.between(-0.6, 0.6));
        for side in Side::BOTH {
            let root = middle + side.of(Vec3::new(0.6 + 0.2 * pair as f32, high, 0.1) * size);
            let out = side.of(Vec3::new(0.8, 0.7 - 0.4 * pair as f32, 0.1)).normalize();
            horn(&mut figure.body, head, root, out, Vec3::Y * bend, length, 0.2 * size.x);
        }
    }
    // More eyes than two, anywhere in front.
    for _ in 0..dice.below(5) {
        let (sin, cos) = sin_cos(dice.between(-50.0, 50.0));
        let high = dice.between(-0.2, 0.6);
        let flat = (1.0 - high * high).sqrt();
        let at = middle + Vec3::new(sin * flat, high, cos * flat) * size * 0.96;
        figure.body.ball(head, at, dice.between(0.10, 0.24) * size.x);
    }
}

fn wings(figure: &mut Figure, chest: JointId, dice: &mut Dice) {
    let s = figure.shape;
    let at = figure.body.at(chest);
    let root = at + Vec3::new(0.35 * s.shoulders, 0.03, -0.9 * s.chest_depth);
    let out = direction(112.0 + dice.between(0.0, 25.0), dice.between(5.0, 55.0));
    let back = (-Vec3::Y - out * out.dot(-Vec3::Y)).normalize();
    let span = dice.between(0.5, 0.95);
    let wing = Wing { root, out, back, span, chord: 0.42 * span, thick: 0.022 };
    let flank = at + Vec3::new(0.3 * s.shoulders, -0.16, -0.9 * s.chest_depth);
    let (fingers, layers) = (dice.count(2, 3), dice.chance(0.5));
    for side in Side::BOTH {
        wing.membrane(&mut figure.body, chest, side, fingers, flank, layers);
    }
}

fn spikes(figure: &mut Figure, chest: JointId, dice: &mut Dice) {
    let s = figure.shape;
    let n = dice.count(3, 6);
    let (low, high) = (figure.hips_y(), figure.neck_y());
    for k in 0..n {
        let t = (k as f32 + 0.5) / n as f32;
        let root = Vec3::new(0.0, low + (high - low) * t, -0.9 * s.chest_depth);
        let joint = if t > 0.6 { chest } else { Body::ROOT };
        let out = Vec3::new(0.0, 0.4, -1.0).normalize();
        spike(&mut figure.body, joint, root, out, dice.between(0.06, 0.14), 0.02, 0.012);
    }
}
