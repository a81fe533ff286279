//! A tiny task, for tests of the loop.

#![allow(dead_code)] // each test takes what it needs

use std::cell::RefCell;
use std::collections::HashSet;
use std::sync::{Arc, Mutex};
use std::thread::ThreadId;
use std::time::Duration;

use riglab_nn::params::{Builder, Init, ParamId, Params, Role, Weights};
use riglab_random::Draw;
use riglab_train::{At, Better, Interrupt, Loss, LossOf, Source, Task, Validation};
use tch::{Device, Kind, Tensor};

/// A network of one hidden layer that learns products of its inputs.
pub struct Products {
    params: Params,
    first: ParamId,
    second: ParamId,
    /// Used by every third batch only, and by none at all.
    sometimes: ParamId,
    /// Dropout of what the hidden layer gives.
    pub dropout: f64,
    /// Threads that computed a loss.
    pub threads: Arc<Mutex<HashSet<ThreadId>>>,
    /// What a batch of that number does instead of giving a loss, if not on the thread of the run.
    pub fault: Option<(u64, Fault)>,
    /// Raised by the last rank at `stop_at`.
    pub interrupt: Interrupt,
    pub stop_at: Option<u64>,
    /// Megabytes in use at each validation.
    pub used: RefCell<Vec<f64>>,
    /// How long the first validation makes things ready.
    pub readied_in: Duration,
}

/// What can go wrong beside.
#[derive(Clone, Copy, Debug)]
pub enum Fault {
    Error,
    Panic,
}

struct Numbers;

impl Source for Numbers {
    type Batch = u64;
    fn batch(&self, number: u64) -> Result<u64, String> {
        Ok(number)
    }
}

impl Products {
    pub fn new() -> Self {
        let mut builder = Builder::default();
        let mut root = builder.root();
        let normal = Init::Normal { std: 0.3 };
        let first = root.add("first", Role::FeedForward, &[16, 4], normal);
        let second = root.add("second", Role::Projection, &[1, 16], normal);
        let sometimes = root.add("sometimes", Role::Vector, &[1], Init::Constant(0.1));
        root.add("never", Role::Vector, &[3], Init::Constant(1.0));
        let params = builder.finish(3, Kind::Float, Device::Cpu).unwrap();
        Self {
            params,
            first,
            second,
            sometimes,
            dropout: 0.0,
            threads: Arc::default(),
            fault: None,
            interrupt: Interrupt::default(),
            stop_at: None,
            used: RefCell::default(),
            readied_in: Duration::ZERO,
        }
    }
}

impl Products {
    fn layers(&self) -> [ParamId; 3] {
        [self.first, self.second, self.sometimes]
    }
}

/// The loss of a batch.
fn off([first, second, sometimes]: [ParamId; 3], dropout: f64, w: &Weights, at: At) -> Loss {
    let mut random = at.stream("products");
    let numbers: Vec<f32> = (0..32).map(|_| random.within(-1.0, 1.0)).collect();
    let x = Tensor::from_slice(&numbers).view([8, 4]).to_kind(w.kind());
    let wanted = x.select(1, 0) * x.select(1, 1);
    let hidden = x.matmul(&w[first].tr()).tanh();
    let hidden = if dropout > 0.0 { riglab_torch::dropout(&hidden, dropout).unwrap() } else { hidden };
    let mut y = hidden.matmul(&w[second].tr()).squeeze_dim(1);
    if at.batch.is_multiple_of(3) {
        y += &w[sometimes];
    }
    let off = (y - wanted).square().mean(Kind::Float);
    Loss::new().term("off", 1.0, off).note("batch", at.batch as f64)
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
        self.threads.lock().unwrap().insert(std::thread::current().id());
        Ok(off(self.layers(), self.dropout, w, at))
    }

    fn beside(&self) -> Option<LossOf<u64>> {
        let (layers, dropout, threads, fault) = (self.layers(), self.dropout, self.threads.clone(), self.fault);
        Some(Box::new(move |w, batch, at| {
            assert_eq!(*batch, at.batch);
            match fault.filter(|(number, _)| *number == at.batch) {
                Some((_, Fault::Error)) => return Err("a batch beside".into()),
                Some((_, Fault::Panic)) => panic!("as asked"),
                None => {}
            }
            threads.lock().unwrap().insert(std::thread::current().id());
            Ok(off(layers, dropout, w, at))
        }))
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
        if self.used.borrow().is_empty() {
            std::thread::sleep(self.readied_in);
        }
        let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = text.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or_default();
        self.used
            .borrow_mut()
            .extend(line.trim().split(' ').next().and_then(|n| n.parse::<f64>().ok()).map(|k| k / 1e3));
        let sum = w.tensors().iter().map(|t| t.abs().sum(Kind::Double).double_value(&[])).sum::<f64>();
        let shared = at.ranks.share(5, |k| Ok(sum * k as f64), |_| {}).map_err(|e| e.to_string())?;
        Ok(Validation { metrics: vec![("sum".into(), shared.iter().sum())], ..Validation::default() })
    }

    fn objective(&self) -> (&'static str, Better) {
        ("sum", Better::Lower)
    }
}
