//! Python's pickles, as far as they hold data: read without running anything.
//!
//! A pickle is a program for a small stack machine. This one knows the instructions that build
//! numbers, text, lists and dictionaries; calls build arrays of numpy, tensors of torch and ordered
//! dictionaries out of a list of seven names, and every other name is refused with its text.
//! What it may hold is counted before it is allocated.
//!
//! Checkpoints hold tensors among objects of any class: [`read_tensors`] reads those over, whatever their
//! names, and never makes them.
//!
//! A data set is one list of dictionaries, possibly larger than memory. [`read`] hands out
//! each member of the first list as soon as it is complete and lets it go.

mod beyond;
mod calls;
mod input;
mod machine;
mod members;
mod nodes;

pub(crate) use machine::{read, read_tensors};
pub(crate) use nodes::{Id, Node, Tensor, View};

#[cfg(test)]
mod tests;
