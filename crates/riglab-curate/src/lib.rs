//! From many files of mixed quality to a clean, documented corpus.
//!
//! [`curate`] looks at every asset of a folder - repairs it, asks the configured stages whether it stays,
//! describes its shape, guesses its category - then drops duplicates, applies a person's decisions, labels
//! what is kept, and writes a corpus with its splits and a report on what became of each file.
//!
//! The one idea: **looking and keeping are apart.** A look at an asset needs nothing but the asset; its
//! result is a [`record::Record`], appended to a journal as soon as it is there. What needs all assets -
//! duplicates, decisions, splits, the funnel - works on records, which are small. So a run that was broken
//! off looks only at what is left, a changed decision costs no second look, and shards of a folder can be
//! looked at on several machines and merged ([`merge_shards`]), duplicates between them included.
//!
//! Holds: a file that cannot be read is a line of the report; each dropped asset has a stage and a sentence;
//! the same files, config and decisions give the same corpus, whatever was broken off between; memory is
//! bounded by records (about 2 kB an asset) and the assets at work.
//!
//! Leaves out: models, the page on which a person decides (it builds on [`decisions`]), other than glTF-like
//! quality: nobody looks at textures.
//!
//! Follows UniRig, section 3 (Rig-XL and VRoid): the steps are theirs; where they give no numbers,
//! `configs/curation` says which are ours.

mod categories;
mod config;
pub mod decisions;
mod duplicates;
mod error;
mod funnel;
mod journal;
mod judge;
mod label;
mod pictures;
mod pieces;
mod read;
pub mod record;
mod repair;
mod report;
mod run;
mod shape;
mod shards;
mod source;
mod stages;
mod store;
mod vlm;
mod words;

pub use categories::{Category, Guess, Traits, by_rules};
pub use config::{
    BonesConfig, CategoriesConfig, CurateConfig, DuplicatesConfig, HumanoidConfig, ImportConfig, Invalid, Labeller,
    ObjectsConfig, OutsideConfig, RepairConfig, ReportConfig, SizeConfig, SplitBy, SplitConfig, TreeConfig, VlmConfig,
    WeightsConfig,
};
pub use duplicates::{groups, pairs};
pub use error::CurateError;
pub use funnel::{Agreement, Funnel, Row, StageCount};
pub use journal::{Journal, Stamp};
pub use judge::Judgement;
pub use read::{Folder, ImportFindings, ReadAsset, ReadOutcome};
pub use repair::repair;
pub use run::{Places, Reading, Shard, Tell, curate};
pub use shape::{Shape, TOLERANCE};
pub use shards::{listed, merge_shards, nothing_left, shards};
pub use stages::StageName;
pub use vlm::{Asker, VlmReport, category_in};
