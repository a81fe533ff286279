//! Sorting of what falls into many places, few into each.

/// The items in order. Each has a place below `places` that rises with it: those of one place are found by counting, so that
/// only they are compared.
pub fn sorted_by_place<T: Copy + Ord>(mut items: Vec<T>, places: usize, place: impl Fn(&T) -> usize) -> Vec<T> {
    // To go over places costs something, too.
    if items.len() < places / 4 {
        items.sort_unstable();
        return items;
    }
    let mut next = vec![0usize; places + 1];
    items.iter().for_each(|item| next[place(item) + 1] += 1);
    for at in 0..places {
        next[at + 1] += next[at];
    }
    let mut sorted = items.clone();
    for item in &items {
        let next = &mut next[place(item)];
        sorted[*next] = *item;
        *next += 1;
    }
    // Where the next would stand is now where each place ends.
    let mut from = 0;
    for &end in &next[..places] {
        if end - from > 1 {
            sorted[from..end].sort_unstable();
        }
        from = end;
    }
    sorted
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn the_order_is_that_of_a_sort() {
        for (count, places) in [(0, 0), (0, 3), (1, 1), (50, 7), (50, 50), (50, 1000), (1000, 300)] {
            let mut random = stream(1, "test", &[count as u64, places as u64]);
            let mut below = |n: usize| (f64::from(random.unit()) * n as f64) as usize;
            let items: Vec<(usize, usize)> = (0..count).map(|_| (below(places), below(5))).collect();
            let mut wanted = items.clone();
            wanted.sort_unstable();
            assert_eq!(sorted_by_place(items, places, |item| item.0), wanted, "{count} in {places}");
        }
    }
}
