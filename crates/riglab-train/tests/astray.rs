//! Training that gives no numbers, and what is left of it.

mod products;

use std::collections::BTreeMap;

use products::Products;
use riglab_nn::params::Params;
use riglab_ranks::ALONE;
use riglab_train::{Checkpoint, Run, RunInfo, State, Task, TrainConfig, TrainError, train};

/// Makes NaN of all weights.
fn spoil(params: &Params) {
    let named = params.named(params.weights());
    params.load(&named.map(|(n, t)| (n.to_string(), t.full_like(f64::NAN))).collect::<BTreeMap<_, _>>()).unwrap();
}

#[test]
fn a_run_that_took_no_step_fails() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::create(&dir.path().join("run"), "").unwrap();
    let (task, config) = (Products::new(), TrainConfig { steps: 3, workers: 0, ..TrainConfig::default() });
    spoil(task.params());
    run.write_info(&RunInfo { seconds: 5.0, ..RunInfo::default() }).unwrap();
    let e = train(&task, &config, &run, &task.interrupt, &ALONE).unwrap_err();
    let said = e.to_string();
    assert!(matches!(e, TrainError::NotFinite(_)) && said.contains("no step was taken: none of 3"), "{said}");
    assert!(said.contains("train.optim.adamw_lr"), "{said}");
    assert!(run.info().unwrap().unwrap().seconds > 5.0, "its time counts all the same, up to its checkpoint");
}

#[test]
fn weights_that_are_no_numbers_are_refused_by_name() {
    let (dir, task) = (tempfile::tempdir().unwrap(), Products::new());
    spoil(task.params());
    let state = State { task: "t".into(), step: 7, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
    Checkpoint::plant(dir.path(), task.params(), &state).unwrap();
    let found = Checkpoint::open(&dir.path().join("checkpoints/best")).unwrap();
    let said = found.load_weights(Products::new().params()).unwrap_err().to_string();
    assert!(said.contains("model.safetensors: tensor `first` holds NaN") && said.contains("diverged"), "{said}");
}
