//! The formats that are read: what riglab asks of one ([`Reads`]), and the list of all ([`Format::ALL`]).
//!
//! Whoever adds a format implements [`Reads`] in a module of its own and adds a line to the list.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::peers::{self, Assets, Source};
use crate::rigging::{Looks, SubjectNote, Unrigged};
use crate::{Fault, ImportOptions, Reading, Rights};

/// All that riglab asks of a format that it reads.
///
/// A format of *surfaces* gives a [`Reading`] of its bytes, and its looks where a rig is to be attached to the model. A format
/// of *arrays*, as data sets have, is opened and hands out its assets one by one. OBJ is both: beside a rig text it is
/// the mesh of that.
pub(crate) trait Reads: Sync {
    /// What it is called in sentences.
    fn name(&self) -> &'static str;

    /// How names of its files end, in lower case.
    fn endings(&self) -> &'static [&'static str];

    /// Whether it begins with these bytes, as no other does.
    fn starts(&self, _bytes: &[u8]) -> bool {
        false
    }

    /// Whether a file with one of its endings is one where no format's bytes tell.
    fn ending_tells(&self) -> bool {
        true
    }

    /// Whether it may begin with these bytes, where neither bytes nor ending told.
    fn may_start(&self, _bytes: &[u8]) -> bool {
        false
    }

    /// Whether its files hold models to be rigged, as surfaces do; else it is one of arrays.
    fn has_models(&self) -> bool {
        true
    }

    /// How commands call it where they choose among formats of rigs; `None` for one that has none.
    fn short(&self) -> Option<&'static str> {
        None
    }

    /// Whether a file with one of its endings, found in a folder, is to be imported as a rig.
    fn is_rig(&self, _path: &Path) -> bool {
        !self.has_models()
    }

    /// What else is read with a file.
    fn beside(&self, _path: &Path, _folder: &Path) -> Vec<PathBuf> {
        Vec::new()
    }

    /// The files that a list of them names.
    fn listed(&self, _path: &Path, _folder: &Path) -> Vec<PathBuf> {
        Vec::new()
    }

    /// Whether a file may hold several assets, and says how many.
    fn holds_several(&self) -> bool {
        !self.has_models()
    }

    /// Whether the file at `path` is read as arrays; `folder` is where what belongs to it is looked for, if at all.
    fn in_arrays(&self, _path: &Path, _folder: Option<&Path>) -> bool {
        !self.has_models()
    }

    /// Opens a file of arrays, with those that make no difference to a rig (`extras`) if they are asked for.
    fn open<'a>(&self, _file: &Source<'a>, _extras: bool) -> Result<Box<dyn Assets + 'a>, Fault> {
        Err(self.unread())
    }

    /// Reads a file of surfaces; `folder` is where what belongs to it is looked for, if at all.
    fn read(&self, _: &[u8], _folder: Option<&Path>, _: &ImportOptions) -> Result<(Reading, Rights), Fault> {
        Err(self.unread())
    }

    /// Reads a model of surfaces with its looks, to become a document. A glTF is one.
    fn looks(&self, _file: &Unrigged<'_>, _notes: &mut Vec<SubjectNote>) -> Result<Looks, Fault> {
        Err(self.unread())
    }

    /// That it is known, but not read in this way.
    fn unread(&self) -> Fault {
        Fault::OtherFormat { format: self.name(), hint: "" }
    }
}

/// A format that is read.
#[derive(Clone, Copy)]
pub struct Format(&'static dyn Reads);

impl Format {
    /// glTF 2.0 as JSON or GLB; VRM is a GLB.
    pub(crate) const GLTF: Self = Self(&crate::gltf::Gltf);

    /// All of them.
    pub const ALL: &[Self] = &[
        Self::GLTF,
        Self(&crate::fbx_format::Fbx),
        Self(&crate::obj::Obj),
        Self(&crate::ply::Ply),
        Self(&crate::stl::Stl),
        Self(&peers::RigText),
        Self(&peers::Npz),
        Self(&peers::Hdf5),
        Self(&peers::TorchZip),
    ];

    /// The format of a file of this name that starts with these bytes: by them, and by its ending where they say nothing.
    ///
    /// # Errors
    /// [`Fault::Empty`], or [`Fault::NotAModel`] with what the file seems to be instead.
    pub fn of(path: &Path, bytes: &[u8]) -> Result<Self, Fault> {
        if bytes.is_empty() {
            return Err(Fault::Empty);
        }
        // Whatever it is called: it stands where the file is to be.
        if bytes.starts_with(POINTER) {
            return Err(Fault::NotAModel(guess(bytes)));
        }
        let all = || Self::ALL.iter().copied();
        (all().find(|format| format.0.starts(bytes)))
            .or_else(|| Self::by_ending(path).filter(|format| format.0.ending_tells()))
            .or_else(|| all().find(|format| format.0.may_start(bytes)))
            .ok_or_else(|| Fault::NotAModel(guess(bytes)))
    }

    /// The format whose files are called like this one.
    pub fn by_ending(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_string_lossy().to_ascii_lowercase();
        Self::ALL.iter().copied().find(|format| format.endings().contains(&ending.as_str()))
    }

    /// How names of its files end, in lower case.
    pub fn endings(self) -> &'static [&'static str] {
        self.0.endings()
    }

    /// Whether its files hold models to be rigged.
    pub fn has_models(self) -> bool {
        self.0.has_models()
    }

    /// How commands call it where they choose among formats of rigs; `None` for one that has none.
    pub fn short(self) -> Option<&'static str> {
        self.0.short()
    }

    /// What it does.
    pub(crate) fn reads(self) -> &'static dyn Reads {
        self.0
    }
}

impl PartialEq for Format {
    fn eq(&self, other: &Self) -> bool {
        self.0.name() == other.0.name()
    }
}

impl Eq for Format {}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name())
    }
}

impl fmt::Debug for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name())
    }
}

/// How a pointer of Git LFS begins.
const POINTER: &[u8] = b"version https://git-lfs";

/// What else people give to importers.
fn guess(bytes: &[u8]) -> &'static str {
    const MAGICS: [(&[u8], &str); 11] = [
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"\x1f\x8b", "a gzip archive"),
        (b"\x28\xb5\x2f\xfd", "a Zstandard archive"),
        (b"BLENDER", "a Blender file"),
        (b"PXR-USDC", "a USD file"),
        (b"#usda", "a USD file"),
        (b"Ogawa", "an Alembic file"),
        (POINTER, "a Git LFS pointer; fetch the file itself (`git lfs pull`)"),
        (b"<", "a web page or XML"),
    ];
    let begins = |magic: &[u8]| bytes.starts_with(magic);
    let head = &bytes[..bytes.len().min(1 << 10)];
    let soon = |word: &[u8]| head.windows(word.len()).any(|at| at == word);
    // What the archives and the XML of other scenes begin with.
    if begins(b"PK\x03\x04") && first_member(bytes).is_some_and(is_usd) {
        return "a USDZ file";
    }
    if begins(b"\x28\xb5\x2f\xfd") && soon(b"BLENDER") {
        return "a Blender file";
    }
    if begins(b"<") && soon(b"<COLLADA") {
        return "a COLLADA file";
    }
    MAGICS.iter().find(|(magic, _)| begins(magic)).map_or("something else", |(_, name)| name)
}

/// The name of the first file in a ZIP archive.
fn first_member(zip: &[u8]) -> Option<&[u8]> {
    let length = zip.get(26..28)?;
    zip.get(30..)?.get(..usize::from(u16::from_le_bytes([length[0], length[1]])))
}

fn is_usd(name: &[u8]) -> bool {
    [&b".usd"[..], b".usda", b".usdc"].iter().any(|ending| name.to_ascii_lowercase().ends_with(ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_formats_share_a_name_or_an_ending() {
        let endings: Vec<_> = Format::ALL.iter().flat_map(|format| format.endings()).collect();
        let names: Vec<_> = Format::ALL.iter().map(|format| format.to_string()).collect();
        let short: Vec<_> = Format::ALL.iter().filter_map(|format| format.short()).collect();
        let unique = |of: &[String]| of.iter().collect::<std::collections::HashSet<_>>().len() == of.len();
        assert!(unique(&names));
        assert!(unique(&endings.iter().map(ToString::to_string).collect::<Vec<_>>()));
        assert!(unique(&short.iter().map(ToString::to_string).collect::<Vec<_>>()));
        assert!(endings.iter().all(|ending| **ending == ending.to_ascii_lowercase()));
    }

    #[test]
    fn bytes_tell_before_the_ending_does() {
        let of = |name: &str, bytes: &[u8]| Format::of(Path::new(name), bytes).map(|format| format.to_string());
        assert_eq!(of("a.obj", b"glTF\x02").unwrap(), "glTF");
        assert_eq!(of("a.OBJ", b"v 0 0 0\n").unwrap(), "OBJ");
        assert_eq!(of("a.txt", b"ply\nformat ascii 1.0\n").unwrap(), "PLY");
        assert_eq!(of("a.obj", b"{\"asset\": {}}").unwrap(), "OBJ");
        assert_eq!(of("a", b"\xef\xbb\xbf {\"asset\": {}}").unwrap(), "glTF");
        assert_eq!(of("a.bin", b"; FBX 7.4.0 project file\n").unwrap(), "FBX");
        // What stands in a data set's place until it is fetched.
        let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n";
        for name in ["a.pt", "a.h5", "a.npz", "a.obj", "a.fbx", "a.glb", "a.txt"] {
            assert!(
                matches!(of(name, pointer), Err(Fault::NotAModel(what)) if what.contains("git lfs pull")),
                "{name}"
            );
        }
        // A name alone makes no GLB.
        assert!(matches!(of("a.glb", b"PK\x03\x04"), Err(Fault::NotAModel("a ZIP archive"))));
        assert!(matches!(of("a.glb", b""), Err(Fault::Empty)));
    }

    #[test]
    fn scenes_of_other_programs_are_called_by_their_names() {
        let zip = |name: &str| {
            let mut bytes = b"PK\x03\x04".to_vec();
            bytes.resize(26, 0);
            bytes.extend((name.len() as u16).to_le_bytes());
            bytes.extend([0; 2]);
            [&bytes, name.as_bytes(), b"and so on"].concat()
        };
        assert_eq!([guess(&zip("hero.USDC")), guess(&zip("hero.usda"))], ["a USDZ file"; 2]);
        assert_eq!([guess(&zip("hero.txt")), guess(b"PK\x03\x04")], ["a ZIP archive"; 2]);
        let blend = b"\x28\xb5\x2f\xfd\x60\x19\x05\x1d\x07\x00\x34\x0bBLENDER17-01v0500";
        assert_eq!([guess(blend), guess(b"BLENDER-v300")], ["a Blender file"; 2]);
        assert_eq!(guess(&blend[..12]), "a Zstandard archive");
        assert_eq!([guess(b"PXR-USDC\0\x08"), guess(b"#usda 1.0\n")], ["a USD file"; 2]);
        assert_eq!(guess(b"Ogawa\xff\0\x01"), "an Alembic file");
        assert_eq!(guess(b"<?xml version=\"1.0\"?>\n<COLLADA xmlns=\"\">"), "a COLLADA file");
        assert_eq!(guess(b"<html><body>"), "a web page or XML");
    }
}
