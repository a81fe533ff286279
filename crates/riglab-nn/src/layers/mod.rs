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

pub(crate) use attention::mix;

/// Rows of x [b, n, c] by index [b, t], as [b, t, c].
pub(crate) fn picked(x: &tch::Tensor, index: &tch::Tensor) -> tch::Tensor {
    let c = x.size()[2];
    x.gather(1, &index.unsqueeze(-1).expand([-1, -1, c], false), false)
}
