//! What figures wear and carry: rigid on one joint, or open cloth that follows the limbs below.

use glam::Vec3;
use riglab_core::JointId;

use super::Figure;
use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::part::Ring;
use crate::piece::{Control, Loft, Piece, Sheet};
use crate::springs::Kind;
use crate::turn::{direction, sin_cos};

impl Figure {
    /// Middle of the skull and its half extents.
    pub fn skull(&self, head: JointId) -> (Vec3, Vec3) {
        let (s, h) = (self.shape, self.shape.head);
        let middle = self.body.at(head) + Vec3::new(0.0, 0.44 * h, 0.02 * h);
        (middle, Vec3::new(0.5 * s.head_width * h, 0.44 * h, 0.5 * s.head_depth * h))
    }

    /// Some clothes and things, at random.
    pub fn dress(&mut self, chest: JointId, head: JointId, hands: &[JointId], dice: &mut Dice) {
        match dice.below(6) {
            0 | 1 => self.hair(head, dice),
            2 => self.hat(head, dice),
            3 => self.helmet(head, dice),
            _ => {}
        }
        if dice.chance(0.15) {
            self.backpack(chest, dice);
        }
        if dice.chance(0.2) {
            self.belt(dice);
        }
        if dice.chance(0.15) {
            self.shoulder_pads(dice);
        }
        if dice.chance(0.25) {
            let length = dice.between(0.25, 0.95);
            self.skirt(length, 0, 0, dice);
        }
        if dice.chance(0.15) {
            self.sleeves(dice);
        }
        if dice.chance(0.15) {
            self.cape(chest, dice);
        }
        if dice.chance(0.25) {
            self.weapon(hands[1], Side::Right, dice);
        }
        if dice.chance(0.1) {
            self.shield(hands[0], Side::Left);
        }
    }

    /// A cap of hair, with a bun or a tail that swings at times.
    fn hair(&mut self, head: JointId, dice: &mut Dice) {
        let (middle, size) = self.skull(head);
        let back = Vec3::new(0.0, 0.10 * size.y, -0.16 * size.z);
        let lean = direction(0.0, dice.between(20.0, 40.0));
        self.body.oval(head, middle + back, lean, size * Vec3::new(1.09, 1.0, 1.06));
        match dice.below(4) {
            0 => {
                let knot = middle + Vec3::new(0.0, 0.75 * size.y, -0.95 * size.z);
                self.body.ball(head, knot, dice.between(0.25, 0.42) * size.x);
            }
            1 => {
                let root = middle + Vec3::new(0.0, 0.45 * size.y, -1.02 * size.z);
                let (n, length) = (dice.count(2, 4), dice.between(1.6, 3.2) * size.y);
                let nodes: Vec<Node> = (0..=n)
                    .map(|k| {
                        let t = k as f32 / n as f32;
                        let at = root + Vec3::new(0.0, -length * t * t, -0.5 * length * t * (1.0 - 0.45 * t));
                        Node::round(at, size.x * (0.20 + 0.5 * t * (1.0 - t)) * (1.0 - 0.8 * t * t))
                    })
                    .collect();
                let chain = self.body.strand(head, (1..=n).map(|k| format!("ponytail_{k}")), &nodes, Vec3::X);
                self.body.swings("ponytail", &chain, Kind::Hair, dice);
            }
            _ => {}
        }
    }

    /// A brim and a crown: a cap, a witch's hat or a top hat.
    fn hat(&mut self, head: JointId, dice: &mut Dice) {
        let (middle, size) = self.skull(head);
        let base = middle + Vec3::Y * (0.42 * size.y);
        let (brim, tall) = (dice.between(1.2, 2.0), dice.between(0.8, 2.6));
        let narrow = if tall > 1.4 { dice.between(0.05, 0.9) } else { dice.between(0.6, 0.95) };
        let ring = |by: f32| Ring::oval(by * size.x, by * size.z);
        let top = base + Vec3::new(0.0, tall * size.y, -0.2 * tall * size.z);
        self.body.loft(Loft::tapered(head.0, base, base + Vec3::Y * (0.08 * size.y), Vec3::X, [ring(brim); 2], 0.0));
        self.body.loft(Loft::tapered(head.0, base, top, Vec3::X, [ring(1.02), ring(narrow)], 0.1));
    }

    fn helmet(&mut self, head: JointId, dice: &mut Dice) {
        let (middle, size) = self.skull(head);
        self.body.oval(head, middle + Vec3::new(0.0, 0.16 * size.y, -0.10 * size.z), Vec3::Z, size * 1.12);
        if dice.chance(0.5) {
            for side in Side::BOTH {
                let r = 0.16 * size.x;
                let points = [(0.95, 0.3, 1.0), (1.45, 0.5, 0.8), (1.75, 1.2, 0.15)].map(|(x, y, w)| {
                    (middle + side.of(Vec3::new(x * size.x, y * size.y, 0.0)), Ring::round(w * r), head.0)
                });
                self.body.loft(Loft::through(&points, Vec3::Z));
            }
        }
    }

    fn backpack(&mut self, chest: JointId, dice: &mut Dice) {
        let s = self.shape;
        let middle = self.body.at(chest) + Vec3::new(0.0, 0.0, -s.chest_depth * 1.05);
        let half = Vec3::new(0.62 * s.shoulders, dice.between(0.07, 0.12), 0.5 * s.chest_depth);
        let (low, high) = (middle - Vec3::Y * half.y, middle + Vec3::Y * half.y);
        let back = Vec3::Z * (0.8 * half.z);
        let ring = Ring::oval(half.x, half.z);
        self.body.loft(Loft::cuboid(chest.0, low - back, high - back, Vec3::X, ring, 0.35));
    }

    fn belt(&mut self, dice: &mut Dice) {
        let s = self.shape;
        let at = self.body.at(Body::ROOT) + Vec3::Y * 0.03;
        let wide = 1.10 * s.hips.max(s.waist);
        let ring = Ring::oval(wide, 0.85 * wide.max(s.waist_depth * 1.25));
        let up = Vec3::Y * dice.between(0.010, 0.022);
        self.body.loft(Loft::tapered(Body::ROOT.0, at - up, at + up, Vec3::X, [ring; 2], 0.0).squared(0.15));
    }

    fn shoulder_pads(&mut self, dice: &mut Dice) {
        let size = dice.between(1.5, 2.2) * self.shape.arm_radius;
        for side in Side::BOTH {
            let name = self.names.of(&side.bone("UpperArm"));
            let Some(arm) = self.body.named(&name) else { continue };
            let at = self.body.at(arm) + Vec3::Y * (0.3 * size);
            self.body.oval(arm, at, Vec3::Z, Vec3::new(1.1, 0.8, 1.0) * size);
        }
    }

    /// Cloth around the hips, `length` of the way to the ankles. With `chains` above 0 it hangs on as
    /// many chains of `joints` joints that swing, else it follows the thighs.
    pub fn skirt(&mut self, length: f32, chains: usize, joints: usize, dice: &mut Dice) {
        let s = self.shape;
        let top = self.body.at(Body::ROOT) + Vec3::Y * 0.035;
        let drop = length * (self.hips_y() - s.ankle) + 0.035;
        let waist = 1.06 * s.hips.max(s.waist);
        let hem = waist * dice.between(1.25, 1.7) + 0.25 * drop * dice.between(0.2, 1.0);
        let ribs = if chains > 0 { chains } else { 8 };
        let steps = if chains > 0 { joints } else { 2 };
        let thighs = Side::BOTH.map(|side| self.body.named(&self.names.of(&side.bone("UpperLeg"))));
        let mut swinging = Vec::new();
        let ribs: Vec<Vec<Control>> = (0..ribs)
            .map(|rib| {
                // Clockwise from above, so that the outside is outside.
                let angle = -360.0 * (rib as f32 + 0.5) / ribs as f32;
                let (sin, cos) = sin_cos(angle);
                let at = |t: f32| {
                    let r = waist + (hem - waist) * t * (1.6 - 0.6 * t);
                    top + Vec3::new(r * sin, -drop * t, 0.86 * r * cos)
                };
                let mut above = Body::ROOT;
                let mut chain = Vec::new();
                let first = Control { at: at(0.0), joint: Body::ROOT.0 };
                let rest = (1..=steps).map(|k| {
                    let t = k as f32 / steps as f32;
                    if chains == 0 {
                        // The front and the back middle hang on both thighs, so on the hips.
                        let thigh = thighs[usize::from(sin < 0.0)].unwrap_or(Body::ROOT);
                        return Control { at: at(t), joint: if sin.abs() < 0.5 { Body::ROOT.0 } else { thigh.0 } };
                    }
                    let name = self.names.skirt(rib, k);
                    above = self.body.joint(above, name, at(t - 0.94 / steps as f32));
                    chain.push(above);
                    Control { at: at(t), joint: above.0 }
                });
                let controls = std::iter::once(first).chain(rest.collect::<Vec<_>>()).collect();
                swinging.push(chain);
                controls
            })
            .collect();
        self.body.pieces.push(Piece::Sheet(Sheet { ribs, thickness: 0.0, round: true }));
        for chain in swinging {
            self.body.swings("skirt", &chain, Kind::Cloth, dice);
        }
    }

    /// Wide sleeves, open at the wrist.
    fn sleeves(&mut self, dice: &mut Dice) {
        let wide = dice.between(1.5, 2.8);
        for side in Side::BOTH {
            let bone = |part: &str| self.body.named(&self.names.of(&side.bone(part)));
            let (Some(arm), Some(fore), Some(hand)) = (bone("UpperArm"), bone("LowerArm"), bone("Hand")) else {
                continue;
            };
            let [shoulder, elbow, wrist] = [arm, fore, hand].map(|joint| self.body.at(joint));
            let s = self.shape;
            let points = [
                (shoulder + (elbow - shoulder) * 0.35, Ring::round(1.15 * s.arm_radius), arm.0),
                (elbow, Ring::round(1.35 * s.elbow), fore.0),
                (elbow + (wrist - elbow) * 0.9, Ring::round(wide * 1.2 * s.elbow), fore.0),
            ];
            self.body.loft(Loft::through(&points, Vec3::Y).open());
        }
    }

    /// Cloth on the back, on the chest alone or on chains of its own.
    fn cape(&mut self, chest: JointId, dice: &mut Dice) {
        let s = self.shape;
        let top = Vec3::new(0.0, self.neck_y() - 0.01, -0.008 - 0.75 * s.chest_depth);
        let length = dice.between(0.35, 0.85) * self.neck_y();
        let joints = if dice.chance(0.6) { dice.count(2, 4) } else { 0 };
        let mut chains = Vec::new();
        let ribs = [-1.0f32, 0.0, 1.0].map(|across| {
            let at = |t: f32| {
                top + Vec3::new(
                    across * s.shoulders * (0.7 + 0.7 * t),
                    -length * t,
                    -0.10 * length * t + 0.03 * across * across,
                )
            };
            let mut above = chest;
            let mut chain = Vec::new();
            let steps = joints.max(2);
            let controls = (0..=steps).map(|k| {
                let t = k as f32 / steps as f32;
                if joints > 0 && k > 0 {
                    let name = format!("cape_{}_{k}", ["r", "m", "l"][(across + 1.0) as usize]);
                    above = self.body.joint(above, name, at(t - 0.94 / steps as f32));
                    chain.push(above);
                }
                Control { at: at(t), joint: above.0 }
            });
            let controls: Vec<_> = controls.collect();
            chains.push(chain);
            controls
        });
        self.body.pieces.push(Piece::Sheet(Sheet { ribs: ribs.into(), thickness: 0.0, round: false }));
        for chain in chains {
            self.body.swings("cape", &chain, Kind::Cloth, dice);
        }
    }

    /// A sword, a staff or a hammer across the palm, with a joint of its own at times.
    fn weapon(&mut self, hand: JointId, side: Side, dice: &mut Dice) {
        let (s, wrist) = (self.shape, self.body.at(hand));
        let palm = self.body.tip(hand).unwrap_or(wrist);
        let grip = wrist + (palm - wrist) * 0.75;
        let ahead = crate::turn::across((palm - wrist).normalize_or(Vec3::X), Vec3::Z);
        let joint =
            if dice.chance(0.5) { self.body.joint(hand, format!("weapon_{}", side.letter()), grip) } else { hand };
        let r = 0.10 * s.hand;
        let length = dice.between(0.35, 0.7);
        let hilt = grip - ahead * (1.6 * s.hand);
        match dice.below(3) {
            0 => {
                let guard = grip + ahead * (0.7 * s.hand);
                let blade = Ring::oval(0.35 * s.hand, 0.35 * r);
                let tip = guard + ahead * length;
                self.body.loft(Loft::tapered(joint.0, hilt, guard, Vec3::Y, [Ring::round(r); 2], 0.0));
                self.body
                    .loft(Loft::tapered(joint.0, guard, tip, Vec3::Y, [blade, blade.scaled(0.2)], 0.0).squared(1.0));
                let cross = Vec3::Y * (0.7 * s.hand);
                self.body.loft(Loft::cuboid(joint.0, guard - cross, guard + cross, ahead, Ring::round(1.2 * r), 0.0));
            }
            1 => {
                let (low, high) = (grip - ahead * length, grip + ahead * length);
                self.body.loft(Loft::tapered(joint.0, low, high, Vec3::Y, [Ring::round(r); 2], 0.0));
                self.body.ball(joint, high, dice.between(1.5, 3.5) * r);
            }
            _ => {
                let top = grip + ahead * length;
                self.body.loft(Loft::tapered(joint.0, hilt, top, Vec3::Y, [Ring::round(r); 2], 0.0));
                let half = Vec3::Y * dice.between(0.5, 1.0) * s.hand;
                self.body.loft(Loft::cuboid(joint.0, top - half, top + half, ahead, Ring::round(0.45 * s.hand), 0.2));
            }
        }
    }

    fn shield(&mut self, hand: JointId, side: Side) {
        let wrist = self.body.at(hand);
        let out = side.of(Vec3::new(0.35, 0.0, 1.0)).normalize();
        let at = wrist + out * (1.2 * self.shape.arm_radius);
        let ring = Ring::oval(0.11, 0.14);
        self.body.loft(Loft::tapered(hand.0, at, at + out * 0.02, Vec3::X, [ring, ring.scaled(0.8)], 0.3));
    }
}
