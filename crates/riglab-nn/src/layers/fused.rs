//! Attention and blocks with the parameters of the released shape encoders (Michelangelo's names):
//! query, key and value in one matrix.

use tch::Tensor;

use super::attention::mix;
use super::{LayerNorm, Linear, block, taken};
use crate::params::{Role, Scope, Weights};

/// What a fused block attends to.
#[derive(Clone)]
enum Reads {
    /// Itself: one matrix whose rows are, head by head, query, key and value.
    Itself(Linear),
    /// Other tokens: queries, and head by head key and value.
    Other(Linear, Linear),
}

/// x += Attn(LN(x)), x += MLP(LN(x)), the MLP four times as wide with GELU by erf.
#[derive(Clone)]
pub struct FusedBlock {
    reads: Reads,
    proj: Linear,
    norm_1: LayerNorm,
    norm_2: LayerNorm,
    /// Of the block that reads others, whose second norm is theirs.
    norm_3: Option<LayerNorm>,
    up: Linear,
    down: Linear,
    heads: i64,
}

/// Sizes of a fused block.
#[derive(Clone, Copy, Debug)]
pub struct FusedConfig {
    /// Width of all tokens.
    pub width: usize,
    /// Heads.
    pub heads: usize,
    /// Whether query, key and value have a bias.
    pub qkv_bias: bool,
    /// Standard deviation at the start, in 1 / √width.
    pub init_scale: f64,
}

impl FusedBlock {
    /// A block over itself, or over other tokens.
    pub fn new(mut at: Scope, c: FusedConfig, others: bool) -> Self {
        let d = c.width;
        assert!(d.is_multiple_of(c.heads), "width {d} is not divisible by {} heads: check the config first", c.heads);
        let std = c.init_scale / (d as f64).sqrt();
        let linear = |at: Scope, role, input, output, bias: bool| {
            if bias {
                Linear::normal(at, role, input, output, std, 0.0)
            } else {
                Linear::plain(at, role, input, output, std)
            }
        };
        let mut attn = at.sub("attn");
        let reads = if others {
            let q = linear(attn.sub("c_q"), Role::Attention, d, d, c.qkv_bias);
            Reads::Other(q, linear(attn.sub("c_kv"), Role::Attention, d, 2 * d, c.qkv_bias))
        } else {
            Reads::Itself(linear(attn.sub("c_qkv"), Role::Attention, d, 3 * d, c.qkv_bias))
        };
        let proj = linear(attn.sub("c_proj"), Role::Attention, d, d, true);
        let mut mlp = at.sub("mlp");
        let up = linear(mlp.sub("c_fc"), Role::FeedForward, d, 4 * d, true);
        let down = linear(mlp.sub("c_proj"), Role::FeedForward, 4 * d, d, true);
        Self {
            reads,
            proj,
            up,
            down,
            norm_1: LayerNorm::new(at.sub("ln_1"), d),
            norm_2: LayerNorm::new(at.sub("ln_2"), d),
            norm_3: others.then(|| LayerNorm::new(at.sub("ln_3"), d)),
            heads: c.heads as i64,
        }
    }

    /// x [b, t, d] through the block; `others` [b, s, d] where it reads them.
    pub fn forward(&self, w: &Weights, x: &Tensor, others: Option<&Tensor>) -> Tensor {
        let (block, inputs) = (self.clone(), std::iter::once(x).chain(others).collect::<Vec<_>>());
        w.block(&inputs, move |w, t| block.compute(w, &t[0], t.get(1)))
    }

    fn compute(&self, w: &Weights, x: &Tensor, others: Option<&Tensor>) -> Tensor {
        let norm = self.norm_3.as_ref().unwrap_or(&self.norm_2);
        block::added(w, norm, [&self.up, &self.down], &self.attended(w, x, others))
    }

    /// x + Attn(LN(x)).
    fn attended(&self, w: &Weights, x: &Tensor, others: Option<&Tensor>) -> Tensor {
        if let Some(out) = self.proj.map(w).filter(|_| riglab_torch::has_block(x)) {
            let dealt = |weights, map: &Linear| {
                let bias = map.bias().map(|b| &w[b]);
                riglab_torch::Heads { weights, bias, count: self.heads, fused: true }
            };
            let norm = self.norm_1.norm(w);
            return match (&self.reads, others) {
                (Reads::Itself(qkv), _) => {
                    let all = [&w[qkv.weight()]];
                    taken(riglab_torch::own_attention(x, norm, dealt(&all, qkv), out))
                }
                (Reads::Other(q, kv), others) => {
                    let others = others.expect("a block that reads others is given them");
                    let (asking, asked) = ([&w[q.weight()]], [&w[kv.weight()]]);
                    let keys = taken(riglab_torch::keys(others, self.norm_2.norm(w), dealt(&asked, kv)));
                    taken(riglab_torch::other_attention(x, norm, dealt(&asking, q), &keys, out))
                }
            };
        }
        let (b, t, d) = x.size3().expect("three axes");
        let own = self.norm_1.forward(w, x);
        let parts = |y: Tensor, n: i64| {
            let s = y.size()[1];
            y.view([b, s, self.heads, n, d / self.heads]).permute([3, 0, 2, 1, 4]).unbind(0)
        };
        let read = match (&self.reads, others) {
            (Reads::Itself(qkv), _) => {
                let p = parts(qkv.forward(w, &own), 3);
                mix(&p[0], &p[1], &p[2], false)
            }
            (Reads::Other(q, kv), others) => {
                let others = self.norm_2.forward(w, others.expect("a block that reads others is given them"));
                let q = parts(q.forward(w, &own), 1);
                let p = parts(kv.forward(w, &others), 2);
                mix(&q[0], &p[0], &p[1], false)
            }
        };
        x + self.proj.forward(w, &read.transpose(1, 2).reshape([b, t, d]))
    }
}
