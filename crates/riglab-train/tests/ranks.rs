//! A run is the same on any number of ranks, and goes on on another.

mod products;

use std::collections::BTreeMap;
use std::path::Path;

use products::Products;
use riglab_ranks::{Ranks, on_threads};
use riglab_train::{Checkpoint, Ended, Precision, Run, Task, TrainConfig, train};

const STEPS: u64 = 60;

fn config(precision: Precision) -> TrainConfig {
    let mut config =
        TrainConfig { steps: STEPS, accumulate: 8, precision, validate_every: 20, ..TrainConfig::default() };
    (config.schedule.warmup, config.save_every, config.workers) = (5, 25, 1);
    config
}

/// Trains in a folder on so many ranks; after `stop` steps one of them is asked to stop.
fn trained(dir: &Path, size: usize, precision: Precision, stop: Option<u64>) -> Vec<Ended> {
    let config = config(precision);
    on_threads(size, |ranks: Ranks| {
        let new = !dir.join("config.toml").exists();
        let ranks_ready = ranks.told(new).unwrap();
        let run = match (ranks.leads(), ranks_ready) {
            (true, true) => Run::create(dir, "").unwrap(),
            (true, false) => Run::open(dir).unwrap(),
            (false, _) => Run::follow(dir),
        };
        let mut task = Products::new();
        task.stop_at = stop;
        let ended = train(&task, &config, &run, &task.interrupt, &ranks);
        if let Err(e) = &ended {
            ranks.end(&e.to_string());
        }
        ended.unwrap().ended
    })
}

/// What counts of a run: its weights, optimizer and metrics.
fn result(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = ["checkpoints/last/model.safetensors", "checkpoints/last/optimizer.safetensors", "metrics.jsonl"];
    files.iter().map(|f| (f.to_string(), std::fs::read(dir.join(f)).unwrap())).collect()
}

fn same(a: &BTreeMap<String, Vec<u8>>, b: &BTreeMap<String, Vec<u8>>, what: &str) {
    a.iter().for_each(|(file, bytes)| assert!(b[file] == *bytes, "{what}: {file} differs"));
}

#[test]
fn the_number_of_ranks_changes_no_bit() {
    tch::set_num_threads(1);
    for precision in [Precision::Fp32, Precision::Bf16] {
        let dir = tempfile::tempdir().unwrap();
        let run = |size: usize| {
            let folder = dir.path().join(size.to_string());
            assert_eq!(trained(&folder, size, precision, None), vec![Ended::Finished; size]);
            result(&folder)
        };
        let one = run(1);
        for size in [2, 4, 8] {
            same(&one, &run(size), &format!("{size} ranks, {precision:?}"));
        }
        let lines = String::from_utf8(one["metrics.jsonl"].clone()).unwrap();
        assert!(lines.lines().count() as u64 > STEPS && lines.contains("eval/sum"), "{lines}");
    }
}

#[test]
fn a_run_that_stopped_goes_on_on_another_number_of_ranks() {
    tch::set_num_threads(1);
    let dir = tempfile::tempdir().unwrap();
    let (whole, broken) = (dir.path().join("whole"), dir.path().join("broken"));
    trained(&whole, 1, Precision::Fp32, None);
    assert_eq!(trained(&broken, 2, Precision::Fp32, Some(7)), [Ended::Interrupted; 2]);
    assert_eq!(trained(&broken, 1, Precision::Fp32, Some(31)), [Ended::Interrupted; 1]);
    assert_eq!(trained(&broken, 4, Precision::Fp32, None), [Ended::Finished; 4]);
    same(&result(&whole), &result(&broken), "after two stops");
}

#[test]
fn frozen_parts_stay_as_they_began_on_any_number_of_ranks() {
    // `second` is read by all batches, `sometimes` by every third: with all else frozen, some have no gradient.
    for (frozen, learns) in [(&["second", "never"][..], "first"), (&["first", "second"], "sometimes")] {
        for precision in [Precision::Fp32, Precision::Bf16] {
            let frozen_parts = frozen.iter().map(|f| (*f).to_string()).collect();
            let config = TrainConfig { frozen: frozen_parts, ..config(precision) };
            let dir = tempfile::tempdir().unwrap();
            let trained = |size: usize| {
                let folder = dir.path().join(size.to_string());
                let ended = on_threads(size, |ranks: Ranks| {
                    let task = Products::new();
                    let run = if ranks.leads() { Run::create(&folder, "").unwrap() } else { Run::follow(&folder) };
                    train(&task, &config, &run, &task.interrupt, &ranks).unwrap().ended
                });
                assert_eq!(ended, vec![Ended::Finished; size]);
                result(&folder)
            };
            tch::set_num_threads(1);
            let one = trained(1);
            same(&one, &trained(2), &format!("2 ranks, {precision:?}"));
            let (start, end) = (Products::new(), Products::new());
            let last = dir.path().join("1/checkpoints/last");
            Checkpoint::open(&last).unwrap().load_weights(end.params()).unwrap();
            for (id, name) in start.params().ids().map(|id| (id, start.params().name(id))) {
                let stayed = start.params().weights()[id].equal(&end.params().weights()[id]);
                assert_eq!(stayed, frozen.contains(&name) || name == "never", "{name} where {learns} learns");
            }
            let optimizer = String::from_utf8_lossy(&one["checkpoints/last/optimizer.safetensors"]).into_owned();
            assert!(optimizer.contains(learns) && !optimizer.contains(frozen[1]), "no state of what stays");
        }
    }
    let dir = tempfile::tempdir().unwrap();
    let config = TrainConfig { frozen: vec!["third".into()], ..config(Precision::Fp32) };
    let errors = on_threads(1, |ranks| {
        let task = Products::new();
        train(&task, &config, &Run::follow(dir.path()), &task.interrupt, &ranks).unwrap_err().to_string()
    });
    assert!(errors[0].contains("`third`") && errors[0].contains("first"), "{}", errors[0]);
}

#[test]
fn batches_that_cannot_be_shared_and_ranks_that_fail_are_told() {
    let config = TrainConfig { accumulate: 3, ..config(Precision::Fp32) };
    let dir = tempfile::tempdir().unwrap();
    let errors = on_threads(2, |ranks| {
        let task = Products::new();
        let run = Run::follow(dir.path());
        train(&task, &config, &run, &task.interrupt, &ranks).unwrap_err().to_string()
    });
    errors.iter().for_each(|e| assert!(e.contains("accumulate = 3") && e.contains("multiple of 2"), "{e}"));
}
