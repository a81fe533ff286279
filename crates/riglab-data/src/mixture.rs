//! Which asset comes at which place of an endless training sequence.

use std::sync::{Arc, Mutex, PoisonError};

use riglab_random::{Draw, stream};

/// The last of what is asked for by number.
type Kept<V> = Mutex<(u64, Arc<Vec<V>>)>;

/// Places of a block, within which every part of a mixture has its exact share.
const BLOCK: usize = 1000;

/// Parts of several weights, each gone through in epochs of an order of their own.
///
/// An asset depends on its place alone, so any worker can ask for any place, and a resumed run goes on
/// where it was by the number of its step. Shares are met in every block of a thousand places.
pub struct Mixture<T> {
    seed: u64,
    parts: Vec<Part<T>>,
    /// Which part is at each place of a block, before it is put in order.
    block: Vec<u16>,
    /// The block last asked for, put in order: at each place the part, and how many of it came before.
    held: Kept<(u16, u32)>,
}

struct Part<T> {
    of: Vec<T>,
    /// Places of a block.
    share: u64,
    /// The order of the epoch last asked for.
    held: Kept<u32>,
}

impl<T: Copy> Mixture<T> {
    /// Parts with their weights. Those without elements or weight are left out; of none that is left,
    /// the mixture is empty.
    pub fn new(seed: u64, parts: Vec<(f32, Vec<T>)>) -> Self {
        let parts: Vec<_> = parts.into_iter().filter(|(weight, of)| *weight > 0.0 && !of.is_empty()).collect();
        let total: f64 = parts.iter().map(|(weight, _)| f64::from(*weight)).sum();
        // Largest remainders, and of every part at least one place.
        let exact: Vec<f64> = parts.iter().map(|(w, _)| f64::from(*w) / total * BLOCK as f64).collect();
        let mut shares: Vec<usize> = exact.iter().map(|x| (x.floor() as usize).max(1)).collect();
        let mut rest: Vec<usize> = (0..parts.len()).collect();
        rest.sort_by(|&a, &b| (exact[b] - exact[b].floor()).total_cmp(&(exact[a] - exact[a].floor())).then(a.cmp(&b)));
        for k in rest {
            if shares.iter().sum::<usize>() < BLOCK {
                shares[k] += 1;
            }
        }
        let block = shares.iter().enumerate().flat_map(|(k, &n)| std::iter::repeat_n(k as u16, n)).collect();
        let none = || Mutex::new((u64::MAX, Arc::default()));
        let part = |((_, of), share): ((f32, Vec<T>), usize)| Part { of, share: share as u64, held: none() };
        Self {
            seed,
            parts: parts.into_iter().zip(shares).map(part).collect(),
            block,
            held: Mutex::new((u64::MAX, Arc::default())),
        }
    }

    /// Elements of all parts.
    pub fn len(&self) -> usize {
        self.parts.iter().map(|p| p.of.len()).sum()
    }

    /// Whether there is nothing to draw from.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// The element at a place. The mixture must not be empty.
    pub fn at(&self, place: u64) -> T {
        if let [only] = &self.parts[..] {
            return only.at(place, |epoch| stream(self.seed, "rig order", &[epoch]));
        }
        let size = self.block.len() as u64;
        let (block, within) = (place / size, (place % size) as usize);
        let order = kept(&self.held, block, || {
            let mut order = self.block.clone();
            stream(self.seed, "mixture", &[block]).shuffled(&mut order);
            let mut before = vec![0u32; self.parts.len()];
            let numbered = order.into_iter().map(|part| {
                let count = &mut before[usize::from(part)];
                *count += 1;
                (part, *count - 1)
            });
            numbered.collect()
        });
        let (number, before) = order[within];
        let part = &self.parts[usize::from(number)];
        let own = block * part.share + u64::from(before);
        part.at(own, |epoch| stream(self.seed, "rig order", &[epoch, u64::from(number)]))
    }
}

impl<T: Copy> Part<T> {
    fn at(&self, place: u64, random: impl Fn(u64) -> riglab_random::Stream) -> T {
        let n = self.of.len() as u64;
        let (epoch, within) = (place / n, (place % n) as usize);
        let order = kept(&self.held, epoch, || {
            let mut order: Vec<u32> = (0..n as u32).collect();
            random(epoch).shuffled(&mut order);
            order
        });
        self.of[order[within] as usize]
    }
}

/// What is kept under a number, or made for it.
fn kept<V>(held: &Kept<V>, number: u64, make: impl FnOnce() -> Vec<V>) -> Arc<Vec<V>> {
    let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
    if held.0 != number {
        *held = (number, Arc::new(make()));
    }
    held.1.clone()
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    #[test]
    fn shares_are_exact_and_every_epoch_is_whole() {
        let parts =
            || vec![(0.7, (0..50).collect()), (0.2, (100..107).collect()), (0.1, (200..1200).collect()), (1.0, vec![])];
        let mixture = Mixture::new(3, parts());
        let drawn: Vec<u32> = (0..3000).map(|place| mixture.at(place)).collect();
        for block in drawn.chunks(BLOCK) {
            let count = |range: std::ops::Range<u32>| block.iter().filter(|x| range.contains(x)).count();
            assert_eq!([count(0..50), count(100..107), count(200..1200)], [700, 200, 100]);
        }
        // Between the first and the last time that an element comes, every other comes as often.
        let mut of: HashMap<u32, usize> = HashMap::new();
        drawn.iter().filter(|x| **x < 50).take(2000).for_each(|x| *of.entry(*x).or_default() += 1);
        assert!(of.len() == 50 && of.values().all(|n| *n == 40));
        // Any place alone, in any order.
        let other = Mixture::new(3, parts());
        for place in [2999, 0, 1500, 700] {
            assert_eq!(other.at(place), drawn[place as usize]);
        }
        assert_ne!((0..3000).map(|place| Mixture::new(4, parts()).at(place)).collect::<Vec<u32>>(), drawn);
    }

    #[test]
    fn a_small_share_is_never_none() {
        let mixture = Mixture::new(0, vec![(1.0, vec![1]), (1e-6, vec![2])]);
        assert!((0..1001).any(|place| mixture.at(place) == 2));
        assert!(Mixture::<u32>::new(0, vec![(0.0, vec![1])]).is_empty());
    }
}
