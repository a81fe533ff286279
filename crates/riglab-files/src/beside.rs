//! Names of what lies beside a file.

use std::path::{Path, PathBuf};

/// The name of what lies beside a file: with `ending` in place of its own where that is one of `known`, of whichever case, and
/// else behind the whole name. What stands behind a point need be no ending, as in `part.1`, and `part.2` has another name.
///
/// ```
/// use riglab_files::beside;
/// let of = |name: &str| beside(name.as_ref(), &["h5"], "curation").display().to_string();
/// assert_eq!(["a/b.h5", "b.H5", "b"].map(of), ["a/b.curation", "b.curation", "b.curation"]);
/// assert_eq!(["part.1", "part.2"].map(of), ["part.1.curation", "part.2.curation"]);
/// ```
pub fn beside(path: &Path, known: &[&str], ending: &str) -> PathBuf {
    match path.extension() {
        Some(own) if !known.iter().any(|known| own.eq_ignore_ascii_case(known)) => {
            let mut whole = own.to_os_string();
            whole.push(".");
            whole.push(ending);
            path.with_extension(whole)
        }
        _ => path.with_extension(ending),
    }
}
