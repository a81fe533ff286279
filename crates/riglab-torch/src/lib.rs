//! The part of libtorch that tch lacks.
//!
//! tch wraps single ops. What training needs besides are ops over lists of tensors in place (the
//! fused AdamW, norms, moving averages), blocks that are computed again in the backward pass, parts that
//! threads compute side by side, halves of transformer blocks as one op each, attention of packed
//! sequences and dropout that all threads share, affine maps by
//! the faster of libtorch's libraries, autocast on the CPU, and the settings of libtorch's global context. They are
//! reached through a small C++ shim compiled against the same headers; a tensor of tch *is* an `at::Tensor`, so nothing
//! is copied.
//!
//! Call [`init`] first thing in a program: it sets threads and allocator switches that libtorch
//! reads once.
//!
//! Leaves out: networks, optimizers' bookkeeping (`riglab-nn`).

mod attention;
mod block;
mod dropout;
mod error;
mod flops;
mod hooks;
mod linear;
mod parts;
mod recompute;
mod rows;
mod settings;
mod tensors;

pub use attention::{Span, flash_attention, packed_attention};
pub use block::{Heads, Map, Norm, feed_forward, has_block, keys, other_attention, own_attention};
pub use dropout::dropout;
pub use error::{TorchError, first_line, out_of_memory, said};
pub use flops::{count_flops, counted_along};
pub use hooks::backward;
pub use linear::linear;
pub use parts::{Part, alone, side_by_side, threads_on, with_gradients};
pub use recompute::{grad_enabled, recompute};
pub use rows::{gated, has_rows, norm_rows, turned_heads};
pub use settings::{
    Autocast, Settings, cpu_capability, device, has_bf16, init, libtorch_version, load_cuda, memory_gb,
    multiplies_bf16, own_generator, rng_state, set_rng_state, wait_patiently,
};
pub use tensors::{AdamwStep, foreach_add, foreach_add_scalar, foreach_lerp, foreach_mul, fused_adamw, global_norm};
