//! Quadrupeds: from mouse to horse, with a neck, four legs and mostly a tail.

mod shape;

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::kit::limbs::horn;
use crate::part::Ring;
use crate::springs::Kind;
use crate::turn::{direction, turned};

use shape::{ARCHETYPES, Shape};

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.10, dice);
    let stance = Stance {
        bend: dice.between(0.6, 1.3),
        swing: [(); 4].map(|()| 7.0 * dice.bell()),
        turn: 10.0 * dice.bell(),
        curl: dice.between(-9.0, 12.0),
    };
    let spine = dice.count(2, 4);
    let neck = if shape.neck > 0.35 { dice.count(2, 3) } else { dice.count(1, 2) };
    let tail = if shape.tail < 0.2 { 1 } else { dice.count(2, 6) };
    let ears = dice.chance(0.8) && triangles > 1_000;
    Builder { shape, stance, spine, neck, tail, ears, body: Body::new("hips", Vec3::ZERO) }.build(dice)
}

/// How the rest pose differs from standing straight.
struct Stance {
    /// How far knees and elbows bend, as a share of the usual.
    bend: f32,
    /// Degrees that each leg is swung forward: left and right fore leg, left and right hind leg.
    swing: [f32; 4],
    /// Degrees that the head looks to the left.
    turn: f32,
    /// Degrees that each part of the tail rises over the one before.
    curl: f32,
}

struct Builder {
    shape: Shape,
    stance: Stance,
    /// Joints of spine, neck and tail.
    spine: usize,
    neck: usize,
    tail: usize,
    /// Whether ears have joints of their own.
    ears: bool,
    body: Body,
}

impl Builder {
    fn build(mut self, dice: &mut Dice) -> Body {
        let spine = self.trunk();
        let (hips, chest) = (spine[0], spine[self.spine - 1]);
        let skull = self.neck(chest);
        self.head(skull, dice);
        let tail = self.tail(hips);
        if dice.chance(0.5) {
            self.body.swings("tail", &tail, Kind::Tail, dice);
        }
        for (k, side) in Side::BOTH.into_iter().enumerate() {
            self.fore_leg(chest, side, self.stance.swing[k]);
            self.hind_leg(hips, side, self.stance.swing[2 + k]);
        }
        self.body.scaled(self.shape.trunk)
    }

    /// The middle of the trunk at a share of the way from hips to shoulders.
    fn spine_at(&self, t: f32) -> Vec3 {
        let s = self.shape;
        let half = s.hips_height + t * (s.chest_height - s.hips_height);
        Vec3::new(0.0, s.stand - half + 4.0 * s.arch * t * (1.0 - t), t - 0.5)
    }

    fn ring_at(&self, t: f32) -> Ring {
        let s = self.shape;
        // A parabola through hips, waist and chest.
        let through = |a: f32, b: f32, c: f32| {
            let (t1, t2) = (2.0 * t - 1.0, t * (1.0 - t) * 4.0);
            b * t2 + a * 0.5 * t1 * (t1 - 1.0) + c * 0.5 * t1 * (t1 + 1.0)
        };
        Ring::oval(
            through(s.hips, s.waist, s.chest).max(0.05),
            through(s.hips_height, s.waist_height, s.chest_height).max(0.05),
        )
    }

    /// Spine joints from hips to chest.
    fn trunk(&mut self) -> Vec<JointId> {
        let n = self.spine;
        let node = |t: f32| Node::new(self.spine_at(t), self.ring_at(t).scaled(if t > 0.95 { 0.92 } else { 1.0 }));
        let nodes: Vec<Node> = (0..=n).map(|k| node(k as f32 / n as f32)).collect();
        self.body.joints[0].head = nodes[0].at.into();
        let mut chain = vec![Body::ROOT];
        for (k, node) in nodes[..n].iter().enumerate().skip(1) {
            chain.push(self.body.joint(chain[k - 1], format!("spine_{k}"), node.at));
        }
        self.body.flesh(&chain, &nodes, Vec3::X);
        chain
    }

    /// Neck joints; gives the last and leaves the skull to the head.
    fn neck(&mut self, chest: JointId) -> JointId {
        let (s, n) = (self.shape, self.neck);
        let from = self.spine_at(0.93) + Vec3::Y * (0.30 * s.chest_height);
        let mut along = direction(0.0, s.neck_rise);
        let step = s.neck / n as f32;
        let mut at = from;
        let wide = |k: usize| s.neck_thick * (1.25 - 0.45 * k as f32 / n as f32);
        let mut nodes = vec![Node::new(at, Ring::oval(wide(0), 1.25 * wide(0)))];
        for k in 1..=n {
            at += along * step;
            // Necks bend forward towards the head.
            along = turned(along, Vec3::X, 6.0);
            nodes.push(Node::new(at, Ring::oval(wide(k), 1.1 * wide(k))));
        }
        let names = (1..=n).map(|k| if n == 1 { "neck".into() } else { format!("neck_{k}") });
        let chain = self.body.chain(chest, names, &nodes, Vec3::X);
        let last = *chain.last().expect("at least one joint");
        self.body.joint(last, "head", at)
    }

    fn head(&mut self, head: JointId, dice: &mut Dice) {
        let s = self.shape;
        let h = s.head;
        let at = self.body.at(head);
        let look = turned(direction(0.0, dice.between(-32.0, -6.0)), Vec3::Y, self.stance.turn);
        let side = crate::turn::across(look, Vec3::X);
        let up = look.cross(side);
        let up = if up.y < 0.0 { -up } else { up };
        let w = s.skull * h;
        let crown = at + look * (0.22 * h) + up * (0.10 * h);
        self.body.mass(head, crown, look, Vec3::new(w, 0.92 * w, 0.36 * h));
        // Muzzle, with a jaw that moves below it where it is long.
        let root = at + look * (0.34 * h) - up * (0.02 * h);
        let tip = root + look * (s.muzzle * h);
        let r = s.muzzle_thick * h;
        let nodes = [Node::new(root, Ring::oval(0.75 * w, 0.85 * w)), Node::new(tip, Ring::oval(r, 0.8 * r))];
        self.body.flesh(&[head], &nodes, side);
        if s.muzzle > 0.4 {
            let hinge = at + look * (0.22 * h) - up * (0.34 * h);
            let chin = tip - look * (0.10 * h) - up * (0.9 * r);
            let jaw = self.body.joint(head, "jaw", hinge);
            let nodes = [Node::round(hinge, 0.42 * w), Node::new(chin, Ring::oval(0.7 * r, 0.5 * r))];
            self.body.flesh(&[jaw], &nodes, side);
        }
        let ear = s.ear * h;
        let antlers = dice.chance(0.25).then(|| (dice.below(3), dice.between(0.4, 1.4) * h));
        for of in Side::BOTH {
            let out = side * of.sign() * side.x.signum();
            if let Some((kind, length)) = antlers {
                self.horns(head, crown, out, up, look, kind, length);
            }
            let root = crown + out * (0.62 * w) + up * (0.62 * w);
            let lean = (up + out * dice.between(0.2, 0.5) - look * 0.15).normalize();
            let tip = root + lean * ear;
            let flat = Ring::oval(0.30 * ear + 0.10 * w, 0.16 * ear + 0.06 * w);
            let joint = match self.ears {
                true => self.body.joint(head, format!("ear_{}", of.word().to_lowercase()), root),
                false => head,
            };
            let nodes = [Node::new(root, flat), Node::new(tip, flat.scaled(0.45))];
            self.body.flesh(&[joint], &nodes, out);
            if joint != head && s.ear > 0.3 && dice.chance(0.5) {
                self.body.swings("ear", &[joint], Kind::Ear, dice);
            }
            if dice.chance(0.7) {
                let center = crown + out * (0.80 * w) + look * (0.24 * h) + up * (0.12 * w);
                self.body.ball(head, center, 0.19 * w);
            }
        }
    }

    /// A horn of a bull, a goat or a stag, on the head's joint.
    #[allow(clippy::too_many_arguments)]
    fn horns(&mut self, head: JointId, crown: Vec3, out: Vec3, up: Vec3, look: Vec3, kind: usize, length: f32) {
        let w = self.shape.skull * self.shape.head;
        let root = crown + out * (0.4 * w) + up * (0.75 * w);
        let (along, bend) = match kind {
            0 => ((out + up * 0.3).normalize(), up * 0.7),
            1 => ((up - look * 0.5).normalize(), -look * 0.7 - up * 0.4),
            _ => ((up + out * 0.5 - look * 0.2).normalize(), out * 0.1),
        };
        horn(&mut self.body, head, root, along, bend, length, 0.16 * w);
        if kind == 2 {
            for (t, side) in [(0.35, 0.7), (0.6, 0.5)] {
                let fork = root + along * (t * length);
                let branch = (look * 0.7 + up * 0.6 + out * (0.3 * side)).normalize();
                horn(&mut self.body, head, fork, branch, up * 0.3, side * 0.6 * length, 0.10 * w);
            }
        }
    }

    fn tail(&mut self, hips: JointId) -> Vec<JointId> {
        let (s, n) = (self.shape, self.tail);
        let mut at = self.spine_at(0.0) + Vec3::new(0.0, 0.55 * s.hips_height, -0.55 * s.hips);
        let mut rise = s.tail_rise;
        let mut nodes = vec![Node::round(at, 1.3 * s.tail_thick)];
        for k in 1..=n {
            at += direction(180.0, rise.clamp(-85.0, 80.0)) * (s.tail / n as f32);
            rise += self.stance.curl;
            nodes.push(Node::round(at, s.tail_thick * (1.15 - 0.55 * k as f32 / n as f32)));
        }
        self.body.chain(hips, (1..=n).map(|k| format!("tail_{k}")), &nodes, Vec3::X)
    }

    /// Shoulder blade, upper arm, forearm, paw.
    fn fore_leg(&mut self, chest: JointId, side: Side, swing: f32) {
        let s = self.shape;
        let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
        let top = self.spine_at(0.90);
        let x = 0.68 * s.chest;
        let blade = Vec3::new(0.55 * x, top.y + 0.45 * s.chest_height, top.z);
        let point = Vec3::new(x, top.y - 0.30 * s.chest_height, top.z + 0.06);
        let reach = point.y - 0.35 * s.paw;
        // Elbow behind, wrist below: from the shoulder's point down.
        let down = turned(-Vec3::Y, Vec3::X, -swing);
        let back = 0.16 * self.stance.bend * reach;
        let elbow = point + down * (0.38 * reach) - Vec3::Z * back;
        let wrist = point + down * (0.84 * reach) - Vec3::Z * (0.25 * back);
        let toe = point + down * reach;
        let toe = Vec3::new(toe.x, 0.30 * s.paw, toe.z);
        let clavicle = self.body.joint(chest, name("scapula"), side.of(blade));
        self.body.bone(
            clavicle,
            side.of(point),
            Ring::oval(0.55 * s.thigh, 0.9 * s.thigh),
            Ring::round(0.80 * s.thigh),
            Vec3::X,
        );
        let nodes = [
            Node::round(side.of(point), 0.80 * s.thigh),
            Node::round(side.of(elbow), 1.15 * s.shin).belly(0.15 * s.shin),
            Node::round(side.of(wrist), s.ankle),
            Node::round(side.of(toe), 1.05 * s.ankle),
        ];
        let chain = self.body.chain(clavicle, [name("upper_arm"), name("forearm"), name("fore_paw")], &nodes, Vec3::X);
        self.paw(chain[2], side, toe);
    }

    /// Thigh, shin, hock, paw.
    fn hind_leg(&mut self, hips: JointId, side: Side, swing: f32) {
        let s = self.shape;
        let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
        let top = self.spine_at(0.04);
        let hip = Vec3::new(0.66 * s.hips, top.y - 0.05 * s.hips_height, top.z);
        let reach = hip.y - 0.35 * s.paw;
        let down = turned(-Vec3::Y, Vec3::X, -swing);
        let bend = 0.16 * self.stance.bend * reach;
        let knee = hip + down * (0.40 * reach) + Vec3::Z * bend;
        let hock = hip + down * (0.72 * reach) - Vec3::Z * (0.9 * bend);
        let toe = hip + down * reach - Vec3::Z * (0.1 * bend);
        let toe = Vec3::new(toe.x, 0.30 * s.paw, toe.z);
        let nodes = [
            Node::new(side.of(hip), Ring::oval(0.85 * s.thigh, 1.25 * s.thigh)),
            Node::round(side.of(knee), 1.35 * s.shin).belly(0.2 * s.shin),
            Node::round(side.of(hock), 1.05 * s.ankle),
            Node::round(side.of(toe), 1.05 * s.ankle),
        ];
        let chain = self.body.chain(hips, [name("thigh"), name("shin"), name("hind_paw")], &nodes, Vec3::X);
        self.paw(chain[2], side, toe);
    }

    fn paw(&mut self, joint: JointId, side: Side, toe: Vec3) {
        let p = self.shape.paw;
        let center = Vec3::new(toe.x, 0.34 * p, toe.z + 0.35 * p);
        self.body.mass(joint, side.of(center), Vec3::Z, Vec3::new(0.50 * p, 0.34 * p, 0.75 * p));
    }
}
