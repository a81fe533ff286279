//! Lizards, crocodiles and their like: legs beside the body, a long tail.

use glam::Vec3;

use crate::body::Body;
use crate::dice::Dice;
use crate::kit::beast::{Beast, Build, Shape};
use crate::kit::limbs::spike;
use crate::springs::Kind;

const ARCHETYPES: [Shape; 5] = [
    // A lizard.
    Shape {
        trunk: 0.25,
        stand: 0.22,
        pitch: 2.0,
        chest: 0.16,
        chest_height: 0.13,
        waist: 0.18,
        waist_height: 0.14,
        hips: 0.13,
        hips_height: 0.12,
        neck: 0.18,
        neck_rise: 8.0,
        neck_thick: 0.11,
        head: 0.34,
        skull: 0.32,
        snout: 0.48,
        snout_tip: 0.17,
        tail: 1.5,
        tail_thick: 0.1,
        tail_rise: -5.0,
        fore: 0.46,
        fore_thick: 0.075,
        hind_thick: 0.09,
        sprawl: 0.9,
        foot: 0.17,
    },
    // A crocodile.
    Shape {
        trunk: 1.4,
        stand: 0.26,
        pitch: 1.0,
        chest: 0.21,
        chest_height: 0.16,
        waist: 0.24,
        waist_height: 0.18,
        hips: 0.18,
        hips_height: 0.15,
        neck: 0.16,
        neck_rise: 4.0,
        neck_thick: 0.16,
        head: 0.32,
        skull: 0.38,
        snout: 1.05,
        snout_tip: 0.19,
        tail: 1.35,
        tail_thick: 0.17,
        tail_rise: -6.0,
        fore: 0.4,
        fore_thick: 0.095,
        hind_thick: 0.12,
        sprawl: 0.8,
        foot: 0.15,
    },
    // A gecko.
    Shape {
        trunk: 0.12,
        stand: 0.16,
        pitch: 0.0,
        chest: 0.17,
        chest_height: 0.12,
        waist: 0.2,
        waist_height: 0.13,
        hips: 0.14,
        hips_height: 0.11,
        neck: 0.14,
        neck_rise: 5.0,
        neck_thick: 0.12,
        head: 0.38,
        skull: 0.42,
        snout: 0.42,
        snout_tip: 0.24,
        tail: 1.1,
        tail_thick: 0.13,
        tail_rise: -3.0,
        fore: 0.52,
        fore_thick: 0.07,
        hind_thick: 0.08,
        sprawl: 1.0,
        foot: 0.2,
    },
    // A salamander.
    Shape {
        trunk: 0.15,
        stand: 0.17,
        pitch: 0.0,
        chest: 0.14,
        chest_height: 0.13,
        waist: 0.15,
        waist_height: 0.14,
        hips: 0.13,
        hips_height: 0.13,
        neck: 0.1,
        neck_rise: 5.0,
        neck_thick: 0.13,
        head: 0.33,
        skull: 0.42,
        snout: 0.36,
        snout_tip: 0.28,
        tail: 1.3,
        tail_thick: 0.12,
        tail_rise: -4.0,
        fore: 0.38,
        fore_thick: 0.065,
        hind_thick: 0.07,
        sprawl: 0.95,
        foot: 0.13,
    },
    // A chameleon.
    Shape {
        trunk: 0.2,
        stand: 0.42,
        pitch: 4.0,
        chest: 0.12,
        chest_height: 0.2,
        waist: 0.13,
        waist_height: 0.24,
        hips: 0.11,
        hips_height: 0.18,
        neck: 0.12,
        neck_rise: 15.0,
        neck_thick: 0.13,
        head: 0.36,
        skull: 0.34,
        snout: 0.4,
        snout_tip: 0.16,
        tail: 1.2,
        tail_thick: 0.08,
        tail_rise: -10.0,
        fore: 0.5,
        fore_thick: 0.055,
        hind_thick: 0.065,
        sprawl: 0.35,
        foot: 0.1,
    },
];

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.12, dice);
    let build = Build { tail: dice.count(3, 8), ..Build::draw(&shape, triangles, dice) };
    let mut beast = Beast::new(shape, build);
    let grown = beast.grow(dice);
    if dice.chance(0.35) {
        // A crest along the back.
        let n = dice.count(4, 10);
        let height = dice.between(0.04, 0.14);
        for k in 0..n {
            let t = (k as f32 + 0.5) / n as f32;
            let root = beast.at(t) + Vec3::Y * (0.92 * beast.ring(t).up);
            let tall = height * (0.5 + 2.0 * t * (1.0 - t));
            let joint = beast.joint_at(t);
            spike(&mut beast.body, joint, root, Vec3::new(0.0, 1.0, -0.35).normalize(), tall, 0.35 / n as f32, 0.012);
        }
    }
    if dice.chance(0.12) {
        // A tortoise's shell.
        let (middle, ring) = (beast.at(0.5), beast.ring(0.5));
        let radii = Vec3::new(1.7 * ring.side, 1.5 * ring.up, 0.62);
        let joint = beast.joint_at(0.5);
        beast.body.oval(joint, middle + Vec3::Y * (0.15 * ring.up), Vec3::Z, radii);
    }
    if dice.chance(0.5) {
        beast.body.swings("tail", &grown.tail, Kind::Tail, dice);
    }
    beast.body.scaled(shape.trunk)
}
