//! One module a format: from a file to [`ArrayRig`]s.

mod anymate;
mod articulation;
mod data_list;
mod npz;
mod obj;
mod puppeteer;
mod rig_text;
mod skeleton_text;
mod skintokens;
mod text;
mod unirig;

use std::ops::ControlFlow;

use super::archive::Input;
use super::array_rig::ArrayRig;
use super::fault::PeerFault;
use crate::Fault;

/// What is wanted of a file.
#[derive(Clone, Copy, Default)]
pub(crate) struct Wanted {
    /// The one asset of this number, or all.
    pub item: Option<usize>,
    /// With the arrays that make no difference to a rig.
    pub extras: bool,
}

impl Wanted {
    /// Whether an asset of this number is to be read.
    fn has(self, item: usize) -> bool {
        self.item.is_none_or(|wanted| wanted == item)
    }
}

/// Takes an asset with its number.
pub(crate) type Give<'a> = &'a mut dyn FnMut(usize, Result<ArrayRig, PeerFault>) -> ControlFlow<()>;

/// An open file of assets.
pub(crate) trait Assets {
    /// How many there are, by the file's own word.
    fn count(&self) -> usize;

    /// Hands out what is wanted, one at a time.
    ///
    /// An asset that is wrong is handed out as its fault; a file that cannot be read on is an error.
    fn each(&mut self, wanted: Wanted, give: Give<'_>) -> Result<(), PeerFault>;
}

/// A file of a single asset.
struct One(Option<ArrayRig>);

impl One {
    fn boxed<'a>(rig: ArrayRig) -> Box<dyn Assets + 'a> {
        Box::new(Self(Some(rig)))
    }
}

impl Assets for One {
    fn count(&self) -> usize {
        1
    }

    fn each(&mut self, _: Wanted, give: Give<'_>) -> Result<(), PeerFault> {
        if let Some(rig) = self.0.take() {
            let _ = give(0, Ok(rig));
        }
        Ok(())
    }
}

pub(crate) use anymate::{TorchZip, bone_parents};
pub(crate) use npz::Npz;
pub(crate) use puppeteer::Hdf5;
pub(crate) use text::{RigText, beside_obj, open_pair, starts_as_rig};

fn bytes(input: Input<'_>) -> Result<std::borrow::Cow<'_, [u8]>, Fault> {
    match input {
        Input::Bytes(bytes) => Ok(bytes.into()),
        Input::File(path) => Ok(std::fs::read(path).map_err(|e| Fault::unreadable(&e))?.into()),
    }
}
