//! Layers: each knows its parameters by number and computes from the weights it is given.
//!
//! Shapes in names: b batch, t queries, s keys, h heads, d width.

mod attention;
mod block;
mod fused;
mod linear;

pub use attention::{Attention, HeadSplit, KeyValue};
pub use block::{Block, BlockConfig, Context, FeedForward};
pub use fused::{FusedBlock, FusedConfig};
pub use linear::{LayerNorm, Linear, RmsNorm};

pub(crate) use attention::{mix, shared_heads};

/// Activations of which a share `p` is dropped in training, the others being made larger; `p` was validated.
pub(crate) fn dropped(x: tch::Tensor, p: f64) -> tch::Tensor {
    if p > 0.0 { taken(riglab_torch::dropout(&x, p)) } else { x }
}

/// x [.., in] to x wᵀ + bias [.., out], w [out, in].
pub(crate) fn affine(x: &tch::Tensor, w: &tch::Tensor, bias: Option<&tch::Tensor>) -> tch::Tensor {
    taken(riglab_torch::linear(x, w, bias))
}

/// What libtorch gives for shapes that fit; it panics as libtorch's own ops do here.
pub(crate) fn taken(found: Result<tch::Tensor, riglab_torch::TorchError>) -> tch::Tensor {
    found.unwrap_or_else(|e| panic!("{e}"))
}

/// Rows of x [b, n, c] by index [b, t], as [b, t, c].
pub(crate) fn picked(x: &tch::Tensor, index: &tch::Tensor) -> tch::Tensor {
    let c = x.size()[2];
    x.gather(1, &index.unsqueeze(-1).expand([-1, -1, c], false), false)
}
