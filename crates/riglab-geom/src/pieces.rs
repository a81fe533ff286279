//! What hangs together.

use std::collections::{BTreeMap, HashMap};

use riglab_core::{Mesh, Vec3};

use crate::SurfaceHeat;

/// The piece of surface that each vertex belongs to, seams closed, and how many there are; vertices of no triangle are
/// pieces of their own. `surface` knows which vertices are one.
///
/// # Panics
/// When it is not of this mesh.
pub fn pieces(mesh: &Mesh, surface: &SurfaceHeat) -> (Vec<u32>, usize) {
    let rows = surface.rows();
    assert_eq!(rows.len(), mesh.positions().len(), "a row a vertex");
    let mut groups = Groups::new(surface.speakers().len());
    for corners in mesh.triangles() {
        let [a, b, c] = corners.map(|v| rows[v as usize] as u32);
        groups.join(a, b);
        groups.join(a, c);
    }
    let mut number = vec![u32::MAX; surface.speakers().len()];
    let mut count = 0;
    let piece = |&row: &usize| {
        let own = &mut number[groups.root(row as u32) as usize];
        if *own == u32::MAX {
            *own = count;
            count += 1;
        }
        *own
    };
    let of_vertices = rows.iter().map(piece).collect();
    (of_vertices, count as usize)
}

/// The piece of surface that has most of the area, as a mesh of its own, and how many others there are; vertices in one place
/// are one. `None` where there are no others, or where it has less than `share` of the area.
pub fn main_piece(mesh: &Mesh, share: f64) -> Option<(Mesh, usize)> {
    let mut places: HashMap<[u32; 3], u32> = HashMap::with_capacity(mesh.positions().len());
    let place = |(p, v): (&Vec3, u32)| *places.entry(p.map(|x| (x + 0.0).to_bits())).or_insert(v);
    let first: Vec<u32> = mesh.positions().iter().zip(0u32..).map(place).collect();
    let mut groups = Groups::new(first.len());
    for corners in mesh.triangles() {
        let [a, b, c] = corners.map(|v| first[v as usize]);
        groups.join(a, b);
        groups.join(a, c);
    }
    let of: Vec<u32> = mesh.triangles().iter().map(|t| groups.root(first[t[0] as usize])).collect();
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    for (triangle, root) in of.iter().enumerate() {
        let area = f64::from(glam::Vec3::from(mesh.area_vector(triangle)).length());
        *areas.entry(*root).or_default() += area;
    }
    // The first of equals.
    let (&main, &area) = areas.iter().rev().max_by(|a, b| a.1.total_cmp(b.1))?;
    let whole: f64 = areas.values().sum();
    if areas.len() < 2 || area < share * whole {
        return None;
    }
    let mut number = vec![u32::MAX; first.len()];
    let mut positions = Vec::new();
    let mut own = |v: u32| {
        let at = &mut number[v as usize];
        if *at == u32::MAX {
            *at = positions.len() as u32;
            positions.push(mesh.positions()[v as usize]);
        }
        *at
    };
    let kept = mesh.triangles().iter().zip(&of).filter(|(_, root)| **root == main);
    let triangles: Vec<[u32; 3]> = kept.map(|(triangle, _)| triangle.map(&mut own)).collect();
    Some((Mesh::new(positions, triangles).ok()?, areas.len() - 1))
}

/// Sets that are joined.
pub(crate) struct Groups(Vec<u32>);

impl Groups {
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(crate) fn root(&mut self, mut at: u32) -> u32 {
        while self.0[at as usize] != at {
            let above = self.0[self.0[at as usize] as usize];
            self.0[at as usize] = above;
            at = above;
        }
        at
    }

    /// Whether they were apart.
    pub(crate) fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
        a != b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_close_seams_and_lone_vertices_are_their_own() {
        // Two triangles that share a side, whose corners are split; one apart; and a vertex of none.
        let corners = [
            [0., 0., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [1., 1., 0.],
            [5., 0., 0.],
            [6., 0., 0.],
            [5., 1., 0.],
            [9., 9., 9.],
        ];
        let mesh = Mesh::new(corners.to_vec(), vec![[0, 1, 2], [3, 5, 4], [6, 7, 8]]).unwrap();
        let surface = SurfaceHeat::new(&mesh, &[1.0; 10]);
        assert_eq!(pieces(&mesh, &surface), (vec![0, 0, 0, 0, 0, 0, 1, 1, 1, 2], 3));
    }

    #[test]
    fn the_main_piece_has_most_of_the_area() {
        let large =
            [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 0.0, -0.0], [0.0, 2.0, 0.0], [2.0, 2.0, 0.0]];
        let small = [[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]];
        let triangles = vec![[6, 7, 8], [0, 1, 2], [3, 5, 4]];
        let mesh = Mesh::new([&large[..], &small].concat(), triangles).unwrap();
        let (main, others) = main_piece(&mesh, 0.5).unwrap();
        assert_eq!((main.positions().len(), main.triangles().len(), others), (6, 2, 1));
        assert_eq!(main.positions()[..3], large[..3]);
        assert_eq!(main_piece(&mesh, 0.9), None, "8 of 9");
        assert_eq!(main_piece(&main, 0.5), None, "there is no other");
    }
}
