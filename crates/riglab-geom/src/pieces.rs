//! What hangs together.

use riglab_core::Mesh;

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
}
