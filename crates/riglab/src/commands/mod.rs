//! One module a command.

pub mod eval;
pub mod train;
