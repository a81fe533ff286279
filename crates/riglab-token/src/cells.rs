//! Cells that tell every parent.

use std::sync::LazyLock;

use crate::EncodeFault;

/// How far a free cell is looked for, in cells.
const REACH: i32 = 12;

/// Moves joints to free cells where their own would give another tree, and tells how many.
///
/// A branch names its parent by a cell, and the latest joint with that cell is taken. So no joint may have
/// the cell of an earlier one that a later branch still names. `branches` has the parents of those joints that
/// are written as branches.
///
/// # Errors
/// [`EncodeFault::NoCell`] where too many joints are at one place.
pub(crate) fn tell_apart(cells: &mut [[u16; 3]], branches: &[Option<usize>], bins: u16) -> Result<usize, EncodeFault> {
    // For each joint, the last branch that names it.
    let mut named_until = vec![0; cells.len()];
    for (joint, parent) in branches.iter().enumerate() {
        if let Some(parent) = *parent {
            named_until[parent] = joint;
        }
    }
    let mut moved = 0;
    // Earlier joints that are named later: few, where chains are long.
    let mut open: Vec<usize> = Vec::new();
    for joint in 1..cells.len() {
        if named_until[joint - 1] > 0 {
            open.push(joint - 1);
        }
        if open.is_empty() {
            continue;
        }
        open.retain(|&earlier| named_until[earlier] > joint);
        let taken = |cells: &[[u16; 3]], cell: [u16; 3]| open.iter().any(|&earlier| cells[earlier] == cell);
        if !taken(cells, cells[joint]) {
            continue;
        }
        let free = around(cells[joint], bins).find(|cell| !taken(cells, *cell));
        cells[joint] = free.ok_or(EncodeFault::NoCell { joint, bins })?;
        moved += 1;
    }
    Ok(moved)
}

/// Ways to cells around, nearest first; of equally near ones in a fixed order.
static STEPS: LazyLock<Vec<[i32; 3]>> = LazyLock::new(|| {
    let span = -REACH..=REACH;
    let mut steps: Vec<[i32; 3]> =
        span.clone().flat_map(|x| span.clone().flat_map(move |y| (-REACH..=REACH).map(move |z| [x, y, z]))).collect();
    steps.sort_by_key(|s| (s.iter().map(|x| x * x).sum::<i32>(), *s));
    steps
});

/// The cells around one, nearest first.
fn around(cell: [u16; 3], bins: u16) -> impl Iterator<Item = [u16; 3]> {
    STEPS.iter().filter_map(move |step| {
        let mut to = cell;
        for axis in 0..3 {
            let x = i32::from(cell[axis]) + step[axis];
            to[axis] = u16::try_from(x).ok().filter(|x| *x < bins)?;
        }
        Some(to)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_joints_that_hide_a_named_one_move() {
        // 0 - 1 - 2 and 0 - 3, 1 - 4: all in one cell.
        let branches = [None, None, None, Some(0), Some(1)];
        let mut cells = [[7; 3]; 5];
        assert_eq!(tell_apart(&mut cells, &branches, 256).unwrap(), 2);
        let latest = |cell: [u16; 3], before: usize| (0..before).rev().find(|&j| cells[j] == cell);
        assert_eq!((latest(cells[0], 3), latest(cells[1], 4)), (Some(0), Some(1)));
        // A chain names nobody.
        let mut chain = [[7; 3]; 4];
        assert_eq!(tell_apart(&mut chain, &[None; 4], 256).unwrap(), 0);
        // A star of more joints than cells.
        let mut star = vec![[0; 3]; 20];
        let branches: Vec<_> = (0..20).map(|j| if j < 2 { None } else { Some(0) }).collect();
        assert_eq!(tell_apart(&mut star.clone(), &branches, 2).unwrap(), 18);
        // A chain of ten, and a branch from each of it: ten cells are needed at once.
        let comb: Vec<_> = (0..20usize).map(|j| j.checked_sub(10)).collect();
        assert!(matches!(tell_apart(&mut star, &comb, 2), Err(EncodeFault::NoCell { .. })));
    }
}
