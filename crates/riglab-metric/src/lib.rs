//! Metrics under named conventions, and baselines without learning.
//!
//! Peers compute metrics of one name by different formulas, so a number here names its convention.
//! This crate has SkinTokens' skin metrics ([`SkinMetrics`], convention `skintokens`) with the readings of
//! its paper that riglab takes, its codebook figures, distances between skeletons ([`SkeletonConvention`]),
//! and baselines by
//! distance, straight or through the body.
//!
//! Holds: sums are in f64 and in fixed order; thresholds are compared in f32; an empty denominator
//! gives NaN, which means over assets leave out and count.
//!
//! Leaves out: models, training, files.

mod baseline;
mod codebook;
mod geodesic;
mod skeleton;
mod skin;

pub use baseline::{Baseline, bone_distances};
pub use codebook::{Codebook, compression_ratio};
pub use geodesic::{geodesic_distances, geodesic_weights};
pub use skeleton::{Joints, SkeletonConvention, SkeletonDistances};
pub use skin::nan_for_null;
pub use skin::{ACTIVE, SkinMetrics, SkinTally};
