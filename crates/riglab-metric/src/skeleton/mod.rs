//! Predicted skeletons against true ones, by the formulas of each peer.

mod bone;
mod connectivity;
mod consensus;
mod diameter;
mod distances;
mod fit;
mod matching;
mod merge;
mod tree_edit;

pub use connectivity::{Connectivity, connectivity};
pub use consensus::{apart_from, consensus, consensus_with, disagreement, refined, symmetrised};
pub use diameter::local_shape_diameters;
pub use distances::{Joints, SkeletonConvention, SkeletonDistances};
pub use fit::fit;
pub use matching::{Matched, match_joints, nearest_shares};
pub use merge::Graph;
pub use tree_edit::{ordered_by_position, tree_edit_distance};
