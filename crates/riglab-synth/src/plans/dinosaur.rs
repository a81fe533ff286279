//! Dinosaurs: on two legs or four, with horns, plates or crests.

use glam::Vec3;

use crate::body::Body;
use crate::dice::Dice;
use crate::kit::beast::{Beast, Build, Grown, Shape};
use crate::kit::limbs::{horn, spike};
use crate::springs::Kind;

const ARCHETYPES: [Shape; 6] = [
    // A tyrannosaur.
    Shape {
        trunk: 2.2,
        stand: 1.25,
        pitch: 8.0,
        chest: 0.29,
        chest_height: 0.36,
        waist: 0.3,
        waist_height: 0.36,
        hips: 0.26,
        hips_height: 0.34,
        neck: 0.36,
        neck_rise: 50.0,
        neck_thick: 0.23,
        head: 0.58,
        skull: 0.36,
        snout: 0.62,
        snout_tip: 0.25,
        tail: 1.7,
        tail_thick: 0.24,
        tail_rise: 6.0,
        fore: 0.34,
        fore_thick: 0.07,
        hind_thick: 0.3,
        sprawl: 0.0,
        foot: 0.27,
    },
    // A raptor.
    Shape {
        trunk: 0.7,
        stand: 1.15,
        pitch: 12.0,
        chest: 0.18,
        chest_height: 0.23,
        waist: 0.18,
        waist_height: 0.21,
        hips: 0.16,
        hips_height: 0.2,
        neck: 0.55,
        neck_rise: 54.0,
        neck_thick: 0.105,
        head: 0.42,
        skull: 0.26,
        snout: 0.75,
        snout_tip: 0.14,
        tail: 1.9,
        tail_thick: 0.13,
        tail_rise: 7.0,
        fore: 0.62,
        fore_thick: 0.07,
        hind_thick: 0.2,
        sprawl: 0.0,
        foot: 0.28,
    },
    // A long-necked giant.
    Shape {
        trunk: 4.0,
        stand: 0.98,
        pitch: 1.0,
        chest: 0.28,
        chest_height: 0.36,
        waist: 0.34,
        waist_height: 0.4,
        hips: 0.3,
        hips_height: 0.36,
        neck: 1.65,
        neck_rise: 46.0,
        neck_thick: 0.14,
        head: 0.22,
        skull: 0.42,
        snout: 0.62,
        snout_tip: 0.26,
        tail: 2.0,
        tail_thick: 0.2,
        tail_rise: -12.0,
        fore: 1.0,
        fore_thick: 0.17,
        hind_thick: 0.2,
        sprawl: 0.0,
        foot: 0.11,
    },
    // A horned one.
    Shape {
        trunk: 2.0,
        stand: 0.8,
        pitch: -3.0,
        chest: 0.31,
        chest_height: 0.37,
        waist: 0.36,
        waist_height: 0.4,
        hips: 0.28,
        hips_height: 0.34,
        neck: 0.22,
        neck_rise: 12.0,
        neck_thick: 0.26,
        head: 0.52,
        skull: 0.42,
        snout: 0.52,
        snout_tip: 0.18,
        tail: 0.9,
        tail_thick: 0.19,
        tail_rise: -18.0,
        fore: 0.9,
        fore_thick: 0.17,
        hind_thick: 0.22,
        sprawl: 0.1,
        foot: 0.11,
    },
    // A plated one.
    Shape {
        trunk: 2.0,
        stand: 0.95,
        pitch: -14.0,
        chest: 0.22,
        chest_height: 0.28,
        waist: 0.3,
        waist_height: 0.4,
        hips: 0.26,
        hips_height: 0.36,
        neck: 0.3,
        neck_rise: -4.0,
        neck_thick: 0.15,
        head: 0.28,
        skull: 0.36,
        snout: 0.6,
        snout_tip: 0.22,
        tail: 1.15,
        tail_thick: 0.19,
        tail_rise: -6.0,
        fore: 0.75,
        fore_thick: 0.14,
        hind_thick: 0.21,
        sprawl: 0.1,
        foot: 0.11,
    },
    // A duck-billed one.
    Shape {
        trunk: 2.2,
        stand: 1.0,
        pitch: 12.0,
        chest: 0.22,
        chest_height: 0.28,
        waist: 0.25,
        waist_height: 0.33,
        hips: 0.23,
        hips_height: 0.31,
        neck: 0.55,
        neck_rise: 42.0,
        neck_thick: 0.13,
        head: 0.36,
        skull: 0.32,
        snout: 0.8,
        snout_tip: 0.24,
        tail: 1.6,
        tail_thick: 0.2,
        tail_rise: -2.0,
        fore: 0.66,
        fore_thick: 0.09,
        hind_thick: 0.24,
        sprawl: 0.0,
        foot: 0.17,
    },
];

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.10, dice);
    let build = Build::draw(&shape, triangles, dice);
    let mut beast = Beast::new(shape, build);
    let grown = beast.grow(dice);
    match dice.below(6) {
        0 | 1 => plates(&mut beast, &grown, dice),
        2 => horns(&mut beast, &grown, dice),
        3 => {
            let face = grown.face;
            let (out, bend) = (face.up * 0.7 - face.look * 0.7, -face.look * 0.3);
            let length = dice.between(1.2, 3.0) * face.width;
            horn(
                &mut beast.body,
                grown.head,
                face.crown + face.up * (0.5 * face.width),
                out,
                bend,
                length,
                0.35 * face.width,
            );
        }
        _ => {}
    }
    if dice.chance(0.4) {
        beast.body.swings("tail", &grown.tail, Kind::Tail, dice);
    }
    beast.body.scaled(shape.trunk)
}

/// One or two rows of plates along the back, and spikes on the tail.
fn plates(beast: &mut Beast, grown: &Grown, dice: &mut Dice) {
    let rows: &[f32] = if dice.chance(0.5) { &[-1.0, 1.0] } else { &[0.0] };
    let (n, height) = (dice.count(4, 9), dice.between(0.10, 0.34));
    for &row in rows {
        for k in 0..n {
            let t = (k as f32 + 0.5 + 0.25 * row) / n as f32;
            let ring = beast.ring(t);
            let root = beast.at(t) + Vec3::new(0.22 * row * ring.side, 0.88 * ring.up, 0.0);
            let out = Vec3::new(0.3 * row, 1.0, -0.1).normalize();
            let tall = height * (0.45 + 2.2 * t * (1.0 - t));
            let joint = beast.joint_at(t);
            spike(&mut beast.body, joint, root, out, tall, 0.42 / n as f32, 0.02);
        }
    }
    if let Some(&last) = grown.tail.last() {
        let at = beast.body.at(last);
        for row in [-1.0, 1.0] {
            let out = Vec3::new(0.7 * row, 0.6, -0.4).normalize();
            horn(&mut beast.body, last, at, out, Vec3::ZERO, 0.7 * height, 0.03);
        }
    }
}

/// Horns on brow and nose, and a frill behind them at times.
fn horns(beast: &mut Beast, grown: &Grown, dice: &mut Dice) {
    let (face, head) = (grown.face, grown.head);
    let length = dice.between(0.8, 2.4) * face.width;
    for sign in [1.0, -1.0] {
        let root = face.crown + face.side * (0.5 * sign * face.width) + face.up * (0.6 * face.width);
        let out = (face.look * 0.6 + face.up * 0.7 + face.side * (0.2 * sign)).normalize();
        horn(&mut beast.body, head, root, out, face.look * 0.2, length, 0.22 * face.width);
    }
    horn(
        &mut beast.body,
        head,
        face.tip + face.up * (0.2 * face.width),
        face.up,
        face.look * 0.1,
        0.4 * length,
        0.16 * face.width,
    );
    if dice.chance(0.7) {
        let center = face.crown + face.up * (0.5 * face.width) - face.look * (0.7 * face.width);
        let wide = dice.between(1.4, 1.9) * face.width;
        let lean = (face.look + face.up * 0.5).normalize();
        beast.body.oval(head, center, lean, Vec3::new(wide, wide, 0.16 * face.width));
    }
}
