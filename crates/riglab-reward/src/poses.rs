//! Poses to try a rig in.

use glam::{DAffine3, DMat3, DVec3};
use riglab_random::{Draw, stream};

/// The map of each joint from rest to a pose of rotation vectors (axis times angle, in radians) about the
/// joints: forward kinematics, global_parent · T(J - J_parent) · R, after T(-J).
pub fn maps(heads: &[[f64; 3]], parents: &[Option<usize>], rotations: &[[f64; 3]]) -> Vec<DAffine3> {
    let mut maps: Vec<DAffine3> = Vec::with_capacity(heads.len());
    for ((head, parent), turn) in heads.iter().zip(parents).zip(rotations) {
        let (head, matrix) = (DVec3::from(*head), rotation(*turn));
        let local = DAffine3 { matrix3: matrix, translation: head - matrix * head };
        maps.push(parent.map_or(local, |p| maps[p] * local));
    }
    maps
}

/// The matrix of a rotation vector, by Rodrigues' formula; sine and cosine are the same on every machine.
fn rotation(turn: [f64; 3]) -> DMat3 {
    let turn = DVec3::from(turn);
    let angle = turn.length();
    if angle == 0.0 {
        return DMat3::IDENTITY;
    }
    let axis = turn / angle;
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    DMat3::IDENTITY + cross * sin + cross * cross * (1.0 - cos)
}

/// Rotation vectors of each joint for some poses, components uniform within ±`degrees`. The numbers of a pose and a
/// joint depend on the seed and on them alone, so that all candidates of a group move alike.
pub fn random_poses(joints: usize, poses: usize, degrees: f64, seed: u64) -> Vec<Vec<[f64; 3]>> {
    let pose = |pose: usize| {
        let mut random = stream(seed, "reward/pose", &[pose as u64]);
        (0..joints).map(|_| [(); 3].map(|()| (2.0 * f64::from(random.unit()) - 1.0) * degrees.to_radians())).collect()
    };
    (0..poses).map(pose).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn children_follow_and_poses_are_kept() {
        let heads = [[0.0; 3], [1.0, 0.0, 0.0]];
        let quarter = std::f64::consts::FRAC_PI_2;
        let maps = maps(&heads, &[None, Some(0)], &[[0.0, 0.0, quarter], [0.0, 0.0, quarter]]);
        let p = maps[1].transform_point3(DVec3::new(2.0, 0.0, 0.0));
        assert!((p - DVec3::new(-1.0, 1.0, 0.0)).length() < 1e-12, "{p}");
        let (few, many) = (random_poses(2, 5, 30.0, 7), random_poses(9, 5, 30.0, 7));
        assert!(few.iter().zip(&many).all(|(a, b)| a[..] == b[..2]));
        assert!(many.iter().flatten().flatten().all(|x| x.abs() <= std::f64::consts::FRAC_PI_6));
    }
}
