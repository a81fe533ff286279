//! Causal decoders of token sequences.

mod cache;
mod kernels;
mod moves;
mod opt;
mod packed;
mod qwen;
mod rotary;
mod steps;

pub use cache::Cache;
pub use opt::{Opt, OptConfig};
pub use packed::Packed;
pub use qwen::{Qwen, QwenConfig};
