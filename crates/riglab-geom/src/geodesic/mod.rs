//! How far bones are from places of a body, along ways through its inside.
//!
//! [`GeodesicSolver`] measures along straight sights and around corners; [`voxel_skin`] is the search over a
//! graph of cells and vertices of the public code of UniRig and SkinTokens, with its weights.

mod body;
mod bridges;
mod released;
mod search;
mod solver;

pub use released::{Kernel, VoxelSkin, VoxelSkinConfig, voxel_skin};
pub use solver::GeodesicSolver;
