//! Rigged files in and out.
//!
//! [`import`] reads one file into an [`Imported`]: the [`Rig`] that everything downstream works on,
//! its [`Provenance`], and the [`Reading`] it was made from. [`import_each`] does so for every asset of
//! a file of several, as data sets are; [`write`] goes the other way, to a [`Target`].
//!
//! The one idea: **two steps with one type between them.** A module per format turns bytes into a
//! [`Reading`] - joints possibly in several trees, meshes possibly unbound, numbered as in the file -
//! and one builder, the same for all formats, turns a reading into a valid rig: one tree, parents
//! first, weights that sum to 1. Whoever adds a format writes a module beside `gltf` that ends
//! in a reading and says there all that is asked of a format (`format::Reads`), and adds a line to [`Format::ALL`].
//!
//! Holds: no input makes it panic, recurse without bound or allocate more than the file can fill;
//! nothing outside the file's own folder is opened, and no connection made; nothing that is not
//! finite reaches a rig; what was repaired or doubtful is told in a [`Warning`]. Units and axes stay
//! those of the file, but that rigs have y up (formats with z up are turned) and that FBX, which says
//! what its units are, comes out in metres. All of FBX takes the feature `fbx`, as it builds a C library.
//!
//! The formats of other research code come down to plain arrays first ([`ArrayRig`], by
//! [`read_arrays`]), which comparisons with other readers need.
//!
//! Weights that others trained are read by name ([`TensorFile`]), out of what torch saves.
//!
//! What was read can be written: with another rig onto its own document, without its rig, or a rig alone
//! ([`mod@export`]); and in any [`Target`] ([`write`]). A finished GLB becomes a complete FBX (`glb_to_fbx`).
//!
//! A model without a rig is a [`rigging::Subject`]: one mesh to be rigged, and the way back into its document.
//!
//! Leaves out: what pictures and materials look like, but to take them from OBJ, FBX and PLY into a glTF.

mod assemble;
mod budget;
mod character;
mod error;
pub mod export;
#[cfg(feature = "fbx")]
mod fbx;
mod fbx_format;
mod format;
mod gltf;
mod influences;
mod inspect;
mod maker;
mod maps;
mod marked;
mod names;
mod nearest;
mod obj;
mod peers;
mod pictures;
mod ply;
mod reading;
pub mod rigging;
mod skeletons;
mod stl;
mod surface;
mod triangles;
mod warning;
mod wavefront;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use riglab_core::{Asset, Bounds, Clip, Joint, Mesh, Provenance, Rig, RigError, Skeleton, SkinWeights};

pub use assemble::RootPolicy;
pub use character::Character;
pub use error::{Fault, ImportError, Place};
use export::{ExportFault, ExportNote, ExportOptions, Exported, Influences, JointFrames};
#[cfg(feature = "fbx")]
pub use fbx::{FbxFault, FbxFile, FbxLeft, glb_to_fbx};
pub use format::Format;
pub use gltf::{decode_draco, decode_meshopt, to_glb};
pub use inspect::Inspection;
pub use peers::{
    Array, ArrayRig, Filling, PeerFault, SparseRows, StoredKind, StoredTensor, Target, TensorFile, Up, WriteError,
    WriteNote, write, write_mesh, written_paths,
};
pub use reading::{Binding, Body, Part, ReadJoint, Reading, Shaped, VertexSet};
pub use warning::{NodeName, Warning};

/// How to read.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// What becomes of a skeleton with several roots.
    pub roots: RootPolicy,
    /// Which asset of a file of several, counted from 0; without it [`import`] refuses such a file.
    pub item: Option<usize>,
    /// Which character of a file with several; `None` reads all as one.
    pub character: Option<Character>,
    /// Whether [`import_each`] gives every character of a file with several by itself.
    pub split: bool,
    /// Whether motions are read, and how they are sampled.
    pub clips: Option<Resample>,
    /// Which motion is read, by its name; of several called alike the first that can be. `None` reads all, as far as there is
    /// room for them.
    pub motion: Option<String>,
    /// Whether to repair what takes a guess: joints of a rig text beside its tree go below the root,
    /// which is refused otherwise, and `NAME_dup_K` joints of RigNet's predictions back into NAME.
    pub repair: bool,
    /// The axis that points up, for files that do not keep to y and do not say so: positions and joints are turned. Motions and
    /// springs are not.
    pub up: rigging::UpAxis,
    /// Whether a glTF without a skeleton is read without what is not shown: meshes that are colliders by the names of their
    /// nodes, that are not of its scene, or hidden.
    pub shown: bool,
    /// Whether the meshes of a glTF are read with the blend shapes that the file shows them with ([`Reading::shaped`]), in
    /// place of their stored positions. Only for looking at: what is written onto a document starts from stored positions.
    pub shaped: bool,
}

/// How motions are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resample {
    /// Frames a second; above 0.
    pub rate: f32,
    /// Frames of a clip at most; what follows is cut off.
    pub frames: usize,
}

#[cfg(feature = "fbx")]
impl Resample {
    /// Motions whole, but for those beyond all measure.
    pub(crate) fn whole(rate: f32) -> Self {
        Self { rate, frames: 1 << 16 }
    }
}

impl Default for Resample {
    fn default() -> Self {
        Self { rate: 30.0, frames: 1024 }
    }
}

/// What the only joint of a mesh without a rig is called in a corpus ([`Imported::into_mesh_asset`]); that tells it from rigs.
pub const LONE_JOINT: &str = "mesh";

/// What a file holds.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The file's name without folder and ending.
    pub name: String,
    /// The rig, or the bare mesh of a file without skeleton.
    pub content: Content,
    /// Motions of the rig, if [`ImportOptions::clips`] asks for them; each has the rig's joints.
    pub clips: Vec<Clip>,
    /// Where it came from; its notes are the warnings as sentences.
    pub provenance: Provenance,
    /// What was read, before it became one tree.
    pub reading: Reading,
    /// Whether it is one of several characters of the file, as [`ImportOptions::split`] asks for; `name` ends with its root's then.
    pub parted: bool,
}

/// What came out of a file.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // one a file
pub enum Content {
    /// A mesh bound to a skeleton.
    Rigged(Rig),
    /// A mesh in a file without skeleton: something to rig, nothing to learn from.
    Bare(Mesh),
}

impl Imported {
    /// The rig, if the file has one.
    pub fn rig(&self) -> Option<&Rig> {
        match &self.content {
            Content::Rigged(rig) => Some(rig),
            Content::Bare(_) => None,
        }
    }

    /// The mesh, bound or not.
    pub fn mesh(&self) -> &Mesh {
        match &self.content {
            Content::Rigged(rig) => rig.mesh(),
            Content::Bare(mesh) => mesh,
        }
    }

    /// What was repaired or is doubtful.
    pub fn warnings(&self) -> &[Warning] {
        &self.reading.warnings
    }

    /// As a corpus keeps it.
    ///
    /// # Errors
    /// [`Fault::NoSkeleton`] for a bare mesh.
    pub fn into_asset(self) -> Result<Asset, ImportError> {
        let Self { name, content, clips, provenance, .. } = self;
        match content {
            Content::Rigged(rig) => Ok(Asset { name, rig, clips, provenance }),
            Content::Bare(_) => Err(ImportError::new(&provenance.source, Fault::NoSkeleton)),
        }
    }

    /// The mesh alone, as a corpus keeps one: held whole by a single joint, [`LONE_JOINT`], in the middle of its box. What the
    /// file has of a skeleton, weights and motions is left behind.
    ///
    /// # Errors
    /// What makes it no rig, with the file before it.
    pub fn into_mesh_asset(self) -> Result<Asset, ImportError> {
        let Self { name, content, mut provenance, .. } = self;
        let mesh = match content {
            Content::Rigged(rig) => rig.mesh().clone(),
            Content::Bare(mesh) => mesh,
        };
        let lone = Warning::NoSkeleton.to_string();
        provenance.notes.retain(|note| *note != lone);
        let held = || -> Result<Rig, RigError> {
            let bounds = Bounds::of(mesh.positions().iter().copied());
            let head = bounds.map_or([0.0; 3], |b| std::array::from_fn(|k| 0.5 * (b.min[k] + b.max[k])));
            let skeleton = Skeleton::new(vec![Joint { name: LONE_JOINT.into(), parent: None, head }])?;
            let weights = SkinWeights::normalized(mesh.positions().iter().map(|_| [(0, 1.0)]))?;
            Rig::new(skeleton, mesh, weights)
        };
        let rig = held().map_err(|e| ImportError::new(&provenance.source, Fault::Rig(e)))?;
        Ok(Asset { name, rig, clips: Vec::new(), provenance })
    }
}

/// Reads the file at `path`, and external buffers from its folder or below, or the mesh beside a rig
/// text.
///
/// ```no_run
/// let imported = riglab_asset::import("fox.glb", &Default::default())?;
/// for warning in imported.warnings() {
///     eprintln!("fox.glb: {warning}");
/// }
/// println!("{} joints", imported.into_asset()?.rig.skeleton().len());
/// # Ok::<(), riglab_asset::ImportError>(())
/// ```
///
/// # Errors
/// What is wrong with the file, with its path before it; [`PeerFault::Several`] for a file of several
/// assets unless the options choose one.
pub fn import(path: impl AsRef<Path>, options: &ImportOptions) -> Result<Imported, ImportError> {
    let path = path.as_ref();
    let (format, folder) = look(path)?;
    match format {
        Some(format) => peers::one(&source(path, format, folder.as_deref()), options),
        None => import_from(path, &contents(path)?, folder.as_deref(), options),
    }
}

/// Reads every asset of the file at `path`, one at a time, as data sets hold thousands: `each` is given
/// an asset or what is wrong with it, and may end the reading. A GLB gives one.
///
/// ```no_run
/// use std::ops::ControlFlow;
/// riglab_asset::import_each("articulation_xlv2_test.npz", &Default::default(), |asset| {
///     match asset {
///         Ok(asset) => println!("{}", asset.name),
///         Err(e) => eprintln!("{e}"),
///     }
///     ControlFlow::Continue(())
/// });
/// ```
pub fn import_each(
    path: impl AsRef<Path>,
    options: &ImportOptions,
    mut each: impl FnMut(Result<Imported, ImportError>) -> ControlFlow<()>,
) {
    let path = path.as_ref();
    match look(path) {
        Ok((Some(format), folder)) => {
            peers::each(&source(path, format, folder.as_deref()), options, false, &mut each);
        }
        Ok((None, folder)) => match contents(path) {
            Ok(bytes) => each_character(path, &bytes, folder.as_deref(), options, &mut each),
            Err(e) => {
                let _ = each(Err(e));
            }
        },
        Err(e) => {
            let _ = each(Err(e));
        }
    }
}

/// The file as one asset, or, where the options split it, each character by itself.
fn each_character(
    path: &Path,
    bytes: &[u8],
    folder: Option<&Path>,
    options: &ImportOptions,
    each: &mut dyn FnMut(Result<Imported, ImportError>) -> ControlFlow<()>,
) {
    let (file, reading) = match read_from(path, bytes, folder, options) {
        Ok(read) => read,
        Err(e) => {
            let _ = each(Err(e));
            return;
        }
    };
    let roots = if options.split { reading.characters() } else { Vec::new() };
    if roots.len() < 2 {
        let _ = each(file.imported(reading, options));
        return;
    }
    for (number, root) in roots.iter().enumerate() {
        let one = reading.only(&Character::Number(number)).map_err(|fault| file.fail(fault));
        let one = one.and_then(|one| file.imported(one, options)).map(|imported| Imported {
            name: format!("{}-{root}", imported.name),
            parted: true,
            ..imported
        });
        if each(one).is_break() {
            return;
        }
    }
}

/// How many assets the file at `path` holds, by its own word; 1 for formats of one.
///
/// # Errors
/// What is wrong with the file.
pub fn count_assets(path: impl AsRef<Path>) -> Result<usize, ImportError> {
    let path = path.as_ref();
    let (format, folder) = look(path)?;
    match format {
        Some(format) if format.reads().holds_several() => {
            let counted = peers::count(&source(path, format, folder.as_deref()));
            counted.map_err(|fault| ImportError::new(&path.to_string_lossy(), fault))
        }
        _ => Ok(1),
    }
}

/// Endings of files that hold a model, rigged or not.
pub fn model_endings() -> impl Iterator<Item = &'static str> {
    Format::ALL.iter().filter(|format| format.has_models()).flat_map(|format| format.endings()).copied()
}

/// Whether a file found in a folder holds a model, by its ending.
pub fn is_model_file(path: &Path) -> bool {
    Format::by_ending(path).is_some_and(Format::has_models)
}

/// Whether a file found in a folder is one to import as a rig: by its ending, and of texts those that
/// are rig texts. A pair of text and OBJ counts once, as its text; of two texts for one OBJ, the one
/// with weights, and both where each has weights of its own.
pub fn is_rig_file(path: &Path) -> bool {
    Format::by_ending(path).is_some_and(|format| format.reads().is_rig(path))
}

/// The file of an asset's name, and which of its assets the name means; empty for the asset of a file of one. A `#` in the name
/// of a folder or file means none.
///
/// ```
/// use riglab_asset::file_and_item;
/// assert_eq!(file_and_item("set.npz#3"), ("set.npz", "3"));
/// assert_eq!(file_and_item("batch#2/fox #1.glb"), ("batch#2/fox #1.glb", ""));
/// assert_eq!(file_and_item("a#b.npz#c#d"), ("a#b.npz", "c#d"));
/// assert_eq!((file_and_item("fox.glb"), file_and_item("#.glb")), (("fox.glb", ""), ("#.glb", "")));
/// ```
pub fn file_and_item(name: &str) -> (&str, &str) {
    let is_file = |(at, _): &(usize, &str)| is_rig_file(Path::new(&name[..*at]));
    name.match_indices('#').find(is_file).map_or((name, ""), |(at, _)| (&name[..at], &name[at + 1..]))
}

/// The files that importing `path` reads: those of [`files_of`], and those that a list of UniRig's names. What a GLB keeps
/// outside is not asked.
pub fn files_read(path: &Path) -> Vec<PathBuf> {
    let listed = format_in_folder(path).map(|(format, folder)| format.reads().listed(path, folder));
    files_of(path).into_iter().chain(listed.into_iter().flatten()).collect()
}

/// The files that an asset is: `path` itself, and the other half of a pair of rig text and OBJ, or the buffers that a `.gltf`
/// names in its folder, there or not.
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let others = format_in_folder(path).map(|(format, folder)| format.reads().beside(path, folder));
    std::iter::once(path.to_path_buf()).chain(others.into_iter().flatten()).collect()
}

/// The format that a file is called by, and the folder in which it lies.
fn format_in_folder(path: &Path) -> Option<(Format, &Path)> {
    let folder = path.parent().map(|f| if f.as_os_str().is_empty() { Path::new(".") } else { f })?;
    Some((Format::by_ending(path)?, folder))
}

/// Whether the file at `path` is a glTF document, by its bytes.
pub fn is_gltf(path: &Path) -> bool {
    use std::io::Read;
    if !path.is_file() {
        return false;
    }
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|f| f.take(4096).read_to_end(&mut start));
    read.is_ok() && Format::of(path, &start).is_ok_and(|format| format == Format::GLTF)
}

/// Whether bytes are a glTF that says it is a VRM, of either version, whatever the file is called.
pub fn is_vrm(bytes: &[u8]) -> bool {
    gltf::is_vrm(bytes)
}

/// Whether the file at `path` is one of arrays ([`read_arrays`]), rather than of surfaces.
///
/// # Errors
/// What is wrong with the file.
pub fn holds_arrays(path: impl AsRef<Path>) -> Result<bool, ImportError> {
    look(path.as_ref()).map(|(format, _)| format.is_some())
}

/// Reads the arrays of a text, npz, h5 or pt file (or of an OBJ with a rig text) as they are, in the
/// file's axes, scale and order, a rig or not: what comparisons with other readers need.
///
/// # Errors
/// What is wrong with the file, and for each asset what is wrong with it.
pub fn read_arrays(path: impl AsRef<Path>) -> Result<Vec<Result<ArrayRig, ImportError>>, ImportError> {
    let path = path.as_ref();
    let fail = |fault| ImportError::new(&path.to_string_lossy(), fault);
    let (format, folder) = look(path)?;
    let format = format.ok_or_else(|| fail(PeerFault::UnknownMembers("those of another format".into()).into()))?;
    let all = peers::read_arrays(&source(path, format, folder.as_deref())).map_err(fail)?;
    Ok(all.into_iter().map(|rig| rig.map_err(fail)).collect())
}

/// Reads bytes as if they were the file `name`, without touching the file system: what refers to
/// other files is refused.
///
/// # Errors
/// What is wrong with the bytes, with `name` before it.
pub fn import_bytes(name: &str, bytes: &[u8], options: &ImportOptions) -> Result<Imported, ImportError> {
    let path = Path::new(name);
    let format = Format::of(path, bytes).map_err(|fault| ImportError::new(name, fault))?;
    if format.reads().in_arrays(path, None) {
        return peers::one(&peers::Source { path, format, input: peers::Input::Bytes(bytes), folder: None }, options);
    }
    import_from(path, bytes, None, options)
}

/// The format of the file at `path`, if that is read as arrays, and the file's folder.
fn look(path: &Path) -> Result<(Option<Format>, Option<PathBuf>), ImportError> {
    use std::io::Read;
    let fail = |fault| ImportError::new(&path.to_string_lossy(), fault);
    // The folder of a bare file name is "", which does not canonicalise.
    let folder = path.parent().map(|f| if f.as_os_str().is_empty() { Path::new(".") } else { f }.to_path_buf());
    // What a system says of a folder that is read as a file does not help.
    if path.is_dir() {
        return Err(fail(Fault::Folder));
    }
    no_pipe(path).map_err(fail)?;
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|f| f.take(4096).read_to_end(&mut start));
    read.map_err(|e| fail(Fault::unreadable(&e)))?;
    let format = Format::of(path, &start).map_err(fail)?;
    let peer = Some(format).filter(|format| format.reads().in_arrays(path, folder.as_deref()));
    Ok((peer, folder))
}

/// Refuses what waits for somebody who writes, or is gone once it was read.
pub(crate) fn no_pipe(path: &Path) -> Result<(), Fault> {
    if path.metadata().is_ok_and(|meta| !meta.is_file() && !meta.is_dir()) { Err(Fault::Pipe) } else { Ok(()) }
}

fn source<'a>(path: &'a Path, format: Format, folder: Option<&'a Path>) -> peers::Source<'a> {
    peers::Source { path, format, input: peers::Input::File(path), folder }
}

fn contents(path: &Path) -> Result<Vec<u8>, ImportError> {
    std::fs::read(path).map_err(|e| ImportError::new(&path.to_string_lossy(), Fault::unreadable(&e)))
}

/// Reads bytes as if they were the file `path`; `folder` is where what belongs to it is looked for, if at all.
fn import_from(
    path: &Path,
    bytes: &[u8],
    folder: Option<&Path>,
    options: &ImportOptions,
) -> Result<Imported, ImportError> {
    let (file, reading) = read_from(path, bytes, folder, options)?;
    file.imported(reading, options)
}

/// What a file says, as one asset or of one of its characters.
fn read_from(
    path: &Path,
    bytes: &[u8],
    folder: Option<&Path>,
    options: &ImportOptions,
) -> Result<(ReadFile, Reading), ImportError> {
    let source = path.to_string_lossy();
    let fail = |fault| ImportError::new(&source, fault);
    let format = Format::of(path, bytes).map_err(fail)?;
    let (mut reading, origin) = format.reads().read(bytes, folder, options).map_err(fail)?;
    if let Some(item) = options.item.filter(|&item| item > 0) {
        return Err(fail(PeerFault::NoSuchItem { item, count: 1 }.into()));
    }
    if let Some(character) = &options.character {
        reading.keep(character).map_err(fail)?;
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let checksum = blake3::hash(bytes).to_hex().to_string();
    Ok((ReadFile { name, source: source.into_owned(), checksum, origin }, reading))
}

/// What is the same of all that a file is read as.
struct ReadFile {
    name: String,
    source: String,
    checksum: String,
    origin: Rights,
}

impl ReadFile {
    fn fail(&self, fault: Fault) -> ImportError {
        ImportError::new(&self.source, fault)
    }

    /// What comes of a reading.
    fn imported(&self, mut reading: Reading, options: &ImportOptions) -> Result<Imported, ImportError> {
        let (content, clips) = assemble::content(&mut reading, options).map_err(|fault| self.fail(fault))?;
        let Rights { licence, author, notes } = self.origin.clone();
        let provenance = Provenance {
            source: self.source.clone(),
            checksum: self.checksum.clone(),
            notes: notes.into_iter().chain(reading.warnings.iter().map(Warning::to_string)).collect(),
            licence,
            author,
            category: String::new(),
        };
        Ok(Imported { name: self.name.clone(), content, clips, provenance, reading, parted: false })
    }
}

/// What a file says of its rights; empty where it says nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Rights {
    pub licence: String,
    pub author: String,
    /// Where it was published and what else belongs in the provenance.
    pub notes: Vec<String>,
}
