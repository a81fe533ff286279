//! Weights without learning: by distance to the bones.

use rayon::prelude::*;
use riglab_core::{DecodeRule, JointId, Mesh, Rig, RigError, Segment, Skeleton, SkinWeights};

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
    /// Those that reports show: the nearest bone, and inverse distance in its sharp forms, as it is
    /// and with the cuts that were best in validation.
    pub const SHOWN: [Self; 6] = [
        Self::Nearest,
        Self::Inverse { power: 2 },
        Self::Inverse { power: 8 },
        Self::InverseCut { power: 2, cut: 0.15 },
        Self::InverseCut { power: 4, cut: 0.15 },
        Self::InverseCut { power: 16, cut: 0.05 },
    ];

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
        let of_vertex = |distances: &mut Vec<f32>, p: &[f32; 3]| {
            distances.clear();
            distances.extend(bones.iter().map(|bone| Segment::nearest_of(bone, *p).1));
            let row = (0u16..).zip(self.weights_of(distances));
            row.filter(|(_, w)| *w > 0.0).map(|(j, w)| (j, f64::from(w))).collect::<Vec<_>>()
        };
        let rows: Vec<_> = mesh.positions().par_iter().map_init(Vec::new, of_vertex).collect();
        let weights = SkinWeights::normalized(rows)?;
        Rig::new(skeleton, mesh, weights)
    }

    /// Weights of one vertex.
    pub(crate) fn weights_of(&self, distances: &[f32]) -> Vec<f32> {
        let mut row = vec![0.0; distances.len()];
        self.row(&mut row, distances);
        row
    }

    fn row(&self, row: &mut [f32], distances: &[f32]) {
        let nearest = (0..distances.len()).min_by(|&a, &b| distances[a].total_cmp(&distances[b]));
        let Some(nearest) = nearest else { return };
        match *self {
            Self::Nearest => row[nearest] = 1.0,
            Self::Inverse { power } => inverse(row, distances, distances[nearest], power),
            Self::InverseCut { power, cut } => {
                inverse(row, distances, distances[nearest], power);
                DecodeRule { cut, influences: 4 }.apply(row);
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

/// Distance of every vertex to the bones of `joints`, a row a vertex. A bone is a joint's segments to
/// its children; see [`riglab_core::Skeleton::segments`].
pub fn bone_distances(rig: &Rig, joints: &[JointId]) -> Vec<f32> {
    let segments = rig.skeleton().segments();
    let bones: Vec<&[Segment]> = joints.iter().map(|j| segments[j.index()].as_slice()).collect();
    let mut out = vec![0.0; rig.mesh().positions().len() * joints.len()];
    out.par_chunks_exact_mut(joints.len().max(1)).zip(rig.mesh().positions()).for_each(|(row, &p)| {
        for (d, bone) in row.iter_mut().zip(&bones) {
            *d = Segment::nearest_of(bone, p).1;
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let rule = Baseline::InverseCut { power: 4, cut: 0.15 };
        let rig = rule.rig(Skeleton::new(joints).unwrap(), mesh).unwrap();
        let ids: Vec<JointId> = rig.skeleton().ids().collect();
        let dense = rule.weights(&bone_distances(&rig, &ids), 3);
        for (v, wanted) in dense.chunks(3).enumerate() {
            let mut row = [0.0; 3];
            rig.weights().row(v).for_each(|(j, w)| row[j.index()] = w);
            assert!(row.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?} {wanted:?}");
        }
        assert!(dense.iter().filter(|w| **w > 0.0).count() > 4, "some vertices are shared");
    }

    #[test]
    fn a_vertex_on_a_bone_is_finite() {
        for b in Baseline::SHOWN {
            let w = b.weights(&[0.0, 0.0, 1.0], 3);
            assert!((w.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{}", b.name());
        }
    }
}
