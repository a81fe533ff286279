//! What kind of thing a rig is: one of eight categories, by rules over skeleton and shape.
//!
//! [`traits`] measures - which body parts joints are named after, how many legs and wings there are, where
//! the mesh stands on the ground, which way the body lies - and [`rules`] weighs. Names alone decide
//! nothing that the shape contradicts, and rigs whose joints are called `joint15` are judged by shape.
//! File names are never looked at.

mod limbs;
mod rules;
mod traits;
mod vocabulary;

use std::fmt;
use std::str::FromStr;

use riglab_core::Rig;
use serde::{Deserialize, Serialize};

pub use limbs::Limbs;
pub use traits::Traits;

/// The categories, as in Rig-XL's style.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Category {
    /// Bipeds with arms, cartoon ones and monsters too; single hands and arms.
    Humanoid,
    /// Avatars in VRM or made as such.
    AnimeVrm,
    /// Four-legged mammals and the like.
    Quadruped,
    /// Birds, bats, what flies.
    BirdFlying,
    /// Insects, spiders, crabs.
    Arthropod,
    /// Fish, whales, what swims.
    Aquatic,
    /// Reptiles, amphibians, dinosaurs, dragons.
    Reptile,
    /// Robots, vehicles, plants, props, anything else.
    MechanicalOther,
}

impl Category {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Humanoid,
        Self::AnimeVrm,
        Self::Quadruped,
        Self::BirdFlying,
        Self::Arthropod,
        Self::Aquatic,
        Self::Reptile,
        Self::MechanicalOther,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Humanoid => "humanoid",
            Self::AnimeVrm => "anime_vrm",
            Self::Quadruped => "quadruped",
            Self::BirdFlying => "bird_flying",
            Self::Arthropod => "arthropod",
            Self::Aquatic => "aquatic",
            Self::Reptile => "reptile",
            Self::MechanicalOther => "mechanical_other",
        }
    }

    /// The names of all, for messages.
    pub fn names() -> String {
        Self::ALL.map(Self::name).join(", ")
    }
}

impl fmt::Display for Category {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Category {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|c| c.name() == name)
            .ok_or_else(|| format!("`{name}` is no category; there is: {}", Self::names()))
    }
}

/// What the rules say of a rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Guess {
    /// The category.
    pub category: Category,
    /// What spoke for it, in a few words.
    pub because: &'static str,
}

/// The category of a rig by rules; `vrm`: whether it is of a VRM, where its human bones are all told. What riglab rigs tells them,
/// too, and is no avatar for that.
pub fn by_rules(rig: &Rig, vrm: bool) -> Guess {
    let traits = Traits::of(rig);
    rules::judge(&Traits { vrm: vrm && traits.vrm, ..traits })
}
