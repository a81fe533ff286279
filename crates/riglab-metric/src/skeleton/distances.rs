//! Distances between skeletons: joints to joints, joints to bones, bones to bones.
//!
//! Half the sum of the two directions, each the mean over its own set of the distance to the nearest point of
//! the other. What points a bone has and in which scale it is measured is the convention's.

use serde::{Deserialize, Serialize};

use super::Graph;

/// Whose formulas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkeletonConvention {
    /// RigNet: a point every 0.005 in the unit cube, both ends. The tables of SkinTokens are in it, in percent.
    Rignet,
    /// UniRig: 100 points a bone, its parent end not among them; distances in [-1, 1]³, divided by 2.
    Unirig,
    /// MagicArticulate and Puppeteer: as RigNet, after near joints were merged on both sides ([`Graph::merged`]).
    Magicarticulate,
    /// Anymate: as RigNet, but in [-1, 1]³, so that samples are twice as dense and numbers twice those of others.
    Anymate,
    /// The unit cube without sampling: points to segments. Of bones to bones one side still needs points, RigNet's.
    Exact,
}

/// A skeleton as positions in [-1, 1]³ and parents, which are positions of the same list.
#[derive(Clone, Debug, Default, PartialEq)]
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
    /// All, the default one first.
    pub const ALL: [Self; 5] = [Self::Rignet, Self::Unirig, Self::Magicarticulate, Self::Anymate, Self::Exact];

    /// Its name in tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rignet => "rignet",
            Self::Unirig => "unirig",
            Self::Magicarticulate => "magicarticulate",
            Self::Anymate => "anymate",
            Self::Exact => "exact",
        }
    }

    /// The distances of a prediction from the truth. The first joint of the truth is taken for its root.
    pub fn distances(self, predicted: &Joints, truth: &Joints) -> SkeletonDistances {
        let (p, g) = (self.measured(predicted, None), self.measured(truth, Some(0)));
        // UniRig measures in the range of length 2 and divides by it.
        let scale = if self == Self::Unirig { 0.5 } else { 1.0 };
        let both = |a: f64, b: f64| scale * (a + b) / 2.0;
        let mut out = SkeletonDistances {
            j2j: both(mean_nearest(&p.joints, &g.joints), mean_nearest(&g.joints, &p.joints)),
            j2b: f64::NAN,
            b2b: f64::NAN,
        };
        if p.bones.is_empty() || g.bones.is_empty() {
            // RigNet's code keeps the first number and fails at the others, its followers pass such assets over.
            if matches!(self, Self::Unirig | Self::Magicarticulate) {
                out.j2j = f64::NAN;
            }
            return out;
        }
        let (sp, sg) = (self.samples(&p), self.samples(&g));
        (out.j2b, out.b2b) = if self == Self::Exact {
            let near = |from: &[[f64; 3]], to: &Graph| mean_to_bones(from, to);
            (both(near(&p.joints, &g), near(&g.joints, &p)), both(near(&sp, &g), near(&sg, &p)))
        } else {
            let near = mean_nearest;
            (both(near(&p.joints, &sg), near(&g.joints, &sp)), both(near(&sp, &sg), near(&sg, &sp)))
        };
        out
    }

    /// How many joints a prediction and the truth have as this convention counts them.
    pub fn joint_counts(self, predicted: &Joints, truth: &Joints) -> [usize; 2] {
        [self.measured(predicted, None), self.measured(truth, Some(0))].map(|g| g.joints.len())
    }

    /// Joints and bones in the convention's unit.
    fn measured(self, joints: &Joints, root: Option<usize>) -> Graph {
        let mut graph = Graph::of(joints);
        if !matches!(self, Self::Unirig | Self::Anymate) {
            graph.joints.iter_mut().for_each(|p| *p = p.map(|x| x / 2.0));
        }
        if self == Self::Magicarticulate { graph.merged(root.filter(|r| *r < joints.positions.len())) } else { graph }
    }

    /// The points of all bones.
    fn samples(self, graph: &Graph) -> Vec<[f64; 3]> {
        let mut points = Vec::new();
        for [parent, child] in graph.bones.iter().map(|b| b.map(|j| graph.joints[j])) {
            let at = |share: f64| std::array::from_fn(|k| child[k] + (parent[k] - child[k]) * share);
            if self == Self::Unirig {
                points.extend((0..100).map(|i| at(f64::from(i) / 100.0)));
            } else {
                let length = (0..3).map(|k| (child[k] - parent[k]).powi(2)).sum::<f64>().sqrt();
                // No rig is so long in its cube; a broken one must not fill the memory.
                let steps = (length / 0.005).round_ties_even().min(100_000.0) as usize;
                points.extend((0..=steps).map(|i| at(1.0 - i as f64 / steps.max(1) as f64)));
            }
        }
        points
    }
}

/// The mean distance of `from` to the nearest bone.
fn mean_to_bones(from: &[[f64; 3]], to: &Graph) -> f64 {
    let bones: Vec<[[f64; 3]; 2]> = to.bones.iter().map(|b| b.map(|j| to.joints[j])).collect();
    let squared = |p: &[f64; 3], [a, b]: &[[f64; 3]; 2]| {
        let (along, off): ([f64; 3], [f64; 3]) =
            (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| p[k] - a[k]));
        let dot = |x: &[f64; 3], y: &[f64; 3]| (0..3).map(|k| x[k] * y[k]).sum::<f64>();
        let length2 = dot(&along, &along);
        let t = if length2 > 0.0 { (dot(&off, &along) / length2).clamp(0.0, 1.0) } else { 0.0 };
        (0..3).map(|k| (off[k] - t * along[k]).powi(2)).sum::<f64>()
    };
    let nearest = |p: &[f64; 3]| bones.iter().map(|b| squared(p, b)).fold(f64::INFINITY, f64::min).sqrt();
    from.iter().map(nearest).sum::<f64>() / from.len() as f64
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
        let anymate = SkeletonConvention::Anymate.distances(&chain(0.1), &chain(0.0));
        assert!([anymate.j2j, anymate.j2b, anymate.b2b].iter().all(|x| (x - 0.1).abs() < 1e-9), "{anymate:?}");
    }

    #[test]
    fn exact_distances_know_no_steps() {
        // The same segment cut differently; 0.0051 is no multiple of RigNet's step.
        let cut = |at: f64| Joints {
            positions: [0.0, at, 1.0].map(|x| [x, 0.0, 0.0]).to_vec(),
            parents: vec![None, Some(0), Some(1)],
        };
        let (a, b) = (cut(0.3), cut(0.3102));
        let exact = SkeletonConvention::Exact.distances(&a, &b);
        assert!(exact.j2b < 1e-15 && exact.b2b < 1e-15 && exact.j2j > 1e-4, "{exact:?}");
        assert!(SkeletonConvention::Rignet.distances(&a, &b).j2b > 1e-6);
    }
}
