//! Fish and what swims like them: a spine that swings, a tail fin, and fins in pairs and alone.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::dice::{Dice, proportions};
use crate::part::Ring;
use crate::piece::{Control, Piece, Sheet};
use crate::turn::{direction, pow};

proportions! {
    /// In shares of the length from snout to the root of the tail fin.
    Shape {
        /// That length, in metres.
        length,
        /// Largest half height and half width.
        height,
        width,
        /// Where along the body it is deepest, from the snout.
        deepest,
        /// Half height of the root of the tail fin.
        stalk,
        /// How pointed the snout is: the power of its outline.
        snout,
        /// Tail fin: span of each lobe and sweep, degrees from the body's axis.
        tail_span,
        tail_sweep,
        /// Dorsal fin: height, and where it stands.
        dorsal,
        dorsal_at,
        /// Pectoral fins.
        pectoral,
        pelvic,
        /// Chord of fins in shares of their span.
        chord,
    }
}

const ARCHETYPES: [Shape; 6] = [
    // A carp.
    Shape {
        length: 0.45,
        height: 0.15,
        width: 0.085,
        deepest: 0.38,
        stalk: 0.045,
        snout: 0.55,
        tail_span: 0.20,
        tail_sweep: 48.0,
        dorsal: 0.10,
        dorsal_at: 0.45,
        pectoral: 0.14,
        pelvic: 0.10,
        chord: 0.55,
    },
    // A shark.
    Shape {
        length: 2.60,
        height: 0.105,
        width: 0.095,
        deepest: 0.36,
        stalk: 0.026,
        snout: 0.70,
        tail_span: 0.24,
        tail_sweep: 40.0,
        dorsal: 0.13,
        dorsal_at: 0.42,
        pectoral: 0.22,
        pelvic: 0.08,
        chord: 0.50,
    },
    // A dolphin.
    Shape {
        length: 2.10,
        height: 0.110,
        width: 0.105,
        deepest: 0.40,
        stalk: 0.028,
        snout: 0.80,
        tail_span: 0.15,
        tail_sweep: 62.0,
        dorsal: 0.11,
        dorsal_at: 0.52,
        pectoral: 0.17,
        pelvic: 0.0,
        chord: 0.55,
    },
    // An angelfish.
    Shape {
        length: 0.12,
        height: 0.30,
        width: 0.060,
        deepest: 0.46,
        stalk: 0.060,
        snout: 0.85,
        tail_span: 0.24,
        tail_sweep: 38.0,
        dorsal: 0.26,
        dorsal_at: 0.55,
        pectoral: 0.16,
        pelvic: 0.24,
        chord: 0.45,
    },
    // A trout, almost an eel.
    Shape {
        length: 0.60,
        height: 0.080,
        width: 0.060,
        deepest: 0.35,
        stalk: 0.030,
        snout: 0.60,
        tail_span: 0.11,
        tail_sweep: 50.0,
        dorsal: 0.06,
        dorsal_at: 0.50,
        pectoral: 0.09,
        pelvic: 0.07,
        chord: 0.60,
    },
    // A fat one, as in games.
    Shape {
        length: 0.30,
        height: 0.34,
        width: 0.27,
        deepest: 0.36,
        stalk: 0.075,
        snout: 0.50,
        tail_span: 0.30,
        tail_sweep: 46.0,
        dorsal: 0.20,
        dorsal_at: 0.55,
        pectoral: 0.20,
        pelvic: 0.10,
        chord: 0.60,
    },
];

/// Where the body hangs on its root, behind the gills.
const START: f32 = 0.32;

/// Where the head begins.
const GILLS: f32 = 0.25;

pub(crate) fn body(dice: &mut Dice, _triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.12, dice);
    let flat_tail = shape.pelvic < 0.03;
    // Many rigs of fish are one chain, their fins stiff on it.
    let plain = dice.chance(0.4);
    let fin_joints = if plain { 0 } else { dice.count(1, 2) };
    let builder = Builder {
        spine: if plain { dice.count(2, 4) } else { dice.count(4, 8) },
        swing: 0.05 * dice.bell(),
        flat_tail,
        fin_joints,
        jaw: dice.chance(0.6),
        shape,
        body: Body::new("spine_1", Vec3::ZERO),
    };
    builder.build(dice)
}

struct Builder {
    shape: Shape,
    /// Joints from the middle of the body to the tail fin.
    spine: usize,
    /// How far the rest pose swings: the amplitude of a wave along the body.
    swing: f32,
    /// Whether the tail fin lies flat, as whales' do.
    flat_tail: bool,
    fin_joints: usize,
    jaw: bool,
    body: Body,
}

impl Builder {
    fn build(mut self, dice: &mut Dice) -> Body {
        let spine = self.spine(dice);
        self.tail_fin(*spine.last().expect("a spine"));
        let s = self.shape;
        let n = spine.len();
        let middle = |at: f32| spine[(((at - START) / (1.0 - START) * n as f32).max(0.0) as usize).min(n - 1)];
        let dorsal = middle(s.dorsal_at);
        let back = self.axis(s.dorsal_at) + Vec3::Y * (0.82 * self.half_height(s.dorsal_at));
        self.fin(dorsal, "dorsal", back, direction(180.0, 55.0), s.dorsal);
        if dice.chance(0.5) && !self.flat_tail {
            let belly = self.axis(0.72) - Vec3::Y * (0.75 * self.half_height(0.72));
            self.fin(middle(0.72), "anal", belly, direction(180.0, -50.0), 0.7 * s.dorsal);
        }
        let spread = dice.between(-35.0, 5.0);
        for side in Side::BOTH {
            let name = |fin: &str| format!("{fin}_{}", side.word().to_lowercase());
            let root = self.axis(0.30) + Vec3::new(0.78 * self.half_width(0.30), -0.30 * self.half_height(0.30), 0.0);
            self.fin(spine[0], &name("pectoral"), side.of(root), side.of(direction(125.0, spread)), s.pectoral);
            if s.pelvic > 0.03 {
                let root =
                    self.axis(0.55) + Vec3::new(0.35 * self.half_width(0.55), -0.80 * self.half_height(0.55), 0.0);
                let out = side.of(direction(150.0, -45.0));
                self.fin(middle(0.55), &name("pelvic"), side.of(root), out, s.pelvic);
            }
        }
        self.body.scaled(s.length)
    }

    /// The body's axis at a share of its length: the snout at 0 is in front, at +z.
    fn axis(&self, t: f32) -> Vec3 {
        let (sin, _) = crate::turn::sin_cos(360.0 * 0.8 * t);
        let off = self.swing * t * sin;
        let side = if self.flat_tail { Vec3::new(0.0, off, 0.0) } else { Vec3::new(off, 0.0, 0.0) };
        Vec3::new(0.0, 0.0, 0.5 - t) + side
    }

    /// The outline: a power of the way up to the deepest place, a smooth fall to the stalk.
    fn outline(&self, t: f32, most: f32, stalk: f32) -> f32 {
        let s = self.shape;
        if t <= s.deepest {
            let x = (t / s.deepest).clamp(0.0, 1.0);
            return most * (0.22 + 0.78 * pow(x * (2.0 - x), s.snout));
        }
        let x = ((t - s.deepest) / (1.0 - s.deepest)).clamp(0.0, 1.0);
        stalk + (most - stalk) * (1.0 - x * x * (3.0 - 2.0 * x))
    }

    fn half_height(&self, t: f32) -> f32 {
        self.outline(t, self.shape.height, self.shape.stalk)
    }

    fn half_width(&self, t: f32) -> f32 {
        self.outline(t, self.shape.width, 0.6 * self.shape.stalk)
    }

    fn node(&self, t: f32) -> Node {
        Node::new(self.axis(t), Ring::oval(self.half_width(t), self.half_height(t)))
    }

    /// Head forward, the spine back to the tail; gives the spine's joints.
    fn spine(&mut self, dice: &mut Dice) -> Vec<JointId> {
        let n = self.spine;
        let start = START;
        let nodes: Vec<Node> = (0..=n).map(|k| self.node(start + (1.0 - start) * k as f32 / n as f32)).collect();
        self.body.joints[0].head = nodes[0].at.into();
        let mut chain = vec![Body::ROOT];
        for (k, node) in nodes[..n].iter().enumerate().skip(1) {
            chain.push(self.body.joint(chain[k - 1], format!("spine_{}", k + 1), node.at));
        }
        self.body.flesh(&chain, &nodes, Vec3::X);
        // The head hangs on the root but not at its place: two joints in one are hard to tell apart.
        let head = self.body.joint(Body::ROOT, "head", self.axis(GILLS));
        let nodes = [self.node(start), self.node(GILLS), self.node(0.16), self.node(0.02)];
        self.body.flesh(&[Body::ROOT, head, head], &nodes, Vec3::X);
        let (h, w) = (self.half_height(0.12), self.half_width(0.12));
        if self.jaw {
            let hinge = self.axis(0.15) - Vec3::Y * (0.55 * h);
            let jaw = self.body.joint(head, "jaw", hinge);
            let chin = self.axis(0.015) - Vec3::Y * (0.62 * h);
            let nodes = [Node::round(hinge, 0.42 * w.min(h)), Node::round(chin, 0.26 * w.min(h))];
            self.body.flesh(&[jaw], &nodes, Vec3::X);
        }
        if dice.chance(0.85) {
            let eye = if dice.chance(0.3) { dice.between(0.3, 0.55) } else { dice.between(0.16, 0.26) };
            for side in Side::BOTH {
                let center = self.axis(0.11) + side.of(Vec3::new(0.90 * w, 0.28 * h, 0.0));
                let radius = eye * w.min(h);
                self.body.ball(head, center, radius);
            }
        }
        chain
    }

    fn tail_fin(&mut self, last: JointId) {
        let s = self.shape;
        let root = self.axis(0.99);
        let base = self.body.joint(last, "tail", root);
        let stalk = Ring::oval(0.6 * s.stalk, s.stalk);
        let behind = root - Vec3::Z * (0.25 * s.tail_span);
        self.body.bone(base, behind, stalk, stalk.scaled(0.8), Vec3::X);
        for (name, sign) in [("tail_upper", 1.0), ("tail_lower", -1.0)] {
            let out = match self.flat_tail {
                true => direction(180.0 - sign * s.tail_sweep, 0.0),
                false => direction(180.0, sign * s.tail_sweep),
            };
            let name =
                if self.flat_tail { name.replace("upper", "left").replace("lower", "right") } else { name.into() };
            self.fin(base, &name, root - Vec3::Z * (0.10 * s.tail_span), out, s.tail_span);
        }
    }

    /// A fin: a thin sheet with one or two joints along `out`, longest in front.
    fn fin(&mut self, parent: JointId, name: &str, root: Vec3, out: Vec3, span: f32) {
        let (n, chord) = (self.fin_joints, self.shape.chord * span);
        let mut joints = vec![parent];
        for k in 0..n {
            let name = if n == 1 { name.to_string() } else { format!("{name}_{}", k + 1) };
            let above = *joints.last().expect("the parent");
            joints.push(self.body.joint(above, name, root + out * (span * k as f32 / n as f32)));
        }
        let rib = |across: f32| {
            let length = span * (1.0 - 0.55 * across * across);
            // The first point is sunk in the body and held by it.
            let along = |k: usize| if k == 0 { -0.08 } else { k as f32 / n.max(1) as f32 };
            let lean = |t: f32| chord * (across - 0.35) * (1.0 - 0.45 * t.max(0.0));
            let point = |k: usize| root + out * (length * along(k)) - Vec3::Z * lean(along(k));
            (0..=n.max(1)).map(|k| Control { at: point(k), joint: joints[k.min(n)].0 }).collect::<Vec<_>>()
        };
        let ribs = (0..4).map(|r| rib(r as f32 / 3.0)).collect();
        self.body.pieces.push(Piece::Sheet(Sheet { ribs, thickness: 0.05 * chord, round: false }));
    }
}
