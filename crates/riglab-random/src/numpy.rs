//! Rows as NumPy's `default_rng(seed).choice(n, k)` draws them: released networks were evaluated with
//! them, so who wants their numbers needs the same rows.
//!
//! The generator is PCG64 (XSL-RR, 128 bits of state) seeded by NumPy's `SeedSequence`; bounded numbers
//! are Lemire's; without repetition it is Floyd's method, or the tail of a shuffle for large draws.

/// `count` of the numbers below `n`, as `numpy.random.default_rng(seed).choice(n, count, replace = count > n)`
/// gives them; `n` must not be 0 unless `count` is.
pub fn numpy_choice(seed: u64, n: u32, count: usize) -> Vec<u32> {
    let mut pcg = Pcg64::new(seed);
    if count > n as usize {
        return (0..count).map(|_| pcg.up_to(n - 1)).collect();
    }
    if count == 0 {
        return Vec::new();
    }
    if n > 10_000 && count > n as usize / 50 {
        let mut all: Vec<u32> = (0..n).collect();
        let first = (n as usize - count).max(1);
        shuffle(&mut pcg, &mut all, first);
        return all.split_off(n as usize - count);
    }
    let mut taken = std::collections::HashSet::with_capacity(count);
    let mut rows = Vec::with_capacity(count);
    for last in n - count as u32..n {
        let drawn = pcg.up_to(last);
        let row = if taken.insert(drawn) { drawn } else { last };
        taken.insert(row);
        rows.push(row);
    }
    shuffle(&mut pcg, &mut rows, 1);
    rows
}

/// Puts items in random order from the end down to `first`.
fn shuffle(pcg: &mut Pcg64, items: &mut [u32], first: usize) {
    for i in (first..items.len()).rev() {
        let j = pcg.up_to(i as u32) as usize;
        items.swap(i, j);
    }
}

struct Pcg64 {
    state: u128,
    step: u128,
    /// The upper half of the last 64 bits, while it is not used.
    half: Option<u32>,
}

impl Pcg64 {
    fn new(seed: u64) -> Self {
        let words = seed_words(seed);
        let wide = |k: usize| (u128::from(words[k]) << 64) | u128::from(words[k + 1]);
        let mut pcg = Self { state: 0, step: (wide(2) << 1) | 1, half: None };
        pcg.advance();
        pcg.state = pcg.state.wrapping_add(wide(0));
        pcg.advance();
        pcg
    }

    fn advance(&mut self) {
        const MULTIPLIER: u128 = 0x2360_ed05_1fc6_5da4_4385_df64_9fcc_f645;
        self.state = self.state.wrapping_mul(MULTIPLIER).wrapping_add(self.step);
    }

    fn next32(&mut self) -> u32 {
        if let Some(half) = self.half.take() {
            return half;
        }
        self.advance();
        let folded = (self.state >> 64) as u64 ^ self.state as u64;
        let word = folded.rotate_right((self.state >> 122) as u32);
        self.half = Some((word >> 32) as u32);
        word as u32
    }

    /// Uniform in 0..=most, without bias.
    fn up_to(&mut self, most: u32) -> u32 {
        if most == 0 {
            return 0;
        }
        if most == u32::MAX {
            return self.next32();
        }
        let range = most + 1;
        let mut product = u64::from(self.next32()) * u64::from(range);
        if (product as u32) < range {
            let threshold = (u32::MAX - most) % range;
            while (product as u32) < threshold {
                product = u64::from(self.next32()) * u64::from(range);
            }
        }
        (product >> 32) as u32
    }
}

/// Four words of state from a seed, as `SeedSequence(seed).generate_state(4, uint64)` mixes them.
fn seed_words(seed: u64) -> [u64; 4] {
    let mut key = 0x43b0_d7e5u32;
    let mut hashed = |mut value: u32| {
        value ^= key;
        key = key.wrapping_mul(0x931e_8875);
        value = value.wrapping_mul(key);
        value ^ (value >> 16)
    };
    let mut pool = [seed as u32, (seed >> 32) as u32, 0, 0].map(&mut hashed);
    for source in 0..4 {
        for target in (0..4).filter(|t| *t != source) {
            let other = hashed(pool[source]);
            let mixed = pool[target].wrapping_mul(0xca01_f9dd).wrapping_sub(other.wrapping_mul(0x4973_f715));
            pool[target] = mixed ^ (mixed >> 16);
        }
    }
    let mut key = 0x8b51_f9ddu32;
    let mut word = |k: usize| {
        let mut value = pool[k % 4] ^ key;
        key = key.wrapping_mul(0x58f3_8ded);
        value = value.wrapping_mul(key);
        u64::from(value ^ (value >> 16))
    };
    std::array::from_fn(|k| word(2 * k) | (word(2 * k + 1) << 32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_repetition_all_are_unlike() {
        for (n, count) in [(1, 1), (20, 20), (500, 64), (20_000, 5_000), (20_000, 30)] {
            let mut rows = numpy_choice(3, n, count);
            rows.sort_unstable();
            rows.dedup();
            assert!(rows.len() == count && rows.iter().all(|r| *r < n));
        }
        assert!(numpy_choice(0, 5, 0).is_empty());
    }

    #[test]
    fn rows_are_those_of_numpy() {
        // numpy 2.4: [default_rng(seed).choice(n, k, replace=k > n) for ...]
        assert_eq!(numpy_choice(0, 20, 8), [11, 1, 19, 7, 5, 4, 0, 8]);
        assert_eq!(numpy_choice(1 << 40, 12_000, 3), [11067, 4555, 4329]);
        assert_eq!(numpy_choice(7, 3, 8), [2, 1, 2, 2, 1, 2, 2, 0]);
    }
}
