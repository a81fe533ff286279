//! What can go wrong with a network.

use std::path::PathBuf;

use thiserror::Error;

/// Why a network, its weights or an optimizer step cannot be.
#[derive(Debug, Error)]
pub enum NnError {
    /// Two parameters of one name: a fault of the network's code.
    #[error("two parameters are named `{0}`")]
    DuplicateName(String),
    /// Weights of another network.
    #[error("{count} of the network's {tensors} tensors do not fit: {first}{}", if *count > 3 { ", ..." } else { "" })]
    Mismatch {
        /// How many faults.
        count: usize,
        /// Tensors of the network.
        tensors: usize,
        /// The first few, in words.
        first: String,
    },
    /// Sizes that no network can have.
    #[error("{0}")]
    Config(String),
    /// More than the machine can hold.
    #[error(
        "the network has {:.1} thousand million parameters, {:.0} GB, and this machine has {memory_gb:.0} GB of memory: \
         make it smaller (model.*)",
        *parameters as f64 / 1e9, *parameters as f64 * 4e-9
    )]
    TooLarge {
        /// Numbers in all its tensors; an end of what can be counted.
        parameters: u128,
        /// What there is.
        memory_gb: f64,
    },
    /// A tensor file that cannot be read.
    #[error("{path}: {message}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// libtorch refused.
    #[error(transparent)]
    Torch(#[from] riglab_torch::TorchError),
}
