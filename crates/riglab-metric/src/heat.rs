//! Weights by heat that flows over the surface.

use rayon::prelude::*;
use riglab_core::{JointId, Mesh, Segment, Skeleton, SkinWeights};
use riglab_geom::SurfaceHeat;
use riglab_geom::geodesic::GeodesicSolver;
use riglab_geom::voxel::SolidConfig;

/// Bones whose distances are held at a time.
const AT_ONCE: usize = 32;
/// Bones whose distances differ by less than this share are equally near.
const EQUAL: f64 = 1e-4;

/// Weights by heat diffusion, as Pinocchio binds a mesh (Baran and Popović 2007, section 4): each bone in turn is hot
/// and heats the vertices it is nearest to, by 1 / d²; heat spreads over the surface, and what a vertex has in
/// equilibrium is its weight. For each bone (L + M H) w = M H p, L the cotangent Laplacian, M the vertices' areas,
/// H = 1 / d² to the nearest bone and p whether that is this bone.
///
/// Pinocchio heats only where the way to the nearest bone is free; here distances go through the body, so that a
/// bone behind a gap is far and every vertex has heat. Vertices of one place are one, as heat must cross seams.
/// Every vertex gets finite weights that sum to 1, whatever the mesh is like. Of all joints where `joints` is empty.
pub fn heat_weights(mesh: &Mesh, skeleton: &Skeleton, joints: &[JointId], config: &SolidConfig) -> SkinWeights {
    let all: Vec<JointId> = skeleton.ids().collect();
    let joints = if joints.is_empty() { &all } else { joints };
    let (near, distance) = nearest(mesh, skeleton, joints, config);
    let surface = SurfaceHeat::new(mesh, &distance);
    let best = surface.hottest(&near, joints.len());
    let rows = surface.rows().iter().zip(&near).map(|(s, near)| {
        let mut row: Vec<(u16, f64)> = best[*s]
            .iter()
            .filter(|(w, _)| w.is_finite() && *w > 0.0)
            .map(|(w, b)| (joints[*b as usize].0, f64::from(*w)))
            .collect();
        if row.is_empty() {
            // Heat that rounding ate: the nearest bone.
            row.extend(near.first().map(|b| (joints[*b as usize].0, 1.0)));
        }
        row
    });
    // Rows have a positive weight on joints that differ, so there is nothing to refuse.
    SkinWeights::normalized(rows).expect("weights of heat are sound")
}

/// For each vertex the bones that are nearest, one or several equally so, and how far they are.
fn nearest(mesh: &Mesh, skeleton: &Skeleton, joints: &[JointId], config: &SolidConfig) -> (Vec<Vec<u32>>, Vec<f64>) {
    let (solver, segments) = (GeodesicSolver::new(mesh, config), skeleton.segments());
    let vertices = mesh.positions().len();
    let mut found = vec![(Vec::<(u32, f64)>::new(), f64::INFINITY); vertices];
    for (chunk, some) in joints.chunks(AT_ONCE).enumerate() {
        let bones: Vec<Vec<Segment>> = some.iter().map(|j| segments[j.index()].clone()).collect();
        let rows = solver.distances(&bones, mesh.positions());
        found.par_iter_mut().enumerate().for_each(|(v, (near, least))| {
            for b in 0..some.len() {
                let d = f64::from(rows[b * vertices + v]);
                *least = least.min(d);
                near.push(((chunk * AT_ONCE + b) as u32, d));
            }
            let limit = *least * (1.0 + EQUAL);
            near.retain(|(_, d)| *d <= limit);
        });
    }
    found.into_iter().map(|(near, least)| (near.into_iter().map(|(b, _)| b).collect(), least)).unzip()
}

#[cfg(test)]
mod tests {
    use riglab_core::Joint;

    use super::*;

    const COARSE: SolidConfig = SolidConfig { resolution: 48, ..SolidConfig::DEFAULT };

    fn chain(heads: &[[f32; 3]]) -> Skeleton {
        let joint = |(j, head): (usize, &[f32; 3])| Joint {
            name: format!("{j}"),
            parent: (j > 0).then(|| JointId(j as u16 - 1)),
            head: *head,
        };
        Skeleton::new(heads.iter().enumerate().map(joint).collect()).unwrap()
    }

    /// A tube along y with rings of eight vertices, each ring once or, split, each quad with corners of its own.
    fn tube(rings: u32, split: bool) -> Mesh {
        let corner = |r: u32, k: u32| {
            let (sin, cos) = libm::sincosf(std::f32::consts::TAU * (k % 8) as f32 / 8.0);
            [cos, r as f32 * 0.5, sin]
        };
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        if !split {
            positions.extend((0..=rings).flat_map(|r| (0..8).map(move |k| corner(r, k))));
        }
        for r in 0..rings {
            for k in 0..8 {
                let own = positions.len() as u32;
                let quad = if split {
                    positions.extend([corner(r, k), corner(r, k + 1), corner(r + 1, k), corner(r + 1, k + 1)]);
                    [own, own + 1, own + 2, own + 3]
                } else {
                    [8 * r + k, 8 * r + (k + 1) % 8, 8 * r + 8 + k, 8 * r + 8 + (k + 1) % 8]
                };
                triangles.extend([[quad[0], quad[2], quad[1]], [quad[1], quad[2], quad[3]]]);
            }
        }
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn heat_falls_from_bone_to_bone_and_crosses_seams() {
        // Two bones along the axis that meet in the middle, at y = 5.
        let skeleton = chain(&[[0.0, 0.5, 0.0], [0.0, 5.0, 0.0], [0.0, 9.5, 0.0]]);
        let joints = [JointId(0), JointId(1)];
        let share = |mesh: &Mesh, y: f32| {
            let weights = heat_weights(mesh, &skeleton, &joints, &COARSE);
            let v = mesh.positions().iter().position(|p| p[1] == y).unwrap();
            weights.row(v).filter(|(j, _)| j.0 == 0).map(|(_, w)| w).sum::<f32>()
        };
        let (whole, seams) = (tube(20, false), tube(20, true));
        let along: Vec<f32> = [1.0, 4.0, 4.5, 5.0, 5.5, 6.0, 9.0].map(|y| share(&whole, y)).to_vec();
        assert!(along.windows(2).all(|w| w[0] > w[1]), "{along:?}");
        // In the middle of a bone the other has next to nothing, where they meet about half.
        assert!(along[0] > 0.95 && along[6] < 0.05 && (along[3] - 0.5).abs() < 0.2, "{along:?}");
        for y in [1.0, 4.5, 6.0] {
            assert!((share(&whole, y) - share(&seams, y)).abs() < 0.02, "heat stops at seams");
        }
    }

    #[test]
    fn anything_gets_weights() {
        let point = Mesh::new(vec![[1e-30; 3]; 3], vec![[0, 1, 2]]).unwrap();
        let far = Mesh::new(vec![[-1e38; 3], [1e38; 3], [1e38, 0.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let unused =
            Mesh::new([tube(3, false).positions(), &[[50.0; 3]]].concat(), tube(3, false).triangles().to_vec());
        for mesh in [point, far, unused.unwrap()] {
            for heads in [&[[0.0; 3]][..], &[[0.2; 3]; 3], &[[-9e9; 3], [9e9, 0.0, 0.0]]] {
                let weights = heat_weights(&mesh, &chain(heads), &[], &COARSE);
                assert_eq!(weights.rows(), mesh.positions().len());
            }
        }
    }
}
