//! Insects: six legs, mostly wings: bees, beetles, ants, butterflies, dragonflies.

mod shape;

use glam::Vec3;

use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::kit::arthropod::{Leg, feeler};
use crate::kit::limbs::horn;
use crate::part::Ring;
use crate::piece::{Control, Piece, Sheet};
use crate::turn::{direction, turned};

use shape::{ARCHETYPES, Shape};

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.14, dice);
    let mut insect = Insect { shape, body: Body::new("thorax", Vec3::ZERO) };
    insect.trunk(dice);
    insect.head(dice);
    let joints = if triangles < 2_000 { 2 } else { dice.count(2, 4) };
    for side in Side::BOTH {
        for (k, name) in ["leg_front", "leg_middle", "leg_back"].into_iter().enumerate() {
            insect.leg(side, name, 1.0 - k as f32, joints, dice);
        }
    }
    if shape.wing > 0.3 {
        insect.wings(dice);
    }
    insect.body.scaled(shape.size)
}

struct Insect {
    shape: Shape,
    body: Body,
}

impl Insect {
    fn middle(&self) -> Vec3 {
        Vec3::Y * self.shape.stand
    }

    /// Thorax and abdomen.
    fn trunk(&mut self, dice: &mut Dice) {
        let s = self.shape;
        let front = self.middle() + Vec3::Z * 0.42;
        let back = self.middle() - Vec3::Z * 0.38;
        // The root in the thorax's back half, where legs and wings meet.
        self.body.joints[0].head = (self.middle() - Vec3::Z * 0.2).into();
        let nodes = [
            Node::new(back, Ring::oval(0.75 * s.width, 0.75 * s.height)),
            Node::new(front, Ring::oval(0.8 * s.width, 0.8 * s.height)).belly(0.0),
        ];
        self.body.flesh(&[Body::ROOT], &[nodes[0].belly(0.25 * s.width), nodes[1]], Vec3::X);
        let n = dice.count(1, 4);
        let droop = dice.between(-20.0, 12.0);
        let mut at = back - Vec3::Z * 0.12;
        let mut along = direction(180.0, 6.0);
        let bulge = |t: f32| {
            let round = (1.0 - (2.0 * t - 0.85) * (2.0 * t - 0.85) / 1.4).max(0.05).sqrt();
            let r = s.abdomen_width * round;
            Ring::oval(r, 0.88 * r)
        };
        let slim = Ring::round(s.waist);
        let mut nodes = vec![Node::new(at, slim)];
        // Two parts a joint, so that a single one is round too.
        let parts = 2 * n;
        for k in 1..=parts {
            at += along * (s.abdomen / parts as f32);
            along = turned(along, Vec3::X, -droop / parts as f32);
            nodes.push(Node::new(at, bulge(k as f32 / parts as f32)));
        }
        let mut above = Body::ROOT;
        let mut held = Vec::new();
        for k in 0..n {
            above = self.body.joint(above, format!("abdomen_{}", k + 1), nodes[2 * k].at);
            held.extend([above; 2]);
        }
        self.body.flesh(&held, &nodes, Vec3::X);
        if dice.chance(0.3) {
            horn(
                &mut self.body,
                above,
                at - along * (0.2 * s.abdomen_width),
                along,
                Vec3::ZERO,
                0.4 * s.abdomen_width + 0.1,
                0.1 * s.abdomen_width,
            );
        }
    }

    fn head(&mut self, dice: &mut Dice) {
        let s = self.shape;
        let neck = self.middle() + Vec3::new(0.0, -0.05 * s.height, 0.44);
        let head = self.body.joint(Body::ROOT, "head", neck);
        let center = neck + Vec3::new(0.0, 0.0, 0.75 * s.head + 0.04);
        self.body.mass(head, center, Vec3::Z, Vec3::new(1.0, 0.92, 0.85) * s.head);
        self.body.bone(head, center, Ring::round(0.45 * s.head), Ring::round(0.5 * s.head), Vec3::X);
        let joints = dice.count(0, 3);
        let jaws = dice.chance(0.5);
        for side in Side::BOTH {
            let eye = center + side.of(Vec3::new(0.72, 0.28, 0.40) * s.head);
            self.body.oval(head, eye, Vec3::Z, Vec3::new(0.8, 1.2, 0.9) * (s.eye * s.head));
            if s.antenna > 0.1 {
                let root = center + Vec3::new(0.3, 0.75, 0.45) * s.head;
                feeler(
                    &mut self.body,
                    head,
                    side,
                    root,
                    [s.antenna, 0.10 * s.head.min(0.4) + 0.3 * s.leg],
                    joints,
                    dice,
                );
            }
            if jaws {
                let root = center + side.of(Vec3::new(0.35, -0.5, 0.6) * s.head);
                horn(
                    &mut self.body,
                    head,
                    root,
                    side.of(direction(15.0, -25.0)),
                    side.of(-0.4 * Vec3::X),
                    0.8 * s.head,
                    0.16 * s.head,
                );
            }
        }
    }

    /// A leg; `place` is 1 for the front pair, -1 for the last.
    fn leg(&mut self, side: Side, name: &str, place: f32, joints: usize, dice: &mut Dice) {
        let s = self.shape;
        let root = self.middle() + Vec3::new(0.55 * s.width, -0.6 * s.height, 0.05 + 0.26 * place);
        let longer = if place < -0.5 { 1.25 } else { 1.0 };
        let leg = Leg {
            root,
            yaw: 90.0 - 38.0 * place + 6.0 * dice.bell(),
            reach: s.reach * longer,
            rise: dice.between(0.15, 0.40) * s.reach,
            radius: s.leg,
            joints,
        };
        leg.grow(&mut self.body, Body::ROOT, side, name);
    }

    /// One or two pairs of wings: sheets held at their root, or bending in the middle.
    fn wings(&mut self, dice: &mut Dice) {
        let s = self.shape;
        let pairs = dice.count(1, 2);
        let (rise, sweep) = (dice.between(-5.0, 55.0), dice.between(-5.0, 45.0));
        let two = dice.chance(0.4);
        for side in Side::BOTH {
            for pair in 0..pairs {
                let small = 1.0 - 0.28 * pair as f32;
                let out = direction(90.0 + sweep + 28.0 * pair as f32, rise);
                let root = self.middle() + Vec3::new(0.45 * s.width, 0.75 * s.height, 0.18 - 0.3 * pair as f32);
                self.wing(side, pair, root, out, small, two);
            }
        }
    }

    fn wing(&mut self, side: Side, pair: usize, root: Vec3, out: Vec3, small: f32, two: bool) {
        let s = self.shape;
        let name = |k: usize| format!("wing_{}_{k}_{}", pair + 1, side.word().to_lowercase());
        let (length, chord) = (small * s.wing, small * s.chord);
        let first = self.body.joint(Body::ROOT, name(1), side.of(root));
        let second = if two { self.body.joint(first, name(2), side.of(root + out * (0.45 * length))) } else { first };
        let back = (-Vec3::Z - out * out.dot(-Vec3::Z)).normalize();
        let ribs = (0..5).map(|rib| {
            let across = rib as f32 / 4.0;
            let joint = |t: f32| if t > 0.4 { second } else { first };
            [0.0, 0.33, 0.7, 1.0]
                .map(|t: f32| {
                    // Narrow at the root, round at the tip.
                    let wide = chord * (0.10 + 0.9 * t * (1.6 - 0.6 * t));
                    let cut = 1.0 - 0.22 * t * (2.0 * across - 0.7) * (2.0 * across - 0.7);
                    let at = root + out * (length * t * cut) + back * (wide * (across - 0.35));
                    Control { at: side.of(at), joint: joint(t).0 }
                })
                .to_vec()
        });
        let ribs = ribs.collect();
        self.body.pieces.push(Piece::Sheet(Sheet { ribs, thickness: 0.0, round: false }));
    }
}
