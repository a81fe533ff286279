//! Dragons: beasts with wings of skin, horns and a crest.

use glam::Vec3;

use crate::body::{Body, Side};
use crate::dice::Dice;
use crate::kit::beast::{Beast, Build, Shape};
use crate::kit::limbs::{horn, spike};
use crate::kit::wings::Wing;
use crate::springs::Kind;
use crate::turn::direction;

const ARCHETYPES: [Shape; 4] = [
    // A dragon on four legs.
    Shape {
        trunk: 2.5,
        stand: 0.78,
        pitch: 8.0,
        chest: 0.25,
        chest_height: 0.28,
        waist: 0.2,
        waist_height: 0.22,
        hips: 0.2,
        hips_height: 0.23,
        neck: 0.9,
        neck_rise: 48.0,
        neck_thick: 0.14,
        head: 0.42,
        skull: 0.3,
        snout: 0.66,
        snout_tip: 0.18,
        tail: 1.9,
        tail_thick: 0.15,
        tail_rise: -10.0,
        fore: 0.95,
        fore_thick: 0.12,
        hind_thick: 0.2,
        sprawl: 0.12,
        foot: 0.22,
    },
    // A wyvern: its arms are its wings.
    Shape {
        trunk: 1.6,
        stand: 0.85,
        pitch: 22.0,
        chest: 0.22,
        chest_height: 0.25,
        waist: 0.2,
        waist_height: 0.22,
        hips: 0.18,
        hips_height: 0.22,
        neck: 0.7,
        neck_rise: 52.0,
        neck_thick: 0.12,
        head: 0.4,
        skull: 0.3,
        snout: 0.7,
        snout_tip: 0.17,
        tail: 1.8,
        tail_thick: 0.14,
        tail_rise: -6.0,
        fore: 0.01,
        fore_thick: 0.1,
        hind_thick: 0.21,
        sprawl: 0.0,
        foot: 0.24,
    },
    // A small fat one.
    Shape {
        trunk: 0.6,
        stand: 0.62,
        pitch: 62.0,
        chest: 0.31,
        chest_height: 0.29,
        waist: 0.36,
        waist_height: 0.34,
        hips: 0.34,
        hips_height: 0.32,
        neck: 0.14,
        neck_rise: 80.0,
        neck_thick: 0.2,
        head: 0.72,
        skull: 0.44,
        snout: 0.32,
        snout_tip: 0.28,
        tail: 1.0,
        tail_thick: 0.2,
        tail_rise: -24.0,
        fore: 0.42,
        fore_thick: 0.11,
        hind_thick: 0.24,
        sprawl: 0.0,
        foot: 0.17,
    },
    // A serpent with legs.
    Shape {
        trunk: 3.0,
        stand: 0.34,
        pitch: 2.0,
        chest: 0.13,
        chest_height: 0.14,
        waist: 0.12,
        waist_height: 0.13,
        hips: 0.12,
        hips_height: 0.13,
        neck: 0.55,
        neck_rise: 44.0,
        neck_thick: 0.115,
        head: 0.34,
        skull: 0.32,
        snout: 0.72,
        snout_tip: 0.18,
        tail: 2.6,
        tail_thick: 0.115,
        tail_rise: -5.0,
        fore: 0.34,
        fore_thick: 0.07,
        hind_thick: 0.085,
        sprawl: 0.4,
        foot: 0.13,
    },
];

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.10, dice);
    let build = Build { jaw: true, ..Build::draw(&shape, triangles, dice) };
    let mut beast = Beast::new(shape, build);
    let grown = beast.grow(dice);
    wings(&mut beast, triangles, dice);
    let face = grown.face;
    let (length, pairs) = (dice.between(0.8, 2.2) * face.width, dice.count(0, 2));
    for pair in 0..pairs {
        for sign in [1.0, -1.0] {
            let root = face.crown
                + face.side * (0.55 * sign * face.width)
                + face.up * ((0.55 - 0.3 * pair as f32) * face.width);
            let out = (face.up * (0.5 - 0.3 * pair as f32) - face.look * 0.75 + face.side * (0.35 * sign)).normalize();
            horn(
                &mut beast.body,
                grown.head,
                root,
                out,
                face.up * 0.3,
                length * (1.0 - 0.35 * pair as f32),
                0.22 * face.width,
            );
        }
    }
    if dice.chance(0.6) {
        crest(&mut beast, &grown.tail, dice);
    }
    if dice.chance(0.5) {
        beast.body.swings("tail", &grown.tail, Kind::Tail, dice);
    }
    beast.body.scaled(shape.trunk)
}

fn wings(beast: &mut Beast, triangles: u32, dice: &mut Dice) {
    let s = beast.shape;
    let at = if s.fore < 0.1 { 0.92 } else { 0.74 };
    let joint = beast.joint_at(at);
    let ring = beast.ring(at);
    let root = beast.at(at) + Vec3::new(0.62 * ring.side, 0.62 * ring.up, 0.0);
    let flank = beast.at(at - 0.55) + Vec3::new(0.7 * ring.side, 0.55 * ring.up, 0.0);
    let out = direction(90.0 + dice.between(0.0, 35.0), dice.between(-5.0, 50.0));
    let back = direction(180.0, dice.between(-40.0, -5.0));
    let back = (back - out * out.dot(back)).normalize();
    let span = dice.between(1.3, 2.8);
    let wing = Wing { root, out, back, span, chord: dice.between(0.32, 0.5) * span, thick: dice.between(0.045, 0.075) };
    let fingers = if triangles < 2_000 { dice.count(1, 2) } else { dice.count(2, 4) };
    let layers = dice.chance(0.5);
    for side in Side::BOTH {
        wing.membrane(&mut beast.body, joint, side, fingers, flank, layers);
    }
}

/// Spikes along the back, and a blade at the end of the tail.
fn crest(beast: &mut Beast, tail: &[riglab_core::JointId], dice: &mut Dice) {
    let n = dice.count(4, 8);
    let height = dice.between(0.05, 0.14);
    for k in 0..n {
        let t = (k as f32 + 0.5) / n as f32;
        let root = beast.at(t) + Vec3::Y * (0.9 * beast.ring(t).up);
        let joint = beast.joint_at(t);
        spike(&mut beast.body, joint, root, Vec3::new(0.0, 1.0, -0.5).normalize(), height, 0.32 / n as f32, 0.014);
    }
    if let Some(tip) = tail.last().and_then(|&last| beast.body.tip(last)) {
        let last = tail[tail.len() - 1];
        let along = (tip - beast.body.at(last)).normalize_or(-Vec3::Z);
        spike(&mut beast.body, last, tip - along * 0.05, along, 2.2 * height, 0.9 * height, 0.02);
    }
}
