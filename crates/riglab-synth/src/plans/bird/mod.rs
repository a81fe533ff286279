//! Birds: flying, standing with folded wings, wading, upright.

mod shape;

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::Dice;
use crate::kit::head::Face;
use crate::kit::limbs::Toes;
use crate::kit::wings::{Wing, fan};
use crate::part::Ring;
use crate::piece::Loft;
use crate::springs::Kind;
use crate::turn::{direction, turned};

use shape::{ARCHETYPES, Shape};

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.12, dice);
    let spine = dice.count(2, 3);
    let mut bird = Bird { shape, body: Body::new("hips", Vec3::ZERO), spine: vec![], fine: triangles > 3_000 };
    bird.trunk(spine);
    let (head, face) = bird.neck_and_head(dice);
    face.beak(&mut bird.body, head, shape.beak, shape.beak_thick, shape.hook, dice.chance(0.5));
    if dice.chance(0.25) {
        bird.comb(head, &face, dice);
    }
    bird.tail(dice);
    let spread = if dice.chance(0.55) { Some(dice.between(-10.0, 40.0)) } else { None };
    let feathers = if bird.fine && dice.chance(0.35) { dice.count(3, 7) } else { 0 };
    let toes = Toes {
        name: "toe",
        count: dice.count(2, 3),
        length: shape.toe,
        radius: 1.05 * shape.leg_thick,
        fan: dice.between(50.0, 80.0),
        joints: if bird.fine { dice.count(0, 2) } else { 0 },
        back: dice.chance(0.7),
    };
    for side in Side::BOTH {
        bird.wing(side, spread, feathers);
        bird.leg(side, 9.0 * dice.bell(), toes);
    }
    bird.body.scaled(shape.trunk)
}

struct Bird {
    shape: Shape,
    body: Body,
    /// Rump to breast.
    spine: Vec<JointId>,
    fine: bool,
}

impl Bird {
    /// The middle of the trunk at a share of the way from rump to breast.
    fn at(&self, t: f32) -> Vec3 {
        let s = self.shape;
        let along = direction(0.0, s.tilt);
        Vec3::Y * (s.leg + 0.75 * s.height) + along * (t - 0.35)
    }

    fn ring(&self, t: f32) -> Ring {
        let round = 1.0 - (1.7 * t - 0.95) * (1.7 * t - 0.95);
        Ring::oval(self.shape.width, self.shape.height).scaled(0.42 + 0.58 * round.max(0.0))
    }

    fn trunk(&mut self, n: usize) {
        let nodes: Vec<Node> =
            (0..=n).map(|k| k as f32 / n as f32).map(|t| Node::new(self.at(t), self.ring(t))).collect();
        self.body.joints[0].head = nodes[0].at.into();
        self.spine = vec![Body::ROOT];
        for (k, node) in nodes[..n].iter().enumerate().skip(1) {
            let name = if k + 1 == n { "chest".into() } else { format!("spine_{k}") };
            self.spine.push(self.body.joint(self.spine[k - 1], name, node.at));
        }
        self.body.flesh(&self.spine, &nodes, Vec3::X);
    }

    fn chest(&self) -> JointId {
        self.spine[self.spine.len() - 1]
    }

    fn neck_and_head(&mut self, dice: &mut Dice) -> (JointId, Face) {
        let s = self.shape;
        let n = if s.neck > 0.5 { dice.count(3, 5) } else { 1 };
        // A long neck leans forward, rises, and bends over: an S.
        let mut rise = if n > 1 { s.neck_rise - 38.0 } else { s.neck_rise };
        let mut at = self.at(0.86) + Vec3::Y * (0.18 * s.height);
        let wide = |t: f32| Ring::round(s.neck_thick * (1.35 - 0.45 * t));
        let mut nodes = vec![Node::new(at, wide(0.0))];
        for k in 1..=n {
            at += direction(0.0, rise) * (s.neck / n as f32);
            rise += if n > 1 { 84.0 / n as f32 } else { 0.0 };
            nodes.push(Node::new(at, wide(k as f32 / n as f32)));
        }
        let names = (1..=n).map(|k| if n == 1 { "neck".into() } else { format!("neck_{k}") });
        let chain = self.body.chain(self.chest(), names, &nodes, Vec3::X);
        let head = self.body.joint(chain[n - 1], "head", at + Vec3::Y * (0.25 * s.head));
        let look = turned(direction(0.0, dice.between(-18.0, 4.0)), Vec3::Y, 14.0 * dice.bell());
        let side = crate::turn::across(look, Vec3::X);
        let up = look.cross(side);
        let crown = self.body.at(head) + up * (0.40 * s.head) + look * (0.20 * s.head);
        self.body.mass(head, crown, look, Vec3::new(0.88, 0.90, 1.08) * s.head);
        if dice.chance(0.8) {
            let radius = dice.between(0.12, 0.24) * s.head;
            for sign in [1.0, -1.0] {
                let eye = crown + side * (0.74 * sign * s.head) + look * (0.45 * s.head) + up * (0.18 * s.head);
                self.body.ball(head, eye, radius);
            }
        }
        (head, Face { look, side, up, crown, width: s.head, tip: crown + look * s.head })
    }

    /// A cock's comb or a crest of feathers.
    fn comb(&mut self, head: JointId, face: &Face, dice: &mut Dice) {
        let n = dice.count(2, 5);
        for k in 0..n {
            let t = k as f32 / (n - 1) as f32 - 0.5;
            let root = face.crown + face.up * (0.75 * face.width) - face.look * (0.9 * t * face.width);
            let out = (face.up - face.look * (0.8 * t)).normalize();
            let points = [(0.0, 0.2), (0.3, 0.2), (0.7, 0.02)].map(|(h, r)| {
                (root + out * (h * face.width), Ring::oval(0.5 * r * face.width, r * face.width), head.0)
            });
            self.body.loft(Loft::through(&points, face.side));
        }
    }

    fn tail(&mut self, dice: &mut Dice) {
        let s = self.shape;
        let back = direction(180.0, dice.between(-25.0, 30.0) - 0.15 * s.tilt);
        let root = self.at(0.04);
        let first = self.body.joint(Body::ROOT, "tail_1", root + back * (0.10 * s.tail));
        let second =
            if dice.chance(0.5) { self.body.joint(first, "tail_2", root + back * (0.5 * s.tail)) } else { first };
        let stump = 0.45 * s.width.min(0.5 * s.tail + 0.1);
        self.body.bone(
            first,
            root + back * (0.35 * s.tail),
            Ring::round(stump),
            Ring::oval(0.7 * stump, 0.35 * stump),
            Vec3::X,
        );
        let open = dice.between(14.0, 60.0);
        fan(&mut self.body, [first, second], root + back * (0.12 * s.tail), back, s.tail, open, 0.3 * s.height);
        if second != first && dice.chance(0.5) {
            self.body.swings("tail", &[first, second], Kind::Tail, dice);
        }
    }

    /// Spread at an elevation, or folded along the body.
    fn wing(&mut self, side: Side, spread: Option<f32>, feathers: usize) {
        let s = self.shape;
        let ring = self.ring(0.75);
        let root = self.at(0.75) + Vec3::new(0.82 * ring.side, 0.35 * ring.up, 0.0);
        let along = direction(0.0, s.tilt);
        let wing = match spread {
            Some(rise) => {
                let out = direction(98.0, rise);
                let back = -Vec3::Z - out * out.dot(-Vec3::Z);
                Wing { root, out, back: back.normalize(), span: s.span, chord: s.chord, thick: s.wing_thick }
            }
            None => {
                let out = (-along + Vec3::new(0.24, 0.05, 0.0)).normalize();
                let down = turned(-along, Vec3::X, -90.0) + Vec3::X * 0.12;
                let back = (down - out * out.dot(down)).normalize();
                let (span, chord) = ((0.6 * s.span).clamp(0.55, 0.95), (0.8 * s.chord).min(1.5 * s.height));
                Wing { root, out, back, span, chord, thick: s.wing_thick }
            }
        };
        let chest = self.chest();
        wing.feathered(&mut self.body, chest, side, feathers);
    }

    /// A feathered thigh, then bare shin and foot.
    fn leg(&mut self, side: Side, swing: f32, toes: Toes) {
        let s = self.shape;
        let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
        let hip = self.at(0.35) + Vec3::new(0.52 * s.width, -0.30 * s.height, 0.0);
        let r = s.leg_thick;
        let ground = 0.9 * r;
        let reach = hip.y - ground;
        let down = turned(-Vec3::Y, Vec3::X, -swing);
        let knee = hip + down * (0.36 * reach) + Vec3::Z * (0.10 * reach);
        let ankle = hip + down * (0.66 * reach) - Vec3::Z * (0.07 * reach);
        let ball = hip + down * reach + Vec3::Z * (0.02 * reach);
        let ball = Vec3::new(ball.x, ground, ball.z);
        let nodes = [Node::round(side.of(hip), (2.6 * r).max(0.32 * s.width)), Node::round(side.of(knee), 1.7 * r)];
        let thigh = self.body.chain(Body::ROOT, [name("thigh")], &nodes, Vec3::X);
        let shin = self.body.joint(thigh[0], name("shin"), side.of(knee));
        let foot = self.body.joint(shin, name("foot"), side.of(ankle));
        // Bare skin begins inside the feathers.
        let points = [
            (hip + (knee - hip) * 0.5, 1.5 * r, thigh[0]),
            (knee, 1.6 * r, shin),
            (ankle, r, foot),
            (ball, 1.1 * r, foot),
        ];
        let points = points.map(|(at, r, joint)| (side.of(at), Ring::round(r), joint.0));
        self.body.loft(Loft::through(&points, Vec3::X));
        toes.grow(&mut self.body, foot, side, ball, direction(8.0, 0.0));
    }
}
