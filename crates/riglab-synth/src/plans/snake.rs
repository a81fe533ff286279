//! Snakes: one long chain, on the ground in waves or with the front raised.

use glam::Vec3;

use crate::body::{Body, Node};
use crate::dice::Dice;
use crate::kit::head::Skull;
use crate::kit::limbs::horn;
use crate::part::Ring;
use crate::piece::Loft;
use crate::springs::Kind;
use crate::turn::{direction, sin_cos};

/// The joint where both halves meet, as a share of the length from the head.
const ROOT_AT: f32 = 0.38;

/// Points along the creature, from the head on.
const FINE: usize = 96;

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    // In shares of the length.
    let thick = dice.between(0.014, 0.042);
    let length = dice.between(0.4, 5.0);
    let joints = dice.count(8, if triangles < 2_500 { 16 } else { 36 });
    let (waves, swing) = (dice.between(0.8, 2.6), dice.between(5.0, 62.0));
    let phase = dice.between(0.0, 360.0);
    let raised = if dice.chance(0.4) { dice.between(0.15, 0.4) } else { 0.0 };
    let hood = if raised > 0.0 && dice.chance(0.6) { dice.between(0.6, 2.2) } else { 0.0 };
    // Walked from the tail, along the ground, and up where the front is raised.
    let mut path = vec![Vec3::new(0.0, thick, 0.0)];
    for k in (0..FINE).rev() {
        let s = k as f32 / FINE as f32;
        let (yaw, _) = sin_cos(360.0 * waves * s + phase);
        let up = if s < raised {
            78.0 * ((raised - s) / raised * 3.0).min(1.0) * ((s / raised) * 3.0).min(1.0)
        } else {
            0.0
        };
        let calm = if raised > 0.0 { (s / raised).min(1.0) } else { 1.0 };
        let last = path[path.len() - 1];
        path.push(last + direction(swing * yaw * calm, up) / FINE as f32);
    }
    path.reverse();
    let middle = path.iter().sum::<Vec3>() / path.len() as f32;
    path.iter_mut().for_each(|p| *p -= Vec3::new(middle.x, 0.0, middle.z));
    let place = |s: f32| {
        let x = s.clamp(0.0, 1.0) * FINE as f32;
        let k = (x as usize).min(FINE - 1);
        path[k] + (path[k + 1] - path[k]) * (x - k as f32)
    };
    let ring = |s: f32| {
        // A slim neck, an even body, a long taper.
        let neck = 0.62 + 0.38 * (s / 0.25).min(1.0);
        let taper = (1.0 - ((s - 0.55) / 0.45).max(0.0)).max(0.10);
        let wide = hood * (1.0 - ((s - 0.10) / 0.09) * ((s - 0.10) / 0.09)).max(0.0);
        let r = thick * neck * taper;
        Ring::oval(r * (1.0 + wide), r * (0.9 - 0.12 * wide.min(2.0)))
    };
    let front = ((joints as f32 * ROOT_AT) as usize).max(2);
    let back = joints - front;
    let mut body = Body::new("spine_1", place(ROOT_AT));
    // Back to the tail; the root holds the first part.
    let nodes: Vec<Node> = (0..=back)
        .map(|k| ROOT_AT + (1.0 - ROOT_AT) * k as f32 / back as f32)
        .map(|s| Node::new(place(s), ring(s)))
        .collect();
    let mut chain = vec![Body::ROOT];
    for (k, node) in nodes[..back].iter().enumerate().skip(1) {
        chain.push(body.joint(chain[k - 1], format!("spine_{}", k + 1), node.at));
    }
    body.flesh(&chain, &nodes, Vec3::X);
    // Forward to the head, from a little before the root: two joints in one are hard to tell apart.
    let start = ROOT_AT - 0.5 * ROOT_AT / front as f32;
    let head_at = 0.03;
    let nodes: Vec<Node> = (0..=front)
        .map(|k| start + (head_at - start) * k as f32 / front as f32)
        .map(|s| Node::new(place(s), ring(s)))
        .collect();
    let link = [Node::new(place(ROOT_AT), ring(ROOT_AT)), nodes[0]];
    body.flesh(&[Body::ROOT], &link, Vec3::X);
    let neck = body.chain(Body::ROOT, (1..=front).map(|k| format!("neck_{k}")), &nodes, Vec3::X);
    let head = body.joint(neck[front - 1], "head", place(head_at));
    let way = place(0.0) - place(0.06);
    let look = direction(0.0, 0.0) * 0.4 + Vec3::new(way.x, 0.0, way.z).normalize_or(Vec3::Z);
    let size = dice.between(2.4, 3.6) * thick;
    let skull = Skull {
        length: size,
        width: dice.between(0.36, 0.52),
        snout: dice.between(0.45, 0.75),
        tip: dice.between(0.18, 0.30),
        eye: dice.between(0.05, 0.10),
        jaw: dice.chance(0.8),
    };
    let face = skull.grow(&mut body, head, look.normalize());
    if dice.chance(0.3) {
        let joint = body.joint(head, "tongue", face.tip - face.look * (0.3 * size) - face.up * (0.12 * size));
        let at = |t: f32| body.at(joint) + face.look * (t * size) - face.up * (0.25 * t * t * size);
        let points = [0.0, 0.5, 1.0].map(|t| (at(t), Ring::oval(0.07 * size, 0.03 * size), joint.0));
        body.loft(Loft::through(&points, face.side));
    }
    if dice.chance(0.15) {
        for sign in [1.0, -1.0] {
            let root = face.crown + (face.side * (0.6 * sign) + face.up * 0.6) * face.width;
            horn(&mut body, head, root, face.up, -face.look * 0.4, 0.9 * face.width, 0.22 * face.width);
        }
    }
    if dice.chance(0.4) {
        let tail: Vec<_> = chain[chain.len() - (chain.len() / 3).max(1)..].to_vec();
        body.swings("tail", &tail, Kind::Tail, dice);
    }
    body.scaled(length)
}
