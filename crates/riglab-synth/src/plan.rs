//! Body plans: what kinds of creature there are.

use crate::body::Body;
use crate::dice::Dice;
use crate::plans;

/// A kind of creature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Plan {
    /// Two legs, two arms, upright, dressed: 20 joints with Mixamo's or Blender's names, 52 with fingers,
    /// more with twist joints, capes and what they carry.
    Biped,
    /// An avatar as VRoid makes them: hair, skirt and the like on spring bones, bones mapped for VRM.
    Anime,
    /// A figure with more arms, horns, tails, eyes than people have, on legs or tentacles.
    Monster,
    /// Four legs, a neck and mostly a tail: from mouse to horse.
    Quadruped,
    /// Two legs and feathered wings, spread or folded: from humming bird to flamingo.
    Bird,
    /// Six legs, mostly wings: bees, beetles, butterflies.
    Insect,
    /// Eight legs or so, with pincers or a sting: spiders, scorpions, crabs.
    Spider,
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
    /// Arms on a base, vehicles, robots: each part follows one joint with weight 1.
    Machine,
    /// Cables, plants, banners, chests: things that bend or open.
    Prop,
    /// What stands where it is but for a part or two: idols, cabinets, traps, bells, scenes. Two to four joints, and
    /// those that exporters add. Not in [`Self::MIXTURE`].
    Fixture,
}

impl Plan {
    /// Every plan.
    pub const ALL: [Self; 15] = [
        Self::Biped,
        Self::Anime,
        Self::Monster,
        Self::Quadruped,
        Self::Bird,
        Self::Insect,
        Self::Spider,
        Self::Fish,
        Self::Snake,
        Self::Lizard,
        Self::Dinosaur,
        Self::Dragon,
        Self::Machine,
        Self::Prop,
        Self::Fixture,
    ];

    /// Plans as often as corpora of real rigs have their like, roughly: more of the many humanoids and
    /// machines, and enough of the rest to learn from. Any few that follow each other are unlike.
    pub const MIXTURE: [Self; 24] = [
        Self::Biped,
        Self::Quadruped,
        Self::Machine,
        Self::Anime,
        Self::Fish,
        Self::Biped,
        Self::Bird,
        Self::Prop,
        Self::Monster,
        Self::Dinosaur,
        Self::Spider,
        Self::Biped,
        Self::Machine,
        Self::Quadruped,
        Self::Lizard,
        Self::Anime,
        Self::Insect,
        Self::Biped,
        Self::Fish,
        Self::Dragon,
        Self::Prop,
        Self::Quadruped,
        Self::Snake,
        Self::Bird,
    ];

    /// Its name in lower case, as in asset names and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Biped => "biped",
            Self::Anime => "anime",
            Self::Monster => "monster",
            Self::Quadruped => "quadruped",
            Self::Bird => "bird",
            Self::Insect => "insect",
            Self::Spider => "spider",
            Self::Fish => "fish",
            Self::Snake => "snake",
            Self::Lizard => "lizard",
            Self::Dinosaur => "dinosaur",
            Self::Dragon => "dragon",
            Self::Machine => "machine",
            Self::Prop => "prop",
            Self::Fixture => "fixture",
        }
    }

    /// The category of its creatures, for [`riglab_core::Provenance::category`].
    pub fn category(self) -> &'static str {
        match self {
            Self::Biped => "humanoid",
            Self::Anime => "anime_vrm",
            Self::Monster => "humanoid",
            Self::Quadruped => "quadruped",
            Self::Bird => "bird_flying",
            Self::Insect => "arthropod",
            Self::Spider => "arthropod",
            Self::Fish => "aquatic",
            Self::Snake => "reptile",
            Self::Lizard => "reptile",
            Self::Dinosaur => "reptile",
            Self::Dragon => "reptile",
            Self::Machine => "mechanical_other",
            Self::Prop => "mechanical_other",
            Self::Fixture => "mechanical_other",
        }
    }

    /// A creature of this plan, with as much detail as `triangles` can show.
    pub(crate) fn body(self, dice: &mut Dice, triangles: u32) -> Body {
        match self {
            Self::Biped => plans::biped::body(dice, triangles),
            Self::Anime => plans::anime::body(dice, triangles),
            Self::Monster => plans::monster::body(dice, triangles),
            Self::Quadruped => plans::quadruped::body(dice, triangles),
            Self::Bird => plans::bird::body(dice, triangles),
            Self::Insect => plans::insect::body(dice, triangles),
            Self::Spider => plans::spider::body(dice, triangles),
            Self::Fish => plans::fish::body(dice, triangles),
            Self::Snake => plans::snake::body(dice, triangles),
            Self::Lizard => plans::lizard::body(dice, triangles),
            Self::Dinosaur => plans::dinosaur::body(dice, triangles),
            Self::Dragon => plans::dragon::body(dice, triangles),
            Self::Machine => plans::machine::body(dice, triangles),
            Self::Prop => plans::prop::body(dice, triangles),
            Self::Fixture => plans::fixture::body(dice, triangles),
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
