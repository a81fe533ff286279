//! Rows that change places within the room they have.

/// What is done to rows, one after another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Move {
    /// A row is written over another.
    Copy { from: usize, to: usize },
    /// A row is kept aside, in the one place there is for that.
    Keep { from: usize },
    /// What was kept aside is written over a row.
    Put { to: usize },
}

/// Steps after which every row is what it was asked to be. Nothing is written over before all that need it have it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Moves(pub Vec<Move>);

impl Moves {
    /// Of so many rows to `rows`, each of which was the one of that number before; `None` where these are more than before.
    pub fn of(rows: &[i64], before: i64) -> Option<Self> {
        if rows.len() as i64 > before {
            return None;
        }
        let source = |to: usize| rows[to] as usize;
        let mut needed = vec![0usize; before as usize];
        let mut waits: Vec<bool> = (0..rows.len()).map(|to| source(to) != to).collect();
        (0..rows.len()).filter(|&to| waits[to]).for_each(|to| needed[source(to)] += 1);
        let mut steps = Vec::new();
        // First those over which may be written, which frees others.
        let mut free: Vec<usize> = (0..rows.len()).filter(|&to| waits[to] && needed[to] == 0).collect();
        while let Some(to) = free.pop() {
            let from = source(to);
            steps.push(Move::Copy { from, to });
            waits[to] = false;
            needed[from] -= 1;
            if needed[from] == 0 && waits.get(from) == Some(&true) {
                free.push(from);
            }
        }
        // What is left goes round in circles.
        for first in 0..rows.len() {
            if !waits[first] {
                continue;
            }
            steps.push(Move::Keep { from: first });
            let mut to = first;
            loop {
                waits[to] = false;
                let from = source(to);
                if from == first {
                    steps.push(Move::Put { to });
                    break;
                }
                steps.push(Move::Copy { from, to });
                to = from;
            }
        }
        Some(Self(steps))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moved(rows: &[i64], before: i64) -> Option<Vec<i64>> {
        let mut all: Vec<i64> = (0..before).collect();
        let mut kept = -1;
        for step in Moves::of(rows, before)?.0 {
            match step {
                Move::Copy { from, to } => all[to] = all[from],
                Move::Keep { from } => kept = all[from],
                Move::Put { to } => all[to] = kept,
            }
        }
        all.truncate(rows.len());
        Some(all)
    }

    #[test]
    fn rows_are_what_they_were_asked_to_be() {
        // Every choice of up to four of four rows.
        for count in 1..=4u32 {
            for code in 0..4i64.pow(count) {
                let rows: Vec<i64> = (0..count).map(|at| code / 4i64.pow(at) % 4).collect();
                assert_eq!(moved(&rows, 4), Some(rows));
            }
        }
        assert_eq!(Moves::of(&[0, 0], 1), None);
    }

    #[test]
    fn what_stays_is_not_touched() {
        assert_eq!(Moves::of(&[0, 1, 2], 5), Some(Moves(Vec::new())));
        assert_eq!(Moves::of(&[0, 0, 2], 3), Some(Moves(vec![Move::Copy { from: 0, to: 1 }])));
        let around = [Move::Keep { from: 0 }, Move::Copy { from: 1, to: 0 }, Move::Put { to: 1 }];
        assert_eq!(Moves::of(&[1, 0], 2), Some(Moves(around.to_vec())));
    }
}
