//! A set of ids.

/// Which ids may follow, a bit each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    words: Vec<u64>,
    len: usize,
}

impl Mask {
    /// None of `len` ids.
    pub fn none(len: usize) -> Self {
        Self { words: vec![0; len.div_ceil(64)], len }
    }

    /// How many ids there are.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no ids at all.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The bits, from the lowest id on.
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// Forbids all.
    pub fn clear(&mut self) {
        self.words.fill(0);
    }

    /// Allows an id.
    pub fn allow(&mut self, id: u32) {
        self.words[id as usize / 64] |= 1 << (id % 64);
    }

    /// Allows a run of ids.
    pub fn allow_all(&mut self, ids: std::ops::Range<u32>) {
        for id in ids {
            self.allow(id);
        }
    }

    /// Whether an id is allowed.
    pub fn allows(&self, id: u32) -> bool {
        self.words.get(id as usize / 64).is_some_and(|w| w >> (id % 64) & 1 == 1)
    }

    /// How many are allowed.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// The allowed ids, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.words.iter().enumerate().flat_map(|(k, &word)| {
            std::iter::successors((word != 0).then_some(word), |w| Some(w & (w - 1)).filter(|w| *w != 0))
                .map(move |w| 64 * k as u32 + w.trailing_zeros())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_allowed_comes_back_in_order() {
        let mut mask = Mask::none(267);
        mask.allow_all(60..70);
        mask.allow(266);
        assert_eq!(mask.iter().collect::<Vec<_>>(), (60..70).chain([266]).collect::<Vec<_>>());
        assert_eq!((mask.count(), mask.allows(63), mask.allows(71), mask.allows(1000)), (11, true, false, false));
        mask.clear();
        assert_eq!(mask.iter().count(), 0);
    }
}
