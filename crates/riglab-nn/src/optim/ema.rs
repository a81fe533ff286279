//! Moving average of weights.

use crate::NnError;
use crate::params::{Params, Weights};

/// avg += (1 - decay) (weights - avg), with a decay that starts low, so that the average is of
/// trained weights early on.
pub struct Ema {
    weights: Weights,
    decay: f64,
}

impl Ema {
    /// Starts at the present weights.
    pub fn new(params: &Params, decay: f64) -> Self {
        Self { weights: params.weights().detached_copy(), decay }
    }

    /// Follows the weights after step `step` (from 0): decay is min(decay, (1 + step) / (10 + step)).
    ///
    /// # Errors
    /// libtorch's message.
    pub fn update(&mut self, params: &Params, step: u64) -> Result<(), NnError> {
        let decay = self.decay.min((1.0 + step as f64) / (10.0 + step as f64));
        Ok(riglab_torch::foreach_lerp(self.weights.tensors(), params.weights().tensors(), 1.0 - decay)?)
    }

    /// The average.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }
}
