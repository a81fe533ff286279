//! Picks by weight in constant time.

/// An alias table (Walker): each slot is one number up to a threshold and another above it. A pick takes
/// one look-up and no search, but does not go with running sums; [`crate::Picker`] does.
pub(crate) struct Alias {
    slots: Vec<Slot>,
}

#[derive(Clone, Copy)]
struct Slot {
    /// Shares of the slot below this, in 2⁻³², are the slot's own number.
    below: u32,
    /// What the others are.
    other: u32,
}

impl Alias {
    /// Over weights that are finite and not negative, at least one of them. Where all are 0, or their
    /// sum is no number, each gets the same share.
    pub(crate) fn new(weights: &[f64]) -> Self {
        let n = weights.len();
        let sum: f64 = weights.iter().sum();
        let even = !(sum > 0.0 && sum.is_finite());
        let mut slots: Vec<Slot> = (0..n as u32).map(|other| Slot { below: u32::MAX, other }).collect();
        if even {
            return Self { slots };
        }
        // In units of a slot. What is above 1 fills up what is below.
        let mut left: Vec<f64> = weights.iter().map(|w| w / sum * n as f64).collect();
        let heaviest = (0..n).max_by(|&a, &b| left[a].total_cmp(&left[b])).unwrap_or(0);
        let (mut low, mut high): (Vec<u32>, Vec<u32>) = (0..n as u32).partition(|&k| left[k as usize] < 1.0);
        while let Some(&giver) = high.last() {
            let Some(taker) = low.pop() else { break };
            let share = left[taker as usize];
            slots[taker as usize] = Slot { below: (share * 4_294_967_296.0) as u32, other: giver };
            left[giver as usize] -= 1.0 - share;
            if left[giver as usize] < 1.0 {
                high.pop();
                low.push(giver);
            }
        }
        // What rounding leaves over is full but for as much; never a weight of 0.
        for taker in low {
            if weights[taker as usize] == 0.0 {
                slots[taker as usize] = Slot { below: 0, other: heaviest as u32 };
            }
        }
        Self { slots }
    }

    /// The pick of 48 random bits.
    #[inline]
    pub(crate) fn pick(&self, bits: u64) -> u32 {
        let product = u128::from(bits) * self.slots.len() as u128;
        let slot = (product >> 48) as usize;
        let Slot { below, other } = self.slots[slot];
        // Without a branch, which would be foreseen wrongly half of the time.
        let own = u32::from(((product >> 16) as u32) < below).wrapping_neg();
        other ^ ((slot as u32 ^ other) & own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How often each is picked, of shares that are spread evenly.
    fn counts(weights: &[f64], n: u64) -> Vec<f64> {
        let alias = Alias::new(weights);
        let mut counts = vec![0.0; weights.len()];
        (0..n).for_each(|k| counts[alias.pick(k * ((1 << 48) / n)) as usize] += 1.0 / n as f64);
        counts
    }

    #[test]
    fn picks_go_with_the_weights_and_never_to_nothing() {
        for weights in [vec![0.0, 1.0, 0.0, 5.0, 1e-3, 2.0, 0.0], vec![7.0], vec![0.0, 0.0, 1e-30], vec![1.0; 9]] {
            let sum: f64 = weights.iter().sum();
            for (w, share) in weights.iter().zip(counts(&weights, 100_000)) {
                assert!((w / sum - share).abs() < 1e-4 && (*w > 0.0 || share == 0.0), "{weights:?}: {w} {share}");
            }
        }
        assert!(counts(&[0.0; 4], 1000).iter().all(|share| (share - 0.25).abs() < 2e-3));
        assert!(counts(&[f64::MAX; 4], 1000).iter().all(|share| (share - 0.25).abs() < 2e-3));
    }
}
