//! OPT: pre-norm decoder with learned positions and ReLU, by the names of its released weights.

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use super::kernels::Panels;
use super::steps::{LayerWeights, Norm, Sizes, Steps, floats};
use super::{Cache, Packed, spread};
use crate::layers::{LayerNorm, Linear, affine, dropped, mix};
use crate::params::{Init, ParamId, Role, Scope, Weights};

/// Positions start at this row of their table.
const OFFSET: i64 = 2;

/// Sizes of the decoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptConfig {
    /// Width of the tokens.
    pub width: usize,
    /// Layers.
    pub layers: usize,
    /// Heads.
    pub heads: usize,
    /// Inner width of the feed-forward layers.
    pub ffn: usize,
    /// Longest sequence, with what conditions it.
    pub positions: usize,
    /// Share of activations dropped in training, after attention and feed-forward layer.
    pub dropout: f64,
    /// Standard deviation of weights at the start. Above 0: [`super::STDS`].
    pub init_std: f64,
    /// A token, one of the vocabulary's, whose input embedding is not trained: 1 in the released models, which take it for
    /// the padding of OPT though it is a coordinate.
    pub frozen_token: Option<u32>,
}

impl Default for OptConfig {
    /// UniRig's release for Articulation-XL: the shape of OPT-350M, before its norms.
    fn default() -> Self {
        Self {
            width: 1024,
            layers: 24,
            heads: 16,
            ffn: 4096,
            positions: 3076,
            dropout: 0.1,
            init_std: 0.02,
            frozen_token: None,
        }
    }
}

impl OptConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let bad = |key: &'static str, why: String| Err((key, format!("{key} {why}")));
        if self.heads == 0 || self.width == 0 || !self.width.is_multiple_of(self.heads.max(1)) {
            return bad("width", format!("({}) must be a multiple of heads ({})", self.width, self.heads));
        }
        for (key, size) in [("layers", self.layers), ("ffn", self.ffn), ("positions", self.positions)] {
            if size == 0 {
                return bad(key, "must be at least 1".into());
            }
        }
        if !(0.0..1.0).contains(&self.dropout) {
            return bad("dropout", format!("({}) must be at least 0 and less than 1", self.dropout));
        }
        spread(self.init_std).map_err(|why| ("init_std", why))?;
        Ok(())
    }
}

#[derive(Clone)]
struct Layer {
    q: Linear,
    k: Linear,
    v: Linear,
    out: Linear,
    norm: LayerNorm,
    up: Linear,
    down: Linear,
    norm_out: LayerNorm,
    heads: i64,
    dropout: f64,
}

/// The decoder.
pub struct Opt {
    tokens: ParamId,
    positions: ParamId,
    layers: Vec<Layer>,
    norm: LayerNorm,
    heads: i64,
    frozen: i64,
    longest: i64,
}

impl Opt {
    /// Of a vocabulary; the config was validated.
    pub fn new(mut at: Scope, c: &OptConfig, vocabulary: usize) -> Self {
        let (d, std) = (c.width, c.init_std);
        let init = Init::Normal { std };
        let tokens = at.sub("embed_tokens").add("weight", Role::Embedding, &[vocabulary as i64, d as i64], init);
        let rows = c.positions as i64 + OFFSET;
        let positions = at.sub("embed_positions").add("weight", Role::Embedding, &[rows, d as i64], init);
        let mut layers = at.sub("layers");
        let layer = |mut at: Scope| {
            let mut attn = at.sub("self_attn");
            let of = |at: Scope, role, input, output| Linear::normal(at, role, input, output, std, 0.0);
            Layer {
                q: of(attn.sub("q_proj"), Role::Attention, d, d),
                k: of(attn.sub("k_proj"), Role::Attention, d, d),
                v: of(attn.sub("v_proj"), Role::Attention, d, d),
                out: of(attn.sub("out_proj"), Role::Attention, d, d),
                norm: LayerNorm::new(at.sub("self_attn_layer_norm"), d),
                up: of(at.sub("fc1"), Role::FeedForward, d, c.ffn),
                down: of(at.sub("fc2"), Role::FeedForward, c.ffn, d),
                norm_out: LayerNorm::new(at.sub("final_layer_norm"), d),
                heads: c.heads as i64,
                dropout: c.dropout,
            }
        };
        let layers = (0..c.layers).map(|k| layer(layers.sub(k))).collect();
        Self {
            tokens,
            positions,
            layers,
            norm: LayerNorm::new(at.sub("final_layer_norm"), d),
            heads: c.heads as i64,
            frozen: c.frozen_token.map_or(-1, i64::from),
            longest: c.positions as i64,
        }
    }

    /// The longest sequence.
    pub fn longest(&self) -> i64 {
        self.longest
    }

    /// Token ids [..] to vectors [.., d].
    pub fn embed(&self, w: &Weights, ids: &Tensor) -> Tensor {
        Tensor::embedding(&w[self.tokens], ids, self.frozen, false, false)
    }

    /// Vectors [.., d] to scores of all tokens [.., v].
    pub fn logits(&self, w: &Weights, x: &Tensor) -> Tensor {
        affine(x, &w[self.tokens], None)
    }

    /// Packed vectors [T, d] of whole sequences, each read from its first place on, to what the last norm
    /// gives [T, d]. In training, activations are dropped by libtorch's generator.
    pub fn forward(&self, w: &Weights, x: &Tensor, packed: &Packed, training: bool) -> Tensor {
        let places = Tensor::from_slice(&packed.places()).to_device(x.device()) + OFFSET;
        let mut x = x + w[self.positions].index_select(0, &places);
        for layer in &self.layers {
            let (layer, packed) = (layer.clone(), packed.clone());
            x = w.block(&[&x], move |w, t| layer.forward(w, &t[0], &packed, training));
        }
        self.norm.forward(w, &x)
    }

    /// A cache for so many rows and tokens.
    pub fn cache(&self, w: &Weights, rows: i64, room: i64) -> Cache {
        let table = &w[self.tokens];
        let width = table.size()[1] / self.heads;
        let room = room.min(self.longest);
        let mut cache = Cache::new(self.layers.len(), rows, self.heads, room, width, table.kind(), table.device());
        // Once for all tokens to come: put together at each, they cost as much as the products.
        cache.fused = self.layers.iter().map(|layer| layer.fused(w)).collect();
        cache
    }

    /// Vectors [rows, t, d] that follow what the cache holds, to what the last norm gives [rows, t, d].
    pub fn read(&self, w: &Weights, x: &Tensor, cache: &mut Cache) -> Tensor {
        let (rows, t, d) = x.size3().expect("three axes");
        let before = cache.len();
        let places = Tensor::arange_start(before, before + t, (Kind::Int64, Device::Cpu)).to_device(x.device());
        let x = x + w[self.positions].index_select(0, &(places + OFFSET));
        if cache.steps.is_none() && t == 1 && before > 0 && self.has_steps(w) {
            cache.steps = Some(self.steps(w, cache, rows));
        }
        if let Some(steps) = &mut cache.steps {
            let out = steps.read(&x, before as usize);
            cache.advance(t);
            return out;
        }
        let mut x = x.view([rows * t, d]);
        for (number, layer) in self.layers.iter().enumerate() {
            let fused = &cache.fused[number];
            let all = affine(&layer.norm.forward(w, &x), &fused[0], Some(&fused[1]));
            // [3, rows, h, t, e]
            let all = all.view([rows, t, 3, self.heads, d / self.heads]).permute([2, 0, 3, 1, 4]);
            let q = all.select(0, 0);
            let (k, v) = cache.extend_both(number, &all.narrow(0, 1, 2));
            // Several tokens are read at once only at the beginning, one sees all before it.
            let read = mix(&q, &k, &v, t > 1).transpose(1, 2).reshape([rows * t, d]);
            x = layer.rest(w, &x, &read, false);
        }
        cache.advance(t);
        self.norm.forward(w, &x).view([rows, t, d])
    }

    /// Whether single tokens are read by [`Steps`].
    fn has_steps(&self, w: &Weights) -> bool {
        let table = &w[self.tokens];
        let d = table.size()[1];
        table.kind() == Kind::Float
            && table.device() == Device::Cpu
            && Steps::serve((d / self.heads) as usize, &[d as usize])
    }

    /// Hands over what the cache holds.
    fn steps(&self, w: &Weights, cache: &mut Cache, rows: i64) -> Steps {
        let panels =
            |weight: &Tensor, bias: &Tensor| Panels::new(&floats(weight), &floats(bias), weight.size()[1] as usize);
        let linear = |l: &Linear| panels(&w[l.weight()], &w[l.bias().expect("OPT has biases")]);
        let norm = |n: &LayerNorm| Norm::Layer(n.floats(w));
        let layers = self.layers.iter().zip(&cache.fused).map(|(layer, fused)| LayerWeights {
            norm: norm(&layer.norm),
            qkv: panels(&fused[0], &fused[1]),
            norm_heads: None,
            out: linear(&layer.out),
            norm_out: norm(&layer.norm_out),
            up: linear(&layer.up),
            gated: false,
            down: linear(&layer.down),
        });
        let width = w[self.tokens].size()[1] / self.heads;
        let sizes = [rows, self.heads, cache.room(), cache.same, width];
        let [rows, heads, room, same, width] = sizes.map(|n| n as usize);
        let sizes = Sizes { rows, heads, kv_heads: heads, room, same, width };
        let threads = tch::get_num_threads() > 1;
        let mut steps = Steps::new(layers.collect(), norm(&self.norm), Default::default(), sizes, threads);
        for (layer, (keys, values)) in cache.take().enumerate() {
            steps.write(layer, &floats(&keys), &floats(&values));
        }
        cache.fused.clear();
        steps
    }
}

impl Layer {
    /// Packed vectors [T, d] through the layer.
    fn forward(&self, w: &Weights, x: &Tensor, packed: &Packed, training: bool) -> Tensor {
        let (q, k, v) = self.project(w, x);
        let read = packed.attend(&q, &k, &v).flatten(1, 2);
        self.rest(w, x, &read, training)
    }

    /// Queries, keys and values of x [T, d], each [T, h, e].
    fn project(&self, w: &Weights, x: &Tensor) -> (Tensor, Tensor, Tensor) {
        let x = self.norm.forward(w, x);
        // One product for all three: the weights are small beside the activations.
        let fused = self.fused(w);
        let mut parts =
            affine(&x, &fused[0], Some(&fused[1])).view([x.size()[0], 3, self.heads, -1]).unbind(1).into_iter();
        let mut next = || parts.next().expect("three parts");
        (next(), next(), next())
    }

    /// Weights and biases of query, key and value as one.
    fn fused(&self, w: &Weights) -> Vec<Tensor> {
        let all = [&self.q, &self.k, &self.v];
        let weight = Tensor::cat(&all.map(|l| &w[l.weight()]), 0);
        vec![weight, Tensor::cat(&all.map(|l| &w[l.bias().expect("OPT has biases")]), 0)]
    }

    /// The output projection and the feed-forward self.
    fn rest(&self, w: &Weights, x: &Tensor, read: &Tensor, training: bool) -> Tensor {
        let drop = |t: Tensor| if training { dropped(t, self.dropout) } else { t };
        let x = x + drop(self.out.forward(w, read));
        let inner = self.up.forward(w, &self.norm_out.forward(w, &x)).relu();
        &x + drop(self.down.forward(w, &inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_begin_with_a_spread() {
        let of = |init_std| OptConfig { init_std, ..OptConfig::default() }.validate().map_err(|(key, _)| key);
        assert_eq!([of(1e-6), of(0.25)], [Ok(()); 2]);
        assert_eq!([of(0.0), of(1e-50), of(-0.02), of(f64::NAN), of(1e6)], [Err("init_std"); 5]);
    }
}
