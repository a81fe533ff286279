//! Weights without learning, for a mesh and a skeleton that are given.

use riglab_core::{DecodeRule, JointId, Rig, SkinWeights};
use riglab_geom::voxel::SolidConfig;

use crate::{Baseline, bone_distances, geodesic_distances, geodesic_weights, heat_weights};

/// Shares of heat at or below it are dropped in the second of its rows: the best of validation.
const HEAT_CUT: f32 = 0.15;

/// A way to bind a mesh to a given skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SkinBaseline {
    /// A rule over straight distances to the bones.
    Straight(Baseline),
    /// A rule over distances through the body.
    Geodesic(Baseline),
    /// Heat over the surface, see [`heat_weights`].
    Heat,
}

impl SkinBaseline {
    /// Those that tables show: one of each kind and the best rules of validation.
    pub const SHOWN: [Self; 5] = [
        Self::Straight(Baseline::Nearest),
        Self::Straight(Baseline::InverseCut { power: 4, cut: 0.15 }),
        Self::Geodesic(Baseline::Nearest),
        Self::Geodesic(Baseline::InverseCut { power: 3, cut: 0.15 }),
        Self::Heat,
    ];

    /// Its name in tables.
    pub fn name(&self) -> String {
        match self {
            Self::Straight(rule) => rule.name(),
            Self::Geodesic(rule) => rule.geodesic_name(),
            Self::Heat => "heat diffusion".into(),
        }
    }

    /// Weights of a rig's mesh on all of its joints; its own weights are not looked at.
    pub fn weights(&self, rig: &Rig, config: &SolidConfig) -> SkinWeights {
        let joints: Vec<_> = rig.skeleton().ids().collect();
        match self {
            Self::Straight(rule) => {
                let distances = bone_distances(rig, &joints);
                let raw = rule.weights(&distances, joints.len());
                // Every row has a positive share, so there is nothing to refuse.
                DecodeRule { cut: 0.0, influences: joints.len() }.weights(&raw, &joints).expect("weights of a rule")
            }
            Self::Geodesic(rule) => geodesic_weights(rig.mesh(), rig.skeleton(), &joints, *rule, config),
            Self::Heat => heat_weights(rig.mesh(), rig.skeleton(), &joints, config),
        }
    }
}

/// What every rule that evaluations show makes of a rig's mesh and its joints `joints`, of which there is one at
/// least: the rule's name, and dense weights, a row of `joints.len()` shares a vertex. Rules over straight distances
/// first, then over those through the body, then heat; distances are found once. The rig's own weights are not looked
/// at.
pub fn every_rule(rig: &Rig, joints: &[JointId], config: &SolidConfig, mut found: impl FnMut(String, &[f32])) {
    let straight = bone_distances(rig, joints);
    for rule in Baseline::SHOWN {
        found(rule.name(), &rule.weights(&straight, joints.len()));
    }
    let ways = geodesic_distances(rig.mesh(), rig.skeleton(), joints, config);
    for rule in Baseline::SHOWN_GEODESIC {
        found(rule.geodesic_name(), &rule.weights(&ways, joints.len()));
    }
    let mut heat = on_joints(&heat_weights(rig.mesh(), rig.skeleton(), joints, config), joints);
    found(SkinBaseline::Heat.name(), &heat);
    let rule = DecodeRule { cut: HEAT_CUT, influences: 4 };
    heat.chunks_exact_mut(joints.len()).for_each(|row| rule.apply(row));
    found(format!("{}, top 4, cut {HEAT_CUT}", SkinBaseline::Heat.name()), &heat);
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
        for baseline in SkinBaseline::SHOWN {
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
}
