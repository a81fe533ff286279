//! Lines on standard output.

use std::fmt::Arguments;
use std::io::Write;

/// As `println!`, but an output that takes no more, such as a full disk, is an error and no panic.
macro_rules! say {
    ($($text:tt)*) => { $crate::say::line(format_args!($($text)*)) };
}

/// Writes a line, or ends the process with a sentence.
pub fn line(text: Arguments) {
    if let Err(e) = writeln!(std::io::stdout().lock(), "{text}") {
        eprintln!("error: standard output takes no more ({e})");
        riglab_files::leave(1);
    }
}
