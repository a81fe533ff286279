//! Which format a file has: by its first bytes, and by its ending where those say nothing.

use std::fmt;
use std::path::Path;

use crate::Fault;
use crate::marked::unmarked;

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// glTF 2.0 as JSON or GLB; VRM is a GLB.
    Gltf,
    /// Autodesk FBX.
    Fbx,
    /// Wavefront OBJ.
    Obj,
    /// Polygons of scanners, or points alone.
    Ply,
    /// Triangles for printing.
    Stl,
    /// Text of joints and weights (RigNet, Puppeteer), or a list of folders (UniRig).
    RigText,
    /// Arrays of numpy (Articulation-XL, UniRig, SkinTokens).
    Npz,
    /// HDF5 (Puppeteer).
    Hdf5,
    /// What torch saves (Anymate).
    TorchZip,
}

impl Format {
    /// The format of a file of this name that starts with these bytes.
    ///
    /// # Errors
    /// [`Fault::Empty`], or [`Fault::NotAModel`] with what the file seems to be instead.
    pub fn of(path: &Path, bytes: &[u8]) -> Result<Self, Fault> {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        if bytes.is_empty() {
            return Err(Fault::Empty);
        }
        if bytes.starts_with(b"glTF") {
            return Ok(Self::Gltf);
        }
        // In binary, or as text with the comment that all exporters begin with.
        if bytes.starts_with(b"Kaydara FBX Binary") || bytes.starts_with(b"; FBX") || ending == "fbx" {
            return Ok(Self::Fbx);
        }
        let text = unmarked(bytes);
        if text.starts_with(b"ply\n") || text.starts_with(b"ply\r") {
            return Ok(Self::Ply);
        }
        if bytes.starts_with(b"\x89HDF\r\n\x1a\n") {
            return Ok(Self::Hdf5);
        }
        match ending.as_str() {
            "obj" => return Ok(Self::Obj),
            "ply" => return Ok(Self::Ply),
            "stl" => return Ok(Self::Stl),
            "txt" => return Ok(Self::RigText),
            "npz" => return Ok(Self::Npz),
            "h5" | "hdf5" => return Ok(Self::Hdf5),
            "pt" | "pth" => return Ok(Self::TorchZip),
            _ => {}
        }
        if crate::gltf::looks_like_json(bytes) {
            return Ok(Self::Gltf);
        }
        Err(Fault::NotAModel(guess(bytes)))
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Gltf => "glTF",
            Self::Fbx => "FBX",
            Self::Obj => "OBJ",
            Self::Ply => "PLY",
            Self::Stl => "STL",
            Self::RigText => "rig text",
            Self::Npz => "npz",
            Self::Hdf5 => "HDF5",
            Self::TorchZip => "torch",
        })
    }
}

/// What else people give to importers.
fn guess(bytes: &[u8]) -> &'static str {
    const MAGICS: [(&[u8], &str); 7] = [
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"\x1f\x8b", "a gzip archive"),
        (b"BLENDER", "a Blender file"),
        (b"version https://git-lfs", "a Git LFS pointer; fetch the file itself"),
        (b"<", "a web page or XML"),
    ];
    MAGICS.iter().find(|(magic, _)| bytes.starts_with(magic)).map_or("something else", |(_, name)| name)
}
