//! What FBX is, whether or not this build reads it: that takes the feature `fbx`.

use std::path::Path;

use crate::Fault;
use crate::format::Reads;
#[cfg(feature = "fbx")]
use crate::{
    ImportOptions, Reading, Rights,
    rigging::{Looks, SubjectNote, Unrigged, fbx_looks},
};

/// Autodesk FBX.
pub(crate) struct Fbx;

impl Reads for Fbx {
    fn name(&self) -> &'static str {
        "FBX"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["fbx"]
    }

    /// In binary, or as text with the comment that all exporters begin with.
    fn starts(&self, bytes: &[u8]) -> bool {
        bytes.starts_with(b"Kaydara FBX Binary") || bytes.starts_with(b"; FBX")
    }

    fn short(&self) -> Option<&'static str> {
        Some("fbx")
    }

    fn is_rig(&self, _: &Path) -> bool {
        cfg!(feature = "fbx")
    }

    #[cfg(feature = "fbx")]
    fn read(&self, bytes: &[u8], _: Option<&Path>, options: &ImportOptions) -> Result<(Reading, Rights), Fault> {
        Ok((crate::fbx::read(bytes, options.clips, options.motion.as_deref())?, Rights::default()))
    }

    #[cfg(feature = "fbx")]
    fn looks(&self, file: &Unrigged<'_>, notes: &mut Vec<SubjectNote>) -> Result<Looks, Fault> {
        fbx_looks(file, notes)
    }

    fn unread(&self) -> Fault {
        let hint = if cfg!(feature = "fbx") { "" } else { " without the feature `fbx` (build with `--features fbx`)" };
        Fault::OtherFormat { format: self.name(), hint }
    }
}
