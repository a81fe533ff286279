//! How skeletons become tokens.

use serde::{Deserialize, Serialize};

use crate::Rule;

/// Ready-made configurations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Unbiased cells, siblings in a fixed order, every skeleton told apart.
    #[default]
    Riglab,
    /// UniRig's paper.
    Paper,
    /// UniRig's release, classes of its Articulation-XL model.
    UnirigReleased,
    /// SkinTokens' release: no templates.
    SkintokensReleased,
}

/// In which order siblings stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Siblings {
    /// As the skeleton has its joints; no joint changes its place but for templates.
    AsGiven,
    /// Depth first, siblings by (y, z, x): from low to high where y is up.
    YUp,
    /// Depth first, siblings by (z, y, x): UniRig's paper, in its axes.
    ZUp,
    /// Depth first, siblings by (z, x, y), in the axes as given: an option of SkinTokens' release, which then writes
    /// neither parts nor springs.
    Zxy,
}

/// When a `spring` token tells that what follows is no part of a template.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spring {
    /// Never.
    Never,
    /// Before the joints that follow a template's parts.
    AfterParts,
    /// So, and at the start of a skeleton with a class but no part.
    WithClass,
    /// So, and at the start of every skeleton without a part.
    Always,
}

/// Which class tokens there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Classes {
    /// A class is as given.
    AsGiven,
    /// A class with a template is written only where a part of the template is; one is found by the joints'
    /// names where none is given.
    ByParts,
}

/// What becomes of a branch whose parent stands where no joint is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Merge {
    /// It hangs on the nearest joint before it.
    Nearest,
    /// It hangs on the nearest joint before it within this distance; else the sequence is refused.
    Within(f32),
}

/// How skeletons become tokens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TokenizerConfig {
    /// Cells of a coordinate.
    pub bins: u16,
    /// Least and greatest coordinate.
    pub range: [f32; 2],
    /// How coordinates become cells.
    pub rule: Rule,
    /// Names of parts that have a token.
    pub parts: Vec<String>,
    /// Whether the tokens of parts are one template's own (`mixamo:body`).
    pub own_parts: bool,
    /// Classes that have a token.
    pub classes: Vec<String>,
    /// When a class is written.
    pub class: Classes,
    /// Whether joints of a template come first, in the template's order.
    pub templates: bool,
    /// Whether a joint of a template's part that hangs where the template has it is written without its
    /// parent: what everyone knows needs no token.
    pub known_parents: bool,
    /// When `spring` is written.
    pub spring: Spring,
    /// The order of siblings.
    pub siblings: Siblings,
    /// Whether a joint moves to a free cell where its own would give another tree.
    pub distinct: bool,
    /// How parents are found again.
    pub merge: Merge,
    /// Whether odd sequences are read as the released decoders read them, instead of being refused.
    pub lenient: bool,
    /// Fewest joints of a skeleton that is read.
    pub least_joints: usize,
}

impl Default for TokenizerConfig {
    fn default() -> Self {
        Preset::Riglab.config()
    }
}

impl Preset {
    /// The preset, spelled out.
    pub fn config(self) -> TokenizerConfig {
        let names = |all: &[&str]| all.iter().map(|s| (*s).to_owned()).collect();
        let riglab = TokenizerConfig {
            bins: 256,
            range: [-1.0, 1.0],
            rule: Rule::Centre,
            parts: names(&["body", "hand"]),
            own_parts: false,
            classes: names(&["vroid", "mixamo"]),
            class: Classes::ByParts,
            templates: true,
            known_parents: true,
            spring: Spring::AfterParts,
            siblings: Siblings::YUp,
            distinct: true,
            merge: Merge::Nearest,
            lenient: false,
            least_joints: 1,
        };
        match self {
            Self::Riglab => riglab,
            Self::Paper => TokenizerConfig {
                rule: Rule::Floor,
                own_parts: true,
                classes: names(&["vroid", "mixamo", "rig-xl"]),
                class: Classes::AsGiven,
                known_parents: false,
                siblings: Siblings::ZUp,
                distinct: false,
                // A cell and a half: what rounding may set apart, and no more.
                merge: Merge::Within(3.0 / 256.0),
                ..riglab
            },
            Self::UnirigReleased => TokenizerConfig {
                rule: Rule::RoundF32,
                classes: names(&["vroid", "mixamo", "articulationxl"]),
                class: Classes::AsGiven,
                known_parents: false,
                spring: Spring::Always,
                siblings: Siblings::AsGiven,
                distinct: false,
                lenient: true,
                least_joints: 2,
                ..riglab
            },
            Self::SkintokensReleased => TokenizerConfig {
                rule: Rule::RoundF64,
                classes: names(&["rignet", "vroid", "articulation"]),
                class: Classes::AsGiven,
                templates: false,
                known_parents: false,
                spring: Spring::Never,
                siblings: Siblings::AsGiven,
                distinct: false,
                lenient: true,
                ..riglab
            },
        }
    }
}
