//! Asking both sides in turn.

use anyhow::Result;

/// What each side took, a value a round.
pub struct Rounds {
    /// riglab's values.
    pub ours: Vec<f64>,
    /// The other side's.
    pub theirs: Vec<f64>,
}

impl Rounds {
    /// The medians.
    pub fn medians(&self) -> (f64, f64) {
        (median(&self.ours), median(&self.theirs))
    }

    /// The spread, for a note: smallest to largest value of each side.
    pub fn spread(&self) -> String {
        let range = |v: &[f64]| {
            let (low, high) = v.iter().fold((f64::INFINITY, 0.0f64), |(l, h), &x| (l.min(x), h.max(x)));
            format!("{low:.3} to {high:.3}")
        };
        format!("{} rounds, ours {}, theirs {}", self.ours.len(), range(&self.ours), range(&self.theirs))
    }
}

/// Threads of numpy's products and of OpenMP look for more work for a while after the last; that is not to be paid by
/// the side whose turn it is.
const REST: std::time::Duration = std::time::Duration::from_millis(150);

/// How long both sides rest in so many rounds.
pub fn rested(rounds: usize) -> std::time::Duration {
    2 * rounds as u32 * REST
}

/// Asks both sides in turn, each after a rest; who is first changes from round to round.
pub fn in_turn(
    rounds: usize,
    mut ours: impl FnMut() -> Result<f64>,
    mut theirs: impl FnMut() -> Result<f64>,
) -> Result<Rounds> {
    let mut found = Rounds { ours: Vec::new(), theirs: Vec::new() };
    for round in 0..rounds {
        for side in [round % 2, 1 - round % 2] {
            std::thread::sleep(REST);
            match side {
                0 => found.ours.push(ours()?),
                _ => found.theirs.push(theirs()?),
            }
        }
    }
    Ok(found)
}

/// The middle value, or the mean of both; NaN of none.
pub fn median(values: &[f64]) -> f64 {
    let mut v = values.to_vec();
    v.sort_by(f64::total_cmp);
    match v.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => v[n / 2],
        n => 0.5 * (v[n / 2 - 1] + v[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_ignores_an_outlier() {
        assert_eq!(median(&[1.0, 50.0, 2.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 90.0]), 3.0);
    }

    #[test]
    fn sides_alternate() {
        let order = std::cell::RefCell::new(String::new());
        let side = |name: char| {
            let order = &order;
            move || {
                order.borrow_mut().push(name);
                Ok(1.0)
            }
        };
        let start = std::time::Instant::now();
        in_turn(3, side('o'), side('t')).unwrap();
        assert_eq!(*order.borrow(), "ottoot");
        // Nearly all of this was rest.
        assert!(rested(3) == 6 * REST && start.elapsed() >= rested(3));
    }
}
