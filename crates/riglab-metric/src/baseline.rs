//! Weights without learning: by distance to the bones.

use rayon::prelude::*;
use riglab_core::{DecodeRule, JointId, Mesh, Rig, RigError, Segment, Skeleton, SkinWeights, Vec3};
use riglab_geom::{BLOCK, Lane};

/// Shares that are kept where some are dropped.
const INFLUENCES: usize = 4;

/// A rule by which distances become weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Baseline {
    /// All to the nearest bone.
    Nearest,
    /// 1 / dᵖ over all bones, divided by their sum.
    Inverse {
        /// p; sharp forms are the better ones.
        power: i32,
    },
    /// The same, four largest kept, those below a cut dropped.
    InverseCut {
        /// p.
        power: i32,
        /// Shares at or below are dropped.
        cut: f32,
    },
}

impl Baseline {
    /// Its name in tables.
    pub fn name(&self) -> String {
        match self {
            Self::Nearest => "nearest bone".into(),
            Self::Inverse { power } => format!("1/d^{power}"),
            Self::InverseCut { power, cut } => format!("1/d^{power}, top 4, cut {cut}"),
        }
    }

    /// Dense weights, a row of `joints` shares a vertex, from [`bone_distances`].
    pub fn weights(&self, distances: &[f32], joints: usize) -> Vec<f32> {
        let mut out = vec![0.0; distances.len()];
        out.par_chunks_exact_mut(joints).zip(distances.par_chunks_exact(joints)).for_each(|(row, d)| self.row(row, d));
        out
    }

    /// A mesh with weights by straight distance to all bones of a skeleton.
    ///
    /// # Errors
    /// When there are more joints than a rig may have.
    pub fn rig(&self, skeleton: Skeleton, mesh: Mesh) -> Result<Rig, RigError> {
        let bones = skeleton.segments();
        let blocks = mesh.positions().par_chunks(BLOCK);
        let rows: Vec<Held> =
            blocks.map_init(Scratch::default, |scratch, points| self.block(points, &bones, scratch)).collect();
        let weights = SkinWeights::normalized(rows.iter().flat_map(Held::rows))?;
        Rig::new(skeleton, mesh, weights)
    }

    /// What the vertices of a block have, by straight distance.
    fn block(&self, points: &[Vec3], bones: &[Vec<Segment>], scratch: &mut Scratch) -> Held {
        let Scratch { rows, kept } = scratch;
        riglab_geom::bone_distances(points, bones, rows);
        // Of each vertex what is kept, by numbers that are larger than `floor` or the largest of all.
        let floor = match *self {
            Self::Nearest => {
                rows.iter_mut().flatten().for_each(|d| *d = -*d);
                f32::INFINITY
            }
            Self::Inverse { power } => {
                inverses(rows, power);
                0.0
            }
            Self::InverseCut { power, cut } => {
                inverses(rows, power);
                cut
            }
        };
        let mut most = [f32::NEG_INFINITY; BLOCK];
        rows.iter().for_each(|row| most.iter_mut().zip(row).for_each(|(most, w)| *most = most.max(*w)));
        kept.resize_with(points.len(), Default::default);
        kept.iter_mut().for_each(|(joints, shares)| {
            joints.clear();
            shares.clear();
        });
        for (joint, row) in (0u16..).zip(&*rows) {
            // Most rows have none: all of a row are compared at once.
            let mut picked = 0u32;
            for (k, (w, most)) in row.iter().zip(&most).enumerate() {
                picked |= u32::from(*w > floor || w == most) << k;
            }
            while picked != 0 {
                let k = picked.trailing_zeros() as usize;
                picked &= picked - 1;
                if let Some((joints, shares)) = kept.get_mut(k) {
                    joints.push(joint);
                    shares.push(row[k]);
                }
            }
        }
        let mut held = Held::default();
        for (joints, shares) in kept {
            match *self {
                // Of equally near ones the first.
                Self::Nearest => shares.iter_mut().enumerate().for_each(|(k, w)| *w = if k == 0 { 1.0 } else { 0.0 }),
                Self::Inverse { .. } => {}
                Self::InverseCut { cut, .. } => DecodeRule { cut, influences: INFLUENCES }.apply(shares),
            }
            let both = joints.iter().zip(shares).filter(|(_, w)| **w > 0.0);
            held.shares.extend(both.map(|(&joint, w)| (joint, f64::from(*w))));
            held.ends.push(held.shares.len());
        }
        held
    }

    fn row(&self, row: &mut [f32], distances: &[f32]) {
        let nearest = (0..distances.len()).min_by(|&a, &b| distances[a].total_cmp(&distances[b]));
        let Some(nearest) = nearest else { return };
        match *self {
            Self::Nearest => row[nearest] = 1.0,
            Self::Inverse { power } => inverse(row, distances, distances[nearest], power),
            Self::InverseCut { power, cut } => {
                inverse(row, distances, distances[nearest], power);
                DecodeRule { cut, influences: INFLUENCES }.apply(row);
            }
        }
    }
}

/// (d_min / d)ᵖ divided by the sum: the ratio keeps large powers finite.
fn inverse(row: &mut [f32], distances: &[f32], smallest: f32, power: i32) {
    let smallest = smallest.max(1e-12);
    for (w, d) in row.iter_mut().zip(distances) {
        *w = (smallest / d.max(1e-12)).powi(power);
    }
    let sum: f32 = row.iter().sum();
    row.iter_mut().for_each(|w| *w /= sum);
}

/// As [`inverse`], of a block of vertices whose distances are given, a row a bone.
fn inverses(rows: &mut [Lane], power: i32) {
    let (mut least, mut sum) = ([f32::INFINITY; BLOCK], [0.0; BLOCK]);
    for row in &*rows {
        least.iter_mut().zip(row).for_each(|(least, d)| *least = least.min(*d));
    }
    for row in rows.iter_mut() {
        row.iter_mut().zip(&least).for_each(|(w, least)| *w = least.max(1e-12) / w.max(1e-12));
        raise(row, power);
        sum.iter_mut().zip(row).for_each(|(sum, w)| *sum += *w);
    }
    rows.iter_mut().for_each(|row| row.iter_mut().zip(&sum).for_each(|(w, sum)| *w /= sum));
}

/// To a power above 0, all at once: `powi` would go one after another.
fn raise(row: &mut Lane, mut power: i32) {
    let (mut square, mut out) = (*row, [1.0; BLOCK]);
    while power > 0 {
        if power % 2 == 1 {
            out.iter_mut().zip(&square).for_each(|(out, x)| *out *= x);
        }
        square.iter_mut().for_each(|x| *x *= *x);
        power /= 2;
    }
    *row = out;
}

/// What [`Baseline::block`] works in.
#[derive(Default)]
struct Scratch {
    /// A row a bone.
    rows: Vec<Lane>,
    /// Of each vertex joints and their shares.
    kept: Vec<(Vec<u16>, Vec<f32>)>,
}

/// What vertices of a block hold, one after another.
#[derive(Default)]
struct Held {
    shares: Vec<(u16, f64)>,
    /// Where the shares of each end.
    ends: Vec<usize>,
}

impl Held {
    /// Joints and shares of each vertex.
    fn rows(&self) -> impl Iterator<Item = impl Iterator<Item = (u16, f64)>> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| self.shares[start..end].iter().copied())
    }
}

/// Distance of every vertex to the bones of `joints`, a row a vertex. A bone is a joint's segments to
/// its children; see [`riglab_core::Skeleton::segments`].
pub fn bone_distances(rig: &Rig, joints: &[JointId]) -> Vec<f32> {
    let segments = rig.skeleton().segments();
    let bones: Vec<Vec<Segment>> = joints.iter().map(|j| segments[j.index()].clone()).collect();
    let m = joints.len().max(1);
    let mut out = vec![0.0; rig.mesh().positions().len() * joints.len()];
    let blocks = out.par_chunks_mut(BLOCK * m).zip(rig.mesh().positions().par_chunks(BLOCK));
    blocks.for_each_init(Vec::new, |rows, (out, points)| {
        riglab_geom::bone_distances(points, &bones, rows);
        for (k, out) in out.chunks_exact_mut(m).enumerate() {
            out.iter_mut().zip(&*rows).for_each(|(d, row)| *d = row[k]);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SkinBaseline;

    /// The rules over straight distances that tables show.
    fn straight() -> impl Iterator<Item = Baseline> {
        SkinBaseline::all().filter_map(|baseline| match baseline {
            SkinBaseline::Straight(rule) => Some(rule),
            _ => None,
        })
    }

    #[test]
    fn weights_follow_distance() {
        let d = [1.0, 2.0, 4.0];
        assert_eq!(Baseline::Nearest.weights(&d, 3), [1.0, 0.0, 0.0]);
        let w = Baseline::Inverse { power: 2 }.weights(&d, 3);
        assert!((w[0] / w[1] - 4.0).abs() < 1e-5 && (w.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        assert_eq!(Baseline::InverseCut { power: 2, cut: 0.1 }.weights(&d, 3), [0.8, 0.2, 0.0]);
    }

    #[test]
    fn a_mesh_has_the_weights_of_its_distances() {
        let joint = |name: &str, parent, head| riglab_core::Joint { name: name.into(), parent, head };
        let joints = vec![
            joint("root", None, [0.0; 3]),
            joint("up", Some(JointId(0)), [0.0, 1.0, 0.0]),
            joint("far", Some(JointId(1)), [4.0, 1.0, 0.0]),
        ];
        let corners = vec![[1.0, 0.0, 0.0], [0.3, 0.9, 0.0], [3.0, 2.0, 1.0], [-1.0, 0.5, 0.0]];
        let mesh = Mesh::new(corners, vec![[0, 1, 2], [0, 3, 1]]).unwrap();
        let skeleton = Skeleton::new(joints).unwrap();
        for rule in straight() {
            let rig = rule.rig(skeleton.clone(), mesh.clone()).unwrap();
            let ids: Vec<JointId> = rig.skeleton().ids().collect();
            let dense = rule.weights(&bone_distances(&rig, &ids), 3);
            for (v, wanted) in dense.chunks(3).enumerate() {
                let mut row = [0.0; 3];
                rig.weights().row(v).for_each(|(j, w)| row[j.index()] = w);
                assert!(row.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?} {wanted:?}");
            }
            let shared = dense.iter().filter(|w| **w > 0.0).count() > 4;
            assert_eq!(shared, rule != Baseline::Nearest, "some vertices are shared");
        }
    }

    #[test]
    fn a_vertex_on_a_bone_is_finite() {
        for b in straight() {
            let w = b.weights(&[0.0, 0.0, 1.0], 3);
            assert!((w.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{}", b.name());
        }
    }
}
