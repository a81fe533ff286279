//! How far vertices are off once the rig moves.

use glam::{DAffine3, DMat3, DVec3};
use riglab_core::Clip;
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};

use crate::rows::both;
use crate::{Joints, Rows};

/// Poses that weights are tried in.
const POSES: usize = 10;
/// Largest turn of each component of a rotation vector.
const DEGREES: f64 = 30.0;
/// What UniRig adds to a vertex' sum of weights.
const EPSILON: f64 = 1e-8;
/// Frames that weights are tried in of an asset's clips, where they have as many.
const FRAMES: usize = 30;
/// Poses that are worked on at once, so that the compiler takes several in an instruction.
const LANES: usize = POSES;

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
    /// Of sums over frames and vertices of distances and their squares, over frames of the largest, and the largest.
    fn of_sums(frames: usize, vertices: usize, [sum, squares, maxima, max]: [f64; 4]) -> Self {
        let n = (frames * vertices) as f64;
        Self {
            mean: sum / n,
            max: if n > 0.0 { max } else { f64::NAN },
            mean_max: if n > 0.0 { maxima / frames as f64 } else { f64::NAN },
            mse: squares / (3.0 * n),
            rms: (squares / n).sqrt(),
        }
    }

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
    let maps = maps(joints, pose);
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

/// The motion of each joint's surroundings in a pose.
fn maps(joints: &Joints, pose: &[DMat3]) -> Vec<DAffine3> {
    let mut maps: Vec<DAffine3> = Vec::with_capacity(joints.positions.len());
    for (j, (head, parent)) in joints.positions.iter().zip(&joints.parents).enumerate() {
        let (head, turn) = (DVec3::from(*head), pose.get(j).copied().unwrap_or(DMat3::IDENTITY));
        let local = DAffine3 { matrix3: turn, translation: head - turn * head };
        maps.push(parent.and_then(|p| maps.get(p)).map_or(local, |above| *above * local));
    }
    maps
}

/// For each frame the map of every joint's surroundings from rest to pose.
pub type Frames = Vec<Vec<DAffine3>>;

/// Frames of an asset's own clips, for [`motion_of_frames`]: at most 30, evenly spaced over all of them laid end to
/// end, so that long clips have more. `scale` and `shift` take the asset's coordinates to those of the vertices:
/// `p -> scale · p + shift`.
pub fn clip_frames(clips: &[Clip], scale: f64, shift: [f64; 3]) -> Frames {
    let shift = DVec3::from(shift);
    let all: Vec<(&Clip, usize)> = clips.iter().flat_map(|clip| (0..clip.frames()).map(move |f| (clip, f))).collect();
    let taken = all.len().min(FRAMES);
    let frame = |k: usize| {
        // The middles of equal stretches.
        let (clip, frame) = all[(2 * k + 1) * all.len() / (2 * taken)];
        let map = |map: &[riglab_core::Vec3; 4]| {
            let [x, y, z, t] = map.map(|column| DVec3::from(column.map(f64::from)));
            // s (A p + t) + d, of p = (q - d) / s, is A q + s t + d - A d.
            let matrix3 = DMat3::from_cols(x, y, z);
            DAffine3 { matrix3, translation: scale * t + shift - matrix3 * shift }
        };
        clip.maps()[frame * clip.joints()..][..clip.joints()].iter().map(map).collect()
    };
    (0..taken).map(frame).collect()
}

/// The distances over some poses; NaN without poses or vertices.
pub fn motion(vertices: &[[f64; 3]], joints: &Joints, poses: &Poses, truth: &Rows, predicted: &Rows) -> Motion {
    let frames = frames_of(joints, poses);
    let shares = Shares::new(joints.positions.len().min(joints.parents.len()), truth, predicted);
    moved(vertices, &frames, &shares)
}

/// The distances over some frames, such as [`clip_frames`] of the asset's own clips: the reconstruction of real motion.
/// Frames map the same joints, columns of the weights beyond them move nothing; NaN without frames or vertices.
pub fn motion_of_frames(vertices: &[[f64; 3]], frames: &Frames, truth: &Rows, predicted: &Rows) -> Motion {
    let known = frames.iter().map(Vec::len).min().unwrap_or(0);
    moved(vertices, frames, &Shares::new(known, truth, predicted))
}

fn moved(vertices: &[[f64; 3]], frames: &Frames, shares: &Shares) -> Motion {
    let (mut sum, mut max, mut maxima, mut squares) = (0.0, 0.0f64, 0.0, 0.0);
    let vertices = &vertices[..vertices.len().min(shares.offsets.len() - 1)];
    for together in frames.chunks(LANES) {
        let maps = lanes(together);
        let (mut sums, mut largest) = ([[0.0; LANES]; 2], [0.0f64; LANES]);
        for (v, shares) in vertices.iter().zip(shares.rows()) {
            let squared = apart2(*v, shares, &maps);
            for l in 0..LANES {
                let distance = squared[l].sqrt();
                sums[0][l] += distance;
                sums[1][l] += squared[l];
                largest[l] = largest[l].max(distance);
            }
        }
        for l in 0..together.len() {
            sum += sums[0][l];
            squares += sums[1][l];
            max = max.max(largest[l]);
            maxima += largest[l];
        }
    }
    Motion::of_sums(frames.len(), vertices.len(), [sum, squares, maxima, max])
}

/// The maps of joints in poses.
pub(crate) fn frames_of(joints: &Joints, poses: &Poses) -> Frames {
    poses.iter().map(|pose| maps(joints, pose)).collect()
}

/// The farthest that any weights put vertices in these frames: of a mean over weighted maps no point is farther off than
/// one of the maps puts it, or the origin, where one without weights is. Means are over the worst of each vertex,
/// `mean_max` over the worst of each frame.
pub(crate) fn farthest_motion(vertices: &[[f64; 3]], frames: &Frames, truth: &Rows) -> Motion {
    let known = frames.iter().map(Vec::len).min().unwrap_or(0);
    let vertices = &vertices[..vertices.len().min(truth.len())];
    let (mut sum, mut squares, mut largest) = (0.0, 0.0, vec![0.0f64; frames.len()]);
    for (v, row) in vertices.iter().zip(truth.iter()) {
        let v = DVec3::from(*v);
        let total =
            row.iter().filter(|(j, _)| (*j as usize) < known).map(|(_, w)| f64::from(*w)).sum::<f64>() + EPSILON;
        let shares = || row.iter().filter(|(j, _)| (*j as usize) < known);
        let own = |frame: &Vec<DAffine3>| {
            shares().map(|(j, w)| f64::from(*w) / total * frame[*j as usize].transform_point3(v)).sum::<DVec3>()
        };
        let own: Vec<DVec3> = frames.iter().map(own).collect();
        let (mut far, mut far2) = (0.0f64, 0.0f64);
        for bone in (0..known).map(Some).chain([None]) {
            let (mut distances, mut squared) = (0.0, 0.0);
            for ((frame, own), largest) in frames.iter().zip(&own).zip(&mut largest) {
                let d2 = own.distance_squared(bone.map_or(DVec3::ZERO, |j| frame[j].transform_point3(v)));
                let d = d2.sqrt();
                (distances, squared) = (distances + d, squared + d2);
                *largest = largest.max(d);
            }
            (far, far2) = (far.max(distances), far2.max(squared));
        }
        (sum, squares) = (sum + far, squares + far2);
    }
    let max = largest.iter().copied().fold(0.0, f64::max);
    Motion::of_sums(frames.len(), vertices.len(), [sum, squares, largest.iter().sum(), max])
}

/// A row of a map has three numbers that are multiplied by the coordinates and one that is added; each for some
/// poses.
type Lanes = [[[f64; LANES]; 4]; 3];

/// The maps of some frames, no more than there are lanes, side by side.
fn lanes(frames: &[Vec<DAffine3>]) -> Vec<Lanes> {
    let mut out = vec![Lanes::default(); frames.iter().map(Vec::len).max().unwrap_or(0)];
    for (l, frame) in frames.iter().enumerate() {
        for (out, map) in out.iter_mut().zip(frame) {
            for (column, numbers) in map.to_cols_array_2d().into_iter().enumerate() {
                (0..3).for_each(|row| out[row][column][l] = numbers[row]);
            }
        }
    }
    out
}

/// Squared distances between a vertex posed with true and with predicted weights, in some poses.
#[inline(always)]
fn apart2(vertex: [f64; 3], shares: &[(usize, f64)], maps: &[Lanes]) -> [f64; LANES] {
    let mut apart = [[0.0; LANES]; 3];
    for &(joint, share) in shares {
        for (apart, [x, y, z, t]) in apart.iter_mut().zip(&maps[joint]) {
            for l in 0..LANES {
                apart[l] += share * (x[l] * vertex[0] + y[l] * vertex[1] + z[l] * vertex[2] + t[l]);
            }
        }
    }
    let [x, y, z] = apart;
    std::array::from_fn(|l| x[l] * x[l] + y[l] * y[l] + z[l] * z[l])
}

/// By how much each joint's share in a vertex is off: the posed vertices are as far apart as what these shares of
/// the joints' maps make of the vertex. Shares are weights divided by their sum, as in [`posed`].
struct Shares {
    offsets: Vec<usize>,
    entries: Vec<(usize, f64)>,
}

impl Shares {
    /// Of the first `known` joints.
    fn new(known: usize, truth: &Rows, predicted: &Rows) -> Self {
        let total = |row: &[(u32, f32)]| {
            row.iter().filter(|(j, _)| (*j as usize) < known).map(|(_, w)| f64::from(*w)).sum::<f64>() + EPSILON
        };
        let mut out = Self { offsets: vec![0], entries: Vec::new() };
        for (w, p) in truth.iter().zip(predicted.iter()) {
            let totals = [total(w), total(p)];
            both(w, p, |joint, w, p| {
                if joint < known {
                    out.entries.push((joint, f64::from(w) / totals[0] - f64::from(p) / totals[1]));
                }
            });
            out.offsets.push(out.entries.len());
        }
        out
    }

    fn rows(&self) -> impl Iterator<Item = &[(usize, f64)]> {
        self.offsets.windows(2).map(|ends| &self.entries[ends[0]..ends[1]])
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
    fn motion_is_what_posing_both_and_comparing_finds() {
        let mut random = stream(7, "test", &[]);
        let mut unit = || f64::from(random.unit());
        let joints = Joints {
            positions: (0..6).map(|_| [(); 3].map(|()| unit())).collect(),
            parents: [None, Some(0), Some(1), Some(1), Some(0), Some(4)].to_vec(),
        };
        let vertices: Vec<[f64; 3]> = (0..50).map(|_| [(); 3].map(|()| unit())).collect();
        // Rows are not normalised, some are empty; the last column is no joint's.
        let mut weights =
            || Rows::dense(&(0..50 * 7).map(|_| (unit() * 2.0 - 1.2).max(0.0) as f32).collect::<Vec<_>>(), 7);
        let (truth, predicted) = (weights(), weights());
        // One pose more than are worked on at once, and one that is too short.
        let mut poses = motion_poses("a", &joints.parents);
        poses.push(poses[0][..3].to_vec());
        let off = |pose: &Vec<DMat3>| -> Vec<f64> {
            let [a, b] = [&truth, &predicted].map(|weights| posed(&vertices, &joints, pose, weights));
            a.iter().zip(&b).map(|(a, b)| DVec3::from(*a).distance(DVec3::from(*b))).collect()
        };
        let all: Vec<Vec<f64>> = poses.iter().map(off).collect();
        let n = (all.len() * vertices.len()) as f64;
        let largest = |of: &[f64]| of.iter().fold(0.0, |a: f64, b| a.max(*b));
        let squares = all.as_slice().concat().iter().map(|d| d * d).sum::<f64>();
        let want = [
            all.concat().iter().sum::<f64>() / n,
            largest(&all.concat()),
            all.iter().map(|d| largest(d)).sum::<f64>() / all.len() as f64,
            squares / (3.0 * n),
            (squares / n).sqrt(),
        ];
        let got = motion(&vertices, &joints, &poses, &truth, &predicted).figures();
        assert!(got.iter().zip(want).all(|((_, g), w)| (g - w).abs() < 1e-13), "{got:?} {want:?}");
    }

    #[test]
    fn a_clip_in_other_units_moves_vertices_as_its_frames_do() {
        // The elbow at x = 12 of a rig of twice the size that stands at x = 10 turns by a quarter in the last frame.
        const STILL: [[f32; 3]; 4] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
        let turned = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [12.0, -12.0, 0.0]];
        let clip = Clip::new("nod".into(), 30.0, 2, vec![STILL, STILL, STILL, turned]).unwrap();
        let frames = clip_frames(&[clip], 0.5, [-5.0, 0.0, 0.0]);
        assert_eq!((frames.len(), frames[0][1]), (2, DAffine3::IDENTITY));
        // In the cube of `arm` the elbow is at x = 1.
        let quarter = rotation([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let poses = vec![vec![DMat3::IDENTITY; 2], vec![DMat3::IDENTITY, quarter]];
        let vertices = [[0.5, 0.0, 0.0], [1.5, 0.0, 0.3], [2.0, 0.0, 0.0]];
        let truth = Rows::dense(&[1.0, 0.0, 0.5, 0.5, 0.0, 1.0], 2);
        let rigid = Rows::dense(&[1.0, 0.0, 1.0, 0.0, 1.0, 0.0], 2);
        let want = motion(&vertices, &arm(), &poses, &truth, &rigid).figures();
        let got = motion_of_frames(&vertices, &frames, &truth, &rigid).figures();
        assert!(got.iter().zip(want).all(|((_, g), (_, w))| (g - w).abs() < 1e-12 && *g > 0.0), "{got:?}");
        assert!(motion_of_frames(&vertices, &Frames::new(), &truth, &rigid).mean.is_nan());
    }

    #[test]
    fn frames_are_spread_over_all_clips() {
        // Frame f of both clips shifts by f along x: clip 0 has 10 frames, clip 1 has 110.
        let clip = |frames: usize| {
            let map = |f: usize| [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [f as f32, 0.0, 0.0]];
            Clip::new(String::new(), 30.0, 1, (0..frames).map(map).collect()).unwrap()
        };
        let at =
            |clips: &[Clip]| clip_frames(clips, 1.0, [0.0; 3]).iter().map(|f| f[0].translation.x).collect::<Vec<_>>();
        let both = at(&[clip(10), clip(110)]);
        assert_eq!((both.len(), &both[..4], both[29]), (FRAMES, &[2.0, 6.0, 0.0, 4.0][..], 108.0));
        assert_eq!(at(&[clip(3)]), [0.0, 1.0, 2.0]);
        assert!(clip_frames(&[], 1.0, [0.0; 3]).is_empty());
    }

    #[test]
    fn poses_hang_on_the_name() {
        let of = |name| motion_poses(name, &arm().parents);
        assert_eq!(of("fox"), of("fox"));
        assert_ne!(of("fox"), of("wolf"));
    }
}
