//! Qwen3: pre-norm decoder with rotary positions, grouped queries, norms of queries and keys, and a gated
//! feed-forward layer, by the names of its released weights.

use serde::{Deserialize, Serialize};
use tch::Tensor;

use super::rotary::Angles;
use super::{Cache, Packed};
use crate::layers::{Linear, RmsNorm, mix};
use crate::params::{Init, ParamId, Role, Scope, Weights};

/// Sizes of the decoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QwenConfig {
    /// Width of the tokens.
    pub width: usize,
    /// Layers.
    pub layers: usize,
    /// Heads of queries.
    pub heads: usize,
    /// Heads of keys and values: each serves `heads / kv_heads` heads of queries.
    pub kv_heads: usize,
    /// Width of a head; `heads · head_width` need not be the width.
    pub head_width: usize,
    /// Inner width of the feed-forward layers.
    pub ffn: usize,
    /// Base of the rotary angles.
    pub rope_theta: f64,
    /// In the norms.
    pub rms_eps: f64,
    /// Longest sequence, with what conditions it.
    pub positions: usize,
    /// Share of activations dropped in training, after attention and feed-forward layer; Qwen3: 0.
    pub dropout: f64,
    /// Standard deviation of weights at the start.
    pub init_std: f64,
}

impl Default for QwenConfig {
    /// TokenRig's release: Qwen3-0.6B with a width of 896.
    fn default() -> Self {
        Self {
            width: 896,
            layers: 28,
            heads: 16,
            kv_heads: 8,
            head_width: 128,
            ffn: 3072,
            rope_theta: 1e6,
            rms_eps: 1e-6,
            positions: 3192,
            dropout: 0.0,
            init_std: 0.02,
        }
    }
}

impl QwenConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let sizes = [
            ("width", self.width),
            ("heads", self.heads),
            ("kv_heads", self.kv_heads),
            ("head_width", self.head_width),
            ("ffn", self.ffn),
            ("positions", self.positions),
        ];
        if let Some((key, _)) = sizes.iter().find(|(_, n)| *n == 0) {
            return Err((key, format!("{key} must be at least 1")));
        }
        if !self.heads.is_multiple_of(self.kv_heads) {
            let (heads, kv) = (self.heads, self.kv_heads);
            return Err(("heads", format!("heads = {heads} must be a multiple of kv_heads = {kv}")));
        }
        if !self.head_width.is_multiple_of(2) {
            let width = self.head_width;
            return Err(("head_width", format!("head_width = {width} must be even: channels turn in pairs")));
        }
        if !(self.rope_theta > 1.0 && self.rope_theta.is_finite()) {
            return Err(("rope_theta", format!("rope_theta = {} must be above 1", self.rope_theta)));
        }
        if !(0.0..1.0).contains(&self.dropout) {
            return Err(("dropout", format!("dropout = {} must lie in [0, 1)", self.dropout)));
        }
        Ok(())
    }
}

struct Layer {
    q: Linear,
    k: Linear,
    v: Linear,
    out: Linear,
    norm_q: RmsNorm,
    norm_k: RmsNorm,
    gate: Linear,
    up: Linear,
    down: Linear,
    norm: RmsNorm,
    norm_mlp: RmsNorm,
}

/// The decoder, without the table that scores tokens: see [`Self::logits`].
pub struct Qwen {
    tokens: ParamId,
    layers: Vec<Layer>,
    norm: RmsNorm,
    config: QwenConfig,
}

impl Qwen {
    /// Of a vocabulary; the config was validated.
    pub fn new(mut at: Scope, c: &QwenConfig, vocabulary: usize) -> Self {
        let (d, std) = (c.width, c.init_std);
        let (q, kv) = (c.heads * c.head_width, c.kv_heads * c.head_width);
        let shape = [vocabulary as i64, d as i64];
        let tokens = at.sub("embed_tokens").add("weight", Role::Embedding, &shape, Init::Normal { std });
        let layer = |mut at: Scope| {
            let of = |at: Scope, role, input, output| Linear::plain(at, role, input, output, std);
            let mut attn = at.sub("self_attn");
            let (norm_q, norm_k) = (
                RmsNorm::new(attn.sub("q_norm"), c.head_width, c.rms_eps),
                RmsNorm::new(attn.sub("k_norm"), c.head_width, c.rms_eps),
            );
            let (q, k, v, out) = (
                of(attn.sub("q_proj"), Role::Attention, d, q),
                of(attn.sub("k_proj"), Role::Attention, d, kv),
                of(attn.sub("v_proj"), Role::Attention, d, kv),
                of(attn.sub("o_proj"), Role::Attention, q, d),
            );
            let mut mlp = at.sub("mlp");
            let (gate, up, down) = (
                of(mlp.sub("gate_proj"), Role::FeedForward, d, c.ffn),
                of(mlp.sub("up_proj"), Role::FeedForward, d, c.ffn),
                of(mlp.sub("down_proj"), Role::FeedForward, c.ffn, d),
            );
            let norm = RmsNorm::new(at.sub("input_layernorm"), d, c.rms_eps);
            let norm_mlp = RmsNorm::new(at.sub("post_attention_layernorm"), d, c.rms_eps);
            Layer { q, k, v, out, norm_q, norm_k, gate, up, down, norm, norm_mlp }
        };
        let mut layers = at.sub("layers");
        let layers = (0..c.layers).map(|k| layer(layers.sub(k))).collect();
        Self { tokens, layers, norm: RmsNorm::new(at.sub("norm"), d, c.rms_eps), config: c.clone() }
    }

    /// Its sizes.
    pub fn config(&self) -> &QwenConfig {
        &self.config
    }

    /// The table of tokens [v, d], which also scores them.
    pub fn table(&self) -> ParamId {
        self.tokens
    }

    /// Token ids [..] to vectors [.., d].
    pub fn embed(&self, w: &Weights, ids: &Tensor) -> Tensor {
        Tensor::embedding(&w[self.tokens], ids, -1, false, false)
    }

    /// Vectors [.., d] to scores of all tokens [.., v].
    pub fn logits(&self, w: &Weights, x: &Tensor) -> Tensor {
        x.linear(&w[self.tokens], None::<&Tensor>)
    }

    /// Packed vectors [T, d] of whole sequences, each read from its first place on, to what the last norm
    /// gives [T, d]. In training, activations are dropped by libtorch's generator.
    pub fn forward(&self, w: &Weights, x: &Tensor, packed: &Packed, training: bool) -> Tensor {
        let angles = self.angles(&packed.places(), x);
        let mut x = x.shallow_clone();
        for layer in &self.layers {
            let (q, k, v) = self.project(w, layer, &x, &angles);
            let apart = |t: &Tensor| packed.apart(t);
            let parts = apart(&q).into_iter().zip(apart(&k)).zip(apart(&v)).map(|((q, k), v)| {
                // [t, h, e] as one batch row of heads.
                let [q, k, v] = [q, k, v].map(|t| t.transpose(0, 1).unsqueeze(0));
                mix(&q, &self.shared(&k), &self.shared(&v), true).squeeze_dim(0).transpose(0, 1)
            });
            let read = Tensor::cat(&parts.collect::<Vec<_>>(), 0).flatten(1, 2);
            x = self.rest(w, layer, &x, &read, training);
        }
        self.norm.forward(w, &x)
    }

    /// A cache for so many rows and tokens.
    pub fn cache(&self, w: &Weights, rows: i64, room: i64) -> Cache {
        let (table, c) = (&w[self.tokens], &self.config);
        let room = room.min(c.positions as i64);
        let (heads, width) = (c.kv_heads as i64, c.head_width as i64);
        Cache::new(self.layers.len(), rows, heads, room, width, table.kind(), table.device())
    }

    /// Vectors [rows, t, d] that follow what the cache holds, to what the last norm gives [rows, t, d].
    pub fn read(&self, w: &Weights, x: &Tensor, cache: &mut Cache) -> Tensor {
        let (rows, t, d) = x.size3().expect("three axes");
        let (c, before) = (&self.config, cache.len());
        let places: Vec<i64> = (0..rows).flat_map(|_| before..before + t).collect();
        let angles = self.angles(&places, x);
        let mut x = x.reshape([rows * t, d]);
        let (kv, group) = (c.kv_heads as i64, (c.heads / c.kv_heads) as i64);
        for (number, layer) in self.layers.iter().enumerate() {
            let (q, k, v) = self.project(w, layer, &x, &angles);
            let [q, k, v] = [q, k, v].map(|p| {
                let size = p.size();
                p.view([rows, t, size[1], size[2]]).transpose(1, 2)
            });
            let (k, v) = cache.extend(number, &k, &v);
            let read = if t == 1 {
                // The queries that share a head of keys stand in for as many tokens.
                let q = q.reshape([rows, kv, group, -1]);
                mix(&q, &k, &v, false).reshape([rows, -1])
            } else {
                let read = mix(&q, &self.shared(&k), &self.shared(&v), true);
                read.transpose(1, 2).reshape([rows * t, -1])
            };
            x = self.rest(w, layer, &x, &read, false);
        }
        cache.advance(t);
        self.norm.forward(w, &x).view([rows, t, d])
    }

    fn angles(&self, places: &[i64], x: &Tensor) -> Angles {
        Angles::new(places, self.config.head_width as i64, self.config.rope_theta, x.kind(), x.device())
    }

    /// Heads of keys or values [b, kv, s, e] for every head of queries [b, h, s, e].
    fn shared(&self, x: &Tensor) -> Tensor {
        let group = (self.config.heads / self.config.kv_heads) as i64;
        if group == 1 { x.shallow_clone() } else { x.repeat_interleave_self_int(group, 1, None::<i64>) }
    }

    /// Queries [T, h, e], keys and values [T, kv, e] of x [T, d], turned by their places.
    fn project(&self, w: &Weights, layer: &Layer, x: &Tensor, angles: &Angles) -> (Tensor, Tensor, Tensor) {
        let c = &self.config;
        let x = layer.norm.forward(w, x);
        // One product for all three: the weights are small beside the activations.
        let weight = Tensor::cat(&[&layer.q, &layer.k, &layer.v].map(|l| &w[l.weight()]), 0);
        let all = x.linear(&weight, None::<&Tensor>).view([x.size()[0], -1, c.head_width as i64]);
        let (heads, kv) = (c.heads as i64, c.kv_heads as i64);
        // Queries and keys are normed and turned as one, each head with its own gain.
        let gain = |norm: &RmsNorm, heads: i64| norm.gain(w).unsqueeze(0).expand([heads, -1], false);
        let gains = Tensor::cat(&[gain(&layer.norm_q, heads), gain(&layer.norm_k, kv)], 0);
        let both = angles.turn(&(layer.norm_q.plain(&all.narrow(1, 0, heads + kv)) * gains));
        (both.narrow(1, 0, heads), both.narrow(1, heads, kv), all.narrow(1, heads + kv, kv))
    }

    /// The output projection and the feed-forward layer.
    fn rest(&self, w: &Weights, layer: &Layer, x: &Tensor, read: &Tensor, training: bool) -> Tensor {
        let p = self.config.dropout;
        let drop = |t: Tensor| if training && p > 0.0 { t.dropout(p, true) } else { t };
        let x = x + drop(layer.out.forward(w, read));
        let inner = layer.norm_mlp.forward(w, &x);
        let both = Tensor::cat(&[&w[layer.gate.weight()], &w[layer.up.weight()]], 0);
        let halves = inner.linear(&both, None::<&Tensor>).chunk(2, -1);
        &x + drop(layer.down.forward(w, &(halves[0].silu() * &halves[1])))
    }
}
