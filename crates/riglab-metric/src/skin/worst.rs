//! The weights that are farthest from true ones.

use crate::Rows;

/// True weights below this are zeros, as UniRig's figures have it.
const ZERO: f32 = 1e-6;

/// Predictions of which, for each figure that grows with the distance from the truth, one has the most that weights of sum
/// 1 at most can have: such a figure is convex in a vertex' weights, so that its largest value is where a vertex hangs on
/// one bone alone, or on none. That bone is, for sums over the table, the one that has least of the vertex; for UniRig's
/// means by bone, the unused or the used one whose mean rises most.
pub(crate) fn farthest(truth: &Rows) -> [Rows; 4] {
    let mut used = vec![0u32; truth.columns()];
    let is_used = |w: f32| w >= ZERO;
    truth.iter().flatten().filter(|(_, w)| is_used(*w)).for_each(|(c, _)| used[*c as usize] += 1);
    // A mean over few vertices rises most.
    let mut seldom_unused: Vec<u32> = (0..truth.columns() as u32).collect();
    seldom_unused.sort_by_key(|c| std::cmp::Reverse(used[*c as usize]));
    let weight = |row: &[(u32, f32)], bone: u32| row.iter().find(|(c, _)| *c == bone).map_or(0.0, |(_, w)| *w);
    let least = |row: &[(u32, f32)]| {
        let stored = row.iter().map(|(c, _)| Some(*c)).chain(std::iter::repeat(None));
        let free = (0..truth.columns() as u32).zip(stored).find(|(c, stored)| Some(*c) != *stored).map(|(c, _)| c);
        free.or_else(|| row.iter().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(c, _)| *c))
    };
    let unused = |row: &[(u32, f32)]| seldom_unused.iter().copied().find(|c| !is_used(weight(row, *c)));
    let over = |row: &[(u32, f32)]| {
        let rise = |(c, w): &(u32, f32)| ((1.0 - 2.0 * w) / used[*c as usize] as f32, *c);
        let rises = row.iter().filter(|(_, w)| is_used(*w)).map(rise).filter(|(rise, _)| *rise > 0.0);
        rises.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, c)| c)
    };
    [on(truth, |_| None), on(truth, least), on(truth, unused), on(truth, over)]
}

/// All of each vertex on the bone that is chosen by its true weights, or on none.
fn on(truth: &Rows, bone: impl Fn(&[(u32, f32)]) -> Option<u32>) -> Rows {
    Rows::new(truth.iter().map(|row| bone(row).map(|c| (c, 1.0))), truth.columns())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_on_one_bone_or_none() {
        let truth = Rows::dense(&[0.7, 0.3, 0.0, 0.1, 0.4, 0.5, 0.2, 0.8, 0.0], 3);
        let [none, least, unused, over] = farthest(&truth);
        assert!(none.iter().all(<[_]>::is_empty));
        let bones = |rows: &Rows| rows.iter().map(|row| row.first().map(|(c, _)| *c)).collect::<Vec<_>>();
        assert_eq!(bones(&least), [Some(2), Some(0), Some(2)]);
        // The second vertex has all three.
        assert_eq!(bones(&unused), [Some(2), None, Some(2)]);
        assert_eq!(bones(&over), [Some(1), Some(0), Some(0)]);
        assert_eq!(bones(&farthest(&Rows::dense(&[1.0], 1))[1]), [Some(0)]);
    }
}
