//! The pieces a surface consists of: what triangles connect, seams closed.

use std::collections::HashMap;

use glam::DVec3;
use riglab_core::Mesh;

/// A piece.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    /// Numbers of its triangles, rising.
    pub(super) triangles: Vec<u32>,
    pub(super) low: DVec3,
    pub(super) high: DVec3,
    /// Twice its area.
    pub(super) area: f64,
    /// Six times its volume; negative where it faces inwards. `None` for one that is not closed, or whose
    /// triangles do not agree which side is out.
    pub(super) volume: Option<f64>,
}

/// The pieces in the order of their first triangles; `first` is what [`super::twins`] says.
pub(super) fn pieces(mesh: &Mesh, first: &[u32]) -> Vec<Piece> {
    let mut above: Vec<u32> = first.to_vec();
    let joined = |[a, b, c]: [u32; 3]| [a, b, c].map(|v| first[v as usize]);
    for &triangle in mesh.triangles() {
        let [a, b, c] = joined(triangle);
        for other in [b, c] {
            let (x, y) = (root(&mut above, a), root(&mut above, other));
            above[x.max(y) as usize] = x.min(y);
        }
    }
    let mut number: HashMap<u32, usize> = HashMap::new();
    let mut all: Vec<Piece> = Vec::new();
    for (t, &triangle) in (0u32..).zip(mesh.triangles()) {
        let at = *number.entry(root(&mut above, first[triangle[0] as usize])).or_insert(all.len());
        if at == all.len() {
            let (low, high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            all.push(Piece { triangles: Vec::new(), low, high, area: 0.0, volume: None });
        }
        let piece = &mut all[at];
        piece.triangles.push(t);
        let [a, b, c] = corners(mesh, t);
        piece.area += (b - a).cross(c - a).length();
        for p in [a, b, c] {
            (piece.low, piece.high) = (piece.low.min(p), piece.high.max(p));
        }
    }
    let mut edges: Vec<(u32, u32)> = Vec::new();
    for piece in &mut all {
        edges.clear();
        for &t in &piece.triangles {
            let [a, b, c] = joined(mesh.triangles()[t as usize]);
            // Of a triangle that seams collapse, two sides cancel and one is none.
            edges.extend([(a, b), (b, c), (c, a)].into_iter().filter(|(from, to)| from != to));
        }
        edges.sort_unstable();
        let alone = edges.windows(2).all(|pair| pair[0] != pair[1]);
        if alone && edges.iter().all(|&(from, to)| edges.binary_search(&(to, from)).is_ok()) {
            // About its middle, for what stands far from the origin.
            let middle = 0.5 * (piece.low + piece.high);
            let volume = |&t: &u32| {
                let [a, b, c] = corners(mesh, t).map(|p| p - middle);
                a.dot(b.cross(c))
            };
            piece.volume = Some(piece.triangles.iter().map(volume).sum());
        }
    }
    all
}

/// The corners of a triangle in double precision.
pub(super) fn corners(mesh: &Mesh, triangle: u32) -> [DVec3; 3] {
    mesh.corners(triangle as usize).map(|p| glam::Vec3::from(p).as_dvec3())
}

/// The first of the group that a vertex is in; `above` names for each another one of its group, and itself for the first.
pub(super) fn root(above: &mut [u32], mut v: u32) -> u32 {
    while above[v as usize] != v {
        above[v as usize] = above[above[v as usize] as usize];
        v = above[v as usize];
    }
    v
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::twins;
    use super::*;

    /// A tetrahedron of a size, its corners split, facing outwards, standing at a place.
    pub(in crate::rigging) fn tetrahedron(at: [f32; 3], size: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let corner = |x: f32, y: f32, z: f32| [at[0] + size * x, at[1] + size * y, at[2] + size * z];
        let [o, x, y, z] = [corner(0., 0., 0.), corner(1., 0., 0.), corner(0., 1., 0.), corner(0., 0., 1.)];
        let positions = vec![o, y, x, o, x, z, o, z, y, x, y, z];
        (positions, (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    #[test]
    fn pieces_are_closed_over_seams_and_know_their_inside() {
        let (mut positions, mut triangles) = tetrahedron([100.0, 0.0, 0.0], 1.0);
        let (more, others) = tetrahedron([0.0; 3], 2.0);
        positions.extend(more);
        triangles.extend(others.iter().map(|[a, b, c]| [a + 12, c + 12, b + 12]));
        positions.extend([[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]]);
        triangles.push([24, 25, 26]);
        let mesh = Mesh::new(positions, triangles).unwrap();
        let found = pieces(&mesh, &twins(mesh.positions()));
        let volumes: Vec<_> = found.iter().map(|p| p.volume).collect();
        assert_eq!(found.len(), 3);
        assert!((volumes[0].unwrap() - 1.0).abs() < 1e-9 && (volumes[1].unwrap() + 8.0).abs() < 1e-9);
        assert_eq!((volumes[2], found[2].area, &found[1].triangles), (None, 1.0, &vec![4, 5, 6, 7]));
    }
}
