//! Geometry on plain arrays: surface sampling and farthest points.
//!
//! Holds: everything is deterministic; what is random takes a stream.
//! Leaves out: what skeletons mean, tensors.

mod farthest;
mod surface;

pub use farthest::farthest_points;
pub use surface::{SurfacePoint, SurfaceSampler, barycentric};
