//! Sums over ranks.

use std::ops::Range;

use crate::{Link, RanksError};

/// Folds parts `0..n` along a tree: the fold of a range is that of its first half with that of its second. Parts that
/// are folded by half, quarter, ... on ranks of their own, and then together, give the same bits.
pub fn halves<T>(parts: Range<usize>, part: &mut impl FnMut(usize) -> T, add: &mut impl FnMut(T, T) -> T) -> T {
    match parts.len() {
        0 | 1 => part(parts.start),
        n => {
            let middle = parts.start + n / 2;
            let first = halves(parts.start..middle, part, add);
            let second = halves(middle..parts.end, part, add);
            add(first, second)
        }
    }
}

/// Each rank gathers and sums a piece of the values, then all hand their sums around: what any sum over ranks has to
/// send at least, for any number of them.
pub(crate) fn sum(link: &dyn Link, values: &mut [f32]) -> Result<(), RanksError> {
    let (rank, size) = (link.rank(), link.size());
    let n = values.len();
    let piece = |k: usize| n * k / size..n * (k + 1) / size;
    let own = piece(rank);
    let mut pieces = vec![Vec::new(); size];
    for d in 1..size {
        let (to, from) = ((rank + d) % size, (rank + size - d) % size);
        pieces[from] = vec![0f32; own.len()];
        link.exchange(to, bytemuck::cast_slice(&values[piece(to)]), from, bytemuck::cast_slice_mut(&mut pieces[from]))?;
    }
    pieces[rank] = values[own.clone()].to_vec();
    let add = &mut |mut a: Vec<f32>, b: Vec<f32>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    let total = halves(0..size, &mut |k| std::mem::take(&mut pieces[k]), add);
    values[own].copy_from_slice(&total);
    for d in 1..size {
        let (to, from) = ((rank + d) % size, (rank + size - d) % size);
        let arrives = piece(from);
        link.exchange(to, bytemuck::cast_slice(&total), from, bytemuck::cast_slice_mut(&mut values[arrives]))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::on_threads;

    #[test]
    fn halves_are_folded_like_the_whole() {
        let tree = |range| halves(range, &mut |k: usize| k.to_string(), &mut |a, b| format!("({a}{b})"));
        assert_eq!(tree(0..1), "0");
        assert_eq!(tree(0..6), "((0(12))(3(45)))");
        assert_eq!(tree(0..6), format!("({}{})", tree(0..3), tree(3..6)));
        assert_eq!(tree(0..8), format!("(({}{})({}{}))", tree(0..2), tree(2..4), tree(4..6), tree(6..8)));
    }

    #[test]
    fn a_sum_has_the_same_bits_on_every_rank_and_on_any_number_of_them() {
        // Sums of such numbers depend on their order.
        let part = |k: usize| -> Vec<f32> { (0..11).map(|i| (0.1 + i as f32).powi(k as i32 % 5) / 3.0).collect() };
        let add = |mut a: Vec<f32>, b: Vec<f32>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        };
        let whole = halves(0..8, &mut part.clone(), &mut { add });
        for size in [2, 4, 8] {
            let sums = on_threads(size, |ranks| {
                let each = 8 / size;
                let mut own = halves(ranks.rank() * each..(ranks.rank() + 1) * each, &mut part.clone(), &mut { add });
                ranks.sum(&mut own).unwrap();
                own
            });
            sums.iter().for_each(|sum| assert_eq!(*sum, whole, "{size} ranks"));
        }
        let three = on_threads(3, |ranks| {
            let mut own = part(ranks.rank());
            ranks.sum(&mut own).unwrap();
            own
        });
        assert_eq!(three[0], halves(0..3, &mut part.clone(), &mut { add }));
        assert!(three.iter().all(|sum| *sum == three[0]));
    }

    #[test]
    fn fewer_values_than_ranks_are_summed_too() {
        let sums = on_threads(3, |ranks| {
            let mut own = [1.0 + ranks.rank() as f32];
            ranks.sum(&mut own).unwrap();
            ranks.sum(&mut []).unwrap();
            own[0]
        });
        assert_eq!(sums, [6.0; 3]);
    }
}
