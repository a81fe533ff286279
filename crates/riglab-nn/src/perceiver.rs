//! The shape encoder of UniRig and TokenRig: a cloud of points as a fixed number of tokens
//! (UniRig 4.1; Michelangelo's perceiver, by the names of its released weights).

use serde::{Deserialize, Serialize};
use tch::Tensor;

use crate::embed::{EmbedConfig, EmbedKind, Embedding};
use crate::layers::{FusedBlock, FusedConfig, LayerNorm, Linear, picked};
use crate::params::{Role, Scope, Weights};

/// Sizes of the shape encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PerceiverConfig {
    /// Tokens that come out: as many points are picked as queries.
    pub tokens: usize,
    /// Points drawn for each query, among which the farthest are picked.
    pub drawn: usize,
    /// Width of the tokens.
    pub width: usize,
    /// Heads.
    pub heads: usize,
    /// Self-attention blocks.
    pub layers: usize,
    /// Frequencies of the encoding of positions.
    pub frequencies: usize,
    /// Whether the picked points come along a curve through the cube that keeps near ones together (z-order; an extension)
    /// in place of the order in which they were picked: a decoder then finds the same places in about the same order.
    pub sorted: bool,
    /// Whether query, key and value have a bias.
    pub qkv_bias: bool,
    /// Standard deviation of weights at the start, in 1 / √width.
    pub init_scale: f64,
}

impl Default for PerceiverConfig {
    /// UniRig's release for Articulation-XL.
    fn default() -> Self {
        Self {
            tokens: 1024,
            drawn: 4,
            width: 512,
            heads: 8,
            layers: 16,
            frequencies: 8,
            sorted: false,
            qkv_bias: false,
            init_scale: 0.25,
        }
    }
}

impl PerceiverConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let bad = |key: &'static str, why: &str| Err((key, format!("{key} {why}")));
        if self.tokens == 0 || self.drawn == 0 {
            return bad("tokens", "and drawn must be at least 1");
        }
        if self.heads == 0 || !self.width.is_multiple_of(self.heads.max(1)) || self.width == 0 {
            return bad("width", &format!("({}) must be a multiple of heads ({})", self.width, self.heads));
        }
        if self.frequencies > 24 {
            return bad("frequencies", "must be at most 24");
        }
        if !(0.0..=16.0).contains(&self.init_scale) {
            return bad("init_scale", &format!("({}) must lie in [0, 16]", self.init_scale));
        }
        Ok(())
    }
}

/// Points and normals to tokens.
pub struct Perceiver {
    embedding: Embedding,
    input: Linear,
    cross: FusedBlock,
    blocks: Vec<FusedBlock>,
    norm: LayerNorm,
}

impl Perceiver {
    /// The config was validated.
    pub fn new(mut at: Scope, c: &PerceiverConfig) -> Self {
        let embedding =
            Embedding::new(&EmbedConfig { kind: EmbedKind::Fourier, frequencies: c.frequencies, base: 1.0 });
        let block = FusedConfig { width: c.width, heads: c.heads, qkv_bias: c.qkv_bias, init_scale: c.init_scale };
        let input = Linear::new(at.sub("input_proj"), Role::Projection, embedding.width() + 3, c.width, true);
        let cross = FusedBlock::new(at.sub("cross_attn"), block, true);
        let mut own = at.sub("self_attn");
        let mut own = own.sub("resblocks");
        let blocks = (0..c.layers).map(|k| FusedBlock::new(own.sub(k), block, false)).collect();
        let norm = LayerNorm::new(at.sub("ln_post"), c.width);
        Self { embedding, input, cross, blocks, norm }
    }

    /// Points with normals [b, n, 6] and the numbers of those picked [b, t] to tokens [b, t, d].
    pub fn forward(&self, w: &Weights, cloud: &Tensor, picks: &Tensor) -> Tensor {
        let features = Tensor::cat(&[&self.embedding.forward(&cloud.narrow(2, 0, 3)), &cloud.narrow(2, 3, 3)], -1);
        let data = self.input.forward(w, &features.to_kind(w.kind()));
        let mut x = self.cross.forward(w, &picked(&data, picks), Some(&data));
        for block in &self.blocks {
            x = block.forward(w, &x, None);
        }
        self.norm.forward(w, &x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_begin_with_a_spread() {
        let of = |init_scale| {
            PerceiverConfig { init_scale, ..PerceiverConfig::default() }.validate().map_err(|(key, _)| key)
        };
        assert_eq!([of(0.0), of(0.25)], [Ok(()); 2]);
        assert_eq!([of(-0.02), of(f64::NAN), of(1e6)], [Err("init_scale"); 3]);
    }
}
