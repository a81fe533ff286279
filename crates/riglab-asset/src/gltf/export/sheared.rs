//! Maps of joints that no node can be: a node scales, then turns, then moves, and what shears besides is left out.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use crate::Reading;

/// What is off by less, as a share of the model's size, is not told.
const TOLD: f64 = 1e-3;

/// Entries of maps that differ by less, as a share of the largest, are the same.
const SAME: f64 = 1e-9;

/// Rounds of fitting a turn to scales and scales to the turn, and of finding a turn: both settle in a few.
const ROUNDS: usize = 20;

/// Scale, turn and place of the node that is nearest to a map, by the squares of what its entries are off. They are the
/// map's own where it does not shear.
pub(super) fn nearest(map: &DAffine3) -> (DVec3, DQuat, DVec3) {
    let (scale, turn, place) = map.to_scale_rotation_translation();
    let matrix = map.matrix3;
    let off = |turn: DMat3, scale: DVec3| matrix - turn * DMat3::from_diagonal(scale);
    let size = |m: DMat3| m.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    let read = off(DMat3::from_quat(turn.normalize()), scale);
    if size(read) <= SAME * size(matrix) {
        return (scale, turn, place);
    }
    let side = if matrix.determinant() < 0.0 { -1.0 } else { 1.0 };
    let mut scale = side * DVec3::new(matrix.x_axis.length(), matrix.y_axis.length(), matrix.z_axis.length());
    let mut fitted = None;
    for _ in 0..ROUNDS {
        let Some(turn) = nearest_turn(matrix * DMat3::from_diagonal(scale)) else { break };
        let turned = turn.transpose() * matrix;
        scale = DVec3::new(turned.x_axis.x, turned.y_axis.y, turned.z_axis.z);
        fitted = Some((scale, turn));
    }
    match fitted {
        Some((scale, turn)) => (scale, DQuat::from_mat3(&turn), place),
        // It is flat.
        None => map.to_scale_rotation_translation(),
    }
}

/// The rotation nearest to a matrix that turns nothing inside out, the first factor of its polar decomposition, by Newton's
/// iteration with Higham's scaling by the determinant; `None` where it is flat.
fn nearest_turn(matrix: DMat3) -> Option<DMat3> {
    let mut turn = matrix;
    for _ in 0..ROUNDS {
        let scaled = turn * turn.determinant().cbrt().recip();
        let next = (scaled + scaled.inverse().transpose()) * 0.5;
        let settled = next.abs_diff_eq(turn, 1e-14);
        turn = next;
        if settled {
            break;
        }
    }
    (turn * turn.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-9).then_some(turn)
}

/// How far vertices are, over a motion, from where maps of joints take them.
pub(super) struct Drift<'a> {
    reading: &'a Reading,
    /// The motion's joint of each of the reading's.
    joint_of: &'a [usize],
    /// The smallest and the largest corner around what each of the motion's joints holds any of.
    boxes: Vec<Option<(Vec3, Vec3)>>,
    /// The model's.
    size: f64,
    most: f64,
}

impl<'a> Drift<'a> {
    pub(super) fn new(reading: &'a Reading, joint_of: &'a [usize], joints: usize) -> Self {
        let mut boxes: Vec<Option<(Vec3, Vec3)>> = vec![None; joints];
        let mut all: Option<(Vec3, Vec3)> = None;
        let with = |own: &mut Option<(Vec3, Vec3)>, p: Vec3| {
            *own = Some(own.map_or((p, p), |(low, high)| (low.min(p), high.max(p))));
        };
        for set in &reading.vertex_sets {
            for (vertex, position) in set.positions.iter().enumerate() {
                let position = Vec3::from(*position);
                with(&mut all, position);
                for (joint, _) in set.weights.iter().flat_map(|weights| weights.row(vertex)) {
                    with(&mut boxes[joint_of[usize::from(joint.0)]], position);
                }
            }
        }
        let size = all.map_or(0.0, |(low, high)| f64::from((high - low).length()));
        Self { reading, joint_of, boxes, size, most: 0.0 }
    }

    /// Looks at a frame, of which is known what each joint's map is off.
    pub(super) fn frame(&mut self, off: &[DAffine3]) {
        // No vertex is farther off than the farthest corner of a joint that holds it.
        let farthest = off.iter().zip(&self.boxes).filter_map(|(off, own)| {
            let (low, high) = (*own)?;
            let corner = |bits: usize| {
                Vec3::from_array(std::array::from_fn(|axis| if bits >> axis & 1 == 0 { low[axis] } else { high[axis] }))
            };
            Some((0..8).map(|bits| moved(off, corner(bits))).fold(0.0, |most: f64, by| most.max(by.length())))
        });
        if farthest.fold(0.0, f64::max) <= self.most.max(TOLD * self.size) {
            return;
        }
        for set in &self.reading.vertex_sets {
            let Some(weights) = &set.weights else { continue };
            for (vertex, position) in set.positions.iter().enumerate() {
                let by = weights.row(vertex).map(|(joint, weight)| {
                    f64::from(weight) * moved(&off[self.joint_of[usize::from(joint.0)]], Vec3::from(*position))
                });
                self.most = self.most.max(by.sum::<DVec3>().length());
            }
        }
    }

    /// How far vertices are off at most, as a share of the model's size, where that is to be told.
    pub(super) fn told(&self) -> Option<f64> {
        let share = self.most / self.size;
        (share > TOLD).then_some(share)
    }
}

fn moved(off: &DAffine3, point: Vec3) -> DVec3 {
    off.transform_point3(point.as_dvec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn off(map: &DMat3, scale: DVec3, turn: DQuat) -> f64 {
        let left = *map - DMat3::from_quat(turn) * DMat3::from_diagonal(scale);
        left.to_cols_array().iter().map(|x| x * x).sum()
    }

    #[test]
    fn what_does_not_shear_is_itself() {
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, -0.8), 2.0);
        for scale in [DVec3::ONE, DVec3::new(1.0, 5.0, 0.2), DVec3::new(-1.0, 5.0, 2.0)] {
            let map = DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(1.0, 2.0, 3.0));
            let (s, r, t) = nearest(&map);
            assert!(DAffine3::from_scale_rotation_translation(s, r, t).abs_diff_eq(map, 1e-12), "{scale}");
            assert_eq!((s, r, t), map.to_scale_rotation_translation());
        }
    }

    #[test]
    fn what_is_nearly_flat_has_a_turn() {
        let below = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(0.6, 0.0, -0.8), 1.1));
        let map = DMat3::from_diagonal(DVec3::new(1e-7, 1.0, 1e-7)) * below;
        let (scale, turn, _) = nearest(&DAffine3::from_mat3(map));
        assert!((turn.length() - 1.0).abs() < 1e-9 && scale.length() < 2.0, "{scale} {turn}");
        assert!(off(&map, scale, turn) < off(&map, DVec3::ZERO, turn));
    }

    #[test]
    fn no_other_turn_and_scale_is_nearer() {
        let below = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(0.6, 0.0, -0.8), 1.1));
        for uneven in [DVec3::new(1.0, 2.0, 0.7), DVec3::new(-1.0, 2.0, 0.7)] {
            let map = DMat3::from_diagonal(uneven) * below;
            let (scale, turn, place) = nearest(&DAffine3 { matrix3: map, translation: DVec3::X });
            let own = off(&map, scale, turn);
            assert!(own < off(&map, DVec3::splat(scale.x.signum()), turn) && place == DVec3::X);
            let read = DAffine3::from_mat3(map).to_scale_rotation_translation();
            assert!(own < 0.9 * off(&map, read.0, read.1.normalize()), "{own}");
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                for by in [-1e-3, 1e-3] {
                    assert!(own < off(&map, scale + by * axis, turn), "{axis} {by}");
                    assert!(own < off(&map, scale, turn * DQuat::from_axis_angle(axis, by)), "{axis} {by}");
                }
            }
        }
    }
}
