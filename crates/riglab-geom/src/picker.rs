//! Picks by weight.

/// Picks from a list of weights: which one lies at a share of their sum.
///
/// A pick is that of a search in the running sums, so that recorded draws can be replayed; a table of
/// where to begin makes it take constant time on average.
pub struct Picker {
    /// Running sums.
    sums: Vec<f64>,
    /// The pick at share k / n, for k below n, with n the number of weights.
    begin: Vec<u32>,
}

impl Picker {
    /// Over weights that are finite and not negative, at least one of them. Where all are 0 each gets
    /// the same share.
    pub fn new(weights: impl IntoIterator<Item = f64>) -> Self {
        let mut sum = 0.0;
        let mut sums: Vec<f64> = weights
            .into_iter()
            .map(|w| {
                sum += w;
                sum
            })
            .collect();
        let n = sums.len();
        if !(sum > 0.0 && sum.is_finite()) {
            sums = (1..=n).map(|k| k as f64).collect();
            sum = n as f64;
        }
        let mut at = 0;
        let first = |k: usize| {
            let share = k as f64 / n as f64 * sum;
            while at + 1 < n && sums[at] <= share {
                at += 1;
            }
            at as u32
        };
        let begin = (0..n).map(first).collect();
        Self { sums, begin }
    }

    /// The pick at a share of the sum, in [0, 1): the first whose running sum is above it. Never one of
    /// weight 0, unless all are.
    pub fn at(&self, share: f64) -> u32 {
        let n = self.sums.len();
        let wanted = share * self.sums[n - 1];
        // One step back: k / n may round to above the share.
        let mut pick = self.begin[((share * n as f64) as usize).min(n - 1).saturating_sub(1)] as usize;
        while pick + 1 < n && self.sums[pick] <= wanted {
            pick += 1;
        }
        // A share that rounds to the whole sum: the last with a weight.
        while pick > 0 && self.sums[pick - 1] >= wanted && self.sums[pick] <= wanted {
            pick -= 1;
        }
        pick as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_are_those_of_a_search() {
        let weights = [0.0, 1.0, 0.0, 0.0, 5.0, 1e-9, 2.0, 0.0];
        let picker = Picker::new(weights);
        let sums: Vec<f64> = weights
            .iter()
            .scan(0.0, |s, w| {
                Some({
                    *s += w;
                    *s
                })
            })
            .collect();
        for k in 0..10_000 {
            let share = f64::from(k) / 10_000.0;
            assert_eq!(picker.at(share) as usize, sums.partition_point(|s| *s <= share * sums[7]), "{share}");
        }
        assert_eq!((picker.at(0.0), picker.at(1.0 - f64::EPSILON / 2.0), picker.at(1.0)), (1, 6, 6));
    }

    #[test]
    fn without_any_weight_all_are_picked() {
        let picker = Picker::new([0.0; 4]);
        assert_eq!([0.0, 0.3, 0.6, 0.9].map(|s| picker.at(s)), [0, 1, 2, 3]);
        assert_eq!(Picker::new([f64::MAX, f64::MAX]).at(0.7), 1);
    }
}
