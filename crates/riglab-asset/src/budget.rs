//! How much one file may ask for.
//!
//! A few bytes of a scene can stand for many: accessors and meshes are shared, constant data compresses to next to
//! nothing, missing data means zeros. So what reading makes of the bytes is counted as it is asked for, before it is
//! allocated, over the whole file. Of the corpus' rigs none asks for more than 5 times its file, but for those
//! that are compressed: up to 31 times.

use std::cell::Cell;

use crate::Fault;

/// Bytes of decoded geometry for each byte of the file and its buffers, in one piece and in all.
const PIECE: u64 = 20;
const ALL: u64 = 40;

/// And as many for small files.
const SMALL: u64 = 32 << 20;

/// What is left of a file's allowance.
pub(crate) struct Budget {
    spent: Cell<u64>,
    /// Bytes of the file and of buffers beside it.
    file: Cell<u64>,
}

impl Budget {
    /// For a file of so many bytes.
    pub(crate) fn new(file: usize) -> Self {
        Self { spent: Cell::new(0), file: Cell::new(file as u64) }
    }

    /// Adds a buffer in a file of its own.
    pub(crate) fn add_buffer(&self, bytes: usize) {
        self.file.set(self.file.get() + bytes as u64);
    }

    fn limit(&self, share: u64) -> u64 {
        self.file.get().saturating_mul(share).max(SMALL)
    }

    /// How many elements of a size may still be asked for.
    pub(crate) fn left(&self, size: usize) -> u64 {
        self.limit(ALL).saturating_sub(self.spent.get()).min(self.limit(PIECE)) / size as u64
    }

    /// Before so many elements of a size are made.
    pub(crate) fn spend(&self, count: usize, size: usize) -> Result<(), Fault> {
        let bytes = (count as u64).saturating_mul(size as u64);
        self.spent.set(self.spent.get().saturating_add(bytes));
        let found = [(bytes, PIECE, "a part of the geometry"), (self.spent.get(), ALL, "the geometry of all meshes")];
        for (bytes, share, what) in found {
            let limit = self.limit(share);
            if bytes > limit {
                return Err(Fault::Unfolded { what, bytes, limit });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_files_may_ask_for_more() {
        let budget = Budget::new(10);
        assert!(budget.spend(SMALL as usize / 4, 4).is_ok());
        assert_eq!(budget.left(12), 0);
        assert!(budget.spend(1, 1).is_err());
        // In two pieces, but not in one.
        let buffer = 4 << 20;
        budget.add_buffer(buffer);
        assert!(budget.spend(21 * buffer, 1).is_err());
        let budget = Budget::new(buffer);
        assert!(budget.spend(20 * buffer, 1).is_ok() && budget.left(12) > 1 << 20);
        assert!(budget.spend(15 * buffer, 1).is_ok());
        assert_eq!(budget.left(1), 5 * buffer as u64);
        assert!(budget.spend(usize::MAX, 12).is_err());
    }
}
