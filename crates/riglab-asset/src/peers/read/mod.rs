//! One module a format: from a file to [`ArrayRig`]s.

mod anymate;
mod articulation;
mod data_list;
mod obj;
mod puppeteer;
mod rig_text;
mod skeleton_text;
mod skintokens;
mod text;
mod unirig;

use std::ops::ControlFlow;
use std::path::Path;

use super::archive::{Archive, Input};
use super::array_rig::ArrayRig;
use super::fault::PeerFault;
use crate::marked::unmarked;
use crate::{Fault, Format};

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

/// Opens a file of a peer's format; `folder` is where the other half of a pair is looked for, if at all.
pub(crate) fn open<'a>(
    format: Format,
    path: &Path,
    input: Input<'a>,
    folder: Option<&'a Path>,
    extras: bool,
) -> Result<Box<dyn Assets + 'a>, Fault> {
    let one = |rig| Box::new(One(Some(rig))) as Box<dyn Assets + 'a>;
    Ok(match format {
        Format::Npz => open_npz(Archive::open(input)?, extras)?,
        Format::TorchZip => Box::new(anymate::open(input)?),
        Format::Hdf5 => Box::new(puppeteer::open(input)?),
        Format::Obj => one(text::with_obj(path, &bytes(input)?, folder)?),
        _ => {
            let bytes = bytes(input)?;
            let list = folder.and_then(|folder| data_list::open(std::str::from_utf8(unmarked(&bytes)).ok()?, folder));
            match list {
                Some(list) => Box::new(list),
                None => one(text::read(path, &bytes, folder)?),
            }
        }
    })
}

pub(crate) use anymate::bone_parents;
/// Which files are two halves of a rig.
pub(crate) use text::{beside_obj, mesh_of, starts_as_rig};

fn open_npz<'a>(mut archive: Archive<'a>, extras: bool) -> Result<Box<dyn Assets + 'a>, PeerFault> {
    if archive.has("arr_0") {
        return Ok(Box::new(articulation::open(archive)?));
    }
    let own = ["mesh_names", "joint_names", "lengths", "matrix_world", "armature_name"];
    let rig = if own.iter().any(|f| archive.has(f)) {
        skintokens::read(&mut archive, extras)?
    } else if archive.has("vertices") || archive.has("joints") {
        unirig::read(&mut archive, extras)?
    } else {
        return Err(PeerFault::UnknownMembers(archive.listed()));
    };
    Ok(Box::new(One(Some(rig))))
}

fn bytes(input: Input<'_>) -> Result<std::borrow::Cow<'_, [u8]>, Fault> {
    match input {
        Input::Bytes(bytes) => Ok(bytes.into()),
        Input::File(path) => Ok(std::fs::read(path).map_err(|e| Fault::Unreadable(e.to_string()))?.into()),
    }
}
