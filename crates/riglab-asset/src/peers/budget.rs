//! How much a file may make its reader hold.

use super::fault::PeerFault;

/// What a reader may hold for each byte of the file. Compressed data and lists of small objects
/// grow; what honest files come to is well below. Numbers count by what they are read into
/// ([`super::numbers::Dtype::unpacked`]), so that no piece of memory exceeds this either.
const GROWTH: u64 = 16;

/// What it may hold however small the file is.
const FLOOR: u64 = 1 << 16;

/// What may pass through without being kept, for each byte of the file: weights in dense matrices
/// are nearly all zeros and shrink a lot.
const PASSING: u64 = 256;

/// Bytes that may yet be held at a time.
#[derive(Clone, Debug)]
pub(crate) struct Budget {
    left: u64,
}

impl Budget {
    /// For a file of this length.
    pub(crate) fn of(file: u64) -> Self {
        Self { left: file.saturating_mul(GROWTH).saturating_add(FLOOR) }
    }

    /// For what is looked at and let go, of a file of this length.
    pub(crate) fn passing(file: u64) -> Self {
        Self { left: file.saturating_mul(PASSING).saturating_add(FLOOR) }
    }

    /// Claims bytes before they are allocated.
    pub(crate) fn take(&mut self, bytes: u64, what: &str) -> Result<(), PeerFault> {
        self.left = self.left.checked_sub(bytes).ok_or_else(|| PeerFault::TooLarge(super::fault::shown(what)))?;
        Ok(())
    }

    /// Gives bytes back that are held no longer.
    pub(crate) fn give_back(&mut self, bytes: u64) {
        self.left = self.left.saturating_add(bytes);
    }
}
