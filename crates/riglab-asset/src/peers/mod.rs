//! The formats of other research code: RigNet's and Puppeteer's texts, Articulation-XL, UniRig,
//! SkinTokens, Puppeteer's HDF5, Anymate.
//!
//! Read in this order: what all of them come down to ([`array_rig`], [`fault`]), the containers they
//! lie in ([`archive`], [`npy`], [`pickle`]; arrays as stored are [`numbers`]), a module a format
//! ([`read`]), and what makes a [`crate::Reading`] of it ([`reading`], by the rules of [`fields`]).
//!
//! The way back is a module a format, too ([`mod@write`]). Trained weights come by the same containers ([`tensors`]).
//!
//! Nothing a file says is executed; what it makes its reader hold is claimed from a [`budget`] first.

mod archive;
mod array_rig;
mod budget;
mod doubts;
mod fault;
mod fields;
mod import;
mod npy;
mod numbers;
mod pickle;
mod read;
mod reading;
mod repair;
mod tensors;
mod torch;
mod write;
mod zip_claims;

pub(crate) use archive::Input;
pub use array_rig::{Array, ArrayRig, SparseRows, Up};
pub use fault::PeerFault;
pub(crate) use fault::shown;
pub(crate) use import::{Source, count, each, one, read_arrays};
pub(crate) use read::{Assets, Hdf5, Npz, RigText, TorchZip, beside_obj, open_pair, starts_as_rig};
pub use tensors::{StoredKind, StoredTensor, TensorFile};
pub use write::{Filling, Target, WriteError, WriteNote, write, write_mesh, written_paths};
