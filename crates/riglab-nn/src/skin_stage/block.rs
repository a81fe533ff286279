//! The post-norm block of the skin stage.

use tch::Tensor;

use crate::layers::{LayerNorm, Linear, mix};
use crate::params::{Role, Scope, Weights};

/// x = LN(x + Attn(x, y)), x = LN(x + FF(x)), the feed-forward layer four times as wide with GELU; all with biases.
#[derive(Clone)]
pub struct PostBlock {
    q: Linear,
    kv: Linear,
    out: Linear,
    norm1: LayerNorm,
    up: Linear,
    down: Linear,
    norm2: LayerNorm,
    heads: i64,
}

impl PostBlock {
    /// The width is a multiple of the heads.
    pub fn new(mut at: Scope, width: usize, heads: usize) -> Self {
        let mut attention = at.sub("attention");
        let mut linear =
            |name: &str, n: usize| Linear::new(attention.sub(name), Role::Attention, width, n * width, true);
        let (q, kv, out) = (linear("Wq", 1), linear("Wkv", 2), linear("out_proj", 1));
        let mut ffn = at.sub("ffn");
        Self {
            q,
            kv,
            out,
            up: Linear::new(ffn.sub(0), Role::FeedForward, width, 4 * width, true),
            down: Linear::new(ffn.sub(2), Role::FeedForward, 4 * width, width, true),
            norm1: LayerNorm::new(at.sub("norm1"), width),
            norm2: LayerNorm::new(at.sub("norm2"), width),
            heads: heads as i64,
        }
    }

    /// x [b, t, d] that reads y [b, s, d].
    pub fn forward(&self, w: &Weights, x: &Tensor, y: &Tensor) -> Tensor {
        let block = self.clone();
        w.block(&[x, y], move |w, t| block.compute(w, &t[0], &t[1]))
    }

    fn compute(&self, w: &Weights, x: &Tensor, y: &Tensor) -> Tensor {
        let (b, t, d) = x.size3().expect("three axes");
        let per = d / self.heads;
        let q = self.q.forward(w, x).view([b, t, self.heads, per]).transpose(1, 2);
        let kv = self.kv.forward(w, y).view([b, y.size()[1], 2, self.heads, per]).permute([2, 0, 3, 1, 4]);
        let read = mix(&q, &kv.get(0), &kv.get(1), false).transpose(1, 2).reshape([b, t, d]);
        let x = self.norm1.forward(w, &(x + self.out.forward(w, &read)));
        self.norm2.forward(w, &(&x + self.down.forward(w, &self.up.forward(w, &x).gelu("none"))))
    }
}

/// A linear map, a norm, GELU.
pub struct Mapped(Linear, LayerNorm);

impl Mapped {
    /// The map is `at.{first}`, the norm `at.{first + 1}`.
    pub fn new(mut at: Scope, first: usize, input: usize, output: usize) -> Self {
        let linear = Linear::new(at.sub(first), Role::Projection, input, output, true);
        Self(linear, LayerNorm::new(at.sub(first + 1), output))
    }

    /// x [.., in] to [.., out].
    pub fn forward(&self, w: &Weights, x: &Tensor) -> Tensor {
        self.1.forward(w, &self.0.forward(w, x)).gelu("none")
    }
}
