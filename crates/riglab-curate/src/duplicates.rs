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

/// The groups of rigs that are the same, each of two or more, by number and rising. Rigs a, b and c are one group if a is
/// near b and b near c.
pub fn groups(shapes: &[Shape], tolerance: f32) -> Vec<Vec<usize>> {
    let mut sets = Sets::new(shapes.len());
    let mut grid = Grid::new(tolerance);
    let mut firsts: HashMap<&Shape, usize> = HashMap::new();
    for (i, shape) in shapes.iter().enumerate() {
        // Of equal ones, which may be many, the first stands for all.
        if let Some(&first) = firsts.get(shape) {
            sets.join(first, i);
            continue;
        }
        firsts.insert(shape, i);
        for j in grid.around(shape) {
            if sets.first(j) != sets.first(i) && shape.distance(&shapes[j]) <= tolerance {
                sets.join(i, j);
            }
        }
        grid.add(shape, i);
    }
    let mut of: HashMap<usize, Vec<usize>> = HashMap::new();
    for i in 0..shapes.len() {
        of.entry(sets.first(i)).or_default().push(i);
    }
    let mut groups: Vec<Vec<usize>> = of.into_values().filter(|g| g.len() > 1).collect();
    groups.sort_unstable();
    groups
}

/// All pairs within the tolerance, the smaller number first, in order of the larger: as many as the square of the rigs, where
/// all are the same.
pub fn pairs(shapes: &[Shape], tolerance: f32) -> Vec<(usize, usize)> {
    let mut grid = Grid::new(tolerance);
    let mut found = Vec::new();
    for (i, shape) in shapes.iter().enumerate() {
        let before = found.len();
        let near = grid.around(shape).filter(|&j| shape.distance(&shapes[j]) <= tolerance);
        found.extend(near.map(|j| (j, i)));
        found[before..].sort_unstable();
        grid.add(shape, i);
    }
    found
}

/// A cell, by a number a key.
type Cell = [i64; KEYS.len()];

/// Rigs by the cells that they are in.
struct Grid {
    /// How far to look, and how wide cells are, in the units of descriptions.
    reach: i64,
    width: i64,
    cells: HashMap<Cell, Vec<u32>>,
}

impl Grid {
    fn new(tolerance: f32) -> Self {
        let reach = (f64::from(tolerance) * 1e6) as i64 + 1;
        let width = ((f64::from(tolerance * CELL)) * 1e6) as i64 + 1;
        Self { reach, width, cells: HashMap::new() }
    }

    fn keys(shape: &Shape) -> Cell {
        KEYS.map(|k| i64::from(shape.values.get(k).copied().unwrap_or(0)))
    }

    fn add(&mut self, shape: &Shape, number: usize) {
        self.cells.entry(Self::keys(shape).map(|k| k.div_euclid(self.width))).or_default().push(number as u32);
    }

    /// Those that may be within the tolerance, each once.
    fn around(&self, shape: &Shape) -> impl Iterator<Item = usize> + '_ {
        let keys = Self::keys(shape);
        let low = keys.map(|k| (k - self.reach).div_euclid(self.width));
        let high = keys.map(|k| (k + self.reach).div_euclid(self.width));
        // A bit a key: its lower or its upper cell, where the two are not one.
        let upper = |which: u32, k: usize| which >> k & 1 == 1;
        let is_one = move |which: &u32| (0..KEYS.len()).all(|k| !upper(*which, k) || low[k] != high[k]);
        let cells = (0..1u32 << KEYS.len()).filter(is_one);
        let cell = move |which| std::array::from_fn(|k| if upper(which, k) { high[k] } else { low[k] });
        cells.filter_map(move |which| self.cells.get::<Cell>(&cell(which))).flatten().map(|&number| number as usize)
    }
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
    fn groups_are_those_of_the_pairs() {
        // Chains of three, each near the next, and some by themselves; a hundred are there twice.
        let chained = (0..240).map(|i| shape(i / 3 * 30_000 + i % 3 * 3_000, 0));
        let mut shapes: Vec<Shape> = chained.chain((0..60).map(|i| shape(-20_000 * (i + 1), 0))).collect();
        shapes.extend_from_within(100..200);
        let mut of: Vec<usize> = (0..shapes.len()).collect();
        for (a, b) in pairs(&shapes, 4e-3) {
            let (a, b) = (of[a].min(of[b]), of[a].max(of[b]));
            of.iter_mut().filter(|own| **own == b).for_each(|own| *own = a);
        }
        let groups = groups(&shapes, 4e-3);
        assert!(groups.iter().all(|group| group.iter().all(|&i| of[i] == group[0])));
        // The others are by themselves.
        let grouped = groups.concat();
        let mut alone = (0..shapes.len()).filter(|i| !grouped.contains(i));
        assert_eq!((groups.len(), grouped.len()), (80, 340));
        assert!(alone.all(|i| of[i] == i));
    }

    #[test]
    fn many_copies_cost_what_they_are() {
        // By pairs, 5 * 10⁹ of them.
        let copies = vec![shape(7, 0); 100_000];
        assert_eq!(groups(&copies, 4e-3)[0].len(), copies.len());
    }

    #[test]
    fn chains_are_one_group_and_far_ones_none() {
        let shapes = [shape(0, 0), shape(900_000, 0), shape(3_000, 0), shape(6_000, 0)];
        assert_eq!(groups(&shapes, 4e-3), [vec![0, 2, 3]]);
        let joints = Shape { joints: 9, ..shape(0, 0) };
        assert!(groups(&[shape(0, 0), joints], 4e-3).is_empty());
    }
}
