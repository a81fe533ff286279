//! A mesh small enough for a page.

use std::collections::HashMap;

use meshopt::SimplifyOptions;
use riglab_core::Mesh;

/// Triangles of a view at most, or nearly so.
const TRIANGLES: usize = 6_000;
/// Vertices of a view at most: what 16 bits count.
const VERTICES: usize = 1 << 16;

/// The vertices that are kept, by number, and triangles of places among them. Vertices at one place become one; a mesh of
/// more triangles than [`TRIANGLES`] loses those whose loss is seen least.
pub(super) fn small(mesh: &Mesh) -> (Vec<u32>, Vec<[u16; 3]>) {
    let mut first: HashMap<[u32; 3], u32> = HashMap::new();
    let same: Vec<u32> = (0u32..)
        .zip(mesh.positions())
        // 0 and -0 are one place.
        .map(|(v, p)| *first.entry(p.map(|x| (x + 0.0).to_bits())).or_insert(v))
        .collect();
    let joined = mesh.triangles().iter().map(|t| t.map(|v| same[v as usize]));
    let mut triangles: Vec<u32> = joined.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).flatten().collect();
    let target = 3 * TRIANGLES;
    let positions = mesh.positions();
    if triangles.len() > target {
        // Pieces that hardly show may go as a whole.
        triangles = meshopt::simplify_decoder(&triangles, positions, target, 1.0, SimplifyOptions::Prune, None);
    }
    if triangles.len() > target + target / 4 {
        // What is left are many small pieces, or edges that no two triangles share.
        triangles = meshopt::simplify_sloppy_decoder(&triangles, positions, target, 1.0, None);
    }
    triangles.truncate(VERTICES / 3 * 3);
    let mut place: HashMap<u32, u16> = HashMap::new();
    let mut kept: Vec<u32> = Vec::new();
    let mut of = |v: u32| {
        *place.entry(v).or_insert_with(|| {
            kept.push(v);
            (kept.len() - 1) as u16
        })
    };
    let out: Vec<[u16; 3]> = triangles.chunks_exact(3).map(|t| [of(t[0]), of(t[1]), of(t[2])]).collect();
    (kept, out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bent sheet of n x n squares.
    fn sheet(n: usize) -> Mesh {
        let at = |x: usize, y: usize| {
            let (x, y) = (x as f32 / n as f32, y as f32 / n as f32);
            [x, y, (4.0 * x).sin() * (3.0 * y).cos()]
        };
        let positions = (0..=n).flat_map(|y| (0..=n).map(move |x| at(x, y))).collect();
        let id = |x: usize, y: usize| (y * (n + 1) + x) as u32;
        let square = |(x, y): (usize, usize)| {
            [[id(x, y), id(x + 1, y), id(x, y + 1)], [id(x + 1, y), id(x + 1, y + 1), id(x, y + 1)]]
        };
        let triangles = (0..n).flat_map(|y| (0..n).map(move |x| (x, y))).flat_map(square).collect();
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn a_large_mesh_is_made_small_and_keeps_its_shape() {
        let mesh = sheet(150);
        let (kept, triangles) = small(&mesh);
        assert!(triangles.len() <= TRIANGLES && triangles.len() > TRIANGLES / 2, "{}", triangles.len());
        assert!(triangles.as_flattened().iter().all(|&v| usize::from(v) < kept.len()));
        // No corner is lost.
        let low = |k: usize| kept.iter().map(|&v| mesh.positions()[v as usize][k]).fold(f32::INFINITY, f32::min);
        assert!((0..2).all(|k| low(k) < 0.02));
    }

    #[test]
    fn vertices_at_one_place_become_one_and_flat_triangles_go() {
        let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let positions = [p[0], p[1], p[2], p[1], [1.0, 1.0, -0.0], p[2], [-0.0, 0.0, 0.0]].to_vec();
        let mesh = Mesh::new(positions, vec![[0, 1, 2], [3, 4, 5], [0, 6, 1]]).unwrap();
        let (kept, triangles) = small(&mesh);
        assert_eq!((kept, triangles), (vec![0, 1, 2, 4], vec![[0, 1, 2], [1, 3, 2]]));
    }

    #[test]
    fn a_soup_of_loose_triangles_is_made_small_too() {
        let mut positions = Vec::new();
        for k in 0..20_000u32 {
            let at = [(k % 141) as f32, (k / 141) as f32, 0.0];
            positions.extend([at, [at[0] + 0.4, at[1], 0.0], [at[0], at[1] + 0.4, 0.1]]);
        }
        let triangles = (0..20_000u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let (_, triangles) = small(&Mesh::new(positions, triangles).unwrap());
        assert!(!triangles.is_empty() && triangles.len() <= TRIANGLES * 5 / 4, "{}", triangles.len());
    }
}
