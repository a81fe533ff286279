//! Edit distance of ordered trees.

use super::Joints;

/// Steps of the comparison at most: some seconds.
const MOST_STEPS: u64 = 2_000_000_000;

/// How many joints must be inserted or deleted to make one tree the other, children kept in order; names do not
/// matter. Children stand in the order of their numbers: see [`ordered_by_position`] for an order that does not
/// hang on the file. `None` where it takes too long: of two spines of a thousand joints with a leaf each, on this side and that.
///
/// Zhang and Shasha's algorithm, which finds what APTED finds, from the left or from the right, whichever is less work;
/// O(n² min(depth, leaves)²). Several roots stand side by side.
pub fn tree_edit_distance(a: &[Option<usize>], b: &[Option<usize>]) -> Option<usize> {
    // Trees have the same distance in the mirror.
    let sides = [false, true].map(|mirrored| [a, b].map(|tree| PostOrder::of(tree, mirrored)));
    let [a, b] = sides.into_iter().min_by_key(|[a, b]| a.work().saturating_mul(b.work()))?;
    (a.work().saturating_mul(b.work()) <= MOST_STEPS).then(|| distance(&a, &b))
}

fn distance(a: &PostOrder, b: &PostOrder) -> usize {
    let (n, m) = (a.leftmost.len(), b.leftmost.len());
    let mut trees = vec![0u32; n * m];
    let mut forest = vec![0u32; (n + 1) * (m + 1)];
    for &i in &a.keyroots {
        for &j in &b.keyroots {
            let (from, to) = (a.leftmost[i], b.leftmost[j]);
            let at = |x: usize, y: usize| x * (m + 1) + y;
            forest[at(0, 0)] = 0;
            for x in 1..=i + 1 - from {
                forest[at(x, 0)] = x as u32;
            }
            for y in 1..=j + 1 - to {
                forest[at(0, y)] = y as u32;
            }
            for x in 1..=i + 1 - from {
                for y in 1..=j + 1 - to {
                    let (p, q) = (from + x - 1, to + y - 1);
                    let either = 1 + forest[at(x - 1, y)].min(forest[at(x, y - 1)]);
                    let (left_p, left_q) = (a.leftmost[p], b.leftmost[q]);
                    forest[at(x, y)] = if left_p == from && left_q == to {
                        // Both are trees: renaming the root costs nothing.
                        let best = either.min(forest[at(x - 1, y - 1)]);
                        trees[p * m + q] = best;
                        best
                    } else {
                        either.min(forest[at(left_p - from, left_q - to)] + trees[p * m + q])
                    };
                }
            }
        }
    }
    trees.last().map_or(n.max(m), |d| *d as usize)
}

/// A tree with its nodes after their children.
struct PostOrder {
    /// Of each node, the first node of its subtree.
    leftmost: Vec<usize>,
    /// Nodes that have an elder sibling, and the root.
    keyroots: Vec<usize>,
}

impl PostOrder {
    /// Parents may stand in any order; what hangs in a circle is left out. In the mirror the youngest child comes first.
    fn of(parents: &[Option<usize>], mirrored: bool) -> Self {
        // A root above all, so that there is one tree; equal on both sides, it costs nothing.
        let top = parents.len();
        let mut children = vec![Vec::new(); top + 1];
        for (joint, parent) in parents.iter().enumerate() {
            children[parent.filter(|p| *p < top).unwrap_or(top)].push(joint);
        }
        if mirrored {
            children.iter_mut().for_each(|below| below.reverse());
        }
        let (mut leftmost, mut keyroots) = (Vec::new(), Vec::new());
        let mut open = vec![(top, 0, 0, true)];
        while let Some((node, next, first, eldest)) = open.pop() {
            if next == 0 {
                // Its subtree begins with what is written next.
                open.push((node, 1, leftmost.len(), eldest));
                for (k, &child) in children[node].iter().enumerate().rev() {
                    open.push((child, 0, 0, k == 0));
                }
            } else {
                if !eldest || node == top {
                    keyroots.push(leftmost.len());
                }
                leftmost.push(first);
            }
        }
        Self { leftmost, keyroots }
    }

    /// How many nodes are gone through, over all subtrees that are compared as such.
    fn work(&self) -> u64 {
        self.keyroots.iter().map(|&i| (i + 1 - self.leftmost[i]) as u64).sum()
    }
}

/// The parents of a skeleton renumbered so that children stand by position (z, y, x), as riglab compares trees:
/// the same skeleton with joints in another order has distance 0.
pub fn ordered_by_position(joints: &Joints) -> Vec<Option<usize>> {
    let mut order: Vec<usize> = (0..joints.positions.len()).collect();
    let key = |j: usize| joints.positions[j];
    order.sort_by(|&a, &b| {
        let (a, b) = (key(a), key(b));
        a[2].total_cmp(&b[2]).then(a[1].total_cmp(&b[1])).then(a[0].total_cmp(&b[0]))
    });
    let mut place = vec![0; order.len()];
    order.iter().enumerate().for_each(|(at, &j)| place[j] = at);
    order.iter().map(|&j| joints.parents[j].map(|p| place[p])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(parents: &[i32]) -> Vec<Option<usize>> {
        parents.iter().map(|&p| usize::try_from(p).ok()).collect()
    }

    #[test]
    fn joints_put_in_and_taken_out_are_counted() {
        let chain = tree(&[-1, 0, 1, 2]);
        assert_eq!(tree_edit_distance(&chain, &chain), Some(0));
        assert_eq!(tree_edit_distance(&chain, &tree(&[-1, 0, 1])), Some(1));
        // A chain of four and a star of four have a chain of two in common.
        assert_eq!(tree_edit_distance(&chain, &tree(&[-1, 0, 0, 0])), Some(4));
        assert_eq!(tree_edit_distance(&[], &chain), Some(4));
    }

    #[test]
    fn the_order_of_children_counts_until_it_is_made_equal() {
        let (leaf_first, leaf_last) = (tree(&[-1, 0, 0, 2]), tree(&[-1, 0, 1, 0]));
        assert_eq!(tree_edit_distance(&leaf_first, &leaf_last), Some(2));
        let place = |order: [usize; 4], parents: &[Option<usize>]| Joints {
            positions: order.map(|p| [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]][p]).to_vec(),
            parents: parents.to_vec(),
        };
        let a = ordered_by_position(&place([0, 1, 2, 3], &leaf_first));
        let b = ordered_by_position(&place([0, 2, 3, 1], &leaf_last));
        assert_eq!(tree_edit_distance(&a, &b), Some(0));
    }

    #[test]
    fn circles_and_parents_out_of_range_do_not_hang() {
        let circle = [Some(1), Some(0), Some(7), None];
        assert_eq!(tree_edit_distance(&circle, &tree(&[-1, -1])), Some(0));
    }

    /// A spine whose joints have a leaf each, as an elder sibling of the spine's next joint or as a younger one.
    fn comb(joints: usize, elder: impl Fn(usize) -> bool) -> Vec<Option<usize>> {
        let mut parents = vec![None];
        let mut spine = 0;
        while parents.len() < joints {
            parents.extend([Some(spine); 2]);
            spine = parents.len() - if elder(parents.len() / 2) { 1 } else { 2 };
        }
        parents
    }

    #[test]
    fn it_goes_by_the_side_that_is_less_work_and_gives_up_what_takes_too_long() {
        for elder in [true, false] {
            let (whole, short) = (comb(1401, |_| elder), comb(1399, |_| elder));
            assert_eq!(tree_edit_distance(&whole, &short), Some(2));
        }
        assert_eq!(tree_edit_distance(&comb(31, |k| k % 2 == 0), &comb(27, |k| k % 2 == 0)), Some(4));
        let alternating = comb(1401, |k| k % 2 == 0);
        assert_eq!(tree_edit_distance(&alternating, &alternating), None);
    }
}
