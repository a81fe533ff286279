//! A tiny task, for tests of the loop.

use std::cell::RefCell;
use std::sync::Arc;

use riglab_nn::params::{Builder, Init, ParamId, Params, Role, Weights};
use riglab_random::Draw;
use riglab_train::{At, Better, Interrupt, Loss, Source, Task, Validation};
use tch::{Device, Kind, Tensor};

/// A network of one hidden layer that learns products of its inputs.
pub struct Products {
    params: Params,
    first: ParamId,
    second: ParamId,
    /// Used by every third batch only, and by none at all.
    sometimes: ParamId,
    /// Raised by the last rank at `stop_at`.
    pub interrupt: Interrupt,
    pub stop_at: Option<u64>,
    /// Megabytes in use at each validation.
    pub used: RefCell<Vec<f64>>,
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
            interrupt: Interrupt::default(),
            stop_at: None,
            used: RefCell::default(),
        }
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
            y += &w[self.sometimes];
        }
        let off = (y - wanted).square().mean(Kind::Float);
        Ok(Loss::new().term("off", 1.0, off).note("batch", at.batch as f64))
    }

    fn validate(&self, w: &Weights, at: At) -> Result<Validation, String> {
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
