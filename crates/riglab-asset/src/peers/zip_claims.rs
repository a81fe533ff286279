//! How many members a zip archive claims, looked at before its reader makes room for them.
//!
//! The number stands at the archive's end and is believed: room for some 200 bytes a member is made
//! before the first is read. Which of several ends counts is the reader's affair, so all are looked at.

use std::io::Read;

use super::archive::Input;
use super::fault::{PeerFault, shown};

/// The least that a member takes in the list at an archive's end.
const ENTRY: u64 = 46;

/// Bytes of an end, of the longer kind, up to its numbers of members.
const END: usize = 40;

/// Bytes looked at in one go.
const BLOCK: usize = 1 << 16;

/// Refuses an archive that claims more members than it has bytes for.
pub(super) fn check(input: Input<'_>) -> Result<(), PeerFault> {
    let unreadable = |e: std::io::Error| PeerFault::Zip(shown(&e.to_string()));
    let length = input.len().map_err(unreadable)?;
    let mut file = input.open().map_err(unreadable)?;
    let mut block = Vec::with_capacity(BLOCK + 2 * END);
    loop {
        let held = block.len();
        (&mut file).take(BLOCK as u64).read_to_end(&mut block).map_err(unreadable)?;
        let is_last = block.len() == held;
        if is_last {
            // The shorter kind of end, at the file's end, is looked at like the longer.
            block.resize(held + END, 0);
        }
        let until = block.len().saturating_sub(END);
        let claims = (0..until).filter(|&at| block[at] == b'P').filter_map(|at| claimed(&block[at..], length));
        if let Some(members) = claims.max().filter(|members| *members > length / ENTRY) {
            return Err(PeerFault::Zip(format!("it claims {members} members, more than it has bytes for")));
        }
        if is_last {
            return Ok(());
        }
        block.drain(..until);
    }
}

/// What an end claims, if one begins here.
fn claimed(bytes: &[u8], length: u64) -> Option<u64> {
    let number = |at: usize, width: usize| {
        bytes[at..at + width].iter().rev().fold(0u64, |number, byte| number << 8 | u64::from(*byte))
    };
    match bytes {
        [b'P', b'K', 5, 6, ..] => Some(number(8, 2).max(number(10, 2))),
        // The four bytes alone come up in data now and then; with a length that fits they hardly do.
        [b'P', b'K', 6, 6, ..] if number(4, 8) <= length => Some(number(24, 8).max(number(32, 8))),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes, then an end of either kind with this many members.
    fn archive(before: usize, members: u64, long: bool) -> Vec<u8> {
        let mut bytes = vec![b'P'; before];
        if long {
            bytes.extend(b"PK\x06\x06");
            bytes.extend(44u64.to_le_bytes());
            bytes.extend([0; 12]);
            bytes.extend([members.to_le_bytes(), members.to_le_bytes()].concat());
            bytes.extend([0; 16]);
        } else {
            bytes.extend(b"PK\x05\x06\0\0\0\0");
            bytes.extend((members as u16).to_le_bytes());
            bytes.extend([0; 12]);
        }
        bytes
    }

    #[test]
    fn members_without_bytes_are_refused_wherever_the_end_stands() {
        for before in [0, 1000, BLOCK - 60, BLOCK - 41, BLOCK - 40, BLOCK - 10, BLOCK, 2 * BLOCK + 7] {
            for long in [false, true] {
                let fits = archive(before, 1 + before as u64 / 50, long);
                assert_eq!(check(Input::Bytes(&fits)).is_ok(), before > 0 || long, "{before}, {long}");
                let more = archive(before, 60_000, long);
                assert!(check(Input::Bytes(&more)).is_err(), "{before}, {long}");
            }
        }
        assert!(check(Input::Bytes(&archive(10, u64::MAX, true))).is_err());
        assert_eq!(check(Input::Bytes(b"")), Ok(()));
    }
}
