//! How far vertices are off once the rig moves.

use glam::{DAffine3, DMat3, DVec3};
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};

use crate::{Joints, Rows};

/// Poses that weights are tried in.
const POSES: usize = 10;
/// Largest turn of each component of a rotation vector.
const DEGREES: f64 = 30.0;
/// What UniRig adds to a vertex' sum of weights.
const EPSILON: f64 = 1e-8;

/// Distances between vertices posed with true and with predicted weights, in units of the coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Mean over poses and vertices: the motion loss of SkinTokens' tables as riglab reads it.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub mean: f64,
    /// The largest of all.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub max: f64,
    /// Mean over poses of the largest of a pose: RigNet's.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub mean_max: f64,
    /// Mean square over coordinates: UniRig's vertex loss.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub mse: f64,
    /// Root of the mean squared distance.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub rms: f64,
}

impl Motion {
    /// Names and values, in the order of the fields.
    pub fn figures(&self) -> crate::Figures {
        vec![
            ("motion", self.mean),
            ("motion_max", self.max),
            ("motion_mean_max", self.mean_max),
            ("motion_mse", self.mse),
            ("motion_rms", self.rms),
        ]
    }
}

/// Local rotations of each joint for some poses.
pub type Poses = Vec<Vec<DMat3>>;

/// The poses that an asset is tried in: 10, each component of each joint's rotation vector uniform within ±30
/// degrees, the root at rest. They hang on the asset's name alone, so that every method meets the same.
pub fn motion_poses(asset: &str, parents: &[Option<usize>]) -> Poses {
    // FNV-1a: the name to a number.
    let seed = asset.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    let pose = |pose: usize| {
        let mut random = stream(seed, "metric/motion", &[pose as u64]);
        let turn = |parent: &Option<usize>| {
            let vector = [(); 3].map(|()| (2.0 * f64::from(random.unit()) - 1.0) * DEGREES.to_radians());
            if parent.is_some() { rotation(vector) } else { DMat3::IDENTITY }
        };
        parents.iter().map(turn).collect()
    };
    (0..POSES).map(pose).collect()
}

/// The matrix of a rotation vector (axis times angle in radians); sine and cosine are the same on every machine.
fn rotation(vector: [f64; 3]) -> DMat3 {
    let vector = DVec3::from(vector);
    let angle = vector.length();
    if angle == 0.0 {
        return DMat3::IDENTITY;
    }
    let (sin, cos) = libm::sincos(angle);
    let [x, y, z] = (vector / angle).to_array();
    let cross = DMat3::from_cols(DVec3::new(0.0, z, -y), DVec3::new(-z, 0.0, x), DVec3::new(y, -x, 0.0));
    DMat3::IDENTITY + cross * sin + cross * cross * (1.0 - cos)
}

/// Where vertices go in a pose: `global_i = global_parent · T(j_i - j_parent) · R_i`, a vertex is
/// `Σ w_i global_i T(-j_i) v / (Σ w_i + 1e-8)`. Weights need not sum to 1; a vertex without any goes to the origin.
/// Parents come first; a pose that is too short leaves the joints beyond it at rest.
pub fn posed(vertices: &[[f64; 3]], joints: &Joints, pose: &[DMat3], weights: &Rows) -> Vec<[f64; 3]> {
    let mut maps: Vec<DAffine3> = Vec::with_capacity(joints.positions.len());
    for (j, (head, parent)) in joints.positions.iter().zip(&joints.parents).enumerate() {
        let (head, turn) = (DVec3::from(*head), pose.get(j).copied().unwrap_or(DMat3::IDENTITY));
        let local = DAffine3 { matrix3: turn, translation: head - turn * head };
        maps.push(parent.and_then(|p| maps.get(p)).map_or(local, |above| *above * local));
    }
    let image = |(v, row): (&[f64; 3], &[(u32, f32)])| {
        let v = DVec3::from(*v);
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for (map, w) in row.iter().filter_map(|(j, w)| Some((maps.get(*j as usize)?, f64::from(*w)))) {
            sum += w * map.transform_point3(v);
            total += w;
        }
        (sum / (total + EPSILON)).to_array()
    };
    vertices.iter().zip(weights.iter()).map(image).collect()
}

/// The distances over some poses; NaN without poses or vertices.
pub fn motion(vertices: &[[f64; 3]], joints: &Joints, poses: &Poses, truth: &Rows, predicted: &Rows) -> Motion {
    let (mut sum, mut max, mut maxima, mut squares, mut count) = (0.0, 0.0f64, 0.0, 0.0, 0u64);
    for pose in poses {
        let (a, b) = (posed(vertices, joints, pose, truth), posed(vertices, joints, pose, predicted));
        let mut largest = 0.0f64;
        for (a, b) in a.iter().zip(&b) {
            let squared = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
            sum += squared.sqrt();
            squares += squared;
            largest = largest.max(squared.sqrt());
            count += 1;
        }
        max = max.max(largest);
        maxima += largest;
    }
    let n = count as f64;
    Motion {
        mean: sum / n,
        max: if count > 0 { max } else { f64::NAN },
        mean_max: if count > 0 { maxima / poses.len() as f64 } else { f64::NAN },
        mse: squares / (3.0 * n),
        rms: (squares / n).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm() -> Joints {
        Joints { positions: vec![[0.0; 3], [1.0, 0.0, 0.0]], parents: vec![None, Some(0)] }
    }

    #[test]
    fn only_what_moves_is_off() {
        let vertices = [[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        let truth = Rows::dense(&[1.0, 0.0, 0.5, 0.5, 0.0, 1.0], 2);
        let rigid = Rows::dense(&[1.0, 0.0, 1.0, 0.0, 1.0, 0.0], 2);
        let poses = motion_poses("a", &arm().parents);
        assert_eq!((poses.len(), poses[0][0]), (POSES, DMat3::IDENTITY));
        // The first is held by the resting root, the second is the elbow itself: only the third moves.
        let off = motion(&vertices, &arm(), &poses, &truth, &rigid);
        assert!(off.mean > 0.01 && off.max > off.mean_max && off.mean_max > off.mean, "{off:?}");
        let same = motion(&vertices, &arm(), &poses, &truth, &truth);
        assert_eq!((same.mean, same.max), (0.0, 0.0));
        assert!(motion(&[], &arm(), &poses, &truth, &truth).mean.is_nan());
    }

    #[test]
    fn a_quarter_turn_of_the_elbow() {
        let quarter = rotation([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let weights = Rows::dense(&[0.0, 3.0, 0.0, 0.0], 2);
        let at = posed(&[[2.0, 0.0, 0.0], [2.0, 0.0, 0.0]], &arm(), &[DMat3::IDENTITY, quarter], &weights);
        assert!((0..3).all(|k| (at[0][k] - [1.0, 1.0, 0.0][k]).abs() < 1e-7), "{at:?}");
        assert_eq!(at[1], [0.0; 3]);
    }

    #[test]
    fn poses_hang_on_the_name() {
        let of = |name| motion_poses(name, &arm().parents);
        assert_eq!(of("fox"), of("fox"));
        assert_ne!(of("fox"), of("wolf"));
    }
}
