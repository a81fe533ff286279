//! Things that stand where they are but for a part or two: idols, cabinets, traps, bells, scenes with one thing that
//! moves. A fifth of the real props and machines at hand are such: a joint on the ground and one more, or a few.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node};
use crate::dice::Dice;
use crate::kit::parts::{bar, block, drum};
use crate::part::Ring;
use crate::turn::{direction, sin_cos};

pub(crate) fn body(dice: &mut Dice, _triangles: u32) -> Body {
    let made = match dice.below(7) {
        0 => pedestal(dice),
        1 => lump(dice),
        2 => cabinet(dice),
        3 => trap(dice),
        4 => hanging(dice),
        5 => mascot(dice),
        _ => scene(dice),
    };
    let size = dice.between(0.3, 4.0);
    made.scaled(size)
}

/// A body whose root stands on the ground, mostly, or within what stands there.
fn standing(dice: &mut Dice, within: f32) -> Body {
    let high = if dice.chance(0.75) { 0.0 } else { within };
    Body::new("base", Vec3::Y * high)
}

/// One solid of about this size around a point.
fn solid(body: &mut Body, joint: JointId, at: Vec3, size: f32, dice: &mut Dice) {
    match dice.below(5) {
        0 => body.ball(joint, at, size),
        1 => body.oval(joint, at, Vec3::Y, Vec3::new(dice.between(0.5, 1.2), dice.between(0.3, 1.0), 1.0) * size),
        2 => {
            let half = Vec3::new(dice.between(0.4, 1.0), dice.between(0.4, 1.0), dice.between(0.2, 1.0)) * size;
            block(body, joint, at, half, dice.between(0.0, 0.4));
        }
        3 => {
            let ends = [dice.between(0.3, 0.9) * size, dice.between(0.05, 0.6) * size];
            let square = if dice.chance(0.5) { 1.0 } else { 0.0 };
            bar(body, joint, at - Vec3::Y * size, at + Vec3::Y * size, ends, square, 0.1);
        }
        _ => {
            let axis = if dice.chance(0.5) { Vec3::Y } else { Vec3::Z };
            drum(body, joint, at, axis, size, dice.between(0.1, 0.6) * size);
        }
    }
}

/// Something on a foot, or above the ground alone, that turns or floats; a glow or ring around it at times.
fn pedestal(dice: &mut Dice) -> Body {
    let foot = dice.between(0.1, 0.7);
    let mut body = standing(dice, 0.5 * foot);
    let wide = dice.between(0.15, 0.45);
    match dice.below(3) {
        0 => block(&mut body, Body::ROOT, Vec3::Y * (0.5 * foot), Vec3::new(wide, 0.5 * foot, wide), 0.1),
        1 => drum(&mut body, Body::ROOT, Vec3::Y * (0.5 * foot), Vec3::Y, wide, 0.5 * foot),
        _ => {
            drum(&mut body, Body::ROOT, Vec3::Y * 0.03, Vec3::Y, wide, 0.03);
            bar(&mut body, Body::ROOT, Vec3::ZERO, Vec3::Y * foot, [0.2 * wide; 2], 0.0, 0.0);
        }
    }
    let size = dice.between(0.12, 0.4);
    let lift = if dice.chance(0.4) { dice.between(0.0, 0.3) } else { 0.0 };
    let middle = Vec3::Y * (foot + size + lift);
    let pivot = if dice.chance(0.6) { middle } else { Vec3::Y * foot };
    let item = body.joint(Body::ROOT, "item", pivot);
    for k in 0..dice.count(1, 3) {
        let (sin, cos) = sin_cos(120.0 * k as f32);
        let aside = Vec3::new(sin, 0.0, cos) * (if k == 0 { 0.0 } else { 0.7 * size });
        solid(&mut body, item, middle + aside, size * (1.0 - 0.25 * k as f32), dice);
    }
    if pivot != middle && dice.chance(0.5) {
        let around = body.joint(Body::ROOT, "glow", middle);
        drum(&mut body, around, middle, Vec3::Y, 1.6 * size, 0.02);
    }
    Body { rigid: true, ..body }
}

/// A blob, a jelly, a sack: one soft body with two or three joints above each other.
fn lump(dice: &mut Dice) -> Body {
    let n = dice.count(2, 3);
    let (wide, deep) = (dice.between(0.2, 0.6), dice.between(0.7, 1.1));
    let ring = |r: f32| Ring::oval(r, deep * r);
    let lean = Vec3::new(dice.between(-0.1, 0.1), 0.0, dice.between(-0.1, 0.1));
    let nodes: Vec<Node> = (0..=n)
        .map(|k| {
            let t = k as f32 / n as f32;
            let r = wide * (1.0 - dice.between(0.1, 0.8) * t);
            Node::new(Vec3::Y * t + lean * t, ring(r.max(0.05)))
        })
        .collect();
    let mut body = Body::new("body", nodes[0].at);
    let mut chain = vec![Body::ROOT];
    for (k, node) in nodes[..n].iter().enumerate().skip(1) {
        chain.push(body.joint(chain[k - 1], format!("body_{}", k + 1), node.at));
    }
    body.flesh(&chain, &nodes, Vec3::X);
    let top = chain[n - 1];
    if dice.chance(0.6) {
        let at = nodes[n].at - Vec3::Y * (0.6 / n as f32);
        for side in [-1.0, 1.0] {
            let eye = at + Vec3::new(0.35 * side * wide, 0.0, 0.7 * deep * wide);
            body.ball(top, eye, dice.between(0.08, 0.2) * wide);
        }
    }
    body
}

/// A box on the ground with an upper part, fittings that follow it or do not, and a door at times.
fn cabinet(dice: &mut Dice) -> Body {
    let half = Vec3::new(dice.between(0.2, 0.6), dice.between(0.3, 0.7), dice.between(0.15, 0.5));
    let mut body = standing(dice, half.y);
    let cut = dice.between(0.25, 0.9) * 2.0 * half.y;
    let lower = Vec3::new(half.x, 0.5 * cut, half.z);
    block(&mut body, Body::ROOT, Vec3::Y * (0.5 * cut), lower, dice.between(0.0, 0.2));
    let top = 2.0 * half.y;
    let upper = match dice.below(3) {
        // The bone of one that reaches from the ground to the top.
        0 => body.joint(Body::ROOT, "top", Vec3::Y * top),
        1 => body.joint(Body::ROOT, "upper", Vec3::Y * cut),
        _ => body.joint(Body::ROOT, "lid", Vec3::new(0.0, cut, -half.z)),
    };
    let rest = 0.5 * (top - cut);
    let inset = dice.between(0.7, 1.0);
    block(&mut body, upper, Vec3::Y * (cut + rest), Vec3::new(inset * half.x, rest, inset * half.z), 0.1);
    for _ in 0..dice.count(0, 6) {
        let y = dice.between(0.05, 1.0) * top;
        let at = Vec3::new(dice.between(-0.8, 0.8) * half.x, y, half.z);
        let joint = if y > cut { upper } else { Body::ROOT };
        solid(&mut body, joint, at, dice.between(0.03, 0.12), dice);
    }
    if dice.chance(0.3) {
        let side = if dice.chance(0.5) { 1.0 } else { -1.0 };
        let hinge = Vec3::new(side * 0.8 * half.x, 0.5 * cut, half.z);
        let door = body.joint(Body::ROOT, "door", hinge);
        block(&mut body, door, Vec3::new(0.0, 0.5 * cut, half.z + 0.02), Vec3::new(0.8 * half.x, 0.4 * cut, 0.02), 0.0);
    }
    Body { rigid: true, ..body }
}

/// A plate from which something comes up: spikes, a piston, a button.
fn trap(dice: &mut Dice) -> Body {
    let (wide, high) = (dice.between(0.3, 0.7), dice.between(0.03, 0.12));
    let mut body = Body::new("base", Vec3::ZERO);
    block(&mut body, Body::ROOT, Vec3::Y * high, Vec3::new(wide, high, wide * dice.between(0.6, 1.0)), 0.1);
    let moving = body.joint(Body::ROOT, "moving", Vec3::Y * (2.0 * high));
    let tall = dice.between(0.15, 0.6);
    let rows = dice.count(1, 4);
    if rows == 1 {
        solid(&mut body, moving, Vec3::Y * (2.0 * high + 0.4 * tall), 0.6 * wide, dice);
    } else {
        let square = if dice.chance(0.5) { 1.0 } else { 0.0 };
        for k in 0..rows * rows {
            let place = |k: usize| wide * 0.75 * (2.0 * k as f32 / (rows - 1) as f32 - 1.0);
            let root = Vec3::new(place(k % rows), high, 0.7 * place(k / rows));
            bar(&mut body, moving, root, root + Vec3::Y * tall, [0.12 * wide, 0.01], square, 0.0);
        }
    }
    Body { rigid: true, ..body }
}

/// A bell, a lantern, a sign or a swing from a post or a frame.
fn hanging(dice: &mut Dice) -> Body {
    let tall = dice.between(0.7, 1.2);
    let mut body = standing(dice, 0.1 * tall);
    let reach = dice.between(0.15, 0.5);
    let thick = dice.between(0.02, 0.06);
    let posts = if dice.chance(0.5) { vec![0.0] } else { vec![-reach, reach] };
    if posts.len() > 1 {
        // On the ground between both, where nothing is.
        body = Body::new("root", Vec3::ZERO);
    }
    for &x in &posts {
        bar(&mut body, Body::ROOT, Vec3::X * x, Vec3::new(x, tall, 0.0), [thick, 0.8 * thick], 1.0, 0.0);
    }
    let across = if posts.len() == 1 { [-0.1 * reach, reach] } else { [-1.1 * reach, 1.1 * reach] };
    let [from, to] = across.map(|x| Vec3::new(x, tall, 0.0));
    bar(&mut body, Body::ROOT, from, to, [0.8 * thick; 2], 1.0, 0.0);
    let hook = Vec3::new(if posts.len() == 1 { 0.85 * reach } else { 0.0 }, tall - thick, 0.0);
    let rope = dice.between(0.05, 0.3) * tall;
    let mut joint = body.joint(Body::ROOT, "hook", hook);
    bar(&mut body, joint, hook, hook - Vec3::Y * rope, [0.3 * thick; 2], 0.0, 0.0);
    if dice.chance(0.35) {
        joint = body.joint(joint, "hanging", hook - Vec3::Y * rope);
    }
    let size = dice.between(0.1, 0.22) * tall;
    solid(&mut body, joint, hook - Vec3::Y * (rope + size), size, dice);
    Body { rigid: true, ..body }
}

/// A little figure without limbs: a root that holds nothing, a torso, at times a neck that holds its upper half, and a
/// large head.
fn mascot(dice: &mut Dice) -> Body {
    let (hip, waist) = (dice.between(0.05, 0.45), dice.between(0.12, 0.3));
    let head_at = hip + dice.between(0.15, 0.35);
    let r = dice.between(0.2, 0.42);
    let back = dice.between(-0.05, 0.05);
    let mut body = Body { rooted: true, ..Body::new("torso", Vec3::new(0.0, hip, back)) };
    let torso = Body::ROOT;
    let middle = Vec3::new(0.0, 0.5 * (hip + head_at), back);
    let mut above = torso;
    if dice.chance(0.5) {
        above = body.joint(torso, "neck", middle);
        // Wider than torso and head are here, which would hide it.
        let wide = (0.95 * waist).max(0.55 * r);
        body.mass(above, middle, Vec3::Z, Vec3::new(wide, 0.4 * (head_at - hip), 0.8 * wide));
    }
    let head = body.joint(above, "head", Vec3::new(0.0, head_at, back));
    body.mass(torso, Vec3::new(0.0, hip, back), Vec3::Z, Vec3::new(waist, 0.6 * (head_at - hip) + 0.05, 0.8 * waist));
    let skull = Vec3::new(0.0, head_at + 0.8 * r, back);
    body.mass(head, skull, Vec3::Z, Vec3::new(r, dice.between(0.7, 1.1) * r, dice.between(0.7, 1.0) * r));
    for side in [-1.0, 1.0] {
        body.ball(head, skull + Vec3::new(0.4 * side * r, 0.1 * r, 0.75 * r), 0.16 * r);
        if dice.chance(0.3) {
            let root = skull + Vec3::new(0.5 * side * r, 0.6 * r, 0.0);
            bar(&mut body, head, root, root + direction(90.0 * side, 60.0) * (0.6 * r), [0.12 * r, 0.02], 0.0, 0.0);
        }
    }
    body
}

/// Much that stands still, and one thing or two among it that moves.
fn scene(dice: &mut Dice) -> Body {
    let mut body = Body::new("base", Vec3::ZERO);
    let wide = dice.between(0.6, 1.2);
    if dice.chance(0.7) {
        drum(&mut body, Body::ROOT, -Vec3::Y * 0.02, Vec3::Y, wide, 0.02);
    }
    let mut tops = Vec::new();
    for k in 0..dice.count(3, 14) {
        let (sin, cos) = sin_cos(137.5 * k as f32 + dice.between(-20.0, 20.0));
        let away = wide * dice.between(0.1, 0.85);
        let half = Vec3::new(dice.between(0.04, 0.2), dice.between(0.05, 0.4), dice.between(0.04, 0.2));
        let at = Vec3::new(away * sin, half.y, away * cos);
        block(&mut body, Body::ROOT, at, half, dice.between(0.0, 0.3));
        if dice.chance(0.3) {
            let roof = at + Vec3::Y * half.y;
            bar(&mut body, Body::ROOT, roof, roof + Vec3::Y * 0.15, [1.2 * half.x, 0.01], 1.0, 0.0);
        }
        tops.push(at + Vec3::Y * half.y);
    }
    let moving = dice.count(1, 2);
    for (k, on) in tops.into_iter().take(moving).enumerate() {
        let size = dice.between(0.05, 0.2);
        let middle = on + Vec3::Y * (size + dice.between(0.0, 0.4));
        let pivot = match dice.below(3) {
            0 => Vec3::new(on.x, 0.0, on.z),
            1 => on,
            _ => middle,
        };
        let moving = body.joint(Body::ROOT, format!("moving_{}", k + 1), pivot);
        solid(&mut body, moving, middle, size, dice);
    }
    Body { rigid: true, ..body }
}
