//! Convolution over occupied cells only.

use tch::{Device, Tensor};

use super::layout::Taps;
use crate::layers::affine;
use crate::params::{Init, ParamId, Role, Scope, Weights};

/// A kernel's neighbours on a device.
pub struct TapTensors {
    side: i64,
    /// Number of the tap, points read, points written; none that is empty.
    taps: Vec<(i64, Tensor, Tensor)>,
}

impl TapTensors {
    /// Of neighbours.
    pub fn new(taps: &Taps, device: Device) -> Self {
        let last = taps.side.pow(3) as i64 - 1;
        let of = |v: &[i64]| Tensor::from_slice(v).to_device(device);
        let mut all = Vec::new();
        for (k, (read, written)) in taps.pairs.iter().enumerate().filter(|(_, p)| !p.0.is_empty()) {
            let (read, written) = (of(read), of(written));
            all.push((last - k as i64, written.shallow_clone(), read.shallow_clone()));
            all.push((k as i64, read, written));
        }
        all.sort_by_key(|t| t.0);
        Self { side: taps.side as i64, taps: all }
    }

    /// The same tensors.
    pub(super) fn shared(&self) -> Self {
        let taps = self.taps.iter().map(|(k, read, written)| (*k, read.shallow_clone(), written.shallow_clone()));
        Self { side: self.side, taps: taps.collect() }
    }
}

/// Submanifold convolution: out[p] = Σ_k W[k] in[p + k - middle] + b over occupied cells (Graham and van der
/// Maaten 2017), weights [out, side, side, side, in]. What represents a cell of several points: see [`Taps`].
///
/// One product a tap, added up in the order of taps: within a tap each point is written by one other unless
/// cells have several points, so the sum is the same on every run.
#[derive(Clone)]
pub struct SubmConv {
    weight: ParamId,
    bias: Option<ParamId>,
    side: i64,
}

impl SubmConv {
    /// With PyTorch's start: uniform within 1 / √(side³ in).
    pub fn new(mut at: Scope, input: usize, output: usize, side: usize, bias: bool) -> Self {
        let (i, o, s) = (input as i64, output as i64, side as i64);
        let bound = 1.0 / ((side.pow(3) * input) as f64).sqrt();
        let weight = at.add("weight", Role::Projection, &[o, s, s, s, i], Init::Uniform { bound });
        let bias = bias.then(|| at.add("bias", Role::Vector, &[o], Init::Uniform { bound }));
        Self { weight, bias, side: s }
    }

    /// x [n, in] to [n, out].
    pub fn forward(&self, w: &Weights, x: &Tensor, taps: &TapTensors) -> Tensor {
        assert_eq!(self.side, taps.side, "neighbours of another kernel");
        let taps_of = w[self.weight].flatten(1, 3);
        let weight = |k: i64| taps_of.select(1, k);
        let mut out = affine(x, &weight(self.side.pow(3) / 2), self.bias.map(|b| &w[b]));
        for (k, read, written) in &taps.taps {
            let part = affine(&x.index_select(0, read), &weight(*k), None);
            out = out.index_add_(0, written, &part);
        }
        out
    }
}
