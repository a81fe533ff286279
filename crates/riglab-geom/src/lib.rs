//! Geometry on plain arrays: surface sampling, farthest points, nearest neighbours.
//!
//! Holds: everything is deterministic; what is random takes a stream.
//! Leaves out: what skeletons mean, tensors.

mod farthest;

pub use farthest::farthest_points;
