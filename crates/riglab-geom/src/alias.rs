//! Picks by weight in constant time.

use std::hint::select_unpredictable;

/// An alias table (Walker): each slot is one number up to a threshold and another above it. A pick takes
/// one look-up and no search.
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
        let units = |k: usize| weights[k] / sum * n as f64;
        let mut left: Vec<f64> = (0..n).map(units).collect();
        let (mut low, mut high) = parted(&left);
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
        low.retain(|&taker| weights[taker as usize] == 0.0);
        if !low.is_empty() {
            let heaviest = (0..n).max_by(|&a, &b| units(a).total_cmp(&units(b))).unwrap_or(0);
            low.iter().for_each(|&taker| slots[taker as usize] = Slot { below: 0, other: heaviest as u32 });
        }
        Self { slots }
    }

    /// The slot of 48 random bits, of which `low` are the last 16, and where in it they fall, in 2⁻³².
    #[inline]
    pub(crate) fn slot(&self, high: u32, low: u32) -> (u32, u32) {
        let n = u64::from(self.slots.len() as u32);
        // The product of all bits and n without its last 16 bits; no part of it is longer than 64.
        let product = u64::from(high) * n + ((u64::from(low) * n) >> 16);
        ((product >> 32) as u32, product as u32)
    }

    /// The pick at a place of a slot.
    #[inline]
    pub(crate) fn of(&self, slot: u32, share: u32) -> u32 {
        let Slot { below, other } = self.slots[slot as usize];
        // Told so, since a mask alone is compiled to a branch: it would be foreseen wrongly half of the
        // time.
        select_unpredictable(share < below, slot, other)
    }
}

/// The numbers of those below 1, and of the others. Both places are written each time and one is kept,
/// since a branch would be foreseen wrongly as often as not.
fn parted(left: &[f64]) -> (Vec<u32>, Vec<u32>) {
    let (mut low, mut high) = (vec![0; left.len()], vec![0; left.len()]);
    let (mut lows, mut highs) = (0, 0);
    for (k, x) in left.iter().enumerate() {
        (low[lows], high[highs]) = (k as u32, k as u32);
        let is_low = usize::from(*x < 1.0);
        lows += is_low;
        highs += 1 - is_low;
    }
    low.truncate(lows);
    high.truncate(highs);
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Alias {
        /// The pick of 48 random bits, in numbers of twice the length.
        pub(crate) fn pick(&self, bits: u64) -> u32 {
            let product = u128::from(bits) * self.slots.len() as u128;
            self.of((product >> 48) as u32, (product >> 16) as u32)
        }
    }

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

    #[test]
    fn slots_are_those_of_the_whole_product() {
        for n in [1usize, 3, 7, 100_003] {
            let alias = Alias::new(&vec![1.0; n]);
            for k in 0..1000u64 {
                let bits = k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 16;
                let product = u128::from(bits) * n as u128;
                let wanted = ((product >> 48) as u32, (product >> 16) as u32);
                assert_eq!(alias.slot((bits >> 16) as u32, bits as u32 & 0xffff), wanted);
            }
        }
    }

    #[test]
    fn parts_are_those_of_a_partition() {
        for left in [vec![], vec![0.5], vec![1.0, 2.0], vec![0.0, 1.0, 0.999, 3.0, 0.0, f64::NAN]] {
            let wanted = (0..left.len() as u32).partition(|&k| left[k as usize] < 1.0);
            assert_eq!(parted(&left), wanted);
        }
    }
}
