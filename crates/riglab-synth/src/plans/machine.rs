//! Machines: arms on a base, vehicles, diggers, robots, drones. Each part is a component of its own
//! and follows one joint with weight 1.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Side};
use crate::dice::Dice;
use crate::kit::parts::{arm, bar, block, drum, gripper, leg, wheel};
use crate::turn::{direction, sin_cos};

pub(crate) fn body(dice: &mut Dice, _triangles: u32) -> Body {
    let made = match dice.below(6) {
        0 => robot_arm(dice),
        1 => vehicle(dice),
        2 => digger(dice),
        3 => drone(dice),
        4 => walker(dice),
        _ => robot(dice),
    };
    let size = dice.between(0.4, 4.0);
    Body { rigid: true, ..made }.scaled(size)
}

/// A turning column with an arm on a base.
fn robot_arm(dice: &mut Dice) -> Body {
    let mut body = Body::new("base", Vec3::ZERO);
    let (wide, high) = (dice.between(0.16, 0.3), dice.between(0.06, 0.16));
    match dice.chance(0.5) {
        true => block(&mut body, Body::ROOT, Vec3::Y * (0.5 * high), Vec3::new(wide, 0.5 * high, wide), 0.1),
        false => drum(&mut body, Body::ROOT, Vec3::Y * (0.5 * high), Vec3::Y, wide, 0.5 * high),
    }
    let column = body.joint(Body::ROOT, "turntable", Vec3::Y * high);
    let tall = dice.between(0.08, 0.2);
    drum(&mut body, column, Vec3::Y * (high + 0.5 * tall), Vec3::Y, 0.6 * wide, 0.5 * tall);
    let arms = if dice.chance(0.2) { 2 } else { 1 };
    for k in 0..arms {
        let aside = if arms == 2 { 0.4 * wide * (1.0 - 2.0 * k as f32) } else { 0.0 };
        let root = Vec3::new(aside, high + tall, 0.0);
        let name = if arms == 2 { format!("arm{}", k + 1) } else { "arm".into() };
        let (joints, length) = (dice.count(2, 6), dice.between(0.7, 1.3));
        let (last, end) = arm(&mut body, column, &name, root, joints, [length, 0.3 * wide], dice);
        let ahead = (end - body.at(last)).normalize_or(Vec3::Z);
        gripper(&mut body, last, &format!("{name}_tool"), end, ahead, 0.6 * wide, dice);
    }
    body
}

/// Chassis with wheels; gives the chassis' half extents.
fn chassis(body: &mut Body, dice: &mut Dice) -> (Vec3, f32) {
    let half = Vec3::new(dice.between(0.18, 0.32), dice.between(0.05, 0.13), dice.between(0.4, 0.7));
    let radius = dice.between(0.09, 0.18);
    body.joints[0].head = (Vec3::Y * (1.1 * radius)).into();
    block(body, Body::ROOT, Vec3::Y * (1.2 * radius + half.y), half, dice.between(0.0, 0.3));
    let axles = dice.count(2, 3);
    for axle in 0..axles {
        let z = half.z * (0.72 - 1.44 * axle as f32 / (axles - 1) as f32);
        for side in Side::BOTH {
            let name = format!("wheel_{}_{}", axle + 1, side.word().to_lowercase());
            let center = side.of(Vec3::new(half.x + 0.3 * radius, radius, z));
            // Front wheels steer on a joint of their own.
            let parent = match axle == 0 && dice.chance(0.4) {
                true => body.joint(
                    Body::ROOT,
                    format!("steer_{}", side.word().to_lowercase()),
                    center - side.of(0.5 * radius * Vec3::X),
                ),
                false => Body::ROOT,
            };
            if parent != Body::ROOT {
                let inner = center - side.of(0.5 * radius * Vec3::X);
                bar(body, parent, inner, center, [0.2 * radius; 2], 1.0, 0.0);
            }
            wheel(body, parent, name, center, radius, 0.3 * radius);
        }
    }
    (half, 1.2 * radius + 2.0 * half.y)
}

/// A car or truck with a cab, doors, a lid.
fn vehicle(dice: &mut Dice) -> Body {
    let mut body = Body::new("chassis", Vec3::ZERO);
    let (half, top) = chassis(&mut body, dice);
    let cab = Vec3::new(0.85 * half.x, dice.between(0.08, 0.2), dice.between(0.3, 0.5) * half.z);
    let z = dice.between(-0.3, 0.4) * half.z;
    let held =
        if dice.chance(0.5) { body.joint(Body::ROOT, "cab", Vec3::new(0.0, top, z - cab.z)) } else { Body::ROOT };
    block(&mut body, held, Vec3::new(0.0, top + cab.y, z), cab, 0.35);
    if dice.chance(0.6) {
        for side in Side::BOTH {
            let hinge = Vec3::new(half.x + 0.01, top - half.y, z + 0.6 * cab.z);
            let door = body.joint(Body::ROOT, format!("door_{}", side.word().to_lowercase()), side.of(hinge));
            let center = hinge + Vec3::new(0.005, 0.4 * cab.y, -0.6 * cab.z);
            block(&mut body, door, side.of(center), Vec3::new(0.012, 0.8 * half.y + 0.4 * cab.y, 0.55 * cab.z), 0.0);
        }
    }
    if dice.chance(0.4) {
        let lid = body.joint(Body::ROOT, "lid", Vec3::new(0.0, top, -half.z * 0.5));
        block(
            &mut body,
            lid,
            Vec3::new(0.0, top + 0.015, -0.75 * half.z),
            Vec3::new(0.8 * half.x, 0.015, 0.24 * half.z),
            0.0,
        );
    }
    if dice.chance(0.35) {
        let at = Vec3::new(0.0, top + 2.0 * cab.y, z);
        let turret = body.joint(held, "turret", at);
        drum(&mut body, turret, at + Vec3::Y * 0.05, Vec3::Y, 0.6 * half.x, 0.05);
        let barrel = body.joint(turret, "barrel", at + Vec3::new(0.0, 0.06, 0.5 * half.x));
        let from = body.at(barrel);
        bar(&mut body, barrel, from, from + direction(0.0, dice.between(0.0, 20.0)) * 0.5, [0.035, 0.03], 0.0, 0.0);
    }
    body
}

/// Wheels or tracks below, a cab that turns, an arm with a bucket.
fn digger(dice: &mut Dice) -> Body {
    let mut body = Body::new("chassis", Vec3::ZERO);
    let (half, top) = chassis(&mut body, dice);
    let cab = body.joint(Body::ROOT, "cab", Vec3::Y * top);
    let tall = dice.between(0.12, 0.25);
    block(
        &mut body,
        cab,
        Vec3::new(0.3 * half.x, top + tall, -0.1 * half.z),
        Vec3::new(0.5 * half.x, tall, 0.35 * half.z),
        0.2,
    );
    block(&mut body, cab, Vec3::new(0.0, top + 0.04, -0.2 * half.z), Vec3::new(half.x, 0.04, 0.7 * half.z), 0.2);
    let root = Vec3::new(-0.35 * half.x, top + 0.08, 0.4 * half.z);
    let (last, end) = arm(&mut body, cab, "boom", root, dice.count(2, 4), [dice.between(0.8, 1.3), 0.05], dice);
    let bucket = body.joint(last, "bucket", end);
    block(&mut body, bucket, end + Vec3::new(0.0, -0.07, 0.03), Vec3::new(0.13, 0.07, 0.09), 0.3);
    for k in 0..4 {
        let tooth = end + Vec3::new(-0.1 + 0.066 * k as f32, -0.12, 0.11);
        bar(&mut body, bucket, tooth, tooth + Vec3::new(0.0, -0.02, 0.07), [0.02, 0.005], 1.0, 0.0);
    }
    body
}

/// A hull with rotors on arms.
fn drone(dice: &mut Dice) -> Body {
    let high = dice.between(0.15, 0.8);
    let mut body = Body::new("hull", Vec3::Y * high);
    let size = dice.between(0.12, 0.25);
    match dice.chance(0.5) {
        true => body.oval(Body::ROOT, Vec3::Y * high, Vec3::Z, Vec3::new(1.0, 0.6, 1.3) * size),
        false => block(&mut body, Body::ROOT, Vec3::Y * high, Vec3::new(0.9, 0.5, 1.2) * size, 0.4),
    }
    let count = dice.count(3, 8);
    let (reach, blades) = (dice.between(0.35, 0.6), dice.count(2, 4));
    for k in 0..count {
        let (sin, cos) = sin_cos(360.0 * (k as f32 + 0.5) / count as f32);
        let out = Vec3::new(sin, 0.05, cos);
        let end = Vec3::Y * high + out * reach;
        bar(&mut body, Body::ROOT, Vec3::Y * high + out * (0.5 * size), end, [0.03, 0.022], 0.0, 0.0);
        let hub = end + Vec3::Y * 0.03;
        let rotor = body.joint(Body::ROOT, format!("rotor_{}", k + 1), hub);
        drum(&mut body, rotor, hub, Vec3::Y, 0.03, 0.025);
        for blade in 0..blades {
            let (sin, cos) = sin_cos(360.0 * blade as f32 / blades as f32 + 25.0 * k as f32);
            let along = Vec3::new(sin, 0.0, cos);
            bar(&mut body, rotor, hub + along * 0.02, hub + along * 0.16, [0.016, 0.008], 1.0, 0.0);
        }
    }
    if dice.chance(0.5) {
        let at = Vec3::new(0.0, high - 0.55 * size, 0.6 * size);
        let camera = body.joint(Body::ROOT, "camera", at);
        body.ball(camera, at, 0.25 * size);
    }
    body
}

/// A hull on two to eight legs.
fn walker(dice: &mut Dice) -> Body {
    let hips = dice.between(0.4, 0.75);
    let mut body = Body::new("hull", Vec3::Y * hips);
    let half = Vec3::new(dice.between(0.14, 0.26), dice.between(0.10, 0.2), dice.between(0.14, 0.4));
    block(&mut body, Body::ROOT, Vec3::Y * (hips + half.y), half, dice.between(0.1, 0.5));
    let pairs = dice.count(1, 4);
    let forward = dice.between(-0.25, 0.3);
    let thick = dice.between(0.03, 0.06);
    for pair in 0..pairs {
        let z = if pairs == 1 { 0.0 } else { half.z * (0.85 - 1.7 * pair as f32 / (pairs - 1) as f32) };
        let number = if pairs == 1 { String::new() } else { format!("_{}", pair + 1) };
        for side in Side::BOTH {
            leg(&mut body, Body::ROOT, side, &number, Vec3::new(half.x + thick, hips, z), forward, thick);
        }
    }
    let top = hips + 2.0 * half.y;
    let turret = body.joint(Body::ROOT, "turret", Vec3::Y * top);
    drum(&mut body, turret, Vec3::Y * (top + 0.05), Vec3::Y, 0.6 * half.x, 0.05);
    for side in Side::BOTH {
        let root = side.of(Vec3::new(0.62 * half.x, top + 0.05, 0.0));
        let gun = body.joint(turret, format!("gun_{}", side.word().to_lowercase()), root);
        bar(&mut body, gun, root, root + Vec3::Z * dice.between(0.2, 0.4), [0.03, 0.022], 0.0, 0.0);
    }
    body
}

/// A figure of boxes and bars.
fn robot(dice: &mut Dice) -> Body {
    let hips = dice.between(0.32, 0.5);
    let mut body = Body::new("pelvis", Vec3::Y * hips);
    let wide = dice.between(0.10, 0.2);
    block(&mut body, Body::ROOT, Vec3::Y * (hips + 0.03), Vec3::new(0.8 * wide, 0.045, 0.6 * wide), 0.2);
    let waist = hips + 0.09;
    let torso = body.joint(Body::ROOT, "torso", Vec3::Y * waist);
    let tall = dice.between(0.1, 0.17);
    block(&mut body, torso, Vec3::Y * (waist + tall), Vec3::new(wide, tall, 0.7 * wide), dice.between(0.1, 0.5));
    drum(&mut body, torso, Vec3::Y * (waist - 0.01), Vec3::Y, 0.4 * wide, 0.04);
    let neck = waist + 2.0 * tall;
    let head = body.joint(torso, "head", Vec3::Y * neck);
    let size = dice.between(0.06, 0.14);
    block(&mut body, head, Vec3::Y * (neck + 0.02 + size), Vec3::new(size, size, 0.9 * size), dice.between(0.1, 0.6));
    for side in Side::BOTH {
        body.ball(head, side.of(Vec3::new(0.4 * size, neck + 0.02 + 1.2 * size, 0.85 * size)), 0.2 * size);
        robot_limb(&mut body, torso, side, Vec3::new(wide + 0.03, neck - 0.05, 0.0), dice);
    }
    if dice.chance(0.75) {
        let forward = dice.between(0.0, 0.12);
        let thick = dice.between(0.03, 0.05);
        for side in Side::BOTH {
            leg(&mut body, Body::ROOT, side, "", Vec3::new(0.6 * wide, hips, 0.0), forward, thick);
        }
    } else {
        for (k, z) in [0.1, -0.1].into_iter().enumerate() {
            for side in Side::BOTH {
                let name = format!("wheel_{}_{}", k + 1, side.word().to_lowercase());
                wheel(&mut body, Body::ROOT, name, side.of(Vec3::new(wide, 0.5 * hips, z)), 0.5 * hips, 0.04);
            }
        }
    }
    body
}

fn robot_limb(body: &mut Body, torso: JointId, side: Side, shoulder: Vec3, dice: &mut Dice) {
    let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
    let down = direction(90.0, dice.between(-75.0, 0.0));
    let (upper, thick) = (dice.between(0.12, 0.2), dice.between(0.022, 0.04));
    let elbow = shoulder + down * upper;
    let wrist = elbow + (down + Vec3::Z * 0.3).normalize() * (0.9 * upper);
    let arm = body.joint(torso, name("arm"), side.of(shoulder));
    body.ball(arm, side.of(shoulder), 1.5 * thick);
    bar(body, arm, side.of(shoulder), side.of(elbow), [thick, 0.85 * thick], 1.0, 0.2);
    let fore = body.joint(arm, name("forearm"), side.of(elbow));
    body.ball(fore, side.of(elbow), 1.15 * thick);
    bar(body, fore, side.of(elbow), side.of(wrist), [0.9 * thick, 1.1 * thick], 0.0, 0.2);
    gripper(body, fore, &name("hand"), side.of(wrist), side.of((wrist - elbow).normalize()), 2.0 * thick, dice);
}
