//! Qwen3: pre-norm decoder with rotary positions, grouped queries, norms of queries and keys, and a gated
//! feed-forward layer, by the names of its released weights.

use riglab_torch::{gated, has_rows, turned_heads};
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use super::kernels::Panels;
use super::rotary::Angles;
use super::steps::{LayerWeights, Norm, Sizes, Steps, floats};
use super::{Cache, Packed, spread};
use crate::layers::{Linear, RmsNorm, affine, dropped, mix, shared_heads};
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
    /// Standard deviation of weights at the start. Above 0: [`super::STDS`].
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
            ("layers", self.layers),
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
        // Below 0, roots of small activations would be no numbers.
        if !(0.0..=1.0).contains(&self.rms_eps) {
            return Err(("rms_eps", format!("rms_eps = {} must lie in [0, 1]", self.rms_eps)));
        }
        spread(self.init_std).map_err(|why| ("init_std", why))
    }
}

/// Of what is put together: weights of query, key and value.
const QKV: usize = 0;
/// Gains of the norms of every head of queries and keys [h + kv, e].
const GAINS: usize = 1;
/// Weights of the feed-forward layer's gates and of what they let through.
const GATE_UP: usize = 2;

#[derive(Clone)]
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
    heads: usize,
    kv_heads: usize,
    head_width: usize,
    dropout: f64,
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
            let &QwenConfig { heads, kv_heads, head_width, dropout, .. } = c;
            Layer { q, k, v, out, norm_q, norm_k, gate, up, down, norm, norm_mlp, heads, kv_heads, head_width, dropout }
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
        affine(x, &w[self.tokens], None)
    }

    /// Packed vectors [T, d] of whole sequences, each read from its first place on, to what the last norm
    /// gives [T, d]. In training, activations are dropped by libtorch's generator.
    pub fn forward(&self, w: &Weights, x: &Tensor, packed: &Packed, training: bool) -> Tensor {
        let angles = self.angles(&packed.places(), x);
        let mut x = x.shallow_clone();
        for layer in &self.layers {
            let (layer, angles, packed) = (layer.clone(), angles.shared(), packed.clone());
            x = w.block(&[&x], move |w, t| layer.forward(w, &t[0], &angles, &packed, training));
        }
        self.norm.forward(w, &x)
    }

    /// A cache for so many rows and tokens.
    pub fn cache(&self, w: &Weights, rows: i64, room: i64) -> Cache {
        let (table, c) = (&w[self.tokens], &self.config);
        let room = room.min(c.positions as i64);
        let (heads, width) = (c.kv_heads as i64, c.head_width as i64);
        let mut cache = Cache::new(self.layers.len(), rows, heads, room, width, table.kind(), table.device());
        // Once for all tokens to come: put together at each, they cost as much as the products.
        cache.fused = self.layers.iter().map(|layer| layer.fused(w)).collect();
        cache.angles = Some(self.angles(&(0..room).collect::<Vec<_>>(), table));
        cache
    }

    /// Vectors [rows, t, d] that follow what the cache holds, to what the last norm gives [rows, t, d].
    pub fn read(&self, w: &Weights, x: &Tensor, cache: &mut Cache) -> Tensor {
        let (rows, t, d) = x.size3().expect("three axes");
        let (c, before) = (&self.config, cache.len());
        if cache.steps.is_none() && t == 1 && before > 0 && self.has_steps(w) {
            cache.steps = Some(self.steps(w, cache, rows));
        }
        if let Some(steps) = &mut cache.steps {
            let out = steps.read(x, before as usize);
            cache.advance(t);
            return out;
        }
        let angles = cache.angles.as_ref().expect("made with the cache").of(before, t);
        let mut x = x.shallow_clone();
        let (kv, group) = (c.kv_heads as i64, (c.heads / c.kv_heads) as i64);
        for (number, layer) in self.layers.iter().enumerate() {
            let (q, k, v) = layer.project(w, &cache.fused[number], &x, &angles);
            let [q, k, v] = [q, k, v].map(|p| p.transpose(1, 2));
            let (k, v) = cache.extend(number, &k, &v);
            let read = if t == 1 {
                // The queries that share a head of keys stand in for as many tokens.
                let q = q.reshape([rows, kv, group, -1]);
                mix(&q, &k, &v, false).reshape([rows, 1, -1])
            } else {
                let read = mix(&q, &layer.shared(&k), &layer.shared(&v), true);
                read.transpose(1, 2).reshape([rows, t, -1])
            };
            x = layer.rest(w, &cache.fused[number], &x, &read, false);
        }
        cache.advance(t);
        self.norm.forward(w, &x).view([rows, t, d])
    }

    /// Whether single tokens are read by [`Steps`].
    fn has_steps(&self, w: &Weights) -> bool {
        let (table, c) = (&w[self.tokens], &self.config);
        let plain = table.kind() == Kind::Float && table.device() == Device::Cpu;
        plain && Steps::serve(c.head_width, &[c.width, c.heads * c.head_width, c.kv_heads * c.head_width, c.ffn])
    }

    /// Hands over what the cache holds.
    fn steps(&self, w: &Weights, cache: &mut Cache, rows: i64) -> Steps {
        let c = &self.config;
        let panels = |weight: &Tensor| {
            let (outputs, inputs) = weight.size2().expect("a matrix");
            Panels::new(&floats(weight), &vec![0.0; outputs as usize], inputs as usize)
        };
        let norm = |n: &RmsNorm| Norm::Rms(floats(n.gain(w)), c.rms_eps as f32);
        let layers = self.layers.iter().zip(&cache.fused).map(|(layer, fused)| LayerWeights {
            norm: norm(&layer.norm),
            qkv: panels(&fused[QKV]),
            norm_heads: Some([norm(&layer.norm_q), norm(&layer.norm_k)]),
            out: panels(&w[layer.out.weight()]),
            norm_out: norm(&layer.norm_mlp),
            up: panels(&fused[GATE_UP]),
            gated: true,
            down: panels(&w[layer.down.weight()]),
        });
        let [rows, room, same] = [rows, cache.room(), cache.same].map(|n| n as usize);
        let sizes = Sizes { rows, heads: c.heads, kv_heads: c.kv_heads, room, same, width: c.head_width };
        let angles = cache.angles.as_ref().map(Angles::floats).unwrap_or_default();
        let mut steps = Steps::new(layers.collect(), norm(&self.norm), angles, sizes, tch::get_num_threads() > 1);
        for (layer, (keys, values)) in cache.take().enumerate() {
            steps.write(layer, &floats(&keys), &floats(&values));
        }
        cache.fused.clear();
        steps
    }

    fn angles(&self, places: &[i64], x: &Tensor) -> Angles {
        Angles::new(places, self.config.head_width as i64, self.config.rope_theta, x.kind(), x.device())
    }
}

impl Layer {
    /// Packed vectors [T, d] through the self.
    fn forward(&self, w: &Weights, x: &Tensor, angles: &Angles, packed: &Packed, training: bool) -> Tensor {
        let fused = self.fused(w);
        let (q, k, v) = self.project(w, &fused, x, angles);
        let read = packed.attend(&q, &k, &v).flatten(1, 2);
        self.rest(w, &fused, x, &read, training)
    }

    /// Heads of keys or values [b, kv, s, e] for every head of queries [b, h, s, e].
    fn shared(&self, x: &Tensor) -> Tensor {
        shared_heads(x, (self.heads / self.kv_heads) as i64)
    }

    /// The weights as few: see [`QKV`], [`GAINS`], [`GATE_UP`].
    fn fused(&self, w: &Weights) -> Vec<Tensor> {
        let weights = |all: &[&Linear]| Tensor::cat(&all.iter().map(|l| &w[l.weight()]).collect::<Vec<_>>(), 0);
        let gain = |norm: &RmsNorm, heads: usize| norm.gain(w).unsqueeze(0).expand([heads as i64, -1], false);
        let gains = Tensor::cat(&[gain(&self.norm_q, self.heads), gain(&self.norm_k, self.kv_heads)], 0);
        vec![weights(&[&self.q, &self.k, &self.v]), gains, weights(&[&self.gate, &self.up])]
    }

    /// Queries [.., h, e], keys and values [.., kv, e] of x [.., d], turned by their places.
    fn project(&self, w: &Weights, fused: &[Tensor], x: &Tensor, angles: &Angles) -> (Tensor, Tensor, Tensor) {
        let x = self.norm.forward(w, x);
        // One product for all three: the weights are small beside the activations.
        let all = affine(&x, &fused[QKV], None);
        let mut size = all.size();
        size.pop();
        let (heads, kv, width) = (self.heads as i64, self.kv_heads as i64, self.head_width as i64);
        // Queries and keys are normed and turned as one, each head with its own gain.
        if has_rows(&all) {
            let rows = all.view([-1, heads + 2 * kv, width]);
            let own = turned_heads(&rows, &fused[GAINS], angles.both(), heads, self.norm_q.eps());
            let parts = own.unwrap_or_else(|e| panic!("{e}"));
            let [q, k, v] = parts.map(|p| p.view([&size[..], &[p.size()[1], width]].concat().as_slice()));
            return (q, k, v);
        }
        size.extend([-1, width]);
        let all = all.view(size.as_slice());
        let both = angles.turn(&(self.norm_q.plain(&all.narrow(-2, 0, heads + kv)) * &fused[GAINS]));
        (both.narrow(-2, 0, heads), both.narrow(-2, heads, kv), all.narrow(-2, heads + kv, kv))
    }

    /// The output projection and the feed-forward self.
    fn rest(&self, w: &Weights, fused: &[Tensor], x: &Tensor, read: &Tensor, training: bool) -> Tensor {
        let drop = |t: Tensor| if training { dropped(t, self.dropout) } else { t };
        let x = x + drop(self.out.forward(w, read));
        let inner = self.norm_mlp.forward(w, &x);
        let both = affine(&inner, &fused[GATE_UP], None);
        let through = if has_rows(&both) {
            gated(&both).unwrap_or_else(|e| panic!("{e}"))
        } else {
            let halves = both.chunk(2, -1);
            halves[0].silu() * &halves[1]
        };
        &x + drop(self.down.forward(w, &through))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Builder;

    #[test]
    fn numbers_that_leave_no_numbers_are_refused() {
        let of = |change: fn(&mut QwenConfig)| {
            let mut c = QwenConfig::default();
            change(&mut c);
            c.validate().map_err(|(key, _)| key)
        };
        assert_eq!(of(|_| ()), Ok(()));
        assert_eq!(of(|c| (c.rms_eps, c.init_std) = (0.0, 1e-6)), Ok(()));
        assert_eq!([of(|c| c.rms_eps = -1e-6), of(|c| c.rms_eps = f64::NAN)], [Err("rms_eps"); 2]);
        let stds = [of(|c| c.init_std = -0.02), of(|c| c.init_std = 0.0), of(|c| c.init_std = 20.0)];
        assert_eq!(stds, [Err("init_std"); 3]);
        assert_eq!(of(|c| c.dropout = 1.0), Err("dropout"));
    }

    #[test]
    fn small_ops_say_what_the_passes_say() {
        tch::manual_seed(1);
        let sizes =
            QwenConfig { width: 32, layers: 2, heads: 4, kv_heads: 2, head_width: 8, ffn: 64, ..QwenConfig::default() };
        let mut builder = Builder::default();
        let net = Qwen::new(builder.root(), &sizes, 11);
        let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
        // Far from its start, where a layer changes next to nothing.
        let _no_grad = tch::no_grad_guard();
        params.weights().tensors().iter().for_each(|t| {
            let _ = t.shallow_clone().g_add_(&(t.randn_like() * 0.2));
        });
        let x = Tensor::randn([14, 32], (Kind::Float, Device::Cpu));
        let packed = Packed::new(vec![5, 9]);
        let whole = net.forward(params.weights(), &x, &packed, false);
        // Of these numbers there are no passes.
        assert!(has_rows(&x) && !has_rows(&x.to_kind(Kind::Half)));
        let half = net.forward(&params.weights().cast(Kind::Half), &x.to_kind(Kind::Half), &packed, false);
        let off = ((half.to_kind(Kind::Float) - &whole).norm() / whole.norm()).double_value(&[]);
        assert!(off < 0.01, "{off}");
    }
}
