//! Triangles.

use crate::{RigError, Vec3};

/// A triangle mesh: at least one vertex and one triangle, all finite and in range.
///
/// Surfaces may be open, in several pieces, or wound inconsistently.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Checks vertices and triangles and keeps their order.
    ///
    /// # Errors
    /// The first violation of the crate's invariants, with its place.
    pub fn new(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self, RigError> {
        if positions.is_empty() {
            return Err(RigError::NoVertices);
        }
        if triangles.is_empty() {
            return Err(RigError::NoTriangles);
        }
        let vertices = positions.len();
        if u32::try_from(vertices).is_err() {
            return Err(RigError::TooManyVertices(vertices));
        }
        if let Some(v) = positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(RigError::VertexNotFinite(v));
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= vertices) {
                return Err(RigError::VertexOutOfRange { triangle, vertex, vertices });
            }
        }
        Ok(Self { positions, triangles })
    }

    /// Vertex positions.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Vertex numbers of each triangle's corners.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The corners of a triangle.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// Twice the area of a triangle along its normal, by the right-hand rule.
    #[inline]
    pub fn area_vector(&self, triangle: usize) -> Vec3 {
        let [a, b, c] = self.corners(triangle).map(glam::Vec3::from);
        (b - a).cross(c - a).into()
    }

    /// Unit normals at the vertices: the area-weighted mean of the triangles around each. A vertex
    /// without area around it gets +y.
    pub fn vertex_normals(&self) -> Vec<Vec3> {
        let mut sums = vec![glam::Vec3::ZERO; self.positions.len()];
        for (t, corners) in self.triangles.iter().enumerate() {
            let area = glam::Vec3::from(self.area_vector(t));
            for &v in corners {
                sums[v as usize] += area;
            }
        }
        sums.into_iter().map(|n| n.try_normalize().unwrap_or(glam::Vec3::Y).into()).collect()
    }

    /// Vertex positions and triangles.
    pub fn into_parts(self) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        (self.positions, self.triangles)
    }

    /// The same triangles over other positions.
    ///
    /// # Errors
    /// As [`Mesh::new`].
    pub fn with_positions(&self, positions: Vec<Vec3>) -> Result<Self, RigError> {
        Self::new(positions, self.triangles.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_point_by_the_right_hand_rule() {
        let m = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        assert_eq!(m.vertex_normals(), vec![[0.0, 0.0, 1.0]; 3]);
    }

    #[test]
    fn each_fault_has_its_error() {
        let p = vec![[0.0; 3]; 3];
        assert_eq!(Mesh::new(vec![], vec![[0; 3]]), Err(RigError::NoVertices));
        assert_eq!(Mesh::new(p.clone(), vec![]), Err(RigError::NoTriangles));
        assert!(matches!(Mesh::new(p, vec![[0, 1, 3]]), Err(RigError::VertexOutOfRange { vertex: 3, .. })));
        assert_eq!(Mesh::new(vec![[f32::INFINITY; 3]], vec![[0; 3]]), Err(RigError::VertexNotFinite(0)));
    }
}
