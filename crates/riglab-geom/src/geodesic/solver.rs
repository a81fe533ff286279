//! Distances from many bones to many points of one body.

use rayon::prelude::*;
use riglab_core::{Mesh, Segment, Vec3};

use super::body::Body;
use super::bridges::Bridges;
use super::search::{Bone, Search};
use crate::voxel::{SolidConfig, Voxels, solid};

/// A body prepared for distances along ways through its inside.
///
/// A way goes straight where it can and turns at cells, one for each block of 2³, so that it is as long as in the
/// body itself but for less than two cells; distances along edges of a lattice's graph are up to three quarters
/// longer. What is not
/// connected hangs together by bridges from piece to piece, the nearest first: eyes, hair and buttons are
/// as far as where they sit, with the gap. A bone that runs through no cell starts at the cell
/// nearest to it, with the way there.
pub struct GeodesicSolver {
    body: Body,
    bridges: Bridges,
}

impl GeodesicSolver {
    /// Of a mesh's body.
    pub fn new(mesh: &Mesh, config: &SolidConfig) -> Self {
        Self::of(&solid(mesh, config))
    }

    /// Of given cells. Without any, all distances are straight.
    pub fn of(voxels: &Voxels) -> Self {
        let body = Body::new(voxels);
        let bridges = Bridges::new(&body);
        Self { body, bridges }
    }

    /// Distances from each bone, which is some segments, to each point, a row a bone: B × N, in the mesh's
    /// units, all finite. A point outside of the body counts from the cell nearest to it. A bone without
    /// segments is as far from everything as the lattice's longest way.
    pub fn distances<B: AsRef<[Segment]> + Sync>(&self, bones: &[B], points: &[Vec3]) -> Vec<f32> {
        let mut out = vec![0.0; bones.len() * points.len()];
        if points.is_empty() {
            return out;
        }
        let homes: Vec<(Option<u32>, glam::Vec3A)> = points.par_iter().map(|p| self.home(*p)).collect();
        let cell = self.body.lattice().cell;
        let rows = out.par_chunks_exact_mut(points.len()).zip(bones);
        rows.for_each_init(Search::default, |search, (row, segments)| {
            let bone = Bone::new(segments.as_ref(), &self.body);
            search.run(&self.body, &self.bridges, &bone);
            for (d, (home, p)) in row.iter_mut().zip(&homes) {
                let length = match home {
                    Some(home) => search.length(&self.body, &bone, *home, *p),
                    None => bone.distance(*p),
                };
                let most = self.body.lattice().cells() as f32;
                *d = (f64::from(if length.is_finite() { length } else { most }) * cell).min(f64::from(f32::MAX)) as f32;
            }
        });
        out
    }

    /// The node of a point's cell, or the one nearest to it.
    fn home(&self, p: Vec3) -> (Option<u32>, glam::Vec3A) {
        let inner = self.body.inner(p);
        let place = self.body.at(inner);
        if let Some(node) = self.body.node(place).or_else(|| self.nearby(place, inner)) {
            return (Some(node), inner);
        }
        let far = |n: &u32| (self.body.middle(*n) - inner).length_squared();
        let nearest = (0..self.body.len() as u32).min_by(|a, b| far(a).total_cmp(&far(b)));
        (nearest, inner)
    }

    /// The node of the nearest occupied cell among those around an empty one.
    fn nearby(&self, [x, y, z]: [u32; 3], p: glam::Vec3A) -> Option<u32> {
        let places = (0..27).map(|s: u32| [x + s / 9 - 1, y + s / 3 % 3 - 1, z + s % 3 - 1]);
        let far = |q: &[u32; 3]| (glam::Vec3A::from(q.map(|x| x as f32)) - p).length_squared();
        let occupied = places.filter(|q| self.body.has(*q));
        occupied.min_by(|a, b| far(a).total_cmp(&far(b))).and_then(|q| self.body.node(q))
    }
}
