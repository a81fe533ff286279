//! What a path says of what is to stand there.

use std::path::{Path, is_separator};

/// Whether a path is written as a folder's, by a separator at its end, whatever is there: no file can be put there.
pub fn is_as_of_folder(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(is_separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_separator_at_the_end_means_a_folder() {
        for (path, folder) in
            [("a/", true), ("a.h5//", true), ("/", true), ("a", false), ("a/b.h5", false), ("", false)]
        {
            assert_eq!(is_as_of_folder(Path::new(path)), folder, "{path}");
        }
    }
}
