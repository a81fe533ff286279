//! Losses of skin reconstruction (SkinTokens 3.2.3) and one extension.
//!
//! `logits`, `predicted` and `weights` are [m, n]: m bones, n points each. `mass` [m, n], where
//! given, says how much each point counts; each bone's mean is 1.

use tch::{Kind, Reduction, Tensor};

/// ε of [`dice`].
pub const DICE_EPS: f64 = 1e-4;

/// Binary cross-entropy of sigmoid(logits) and soft targets, mean over bones and points.
pub fn bce(logits: &Tensor, weights: &Tensor, mass: Option<&Tensor>) -> Tensor {
    logits.binary_cross_entropy_with_logits(weights, mass, None::<&Tensor>, Reduction::Mean)
}

/// Mean squared error of predicted weights.
pub fn mse(predicted: &Tensor, weights: &Tensor, mass: Option<&Tensor>) -> Tensor {
    match mass {
        Some(mass) => ((predicted - weights).square() * mass).mean(None::<Kind>),
        None => predicted.mse_loss(weights, Reduction::Mean),
    }
}

/// One value a bone: 1 - (2 Σ w ŵ + ε) / (Σ ŵ² + Σ w² + ε).
pub fn dice(predicted: &Tensor, weights: &Tensor, mass: Option<&Tensor>) -> Tensor {
    let sum = |t: Tensor| match mass {
        Some(mass) => (t * mass).sum_dim_intlist(-1, false, None::<Kind>),
        None => t.sum_dim_intlist(-1, false, None::<Kind>),
    };
    let both = sum(predicted * weights) * 2.0 + DICE_EPS;
    let all = sum(predicted.square()) + sum(weights.square()) + DICE_EPS;
    both.divide(&all).neg() + 1.0
}

/// An extension: cross-entropy of "the output passes `threshold`" and "the weight passes it".
///
/// Under doubt, plain cross-entropy predicts the mean, and a 2 % doubt is already an entry above a
/// threshold of 1 %. Shifting the logits by -logit(threshold) puts the decision where the metric
/// makes it.
pub fn support(logits: &Tensor, weights: &Tensor, threshold: f64, mass: Option<&Tensor>) -> Tensor {
    let shift = ((1.0 - threshold) / threshold).ln();
    bce(&(logits + shift), &weights.gt(threshold).to_kind(logits.kind()), mass)
}
