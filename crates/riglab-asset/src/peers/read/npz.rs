//! Archives of numpy: Articulation-XL's, UniRig's and SkinTokens', told apart by their members.

use super::super::archive::Archive;
use super::super::fault::PeerFault;
use super::{Assets, One, articulation, skintokens, unirig};
use crate::Fault;
use crate::format::Reads;
use crate::peers::Source;

/// Arrays of numpy.
pub(crate) struct Npz;

impl Reads for Npz {
    fn name(&self) -> &'static str {
        "npz"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["npz"]
    }

    fn has_models(&self) -> bool {
        false
    }

    fn short(&self) -> Option<&'static str> {
        Some("npz")
    }

    fn open<'a>(&self, file: &Source<'a>, extras: bool) -> Result<Box<dyn Assets + 'a>, Fault> {
        Ok(open(Archive::open(file.input)?, extras)?)
    }
}

fn open<'a>(mut archive: Archive<'a>, extras: bool) -> Result<Box<dyn Assets + 'a>, PeerFault> {
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
    Ok(One::boxed(rig))
}
