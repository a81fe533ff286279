//! The norm behind the stem.

use tch::{Kind, Tensor};

use super::Norm;
use crate::layers::LayerNorm;
use crate::params::{Init, ParamId, Role, Scope, Weights};

/// ε of the released batch norm.
const EPS: f64 = 1e-3;

pub(super) enum StemNorm {
    Layer(LayerNorm),
    /// Gain, bias, and mean and variance that were measured while the released weights were trained.
    Batch([ParamId; 4]),
}

impl StemNorm {
    pub fn new(mut at: Scope, width: usize, norm: Norm) -> Self {
        let mut vector = |name, start| at.add(name, Role::Vector, &[width as i64], Init::Constant(start));
        match norm {
            Norm::Layer => Self::Layer(LayerNorm::new(at, width)),
            Norm::Batch => Self::Batch([
                vector("weight", 1.0),
                vector("bias", 0.0),
                vector("running_mean", 0.0),
                vector("running_var", 1.0),
            ]),
        }
    }

    pub fn forward(&self, w: &Weights, x: &Tensor) -> Tensor {
        match self {
            Self::Layer(norm) => norm.forward(w, x),
            Self::Batch([gain, bias, mean, variance]) => {
                // Statistics have no gradient, so no optimizer moves or decays them.
                let (mean, variance) = (w[*mean].detach(), w[*variance].detach());
                let scale = (variance.to_kind(wide(w)) + EPS).rsqrt().to_kind(w.kind());
                (x - mean) * scale * &w[*gain] + &w[*bias]
            }
        }
    }
}

fn wide(w: &Weights) -> Kind {
    if w.kind() == Kind::Double { Kind::Double } else { Kind::Float }
}
