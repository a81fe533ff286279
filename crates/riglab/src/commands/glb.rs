//! Choices of commands that write GLB.

use riglab_asset::export::{Influences, JointFrames};

/// How many joints may hold a vertex.
#[derive(Clone, Copy, clap::ValueEnum)]
pub enum Most {
    /// What every engine reads.
    #[value(name = "4")]
    Four,
    /// Two sets of four.
    #[value(name = "8")]
    Eight,
    /// As many as there are.
    All,
}

impl From<Most> for Influences {
    fn from(most: Most) -> Self {
        match most {
            Most::Four => Self::Four,
            Most::Eight => Self::Eight,
            Most::All => Self::All,
        }
    }
}

/// How joints are turned at rest.
#[derive(Clone, Copy, clap::ValueEnum)]
pub enum Frames {
    /// As the scene: no turns, every number exact.
    Parallel,
    /// Y along the bone, as Blender and engines show bones.
    Bone,
}

impl From<Frames> for JointFrames {
    fn from(frames: Frames) -> Self {
        match frames {
            Frames::Parallel => Self::Parallel,
            Frames::Bone => Self::AlongBone,
        }
    }
}
