//! Space cut into cubes, and which of them a body fills.
//!
//! [`solid`] is for real assets: surfaces open at sleeves and necks, eyes and hair as pieces of their own,
//! faces missing or turned. [`shell`] has the cells that the surface touches alone, [`fill`] and
//! [`by_depth`] are what the public code of UniRig and SkinTokens does.

mod depth;
mod fill;
mod lattice;
mod orient;
mod rays;
mod shell;
mod solid;

pub use depth::by_depth;
pub use fill::{Between, fill};
pub use lattice::{Lattice, MOST_CELLS, Voxels};
pub use shell::shell;
pub use solid::{Shell, SolidConfig, solid};
