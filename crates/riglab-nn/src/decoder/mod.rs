//! Causal decoders of token sequences.

mod cache;
mod opt;
mod packed;

pub use cache::Cache;
pub use opt::{Opt, OptConfig};
pub use packed::Packed;
