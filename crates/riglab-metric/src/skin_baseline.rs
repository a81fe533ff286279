//! Weights without learning, for a mesh and a skeleton that are given.

use std::cell::LazyCell;

use riglab_core::{DecodeRule, JointId, Rig, SkinWeights};
use riglab_geom::voxel::SolidConfig;

use crate::{Baseline, bone_distances, geodesic_distances, geodesic_weights, heat_weights};

/// A way to bind a mesh to a given skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SkinBaseline {
    /// A rule over straight distances to the bones.
    Straight(Baseline),
    /// A rule over distances through the body.
    Geodesic(Baseline),
    /// Heat over the surface, see [`heat_weights`].
    Heat,
    /// The same, four largest kept, those below a cut dropped.
    HeatCut {
        /// Shares at or below are dropped.
        cut: f32,
    },
}

/// Who shows a baseline.
#[derive(Clone, Copy, PartialEq)]
enum Shown {
    /// Evaluations of a run.
    Evaluated,
    /// These, and comparisons of systems, which have a column for each.
    Compared,
}

impl SkinBaseline {
    /// Each kind as it is and with the powers and cuts that were best in validation. Comparisons show one of each kind as it
    /// is, and its best. Rules over straight distances come first, then those through the body, then heat.
    const ALL: [(Self, Shown); 12] = {
        use Baseline::{Inverse, InverseCut, Nearest};
        [
            (Self::Straight(Nearest), Shown::Compared),
            (Self::Straight(Inverse { power: 2 }), Shown::Evaluated),
            (Self::Straight(Inverse { power: 8 }), Shown::Evaluated),
            (Self::Straight(InverseCut { power: 2, cut: 0.15 }), Shown::Evaluated),
            (Self::Straight(InverseCut { power: 4, cut: 0.15 }), Shown::Compared),
            (Self::Straight(InverseCut { power: 16, cut: 0.05 }), Shown::Evaluated),
            (Self::Geodesic(Nearest), Shown::Compared),
            (Self::Geodesic(Inverse { power: 16 }), Shown::Evaluated),
            (Self::Geodesic(InverseCut { power: 3, cut: 0.15 }), Shown::Compared),
            (Self::Geodesic(InverseCut { power: 16, cut: 0.15 }), Shown::Evaluated),
            (Self::Heat, Shown::Compared),
            (Self::HeatCut { cut: 0.15 }, Shown::Compared),
        ]
    };

    /// All that evaluations show.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().map(|(baseline, _)| baseline)
    }

    /// Those of them that comparisons show.
    pub fn compared() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|(_, shown)| *shown == Shown::Compared).map(|(baseline, _)| baseline)
    }

    /// Its name in tables.
    pub fn name(&self) -> String {
        match self {
            Self::Straight(rule) => rule.name(),
            Self::Geodesic(rule) => rule.geodesic_name(),
            Self::Heat => "heat diffusion".into(),
            Self::HeatCut { cut } => format!("{}, top 4, cut {cut}", Self::Heat.name()),
        }
    }

    /// Weights of a rig's mesh on all of its joints; its own weights are not looked at.
    pub fn weights(&self, rig: &Rig, config: &SolidConfig) -> SkinWeights {
        let joints: Vec<_> = rig.skeleton().ids().collect();
        let heat = || heat_weights(rig.mesh(), rig.skeleton(), &joints, config);
        // Every row has a positive share, so there is nothing to refuse.
        let sparse = |dense: &[f32], rule: DecodeRule| {
            rule.weights(dense, &joints).expect("weights of a rule that has all rows")
        };
        match self {
            Self::Straight(rule) => {
                let raw = rule.weights(&bone_distances(rig, &joints), joints.len());
                sparse(&raw, DecodeRule { cut: 0.0, influences: joints.len() })
            }
            Self::Geodesic(rule) => geodesic_weights(rig.mesh(), rig.skeleton(), &joints, *rule, config),
            Self::Heat => heat(),
            Self::HeatCut { cut } => sparse(&on_joints(&heat(), &joints), cut_at(*cut)),
        }
    }
}

/// Keeps the four largest shares above a cut.
fn cut_at(cut: f32) -> DecodeRule {
    DecodeRule { cut, influences: 4 }
}

/// What every rule that evaluations show makes of a rig's mesh and its joints `joints`, of which there is one at
/// least: the rule's name, and dense weights, a row of `joints.len()` shares a vertex. They come in the order of
/// [`SkinBaseline::all`]; distances and heat are found once. The rig's own weights are not looked at.
pub fn every_rule(rig: &Rig, joints: &[JointId], config: &SolidConfig, mut found: impl FnMut(String, &[f32])) {
    let straight = LazyCell::new(|| bone_distances(rig, joints));
    let ways = LazyCell::new(|| geodesic_distances(rig.mesh(), rig.skeleton(), joints, config));
    let heat = LazyCell::new(|| on_joints(&heat_weights(rig.mesh(), rig.skeleton(), joints, config), joints));
    for baseline in SkinBaseline::all() {
        let weights = match baseline {
            SkinBaseline::Straight(rule) => rule.weights(&straight, joints.len()),
            SkinBaseline::Geodesic(rule) => rule.weights(&ways, joints.len()),
            SkinBaseline::Heat => heat.clone(),
            SkinBaseline::HeatCut { cut } => {
                let mut cut_off = heat.clone();
                cut_off.chunks_exact_mut(joints.len()).for_each(|row| cut_at(cut).apply(row));
                cut_off
            }
        };
        found(baseline.name(), &weights);
    }
}

/// Dense rows over `joints`, which are all that hold something.
fn on_joints(weights: &SkinWeights, joints: &[JointId]) -> Vec<f32> {
    let all = joints.iter().map(|j| j.index() + 1).max().unwrap_or(0);
    let mut column = vec![usize::MAX; all];
    (0..).zip(joints).for_each(|(k, j)| column[j.index()] = k);
    let mut dense = vec![0.0; weights.rows() * joints.len()];
    for (v, row) in dense.chunks_exact_mut(joints.len()).enumerate() {
        weights.row(v).for_each(|(joint, w)| row[column[joint.index()]] = w);
    }
    dense
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Skeleton};

    use super::*;

    /// A needle along y with three bones of length 2.
    fn needle() -> Rig {
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [0.1, f32::from(k) * 2.0, 0.1],
        };
        let skeleton = Skeleton::new((0..3).map(joint).collect()).unwrap();
        let positions: Vec<[f32; 3]> = (0..=12)
            .flat_map(|y| [[0.0, 0.5, 0.0], [0.2, 0.5, 0.0], [0.1, 0.5, 0.2]].map(|p| [p[0], p[1] * y as f32, p[2]]))
            .collect();
        let sides = |r: u32| {
            (0..3).flat_map(move |k| {
                let (a, b) = (3 * r + k, 3 * r + (k + 1) % 3);
                [[a, b, a + 3], [b, b + 3, a + 3]]
            })
        };
        let mesh = Mesh::new(positions, (0..12).flat_map(sides).collect()).unwrap();
        let own = SkinWeights::normalized((0..39).map(|_| [(0u16, 1.0)])).unwrap();
        Rig::new(skeleton, mesh, own).unwrap()
    }

    #[test]
    fn each_binds_a_vertex_to_the_bone_beside_it() {
        let rig = needle();
        for baseline in SkinBaseline::all() {
            let weights = baseline.weights(&rig, &SolidConfig { resolution: 48, ..SolidConfig::DEFAULT });
            for (vertex, bone) in [(6, 0), (18, 1), (36, 2)] {
                let largest = weights.row(vertex).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
                assert_eq!(largest.0, JointId(bone), "{}: vertex {vertex}", baseline.name());
            }
        }
    }

    #[test]
    fn every_rule_is_told_once_and_on_the_joints_that_are_asked() {
        let (rig, config) = (needle(), SolidConfig { resolution: 48, ..SolidConfig::DEFAULT });
        // The first joint is not asked, and they stand in no order.
        let joints = [JointId(2), JointId(1)];
        let mut names = Vec::new();
        every_rule(&rig, &joints, &config, |name, weights| {
            assert_eq!(weights.len(), 39 * 2, "{name}");
            assert!(weights.chunks_exact(2).all(|row| (row.iter().sum::<f32>() - 1.0).abs() < 1e-5), "{name}");
            let [low, high] = [18, 36].map(|v| [weights[2 * v], weights[2 * v + 1]]);
            assert!(low[1] > low[0] && high[0] > high[1], "{name}: {low:?} {high:?}");
            names.push(name);
        });
        let (first, last) = (names.first().unwrap().as_str(), names.last().unwrap().as_str());
        assert_eq!((first, last), ("nearest bone", "heat diffusion, top 4, cut 0.15"));
        let told = names.len();
        names.sort();
        names.dedup();
        assert_eq!((names.len(), told), (12, 12));
    }

    #[test]
    fn comparisons_show_each_kind_as_it_is_and_its_best() {
        let names: Vec<String> = SkinBaseline::compared().map(|baseline| baseline.name()).collect();
        let wanted = [
            "nearest bone",
            "1/d^4, top 4, cut 0.15",
            "geodesic nearest bone",
            "geodesic 1/d^3, top 4, cut 0.15",
            "heat diffusion",
            "heat diffusion, top 4, cut 0.15",
        ];
        assert_eq!(names, wanted);
    }

    #[test]
    fn one_alone_binds_as_it_does_among_all() {
        let (needle, config) = (needle(), SolidConfig { resolution: 48, ..SolidConfig::DEFAULT });
        // Twelve bones: all of them share a vertex, the far ones too.
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [0.1, f32::from(k) * 0.5, 0.1],
        };
        let skeleton = Skeleton::new((0..12).map(joint).collect()).unwrap();
        let rig = Rig::new(skeleton, needle.mesh().clone(), needle.weights().clone()).unwrap();
        let joints: Vec<JointId> = rig.skeleton().ids().collect();
        let mut alone = SkinBaseline::all();
        every_rule(&rig, &joints, &config, |name, weights| {
            let baseline = alone.next().unwrap();
            assert_eq!(name, baseline.name());
            let own = on_joints(&baseline.weights(&rig, &config), &joints);
            assert!(own.iter().zip(weights).all(|(a, b)| (a - b).abs() < 1e-5), "{name}");
        });
    }
}
