//! Ways between pieces of a body that do not touch.

use super::body::Body;
use crate::pieces::Groups;

/// Pairs of nodes of different pieces and how far they are apart, in edges of a cell; by the first, each pair from
/// both sides.
pub(super) struct Bridges {
    ways: Vec<(u32, u32, f32)>,
    /// Whether a node has any, a bit each.
    marked: Vec<u64>,
}

/// Besides the shortest way between two pieces, those that are longer by so much count.
const SLACK: f32 = 2.0;

impl Bridges {
    /// Joins pieces, the nearest first, until there is one body.
    ///
    /// Pieces grow by layers into the empty cells until all have met; between two that are joined, all ways
    /// count that are hardly longer than the shortest: a shirt around a body hangs on it everywhere.
    pub(super) fn new(body: &Body) -> Self {
        let mut bridges = Self { ways: Vec::new(), marked: vec![0; body.len().div_ceil(64)] };
        let (pieces, count) = pieces(body);
        if count < 2 {
            return bridges;
        }
        let mut meetings = meetings(body, &pieces, count);
        // By their length; ties by the cells, so that the result is always the same.
        meetings.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        meetings.dedup_by(|a, b| (a.0, a.1) == (b.0, b.1));
        meetings.sort_by(|a, b| a.2.total_cmp(&b.2));
        let mut groups = Groups::new(count);
        let mut joined: std::collections::HashMap<(u32, u32), f32> = std::collections::HashMap::new();
        for &(a, b, gap) in &meetings {
            let pair = (pieces[a as usize], pieces[b as usize]);
            if groups.join(pair.0, pair.1) {
                joined.insert(pair, gap);
            }
            let shortest = joined.get(&pair).or_else(|| joined.get(&(pair.1, pair.0)));
            if shortest.is_some_and(|s| gap <= s + SLACK) {
                let length = (body.middle(a) - body.middle(b)).length();
                bridges.ways.extend([(a, b, length), (b, a, length)]);
            }
        }
        bridges.ways.sort_unstable_by_key(|a| (a.0, a.1));
        for (a, ..) in &bridges.ways {
            bridges.marked[*a as usize / 64] |= 1 << (a % 64);
        }
        bridges
    }

    /// The ways from a node: to which, and how long.
    #[inline]
    pub(super) fn from(&self, cell: u32) -> &[(u32, u32, f32)] {
        if self.marked[cell as usize / 64] >> (cell % 64) & 1 == 0 {
            return &[];
        }
        let start = self.ways.partition_point(|w| w.0 < cell);
        let count = self.ways[start..].iter().take_while(|w| w.0 == cell).count();
        &self.ways[start..start + count]
    }
}

/// The piece of each node, and how many there are. Nodes of a piece are reached across faces.
fn pieces(body: &Body) -> (Vec<u32>, usize) {
    let mut pieces = vec![u32::MAX; body.len()];
    let (mut count, mut left) = (0, Vec::new());
    for first in 0..body.len() as u32 {
        if pieces[first as usize] != u32::MAX {
            continue;
        }
        pieces[first as usize] = count;
        left.push(first);
        while let Some(cell) = left.pop() {
            for other in body.beside(cell) {
                if pieces[other as usize] == u32::MAX {
                    pieces[other as usize] = count;
                    left.push(other);
                }
            }
        }
        count += 1;
    }
    (pieces, count as usize)
}

/// Where pieces meet that grow by layers: the nodes of the cells they grew from, the lower piece's first, and how far
/// those cells are apart.
fn meetings(body: &Body, pieces: &[u32], count: usize) -> Vec<(u32, u32, f32)> {
    let lattice = body.lattice();
    let low = body.at(glam::Vec3A::splat(f32::MIN));
    let index = |place: [u32; 3]| lattice.index(std::array::from_fn(|k| (place[k] - low[k]) as usize));
    let place = |index: u32| -> [u32; 3] {
        let place = lattice.place(index as usize);
        std::array::from_fn(|k| place[k] as u32 + low[k])
    };
    // The cell that each grew from.
    let mut source = vec![u32::MAX; lattice.cells()];
    let mut front: Vec<[u32; 3]> = body.occupied().collect();
    for place in &front {
        source[index(*place)] = index(*place) as u32;
    }
    let mut groups = Groups::new(count);
    let (mut apart, mut more) = (count - 1, SLACK as usize);
    let mut found = Vec::new();
    while !front.is_empty() {
        let mut next = Vec::new();
        for at in &front {
            let here = source[index(*at)];
            for (axis, up) in [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)] {
                let end = if up { low[axis] + lattice.size[axis] as u32 - 1 } else { low[axis] };
                if at[axis] == end {
                    continue;
                }
                let mut beside = *at;
                beside[axis] = if up { beside[axis] + 1 } else { beside[axis] - 1 };
                let there = &mut source[index(beside)];
                if *there == u32::MAX {
                    *there = here;
                    next.push(beside);
                } else if *there != here {
                    let [p, q] = [here, *there].map(place);
                    let [Some(a), Some(b)] = [p, q].map(|p| body.node(p)) else { continue };
                    if pieces[a as usize] != pieces[b as usize] {
                        let gap = (0..3).map(|k| p[k].abs_diff(q[k]).pow(2)).sum::<u32>() as f32;
                        let (low, high) = if pieces[a as usize] < pieces[b as usize] { (a, b) } else { (b, a) };
                        found.push((low, high, gap.sqrt()));
                        apart -= usize::from(groups.join(pieces[a as usize], pieces[b as usize]));
                    }
                }
            }
        }
        front = next;
        if apart == 0 {
            if more == 0 {
                break;
            }
            more -= 1;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::voxel::{Lattice, Voxels};

    #[test]
    fn pieces_hang_on_their_nearest() {
        // Three bars: at x = 0, 3 and 8; the outer ones on the middle one, not on each other.
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [9, 1, 5] };
        let body = Body::new(&Voxels::new(lattice, (0..5).flat_map(|z| [0, 3, 8].map(|x| [x, 0, z]))));
        let bridges = Bridges::new(&body);
        let ways = |x: u32, y: u32| {
            let of = |c: u32| body.place(c)[0] - body.place(0)[0];
            let from = (0..body.len() as u32).filter(|c| of(*c) == x);
            from.flat_map(|c| bridges.from(c)).filter(|w| of(w.1) == y).count()
        };
        // Each bar is three nodes; ways lead across and aslant.
        assert!(ways(0, 3) >= 3 && ways(3, 0) == ways(0, 3) && ways(3, 8) >= 3);
        assert_eq!((ways(0, 8), ways(8, 0)), (0, 0));
    }

    #[test]
    fn one_piece_needs_none() {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [4; 3] };
        let body = Body::new(&Voxels::new(lattice, [[0, 0, 0], [0, 0, 1]]));
        assert!(Bridges::new(&body).ways.is_empty());
        assert!(Bridges::new(&Body::new(&Voxels::new(lattice, []))).ways.is_empty());
    }
}
