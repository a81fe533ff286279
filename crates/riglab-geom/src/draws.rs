//! Places on triangles from random numbers, many at once.

use std::hint::select_unpredictable;

use multiversion::multiversion;
use riglab_random::{Draw, Stream};

use crate::alias::Alias;

/// Points of a block. Their arrays stay in the nearest cache.
pub(crate) const BLOCK: usize = 128;
/// Random words of a point.
const WORDS: usize = 3;

/// Points on triangles: which, and the shares of their second and third corners.
pub(crate) struct Picks<'a> {
    /// Numbers of the table.
    pub(crate) numbers: &'a [u32],
    /// Shares of the second corner.
    pub(crate) u: &'a [f32],
    /// Shares of the third.
    pub(crate) v: &'a [f32],
}

/// Draws `count` points, given block by block: of each 48 bits for the triangle, two times 24 for the
/// place on it. Numbers are taken from the stream many at once, which costs a third of taking them one
/// by one, and each step goes through the whole block: no step has a branch, which would be foreseen
/// wrongly half of the time, and the first one is done for several points at once.
#[inline]
pub(crate) fn draws(alias: &Alias, count: usize, random: &mut Stream, mut take: impl FnMut(Picks<'_>)) {
    let mut bytes = [0u8; 4 * WORDS * BLOCK];
    let mut numbers = [0u32; BLOCK];
    let (mut u, mut v) = ([0f32; BLOCK], [0f32; BLOCK]);
    let mut left = count;
    while left > 0 {
        let now = left.min(BLOCK);
        random.bytes(&mut bytes[..4 * WORDS * now]);
        places(alias, &bytes, &mut numbers, &mut u, &mut v);
        take(Picks { numbers: &numbers[..now], u: &u[..now], v: &v[..now] });
        left -= now;
    }
}

/// By the widest instructions there are; the values are the same.
#[multiversion(targets("x86_64+avx2"))]
fn places(
    alias: &Alias,
    bytes: &[u8; 4 * WORDS * BLOCK],
    numbers: &mut [u32; BLOCK],
    u: &mut [f32; BLOCK],
    v: &mut [f32; BLOCK],
) {
    plain(alias, bytes, numbers, u, v);
}

/// What is behind the end of a last block is read, too, and made nothing of.
#[inline(always)]
fn plain(
    alias: &Alias,
    bytes: &[u8; 4 * WORDS * BLOCK],
    numbers: &mut [u32; BLOCK],
    u: &mut [f32; BLOCK],
    v: &mut [f32; BLOCK],
) {
    let (mut slots, mut shares) = ([0u32; BLOCK], [0u32; BLOCK]);
    let words = bytes.as_chunks::<4>().0.as_chunks::<WORDS>().0;
    for (k, words) in words.iter().enumerate() {
        let [a, b, c] = words.map(u32::from_le_bytes);
        // The last bits of the numbers that need but 24.
        (slots[k], shares[k]) = alias.slot(a, (b & 0xff) << 8 | c & 0xff);
        let unit = |word: u32| (word >> 8) as i32 as f32 * (1.0 / 16_777_216.0);
        [u[k], v[k]] = folded([unit(b), unit(c)]);
    }
    for ((number, slot), share) in numbers.iter_mut().zip(&slots).zip(&shares) {
        *number = alias.of(*slot, *share);
    }
}

/// Shares of a triangle's second and third corner from two numbers in [0, 1); those of the
/// parallelogram's other half are turned over.
#[inline]
pub(crate) fn folded([u, v]: [f32; 2]) -> [f32; 2] {
    let over = u + v > 1.0;
    [select_unpredictable(over, 1.0 - u, u), select_unpredictable(over, 1.0 - v, v)]
}

/// The shares of all three corners.
#[inline]
pub(crate) fn barycentric([u, v]: [f32; 2]) -> [f32; 3] {
    [1.0 - u - v, u, v]
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;

    #[test]
    fn blocks_give_what_single_points_do() {
        let alias = Alias::new(&[0.5, 0.0, 3.0, 1.25, 1e-3]);
        for count in [0, 1, 127, 128, 129, 1000] {
            let (mut got, mut wanted) = (Vec::new(), Vec::new());
            draws(&alias, count, &mut stream(1, "test", &[]), |Picks { numbers, u, v }| {
                got.extend(numbers.iter().zip(u).zip(v).map(|((n, u), v)| (*n, *u, *v)));
            });
            let mut random = stream(1, "test", &[]);
            for _ in 0..count {
                let mut bytes = [0; 12];
                random.bytes(&mut bytes);
                let [a, b, c] = [0, 4, 8].map(|k| u32::from_le_bytes(bytes[k..k + 4].try_into().unwrap()));
                let bits = u64::from(a) << 16 | u64::from(b & 0xff) << 8 | u64::from(c & 0xff);
                let [mut u, mut v] = [b, c].map(|word| (word >> 8) as f32 / 16_777_216.0);
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                wanted.push((alias.pick(bits), u, v));
            }
            assert_eq!(got, wanted);
        }
    }

    #[test]
    fn wide_instructions_give_what_plain_ones_do() {
        let alias = Alias::new(&[0.5, 0.0, 3.0, 1.25, 1e-3]);
        let mut bytes = [0; 4 * WORDS * BLOCK];
        stream(2, "test", &[]).bytes(&mut bytes);
        let of = |fill: fn(&Alias, &_, &mut _, &mut _, &mut _)| {
            let (mut numbers, mut u, mut v) = ([0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
            fill(&alias, &bytes, &mut numbers, &mut u, &mut v);
            (numbers, u, v)
        };
        assert_eq!(of(places), of(plain));
    }
}
