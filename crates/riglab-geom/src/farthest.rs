//! Farthest point sampling.

use riglab_core::Vec3;

/// Picks `count` of `points`, each the farthest from those picked before, beginning with `first`.
///
/// Distances are squared, and the first of equal ones wins. More picks than distinct points repeat
/// points; `points` must not be empty unless `count` is 0.
pub fn farthest_points(points: &[Vec3], count: usize, first: usize) -> Vec<usize> {
    let mut picks = Vec::with_capacity(count);
    let mut nearest = vec![f32::INFINITY; points.len()];
    let mut next = first;
    while picks.len() < count {
        picks.push(next);
        let p = points[next];
        let mut best = (0, -1.0);
        for (i, (d, q)) in nearest.iter_mut().zip(points).enumerate() {
            let delta = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
            *d = d.min(delta[0] * delta[0] + delta[1] * delta[1] + delta[2] * delta[2]);
            if *d > best.1 {
                best = (i, *d);
            }
        }
        next = best.0;
    }
    picks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_spread_out_and_the_first_of_equals_wins() {
        let points = [0.0, 1.0, 9.0, 10.0, 5.0].map(|x| [x, 0.0, 0.0]);
        assert_eq!(farthest_points(&points, 4, 0), [0, 3, 4, 1]);
        assert!(farthest_points(&points, 0, 0).is_empty());
        assert_eq!(farthest_points(&[[1.0; 3]; 2], 3, 1), [1, 0, 0]);
    }
}
