//! Layers: each knows its parameters by number and computes from the weights it is given.
//!
//! Shapes in names: b batch, t queries, s keys, h heads, d width.

mod attention;
mod block;
mod linear;

pub use attention::{Attention, HeadSplit, KeyValue};
pub use block::{Block, BlockConfig, Context, FeedForward};
pub use linear::{LayerNorm, Linear};
