//! Weights without learning, for a mesh and a skeleton that are given.

use riglab_core::{DecodeRule, Rig, SkinWeights};
use riglab_geom::voxel::SolidConfig;

use crate::{Baseline, bone_distances, geodesic_weights, heat_weights};

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

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Skeleton};

    use super::*;

    #[test]
    fn each_binds_a_vertex_to_the_bone_beside_it() {
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [0.1, f32::from(k) * 2.0, 0.1],
        };
        let skeleton = Skeleton::new((0..3).map(joint).collect()).unwrap();
        // A needle along y.
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
        let rig = Rig::new(skeleton, mesh, own).unwrap();
        for baseline in SkinBaseline::SHOWN {
            let weights = baseline.weights(&rig, &SolidConfig { resolution: 48, ..SolidConfig::DEFAULT });
            for (vertex, bone) in [(6, 0), (18, 1), (36, 2)] {
                let largest = weights.row(vertex).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
                assert_eq!(largest.0, JointId(bone), "{}: vertex {vertex}", baseline.name());
            }
        }
    }
}
