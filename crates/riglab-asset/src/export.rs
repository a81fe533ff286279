//! Files out: a rig put into the document its mesh came from, a rig alone, a document without its rig.
//!
//! [`onto`] writes the source again with another rig: materials, pictures, morph targets, names, extras,
//! extensions and the nodes stay. A skeleton that is the source's own keeps its nodes and skins, and only
//! weights that differ are written; skins take in joints of others that these need. Only where vertices
//! would be seen to move by that, and for any other skeleton, a new armature comes beside the meshes, whose
//! joints take the place of the old ones: nodes that were for the old joints alone go, which is told, and so does motion
//! of them. [`strip`] takes the rig out and leaves the meshes where the rest pose shows them.
//!
//! Human bones and springs go along: into a VRM in the words of its version, and from a rig that has none
//! what the source says stays, as far as its joints do; for new joints of the source's own skeleton it is told anew, in
//! their axes. Any other file gets `VRMC_springBone`, and the human
//! bones in `extras` of nodes; [`alone`] makes a VRM 1.0 where the author is known to have chosen its licence.
//!
//! Holds: what is written reads back with the same joints, heads and triangles, positions equal bit for
//! bit (where the source's own joints get other weights, within a millionth of the rig's size), weights
//! within 1e-6 unless they were cut; the same input gives the same bytes; pictures are copied byte for byte. With [`JointFrames::AlongBone`] heads and positions are equal within rounding of f32.
//!
//! Two things look different: geometry that was compressed (Draco, meshopt) is written plain, and the file
//! is one GLB, with everything in it that lay beside it. A mesh that was mirrored by its node, when a skin
//! binds it or its node goes, gets its triangles turned round so that they face as before.

use std::fmt;
use std::io;
use std::path::Path;

use riglab_core::{Asset, Clip, HumanBone, Provenance, Rig, Skeleton};
use thiserror::Error;

use crate::warning::{of_number, rounded};
use crate::{Fault, Format, ImportOptions, Imported, gltf, import_from};

/// How to write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExportOptions {
    /// How many influences a vertex may have.
    pub influences: Influences,
    /// How joints of a new skeleton are turned at rest.
    pub frames: JointFrames,
}

/// How many influences a vertex may have. The largest stay, and their sum is made 1 again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Influences {
    /// Four: what every engine reads.
    #[default]
    Four,
    /// Eight: two sets, JOINTS_1 and WEIGHTS_1 where they are needed.
    Eight,
    /// As many as the rig has.
    All,
}

/// How joints of a new skeleton are turned at rest. Where they are is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JointFrames {
    /// All axes as those of the scene: no turns, and every number exact.
    #[default]
    Parallel,
    /// y from the joint to its child with the most joints below, as Blender's bones; without children as
    /// the parent. z looks along the scene's z as far as it can, so that left and right mirror each other; bones
    /// within 25 degrees of that go on from their parent by the shortest turn.
    AlongBone,
}

/// A file that was written, and what to know about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// A GLB.
    pub bytes: Vec<u8>,
    /// What is not as it was.
    pub notes: Vec<ExportNote>,
}

/// Something about a written file that a person may want to know. Its text is a sentence without a full
/// stop.
#[derive(Clone, Debug, PartialEq)]
pub enum ExportNote {
    /// Vertices lost influences.
    InfluencesCut {
        /// How many.
        vertices: usize,
        /// As many influences as they may have.
        most: usize,
        /// The largest share that one lost.
        lost: f32,
    },
    /// A picture is not in the file: it could not be read, or nothing says what it is.
    PictureLeft {
        /// Its number.
        image: usize,
        /// What the source says, cut to a readable length.
        uri: String,
        /// Whether it is in no folder that is looked in: the model's and those below it.
        outside: bool,
    },
    /// The old rig could not be read, for this fault.
    RigBroken(Fault),
    /// What has numbers that are not finite, which the format does not allow, was mended or left out.
    NotFinite {
        /// Normals, which were made anew of the triangles around them.
        normals: usize,
        /// Texture coordinates, which are 0 now.
        coordinates: usize,
        /// Colours of vertices, which are white now.
        colours: usize,
        /// What morph targets add to a vertex, which is nothing now.
        offsets: usize,
        /// Primitives whose tangents were left out.
        tangents: usize,
        /// Animation channels that were left out.
        channels: usize,
    },
    /// Animations of the old rig do not apply any more.
    MotionDropped {
        /// Channels dropped.
        channels: usize,
    },
    /// What is written stands as it was bound, too, which is another size than the file shows.
    Resized {
        /// By what the file shows.
        size: f64,
    },
    /// Mirrored meshes without skin had their triangles turned round.
    TrianglesTurned {
        /// How many.
        surfaces: usize,
    },
    /// The human bones of a rig alone are in the `extras` of nodes: it cannot become a VRM 1.0.
    NoVrm {
        /// Why.
        lacking: &'static str,
    },
    /// A VRM 0.x cannot say all that the springs of the rig are.
    SpringsChanged {
        /// Joints that swing, because one above them does.
        joints: usize,
        /// Capsules that became spheres.
        capsules: usize,
    },
    /// Nodes that hold a mesh, or stand above one, are moved by animations, which do nothing to it any more: a skinned mesh
    /// goes with its joints.
    MotionIdle {
        /// How many hold one.
        nodes: usize,
        /// How many others stand above one.
        above: usize,
    },
    /// A motion scales joints to nothing, and others vanish with them that hang there and are seen in the source.
    MotionSwallowed {
        /// Its name; of several the one where most vanish.
        motion: String,
        /// How many joints vanish in it.
        joints: usize,
        /// How many other motions do the same.
        others: usize,
    },
    /// A motion shears joints, which nodes cannot: they stand as near as nodes can.
    MotionSheared {
        /// Its name; of several the one that is furthest off.
        motion: String,
        /// How far vertices are at most from where the source has them, by the diagonal of the model.
        share: f64,
        /// How many other motions do the same.
        others: usize,
    },
    /// What was of the old joints beside what a rig holds went with them.
    HungLost {
        /// Nodes that hung on them: sockets, eyes, what colliders are of.
        nodes: usize,
        /// Human bones of a VRM that had none of the rig's joints.
        bones: usize,
        /// Nodes that followed others (`VRMC_node_constraint`).
        constraints: usize,
    },
    /// Nodes that were for the old rig alone stay, as extensions that are not known may name nodes by number.
    JointsStay {
        /// How many.
        nodes: usize,
        /// These extensions.
        extensions: Vec<String>,
    },
    /// The file is a VRM that lacks human bones it must have.
    NotHuman {
        /// Their names in VRM 1.0.
        lacking: Vec<String>,
    },
    /// Parts of a VRM that are about the old rig were dropped.
    VrmDropped {
        /// As the format calls them.
        parts: Vec<&'static str>,
    },
    /// Human bones and springs are those of the source: the rig has a root that the source has not.
    BodyLeft,
}

impl ExportNote {
    /// What tells the worst of several notes of a kind; `None` of those that have no such figure.
    pub fn figure(&self) -> Option<f64> {
        match self {
            Self::InfluencesCut { lost, .. } => Some(f64::from(*lost)),
            Self::MotionDropped { channels } => Some(*channels as f64),
            Self::MotionSwallowed { joints, .. } => Some(*joints as f64),
            Self::MotionSheared { share, .. } => Some(*share),
            _ => None,
        }
    }

    /// Adds it to those of a file. Of motions one line says what is wrong with them, however many there are.
    pub(crate) fn put(self, notes: &mut Vec<Self>) {
        let same = notes.iter_mut().find(|note| std::mem::discriminant(*note) == std::mem::discriminant(&self));
        match (same, self) {
            (Some(own @ Self::MotionSwallowed { .. }), note) | (Some(own @ Self::MotionSheared { .. }), note) => {
                own.join(note);
            }
            (_, note) => notes.push(note),
        }
    }

    /// The worse of two on motions, counted as both.
    fn join(&mut self, mut other: Self) {
        // The first in the file of those that are as bad, which come last.
        if other.figure() >= self.figure() {
            std::mem::swap(self, &mut other);
        }
        let (Self::MotionSwallowed { others: more, .. } | Self::MotionSheared { others: more, .. }) = other else {
            return;
        };
        if let Self::MotionSwallowed { others, .. } | Self::MotionSheared { others, .. } = self {
            *others += more + 1;
        }
    }
}

impl fmt::Display for ExportNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InfluencesCut { vertices, most, lost } => write!(
                f,
                "{} more than {most} influences; the smallest were left out, at most a share of {lost:.4}",
                of_number(*vertices, "vertex has", "vertices have")
            ),
            Self::PictureLeft { image, uri, outside: true } => write!(
                f,
                "image {image} is not in the file: `{uri}` lies outside the model's folder, and only that is searched; put it \
                 there"
            ),
            Self::PictureLeft { image, uri, .. } => {
                write!(f, "image {image} is not in the file: `{uri}` cannot be read or is no known kind of picture")
            }
            Self::RigBroken(fault) => write!(
                f,
                "the old rig cannot be read and was left out: {fault}; the model stands where its nodes place it"
            ),
            Self::NotFinite { normals, coordinates, colours, offsets, tangents, channels } => {
                let parts = [
                    (normals, "normal was made anew", "normals were made anew"),
                    (coordinates, "texture coordinate was set to 0", "texture coordinates were set to 0"),
                    (colours, "colour was set to white", "colours were set to white"),
                    (offsets, "offset of a morph target was set to 0", "offsets of morph targets were set to 0"),
                    (tangents, "primitive lost its tangents", "primitives lost their tangents"),
                    (channels, "animation channel was left out", "animation channels were left out"),
                ];
                let told = parts.iter().filter(|(n, ..)| **n > 0).map(|(n, one, many)| of_number(**n, one, many));
                let told: Vec<_> = told.collect();
                write!(
                    f,
                    "numbers in it are not finite (NaN or infinity), which glTF does not allow: {}",
                    told.join(", ")
                )
            }
            Self::MotionDropped { channels } => {
                let dropped = of_number(
                    *channels,
                    "animation channel that moved the old rig was dropped",
                    "animation channels that moved the old rig were dropped",
                );
                f.write_str(&dropped)
            }
            Self::Resized { size } => write!(
                f,
                "it is written in its bind pose, so the output is {} times the size that the file shows: scale it where it is \
                 used, or apply the armature's scale beforehand",
                rounded(*size)
            ),
            Self::MotionIdle { nodes, above } => {
                let holding = if *nodes == 1 { "a node that holds a mesh" } else { "nodes that hold meshes" };
                let higher = if *above == 1 { "a node above a mesh" } else { "nodes above meshes" };
                let whose: Vec<_> =
                    [(nodes, holding), (above, higher)].iter().filter(|(n, _)| **n > 0).map(|(_, who)| *who).collect();
                let nothing = if *above == 0 { "nothing" } else { "no mesh" };
                write!(
                    f,
                    "animations of {} move {nothing} any more: skinned meshes go with their joints",
                    whose.join(" and of ")
                )
            }
            Self::MotionSwallowed { motion, joints, others } => {
                let (one, many) = ("joint on them vanishes, too, but is", "joints on them vanish, too, but are");
                let vanish = of_number(*joints, one, many);
                match others {
                    0 => write!(f, "motion `{motion}` scales joints to 0: {vanish} seen in the source"),
                    n => write!(
                        f,
                        "{} motions scale joints to 0, `{motion}` the most: {vanish} seen in the source",
                        n + 1
                    ),
                }
            }
            Self::MotionSheared { motion, share, others } => {
                let cannot = "joints, which nodes of glTF cannot:";
                let off = format!("up to {:.1} % of the model's size from where the source has them", 100.0 * share);
                match others {
                    0 => write!(f, "motion `{motion}` shears {cannot} its vertices are {off}"),
                    n => write!(f, "{} motions shear {cannot} their vertices are {off}, most in `{motion}`", n + 1),
                }
            }
            Self::HungLost { nodes, bones, constraints } => {
                let parts = [
                    (nodes, "node that hung on them", "nodes that hung on them"),
                    (bones, "human bone", "human bones"),
                    (constraints, "constraint", "constraints"),
                ];
                let told = parts.iter().filter(|(n, ..)| **n > 0).map(|(n, one, many)| of_number(**n, one, many));
                let told: Vec<_> = told.collect();
                write!(f, "with the old joints went {}", told.join(", "))
            }
            Self::JointsStay { nodes, extensions } => {
                let stay = of_number(
                    *nodes,
                    "node that was for the old rig alone stays",
                    "nodes that were for the old rig alone stay",
                );
                write!(
                    f,
                    "{stay}, as extensions that riglab does not know may name nodes by number: {}; take these out of the file to \
                     have the nodes go, too",
                    extensions.join(", ")
                )
            }
            // All that a body must have.
            Self::NotHuman { lacking }
                if lacking.len() == HumanBone::all().filter(|bone| bone.is_required()).count() =>
            {
                f.write_str("its joints are no human body, without which programs that read VRM will refuse it")
            }
            Self::NotHuman { lacking } => write!(
                f,
                "programs that read VRM will refuse it: no {} was found among its joints, whatever they are called; another \
                 --seed, or --template mixamo, may find them",
                lacking.join(", ")
            ),
            Self::VrmDropped { parts } => {
                let were = if parts.len() == 1 { "was" } else { "were" };
                write!(f, "{} (of VRM) referred to the old rig and {were} removed with it", parts.join(", "))
            }
            Self::TrianglesTurned { surfaces } => {
                let meshes = if *surfaces == 1 { "mesh" } else { "meshes" };
                write!(
                    f,
                    "the triangles of {surfaces} mirrored {meshes} were turned round, so that they face as before"
                )
            }
            Self::NoVrm { lacking } => {
                write!(f, "human bones are in the extras of nodes, and the file is no VRM: {lacking}")
            }
            Self::SpringsChanged { joints, capsules } => write!(
                f,
                "VRM 0.x cannot say all of the springs: {joints} joints swing with one above them, \
                 {capsules} capsules became rows of spheres"
            ),
            Self::BodyLeft => f.write_str(
                "human bones and springs are those of the source, for the rig has a root that the source has not",
            ),
        }
    }
}

/// A file that cannot be written again, and why.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{file}: {fault}")]
pub struct ExportError {
    /// Path of the source, as given.
    pub file: String,
    /// What is wrong.
    pub fault: ExportFault,
}

/// One way in which an export can fail.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ExportFault {
    /// The source itself.
    #[error(transparent)]
    Source(#[from] Fault),
    /// The rig is of another mesh.
    #[error(
        "the rig has another mesh than the file: {found} vertices and {wanted} in the file, or other places; \
         export it alone, or import the file again"
    )]
    OtherMesh {
        /// In the rig.
        found: usize,
        /// In the file.
        wanted: usize,
    },
    /// The bytes changed since they were imported.
    #[error("the file is not the one that was imported; import it again")]
    OtherSource,
    /// The clip is of another skeleton.
    #[error("the motion is of another skeleton ({0}); import the file again")]
    OtherMotion(String),
    /// Not glTF.
    #[error("only glTF, GLB and VRM files can be written again as they are; convert the file to GLB first")]
    NotADocument,
    /// A GLB counts its bytes with 32 bits.
    #[error("the GLB would have {0} bytes, more than the format can say (4 GiB); leave out pictures or meshes")]
    TooLong(usize),
}

/// Writes the file at `path` again with `rig`, which has the mesh that `imported`, read from it, has: the
/// same vertices in the same order.
///
/// A source without a document (OBJ and the like) gives what [`alone`] gives.
///
/// ```no_run
/// use riglab_asset::export::{self, ExportOptions};
///
/// let imported = riglab_asset::import("fox.glb", &Default::default())?;
/// let rig = imported.rig().unwrap().clone(); // or one predicted on `imported.mesh()`
/// let exported = export::onto("fox.glb", &imported, &rig, &ExportOptions::default())?;
/// export::write("rigged.glb", &exported.bytes)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// What is wrong with the file, or that rig, file and import do not belong together.
pub fn onto(
    path: impl AsRef<Path>,
    imported: &Imported,
    rig: &Rig,
    options: &ExportOptions,
) -> Result<Exported, ExportError> {
    let path = path.as_ref();
    let bytes = read(path)?;
    onto_bytes(path, &bytes, Some(folder(path)), imported, rig, options)
}

/// As [`onto`], with the bytes of the file; `folder` is where what belongs to it is looked for, if at all.
///
/// # Errors
/// As [`onto`].
pub fn onto_bytes(
    path: impl AsRef<Path>,
    bytes: &[u8],
    folder: Option<&Path>,
    imported: &Imported,
    rig: &Rig,
    options: &ExportOptions,
) -> Result<Exported, ExportError> {
    let path = path.as_ref();
    let fail = |fault| ExportError { file: path.to_string_lossy().into_owned(), fault };
    if rig.mesh() != imported.mesh() {
        let (found, wanted) = (rig.mesh().positions().len(), imported.mesh().positions().len());
        return Err(fail(ExportFault::OtherMesh { found, wanted }));
    }
    if blake3::hash(bytes).to_hex().to_string() != imported.provenance.checksum {
        return Err(fail(ExportFault::OtherSource));
    }
    match Format::of(path, bytes).map_err(|f| fail(f.into()))? == Format::GLTF {
        true => gltf::export::onto(bytes, folder, imported, rig, [0.0; 3], &[], options).map_err(fail),
        false => gltf::export::alone(&imported.name, rig, &imported.provenance, options).map_err(fail),
    }
}

/// A rig as a GLB of its own: one mesh with normals and a plain material, one skin, a node a joint.
///
/// Springs are those of VRM 1.0 (`VRMC_springBone`). The whole becomes a VRM 1.0 where the rig has all human
/// bones that it asks for and looks along +z, and the provenance an author and the licence
/// <https://vrm.dev/licenses/1.0/>. Else each human bone is told by the member `riglabHumanBone` of the
/// `extras` of its node, which [`crate::import`] reads.
///
/// # Errors
/// [`ExportFault::TooLong`].
pub fn alone(name: &str, rig: &Rig, provenance: &Provenance, options: &ExportOptions) -> Result<Exported, ExportError> {
    gltf::export::alone(name, rig, provenance, options).map_err(|fault| ExportError { file: name.into(), fault })
}

/// An asset as [`alone`] writes its rig, with its motions: a key a frame for each joint that they move.
///
/// # Errors
/// [`ExportFault::TooLong`].
pub fn moving(asset: &Asset, options: &ExportOptions) -> Result<Exported, ExportError> {
    let exported = alone(&asset.name, &asset.rig, &asset.provenance, options)?;
    gltf::export::with_motions(exported, asset.rig.skeleton(), &asset.clips)
        .map_err(|fault| ExportError { file: asset.name.clone(), fault })
}

/// The file at `path` without its rig: no skins, no weights, no nodes that were for joints alone, no motion
/// of them, no humanoid or springs of VRM. Meshes stand as the rest pose shows them, as the importer reads
/// it (but by [`crate::Reading::shown_off`] away, so that they stay among what no joint moved), or, where the rig is broken,
/// their nodes place them. A file without a rig comes back as it is, but for being one GLB.
///
/// # Errors
/// What is wrong with the file beyond its rig; [`ExportFault::NotADocument`] for other formats than glTF.
pub fn strip(path: impl AsRef<Path>, options: &ImportOptions) -> Result<Exported, ExportError> {
    let path = path.as_ref();
    strip_bytes(path, &read(path)?, Some(folder(path)), options)
}

/// As [`strip`], with the bytes of the file; `folder` is where what belongs to it is looked for, if at all.
///
/// # Errors
/// As [`strip`].
pub fn strip_bytes(
    path: impl AsRef<Path>,
    bytes: &[u8],
    folder: Option<&Path>,
    options: &ImportOptions,
) -> Result<Exported, ExportError> {
    let path = path.as_ref();
    let fail = |fault| ExportError { file: path.to_string_lossy().into_owned(), fault };
    if Format::of(path, bytes).map_err(|f| fail(f.into()))? != Format::GLTF {
        return Err(fail(ExportFault::NotADocument));
    }
    // All characters go, and nothing is looked at that does not stand somewhere.
    let options = ImportOptions { character: None, clips: None, ..options.clone() };
    match import_from(path, bytes, folder, &options) {
        Ok(imported) => gltf::export::strip(bytes, folder, &imported.reading),
        Err(e) => gltf::export::strip_broken(bytes, folder, &options, e.fault).map(|(_, exported)| exported),
    }
    .map_err(fail)
}

/// A rigged glTF with one motion more, `riglab preview`: each joint of each skin bends 25 degrees to and fro, one after
/// another, so that a person sees whether the rig works. A file without skin comes back as it is, but for being one GLB.
///
/// The motion lasts 2.5 to 8 seconds, by how many joints there are. Rest pose and other motions stay.
///
/// # Errors
/// What is wrong with the file.
pub fn preview(bytes: &[u8]) -> Result<Exported, ExportFault> {
    gltf::export::preview(bytes, None)
}

/// A glTF with one motion more, which comes first: `clip`, with a key a frame for each joint that it moves. The joints
/// of the clip are those of `skeleton`, by whose names the file's are found; `imported` was read from these very
/// bytes. `folder` is where what belongs to the file is looked for, if at all. All else stays as it is;
/// weights that compression rounded too, which [`onto`] mends.
///
/// Turns, shifts and scales of joints are kept; sheared ones, as uneven scales of turned joints make, come near.
///
/// # Errors
/// What is wrong with the file; that it is no glTF, or file, import, skeleton and clip do not belong together.
pub fn animate(
    bytes: &[u8],
    folder: Option<&Path>,
    imported: &Imported,
    skeleton: &Skeleton,
    clip: &Clip,
) -> Result<Exported, ExportError> {
    let file = &imported.provenance.source;
    let fail = |fault| ExportError { file: file.clone(), fault };
    if blake3::hash(bytes).to_hex().to_string() != imported.provenance.checksum {
        return Err(fail(ExportFault::OtherSource));
    }
    if Format::of(Path::new(file), bytes).map_err(|f| fail(f.into()))? != Format::GLTF {
        return Err(fail(ExportFault::NotADocument));
    }
    gltf::export::animate(bytes, folder, &imported.reading, skeleton, std::slice::from_ref(clip)).map_err(fail)
}

/// A GLB that says in it which file it was made of, for [`crate::Target::made_of`]; as it is where it has no place for that.
pub fn made_of(glb: Vec<u8>, file: &str) -> Vec<u8> {
    gltf::say_made_of(&glb, file).unwrap_or(glb)
}

/// Writes a file whole or not at all: under a temporary name in the same folder, synced, then renamed. A kill
/// at any moment leaves what was there. A link is followed; a device or folder is not replaced.
///
/// # Errors
/// What the system says; nothing stays behind then.
pub fn write(path: impl AsRef<Path>, bytes: &[u8]) -> io::Result<()> {
    riglab_files::write(path.as_ref(), bytes)
}

/// Whether two paths lead to one file, by whatever names or links. False where one of them is not there.
pub fn same_file(a: impl AsRef<Path>, b: impl AsRef<Path>) -> bool {
    let real = |path: &Path| path.canonicalize().ok();
    match (real(a.as_ref()), real(b.as_ref())) {
        (Some(a), Some(b)) => a == b,
        _ => false,
    }
}

fn read(path: &Path) -> Result<Vec<u8>, ExportError> {
    let fail = |fault| ExportError { file: path.to_string_lossy().into_owned(), fault: ExportFault::Source(fault) };
    crate::no_pipe(path).map_err(fail)?;
    std::fs::read(path).map_err(|e| fail(Fault::unreadable(&e)))
}

/// The folder of a bare file name is "", which does not canonicalise.
pub(crate) fn folder(path: &Path) -> &Path {
    path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."))
}
