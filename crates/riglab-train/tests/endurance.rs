//! Memory stays what it was, however long a run is.
//!
//! A few thousand steps by default; `RIGLAB_STEPS=100000` for the long test.

mod products;

use std::path::Path;

use products::Products;
use riglab_ranks::{Ranks, on_threads};
use riglab_train::{Ended, Run, TrainConfig, train};

fn steps() -> u64 {
    std::env::var("RIGLAB_STEPS").ok().and_then(|n| n.parse().ok()).unwrap_or(3000)
}

/// Trains in a folder; gives megabytes in use after a quarter of the steps, and at the end.
fn megabytes(dir: &Path, ranks: &Ranks) -> (f64, f64) {
    let steps = steps();
    let mut config =
        TrainConfig { steps, accumulate: 2, validate_every: steps / 4, workers: 1, ..TrainConfig::default() };
    (config.save_every, config.log_every) = (steps / 20, 100);
    let run = if ranks.leads() { Run::create(dir, "").unwrap() } else { Run::follow(dir) };
    let task = Products::new();
    let outcome = train(&task, &config, &run, &task.interrupt, ranks).unwrap();
    assert_eq!(outcome.ended, Ended::Finished);
    let used = task.used.borrow();
    // The first validation is after a quarter.
    (used[0], used[used.len() - 1])
}

#[test]
fn memory_is_flat() {
    tch::set_num_threads(1);
    let dir = tempfile::tempdir().unwrap();
    for size in [1, 2] {
        let folder = dir.path().join(size.to_string());
        // Rank by rank they tell of the same process.
        let (early, late) = on_threads(size, |ranks| megabytes(&folder, &ranks))[0];
        eprintln!("{size} ranks, {} steps: {early:.1} MB after a quarter, {late:.1} MB at the end", steps());
        assert!(late <= 1.02 * early, "{size} ranks: {early:.1} MB grew to {late:.1} MB");
    }
}
