//! The pre-norm transformer block of the skin auto-encoder (SkinTokens 3.2, released `DiTBlock`).

use tch::Tensor;

use super::attention::KeyValue;
use super::{Attention, HeadSplit, LayerNorm, Linear, taken};
use crate::params::{Role, Scope, Weights};

/// Linear, GELU (by erf), Linear.
#[derive(Clone)]
pub struct FeedForward {
    up: Linear,
    down: Linear,
}

impl FeedForward {
    /// `ratio` times as wide inside.
    pub fn new(mut at: Scope, width: usize, ratio: f64) -> Self {
        let inner = ((width as f64) * ratio).round() as usize;
        let mut net = at.sub("net");
        Self {
            up: Linear::new(net.sub(0).sub("proj"), Role::FeedForward, width, inner, true),
            down: Linear::new(net.sub(2), Role::FeedForward, inner, width, true),
        }
    }

    /// x [.., d], same shape out.
    pub fn forward(&self, w: &Weights, x: &Tensor) -> Tensor {
        self.down.forward(w, &self.up.forward(w, x).gelu("none"))
    }

    /// x + [`Self::forward`] of LN(x).
    pub fn added(&self, w: &Weights, norm: &LayerNorm, x: &Tensor) -> Tensor {
        added(w, norm, [&self.up, &self.down], x)
    }
}

/// x + W₂ gelu(W₁ LN(x) + b₁) + b₂ by the maps up and down.
pub(super) fn added(w: &Weights, norm: &LayerNorm, [up, down]: [&Linear; 2], x: &Tensor) -> Tensor {
    match (up.map(w), down.map(w)) {
        (Some(up), Some(down)) if riglab_torch::has_block(x) => {
            taken(riglab_torch::feed_forward(x, norm.norm(w), up, down))
        }
        _ => x + down.forward(w, &up.forward(w, &norm.forward(w, x)).gelu("none")),
    }
}

/// What a block attends to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Context {
    /// Itself (`norm1`, `attn1`).
    Itself,
    /// Other tokens (`norm2`, `attn2` with `norm_cross` on the others).
    Other,
    /// Itself, then other tokens.
    Both,
}

/// Sizes of a block.
#[derive(Clone, Copy, Debug)]
pub struct BlockConfig {
    /// Width of the residual stream.
    pub width: usize,
    /// Width of the tokens attended to, where they are others.
    pub context_width: usize,
    /// Heads.
    pub heads: usize,
    /// Inner width of the feed-forward layer over the width.
    pub mlp_ratio: f64,
    /// How channels are dealt to heads.
    pub split: HeadSplit,
}

/// x += Attn(LN(x)) for each attention, then x += FF(LN(x)).
#[derive(Clone)]
pub struct Block {
    own: Option<(LayerNorm, Attention)>,
    other: Option<(LayerNorm, LayerNorm, Attention)>,
    norm3: LayerNorm,
    ff: FeedForward,
}

impl Block {
    /// A block of the given kind.
    pub fn new(mut at: Scope, c: BlockConfig, context: Context) -> Self {
        let own = (context != Context::Other).then(|| {
            (
                LayerNorm::new(at.sub("norm1"), c.width),
                Attention::new(at.sub("attn1"), c.width, c.width, c.heads, c.split),
            )
        });
        let other = (context != Context::Itself).then(|| {
            let norm = LayerNorm::new(at.sub("norm2"), c.width);
            let norm_cross = LayerNorm::new(at.sub("attn2").sub("norm_cross"), c.context_width);
            (norm, norm_cross, Attention::new(at.sub("attn2"), c.width, c.context_width, c.heads, c.split))
        });
        Self {
            own,
            other,
            norm3: LayerNorm::new(at.sub("norm3"), c.width),
            ff: FeedForward::new(at.sub("ff"), c.width, c.mlp_ratio),
        }
    }

    /// The keys of the other tokens y [b, s, c], for [`Self::forward`].
    pub fn keys(&self, w: &Weights, y_bsc: &Tensor) -> KeyValue {
        let (_, norm_cross, attention) = self.other.as_ref().expect("a block that attends to other tokens");
        attention.keys_of(w, norm_cross, y_bsc)
    }

    /// x [b, t, d] through the block, which reads the other tokens [b, s, c] if it does: as one of a deep stack.
    pub fn read(&self, w: &Weights, x: &Tensor, others: Option<&Tensor>) -> Tensor {
        let (block, inputs) = (self.clone(), std::iter::once(x).chain(others).collect::<Vec<_>>());
        w.block(&inputs, move |w, t| {
            let keys = t.get(1).map(|others| block.keys(w, others));
            block.forward(w, &t[0], keys.as_ref())
        })
    }

    /// x [b, t, d] through the block.
    ///
    /// Queries attend alone, so rows can be shared. Where `keys` has fewer rows than x (a rig's
    /// shape, read by each of its bones), x is folded to that many rows. Where it has more (the
    /// tokens of each bone, read by points that the rig's bones share), each row of x is read by as
    /// many rows of keys, and the result has the keys' rows; norm and query projection are still
    /// computed once.
    pub fn forward(&self, w: &Weights, x_btd: &Tensor, keys: Option<&KeyValue>) -> Tensor {
        let mut x = x_btd.shallow_clone();
        if let Some((norm, attention)) = &self.own {
            x = attention.added_over_itself(w, norm, &x);
        }
        if let Some((norm, _, attention)) = &self.other {
            let keys = keys.expect("a block that attends to other tokens is given their keys");
            x = attention.added_over(w, norm, &x, keys);
        }
        self.ff.added(w, &self.norm3, &x)
    }
}
