//! Formats that are written by modules of their own: what riglab asks of them.

use std::fs::File;
use std::io::Read;
#[cfg(feature = "fbx")]
use std::io::{Seek, SeekFrom};
use std::path::Path;

use riglab_core::Asset;

use super::target::{Writes, Written};
use super::{WriteError, WriteNote, text};
#[cfg(feature = "fbx")]
use crate::export::{self, ExportOptions, Influences};

/// glTF in one file. A VRM is a GLB with extensions, which come along from a VRM.
pub(super) struct Glb;

impl Writes for Glb {
    fn name(&self) -> &'static str {
        "glb"
    }

    fn suffix(&self) -> &'static str {
        ".glb"
    }

    fn is_told_by(&self, name: &str) -> bool {
        name.ends_with(".glb") || name.ends_with(".vrm")
    }

    fn holds_scenes(&self) -> bool {
        true
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        start.starts_with(b"glTF")
    }

    fn is_own(&self, path: &Path, _: &[u8]) -> bool {
        crate::gltf::is_own(path)
    }

    /// It is as long as it says.
    fn is_whole(&self, path: &Path) -> bool {
        let mut head = [0; 12];
        let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
        let told = u32::from_le_bytes([head[8], head[9], head[10], head[11]]);
        read.is_ok() && path.metadata().is_ok_and(|meta| meta.len() == u64::from(told))
    }

    fn made_of(&self, path: &Path) -> Option<String> {
        crate::gltf::made_of(path)
    }

    fn files(&self, assets: &[Asset], _: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        Ok(assets.iter().flat_map(crate::to_glb).collect::<Vec<u8>>().into())
    }
}

/// A mesh alone.
pub(super) struct Obj;

impl Writes for Obj {
    fn name(&self) -> &'static str {
        "obj"
    }

    fn suffix(&self) -> &'static str {
        ".obj"
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        text::is_obj(start)
    }

    fn is_own(&self, _: &Path, start: &[u8]) -> bool {
        text::is_own_obj(start)
    }

    fn files(&self, assets: &[Asset], notes: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        notes.push(WriteNote::Lacks("an OBJ holds the mesh alone: skeleton and weights are not in it"));
        Ok(text::objs(assets).into())
    }
}

/// Autodesk FBX 7.4, binary.
#[cfg(feature = "fbx")]
pub(super) struct Fbx;

#[cfg(feature = "fbx")]
impl Writes for Fbx {
    fn name(&self) -> &'static str {
        "fbx"
    }

    fn suffix(&self) -> &'static str {
        ".fbx"
    }

    fn holds_scenes(&self) -> bool {
        true
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        start.starts_with(b"Kaydara FBX Binary") || start.starts_with(b"; FBX")
    }

    /// A node's name, the kind of its value, and four bytes of length stand before the value.
    fn is_own(&self, _: &Path, start: &[u8]) -> bool {
        const CREATOR: &[u8] = b"CreatorS";
        let start = &start[..start.len().min(1 << 12)];
        let mut named = start.windows(CREATOR.len()).enumerate().filter(|(_, word)| *word == CREATOR);
        named.any(|(at, word)| start.get(at + word.len() + 4..).is_some_and(crate::maker::is_maker))
    }

    fn is_whole(&self, path: &Path) -> bool {
        let mut end = [0; crate::fbx::END.len()];
        let read = File::open(path).and_then(|mut file| {
            file.seek(SeekFrom::End(-(end.len() as i64)))?;
            file.read_exact(&mut end)
        });
        read.is_ok() && end == crate::fbx::END
    }

    fn made_of(&self, path: &Path) -> Option<String> {
        let mut start = Vec::new();
        File::open(path).and_then(|file| file.take(1 << 12).read_to_end(&mut start)).ok()?;
        crate::fbx::made_of(&start)
    }

    fn files(&self, assets: &[Asset], _: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        let asset = &assets[0];
        let cannot = |reason| WriteError::Cannot { asset: asset.name.clone(), format: super::Target::FBX, reason };
        let options = ExportOptions { influences: Influences::All, ..ExportOptions::default() };
        let glb = export::moving(asset, &options).map_err(|e| cannot(e.fault.to_string()))?;
        Ok(crate::glb_to_fbx(&glb.bytes).map_err(|e| cannot(e.to_string()))?.bytes.into())
    }
}
