//! The tasks: the only place where data, network, loss and evaluation meet.
//!
//! A task is one module; adding one touches that module and the registry of the command line.
//!
//! Leaves out: file formats, the training loop.

pub mod assets;
pub mod bundle;
mod experiment;
pub mod fsq_cvae;
pub mod grpo;
pub mod released;
pub mod seen;
mod sequences;
pub mod settings;
pub mod start;
pub mod tokenrig;
pub mod unirig_skeleton;
pub mod unirig_skin;
mod up;

pub use experiment::{Examined, Experiment};
