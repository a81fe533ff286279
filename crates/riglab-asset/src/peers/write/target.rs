//! The formats that are written: what riglab asks of one ([`Writes`]), and the list of all ([`Target::ALL`]).

use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use riglab_core::{Asset, Bounds, Rig, Similarity};

use super::filling::Begin;
use super::{WriteError, WriteNote};

/// All that riglab asks of a format that it writes. Whoever adds one implements this in a module of its own and adds a line
/// to the list.
pub(crate) trait Writes: Sync {
    /// Its name on the command line.
    fn name(&self) -> &'static str;

    /// What a file of one asset is called: `NAME` and this, in lower case.
    fn suffix(&self) -> &'static str;

    /// Whether a file's name, in lower case, tells this format from all others.
    fn is_told_by(&self, name: &str) -> bool {
        name.ends_with(self.suffix())
    }

    /// How a file is begun that holds as many assets as are added; `None` of a format of one asset a file, which gives
    /// [`Self::files`].
    fn filled(&self) -> Option<Begin> {
        None
    }

    /// Whether a file holds more than rigs: motions, meshes without a skeleton, and looks.
    fn holds_scenes(&self) -> bool {
        false
    }

    /// Why the format has no form for an asset, where it has none.
    fn lacks(&self, _rig: &Rig) -> Option<String> {
        None
    }

    /// Half a side of the cube about the origin that the format's own loaders expect vertices and joints in.
    fn half_cube(&self) -> Option<f32> {
        None
    }

    /// Whether the file at `path`, which starts with `start`, is one of the format, or one that is written beside one.
    fn is_at(&self, path: &Path, start: &[u8]) -> bool;

    /// Whether such a file, of the format, says that riglab wrote it ([`crate::maker`]).
    fn is_own(&self, path: &Path, start: &[u8]) -> bool;

    /// Whether such a file has an end; of formats that say nothing of it, any has.
    fn is_whole(&self, _path: &Path) -> bool {
        true
    }

    /// The file that such a one says it was made of ([`crate::export::made_of`]).
    fn made_of(&self, _path: &Path) -> Option<String> {
        None
    }

    /// What is written beside a file.
    fn beside(&self, _path: &Path) -> Option<PathBuf> {
        None
    }

    /// The bytes of a file, and of the one beside it. What the format does not hold is told in `notes`.
    ///
    /// `assets` is one.
    fn files(&self, _assets: &[Asset], _notes: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        unreachable!("files of several assets are filled")
    }
}

/// Share of a cube that coordinates may lie beyond it by rounding.
const ROUNDING: f32 = 1e-3;

/// What a file becomes.
pub(crate) struct Written {
    /// Its bytes.
    pub file: Vec<u8>,
    /// Those of the file beside it.
    pub beside: Option<Vec<u8>>,
}

impl From<Vec<u8>> for Written {
    fn from(file: Vec<u8>) -> Self {
        Self { file, beside: None }
    }
}

/// A format to write.
#[derive(Clone, Copy)]
pub struct Target(&'static dyn Writes);

impl Target {
    /// glTF in one file.
    pub const GLB: Self = Self(&super::plain::Glb);
    /// A mesh alone.
    pub const OBJ: Self = Self(&super::plain::Obj);
    /// RigNet's text, `_rig.txt`, with an OBJ.
    pub const RIGNET: Self = Self(&super::text::RigNet);
    /// Puppeteer's text with an OBJ.
    pub const PUPPETEER: Self = Self(&super::text::Puppeteer);
    /// Puppeteer's HDF5.
    pub const PUPPETEER_H5: Self = Self(&super::puppeteer::PuppeteerH5);
    /// Articulation-XL's npz.
    pub const ARTICULATION_XL: Self = Self(&super::articulation::ArticulationXl);
    /// UniRig's `raw_data.npz`.
    pub const UNIRIG: Self = Self(&super::unirig::UniRig);
    /// SkinTokens' npz.
    pub const SKINTOKENS: Self = Self(&super::skintokens::SkinTokens);
    /// Anymate's pt.
    pub const ANYMATE: Self = Self(&super::anymate::Anymate);
    /// Autodesk FBX 7.4, binary.
    #[cfg(feature = "fbx")]
    pub const FBX: Self = Self(&super::plain::Fbx);

    /// All of them.
    pub const ALL: &[Self] = &[
        Self::GLB,
        Self::OBJ,
        Self::RIGNET,
        Self::PUPPETEER,
        Self::PUPPETEER_H5,
        Self::ARTICULATION_XL,
        Self::UNIRIG,
        Self::SKINTOKENS,
        Self::ANYMATE,
        #[cfg(feature = "fbx")]
        Self::FBX,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        self.0.name()
    }

    pub(super) fn names() -> String {
        Self::ALL.iter().map(|t| t.name()).collect::<Vec<_>>().join(", ")
    }

    /// The names of those that a file may be by its ending; of all where it is none's.
    pub(super) fn names_of(file: &str) -> String {
        let ending = Path::new(file).extension().unwrap_or_default();
        let fits = Self::ALL.iter().filter(|t| ending.eq_ignore_ascii_case(t.ending()));
        let fits = fits.map(|t| t.name()).collect::<Vec<_>>().join(", ");
        if fits.is_empty() { Self::names() } else { fits }
    }

    /// What a file of one asset is called: `NAME` and this.
    pub fn suffix(self) -> &'static str {
        self.0.suffix()
    }

    /// What stands after the dot in names of its files.
    pub fn ending(self) -> &'static str {
        self.suffix().rsplit('.').next().unwrap_or_default()
    }

    /// Whether a file may hold several assets.
    pub fn holds_several(self) -> bool {
        self.0.filled().is_some()
    }

    /// Whether a file holds more than rigs: motions, meshes without a skeleton, and looks.
    pub fn holds_scenes(self) -> bool {
        self.0.holds_scenes()
    }

    /// Whether the format has a form for an asset.
    ///
    /// # Errors
    /// [`WriteError::Cannot`], as writing it would give.
    pub fn holds(self, asset: &Asset) -> Result<(), WriteError> {
        match self.0.lacks(&asset.rig) {
            Some(reason) => Err(WriteError::Cannot { asset: asset.name.clone(), format: self, reason }),
            None => Ok(()),
        }
    }

    /// Whether the format's own loaders expect vertices and joints in a cube.
    pub fn has_cube(self) -> bool {
        self.0.half_cube().is_some()
    }

    /// The rig moved and scaled as a whole to fill the cube that the format's own loaders expect; `None` where there is no
    /// such cube. It holds joints as well as vertices: loaders take the ones and the others only from within.
    pub fn fitted(self, rig: &Rig) -> Option<Rig> {
        let half = self.0.half_cube()?;
        let Similarity { scale, shift } = Similarity::into_cube(rig.bounds());
        let map = Similarity { scale: half * scale, shift: shift.map(|s| half * s) };
        Some(rig.transformed(map).expect("what is in a cube is finite"))
    }

    /// What is told of assets that reach out of the cube that the format's own loaders expect.
    pub(super) fn beyond(self, reach: &Reach) -> Option<WriteNote> {
        let half = self.0.half_cube()?;
        let Reach { assets, beyond, most } = *reach;
        (beyond > 0).then_some(WriteNote::Beyond { half, assets, beyond, most })
    }

    /// Whether a file that is there is one of the format, or the mesh beside one, and nothing else by that name.
    pub fn is_at(self, path: &Path) -> bool {
        start(path).is_ok_and(|start| self.0.is_at(path, &start))
    }

    /// Whether such a file says that riglab wrote it. Files of versions that left no mark do not.
    pub fn is_own(self, path: &Path) -> bool {
        start(path).is_ok_and(|start| self.0.is_at(path, &start) && self.0.is_own(path, &start))
    }

    /// Whether a file that is there is one of the format, to its end: copies may be cut off.
    pub fn is_whole(self, path: &Path) -> bool {
        self.is_at(path) && self.0.is_whole(path)
    }

    /// The name of the file that one of the format says it was made of; `None` where it does not say it.
    pub fn made_of(self, path: &Path) -> Option<String> {
        self.0.made_of(path)
    }

    /// The format that a file's name tells.
    ///
    /// # Errors
    /// [`WriteError::WhichFormat`] for npz and txt, which three and two formats have, unless the whole
    /// name tells, and for unknown endings.
    pub fn of(path: &Path) -> Result<Self, WriteError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let found = Self::ALL.iter().copied().find(|target| target.0.is_told_by(&name));
        found.ok_or_else(|| WriteError::WhichFormat(path.display().to_string()))
    }

    /// What it does.
    pub(super) fn writes(self) -> &'static dyn Writes {
        self.0
    }
}

/// How far assets reach.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Reach {
    assets: usize,
    /// Those that reach beyond the cube of the format.
    beyond: usize,
    /// The largest coordinate of these.
    most: f32,
}

impl Reach {
    /// With one more asset that is written in a format.
    pub(super) fn add(&mut self, target: Target, rig: &Rig) {
        self.assets += 1;
        let Some(half) = target.0.half_cube() else { return };
        let Bounds { min, max } = rig.bounds();
        let most = min.into_iter().chain(max).fold(0.0f32, |most, x| most.max(x.abs()));
        if most > half * (1.0 + ROUNDING) {
            self.beyond += 1;
            self.most = self.most.max(most);
        }
    }
}

/// How a file begins.
fn start(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    // Comments of an OBJ may be long.
    std::fs::File::open(path)?.take(1 << 20).read_to_end(&mut start)?;
    Ok(start)
}

impl PartialEq for Target {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Target {}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Debug for Target {
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
        assert!(Target::OBJ.is_at(&obj) && Target::RIGNET.is_at(&obj) && !Target::GLB.is_at(&obj));
    }

    #[test]
    fn names_and_endings_tell_the_format() {
        for &target in Target::ALL {
            assert_eq!(target.name().parse::<Target>().unwrap(), target);
        }
        for (path, target) in [
            ("a/B.GLB", Target::GLB),
            ("a.vrm", Target::GLB),
            ("raw_data.npz", Target::UNIRIG),
            ("7_rig.txt", Target::RIGNET),
        ] {
            assert_eq!(Target::of(Path::new(path)).unwrap(), target);
        }
        let said = |path: &str| Target::of(Path::new(path)).unwrap_err().to_string();
        for path in ["a", "a.blend"] {
            assert!(said(path).contains("puppeteer-h5, articulation-xl, unirig"), "{path}");
        }
        assert!(said("a.NPZ").contains("which of articulation-xl, unirig, skintokens it is"), "{}", said("a.NPZ"));
        assert!(said("a.txt").contains("which of rignet, puppeteer it is"), "{}", said("a.txt"));
    }
}
