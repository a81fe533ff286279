//! Which of many rigs are the same.
//!
//! Candidates are found in a grid over four of a description's numbers with cells a few tolerances wide: a
//! rig is looked for in the cells that its numbers, give or take the tolerance, fall into. The cost of each
//! is that of the few rigs that are there, however many there are in all. (A tree such as `kiddo`'s limits
//! how many points of one place it takes, and duplicates are points of one place.)

use std::collections::HashMap;

use crate::shape::{KEYS, Shape};

/// Cells are so many tolerances wide: wider means more rigs in a cell, narrower more cells to look into.
const CELL: f32 = 6.0;

/// The groups of rigs that are the same, each of two or more, by number and rising, and the largest distance
/// of each to its first. Rigs a, b and c are one group if a is near b and b near c.
pub fn groups(shapes: &[Shape], tolerance: f32) -> Vec<Vec<usize>> {
    let mut sets = Sets::new(shapes.len());
    for (a, b) in pairs(shapes, tolerance) {
        sets.join(a, b);
    }
    let mut of: HashMap<usize, Vec<usize>> = HashMap::new();
    for i in 0..shapes.len() {
        of.entry(sets.first(i)).or_default().push(i);
    }
    let mut groups: Vec<Vec<usize>> = of.into_values().filter(|g| g.len() > 1).collect();
    groups.sort_unstable();
    groups
}

/// All pairs within the tolerance, the smaller number first, in order of the larger.
pub fn pairs(shapes: &[Shape], tolerance: f32) -> Vec<(usize, usize)> {
    let reach = (f64::from(tolerance) * 1e6) as i64 + 1;
    let width = ((f64::from(tolerance * CELL)) * 1e6) as i64 + 1;
    let mut grid: HashMap<[i64; KEYS.len()], Vec<u32>> = HashMap::new();
    let mut found = Vec::new();
    for (i, shape) in shapes.iter().enumerate() {
        let keys = KEYS.map(|k| i64::from(shape.values.get(k).copied().unwrap_or(0)));
        let (low, high) = (keys.map(|k| (k - reach).div_euclid(width)), keys.map(|k| (k + reach).div_euclid(width)));
        let before = found.len();
        for which in 0..1u32 << KEYS.len() {
            // A bit a key: its lower or its upper cell, where the two are not one.
            let upper = |k: usize| which >> k & 1 == 1;
            if (0..KEYS.len()).any(|k| upper(k) && low[k] == high[k]) {
                continue;
            }
            let cell: [i64; KEYS.len()] = std::array::from_fn(|k| if upper(k) { high[k] } else { low[k] });
            for &j in grid.get(&cell).into_iter().flatten() {
                if shape.distance(&shapes[j as usize]) <= tolerance {
                    found.push((j as usize, i));
                }
            }
        }
        found[before..].sort_unstable();
        grid.entry(keys.map(|k| k.div_euclid(width))).or_default().push(i as u32);
    }
    found
}

/// Disjoint sets; each is known by its smallest member.
struct Sets(Vec<usize>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n).collect())
    }

    fn first(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.first(a), self.first(b));
        self.0[a.max(b)] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::LEN;

    /// A description whose every number is `v` millionths, but for a few that tell apart by `i`.
    fn shape(v: i32, i: i32) -> Shape {
        let mut values = vec![v; LEN];
        KEYS.iter().enumerate().for_each(|(n, &k)| values[k] = v + i * (n as i32 + 1));
        Shape { joints: 5, values }
    }

    #[test]
    fn the_grid_finds_what_comparing_all_finds() {
        // Numbers over several cells and across their borders, negative ones too.
        let shapes: Vec<Shape> = (0..400).map(|i| shape((i * 7919 % 90_000) - 45_000, i * 31 % 9_000)).collect();
        let mut all = Vec::new();
        for i in 0..shapes.len() {
            all.extend((0..i).filter(|&j| shapes[i].distance(&shapes[j]) <= 4e-3).map(|j| (j, i)));
        }
        assert!(all.len() > 100);
        assert_eq!(pairs(&shapes, 4e-3), all);
    }

    #[test]
    fn chains_are_one_group_and_far_ones_none() {
        let shapes = [shape(0, 0), shape(900_000, 0), shape(3_000, 0), shape(6_000, 0)];
        assert_eq!(groups(&shapes, 4e-3), [vec![0, 2, 3]]);
        let joints = Shape { joints: 9, ..shape(0, 0) };
        assert!(groups(&[shape(0, 0), joints], 4e-3).is_empty());
    }
}
