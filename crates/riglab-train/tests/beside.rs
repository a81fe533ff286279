//! Batches of a step side by side give what they give one after another.

mod products;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;

use products::{Fault, Products};
use riglab_ranks::ALONE;
use riglab_train::{Precision, Run, Task, TrainConfig, TrainError, estimate, sides, train};

/// libtorch's number of threads is everybody's.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn config(precision: Precision) -> TrainConfig {
    let mut config = TrainConfig { steps: 30, accumulate: 4, precision, validate_every: 15, ..TrainConfig::default() };
    (config.schedule.warmup, config.save_every, config.workers) = (5, 15, 1);
    config
}

fn trained(dir: &Path, threads: i32, task: &Products, config: &TrainConfig) -> Result<(), TrainError> {
    tch::set_num_threads(threads);
    let ended = train(task, config, &Run::create(dir, "").unwrap(), &task.interrupt, &ALONE);
    assert_eq!(tch::get_num_threads(), threads, "as it was");
    ended.map(drop)
}

/// What counts of a run: its weights, optimizer and metrics.
fn result(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = ["checkpoints/last/model.safetensors", "checkpoints/last/optimizer.safetensors", "metrics.jsonl"];
    files.iter().map(|f| (f.to_string(), std::fs::read(dir.join(f)).unwrap())).collect()
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(|e| e.into_inner());
    let dir = tempfile::tempdir().unwrap();
    let cases = [
        (Precision::Fp32, false, &[][..]),
        (Precision::Bf16, false, &[]),
        (Precision::Fp32, true, &[]),
        (Precision::Fp32, false, &["first", "second"]),
    ];
    for (k, (precision, recompute, frozen)) in cases.into_iter().enumerate() {
        let frozen: Vec<String> = frozen.iter().map(|part: &&str| (*part).to_string()).collect();
        let run = |threads: i32, accumulate: u64| {
            let folder = dir.path().join(format!("{k}-{threads}-{accumulate}"));
            let mut task = Products::new();
            task.dropout = 0.2;
            let frozen = frozen.clone();
            let config = TrainConfig { accumulate, recompute, frozen, ..config(precision) };
            trained(&folder, threads, &task, &config).unwrap();
            let took_part = task.threads.lock().unwrap().len();
            (result(&folder), took_part)
        };
        let (alone, threads) = run(1, 4);
        assert_eq!(threads, 1);
        for threads in [2, 3, 4] {
            let (together, took_part) = run(threads, 4);
            // Three threads would need as many rounds as two.
            assert_eq!(took_part, [2, 2, 4][threads as usize - 2]);
            alone
                .iter()
                .for_each(|(file, bytes)| assert!(together[file] == *bytes, "{threads} threads: {file} differs"));
        }
        let (fewer, _) = run(2, 2);
        assert!(alone.iter().any(|(file, bytes)| fewer[file] != *bytes), "such a test can fail");
    }
}

#[test]
fn what_goes_wrong_beside_ends_the_run() {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(|e| e.into_inner());
    let dir = tempfile::tempdir().unwrap();
    for (fault, said) in [(Fault::Error, "a batch beside"), (Fault::Panic, "ended unexpectedly")] {
        let mut task = Products::new();
        task.fault = Some((4 * 20 + 1, fault));
        let folder = dir.path().join(said);
        let error = trained(&folder, 2, &task, &config(Precision::Fp32)).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
        assert!(folder.join("checkpoints/last/model.safetensors").is_file(), "what was saved stays");
    }
}

#[test]
fn what_others_compute_counts_and_fewer_can_be_asked_for() {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(|e| e.into_inner());
    let flops = |threads: i32, side_by_side: u64| {
        tch::set_num_threads(threads);
        let (task, config) = (Products::new(), TrainConfig { side_by_side, ..config(Precision::Fp32) });
        (sides(&task, &config, &ALONE), estimate(&task, &config).unwrap().flops)
    };
    let (alone, one) = flops(1, 0);
    assert!(alone == 1 && one > 0.0);
    assert_eq!(flops(2, 0), (2, one));
    assert_eq!(flops(4, 0), (4, one));
    assert_eq!(flops(4, 1), (1, one));
}

#[test]
fn what_is_frozen_takes_no_gradients_in_an_estimate() {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(|e| e.into_inner());
    tch::set_num_threads(1);
    let gradients = |frozen: &[String]| {
        let task = Products::new();
        task.params().freeze(frozen).unwrap();
        let found = estimate(&task, &config(Precision::Fp32)).unwrap();
        found.memory_mb.iter().find(|(name, _)| name == "gradients").unwrap().1
    };
    // 84 numbers of four bytes, of which one part has 64; of four batches two sums wait while the last is computed.
    assert_eq!(gradients(&[]), 3.0 * 84.0 * 4.0 / 1e6);
    assert_eq!(gradients(&["first".into()]), 3.0 * 20.0 * 4.0 / 1e6);
}

#[test]
fn an_estimate_is_of_the_last_steps() {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(|e| e.into_inner());
    tch::set_num_threads(2);
    let of = |steps: u64, faulty_step: u64| {
        let mut task = Products::new();
        // The second batch of the step, which is computed beside the first.
        task.fault = Some((4 * faulty_step + 1, Fault::Error));
        estimate(&task, &TrainConfig { steps, ..config(Precision::Fp32) })
    };
    // Parts of a loss may have no weight in the first ones.
    assert!(of(1000, 0).is_ok());
    assert!(of(1000, 900).is_err());
    assert!(of(5, 0).is_err(), "a short run has no later ones");
}

#[test]
fn an_estimate_counts_once_what_the_first_validation_makes_ready() {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(|e| e.into_inner());
    tch::set_num_threads(1);
    let of = |validate_every: u64| {
        let mut task = Products::new();
        task.readied_in = std::time::Duration::from_secs(2);
        let config = TrainConfig { validate_every, ..config(Precision::Fp32) };
        (estimate(&task, &config).unwrap(), task.used.borrow().len())
    };
    let (found, times) = of(1);
    assert_eq!(times, 2);
    assert!(found.first_validation_seconds > 2.0 && found.validation_seconds < 1.0, "{found:?}");
    let steps = 30.0 * found.step_seconds;
    let wanted = steps + found.first_validation_seconds + 29.0 * found.validation_seconds;
    assert!((found.seconds - wanted).abs() < 1e-9, "{found:?}");
    let (only, times) = of(0);
    assert_eq!((times, only.first_validation_seconds), (1, only.validation_seconds));
    assert!((only.seconds - 30.0 * only.step_seconds - only.validation_seconds).abs() < 1e-9, "{only:?}");
}
