//! Seeded augmentation of rigs and their points.
//!
//! Each augmentation is drawn from a stream and then applied, so that it can be tested alone and
//! used on whole rigs or only on the points that a batch samples.
//!
//! Leaves out: tensors, the order of a task's augmentations.

mod affine;

pub use affine::{AffineConfig, AffineMap};
