//! Farthest point sampling.

use multiversion::multiversion;
use riglab_core::Vec3;

/// Picks `count` of `points`, each the farthest from those picked before, beginning with `first`.
///
/// Distances are squared, and the first of equal ones wins. More picks than distinct points repeat
/// points; `points` must not be empty unless `count` is 0.
pub fn farthest_points(points: &[Vec3], count: usize, first: usize) -> Vec<usize> {
    let mut picks = Vec::with_capacity(count);
    let mut blocks: Vec<Block> = points.chunks(BLOCK).map(Block::new).collect();
    let mut next = first;
    while picks.len() < count {
        picks.push(next);
        let p = points[next];
        next = farthest(&mut blocks, p);
    }
    picks
}

/// Points that are worked on at once, so that the compiler takes several in an instruction.
const BLOCK: usize = 32;

/// Some points with the squared distances to the nearest of those picked; places behind the last point have -1.
struct Block {
    axes: [[f32; BLOCK]; 3],
    nearest: [f32; BLOCK],
}

impl Block {
    fn new(points: &[Vec3]) -> Self {
        let mut block = Self { axes: [[0.0; BLOCK]; 3], nearest: [-1.0; BLOCK] };
        for (k, p) in points.iter().enumerate() {
            (0..3).for_each(|axis| block.axes[axis][k] = p[axis]);
            block.nearest[k] = f32::INFINITY;
        }
        block
    }
}

/// Counts a pick; gives the number of the first of the points that are farthest from all picks. By the widest instructions there
/// are; the values are the same.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn farthest(blocks: &mut [Block], p: Vec3) -> usize {
    // Lane against lane: the compiler does not reorder what it takes for sums.
    let mut most = [-1.0f32; BLOCK];
    for block in &mut *blocks {
        for (k, (nearest, most)) in block.nearest.iter_mut().zip(&mut most).enumerate() {
            let [x, y, z] = [0, 1, 2].map(|axis| block.axes[axis][k] - p[axis]);
            let square = x * x + y * y + z * z;
            // Not `min`, which asks about NaN.
            *nearest = if square < *nearest { square } else { *nearest };
            *most = if *nearest > *most { *nearest } else { *most };
        }
    }
    let most = most.into_iter().fold(-1.0, |most: f32, lane| if lane > most { lane } else { most });
    for (start, block) in (0..).step_by(BLOCK).zip(blocks) {
        if block.nearest.iter().fold(false, |any, d| any | (*d == most)) {
            return start + block.nearest.iter().position(|d| *d == most).unwrap_or(0);
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn picks_spread_out_and_the_first_of_equals_wins() {
        let points = [0.0, 1.0, 9.0, 10.0, 5.0].map(|x| [x, 0.0, 0.0]);
        assert_eq!(farthest_points(&points, 4, 0), [0, 3, 4, 1]);
        assert!(farthest_points(&points, 0, 0).is_empty());
        assert_eq!(farthest_points(&[[1.0; 3]; 2], 3, 1), [1, 0, 0]);
    }

    #[test]
    fn blocks_pick_what_one_after_another_would() {
        let random = &mut stream(1, "farthest", &[]);
        for n in [1, 31, 32, 33, 200] {
            // On a lattice, so that many are equally far.
            let points: Vec<Vec3> = (0..n).map(|_| [0; 3].map(|_: i32| random.below(4) as f32)).collect();
            let (mut nearest, mut next, mut want) = (vec![f32::INFINITY; n], n / 2, Vec::new());
            for _ in 0..40 {
                want.push(next);
                let mut best = (0, -1.0);
                for (k, q) in points.iter().enumerate() {
                    let square = (0..3).map(|axis| (q[axis] - points[next][axis]).powi(2)).sum::<f32>();
                    nearest[k] = square.min(nearest[k]);
                    if nearest[k] > best.1 {
                        best = (k, nearest[k]);
                    }
                }
                next = best.0;
            }
            assert_eq!(farthest_points(&points, 40, n / 2), want);
        }
    }
}
