//! Beasts: a trunk between hips and chest, neck, head, tail, and four limbs that stand, sprawl or
//! grasp. Lizards, dinosaurs and dragons differ in proportions.

use glam::Vec3;
use riglab_core::JointId;

use super::head::{Face, Skull};
use super::limbs::{Tail, Toes};
use crate::body::{Body, Node, Side};
use crate::dice::{Dice, proportions};
use crate::part::Ring;
use crate::turn::{direction, turned};

proportions! {
    /// A beast: lengths and radii in shares of the trunk's length unless said otherwise.
    Shape {
        /// Trunk from hips to shoulders, in metres.
        trunk,
        /// Height of the hips above the ground.
        stand,
        /// Degrees of the trunk above the horizontal.
        pitch,
        /// Half widths and half heights of the trunk at chest, waist and hips.
        chest,
        chest_height,
        waist,
        waist_height,
        hips,
        hips_height,
        neck,
        /// Degrees of the neck above the horizontal.
        neck_rise,
        neck_thick,
        head,
        /// Half width of the skull, length and half width of the snout, in shares of the head.
        skull,
        snout,
        snout_tip,
        tail,
        tail_thick,
        /// Degrees of the tail above the horizontal.
        tail_rise,
        /// Length of the fore limbs; those too short to reach the ground are
        /// arms, and below 0.1 there are none.
        fore,
        fore_thick,
        hind_thick,
        /// 0 for legs below the body, 1 for legs beside it.
        sprawl,
        /// Length of the toes.
        foot,
    }
}

/// How many joints things have, and how the rest pose stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Build {
    pub spine: usize,
    pub neck: usize,
    pub tail: usize,
    pub toes: usize,
    pub toe_joints: usize,
    pub jaw: bool,
    /// Degrees by which neck and tail bend to one side, joint by joint.
    pub sway: f32,
    pub curl: f32,
}

impl Build {
    pub fn draw(shape: &Shape, triangles: u32, dice: &mut Dice) -> Self {
        let fine = triangles > 3_500;
        Self {
            spine: dice.count(2, 4),
            neck: if shape.neck > 0.6 { dice.count(3, 6) } else { dice.count(1, 2) },
            tail: if shape.tail < 0.4 { dice.count(1, 3) } else { dice.count(3, 8) },
            toes: dice.count(3, 5),
            toe_joints: if fine && dice.chance(0.5) { dice.count(1, 2) } else { 0 },
            jaw: dice.chance(0.75),
            sway: if dice.chance(0.4) { 9.0 * dice.bell() } else { 0.0 },
            curl: dice.between(-5.0, 7.0),
        }
    }
}

/// A beast in the making, its trunk of length 1.
pub(crate) struct Beast {
    pub shape: Shape,
    pub build: Build,
    pub body: Body,
    /// Hips to chest.
    pub spine: Vec<JointId>,
}

/// Joints that a plan may hang more on.
pub(crate) struct Grown {
    pub head: JointId,
    pub face: Face,
    pub tail: Vec<JointId>,
}

impl Beast {
    pub fn new(shape: Shape, build: Build) -> Self {
        Self { shape, build, body: Body::new("hips", Vec3::ZERO), spine: vec![] }
    }

    /// Trunk, neck, head, tail and legs.
    pub fn grow(&mut self, dice: &mut Dice) -> Grown {
        self.trunk();
        let (hips, chest) = (Body::ROOT, *self.spine.last().expect("a spine"));
        let (head, face) = self.neck_and_head(chest, dice);
        let s = self.shape;
        let back = direction(0.0, s.pitch);
        let root = self.at(0.0) - back * (0.35 * s.hips_height) + Vec3::Y * (0.15 * s.hips_height);
        let tail = Tail {
            joints: self.build.tail,
            length: s.tail,
            thick: [s.tail_thick, 0.12 * s.tail_thick],
            tall: 1.1,
            rise: s.tail_rise,
            curl: self.build.curl,
            sway: self.build.sway,
        };
        let tail = tail.grow(&mut self.body, hips, "tail", root);
        for side in Side::BOTH {
            self.hind_leg(hips, side, 8.0 * dice.bell());
            if s.fore > 0.1 {
                self.fore_leg(chest, side, 8.0 * dice.bell());
            }
        }
        Grown { head, face, tail }
    }

    /// The middle of the trunk at a share of the way from hips to shoulders.
    pub fn at(&self, t: f32) -> Vec3 {
        let s = self.shape;
        let along = direction(0.0, s.pitch);
        Vec3::Y * s.stand + along * t - Vec3::Z * (0.5 * along.z) + Vec3::Y * (0.06 * t * (1.0 - t))
    }

    /// The cross-section there: a parabola through hips, waist and chest.
    pub fn ring(&self, t: f32) -> Ring {
        let s = self.shape;
        let through = |a: f32, b: f32, c: f32| {
            let (t1, t2) = (2.0 * t - 1.0, t * (1.0 - t) * 4.0);
            b * t2 + a * 0.5 * t1 * (t1 - 1.0) + c * 0.5 * t1 * (t1 + 1.0)
        };
        Ring::oval(through(s.hips, s.waist, s.chest), through(s.hips_height, s.waist_height, s.chest_height))
    }

    /// The joint of the trunk there.
    pub fn joint_at(&self, t: f32) -> JointId {
        self.spine[((t * self.spine.len() as f32) as usize).min(self.spine.len() - 1)]
    }

    fn trunk(&mut self) {
        let n = self.build.spine;
        let node = |t: f32| Node::new(self.at(t), self.ring(t).scaled(if t > 0.95 { 0.9 } else { 1.0 }));
        let nodes: Vec<Node> = (0..=n).map(|k| node(k as f32 / n as f32)).collect();
        self.body.joints[0].head = nodes[0].at.into();
        self.spine = vec![Body::ROOT];
        for (k, node) in nodes[..n].iter().enumerate().skip(1) {
            self.spine.push(self.body.joint(self.spine[k - 1], format!("spine_{k}"), node.at));
        }
        self.body.flesh(&self.spine, &nodes, Vec3::X);
    }

    fn neck_and_head(&mut self, chest: JointId, dice: &mut Dice) -> (JointId, Face) {
        let (s, n) = (self.shape, self.build.neck);
        let mut along = direction(0.0, s.neck_rise);
        let mut at = self.at(0.97) + Vec3::Y * (0.25 * s.chest_height) - along * (0.1 * s.neck);
        let wide = |t: f32| {
            let r = s.neck_thick * (1.25 - 0.5 * t);
            Ring::oval(r, 1.15 * r)
        };
        let mut nodes = vec![Node::new(at, wide(0.0))];
        // A long neck rises and then bends over.
        let bend = if s.neck > 0.6 { 40.0 } else { 14.0 } / n as f32;
        for k in 1..=n {
            at += along * (s.neck / n as f32);
            along = turned(turned(along, Vec3::X, bend), Vec3::Y, 0.6 * self.build.sway);
            nodes.push(Node::new(at, wide(k as f32 / n as f32)));
        }
        let names = (1..=n).map(|k| if n == 1 { "neck".into() } else { format!("neck_{k}") });
        let chain = self.body.chain(chest, names, &nodes, Vec3::X);
        let head = self.body.joint(*chain.last().expect("a neck"), "head", at);
        let look = turned(direction(0.0, dice.between(-26.0, 4.0)), Vec3::Y, 10.0 * dice.bell());
        let eye = if dice.chance(0.75) { dice.between(0.035, 0.075) } else { 0.0 };
        let Build { jaw, .. } = self.build;
        let skull = Skull { length: s.head, width: s.skull, snout: s.snout, tip: s.snout_tip, eye, jaw };
        (head, skull.grow(&mut self.body, head, look))
    }

    /// Thigh, shin, foot and toes.
    fn hind_leg(&mut self, hips: JointId, side: Side, swing: f32) {
        let s = self.shape;
        let hip = self.at(0.03) + Vec3::new(0.72 * s.hips, -0.10 * s.hips_height, 0.0);
        let sole = 0.9 * s.hind_thick * 0.35;
        let points = self.leg_points(hip, sole, [0.16, 0.14], swing);
        let thick = s.hind_thick;
        let rings = [Ring::oval(0.8 * thick, 1.15 * thick), Ring::round(0.62 * thick), Ring::round(0.36 * thick)];
        self.leg(hips, side, ["thigh", "shin", "foot"], points, rings, 0.36 * thick);
    }

    /// Shoulder blade, upper arm, forearm, hand and fingers.
    fn fore_leg(&mut self, chest: JointId, side: Side, swing: f32) {
        let s = self.shape;
        let shoulder = self.at(0.93) + Vec3::new(0.80 * s.chest, -0.38 * s.chest_height, 0.0);
        let thick = s.fore_thick;
        let sole = 0.9 * thick * 0.35;
        let points = match s.fore > 0.75 * (shoulder.y - sole) || s.sprawl > 0.5 {
            true => self.leg_points(shoulder, sole, [-0.12, 0.02], swing),
            false => {
                // An arm: down and back to the elbow, forward to the hand; outwards before an upright chest.
                let apart = 10.0 + 0.8 * s.pitch.max(0.0);
                let shoulder = shoulder + Vec3::new(0.25 * s.chest, 0.38 * s.chest_height, 0.0) * (apart / 60.0);
                let down = turned(turned(-Vec3::Y, Vec3::X, 25.0 - swing), Vec3::Z, apart);
                let elbow = shoulder + down * (0.45 * s.fore);
                let ahead = turned(turned(Vec3::Z, Vec3::X, 35.0 + swing), Vec3::Y, 0.7 * apart);
                let wrist = elbow + ahead * (0.38 * s.fore);
                [shoulder, elbow, wrist, wrist + direction(-8.0, -45.0) * (0.17 * s.fore)]
            }
        };
        let blade = Vec3::new(0.45 * s.chest, shoulder.y + 0.55 * s.chest_height, shoulder.z);
        let name = format!("scapula_{}", side.word().to_lowercase());
        let scapula = self.body.joint(chest, name, side.of(blade));
        let ring = Ring::oval(0.6 * thick, 0.9 * thick);
        self.body.bone(scapula, side.of(shoulder), ring, Ring::round(0.9 * thick), Vec3::X);
        let rings = [Ring::round(0.9 * thick), Ring::round(0.60 * thick), Ring::round(0.36 * thick)];
        self.leg(scapula, side, ["upper_arm", "forearm", "hand"], points, rings, 0.34 * thick);
    }

    /// Hip, knee, ankle and ball of a leg; `bend` is how far knee and ankle are before and behind.
    fn leg_points(&self, hip: Vec3, sole: f32, bend: [f32; 2], swing: f32) -> [Vec3; 4] {
        let s = self.shape;
        let reach = hip.y - sole;
        let down = turned(-Vec3::Y, Vec3::X, -swing);
        let ground = |p: Vec3| Vec3::new(p.x, sole, p.z);
        let knee = hip + down * (0.45 * reach) + Vec3::Z * (bend[0] * reach);
        let ankle = hip + down * (0.84 * reach) - Vec3::Z * (bend[1] * reach);
        let ball = ground(hip + down * reach + Vec3::Z * (0.4 * bend[0] * reach));
        let upright = [hip, knee, ankle, ball];
        let wide = direction(90.0 - swing, 5.0);
        let knee = hip + wide * (0.50 * s.fore);
        let ankle = ground(knee + Vec3::new(0.14 * s.fore, 0.0, 0.05)) + Vec3::Y * (0.8 * sole);
        let sprawling = [hip, knee, ankle, ground(ankle + Vec3::new(0.05, 0.0, 0.12) * s.fore)];
        std::array::from_fn(|k| upright[k] + (sprawling[k] - upright[k]) * s.sprawl.clamp(0.0, 1.0))
    }

    fn leg(&mut self, parent: JointId, side: Side, names: [&str; 3], points: [Vec3; 4], rings: [Ring; 3], toe: f32) {
        let s = self.shape;
        let [r0, r1, r2] = rings;
        let nodes = [
            Node::new(side.of(points[0]), r0),
            Node::new(side.of(points[1]), r1).belly(0.12 * r1.mean()),
            Node::new(side.of(points[2]), r2),
            Node::new(side.of(points[3]), Ring::oval(1.15 * r2.side, 0.9 * r2.up)),
        ];
        let hand = names[2] == "hand";
        let names = names.map(|part| format!("{part}_{}", side.word().to_lowercase()));
        let chain = self.body.chain(parent, names, &nodes, Vec3::X);
        let ahead = direction(12.0 + 20.0 * s.sprawl, 0.0);
        let hangs = points[3].y > 0.3 * s.stand;
        let ahead = if hangs { direction(0.0, -55.0) } else { ahead };
        let toes = Toes {
            name: if hand { "finger" } else { "toe" },
            count: self.build.toes,
            length: s.foot,
            radius: 0.62 * toe,
            fan: if hangs { 50.0 } else { 75.0 },
            joints: self.build.toe_joints,
            back: false,
        };
        toes.grow(&mut self.body, chain[2], side, points[3], ahead);
    }
}
