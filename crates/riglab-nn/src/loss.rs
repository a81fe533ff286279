//! Losses of skin reconstruction (SkinTokens 3.2.3) and two extensions.
//!
//! `logits`, `predicted` and `weights` are [m, n]: m bones, n points each.

use tch::{Kind, Reduction, Tensor};

/// ε of [`dice`].
pub const DICE_EPS: f64 = 1e-4;

/// Binary cross-entropy of sigmoid(logits) and soft targets, mean over bones and points.
pub fn bce(logits: &Tensor, weights: &Tensor) -> Tensor {
    logits.binary_cross_entropy_with_logits(weights, None::<&Tensor>, None::<&Tensor>, Reduction::Mean)
}

/// Mean squared error of predicted weights.
pub fn mse(predicted: &Tensor, weights: &Tensor) -> Tensor {
    predicted.mse_loss(weights, Reduction::Mean)
}

/// One value a bone: 1 - (2 Σ w ŵ + ε) / (Σ ŵ² + Σ w² + ε).
pub fn dice(predicted: &Tensor, weights: &Tensor) -> Tensor {
    let sum = |t: Tensor| t.sum_dim_intlist(-1, false, None::<Kind>);
    let both = sum(predicted * weights) * 2.0 + DICE_EPS;
    let all = sum(predicted.square()) + sum(weights.square()) + DICE_EPS;
    both.divide(&all).neg() + 1.0
}

/// An extension: cross-entropy of "the output passes `threshold`" and "the weight passes it".
///
/// Under doubt, plain cross-entropy predicts the mean, and a 2 % doubt is already an entry above a
/// threshold of 1 %. Shifting the logits by -logit(threshold) puts the decision where the metric
/// makes it.
pub fn support(logits: &Tensor, weights: &Tensor, threshold: f64) -> Tensor {
    let shift = ((1.0 - threshold) / threshold).ln();
    bce(&(logits + shift), &weights.gt(threshold).to_kind(logits.kind()))
}

/// An extension: how far latents z [.., axes] are from filling their codebook. Over the whole batch,
/// each axis should have mean 0 and deviation 1, where FSQ's tanh deals them to all levels:
/// the mean over axes of KL(N(mean, variance), N(0, 1)) = (mean² + variance - 1 - ln variance) / 2.
///
/// Where the decoder can do without codes at first, their gradients are noise, an optimizer that
/// normalises gradients walks with it, and the tanh saturates: all codes become one and stay it.
pub fn spread(z: &Tensor) -> Tensor {
    let z = z.flatten(0, -2);
    let mean = z.mean_dim([0i64].as_slice(), false, None::<Kind>);
    let variance = (&z - &mean).square().mean_dim([0i64].as_slice(), false, None::<Kind>) + 1e-6;
    let divergence: Tensor = (mean.square() + &variance - 1.0 - variance.log()) * 0.5;
    divergence.mean(None::<Kind>)
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    #[test]
    fn spread_is_least_where_latents_fill_the_codebook() {
        tch::manual_seed(1);
        let z = Tensor::randn([64, 32, 3], (Kind::Float, Device::Cpu));
        let at = |z: &Tensor| spread(z).double_value(&[]);
        assert!(at(&z).abs() < 1e-3);
        assert!(at(&(&z * 0.1)) > 1.0 && at(&(&z * 10.0)) > 1.0 && at(&(&z + 3.0)) > 1.0);
        // KL(N(1, 4), N(0, 1)) = (1 + 4 - 1 - ln 4) / 2.
        assert!((at(&(&z * 2.0 + 1.0)) - (4.0 - 4f64.ln()) / 2.0).abs() < 0.05);
    }
}
