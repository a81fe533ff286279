//! Affine maps and norms.

use riglab_torch::{has_rows, norm_rows};
use tch::{Kind, Tensor};

use super::affine;
use crate::params::{Init, ParamId, Role, Scope, Weights};

/// y = x Wᵀ + b, with W of shape [out, in].
#[derive(Clone)]
pub struct Linear {
    weight: ParamId,
    bias: Option<ParamId>,
}

impl Linear {
    /// With PyTorch's start: both uniform within 1 / √in.
    pub fn new(mut at: Scope, role: Role, input: usize, output: usize, bias: bool) -> Self {
        let bound = 1.0 / (input as f64).sqrt();
        let weight = at.add("weight", role, &[output as i64, input as i64], Init::Uniform { bound });
        let bias = bias.then(|| at.add("bias", Role::Vector, &[output as i64], Init::Uniform { bound }));
        Self { weight, bias }
    }

    /// With a normal start of the given deviation and a constant bias.
    pub fn normal(mut at: Scope, role: Role, input: usize, output: usize, std: f64, bias: f64) -> Self {
        let weight = at.add("weight", role, &[output as i64, input as i64], Init::Normal { std });
        let bias = Some(at.add("bias", Role::Vector, &[output as i64], Init::Constant(bias)));
        Self { weight, bias }
    }

    /// With a normal start of the given deviation and no bias.
    pub fn plain(mut at: Scope, role: Role, input: usize, output: usize, std: f64) -> Self {
        Self { weight: at.add("weight", role, &[output as i64, input as i64], Init::Normal { std }), bias: None }
    }

    /// x [.., in] to [.., out].
    pub fn forward(&self, w: &Weights, x: &Tensor) -> Tensor {
        affine(x, &w[self.weight], self.bias.map(|b| &w[b]))
    }

    /// As an op that computes more than the map takes it; `None` without a bias.
    pub(crate) fn map<'a>(&self, w: &'a Weights) -> Option<riglab_torch::Map<'a>> {
        self.bias.map(|bias| riglab_torch::Map { weight: &w[self.weight], bias: &w[bias] })
    }

    pub(crate) fn weight(&self) -> ParamId {
        self.weight
    }

    pub(crate) fn bias(&self) -> Option<ParamId> {
        self.bias
    }
}

/// Layer norm over the last axis with gain and bias; eps 1e-5.
#[derive(Clone)]
pub struct LayerNorm {
    weight: ParamId,
    bias: ParamId,
    width: i64,
}

impl LayerNorm {
    /// Starts as the plain norm.
    pub fn new(mut at: Scope, width: usize) -> Self {
        let shape = [width as i64];
        let weight = at.add("weight", Role::Vector, &shape, Init::Constant(1.0));
        let bias = at.add("bias", Role::Vector, &shape, Init::Constant(0.0));
        Self { weight, bias, width: width as i64 }
    }

    /// As an op that computes more than the norm takes it.
    pub(crate) fn norm<'a>(&self, w: &'a Weights) -> riglab_torch::Norm<'a> {
        riglab_torch::Norm { gain: &w[self.weight], bias: &w[self.bias] }
    }

    /// Gain and bias as numbers.
    pub(crate) fn floats(&self, w: &Weights) -> (Vec<f32>, Vec<f32>) {
        let own = |id| Vec::<f32>::try_from(w[id].detach().contiguous()).expect("floats on the CPU");
        (own(self.weight), own(self.bias))
    }

    /// x [.., width], same shape out.
    pub fn forward(&self, w: &Weights, x: &Tensor) -> Tensor {
        x.layer_norm([self.width], Some(&w[self.weight]), Some(&w[self.bias]), 1e-5, false)
    }
}

/// Root-mean-square norm over the last axis with a gain: x / √(mean x² + eps) · g, computed in at least f32.
#[derive(Clone)]
pub struct RmsNorm {
    weight: ParamId,
    eps: f64,
}

impl RmsNorm {
    /// Starts as the plain norm.
    pub fn new(mut at: Scope, width: usize, eps: f64) -> Self {
        Self { weight: at.add("weight", Role::Vector, &[width as i64], Init::Constant(1.0)), eps }
    }

    /// x [.., width], same shape out.
    pub fn forward(&self, w: &Weights, x: &Tensor) -> Tensor {
        let gain = &w[self.weight];
        if has_rows(x) && gain.kind() == x.kind() {
            return norm_rows(x, gain, self.eps).unwrap_or_else(|e| panic!("{e}"));
        }
        self.plain(x) * gain
    }

    pub(crate) fn eps(&self) -> f64 {
        self.eps
    }

    /// The same before the gain, by small ops: for tensors that have no op of all (see [`has_rows`]).
    pub(crate) fn plain(&self, x: &Tensor) -> Tensor {
        let wide = if x.kind() == Kind::BFloat16 { x.to_kind(Kind::Float) } else { x.shallow_clone() };
        let mean = wide.square().mean_dim([-1i64].as_slice(), true, None::<Kind>);
        (&wide * (mean + self.eps).rsqrt()).to_kind(x.kind())
    }

    pub(crate) fn gain<'a>(&self, w: &'a Weights) -> &'a Tensor {
        &w[self.weight]
    }
}
