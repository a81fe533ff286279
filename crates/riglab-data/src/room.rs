//! Room on the disk, taken before it is needed.
//!
//! The HDF5 library does not survive a full disk: a chunk that cannot be flushed leaves it in a state
//! in which its next call may crash the process. So blocks are reserved before HDF5 writes into them.

use std::fs::File;
use std::io;
use std::path::Path;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};

/// Reserves a file's first `bytes` bytes without changing its length. File systems that cannot
/// reserve (some network ones) are trusted.
///
/// # Errors
/// When there is no such room, by disk, quota or the process's limit.
pub(crate) fn reserve(path: &Path, bytes: u64) -> io::Result<()> {
    if getrlimit(Resource::Fsize).current.is_some_and(|most| bytes > most) {
        return Err(Errno::FBIG.into());
    }
    let file = File::options().write(true).open(path)?;
    match fallocate(&file, FallocateFlags::KEEP_SIZE, 0, bytes) {
        Err(Errno::OPNOTSUPP | Errno::NOSYS | Errno::INVAL) | Ok(()) => Ok(()),
        Err(e) => Err(e.into()),
    }
}

/// Gives back what was reserved beyond a file's end.
///
/// # Errors
/// The file system's.
pub(crate) fn release(file: &File) -> io::Result<()> {
    file.set_len(file.metadata()?.len())
}
