//! Causal decoders of token sequences.

mod cache;
mod kernels;
mod moves;
mod opt;
mod packed;
mod qwen;
mod rotary;
mod steps;

use std::ops::RangeInclusive;

pub use cache::Cache;
pub use opt::{Opt, OptConfig};
pub use packed::Packed;
pub use qwen::{Qwen, QwenConfig};

/// Standard deviations that weights may begin with. Tokens of weights that are all 0 stay 0 through every layer and are
/// scored by 0: no gradient comes to any weight, also of what tells tokens more, and nothing is ever learnt. Far below the
/// least one here it is the same, in single precision.
pub const STDS: RangeInclusive<f64> = 1e-6..=1.0;

/// Checks a decoder's `init_std`.
fn spread(std: f64) -> Result<(), String> {
    let (least, most) = STDS.into_inner();
    match STDS.contains(&std) {
        true => Ok(()),
        false => Err(format!(
            "init_std = {std:?} must lie in [{least:?}, {most:?}]: with weights that all begin as 0 nothing is learnt"
        )),
    }
}
