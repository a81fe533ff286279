//! The zip archives that torch writes.

use super::archive::{Archive, Input};
use super::fault::PeerFault;

/// An archive of torch: a pickle, and beside it the bytes of what the pickle's tensors lie in.
pub(crate) struct TorchArchive<'a> {
    pub archive: Archive<'a>,
    /// The archive's own folder, which all members lie in.
    folder: String,
    /// Most significant byte first.
    pub big: bool,
}

impl<'a> TorchArchive<'a> {
    pub(crate) fn open(input: Input<'a>) -> Result<Self, PeerFault> {
        let mut start = [0; 2];
        let zipped = input.open().is_ok_and(|mut file| file.read_exact(&mut start).is_ok()) && start == *b"PK";
        if !zipped {
            return Err(PeerFault::LegacyTorch);
        }
        let mut archive = Archive::open(input)?;
        let pickled = archive.members().find(|name| name.ends_with("/data.pkl")).map(str::to_owned);
        let pickled = pickled.ok_or_else(|| PeerFault::UnknownMembers(archive.listed()))?;
        let folder = pickled.trim_end_matches("data.pkl").to_owned();
        let order = format!("{folder}byteorder");
        let big = archive.members().any(|name| name == order) && archive.bytes(&order)?.starts_with(b"big");
        Ok(Self { archive, folder, big })
    }

    /// The bytes of the pickle.
    pub(crate) fn pickle(&mut self) -> Result<Vec<u8>, PeerFault> {
        self.archive.bytes(&format!("{}data.pkl", self.folder))
    }

    /// The bytes of a storage.
    pub(crate) fn storage(&mut self, key: &str) -> Result<Vec<u8>, PeerFault> {
        self.archive.bytes(&format!("{}data/{key}", self.folder))
    }
}
