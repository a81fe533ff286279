//! How much one file may ask for.
//!
//! A few bytes of a scene can stand for many: accessors and meshes are shared, constant data compresses to next to
//! nothing, missing data means zeros. So what reading makes of the bytes is counted as it is asked for, before it is
//! allocated, over the whole file. Of the corpus' rigs none asks for more than 5 times its file, but for those
//! that are compressed: up to 31 times.
//!
//! What is decoded and what is shown count apart. Props and crowds are one mesh on hundreds of nodes: that is many
//! times the file and still no large scene, so it has an absolute bound, too.

use std::cell::Cell;

use crate::Fault;

/// Bytes of decoded geometry for each byte of the file and its buffers, in one piece and in all.
const PIECE: u64 = 20;
const ALL: u64 = 40;

/// And as many for small files.
const SMALL: u64 = 32 << 20;

/// Bytes of all that nodes show, likewise.
const SHOWN: u64 = 64;

/// And as many for small files: some millions of vertices.
const SMALL_SHOWN: u64 = 256 << 20;

/// Bytes of a part on a node besides its numbers: the part, its vertices' set and their places among others.
pub(crate) const PART: u64 = 512;

/// Bytes of a triangle, as read and in the mesh that comes of it.
pub(crate) const TRIANGLE: u64 = 2 * 12;

/// Bytes of a vertex: its number, and its position as read and in the mesh.
pub(crate) const VERTEX: u64 = 4 + 2 * 12;

/// Bytes of a vertex's number among those that a part uses.
pub(crate) const USED: u64 = 4;

/// Bytes of a vertex's weight on the one joint that it hangs on.
pub(crate) const RIGID_ROW: u64 = row(1);

/// Bytes of a vertex's weights, as read and in the rig: where they end, and a joint and a weight for each influence.
pub(crate) const fn row(influences: u64) -> u64 {
    2 * (4 + 6 * influences)
}

/// What is left of a file's allowance.
pub(crate) struct Budget {
    spent: Cell<u64>,
    shown: Cell<u64>,
    /// Bytes of the file and of buffers beside it.
    file: Cell<u64>,
}

impl Budget {
    /// For a file of so many bytes.
    pub(crate) fn new(file: usize) -> Self {
        Self { spent: Cell::new(0), shown: Cell::new(0), file: Cell::new(file as u64) }
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

    /// Before so many elements of a size are made for a moment.
    pub(crate) fn piece(&self, count: usize, size: usize) -> Result<(), Fault> {
        let (bytes, limit) = ((count as u64).saturating_mul(size as u64), self.limit(PIECE));
        match bytes > limit {
            true => Err(Fault::Unfolded { what: "a part of the geometry", bytes, limit }),
            false => Ok(()),
        }
    }

    /// Before a mesh comes to so many bytes on each of some nodes. What is read of it, kept for it and made of it in
    /// the end all count: they are held at once.
    pub(crate) fn show(&self, bytes: u64, nodes: usize) -> Result<(), Fault> {
        self.shown.set(self.shown.get().saturating_add(bytes.saturating_mul(nodes as u64)));
        let limit = self.file.get().saturating_mul(SHOWN).max(SMALL_SHOWN);
        match self.shown.get() {
            bytes if bytes > limit => Err(Fault::Shown { bytes, limit }),
            _ => Ok(()),
        }
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

    #[test]
    fn what_nodes_show_has_an_allowance_of_its_own() {
        let budget = Budget::new(10);
        assert!(budget.spend(SMALL as usize, 1).is_ok());
        assert!(budget.show(SMALL_SHOWN / 500, 500).is_ok());
        assert_eq!(budget.show(500, 1), Err(Fault::Shown { bytes: SMALL_SHOWN / 500 * 500 + 500, limit: SMALL_SHOWN }));
        assert!(Budget::new(8 << 20).show(1 << 20, 512).is_ok());
        assert!(Budget::new(10).show(u64::MAX, usize::MAX).is_err());
    }
}
