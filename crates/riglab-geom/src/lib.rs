//! Geometry on plain arrays: surface sampling and farthest points.
//!
//! Holds: everything is deterministic; what is random takes a stream.
//! Leaves out: what skeletons mean, tensors.

mod farthest;
mod normals;
mod surface;

pub use farthest::farthest_points;
pub use normals::{normals_by_angle, triangle_normals};
pub use surface::{SurfacePoint, SurfaceSampler, barycentric};
