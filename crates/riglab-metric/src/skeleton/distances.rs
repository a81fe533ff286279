//! Distances between skeletons: joints to joints, joints to bones, bones to bones.
//!
//! Half the sum of the two directions, each the mean over its own set of the distance to the nearest point of
//! the other. What points a bone has and in which scale it is measured is the convention's.

use serde::{Deserialize, Serialize};

use super::Graph;
use super::bone::{Bones, Cut};

/// Whose formulas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkeletonConvention {
    /// RigNet: a point every 0.005 in the unit cube, both ends. The tables of SkinTokens are in it, in percent.
    Rignet,
    /// UniRig: 100 points a bone, its parent end not among them; distances in [-1, 1]³, divided by 2.
    Unirig,
    /// MagicArticulate and Puppeteer: as RigNet, after near joints were merged on both sides ([`Graph::merged`]). Their
    /// files have true joints cut off at the cube's sides; here they are measured where they are.
    Magicarticulate,
    /// Anymate: as RigNet, but in [-1, 1]³, so that samples are twice as dense and numbers twice those of others.
    Anymate,
    /// The unit cube without sampling: points to segments. Of bones to bones one side still needs points, RigNet's.
    Exact,
}

/// A skeleton as positions in [-1, 1]³ and parents, which are positions of the same list.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
        let (bp, bg) = (self.bones(&p), self.bones(&g));
        out.j2b = both(bg.mean_apart(&p.joints), bp.mean_apart(&g.joints));
        out.b2b = both(bg.mean_apart_of(&bp), bp.mean_apart_of(&bg));
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

    /// The bones with their points.
    fn bones(self, graph: &Graph) -> Bones {
        let cut = if self == Self::Unirig { Cut::Into(100) } else { Cut::Every(0.005) };
        Bones::new(graph.bones.iter().map(|b| b.map(|j| graph.joints[j])), cut, self == Self::Exact)
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
        let anymate = SkeletonConvention::Anymate.distances(&chain(0.1), &chain(0.0));
        assert!([anymate.j2j, anymate.j2b, anymate.b2b].iter().all(|x| (x - 0.1).abs() < 1e-9), "{anymate:?}");
    }

    #[test]
    fn the_nearest_of_a_bones_points_is_what_trying_all_finds() {
        use riglab_random::{Draw, stream};
        let mut random = stream(3, "test", &[]);
        let mut tree = |joints: usize| {
            let mut at = || [(); 3].map(|()| f64::from(random.unit()) - 0.5);
            // One bone of no length, one shorter than a step.
            let mut positions: Vec<[f64; 3]> = (0..joints).map(|_| at()).collect();
            positions[2] = positions[1];
            positions[3] = positions[2].map(|x| x + 0.001);
            Joints { positions, parents: (0..joints).map(|j| j.checked_sub(1)).collect() }
        };
        let (a, b) = (tree(9), tree(7));
        for convention in [SkeletonConvention::Rignet, SkeletonConvention::Unirig, SkeletonConvention::Anymate] {
            let points = |j: &Joints| convention.bones(&convention.measured(j, None)).points();
            let (pa, pb) = (points(&a), points(&b));
            let scale = if convention == SkeletonConvention::Unirig { 0.5 } else { 1.0 };
            let all = scale * (mean_nearest(&pa, &pb) + mean_nearest(&pb, &pa)) / 2.0;
            assert!((convention.distances(&a, &b).b2b - all).abs() < 1e-14, "{convention:?}");
        }
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
