//! Files written whole or not at all, folders walked to their end, and what a process does that is asked to leave.
//!
//! The one idea: **what is unfinished has another name.** A file is written under a temporary name in
//! its own folder, synced and renamed, so a kill at any moment leaves what was there; the names of
//! unfinished files are known, so a process that is asked to leave takes them with it. Those of one that was killed are
//! removed by the next that writes into their folder on the same machine. A file that replaces another may be read and
//! written by the same users, where it can be given to them, and what is write-protected is not replaced.
//!
//! Leaves out: what is in the files.

mod beside;
mod lock;
mod place;
mod signals;
mod stale;
mod unfinished;
mod walk;
mod write;

pub use beside::beside;
pub use lock::is_locked;
pub use place::is_as_of_folder;
pub use signals::{Signal, on_signals, was_asked};
pub use unfinished::{Unfinished, ask_to_leave, leave, may_replace};
pub use walk::{Below, below};
pub use write::{make_folder_of, may_write, sync_folder, write, write_first, write_with};
