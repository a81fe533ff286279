//! Seeded augmentation of rigs and their points.
//!
//! A [`Recipe`] takes a rig apart once ([`Draft`]), lets each of its steps change what lies there in
//! place, and puts a rig together again. A step is a file: its config draws, by probability and range,
//! and hands the draws to a function that takes them as arguments, so that values recorded from other
//! code can be replayed, and each can be tested and used alone. Drawn maps for single points, for tasks
//! that do not augment whole rigs, are [`AffineMap`]s.
//!
//! Holds: the result of any steps in any order on any rig is a rig: one tree, weights that sum to 1,
//! finite numbers, at least one triangle; humanoid map and springs name the joints that are left. A step
//! that cannot keep this promise on some rig, because no triangle would be left or numbers would
//! overflow, leaves that rig as it is. Same seed and index, same bytes. What was recorded of the rig
//! before, such as clips, can be carried over by [`Augmented::motion`].
//!
//! Units are those of the normalised cube where a step comes after [`CubeConfig`], else the rig's.
//!
//! Leaves out: tensors, sampling of points (`riglab-geom`), the choice of assets.

mod affine;
mod cube;
mod delete;
mod discretise;
mod draft;
mod jitter;
mod linear;
mod moving;
mod part;
mod pose;
mod recipe;
mod reconnect;
mod rules;
mod select;
mod trim;
mod turn;

pub use affine::{AffineConfig, AffineMap};
pub use cube::{CubeConfig, Shift, into_cube};
pub use delete::{DeleteConfig, delete, keep_part};
pub use discretise::DiscretiseConfig;
pub use draft::{Augmented, Draft, Motion, Normals};
pub use jitter::{JitterConfig, JointNoiseConfig, Noise, unit};
pub use linear::{AxesConfig, FlipConfig, LinearParts, RotateConfig, ScaleConfig, TurnConfig, linear, signed_axes};
pub use part::PartConfig;
pub use pose::{PoseConfig, pose};
pub use recipe::Recipe;
pub use reconnect::{ReconnectConfig, reconnect};
pub use rules::Fault;
pub use trim::{TrimConfig, trim};
pub use turn::{about, rotation};
