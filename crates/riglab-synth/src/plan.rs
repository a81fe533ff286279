//! Body plans: what kinds of creature there are.

use crate::body::Body;
use crate::dice::Dice;
use crate::plans;

/// A kind of creature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Plan {
    /// Two legs, two arms, upright: 22 joints with Mixamo's names, up to 52 with fingers.
    Biped,
    /// An avatar as VRoid makes them: hair, skirt and the like on spring bones, bones mapped for VRM.
    Anime,
    /// Four legs, a neck and mostly a tail: from mouse to horse.
    Quadruped,
    /// Two legs and feathered wings, spread or folded: from humming bird to flamingo.
    Bird,
    /// Fins and a tail that swings sideways or, for dolphins and their like, up and down.
    Fish,
    /// One long chain with a head.
    Snake,
    /// Legs beside the body and a long tail: lizards, crocodiles, tortoises.
    Lizard,
    /// On two legs or four, with plates, horns or crests.
    Dinosaur,
    /// A beast with wings of skin.
    Dragon,
}

impl Plan {
    /// Every plan.
    pub const ALL: [Self; 9] = [
        Self::Biped,
        Self::Anime,
        Self::Quadruped,
        Self::Bird,
        Self::Fish,
        Self::Snake,
        Self::Lizard,
        Self::Dinosaur,
        Self::Dragon,
    ];

    /// Its name in lower case, as in asset names and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Biped => "biped",
            Self::Anime => "anime",
            Self::Quadruped => "quadruped",
            Self::Bird => "bird",
            Self::Fish => "fish",
            Self::Snake => "snake",
            Self::Lizard => "lizard",
            Self::Dinosaur => "dinosaur",
            Self::Dragon => "dragon",
        }
    }

    /// The category of its creatures, for [`riglab_core::Provenance::category`].
    pub fn category(self) -> &'static str {
        match self {
            Self::Biped => "humanoid",
            Self::Anime => "anime_vrm",
            Self::Quadruped => "quadruped",
            Self::Bird => "bird_flying",
            Self::Fish => "aquatic",
            Self::Snake => "reptile",
            Self::Lizard => "reptile",
            Self::Dinosaur => "reptile",
            Self::Dragon => "reptile",
        }
    }

    /// A creature of this plan, with as much detail as `triangles` can show.
    pub(crate) fn body(self, dice: &mut Dice, triangles: u32) -> Body {
        match self {
            Self::Biped => plans::biped::body(dice, triangles),
            Self::Anime => plans::anime::body(dice, triangles),
            Self::Quadruped => plans::quadruped::body(dice, triangles),
            Self::Bird => plans::bird::body(dice, triangles),
            Self::Fish => plans::fish::body(dice, triangles),
            Self::Snake => plans::snake::body(dice, triangles),
            Self::Lizard => plans::lizard::body(dice, triangles),
            Self::Dinosaur => plans::dinosaur::body(dice, triangles),
            Self::Dragon => plans::dragon::body(dice, triangles),
        }
    }
}

impl std::str::FromStr for Plan {
    type Err = String;

    /// From a [`Plan::name`]; the error lists them.
    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|plan| plan.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("no body plan is called `{name}`; there are {names}")
        })
    }
}
