//! The points of many that lie nearest to some others.

use riglab_core::Vec3;

use crate::near::{Axes, BLOCK, axes, nearest, to_boxes};

/// Points in blocks of neighbours, with the box around each: what is far from all that is asked for is not measured.
pub struct Blocks {
    /// Which point is where, [`BLOCK`] in a block; the last block may have fewer.
    order: Vec<u32>,
    /// The points of each block.
    points: Vec<Axes>,
    /// The boxes of [`BLOCK`] blocks after another: smallest and largest coordinates.
    boxes: Vec<[Axes; 2]>,
}

impl Blocks {
    /// Of finite points.
    pub fn new(points: &[Vec3]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        halve(points, &mut order);
        let own: Vec<Vec<Vec3>> =
            order.chunks(BLOCK).map(|block| block.iter().map(|&v| points[v as usize]).collect()).collect();
        let bounds: Vec<[Vec3; 2]> = own.iter().map(|points| bounds(points.iter().copied())).collect();
        let side = |bounds: &[[Vec3; 2]], k: usize| axes(&bounds.iter().map(|b| b[k]).collect::<Vec<_>>());
        let boxes = bounds.chunks(BLOCK).map(|bounds| [side(bounds, 0), side(bounds, 1)]).collect();
        Self { points: own.iter().map(|points| axes(points)).collect(), order, boxes }
    }

    /// The numbers of the `count` points that lie nearest to any of `others`, ascending; of equally near ones the first.
    /// `except`: numbers of points that are left out.
    pub fn nearest(&self, others: &[Vec3], except: &[u32], count: usize) -> Vec<u32> {
        if count == 0 || others.is_empty() {
            return Vec::new();
        }
        let mut left_out = vec![false; self.order.len()];
        except.iter().for_each(|&v| left_out[v as usize] = true);
        // Squares are positive numbers, whose bits are in their order; behind them what they are of.
        let key = |square: f32, number: usize| u64::from(square.to_bits()) << 32 | number as u64;
        let bounds = self.boxes.iter().flat_map(|[low, high]| to_boxes(low, high, others));
        let mut blocks: Vec<u64> =
            bounds.take(self.points.len()).enumerate().map(|(b, square)| key(square, b)).collect();
        blocks.sort_unstable();
        let (mut found, mut limit, mut enough) = (Vec::with_capacity(2 * count + BLOCK), u64::MAX, count);
        for key_of_block in blocks {
            // Sums of squares of what is smaller are smaller as they are rounded, too: none of this block is nearer.
            if key_of_block >> 32 > limit >> 32 {
                break;
            }
            let block = key_of_block as u32 as usize;
            let order = &self.order[BLOCK * block..self.order.len().min(BLOCK * (block + 1))];
            if order.iter().all(|&v| left_out[v as usize]) {
                continue;
            }
            let squares = nearest(&self.points[block], others);
            let keys =
                order.iter().zip(squares).filter(|(v, _)| !left_out[**v as usize]).map(|(&v, d)| key(d, v as usize));
            found.extend(keys.filter(|key| *key < limit));
            if found.len() >= enough {
                limit = *found.select_nth_unstable(count - 1).1 + 1;
                found.truncate(count);
                enough = 2 * count;
            }
        }
        if found.len() > count {
            found.select_nth_unstable(count - 1);
            found.truncate(count);
        }
        let mut numbers: Vec<u32> = found.into_iter().map(|key| key as u32).collect();
        numbers.sort_unstable();
        numbers
    }
}

/// Smallest and largest coordinates.
fn bounds(points: impl Iterator<Item = Vec3>) -> [Vec3; 2] {
    let none = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    points.fold(none, |[low, high], p| {
        [[0, 1, 2].map(|axis| low[axis].min(p[axis])), [0, 1, 2].map(|axis| high[axis].max(p[axis]))]
    })
}

/// Puts neighbours beside each other: cut in two where the box is longest, at a whole number of blocks, and so each part.
fn halve(points: &[Vec3], order: &mut [u32]) {
    if order.len() <= BLOCK {
        return;
    }
    let [low, high] = bounds(order.iter().map(|&v| points[v as usize]));
    let length = |axis: usize| high[axis] - low[axis];
    let axis = (0..3).fold(0, |longest, axis| if length(axis) > length(longest) { axis } else { longest });
    let middle = order.len().div_ceil(BLOCK).div_ceil(2) * BLOCK;
    order.select_nth_unstable_by(middle, |&a, &b| points[a as usize][axis].total_cmp(&points[b as usize][axis]));
    let (left, right) = order.split_at_mut(middle);
    halve(points, left);
    halve(points, right);
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn the_nearest_are_those_of_all_that_were_measured() {
        let random = &mut stream(1, "nearest", &[]);
        // Neighbours in number that are neighbours in place, as along a curve, and some that are not; many equally near.
        for scattered in [0.0, 0.05, 3.0] {
            let n = 2_500;
            let points: Vec<Vec3> = (0..n)
                .map(|k| {
                    let turn = k as f32 * 0.01;
                    let off: [f32; 3] = [0; 3].map(|_: i32| random.normal() * scattered);
                    [turn.cos() + off[0], turn.sin() + off[1], (0.1 * turn + off[2]).round()]
                })
                .collect();
            let blocks = Blocks::new(&points);
            assert!(blocks.order.len() == n && blocks.points.len() == n.div_ceil(BLOCK));
            for (count, others) in [(1, 1), (40, 3), (700, 64), (n, 5), (3 * n, 2)] {
                let first = random.below(n - others);
                let others: Vec<Vec3> = (0..others).map(|k| points[first + k]).collect();
                let except: Vec<u32> =
                    (0..n as u32).filter(|_| random.chance(0.3)).chain(first as u32..n as u32).collect();
                let square = |p: &Vec3| {
                    let each = others.iter().map(|o| {
                        let [x, y, z] = [0, 1, 2].map(|axis| o[axis] - p[axis]);
                        x * x + y * y + z * z
                    });
                    each.fold(f32::INFINITY, f32::min)
                };
                let mut all: Vec<(f32, u32)> =
                    (0u32..).zip(&points).filter(|(v, _)| !except.contains(v)).map(|(v, p)| (square(p), v)).collect();
                all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let mut want: Vec<u32> = all.into_iter().take(count).map(|(_, v)| v).collect();
                want.sort_unstable();
                assert_eq!(blocks.nearest(&others, &except, count), want, "{count} of {scattered}");
            }
        }
        let blocks = Blocks::new(&[]);
        assert!(blocks.nearest(&[[0.0; 3]], &[], 3).is_empty());
        assert!(Blocks::new(&[[0.0; 3]]).nearest(&[], &[], 3).is_empty());
    }
}
