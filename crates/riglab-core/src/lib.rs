//! Rigs: skeletons, meshes and skinning weights, and what can be said about them without files or
//! tensors.
//!
//! The one idea: **a [`Rig`] is valid or does not exist.** [`Skeleton::new`], [`Mesh::new`] and
//! [`SkinWeights::new`] check their part once, [`Rig::new`] checks that the parts fit, fields are
//! private, and nothing downstream checks again. Repairs happen before, where files are read, and
//! are recorded in the asset's [`Provenance`].
//!
//! Holds: one tree with its root first and parents before children; unique, non-empty joint names;
//! finite numbers; triangle and joint indices in range; weights positive, at most one per joint
//! and vertex, summing to 1 on every vertex within [`SUM_TOLERANCE`].
//!
//! Axes and units are those of the source unless a rig went through [`Rig::normalized`].
//!
//! Also: what a rig may have besides, humanoid map and spring bones, and the clips that move it.
//!
//! Leaves out: files (`riglab-asset`), tensors, the simulation of springs (`riglab-simulate`).

mod asset;
mod bones;
mod clip;
mod error;
mod humanoid;
mod mesh;
mod pose;
mod rig;
mod rule;
mod skeleton;
mod springs;
mod weights;

pub use asset::{Asset, Provenance};
pub use bones::Segment;
pub use clip::{Clip, JointMap};
pub use error::RigError;
pub use humanoid::{HumanBone, Humanoid};
pub use mesh::Mesh;
pub use pose::{Pose, lbs, skin};
pub use rig::{Bounds, Rig, Similarity};
pub use rule::DecodeRule;
pub use skeleton::{Joint, JointId, Skeleton};
pub use springs::{Collider, Shape, Spring, SpringJoint, Springs, Swing};
pub use weights::{SUM_TOLERANCE, SkinWeights};

/// A point or direction: x, y, z.
pub type Vec3 = [f32; 3];
