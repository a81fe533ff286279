//! Parts of machines: each follows one joint with weight 1.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Side};
use crate::dice::Dice;
use crate::part::Ring;
use crate::piece::Loft;
use crate::turn::direction;

/// A box of half extents `half` around a point, axes along those of space.
pub(crate) fn block(body: &mut Body, joint: JointId, center: Vec3, half: Vec3, bevel: f32) {
    let up = Vec3::Y * half.y;
    let ring = Ring::oval(half.x, half.z);
    body.loft(Loft::cuboid(joint.0, center - up, center + up, Vec3::X, ring, bevel));
}

/// A bar from `a` to `b`: square with `square` 1, round with 0.
pub(crate) fn bar(body: &mut Body, joint: JointId, a: Vec3, b: Vec3, ends: [f32; 2], square: f32, bevel: f32) {
    let rings = ends.map(Ring::round);
    body.loft(Loft::tapered(joint.0, a, b, Vec3::X, rings, bevel).squared(square));
}

/// A disc or cylinder around an axis.
pub(crate) fn drum(body: &mut Body, joint: JointId, center: Vec3, axis: Vec3, radius: f32, half: f32) {
    let ring = Ring::round(radius);
    let hint = if axis.y.abs() > 0.7 { Vec3::X } else { Vec3::Y };
    body.loft(Loft::tapered(joint.0, center - axis * half, center + axis * half, hint, [ring; 2], 0.15));
}

/// A wheel with its hub on a joint of its own.
pub(crate) fn wheel(body: &mut Body, parent: JointId, name: String, center: Vec3, radius: f32, half: f32) {
    let joint = body.joint(parent, name, center);
    drum(body, joint, center, Vec3::X, radius, half);
    let out = Vec3::X * (center.x.signum() * half);
    drum(body, joint, center + out, Vec3::X, 0.45 * radius, 0.25 * half);
}

/// A chain of bars that starts upwards and folds forward, with a drum at each hinge; gives the last
/// joint and its far end.
pub(crate) fn arm(
    body: &mut Body,
    parent: JointId,
    name: &str,
    root: Vec3,
    joints: usize,
    [length, thick]: [f32; 2],
    dice: &mut Dice,
) -> (JointId, Vec3) {
    let (mut at, mut above, mut rise) = (root, parent, dice.between(55.0, 95.0));
    let square = if dice.chance(0.5) { 1.0 } else { 0.0 };
    for k in 0..joints {
        let part = length * (1.0 - 0.12 * k as f32) / joints as f32;
        let r = thick * (1.0 - 0.14 * k as f32);
        above = body.joint(above, format!("{name}_{}", k + 1), at);
        let end = at + direction(0.0, rise) * part;
        drum(body, above, at, Vec3::X, 1.35 * r, 1.5 * r);
        bar(body, above, at, end, [r, 0.85 * r], square, 0.2);
        (at, rise) = (end, rise - dice.between(20.0, 75.0));
    }
    (above, at)
}

/// A hand of two or three fingers, each on a joint, or a rigid tool.
pub(crate) fn gripper(body: &mut Body, parent: JointId, name: &str, at: Vec3, ahead: Vec3, size: f32, dice: &mut Dice) {
    let hand = body.joint(parent, name, at);
    let side = crate::turn::across(ahead, Vec3::X);
    let up = ahead.cross(side);
    bar(body, hand, at, at + ahead * (0.4 * size), [0.35 * size, 0.42 * size], 1.0, 0.15);
    let fingers = dice.below(4);
    if fingers < 2 {
        return bar(
            body,
            hand,
            at + ahead * (0.4 * size),
            at + ahead * (1.2 * size),
            [0.14 * size, 0.05 * size],
            0.0,
            0.0,
        );
    }
    for k in 0..fingers {
        let (sin, cos) = crate::turn::sin_cos(360.0 * k as f32 / fingers as f32);
        let out = side * cos + up * sin;
        let hinge = at + ahead * (0.42 * size) + out * (0.3 * size);
        let finger = body.joint(hand, format!("{name}_finger_{}", k + 1), hinge);
        let knuckle = hinge + ahead * (0.4 * size) + out * (0.22 * size);
        bar(body, finger, hinge, knuckle, [0.10 * size, 0.09 * size], 1.0, 0.0);
        bar(
            body,
            finger,
            knuckle,
            knuckle + ahead * (0.4 * size) - out * (0.25 * size),
            [0.09 * size, 0.04 * size],
            1.0,
            0.0,
        );
    }
}

/// A leg of two bars and a foot.
pub(crate) fn leg(body: &mut Body, parent: JointId, side: Side, number: &str, hip: Vec3, forward: f32, thick: f32) {
    let name = |part: &str| format!("{part}{number}_{}", side.word().to_lowercase());
    let sole = 0.6 * thick;
    let reach = hip.y - sole;
    let knee = hip + Vec3::new(0.05 * reach, -0.48 * reach, forward * reach);
    let ankle = Vec3::new(hip.x + 0.08 * reach, sole + 0.1 * reach, hip.z - 0.1 * forward * reach);
    let thigh = body.joint(parent, name("thigh"), side.of(hip));
    drum(body, thigh, side.of(hip), Vec3::X, 1.3 * thick, thick);
    bar(body, thigh, side.of(hip), side.of(knee), [thick, 0.8 * thick], 1.0, 0.2);
    let shin = body.joint(thigh, name("shin"), side.of(knee));
    drum(body, shin, side.of(knee), Vec3::X, thick, 0.9 * thick);
    bar(body, shin, side.of(knee), side.of(ankle), [0.8 * thick, 0.65 * thick], 1.0, 0.2);
    let foot = body.joint(shin, name("foot"), side.of(ankle));
    let middle = Vec3::new(ankle.x, 0.5 * ankle.y, ankle.z + 0.6 * thick);
    block(body, foot, side.of(middle), Vec3::new(1.1 * thick, 0.5 * ankle.y, 1.9 * thick), 0.15);
}
