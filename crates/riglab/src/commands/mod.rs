//! One module a command.

pub mod checkpoint;
pub mod compare;
pub mod convert;
pub mod curate;
pub mod dataset;
pub mod doctor;
pub mod eval;
mod glb;
pub mod inspect;
pub mod report;
pub mod review;
pub mod rig;
pub mod simulate;
pub mod slurm;
pub mod strip;
pub mod sweep;
pub mod synth;
pub mod tokens;
pub mod train;
pub mod view;
