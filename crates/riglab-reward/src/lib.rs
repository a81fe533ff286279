//! Geometric rewards of rigs: what SkinTokens' reinforcement learning asks of a rig, without a true one.
//!
//! The one idea: **a mesh is prepared once, its candidates are scored many at a time.** [`Scorer::new`] makes
//! the voxels and edges of a mesh, [`Scorer::score`] and [`Scorer::score_group`] give the four rewards of
//! candidates ([`Candidate`]) and their weighted total. Each reward is a pure function as well: [`coverage`],
//! [`containment`], [`skinning`] and [`motion`], with the paper's equation in its docs. [`physics()`], of spring bones,
//! is an extension and in no total.
//!
//! Holds: rewards lie in [0, 1], the better the larger; a candidate that could not be decoded has 0 in all; the
//! same input gives the same bits whatever the number of threads and the machine. Rigid motions of mesh and
//! rig together change rewards by rounding and, for those over voxels, by the lattice; the order of vertices
//! and joints does not matter, but for the poses of [`motion`], which are drawn joint by joint.
//! Leaves out: tensors, sampling, advantages.
//! Follows SkinTokens (arXiv 2602.04805), section 3.4.1; the rewards were never released.

mod candidate;
mod containment;
mod coverage;
mod exp;
mod motion;
mod physics;
mod poses;
mod rewards;
mod scorer;
mod skinning;
mod weights;

pub use candidate::{Candidate, CandidateError, RawWeights};
pub use containment::containment;
pub use coverage::{Coverage, coverage};
pub use motion::{motion, skinned, stretches};
pub use physics::physics;
pub use poses::{maps, random_poses};
pub use rewards::{Part, Rewards};
pub use scorer::{RewardConfig, Scorer};
pub use skinning::{Faults, skinning};
pub use weights::RewardWeights;
