//! The mark that tells riglab's files from those of others: what riglab wrote it may write again unasked.
//!
//! Each format has a place of its own for it; a rig text has none, and its mesh has it for both.

/// Who writes, for the places where files say it.
pub(crate) const MAKER: &str = concat!("riglab ", env!("CARGO_PKG_VERSION"));

/// Whether what a file says of its maker begins with riglab, of whatever version.
pub(crate) fn is_maker(said: &[u8]) -> bool {
    said.starts_with(b"riglab ")
}
