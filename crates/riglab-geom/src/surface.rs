//! Points drawn from a mesh's surface, uniformly by area or by its square.

use std::borrow::Cow;

use glam::Vec3;
use riglab_core::{Mesh, SkinWeights};
use riglab_random::{Draw, Stream};

use crate::cloud::By;
use crate::draws::{self, folded};

/// A point on a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Which triangle.
    pub triangle: u32,
    /// Shares of its corners; they sum to 1.
    pub barycentric: [f32; 3],
}

/// Draws points of one mesh; keeps the areas summed up.
pub struct SurfaceSampler<'a> {
    mesh: &'a Mesh,
    /// Running sum of areas, or of their squares; the last one is all of them.
    sums: Cow<'a, [f64]>,
}

/// Shares of a triangle's corners, uniform over its area. Takes two numbers from the stream.
pub fn barycentric(random: &mut Stream) -> [f32; 3] {
    draws::barycentric(folded([random.unit(), random.unit()]))
}

impl<'a> SurfaceSampler<'a> {
    /// Sums up the areas. A mesh without any area gives all triangles the same share.
    pub fn new(mesh: &'a Mesh) -> Self {
        Self::by(mesh, By::Area)
    }

    /// As [`Self::new`], of what triangles are weighted by.
    pub fn by(mesh: &'a Mesh, by: By) -> Self {
        let n = mesh.triangles().len();
        let mut sums: Vec<f64> = Vec::with_capacity(n);
        let mut sum = 0.0;
        for t in 0..n {
            sum += by.weight(Vec3::from(mesh.area_vector(t)).length());
            sums.push(sum);
        }
        if !(sum > 0.0 && sum.is_finite()) {
            sums = (1..=n).map(|t| t as f64).collect();
        }
        Self { mesh, sums: sums.into() }
    }

    /// With areas summed up before, by [`Self::into_sums`] on the same mesh.
    pub fn with_sums(mesh: &'a Mesh, sums: &'a [f64]) -> Self {
        Self { mesh, sums: sums.into() }
    }

    /// The running sums of areas.
    pub fn into_sums(self) -> Vec<f64> {
        self.sums.into_owned()
    }

    /// One point. Takes four numbers from the stream.
    pub fn draw(&self, random: &mut Stream) -> SurfacePoint {
        let total = self.sums[self.sums.len() - 1];
        let at = f64::from(random.unit()) * total + f64::from(random.unit()) * total * 2f64.powi(-24);
        let triangle = self.sums.partition_point(|&s| s <= at).min(self.sums.len() - 1) as u32;
        SurfacePoint { triangle, barycentric: barycentric(random) }
    }

    /// The point of given draws in [0, 1): a share of the surface, and two numbers for the place on the
    /// triangle there.
    pub fn at(&self, share: f64, on_it: [f32; 2]) -> SurfacePoint {
        let at = share * self.sums[self.sums.len() - 1];
        let triangle = self.sums.partition_point(|&s| s <= at).min(self.sums.len() - 1) as u32;
        SurfacePoint { triangle, barycentric: draws::barycentric(folded(on_it)) }
    }

    /// Its position.
    pub fn position(&self, p: &SurfacePoint) -> [f32; 3] {
        let [a, b, c] = self.mesh.corners(p.triangle as usize).map(Vec3::from);
        let [u, v, w] = p.barycentric;
        (a * u + b * v + c * w).into()
    }

    /// The normal of its triangle; +y where that has no area.
    pub fn normal(&self, p: &SurfacePoint) -> [f32; 3] {
        Vec3::from(self.mesh.area_vector(p.triangle as usize)).try_normalize().unwrap_or(Vec3::Y).into()
    }

    /// Its skinning weights: those of the corners, by their shares; joints rising.
    pub fn weights(&self, p: &SurfacePoint, weights: &SkinWeights) -> Vec<(u16, f32)> {
        let corners = self.mesh.triangles()[p.triangle as usize];
        let mut row: Vec<(u16, f32)> = Vec::with_capacity(8);
        for (&corner, share) in corners.iter().zip(p.barycentric) {
            for (joint, w) in weights.row(corner as usize) {
                match row.iter_mut().find(|(j, _)| *j == joint.0) {
                    Some((_, sum)) => *sum += share * w,
                    None => row.push((joint.0, share * w)),
                }
            }
        }
        row.sort_unstable_by_key(|(j, _)| *j);
        row
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;

    fn two_triangles() -> Mesh {
        // Areas 1/2 and 3/2.
        let p =
            vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        Mesh::new(p, vec![[0, 1, 2], [3, 4, 5]]).unwrap()
    }

    #[test]
    fn triangles_are_hit_by_their_area() {
        let mesh = two_triangles();
        let sampler = SurfaceSampler::new(&mesh);
        let mut random = stream(1, "test", &[]);
        let points: Vec<_> = (0..4000).map(|_| sampler.draw(&mut random)).collect();
        let second = points.iter().filter(|p| p.triangle == 1).count();
        assert!((2900..3100).contains(&second), "{second}");
        for p in &points {
            let [x, y, z] = sampler.position(p);
            assert!(x >= 0.0 && y >= 0.0 && (z == 0.0 || z == 1.0));
            assert!((p.barycentric.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
        assert_eq!(sampler.normal(&points[0]), [0.0, 0.0, 1.0]);
        // By its square nine in ten lie on the larger one.
        let squared = SurfaceSampler::by(&mesh, By::SquaredArea);
        let second = (0..4000).filter(|_| squared.draw(&mut random).triangle == 1).count();
        assert!((3500..3700).contains(&second), "{second}");
    }

    #[test]
    fn weights_are_interpolated() {
        let mesh = two_triangles();
        let weights = SkinWeights::normalized((0..6).map(|v| vec![(v as u16 % 2, 1.0)])).unwrap();
        let point = SurfacePoint { triangle: 0, barycentric: [0.5, 0.25, 0.25] };
        assert_eq!(SurfaceSampler::new(&mesh).weights(&point, &weights), [(0, 0.75), (1, 0.25)]);
    }

    #[test]
    fn a_mesh_without_area_still_gives_points() {
        let mesh = Mesh::new(vec![[1.0; 3]; 3], vec![[0, 1, 2], [0, 0, 0]]).unwrap();
        let sampler = SurfaceSampler::new(&mesh);
        let p = sampler.draw(&mut stream(1, "test", &[]));
        assert_eq!((sampler.position(&p), sampler.normal(&p)), ([1.0; 3], [0.0, 1.0, 0.0]));
    }
}
