//! Spring bones in motion: VRM's update rule, on the motion of a rig.
//!
//! The one idea: **everything is a map from rest to pose.** A motion gives one for each joint, the simulation
//! gives another for those that swing and all below them, and skinning takes either. So there are no local
//! frames, and a rig moves alike whatever file it came from. [`Simulation`] goes frame by frame, [`play`] through a
//! whole clip; [`generate`] makes motions for rigs that have none, and [`guess`] springs.
//!
//! The rule is that of `VRMC_springBone` 1.0 (VRM Consortium). Of each bone that swings, the tail keeps its velocity
//! less drag, is pulled to where the bone would be at rest and to where gravity points, comes back to the bone's
//! length, and leaves the colliders; the bone then takes the shortest turn from rest. Stiffness and
//! gravity are lengths a second in the rig's units, as there: a rig in centimetres needs larger ones.
//!
//! Holds: no input gives a map that is not finite; bones without length, singular maps, steps of no time and
//! colliders that wait for one another included. The same input gives the same bits on every machine.
//! Agrees with three-vrm (`tests/three_vrm.rs`).
//! Leaves out: tensors and gradients (`riglab-nn::simulate`), files; radii that grow with a motion's scale.

mod bone;
mod guess;
mod motion;
mod order;
mod play;
mod simulation;

pub use bone::Lengths;
pub use guess::guess;
pub use motion::{Motion, MotionKind, generate};
pub use play::play;
pub use simulation::{Simulation, SimulationError};
