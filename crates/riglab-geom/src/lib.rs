//! Geometry on plain arrays: surface sampling, normals and farthest points.
//!
//! Whole clouds come from a [`CloudSampler`], or a [`DenseSampler`] for the part that one bone holds;
//! single points from a [`SurfaceSampler`].
//!
//! Holds: everything is deterministic; what is random takes a stream.
//! Leaves out: what skeletons mean, tensors.

mod alias;
mod cloud;
mod dense;
mod farthest;
mod normals;
mod surface;

pub use cloud::{By, Cloud, CloudConfig, CloudSampler, Place};
pub use dense::{DenseConfig, DenseSampler, near_bone};
pub use farthest::farthest_points;
pub use normals::{normals_by_angle, triangle_normals};
pub use surface::{SurfacePoint, SurfaceSampler, barycentric};
