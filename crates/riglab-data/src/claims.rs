//! Whether a dataset can have as many rows as it says.
//!
//! A shape costs a file nothing, and what is not stored reads as zeros: a few changed bytes would have a program ask for
//! more memory than there is, which ends it without a word.

use std::path::Path;

use hdf5::Dataset;

use crate::DataError;

/// Bytes for each that is stored, where nothing is compressed: rows that were never written are not stored.
const PLAIN: u64 = 16;
/// Where it is. Deflate comes to about 1000 for what is all the same.
const PACKED: u64 = 4096;
/// What any dataset may claim.
const SMALL: u64 = 16 << 20;

/// Refuses a dataset of a file of `bytes` that claims far more than is stored.
pub(crate) fn check(path: &Path, bytes: u64, dataset: &Dataset) -> Result<(), DataError> {
    let rows = dataset.shape().iter().try_fold(1u64, |all, n| all.checked_mul(*n as u64));
    let size = dataset.dtype().map_or(1, |dtype| dtype.size()) as u64;
    let claimed = rows.and_then(|rows| rows.checked_mul(size));
    // The file says how much is stored, too.
    let stored = dataset.storage_size().min(bytes);
    if claimed.is_some_and(|claimed| is_likely(claimed, stored, !dataset.filters().is_empty())) {
        return Ok(());
    }
    let name = dataset.name().trim_start_matches('/').to_owned();
    Err(DataError::Overstated { path: path.into(), name, shape: dataset.shape(), stored })
}

fn is_likely(claimed: u64, stored: u64, packed: bool) -> bool {
    claimed <= SMALL.max(stored.saturating_mul(if packed { PACKED } else { PLAIN }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_compressed_may_be_a_thousandth() {
        const GB: u64 = 1 << 30;
        assert!(is_likely(GB, GB / 1030, true) && is_likely(GB, GB, false));
        assert!(!is_likely(GB, GB / 1030, false));
        assert!(!is_likely(1 << 40, 1 << 20, true) && !is_likely(1 << 40, 0, true));
        assert!(is_likely(0, 0, false) && is_likely(1 << 20, 100, false));
    }

    #[test]
    fn a_dataset_of_rows_that_are_not_there_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.h5");
        let file = hdf5::File::create(&path).unwrap();
        let dataset = file.new_dataset::<f32>().chunk((64, 3)).shape((0.., 3)).create("faces").unwrap();
        dataset.resize((1usize << 20, 3)).unwrap();
        assert!(check(&path, 1 << 20, &dataset).is_ok(), "12 MiB are no harm");
        dataset.resize((1usize << 40, 3)).unwrap();
        let said = check(&path, 1 << 20, &dataset).unwrap_err().to_string();
        assert!(said.contains("c.h5") && said.contains("`faces`") && said.contains("import"), "{said}");
    }
}
