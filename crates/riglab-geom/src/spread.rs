//! Weights that spread over a surface as heat does.

use rayon::prelude::*;
use riglab_core::Mesh;

use crate::heat::SurfaceHeat;

/// Bones whose weights are held at a time.
const AT_ONCE: usize = 32;

/// Weights V × J spread over the surface: each bone's are what heats, each vertex keeps its own the more the smaller its
/// distance is. Smooths what was told vertex by vertex, welds seams, and holds parts that hang together, together. Rows
/// that summed to 1 still do; a row that nothing reaches stays as it was.
///
/// # Panics
/// When lengths do not fit.
pub fn spread_weights(mesh: &Mesh, weights: &[f32], distance: &[f64]) -> Vec<f32> {
    let vertices = mesh.positions().len();
    let bones = weights.len() / vertices.max(1);
    assert_eq!(weights.len(), vertices * bones, "a row of weights a vertex");
    let surface = SurfaceHeat::new(mesh, distance);
    let (rows, places) = (surface.rows(), surface.speakers().len());
    let mut count = vec![0.0f64; places];
    rows.iter().for_each(|row| count[*row] += 1.0);
    let held = |bone: usize| -> Vec<(usize, f64)> {
        let mut own = vec![0.0; places];
        for (v, &row) in rows.iter().enumerate() {
            own[row] += f64::from(weights[v * bones + bone]) / count[row];
        }
        own.into_iter().enumerate().filter(|(_, w)| *w > 0.0).collect()
    };
    let mut out = vec![0.0f32; weights.len()];
    for first in (0..bones).step_by(AT_ONCE) {
        let some: Vec<Vec<(usize, f64)>> = (first..bones.min(first + AT_ONCE)).into_par_iter().map(held).collect();
        let solved = surface.solve(&some);
        out.par_chunks_exact_mut(bones).zip(rows).for_each(|(row, &place)| {
            row[first..].iter_mut().zip(&solved).for_each(|(w, heat)| *w = heat[place].max(0.0) as f32);
        });
    }
    out.par_chunks_exact_mut(bones.max(1)).zip(weights.par_chunks_exact(bones.max(1))).for_each(|(row, before)| {
        let sum: f32 = row.iter().sum();
        if sum > 0.0 && sum.is_finite() {
            row.iter_mut().for_each(|w| *w /= sum);
        } else {
            row.copy_from_slice(before);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heat::tests::tube;

    #[test]
    fn weights_spread_as_far_as_they_are_told() {
        // A step in the middle of a tube of 21 rings, half a unit apart.
        let mesh = tube(20, false);
        let vertices = mesh.positions().len();
        let step: Vec<f32> =
            mesh.positions().iter().flat_map(|p| if p[1] < 5.1 { [1.0, 0.0] } else { [0.0, 1.0] }).collect();
        let at = |spread: &[f32], y: f32| {
            let v = mesh.positions().iter().position(|p| p[1] == y).unwrap();
            spread[2 * v]
        };
        let near = spread_weights(&mesh, &step, &vec![1e-3; vertices]);
        assert!(near.iter().zip(&step).all(|(a, b)| (a - b).abs() < 1e-3), "nowhere");
        let some = spread_weights(&mesh, &step, &vec![1.0; vertices]);
        assert!(some.chunks_exact(2).all(|row| (row[0] + row[1] - 1.0).abs() < 1e-5));
        // A screened step falls as exp(-x / d) on either side: 1/(2e) of it is left a unit away from the middle.
        let far: Vec<f32> = [2.0, 4.0, 5.0, 5.5, 6.0, 7.5].map(|y| at(&some, y)).to_vec();
        assert!(far.windows(2).all(|w| w[0] > w[1]) && far[0] > 0.95 && far[5] < 0.08, "{far:?}");
        assert!((at(&some, 6.5) - 0.5 * (-1.25f32).exp()).abs() < 0.03, "{}", at(&some, 6.5));
    }

    #[test]
    fn spread_weights_weld_seams_and_rows_that_nothing_reaches_stay() {
        // Corners of one place differ before; a vertex of no triangle keeps what it has.
        let split = tube(4, true);
        let mesh = Mesh::new([split.positions(), &[[50.0; 3]]].concat(), split.triangles().to_vec()).unwrap();
        let told = |v: usize| [[0.9, 0.1], [0.5, 0.5], [0.2, 0.8]][v % 3];
        let weights: Vec<f32> = (0..mesh.positions().len()).flat_map(told).collect();
        let spread = spread_weights(&mesh, &weights, &vec![0.2; mesh.positions().len()]);
        let last = weights.len() - 2;
        assert!((spread[last] - weights[last]).abs() < 1e-5);
        for (a, p) in mesh.positions().iter().enumerate() {
            let b = mesh.positions().iter().position(|q| q == p).unwrap();
            assert_eq!(spread[2 * a..2 * a + 2], spread[2 * b..2 * b + 2], "{p:?}");
        }
        let none = spread_weights(&mesh, &vec![0.0; weights.len()], &vec![0.2; mesh.positions().len()]);
        assert!(none.iter().all(|w| *w == 0.0), "nothing is made up");
        let odd = spread_weights(&mesh, &weights, &vec![f64::INFINITY; mesh.positions().len()]);
        assert!(odd.iter().all(|w| w.is_finite()));
    }
}
