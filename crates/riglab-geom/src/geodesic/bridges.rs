//! Ways between pieces of a body that do not touch.

use super::body::Body;

/// Pairs of cells of different pieces and how far they are apart, in edges of a cell; by the first cell, each
/// pair from both sides.
pub(super) struct Bridges {
    ways: Vec<(u32, u32, f32)>,
    /// Whether a cell has any, a bit each.
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
        meetings.sort_unstable_by(|a, b| a.2.total_cmp(&b.2).then((a.0, a.1).cmp(&(b.0, b.1))));
        meetings.dedup_by(|a, b| (a.0, a.1) == (b.0, b.1));
        let mut groups = Groups::new(count);
        let mut joined: std::collections::HashMap<(u32, u32), f32> = std::collections::HashMap::new();
        for &(a, b, length) in &meetings {
            let pair = (pieces[a as usize], pieces[b as usize]);
            if groups.join(pair.0, pair.1) {
                joined.insert(pair, length);
            }
            let shortest = joined.get(&pair).or_else(|| joined.get(&(pair.1, pair.0)));
            if shortest.is_some_and(|s| length <= s + SLACK) {
                bridges.ways.extend([(a, b, length), (b, a, length)]);
            }
        }
        bridges.ways.sort_unstable_by_key(|a| (a.0, a.1));
        for (a, ..) in &bridges.ways {
            bridges.marked[*a as usize / 64] |= 1 << (a % 64);
        }
        bridges
    }

    /// The ways from a cell: to which, and how long.
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

/// The piece of each cell, and how many there are. Cells of a piece are reached across faces.
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
            for other in body.beside(body.place(cell)).into_iter().flatten() {
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

/// Where pieces meet that grow by layers: the cells they grew from, the lower piece's first.
fn meetings(body: &Body, pieces: &[u32], count: usize) -> Vec<(u32, u32, f32)> {
    let lattice = body.lattice();
    let low = body.at(glam::Vec3A::splat(f32::MIN));
    let index = |place: [u32; 3]| lattice.index(std::array::from_fn(|k| (place[k] - low[k]) as usize));
    let mut source = vec![u32::MAX; lattice.cells()];
    let mut front: Vec<[u32; 3]> = (0..body.len() as u32).map(|c| body.place(c)).collect();
    for (cell, place) in front.iter().enumerate() {
        source[index(*place)] = cell as u32;
    }
    let mut groups = Groups::new(count);
    let (mut apart, mut more) = (count - 1, SLACK as usize);
    let mut found = Vec::new();
    while !front.is_empty() {
        let mut next = Vec::new();
        for place in &front {
            let here = source[index(*place)];
            for (axis, up) in [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)] {
                let end = if up { low[axis] + lattice.size[axis] as u32 - 1 } else { low[axis] };
                if place[axis] == end {
                    continue;
                }
                let mut beside = *place;
                beside[axis] = if up { beside[axis] + 1 } else { beside[axis] - 1 };
                let there = &mut source[index(beside)];
                if *there == u32::MAX {
                    *there = here;
                    next.push(beside);
                } else if pieces[*there as usize] != pieces[here as usize] {
                    let ordered = pieces[*there as usize] < pieces[here as usize];
                    let (a, b) = if ordered { (*there, here) } else { (here, *there) };
                    found.push((a, b, (body.middle(a) - body.middle(b)).length()));
                    apart -= usize::from(groups.join(pieces[a as usize], pieces[b as usize]));
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

/// Sets that are joined.
struct Groups(Vec<u32>);

impl Groups {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn root(&mut self, mut at: u32) -> u32 {
        while self.0[at as usize] != at {
            let above = self.0[self.0[at as usize] as usize];
            self.0[at as usize] = above;
            at = above;
        }
        at
    }

    /// Whether they were apart.
    fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
        a != b
    }
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
        let lengths: Vec<f32> = (0..body.len() as u32).flat_map(|c| bridges.from(c).iter().map(|w| w.2)).collect();
        assert!(lengths.iter().all(|l| (3.0..=7.0).contains(l)), "{lengths:?}");
        assert_eq!(lengths.iter().filter(|l| **l == 3.0).count(), 10);
        assert_eq!(lengths.iter().filter(|l| **l == 5.0).count(), 10);
    }

    #[test]
    fn one_piece_needs_none() {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [4; 3] };
        let body = Body::new(&Voxels::new(lattice, [[0, 0, 0], [0, 0, 1]]));
        assert!(Bridges::new(&body).ways.is_empty());
        assert!(Bridges::new(&Body::new(&Voxels::new(lattice, []))).ways.is_empty());
    }
}
