//! The backbone's block.

use tch::Tensor;

use super::conv::SubmConv;
use super::{Places, Ptv3Config, View, layout};
use crate::layers::{LayerNorm, Linear, mix};
use crate::params::{Role, Scope, Weights};

/// x += LN(L(conv(x))), x += Attn(LN(x)) within patches, x += MLP(LN(x)).
#[derive(Clone)]
pub struct Block {
    cpe: (SubmConv, Linear, LayerNorm),
    norm1: LayerNorm,
    qkv: Linear,
    proj: Linear,
    norm2: LayerNorm,
    up: Linear,
    down: Linear,
    heads: i64,
    qk_norm: bool,
    patch: usize,
    turn: usize,
}

impl Block {
    /// Block `turn` of a stage: it takes that order, counted round.
    pub(super) fn new(mut at: Scope, c: &Ptv3Config, stage: usize, turn: usize) -> Self {
        let d = c.channels[stage];
        let mut cpe = at.sub("cpe");
        let cpe = (
            SubmConv::new(cpe.sub(0), d, d, layout::BLOCK, true),
            Linear::new(cpe.sub(1), Role::Projection, d, d, true),
            LayerNorm::new(cpe.sub(2), d),
        );
        let norm1 = LayerNorm::new(at.sub("norm1").sub(0), d);
        let mut attn = at.sub("attn");
        let qkv = Linear::new(attn.sub("qkv"), Role::Attention, d, 3 * d, true);
        let proj = Linear::new(attn.sub("proj"), Role::Attention, d, d, true);
        let norm2 = LayerNorm::new(at.sub("norm2").sub(0), d);
        let mut mlp = at.sub("mlp");
        let mut mlp = mlp.sub(0);
        let up = Linear::new(mlp.sub("fc1"), Role::FeedForward, d, c.mlp_ratio * d, true);
        let down = Linear::new(mlp.sub("fc2"), Role::FeedForward, c.mlp_ratio * d, d, true);
        let (heads, qk_norm, patch) = (c.heads[stage] as i64, c.qk_norm, c.patch);
        Self { cpe, norm1, qkv, proj, norm2, up, down, heads, qk_norm, patch, turn }
    }

    /// x [n, c] through the block.
    pub fn forward(&self, w: &Weights, x: &Tensor, places: &Places) -> Tensor {
        let (block, places) = (self.clone(), places.shared());
        w.block(&[x], move |w, t| block.compute(w, &t[0], &places))
    }

    fn compute(&self, w: &Weights, x: &Tensor, places: &Places) -> Tensor {
        let x = x + self.placed(w, x, places);
        let x = &x + self.attended(w, &x, places);
        &x + self.down.forward(w, &self.up.forward(w, &self.norm2.forward(w, &x)).gelu("none"))
    }

    /// What the convolution adds to x: where points are.
    pub fn placed(&self, w: &Weights, x: &Tensor, places: &Places) -> Tensor {
        let (conv, linear, norm) = &self.cpe;
        norm.forward(w, &linear.forward(w, &conv.forward(w, x, &places.blocks)))
    }

    /// What the attention adds to x.
    pub fn attended(&self, w: &Weights, x: &Tensor, places: &Places) -> Tensor {
        let View { take, back, lengths } = places.view(self.patch, self.turn);
        let (h, d) = (self.heads, x.size()[1] / self.heads);
        let qkv = self.qkv.forward(w, &self.norm1.forward(w, x)).index_select(0, take);
        let mut parts = Vec::new();
        let mut start = 0;
        // Runs of patches of one length go together: all of them, unless clouds are small.
        for run in lengths.chunk_by(|a, b| a == b) {
            let (p, l) = (run.len() as i64, run[0]);
            let own = qkv.narrow(0, start, p * l).view([p, l, 3, h, d]).permute([2, 0, 3, 1, 4]);
            let (q, k, v) = (self.normed(&own.get(0)), self.normed(&own.get(1)), own.get(2));
            parts.push(mix(&q, &k, &v, false).transpose(1, 2).reshape([p * l, h * d]));
            start += p * l;
        }
        self.proj.forward(w, &Tensor::cat(&parts, 0).index_select(0, back))
    }

    fn normed(&self, x: &Tensor) -> Tensor {
        if !self.qk_norm {
            return x.shallow_clone();
        }
        x.layer_norm([x.size()[3]], None::<&Tensor>, None::<&Tensor>, 1e-5, false)
    }
}
