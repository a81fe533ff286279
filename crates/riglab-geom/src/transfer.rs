//! What is known at points of a cloud, told for other points.

use rayon::prelude::*;
use riglab_core::Vec3;
use rstar::primitives::GeomWithData;
use rstar::{DefaultParams, RTree};

/// Keeps a point of the cloud itself finite (as released).
const EPS: f64 = 1e-8;

/// Points of a cloud, to be asked for those around a place.
pub struct Transfer {
    tree: RTree<GeomWithData<[f64; 3], u32>, DefaultParams>,
    count: usize,
}

impl Transfer {
    /// Of a cloud; each place is told by its `count` nearest points (SkinTokens' release: 8).
    pub fn new(points: &[Vec3], count: usize) -> Self {
        let each = points.iter().zip(0u32..).map(|(p, k)| GeomWithData::new(p.map(f64::from), k));
        Self { tree: RTree::bulk_load(each.collect()), count }
    }

    /// Of each place, the nearest points with shares that sum to 1: the inverse of their distances.
    pub fn shares(&self, places: &[Vec3]) -> Vec<Vec<(u32, f32)>> {
        places.par_iter().map(|p| self.share(p.map(f64::from))).collect()
    }

    fn share(&self, p: [f64; 3]) -> Vec<(u32, f32)> {
        let near = self.tree.nearest_neighbor_iter_with_distance_2(p).take(self.count);
        let near: Vec<(u32, f64)> = near.map(|(point, square)| (point.data, 1.0 / (square.sqrt() + EPS))).collect();
        let sum: f64 = near.iter().map(|(_, w)| w).sum();
        near.into_iter().map(|(k, w)| (k, (w / sum) as f32)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_told_by_what_is_near() {
        let points: Vec<Vec3> = (0..100).map(|i| [i as f32, 0.0, 0.0]).collect();
        let shares = Transfer::new(&points, 2).shares(&[[10.25, 0.0, 0.0], [7.0, 0.0, 0.0]]);
        assert_eq!(shares[0].iter().map(|s| s.0).collect::<Vec<_>>(), [10, 11]);
        assert!((shares[0][0].1 - 0.75).abs() < 1e-6);
        assert!(shares[1][0].0 == 7 && shares[1][0].1 > 0.999);
    }

    #[test]
    fn many_points_in_one_place_and_few_in_all_do_no_harm() {
        let same = vec![[1.0f32; 3]; 1000];
        let sum: f32 = Transfer::new(&same, 8).shares(&[[0.0; 3]])[0].iter().map(|s| s.1).sum();
        assert!((sum - 1.0).abs() < 1e-5);
        assert_eq!(Transfer::new(&same[..3], 8).shares(&[[0.0; 3]])[0].len(), 3);
        assert!(Transfer::new(&[], 8).shares(&[[0.0; 3]])[0].is_empty());
    }
}
