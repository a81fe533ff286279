//! UniRig's skeleton model (4.1): the shape as a prefix, the skeleton's tokens after it.

use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use crate::decoder::{Cache, Opt, OptConfig, Packed};
use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};
use crate::perceiver::{Perceiver, PerceiverConfig};

/// Sizes of the skeleton model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkeletonModelConfig {
    /// The shape encoder.
    pub shape: PerceiverConfig,
    /// The decoder.
    pub decoder: OptConfig,
}

impl SkeletonModelConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        self.shape.validate().map_err(|(key, text)| (format!("shape.{key}"), text))?;
        self.decoder.validate().map_err(|(key, text)| (format!("decoder.{key}"), text))?;
        if self.decoder.positions <= self.shape.tokens {
            let (positions, tokens) = (self.decoder.positions, self.shape.tokens);
            let text = format!("positions ({positions}) must be more than the {tokens} tokens of the shape");
            return Err(("decoder.positions".into(), text));
        }
        Ok(())
    }
}

/// The network, by the names of its released weights.
pub struct SkeletonModel {
    shape: Perceiver,
    to_decoder: Linear,
    decoder: Opt,
}

impl SkeletonModel {
    /// Of a vocabulary; the config was validated.
    pub fn new(mut at: Scope, c: &SkeletonModelConfig, vocabulary: usize) -> Self {
        let shape = Perceiver::new(at.sub("mesh_encoder").sub("encoder"), &c.shape);
        let to_decoder = Linear::new(at.sub("output_proj"), Role::Projection, c.shape.width, c.decoder.width, true);
        let decoder = Opt::new(at.sub("transformer").sub("model").sub("decoder"), &c.decoder, vocabulary);
        Self { shape, to_decoder, decoder }
    }

    /// Points with normals [b, n, 6] and those picked [b, p] to the prefix [b, p, d].
    pub fn condition(&self, w: &Weights, cloud: &Tensor, picks: &Tensor) -> Tensor {
        self.to_decoder.forward(w, &self.shape.forward(w, cloud, picks))
    }

    /// The shape encoder alone: tokens [b, p, width].
    pub fn shape(&self) -> &Perceiver {
        &self.shape
    }

    /// The decoder.
    pub fn decoder(&self) -> &Opt {
        &self.decoder
    }

    /// Scores [M, v] of what follows each token but the last of every sequence, in their order.
    /// `prefix` [b, p, d]; `ids` are those of all sequences one after another, `lengths` theirs.
    pub fn logits(&self, w: &Weights, prefix: &Tensor, ids: &Tensor, lengths: &[i64], training: bool) -> Tensor {
        let p = prefix.size()[1];
        let tokens = self.decoder.embed(w, ids).split_with_sizes(lengths, 0);
        let mut parts = Vec::with_capacity(2 * tokens.len());
        for (shape, tokens) in prefix.unbind(0).into_iter().zip(tokens) {
            parts.extend([shape, tokens]);
        }
        let packed = Packed::new(lengths.iter().map(|n| n + p).collect());
        let out = self.decoder.forward(w, &Tensor::cat(&parts, 0), &packed, training);
        // Only what is scored goes through the head.
        let asked = packed.apart(&out).into_iter().zip(lengths).map(|(rows, n)| rows.narrow(0, p, n - 1));
        self.decoder.logits(w, &Tensor::cat(&asked.collect::<Vec<_>>(), 0))
    }

    /// As [`Self::logits`] without what training adds, each sequence behind the prefix [b, p, d] that `of` names, which is
    /// read once for all of them.
    pub fn logits_behind(&self, w: &Weights, prefix: &Tensor, of: &[usize], ids: &Tensor, lengths: &[i64]) -> Tensor {
        let (b, p, d) = prefix.size3().expect("three axes");
        let packed = Packed::behind(b as usize, p, of, lengths);
        let x = Tensor::cat(&[prefix.reshape([b * p, d]), self.decoder.embed(w, ids)], 0);
        let out = self.decoder.forward(w, &x, &packed, false);
        let own = packed.apart(&out).into_iter().skip(b as usize).zip(lengths);
        let asked: Vec<Tensor> = own.map(|(rows, n)| rows.narrow(0, 0, n - 1)).collect();
        self.decoder.logits(w, &Tensor::cat(&asked, 0))
    }

    /// A cache that has read the prefix [b, p, d], with room for so many tokens after it.
    pub fn start(&self, w: &Weights, prefix: &Tensor, tokens: i64) -> Cache {
        let size = prefix.size();
        let mut cache = self.decoder.cache(w, size[0], size[1] + tokens);
        let _ = self.decoder.read(w, prefix, &mut cache);
        cache
    }

    /// Scores [rows, v] of what follows the next tokens `ids` [rows, t] in f32.
    pub fn next(&self, w: &Weights, ids: &Tensor, cache: &mut Cache) -> Tensor {
        let out = self.decoder.read(w, &self.decoder.embed(w, ids), cache);
        let last = out.select(1, ids.size()[1] - 1);
        self.decoder.logits(w, &last).to_kind(Kind::Float)
    }
}

/// Cross-entropy of scores [M, v] and the ids that follow [M], the mean over all of them.
pub fn cross_entropy(logits: &Tensor, targets: &Tensor) -> Tensor {
    logits.to_kind(Kind::Float).cross_entropy_for_logits(targets)
}

/// As [`cross_entropy`], with each coordinate's target spread over the cells around it: a normal distribution
/// of `sigma` cells, cut at twice that; what would lie beyond an end of the range is added to the last cell there (an
/// extension).
pub fn spread_cross_entropy(logits: &Tensor, targets: &Tensor, bins: i64, sigma: f64) -> Tensor {
    let likely = logits.to_kind(Kind::Float).log_softmax(-1, Kind::Float);
    spread_likelihood(&likely, targets, bins, sigma).mean(None::<Kind>)
}

/// Minus the log-likelihood of each target [M], from those of all ids [M, v], spread as
/// [`spread_cross_entropy`] does; `sigma` 0: of the target alone.
pub fn spread_likelihood(likely: &Tensor, targets: &Tensor, bins: i64, sigma: f64) -> Tensor {
    let reach = (2.0 * sigma).ceil() as i64;
    let coordinates = targets.lt(bins);
    let weights: Vec<f64> =
        (-reach..=reach).map(|k| if k == 0 { 1.0 } else { (-0.5 * (k as f64 / sigma).powi(2)).exp() }).collect();
    let total: f64 = weights.iter().sum();
    let mut sum = Tensor::zeros([targets.size()[0]], (likely.kind(), likely.device()));
    for (offset, weight) in (-reach..=reach).zip(weights) {
        // A cell beyond the end is the last one; what is no coordinate is not spread.
        let beside = (targets + offset).clamp(0, bins - 1);
        let at = beside.where_self(&coordinates, targets);
        sum += likely.gather(1, &at.unsqueeze(1), false).squeeze_dim(1) * (weight / total);
    }
    -sum
}

/// How far off coordinates are expected to be: over targets that are coordinates, the probability of
/// each cell times its distance in shares of the range, summed and divided by 50 as released.
pub fn coordinate_distance(logits: &Tensor, targets: &Tensor, bins: i64) -> Tensor {
    let coordinates = targets.lt(bins);
    let chosen = coordinates.nonzero().squeeze_dim(1);
    let p = logits.to_kind(Kind::Float).softmax(-1, None::<Kind>).index_select(0, &chosen).narrow(1, 0, bins);
    let cells = Tensor::arange(bins, (Kind::Float, logits.device()));
    let distance = (cells.unsqueeze(0) - targets.index_select(0, &chosen).unsqueeze(1)).abs() / bins as f64;
    (p * distance).sum(None::<Kind>) / 50.0
}
