//! Rigs that other systems wrote, scored against true ones.
//!
//! The one idea: **every true asset gets a row, whatever was predicted.** Predictions are found by name
//! ([`Predictions`]), brought into the truth's coordinates and onto its vertices and joints ([`fit()`]), and scored
//! under all presets of `riglab-metric`; an asset without a prediction, with a broken one or with one of another mesh
//! is a row with the reason ([`Row`], [`Status`]). [`Comparison`] makes tables of them.
//!
//! Holds: nothing is dropped silently: means stand beside the number of assets they are of, those that failed and
//! those where a figure is undefined; what was moved, scaled or matched by position is told in a note.
//!
//! Leaves out: models; how predictions came about.

mod corpora;
mod error;
mod figures;
mod fit;
mod keys;
mod predictions;
mod rows;
mod several;
mod tables;
mod truths;
mod unit;

pub use error::CompareError;
pub use fit::{Fitted, fit};
pub use keys::{key, pairs};
pub use predictions::{Kind, Prediction, Predictions};
pub use rows::{Failures, Row, Status, System, Unread, score};
pub use tables::{Comparison, Summary};
pub use truths::{Named, TruthSource, Truths};
