//! A run is the same on any number of ranks, and goes on on another.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use riglab_nn::params::{Builder, Init, ParamId, Params, Role, Weights};
use riglab_random::Draw;
use riglab_ranks::{Ranks, on_threads};
use riglab_train::{At, Better, Ended, Interrupt, Loss, Precision, Run, Source, Task, TrainConfig, Validation, train};
use tch::{Device, Kind, Tensor};

const STEPS: u64 = 60;

/// A network of one hidden layer that learns products of its inputs.
struct Products {
    params: Params,
    first: ParamId,
    second: ParamId,
    /// Used by every third batch only, and by none at all.
    sometimes: ParamId,
    interrupt: Interrupt,
    stop_at: Option<u64>,
}

struct Numbers;

impl Source for Numbers {
    type Batch = u64;
    fn batch(&self, number: u64) -> Result<u64, String> {
        Ok(number)
    }
}

impl Products {
    fn new() -> Self {
        let mut builder = Builder::default();
        let mut root = builder.root();
        let normal = Init::Normal { std: 0.3 };
        let first = root.add("first", Role::FeedForward, &[16, 4], normal);
        let second = root.add("second", Role::Projection, &[1, 16], normal);
        let sometimes = root.add("sometimes", Role::Vector, &[1], Init::Constant(0.1));
        root.add("never", Role::Vector, &[3], Init::Constant(1.0));
        let params = builder.finish(3, Kind::Float, Device::Cpu).unwrap();
        Self { params, first, second, sometimes, interrupt: Interrupt::default(), stop_at: None }
    }
}

impl Task for Products {
    type Batch = u64;

    fn name(&self) -> &'static str {
        "products"
    }

    fn params(&self) -> &Params {
        &self.params
    }

    fn source(&self) -> Arc<dyn Source<Batch = u64>> {
        Arc::new(Numbers)
    }

    fn loss(&self, w: &Weights, batch: &u64, at: At) -> Result<Loss, String> {
        assert_eq!(*batch, at.batch, "the batch that was made is the one that is asked for");
        if self.stop_at == Some(at.step) && at.ranks.rank() + 1 == at.ranks.size() {
            self.interrupt.raise();
        }
        let mut random = at.stream("products");
        let numbers: Vec<f32> = (0..32).map(|_| random.within(-1.0, 1.0)).collect();
        let x = Tensor::from_slice(&numbers).view([8, 4]).to_kind(w.kind());
        let wanted = x.select(1, 0) * x.select(1, 1);
        let mut y = x.matmul(&w[self.first].tr()).tanh().matmul(&w[self.second].tr()).squeeze_dim(1);
        if at.batch.is_multiple_of(3) {
            y = y + &w[self.sometimes];
        }
        let off = (y - wanted).square().mean(Kind::Float);
        Ok(Loss::new().term("off", 1.0, off).note("batch", at.batch as f64))
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
        let sum = w.tensors().iter().map(|t| t.abs().sum(Kind::Double).double_value(&[])).sum::<f64>();
        let shared = at.ranks.share(5, |k| Ok(sum * k as f64), |_| {}).map_err(|e| e.to_string())?;
        Ok(Validation { metrics: vec![("sum".into(), shared.iter().sum())], ..Validation::default() })
    }

    fn objective(&self) -> (&'static str, Better) {
        ("sum", Better::Lower)
    }
}

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
        let task = Products { stop_at: stop, ..Products::new() };
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
