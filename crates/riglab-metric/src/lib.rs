//! Metrics under named conventions, and baselines without learning.
//!
//! Peers compute metrics of one name by different formulas, so a number here names its convention: distances
//! between skeletons ([`SkeletonConvention`]), figures of skin weights ([`SkinConvention`]), with the readings of
//! the papers that riglab takes where no code is public. Beside them stand joints matched one to one, tree edit
//! distance, connectivity, motion, the use of a codebook, and baselines: by distance, straight or through the body,
//! and by heat.
//! [`Truth`] gives all of them for one asset, [`statistics`] says how sure a mean over assets is.
//!
//! Holds: sums are in f64 and in fixed order; thresholds are compared in f32 unless the convention's code does
//! otherwise; an empty denominator gives NaN, which means over assets leave out and count.
//!
//! Leaves out: models, training, files.

mod baseline;
mod codebook;
mod geodesic;
mod heat;
mod motion;
mod rows;
mod score;
mod skeleton;
mod skin;
mod skin_baseline;
pub mod statistics;

pub use baseline::{Baseline, bone_distances};
pub use codebook::{Codebook, compression_ratio};
pub use geodesic::{geodesic_distances, geodesic_weights};
pub use heat::heat_weights;
pub use motion::{Frames, Motion, Poses, clip_frames, motion, motion_of_frames, motion_poses, posed};
pub use rows::Rows;
pub use score::{Measure, Preset, Truth, lower_is_better, trades};
pub use skeleton::{
    Connectivity, Graph, Joints, Matched, SkeletonConvention, SkeletonDistances, apart_from, connectivity, consensus,
    consensus_with, disagreement, fit, local_shape_diameters, match_joints, nearest_shares, ordered_by_position,
    refined, symmetrised, tree_edit_distance,
};
pub use skin::{ACTIVE, PrecisionRecall, SkinConvention, SkinMetrics, SkinTally, Skins, edges_of, nan_for_null};
pub use skin_baseline::{SkinBaseline, every_rule};

/// Names and values of one asset, in the order of a table's columns.
pub type Figures = Vec<(&'static str, f64)>;
