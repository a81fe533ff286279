//! Lines on standard output and standard error.

use std::fmt::Arguments;
use std::io::Write;

/// As `println!`, but an output that takes no more, such as a full disk, is an error and no panic.
macro_rules! say {
    ($($text:tt)*) => { $crate::say::line(format_args!($($text)*)) };
}

/// As `eprintln!`, but a standard error that takes no more ends nothing.
macro_rules! tell {
    ($($text:tt)*) => { riglab_train::tell(format_args!($($text)*)) };
}

/// What a shell gives for a process that ended as nobody read on: 128 and SIGPIPE.
const NOBODY_READS: i32 = 141;

/// Writes a line, or ends the process with a sentence.
pub fn line(text: Arguments) {
    whole(format_args!("{text}\n"));
}

/// Writes what ends its last line itself, or ends the process with a sentence.
pub fn whole(text: Arguments) {
    if let Err(e) = write!(std::io::stdout().lock(), "{}", riglab_train::plain(text)) {
        // `riglab inspect FILE | head` ends quietly when `head` has enough. The signal would leave half-written files, and
        // would come for standard error, too, whose reader may go while the work goes on.
        if e.kind() == std::io::ErrorKind::BrokenPipe {
            riglab_files::leave(NOBODY_READS);
        }
        tell!("error: standard output takes no more ({e})");
        riglab_files::leave(1);
    }
}
