//! Codes that are real numbers, as a variational auto-encoder has them (Kingma and Welling 2014), in place of rounded
//! ones: the other side of what SkinTokens leaves open, what it costs that codes are discrete.
//!
//! The encoder says mean μ and variance σ² of each axis. Training draws z = μ + σ ε with ε ~ N(0, 1). Beside N(0, 1) such
//! a draw tells KL(N(μ, σ²), N(0, 1)) = (μ² + σ² - 1 - ln σ²) / 2 nats; the mean, which evaluation takes too, is exact.

use tch::{Kind, Tensor};

use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};

/// Codes are z over this: nearly all lie in [-1, 1] then, as rounded ones do, where Fourier features tell them apart.
const REACH: f64 = 3.0;
/// Where ln σ² starts. From σ = 1, codes were noise at first, and the decoder would learn to do without them.
const START: f64 = -4.0;
/// Bounds of ln σ²: far beyond what is learned, so that no step leaves what single precision holds.
const LOG_VARIANCE: (f64, f64) = (-20.0, 10.0);

/// The codes of bones, and what they tell.
pub struct Coded {
    /// [m, k, axes], in about [-1, 1].
    pub codes: Tensor,
    /// Of codes that are real numbers, what is said of their learned axes.
    pub said: Option<GaussianCode>,
}

/// What a Gaussian says of learned axes besides their means.
pub struct GaussianCode {
    /// How far codes that are drawn scatter, [m, k, a].
    pub deviation: Tensor,
    /// What such a draw tells, in nats, [m, k].
    pub divergence: Tensor,
}

/// What says the variances; the means are what would be rounded.
pub struct Gaussian {
    log_variance: Linear,
}

impl Gaussian {
    /// From latents of `latent` channels, for `axes` axes.
    pub fn new(at: Scope, latent: usize, axes: usize) -> Self {
        let std = 0.25 / (latent as f64).sqrt();
        Self { log_variance: Linear::normal(at, Role::Projection, latent, axes, std, START) }
    }

    /// Codes of means [m, k, a] and latents [m, k, l]: the means, or with `noise` ε [m, k, a] what is drawn.
    pub fn code(&self, w: &Weights, mean: &Tensor, latent: &Tensor, noise: Option<&Tensor>) -> Coded {
        let (low, high) = LOG_VARIANCE;
        let log_variance = self.log_variance.forward(w, latent).to_kind(mean.kind()).clamp(low, high);
        let deviation = (&log_variance * 0.5).exp() / REACH;
        let mut codes = mean / REACH;
        if let Some(noise) = noise {
            codes += &deviation * noise;
        }
        let divergence = divergence(mean, &log_variance).sum_dim_intlist([-1i64].as_slice(), false, None::<Kind>);
        Coded { codes, said: Some(GaussianCode { deviation, divergence }) }
    }
}

/// KL(N(μ, σ²), N(0, 1)) of each number, in nats.
fn divergence(mean: &Tensor, log_variance: &Tensor) -> Tensor {
    (mean.square() + log_variance.exp() - 1.0 - log_variance) * 0.5
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::params::Builder;

    #[test]
    fn what_an_axis_tells_is_the_integral_of_its_densities() {
        let of =
            |mean: f64, variance: f64| divergence(&Tensor::from(mean), &Tensor::from(variance.ln())).double_value(&[]);
        assert!(of(0.0, 1.0).abs() < 1e-12);
        for (mean, variance) in [(0.7f64, 0.3f64), (-1.5, 0.05), (0.2, 2.5)] {
            // ∫ q ln(q / p) by small steps over ten deviations.
            let s = variance.sqrt();
            let (steps, width) = (20_000, 20.0 * s / 20_000.0);
            let sum: f64 = (0..steps)
                .map(|k| {
                    let x = mean - 10.0 * s + (k as f64 + 0.5) * width;
                    let log_q = -0.5 * (x - mean).powi(2) / variance - s.ln();
                    let log_p = -0.5 * x * x;
                    (log_q - log_p) * log_q.exp() * width / (2.0 * std::f64::consts::PI).sqrt()
                })
                .sum();
            assert!((of(mean, variance) - sum).abs() < 1e-6, "{mean}, {variance}: {sum}");
        }
    }

    #[test]
    fn draws_have_the_mean_and_variance_that_were_said() {
        tch::manual_seed(1);
        let mut builder = Builder::default();
        let gaussian = Gaussian::new(builder.root(), 8, 3);
        let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
        let latent = Tensor::randn([1, 1, 8], (Kind::Float, Device::Cpu));
        let (mean, n) = (Tensor::from_slice(&[0.5f32, -1.0, 2.0]).view([1, 1, 3]), 20_000);
        let of = |mean: &Tensor, noise: Option<&Tensor>| {
            let rows = mean.size()[0];
            gaussian.code(params.weights(), mean, &latent.expand([rows, -1, -1], false), noise)
        };
        let still = of(&mean, None);
        assert!((&still.codes * REACH - &mean).abs().max().double_value(&[]) < 1e-6, "without noise: the means");
        let said = still.said.unwrap();
        assert_eq!((said.divergence.size(), said.deviation.size()), (vec![1, 1], vec![1, 1, 3]));
        let noise = Tensor::randn([n, 1, 3], (Kind::Float, Device::Cpu));
        let drawn = of(&mean.expand([n, -1, -1], false), Some(&noise)).codes * REACH;
        let off = (drawn.mean_dim([0i64].as_slice(), true, Kind::Float) - &mean).abs().max().double_value(&[]);
        // Near where it starts: a deviation of e^-2.
        let deviation = drawn.std_dim(0, true, false).mean(Kind::Float).double_value(&[]);
        assert!(off < 0.01 && (deviation - START.exp().sqrt()).abs() < 0.05, "{off}, {deviation}");
    }
}
