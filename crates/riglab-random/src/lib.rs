//! Random streams keyed by seed, purpose and index.
//!
//! Every random choice in riglab comes from a stream that is named by what it is for: the run's
//! seed, a purpose, and the step or asset it belongs to. No state is carried from one choice to
//! the next, so nothing random has to be saved: a resumed run, or one with another number of
//! workers, draws the same values.
//!
//! ```
//! use riglab_random::{Draw, stream};
//! let mut points = stream(7, "surface points", &[12]);
//! let x: f32 = points.unit();
//! assert_eq!(x, stream(7, "surface points", &[12]).unit());
//! ```
//!
//! Holds: two different keys give independent streams (ChaCha8 with the key as its 256-bit key);
//! the same key gives the same values on every machine.
//! Leaves out: libtorch's generator, which is seeded from a stream where a network needs it.

mod numpy;

pub use numpy::numpy_choice;
use rand::seq::SliceRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A stream of random numbers.
pub type Stream = ChaCha8Rng;

/// The stream of a key. `index` holds at most two numbers, say a step and an asset; more are folded.
pub fn stream(seed: u64, purpose: &str, index: &[u64]) -> Stream {
    let mut words = [seed, hash(purpose), 0, 0];
    for (k, &i) in index.iter().enumerate() {
        let word = &mut words[2 + k % 2];
        *word = mix(*word ^ mix(i.wrapping_add(k as u64 + 1)));
    }
    let mut key = [0; 32];
    for (bytes, word) in key.chunks_exact_mut(8).zip(words) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

/// The draws that riglab uses.
pub trait Draw: Rng {
    /// Uniform in [0, 1).
    fn unit(&mut self) -> f32 {
        self.random()
    }

    /// Fills with random bytes: many numbers at once, for who makes them of bits.
    fn bytes(&mut self, out: &mut [u8]) {
        self.fill_bytes(out);
    }

    /// Uniform in [low, high); `low` when the range is empty.
    fn within(&mut self, low: f32, high: f32) -> f32 {
        let drawn = low + (high - low) * self.unit();
        // Rounding may reach the end, which is not of the range.
        if low < drawn && drawn >= high { high.next_down().max(low) } else { drawn }
    }

    /// Standard normal.
    fn normal(&mut self) -> f32 {
        StandardNormal.sample(self)
    }

    /// True with probability `p`.
    fn chance(&mut self, p: f32) -> bool {
        self.unit() < p
    }

    /// Uniform in 0..n; `n` must not be 0.
    fn below(&mut self, n: usize) -> usize {
        self.random_range(0..n)
    }

    /// Puts the items in random order.
    fn shuffled<T>(&mut self, items: &mut [T])
    where
        Self: Sized,
    {
        items.shuffle(self);
    }
}

impl<R: Rng + ?Sized> Draw for R {}

/// FNV-1a: a name to a word, the same on every machine.
fn hash(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// The finalizer of SplitMix64: a bijection that spreads neighbouring numbers.
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_key_same_values() {
        let a: Vec<f32> = std::iter::repeat_with({
            let mut s = stream(1, "a", &[2, 3]);
            move || s.unit()
        })
        .take(8)
        .collect();
        let mut s = stream(1, "a", &[2, 3]);
        assert!(a.iter().all(|&x| x == s.unit()));
    }

    #[test]
    fn every_part_of_the_key_counts() {
        let first = |mut s: Stream| s.unit().to_bits();
        let mut all = vec![
            first(stream(1, "a", &[])),
            first(stream(2, "a", &[])),
            first(stream(1, "b", &[])),
            first(stream(1, "a", &[0])),
            first(stream(1, "a", &[1])),
            first(stream(1, "a", &[0, 0])),
            first(stream(1, "a", &[0, 1])),
            first(stream(1, "a", &[1, 0])),
            first(stream(1, "a", &[0, 0, 1])),
        ];
        let n = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), n);
    }

    #[test]
    fn no_draw_reaches_the_end_of_its_range() {
        /// Gives its greatest number always.
        struct Most;
        impl rand::rand_core::TryRng for Most {
            type Error = std::convert::Infallible;
            fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
                Ok(u32::MAX)
            }
            fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
                Ok(u64::MAX)
            }
            fn try_fill_bytes(&mut self, out: &mut [u8]) -> Result<(), Self::Error> {
                out.fill(u8::MAX);
                Ok(())
            }
        }
        for (low, high) in [(1.0, 2.0), (-1.0, 1.0), (0.0, 1.0), (7.0, 7.0f32.next_up()), (1e30, 2e30)] {
            let drawn = Most.within(low, high);
            assert!(low <= drawn && drawn < high, "[{low}, {high}): {drawn}");
        }
        assert_eq!((Most.within(3.0, 3.0), Most.within(0.0, 0.0)), (3.0, 0.0));
    }

    /// Results depend on these values: a change of the random crates must not pass unseen.
    #[test]
    fn values_are_pinned() {
        let mut s = stream(42, "pinned", &[7]);
        let got = (s.unit(), s.below(1000), s.normal(), s.within(-1.0, 1.0), s.chance(0.5));
        let mut order = [0, 1, 2, 3, 4, 5, 6, 7];
        s.shuffled(&mut order);
        assert_eq!(
            format!("{got:?} {order:?}"),
            "(0.506243, 151, -1.225564, 0.41820145, false) [5, 2, 4, 3, 7, 6, 0, 1]"
        );
    }
}
