//! The formats that are written, by name and by ending.

use std::fmt;
use std::io::Read;
use std::path::Path;
use std::str::FromStr;

use super::WriteError;
use crate::peers::starts_as_rig;

/// A format to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// glTF in one file.
    Glb,
    /// A mesh alone.
    Obj,
    /// RigNet's text, `_rig.txt`, with an OBJ.
    RigNet,
    /// Puppeteer's text with an OBJ.
    Puppeteer,
    /// Puppeteer's HDF5.
    PuppeteerH5,
    /// Articulation-XL's npz.
    ArticulationXl,
    /// UniRig's `raw_data.npz`.
    UniRig,
    /// SkinTokens' npz.
    SkinTokens,
    /// Anymate's pt.
    Anymate,
    /// Autodesk FBX 7.5, binary.
    #[cfg(feature = "fbx")]
    Fbx,
}

impl Target {
    /// All of them.
    pub const ALL: &[Self] = &[
        Self::Glb,
        Self::Obj,
        Self::RigNet,
        Self::Puppeteer,
        Self::PuppeteerH5,
        Self::ArticulationXl,
        Self::UniRig,
        Self::SkinTokens,
        Self::Anymate,
        #[cfg(feature = "fbx")]
        Self::Fbx,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Obj => "obj",
            Self::RigNet => "rignet",
            Self::Puppeteer => "puppeteer",
            Self::PuppeteerH5 => "puppeteer-h5",
            Self::ArticulationXl => "articulation-xl",
            Self::UniRig => "unirig",
            Self::SkinTokens => "skintokens",
            Self::Anymate => "anymate",
            #[cfg(feature = "fbx")]
            Self::Fbx => "fbx",
        }
    }

    pub(super) fn names() -> String {
        Self::ALL.iter().map(|t| t.name()).collect::<Vec<_>>().join(", ")
    }

    /// What a file of one asset is called: `NAME` and this.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Glb => ".glb",
            Self::Obj => ".obj",
            Self::RigNet => "_rig.txt",
            Self::Puppeteer => ".txt",
            Self::PuppeteerH5 => ".h5",
            Self::ArticulationXl | Self::UniRig | Self::SkinTokens => ".npz",
            Self::Anymate => ".pt",
            #[cfg(feature = "fbx")]
            Self::Fbx => ".fbx",
        }
    }

    /// What stands after the dot in names of its files.
    pub fn ending(self) -> &'static str {
        self.suffix().rsplit('.').next().unwrap_or_default()
    }

    /// Whether a file may hold several assets.
    pub fn holds_several(self) -> bool {
        matches!(self, Self::PuppeteerH5 | Self::ArticulationXl | Self::Anymate)
    }

    /// Whether a file that is there is one of the format, or the mesh beside one, and nothing else by that name.
    pub fn is_at(self, path: &Path) -> bool {
        let mut start = Vec::new();
        // Comments of an OBJ may be long.
        let read = std::fs::File::open(path).and_then(|file| file.take(1 << 20).read_to_end(&mut start));
        let vertex = |line: &[u8]| matches!(line.trim_ascii_start(), [b'v', b' ' | b'\t', ..]);
        let obj = |start: &[u8]| start.split(|b| *b == b'\n').any(vertex);
        let text = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("txt"));
        read.is_ok()
            && match self {
                Self::Glb => start.starts_with(b"glTF"),
                Self::RigNet | Self::Puppeteer if text => starts_as_rig(path),
                Self::Obj | Self::RigNet | Self::Puppeteer => obj(&start),
                Self::PuppeteerH5 => start.starts_with(b"\x89HDF\r\n\x1a\n"),
                Self::ArticulationXl | Self::UniRig | Self::SkinTokens | Self::Anymate => start.starts_with(b"PK"),
                #[cfg(feature = "fbx")]
                Self::Fbx => start.starts_with(b"Kaydara FBX Binary") || start.starts_with(b"; FBX"),
            }
    }

    /// The format that a file's name tells.
    ///
    /// # Errors
    /// [`WriteError::WhichFormat`] for npz and txt, which three and two formats have, unless the whole
    /// name tells, and for unknown endings.
    pub fn of(path: &Path) -> Result<Self, WriteError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        if name == "raw_data.npz" {
            return Ok(Self::UniRig);
        }
        if name.ends_with(Self::RigNet.suffix()) {
            return Ok(Self::RigNet);
        }
        // A VRM is a GLB with extensions, which come along from a VRM.
        if name.ends_with(".vrm") {
            return Ok(Self::Glb);
        }
        let clear = [
            Self::Glb,
            Self::Obj,
            Self::PuppeteerH5,
            Self::Anymate,
            #[cfg(feature = "fbx")]
            Self::Fbx,
        ];
        let found = clear.into_iter().find(|t| name.ends_with(t.suffix()));
        found.ok_or_else(|| WriteError::WhichFormat(path.display().to_string()))
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Target {
    type Err = WriteError;

    fn from_str(name: &str) -> Result<Self, WriteError> {
        Self::ALL.iter().copied().find(|t| t.name() == name).ok_or_else(|| WriteError::NoFormat(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_none_of_the_format_is_known() {
        let dir = tempfile::tempdir().unwrap();
        for &target in Target::ALL {
            let path = dir.path().join(format!("a{}", target.suffix()));
            for other in ["my notes\n", "task = \"fsq_cvae\"\n", "very = 1\n", "\u{1}\u{2}"] {
                std::fs::write(&path, other).unwrap();
                assert!(!target.is_at(&path), "{target}: {other}");
            }
        }
        let obj = dir.path().join("a.obj");
        std::fs::write(&obj, "# a comment\no body\nv 0 0 0\n").unwrap();
        assert!(Target::Obj.is_at(&obj) && Target::RigNet.is_at(&obj) && !Target::Glb.is_at(&obj));
    }

    #[test]
    fn names_and_endings_tell_the_format() {
        for &target in Target::ALL {
            assert_eq!(target.name().parse::<Target>().unwrap(), target);
        }
        for (path, target) in [
            ("a/B.GLB", Target::Glb),
            ("a.vrm", Target::Glb),
            ("raw_data.npz", Target::UniRig),
            ("7_rig.txt", Target::RigNet),
        ] {
            assert_eq!(Target::of(Path::new(path)).unwrap(), target);
        }
        for path in ["a.npz", "a.txt", "a", "a.blend"] {
            assert!(Target::of(Path::new(path)).unwrap_err().to_string().contains("articulation-xl, unirig"), "{path}");
        }
    }
}
