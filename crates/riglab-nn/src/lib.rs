//! Networks, layers and optimizers on libtorch.
//!
//! The one idea: a network is a tree of layers that know their parameters by number
//! ([`params::ParamId`]); what it computes with is handed in ([`params::Weights`]). Master weights,
//! their bfloat16 copy and their moving average are all just weights.
//!
//! Names of parameters are those of the released checkpoints, so that weights can be exchanged.
//! Shapes are written as suffixes where more than two axes meet: b batch, t and s tokens, n points,
//! d width.
//!
//! Configs are checked by their `validate` before a network is built; forward passes assume them.
//!
//! Leaves out: rigs, files of training data, the training loop.

pub mod decoder;
pub mod embed;
mod error;
pub mod fsq;
pub mod fsq_cvae;
pub mod generate;
pub mod grpo;
pub mod io;
pub mod layers;
pub mod loss;
pub mod optim;
pub mod params;
pub mod perceiver;
pub mod simulate;
pub mod skeleton;
pub mod skin_stage;
pub mod tokenrig;

pub use error::NnError;
