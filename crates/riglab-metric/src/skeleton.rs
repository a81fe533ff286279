//! Distances between skeletons: joints to joints, joints to bones, bones to bones.
//!
//! Half the sum of the two directions, each the mean over its own set of the distance to the nearest point of
//! the other. What points a bone has and in which scale it is measured is the convention's.

use serde::{Deserialize, Serialize};

/// Whose formulas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkeletonConvention {
    /// UniRig: 100 points a bone, its parent end not among them; distances in [-1, 1]³, divided by 2.
    Unirig,
    /// RigNet: a point every 0.005 in the unit cube, both ends.
    Rignet,
}

/// A skeleton as positions in [-1, 1]³ and parents.
#[derive(Clone, Debug, PartialEq)]
pub struct Joints {
    /// J × 3.
    pub positions: Vec<[f64; 3]>,
    /// The root has none.
    pub parents: Vec<Option<usize>>,
}

impl Joints {
    /// Of a skeleton in [-1, 1]³.
    pub fn of(skeleton: &riglab_core::Skeleton) -> Self {
        Self {
            positions: skeleton.heads().iter().map(|p| p.map(f64::from)).collect(),
            parents: skeleton.parents().iter().map(|p| p.map(riglab_core::JointId::index)).collect(),
        }
    }

    fn bones(&self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> + '_ {
        let all = self.positions.iter().zip(&self.parents);
        all.filter_map(|(child, parent)| parent.map(|p| (self.positions[p], *child)))
    }
}

/// Distances of two skeletons, in shares of the cube's edge; NaN where a side has no bone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SkeletonDistances {
    /// Joints to joints.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub j2j: f64,
    /// Joints to bones.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub j2b: f64,
    /// Bones to bones.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub b2b: f64,
}

impl SkeletonConvention {
    /// The distances of a prediction from the truth.
    pub fn distances(self, predicted: &Joints, truth: &Joints) -> SkeletonDistances {
        let scale = |p: &[f64; 3]| match self {
            Self::Unirig => *p,
            Self::Rignet => p.map(|x| x / 2.0),
        };
        let points = |joints: &Joints| joints.positions.iter().map(scale).collect::<Vec<_>>();
        let samples = |joints: &Joints| -> Vec<[f64; 3]> {
            joints.bones().flat_map(|(parent, child)| self.samples(scale(&parent), scale(&child))).collect()
        };
        let (p, g) = (points(predicted), points(truth));
        let (sp, sg) = (samples(predicted), samples(truth));
        let half = match self {
            Self::Unirig => 0.5,
            Self::Rignet => 1.0,
        };
        let both = |a: &[[f64; 3]], b: &[[f64; 3]], c: &[[f64; 3]], d: &[[f64; 3]]| {
            half * (mean_nearest(a, b) + mean_nearest(c, d)) / 2.0
        };
        let mut out = SkeletonDistances { j2j: both(&p, &g, &g, &p), j2b: f64::NAN, b2b: f64::NAN };
        if !sp.is_empty() && !sg.is_empty() {
            (out.j2b, out.b2b) = (both(&p, &sg, &g, &sp), both(&sp, &sg, &sg, &sp));
        } else if self == Self::Unirig {
            // Its code passes such assets over.
            out.j2j = f64::NAN;
        }
        out
    }

    fn samples(self, parent: [f64; 3], child: [f64; 3]) -> Vec<[f64; 3]> {
        let at = |share: f64| std::array::from_fn(|k| child[k] + (parent[k] - child[k]) * share);
        match self {
            Self::Unirig => (0..100).map(|i| at(f64::from(i) / 100.0)).collect(),
            Self::Rignet => {
                let length = (0..3).map(|k| (child[k] - parent[k]).powi(2)).sum::<f64>().sqrt();
                let steps = (length / 0.005).round_ties_even() as usize;
                (0..=steps).map(|i| at(1.0 - i as f64 / steps.max(1) as f64)).collect()
            }
        }
    }
}

/// The mean distance of `from` to the nearest of `to`.
///
/// Sorted along x, so that only neighbours within the best distance so far are looked at.
fn mean_nearest(from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
    if from.is_empty() || to.is_empty() {
        return f64::NAN;
    }
    let mut sorted = to.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let nearest = |p: &[f64; 3]| {
        let squared = |q: &[f64; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>();
        let start = sorted.partition_point(|q| q[0] < p[0]);
        let mut least = f64::INFINITY;
        for q in &sorted[start..] {
            if (q[0] - p[0]).powi(2) >= least {
                break;
            }
            least = least.min(squared(q));
        }
        for q in sorted[..start].iter().rev() {
            if (q[0] - p[0]).powi(2) >= least {
                break;
            }
            least = least.min(squared(q));
        }
        least.sqrt()
    };
    from.iter().map(nearest).sum::<f64>() / from.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_compared_survives_a_file() {
        let none = SkeletonDistances { j2j: f64::NAN, j2b: f64::NAN, b2b: f64::NAN };
        let back: SkeletonDistances = serde_json::from_str(&serde_json::to_string(&none).unwrap()).unwrap();
        assert!(back.j2j.is_nan() && back.j2b.is_nan() && back.b2b.is_nan());
    }

    #[test]
    fn a_shifted_chain_is_off_by_its_shift() {
        let chain = |y: f64| Joints {
            positions: (0..3).map(|k| [f64::from(k) * 0.2, y, 0.0]).collect(),
            parents: vec![None, Some(0), Some(1)],
        };
        let d = SkeletonConvention::Rignet.distances(&chain(0.1), &chain(0.0));
        assert!([d.j2j, d.j2b, d.b2b].iter().all(|x| (x - 0.05).abs() < 1e-9), "{d:?}");
        let single = Joints { positions: vec![[0.0; 3]], parents: vec![None] };
        let d = SkeletonConvention::Rignet.distances(&single, &chain(0.0));
        assert!(d.j2j.is_finite() && d.j2b.is_nan());
        assert!(SkeletonConvention::Unirig.distances(&single, &chain(0.0)).j2j.is_nan());
    }
}
