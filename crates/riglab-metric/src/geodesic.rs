//! Distances and weights along ways through the body.

use rayon::prelude::*;
use riglab_core::{DecodeRule, JointId, Mesh, Segment, Skeleton, SkinWeights};
use riglab_geom::geodesic::GeodesicSolver;
use riglab_geom::voxel::SolidConfig;

use crate::Baseline;

impl Baseline {
    /// Its name in tables where distances are geodesic.
    pub fn geodesic_name(&self) -> String {
        format!("geodesic {}", self.name())
    }
}

/// Distance of every vertex to the bones of `joints` along ways through the body, a row a vertex, as
/// [`crate::bone_distances`] gives the straight ones. All are finite: see [`GeodesicSolver`] for pieces that do
/// not touch and bones that lie outside.
pub fn geodesic_distances(mesh: &Mesh, skeleton: &Skeleton, joints: &[JointId], config: &SolidConfig) -> Vec<f32> {
    let rows = GeodesicSolver::new(mesh, config).distances(&bones(skeleton, joints), mesh.positions());
    let (bones, vertices) = (joints.len(), mesh.positions().len());
    let mut out = vec![0.0; rows.len()];
    out.par_chunks_exact_mut(bones.max(1)).enumerate().for_each(|(v, row)| {
        row.iter_mut().enumerate().for_each(|(b, d)| *d = rows[b * vertices + v]);
    });
    out
}

/// Weights of a mesh on the bones of `joints`, or of all joints where there are none, by a rule over voxel
/// geodesic distances to all of them.
///
/// Every vertex has finite weights that sum to 1, whatever mesh and bones are like: of one triangle or a
/// million, of no length, outside of the body, on pieces that no bone touches.
pub fn geodesic_weights(
    mesh: &Mesh,
    skeleton: &Skeleton,
    joints: &[JointId],
    rule: Baseline,
    config: &SolidConfig,
) -> SkinWeights {
    let all: Vec<JointId> = skeleton.ids().collect();
    let joints = if joints.is_empty() { &all } else { joints };
    let raw = rule.weights(&geodesic_distances(mesh, skeleton, joints, config), joints.len());
    // Rows have a positive weight on joints that differ, so there is nothing to refuse.
    let kept = DecodeRule { cut: 0.0, influences: joints.len() }.weights(&raw, joints);
    kept.expect("weights of a rule are sound")
}

fn bones(skeleton: &Skeleton, joints: &[JointId]) -> Vec<Vec<Segment>> {
    let segments = skeleton.segments();
    joints.iter().map(|j| segments[j.index()].clone()).collect()
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, Rig};

    use super::*;
    use crate::SkinBaseline;
    use crate::bone_distances;

    const COARSE: SolidConfig = SolidConfig { resolution: 48, ..SolidConfig::DEFAULT };

    fn skeleton(heads: &[[f32; 3]]) -> Skeleton {
        let joint = |(j, head): (usize, &[f32; 3])| Joint {
            name: format!("{j}"),
            parent: (j > 0).then(|| JointId(j as u16 - 1)),
            head: *head,
        };
        Skeleton::new(heads.iter().enumerate().map(joint).collect()).unwrap()
    }

    /// Two legs side by side, joined at the top: boxes along y.
    fn legs() -> Mesh {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for (low, high) in [([0.0, 0.0], [0.4, 3.0]), ([0.6, 0.0], [1.0, 3.0]), ([0.0, 2.6], [1.0, 3.0f32])] {
            let n = positions.len() as u32;
            for i in 0..8 {
                let pick = |k: usize| if i >> k & 1 == 1 { high[k] } else { low[k] };
                positions.push([pick(0), pick(1), if i >> 2 & 1 == 1 { 0.4 } else { 0.0 }]);
            }
            let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
            triangles
                .extend(sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]].map(|t| t.map(|v| v + n))));
        }
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn a_leg_does_not_hold_the_other() {
        let mesh = legs();
        // A chain through the middle of the left leg, then down the inner side of the right one.
        let skeleton = skeleton(&[[0.2, 2.8, 0.2], [0.2, 0.1, 0.2], [0.8, 2.8, 0.2], [0.62, 0.1, 0.2]]);
        let joints = [JointId(0), JointId(2)];
        let d = geodesic_distances(&mesh, &skeleton, &joints, &COARSE);
        // The left leg's inner lower corner: straight, the right bone is as near as can be.
        assert!(d[2] < 0.4 && d[3] > 2.0, "{:?}", &d[2..4]);
        let rule = Baseline::InverseCut { power: 4, cut: 0.15 };
        let weights = geodesic_weights(&mesh, &skeleton, &joints, rule, &COARSE);
        assert_eq!(weights.row(1).collect::<Vec<_>>(), [(JointId(0), 1.0)]);
        assert_eq!(weights.row(9).collect::<Vec<_>>(), [(JointId(2), 1.0)]);
        let rig = Rig::new(skeleton, mesh, weights).unwrap();
        let straight = bone_distances(&rig, &joints);
        assert!(straight.iter().zip(&d).all(|(s, d)| s - d < 0.05), "a way is no shorter than the straight one");
    }

    #[test]
    fn anything_gets_weights() {
        let point = Mesh::new(vec![[1e-30; 3]; 3], vec![[0, 1, 2]]).unwrap();
        let far = Mesh::new(vec![[-1e38; 3], [1e38; 3], [1e38, 0.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let unused =
            Mesh::new([legs().positions(), &[[50.0; 3], [-1.0; 3]]].concat(), legs().triangles().to_vec()).unwrap();
        for mesh in [point, far, legs(), unused] {
            for heads in [
                &[[0.0; 3]][..],
                &[[0.2; 3]; 3],
                &[[-9e9; 3], [9e9, 0.0, 0.0]],
                &[[1e25; 3]],
                &[[f32::MAX; 3], [-f32::MAX; 3]],
            ] {
                for baseline in SkinBaseline::all() {
                    let SkinBaseline::Geodesic(rule) = baseline else { continue };
                    let weights = geodesic_weights(&mesh, &skeleton(heads), &[], rule, &COARSE);
                    assert_eq!(weights.rows(), mesh.positions().len());
                }
            }
        }
    }
}
