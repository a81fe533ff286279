//! Geometry on plain arrays: surface sampling, normals, farthest points, voxels and the distances within.
//!
//! Whole clouds come from a [`CloudSampler`], or a [`DenseSampler`] for the part that one bone holds;
//! single points from a [`SurfaceSampler`]. The body under a surface is [`voxel::solid`], distances through it
//! are [`geodesic`].
//!
//! Holds: everything is deterministic, whatever the number of threads; what is random takes a stream.
//! Leaves out: tensors, and of skeletons all but where their bones lie.

mod alias;
#[cfg(test)]
mod bodies;
mod buckets;
mod cloud;
mod dense;
mod draws;
mod factors;
mod farthest;
pub mod geodesic;
mod heat;
mod near;
mod nearest;
mod normals;
mod pieces;
mod reskin;
mod spread;
mod surface;
mod symmetry;
mod system;
mod transfer;
pub mod voxel;

pub use buckets::sorted_by_place;
pub use cloud::{By, Cloud, CloudConfig, CloudSampler, Place};
pub use dense::{DenseConfig, DenseSampler, near_bone};
pub use farthest::farthest_points;
pub use heat::{HOTTEST, SurfaceHeat};
pub use near::{BLOCK, Lane, bone_distances};
pub use nearest::Blocks;
pub use normals::{normals_by_angle, triangle_normals};
pub use pieces::{main_piece, pieces};
pub use reskin::{Nearby, ReskinConfig, reskin};
pub use spread::spread_weights;
pub use surface::{SurfacePoint, SurfaceSampler, barycentric};
pub use symmetry::{Yaw, mirror_plane, symmetric_yaw};
pub use transfer::Transfer;
