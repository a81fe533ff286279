//! Corpora of rigs in HDF5, and how they are split.
//!
//! The one idea: **packed arrays**. A corpus is one file with one dataset per field over all assets
//! (all vertices of all assets in one table, and so on) and offsets that say where each asset
//! begins. Opening costs a few reads whatever the number of assets, and one asset a few more. The
//! fields are described in [`schema`].
//!
//! Holds: a corpus is written under a temporary name and renamed when it is complete; what is read
//! back is a valid [`riglab_core::Asset`] or an error; [`Corpus::verify`] compares every asset with
//! the digest it was written with.
//!
//! Leaves out: models, augmentation, curation.

mod beside;
mod claims;
mod copies;
mod error;
mod import;
mod manifest;
mod merge;
mod mixture;
mod reader;
mod rewrite;
mod room;
pub mod schema;
mod split;
mod stats;
mod tally;
mod words;
mod writer;

pub use beside::{checksums, whole_checksum};
pub use copies::told as copies_told;
pub use error::DataError;
pub use import::{
    ImportReport, Refused, import_folder, import_meshes, models_below, name_below, rigged_below, rigged_files,
};
pub use manifest::Manifest;
pub use merge::{Member, MergeReport, Repeated, merge};
pub use mixture::Mixture;
pub use reader::{Corpus, Fault};
pub use rewrite::{Place, rewrite, same};
pub use riglab_asset::LONE_JOINT;
pub use split::{SplitNames, Splitter};
pub use stats::{Stats, stats};
pub use tally::{OpenFile, Tally};
pub use writer::CorpusWriter;

/// The version of the HDF5 library that is linked.
pub fn hdf5_version() -> String {
    let (major, minor, patch) = hdf5::library_version();
    format!("{major}.{minor}.{patch}")
}
