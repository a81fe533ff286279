//! Things that bend or open: cables, plants, banners, chests, hanging lamps, balloons on strings.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node};
use crate::dice::Dice;
use crate::kit::parts::{bar, block, drum};
use crate::part::Ring;
use crate::piece::{Control, Loft, Piece, Sheet};
use crate::springs::Kind;
use crate::turn::{across, direction, sin_cos, turned};

pub(crate) fn body(dice: &mut Dice, _triangles: u32) -> Body {
    let made = match dice.below(5) {
        0 => cable(dice),
        1 => plant(dice),
        2 => banner(dice),
        3 => chest(dice),
        _ => cluster(dice),
    };
    let size = dice.between(0.3, 3.0);
    made.scaled(size)
}

/// A hose, a rope or a tentacle, with plugs at its ends at times.
fn cable(dice: &mut Dice) -> Body {
    let n = dice.count(4, 24);
    let thick = dice.between(0.012, 0.07);
    let (mut yaw, mut rise) = (0.0, if dice.chance(0.4) { 80.0 } else { 5.0 });
    let mut at = Vec3::new(0.0, thick, -0.5);
    let taper = if dice.chance(0.4) { 0.85 } else { 0.0 };
    let bend = dice.between(0.0, 220.0) / n as f32;
    let mut nodes = vec![Node::round(at, thick)];
    for k in 1..=n {
        at += direction(yaw, rise) / n as f32;
        yaw += bend * dice.bell() * 2.0;
        rise = (rise + bend * dice.bell()).clamp(-80.0, 88.0);
        nodes.push(Node::round(at, thick * (1.0 - taper * k as f32 / n as f32)));
    }
    let mut body = Body::new("segment_1", nodes[0].at);
    let mut chain = vec![Body::ROOT];
    for (k, node) in nodes[..n].iter().enumerate().skip(1) {
        chain.push(body.joint(chain[k - 1], format!("segment_{}", k + 1), node.at));
    }
    if dice.chance(0.5) {
        body.flesh(&chain, &nodes, Vec3::X);
    } else {
        let points: Vec<_> =
            nodes.iter().enumerate().map(|(k, node)| (node.at, node.ring, chain[k.min(n - 1)].0)).collect();
        body.loft(Loft::through(&points, Vec3::X));
    }
    if taper == 0.0 {
        for (k, way) in [(0, nodes[0].at - nodes[1].at), (n, nodes[n].at - nodes[n - 1].at)] {
            let (end, way) = (nodes[k].at, way.normalize_or(Vec3::Z));
            bar(
                &mut body,
                chain[k.min(n - 1)],
                end - way * thick,
                end + way * (2.0 * thick),
                [1.5 * thick; 2],
                1.0,
                0.2,
            );
        }
    }
    body
}

/// A stem with branches, leaves or crowns of leaves.
fn plant(dice: &mut Dice) -> Body {
    let n = dice.count(2, 6);
    let (tall, thick) = (dice.between(0.5, 1.0), dice.between(0.02, 0.06));
    let lean = direction(dice.between(0.0, 360.0), dice.between(78.0, 89.0));
    let mut along = Vec3::Y;
    let mut nodes = vec![Node::round(Vec3::ZERO, 1.3 * thick)];
    for k in 1..=n {
        let t = k as f32 / n as f32;
        nodes.push(Node::round(nodes[k - 1].at + along * (tall / n as f32), thick * (1.2 - 0.7 * t)));
        along = (along + (lean - Vec3::Y) * 0.8).normalize();
    }
    let mut body = Body::new("stem_1", Vec3::ZERO);
    let mut stem = vec![Body::ROOT];
    for (k, node) in nodes[..n].iter().enumerate().skip(1) {
        stem.push(body.joint(stem[k - 1], format!("stem_{}", k + 1), node.at));
    }
    body.flesh(&stem, &nodes, Vec3::X);
    let leaves = dice.chance(0.5);
    let mut grown = Vec::new();
    for k in 0..dice.count(2, 10) {
        let t = dice.between(0.35, 1.0) * n as f32;
        let on = (t as usize).min(n - 1);
        let share = (t - on as f32).clamp(0.08, 0.95);
        let out = direction(137.5 * k as f32, dice.between(-5.0, 50.0));
        let length = dice.between(0.2, 0.4) * tall;
        let place = |share: f32| nodes[on].at + (nodes[on + 1].at - nodes[on].at) * share;
        let taken = |root: Vec3| grown.iter().any(|other: &Vec3| other.distance(root) < APART * tall);
        let root = shares(share).map(place).find(|&root| leaves || !taken(root)).unwrap_or(place(share));
        grown.push(root);
        if leaves {
            leaf(&mut body, stem[on], k, root, out, length);
        } else {
            let joint = body.joint(stem[on], format!("branch_{}", k + 1), root);
            bar(&mut body, joint, root, root + out * length, [0.5 * thick, 0.25 * thick], 0.0, 0.0);
            body.oval(joint, root + out * length, Vec3::Y, Vec3::splat(dice.between(0.25, 0.6) * length));
        }
    }
    body
}

/// How far apart branches grow at least, as a share of the plant's height; leaves begin a little away from the stem.
const APART: f32 = 0.0025;

/// A share of a piece of the stem, and others all along it for where that is taken.
fn shares(first: f32) -> impl Iterator<Item = f32> {
    // By the golden ratio each new one falls into the widest gap.
    std::iter::once(first).chain((1..64).map(|k: u8| 0.08 + 0.87 * (0.618_034 * f32::from(k)).fract()))
}

/// A leaf of two joints, open, one layer.
fn leaf(body: &mut Body, stem: JointId, number: usize, root: Vec3, out: Vec3, length: f32) {
    let first = body.joint(stem, format!("leaf_{}_1", number + 1), root + out * (0.05 * length));
    let at = |t: f32| root + out * (length * t) - Vec3::Y * (0.45 * length * t * t);
    let second = body.joint(first, format!("leaf_{}_2", number + 1), at(0.5));
    let side = across(out, turned(out, Vec3::Y, 90.0));
    let ribs = [-1.0, 0.0, 1.0].map(|wide: f32| {
        [(0.0, 0.02, first), (0.35, 0.16, first), (0.7, 0.13, second), (1.0, 0.01, second)]
            .map(|(t, r, joint)| {
                let lift = Vec3::Y * (0.25 * r * length * wide * wide);
                Control { at: at(t) + side * (r * length * wide) + lift, joint: joint.0 }
            })
            .to_vec()
    });
    body.pieces.push(Piece::Sheet(Sheet { ribs: ribs.into(), thickness: 0.0, round: false }));
}

/// Cloth on a pole: chains of joints across it that swing.
fn banner(dice: &mut Dice) -> Body {
    let mut body = Body::new("pole", Vec3::ZERO);
    bar(&mut body, Body::ROOT, Vec3::ZERO, Vec3::Y, [0.02; 2], 0.0, 0.0);
    let (wide, high) = (dice.between(0.3, 0.9), dice.between(0.2, 0.6));
    let (rows, joints) = (dice.count(1, 4), dice.count(2, 6));
    let wave = dice.between(0.0, 0.08);
    let hangs = dice.chance(0.4);
    if hangs {
        bar(&mut body, Body::ROOT, Vec3::new(-0.1 - wide, 1.0, 0.0), Vec3::new(0.1, 1.0, 0.0), [0.015; 2], 0.0, 0.0);
    }
    let at = |row: f32, t: f32| {
        let (sin, _) = sin_cos(400.0 * t + 60.0 * row);
        match hangs {
            true => Vec3::new(-wide * row - 0.02, 0.985 - high * 1.4 * t, wave * sin * t),
            false => Vec3::new(-wide * t - 0.02, 0.98 - high * row, wave * sin * t),
        }
    };
    let ribs = rows.max(2);
    let mut chains = Vec::new();
    let sheet: Vec<Vec<Control>> = (0..ribs)
        .map(|rib| {
            let row = rib as f32 / (ribs - 1) as f32;
            // With one chain for all ribs it runs along the middle.
            if rib < rows {
                let own = if rows == 1 { 0.5 } else { row };
                let mut above = Body::ROOT;
                let chain: Vec<_> = (1..=joints)
                    .map(|k| {
                        let t = (k as f32 - 0.9) / joints as f32;
                        above = body.joint(above, format!("cloth_{}_{k}", rib + 1), at(own, t));
                        above
                    })
                    .collect();
                chains.push(chain);
            }
            let chain = &chains[rib.min(rows - 1)];
            (0..=joints)
                .map(|k| Control {
                    at: at(row, k as f32 / joints as f32),
                    joint: if k == 0 { Body::ROOT.0 } else { chain[k - 1].0 },
                })
                .collect()
        })
        .collect();
    body.pieces.push(Piece::Sheet(Sheet { ribs: sheet, thickness: 0.0, round: false }));
    for chain in chains {
        body.swings("cloth", &chain, Kind::Cloth, dice);
    }
    body
}

/// A box with a lid, drawers or doors.
fn chest(dice: &mut Dice) -> Body {
    let half = Vec3::new(dice.between(0.25, 0.5), dice.between(0.15, 0.5), dice.between(0.18, 0.35));
    let mut body = Body::new("box", Vec3::ZERO);
    let bevel = dice.between(0.0, 0.3);
    block(&mut body, Body::ROOT, Vec3::Y * half.y, half, bevel);
    let top = 2.0 * half.y;
    if dice.chance(0.7) {
        let lid = body.joint(Body::ROOT, "lid", Vec3::new(0.0, top, -half.z));
        let open = dice.between(0.0, 60.0) * if dice.chance(0.5) { 1.0 } else { 0.0 };
        let tall = dice.between(0.05, 0.15);
        block(&mut body, lid, Vec3::Y * (top + tall), Vec3::new(half.x, tall, half.z), bevel);
        body.turn(lid.index(), Vec3::X, -open);
    }
    let drawers = dice.count(1, 4);
    for k in 0..drawers {
        let high = half.y / drawers as f32;
        let y = high * (2 * k + 1) as f32;
        let name = format!("drawer_{}", k + 1);
        let out = dice.between(0.0, 0.8) * half.z;
        let drawer = body.joint(Body::ROOT, name, Vec3::new(0.0, y, 0.9 * half.z + out));
        block(&mut body, drawer, Vec3::new(0.0, y, half.z + out), Vec3::new(0.9 * half.x, 0.8 * high, 0.02), 0.0);
        body.ball(drawer, Vec3::new(0.0, y, half.z + out + 0.04), 0.03);
    }
    Body { rigid: true, ..body }
}

/// Things around a middle, each on a joint from the ground: lamps, balloons, crystals.
fn cluster(dice: &mut Dice) -> Body {
    let mut body = Body::new("root_bone", Vec3::ZERO);
    drum(&mut body, Body::ROOT, Vec3::Y * 0.02, Vec3::Y, dice.between(0.08, 0.25), 0.02);
    let kind = dice.below(3);
    for k in 0..dice.count(3, 16) {
        let (sin, cos) = sin_cos(137.5 * k as f32);
        let r = dice.between(0.1, 0.5);
        let at = Vec3::new(r * sin, dice.between(0.3, 1.0), r * cos);
        let size = dice.between(0.04, 0.11);
        match kind {
            0 => {
                let joint = body.joint(Body::ROOT, format!("item_{}", k + 1), at);
                body.ball(joint, at, size);
            }
            1 => {
                let middle = body.joint(Body::ROOT, format!("string_{}", k + 1), at * 0.45);
                let joint = body.joint(middle, format!("balloon_{}", k + 1), at);
                let points = [(Vec3::Y * 0.04, Body::ROOT), (at * 0.45, middle), (at, joint)];
                let points = points.map(|(p, joint)| (p, Ring::round(0.006), joint.0));
                body.loft(Loft::through(&points, Vec3::X));
                body.oval(joint, at + Vec3::Y * size, Vec3::Y, Vec3::new(1.0, 1.0, 1.25) * size);
            }
            _ => {
                let root = Vec3::new(0.5 * at.x, 0.0, 0.5 * at.z);
                let joint = body.joint(Body::ROOT, format!("crystal_{}", k + 1), root + Vec3::Y * 0.02);
                let top = root + (at - root) * 0.7;
                bar(&mut body, joint, root, top, [size, 0.7 * size], dice.between(0.0, 1.0), 0.6);
            }
        }
    }
    Body { rigid: kind != 1, ..body }
}
