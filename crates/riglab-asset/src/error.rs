//! Why a file cannot be imported.

use std::fmt;

use riglab_core::RigError;
use thiserror::Error;

use crate::PeerFault;

/// A file that cannot be imported, and why.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{file}: {fault}{}", fault.remedy())]
pub struct ImportError {
    /// Its path, as given.
    pub file: String,
    /// What is wrong with it.
    pub fault: Fault,
}

impl ImportError {
    /// A fault of a file.
    pub fn new(file: &str, fault: Fault) -> Self {
        Self { file: file.to_owned(), fault }
    }
}

/// A primitive of a mesh on a node, by their numbers in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// The node that holds the mesh.
    pub node: usize,
    /// The mesh.
    pub mesh: usize,
    /// Which primitive of the mesh.
    pub primitive: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "mesh {}, primitive {} (node {})", self.mesh, self.primitive, self.node)
    }
}

/// One way in which a file can be wrong. The numbers count from 0, as in the file.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Fault {
    /// The file cannot be opened or read.
    #[error("cannot be read: {0}")]
    Unreadable(String),
    /// A folder where a file is asked for.
    #[error(
        "it is a folder; give one of the files in it (`riglab dataset import` and `riglab convert` take all of them)"
    )]
    Folder,
    /// What can be read but once.
    #[error("it is a pipe or a device, and files are read more than once: write it to a file first")]
    Pipe,
    /// No bytes at all.
    #[error("the file is empty")]
    Empty,
    /// Neither GLB nor JSON.
    #[error(
        "not a glTF, GLB or VRM file: no magic `glTF` and no JSON at its start; it looks like {0}. riglab reads these, FBX, OBJ, \
         PLY, STL and the formats of other research code (`riglab convert --help`); convert it to GLB, in Blender for example"
    )]
    NotAModel(&'static str),
    /// A format that is known but not read.
    #[error("{format} is a format that is not read{hint}; convert the file to GLB, in Blender for example")]
    OtherFormat {
        /// The format.
        format: &'static str,
        /// What this build lacks for it, or nothing.
        hint: &'static str,
    },

    /// A character that the file does not have.
    #[error("no character {wanted}; the file has {}", listed(found))]
    NoSuchCharacter {
        /// Which was asked for.
        wanted: String,
        /// The names of those there are.
        found: Vec<String>,
    },

    /// Bytes that are no FBX, or an FBX that makes no rig.
    #[error("cannot be read as FBX: {0}; export the file again, or convert it to GLB, in Blender for example")]
    Fbx(String),

    /// A line of an OBJ file.
    #[error("cannot be read as OBJ: {0}; export the file again, in Blender for example")]
    Obj(String),

    /// A head, row or number of a PLY file.
    #[error("cannot be read as PLY: {0}; export the file again, in Blender for example")]
    Ply(String),

    /// A line or triangle of an STL file.
    #[error("cannot be read as STL: {0}; export the file again, in Blender for example")]
    Stl(String),

    /// A GLB shorter than its header.
    #[error("the GLB header is cut short: {0} bytes of 12")]
    ShortHeader(usize),
    /// GLB 1 was another format.
    #[error("GLB version {0} is not read, only version 2; export the file again as glTF 2.0")]
    GlbVersion(u32),
    /// The header's length is more than the file has.
    #[error("the file is truncated: its header gives a length of {claimed} bytes, it has {found}")]
    Truncated {
        /// By the header.
        claimed: usize,
        /// In the file.
        found: usize,
    },
    /// A chunk does not fit.
    #[error("chunk {chunk} gives a length of {claimed} bytes where {left} are left")]
    ChunkLength {
        /// Which chunk.
        chunk: usize,
        /// By its header.
        claimed: usize,
        /// After its header.
        left: usize,
    },
    /// The first chunk must be JSON.
    #[error("chunk 0 of the GLB is not its JSON chunk")]
    NoJsonChunk,
    /// Not the JSON of a glTF file.
    #[error("invalid JSON{}: {reason}", if path.is_empty() { String::new() } else { format!(" at {path}") })]
    Json {
        /// Where, as in `accessors[3].count`; empty when the syntax itself is wrong.
        path: String,
        /// What is wrong, with line and column.
        reason: String,
    },
    /// Brackets within brackets.
    #[error("the JSON is nested more than {0} deep")]
    JsonDepth(usize),
    /// Another glTF.
    #[error("asset.version is `{0}`, only version 2 of glTF is read")]
    Version(String),
    /// The file cannot be read rightly without it.
    #[error("requires the extension {extension}, {does}", extension = .0, does = unread(.0))]
    RequiredExtension(String),
    /// Compressed geometry that is not what its extension defines.
    #[error("{what} cannot be decoded: {extension}: {reason}; export without compression")]
    Compressed {
        /// Which buffer view or primitive.
        what: String,
        /// What compressed it.
        extension: &'static str,
        /// What is wrong.
        reason: String,
    },

    /// A number that names nothing.
    #[error("{from} names {to} {index}, which is out of range: there are {count}")]
    Reference {
        /// What names it.
        from: String,
        /// The kind of thing named.
        to: &'static str,
        /// Its number.
        index: usize,
        /// How many of its kind there are.
        count: usize,
    },
    /// Only the first buffer of a GLB has no uri.
    #[error("buffer {0} has no uri, and the file has no binary chunk for it")]
    NoBinaryChunk(usize),
    /// A data uri that is not base64.
    #[error("buffer {buffer}: its data uri is not base64: {reason}")]
    Base64 {
        /// Which buffer.
        buffer: usize,
        /// What the decoder says.
        reason: String,
    },
    /// An address, not a file beside this one.
    #[error("buffer {buffer}: the uri `{uri}` has a scheme or percent signs that do not name a file in this folder")]
    UriScheme {
        /// Which buffer.
        buffer: usize,
        /// The uri, cut to a readable length.
        uri: String,
    },
    /// A file elsewhere.
    #[error("buffer {buffer}: the uri `{uri}` leads outside the folder of the file, which is not allowed")]
    UriOutside {
        /// Which buffer.
        buffer: usize,
        /// The uri, cut to a readable length.
        uri: String,
    },
    /// The file it names cannot be read.
    #[error("buffer {buffer}: the file `{uri}` is missing or cannot be read: {reason}")]
    BufferFile {
        /// Which buffer.
        buffer: usize,
        /// The uri, cut to a readable length.
        uri: String,
        /// What the system says.
        reason: String,
    },
    /// A view beyond its buffer.
    #[error("buffer view {view} reaches out of bounds: {length} bytes from {offset} in buffer {buffer} of {found}")]
    ViewBounds {
        /// Which view.
        view: usize,
        /// Where it starts.
        offset: u64,
        /// How long it is.
        length: u64,
        /// In which buffer.
        buffer: usize,
        /// How many bytes that has.
        found: usize,
    },
    /// An accessor beyond its view.
    #[error(
        "accessor {accessor} reaches out of bounds: {count} elements from byte {offset} \
         in buffer view {view} of {found} bytes"
    )]
    AccessorBounds {
        /// Which accessor.
        accessor: usize,
        /// Elements claimed.
        count: u64,
        /// Where they start.
        offset: u64,
        /// In which view.
        view: usize,
        /// How many bytes that has.
        found: usize,
    },
    /// Elements that overlap.
    #[error("accessor {accessor}: the byte stride {stride} is less than its elements' {size} bytes")]
    Stride {
        /// Which accessor.
        accessor: usize,
        /// The stride of its view.
        stride: usize,
        /// The size of an element.
        size: usize,
    },
    /// A number glTF does not define.
    #[error("accessor {accessor} has the component type {found}, which does not exist")]
    ComponentType {
        /// Which accessor.
        accessor: usize,
        /// The number.
        found: u32,
    },
    /// A type that cannot serve here.
    #[error("accessor {accessor}: {used} cannot be {found}, component types and shape must be {wanted}")]
    AccessorType {
        /// Which accessor.
        accessor: usize,
        /// What it is used as.
        used: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        wanted: &'static str,
    },
    /// A count that no file this size can mean.
    #[error(
        "{what}: a count of {count} is too large, the limit is {limit}; if it is real, decimate its meshes or split \
         it into several files, in Blender for example"
    )]
    TooLarge {
        /// Of what.
        what: String,
        /// Claimed.
        count: u64,
        /// Allowed.
        limit: u64,
    },
    /// Nodes that show meshes again and again.
    #[error(
        "the meshes, counted once for each node that shows them, take {bytes} bytes, more than a file of this size may \
         need ({limit}); put fewer nodes on one mesh, or simplify that mesh"
    )]
    Shown {
        /// So far.
        bytes: u64,
        /// Allowed.
        limit: u64,
    },
    /// Few bytes that stand for many, in primitives that share accessors or by compression.
    #[error(
        "{what} comes to {bytes} bytes once decoded, more than a file of this size may ask for ({limit}); export it without \
         compression, and with accessors of their own for the primitives that share them"
    )]
    Unfolded {
        /// What of the file.
        what: &'static str,
        /// So far.
        bytes: u64,
        /// Allowed.
        limit: u64,
    },
    /// More than were asked for.
    #[error(
        "{found} triangles are more than the {limit} that are read; `--max-triangles {found}` reads them, and decimating the \
         model, in Blender for example, takes less time and memory"
    )]
    Triangles {
        /// In the file.
        found: usize,
        /// Allowed.
        limit: usize,
    },
    /// A surface without area has nothing to rig.
    #[error("none of its triangles has an area: there is no surface to rig; export the model again, at its own size")]
    NoArea,
    /// Sparse accessors replace elements by number.
    #[error("accessor {accessor}: a sparse index is {index}, out of range of its {count} elements")]
    SparseIndex {
        /// Which accessor.
        accessor: usize,
        /// The index.
        index: usize,
        /// How many elements there are.
        count: usize,
    },
    /// NaN or infinity.
    #[error("accessor {accessor} ({used}) has a number that is not finite (NaN or infinity) in element {element}")]
    NotFinite {
        /// Which accessor.
        accessor: usize,
        /// What it is used as.
        used: &'static str,
        /// Which element.
        element: usize,
    },

    /// Modes are 0 to 6.
    #[error("{place} has mode {mode}, which does not exist")]
    Mode {
        /// Where.
        place: Place,
        /// The number.
        mode: u32,
    },
    /// Attributes go together.
    #[error("{place}: {attribute} has {found} elements, POSITION has {wanted}")]
    AttributeCount {
        /// Where.
        place: Place,
        /// Which attribute.
        attribute: String,
        /// Its count.
        found: usize,
        /// The count of the positions.
        wanted: usize,
    },
    /// A skin needs both.
    #[error("{place} has joints without weights or weights without joints: {missing} is missing")]
    AttributeMissing {
        /// Where.
        place: Place,
        /// The attribute that is not there.
        missing: String,
    },
    /// A triangle of a vertex that is not there.
    #[error("{place} names vertex {vertex}, an index out of range: there are {count}")]
    VertexIndex {
        /// Where.
        place: Place,
        /// The index.
        vertex: u32,
        /// How many vertices there are.
        count: usize,
    },
    /// A weight on a joint that is not there.
    #[error("{place}: vertex {vertex} has a weight on joint {joint}, its skin {skin} has {count} joints")]
    JointIndex {
        /// Where.
        place: Place,
        /// Which vertex.
        vertex: usize,
        /// The index into the skin.
        joint: usize,
        /// Which skin.
        skin: usize,
        /// How many joints that has.
        count: usize,
    },
    /// Transforms took a vertex beyond what fits.
    #[error("{place}: vertex {vertex} comes to lie at a place that is not finite")]
    VertexNotFinite {
        /// Where.
        place: Place,
        /// Which vertex.
        vertex: u32,
    },

    /// A node is a child once.
    #[error("node {node} has two parents, nodes {first} and {second}")]
    TwoParents {
        /// Which node.
        node: usize,
        /// One parent.
        first: usize,
        /// The other; the same when it is listed twice.
        second: usize,
    },
    /// A node above itself.
    #[error("node {0} lies in a cycle: it is its own parent, directly or by others")]
    Cycle(usize),
    /// Skins list joints.
    #[error("skin {0} has no joints")]
    EmptySkin(usize),
    /// A slot a node.
    #[error("skin {skin} has a duplicate joint: node {node} is listed twice, so its bind pose is ambiguous")]
    JointTwice {
        /// Which skin.
        skin: usize,
        /// Which node.
        node: usize,
    },
    /// A matrix a joint.
    #[error("skin {skin} has {found} inverse bind matrices for {wanted} joints")]
    InverseBindCount {
        /// Which skin.
        skin: usize,
        /// Matrices in its accessor.
        found: usize,
        /// Joints it lists.
        wanted: usize,
    },
    /// No bind pose follows from it.
    #[error("skin {skin}: the inverse bind matrix of joint {joint} (node {node}) is singular, it cannot be inverted")]
    Singular {
        /// Which skin.
        skin: usize,
        /// Which of its joints.
        joint: usize,
        /// That joint's node.
        node: usize,
    },
    /// Transforms took a joint beyond what fits.
    #[error("joint `{name}` (node {node}) comes to lie at a place that is not finite")]
    JointNotFinite {
        /// Its name.
        name: String,
        /// Its node.
        node: usize,
    },

    /// Nothing to see.
    #[error("the file has no mesh with triangles")]
    NoMesh,
    /// Meshes and skins that do not meet.
    #[error("the file has a skeleton, but no mesh with triangles is bound to it")]
    NothingBound,
    /// Asked for a rig, found a mesh.
    #[error(
        "the file has a mesh but no skin, so there is no rig: there is nothing to learn from or to convert but the mesh \
         (`riglab rig` makes a rig for it; `riglab dataset import --meshes` takes the mesh alone)"
    )]
    NoSkeleton,
    /// A text, npz, h5 or pt file.
    #[error(transparent)]
    Peer(#[from] PeerFault),
    /// What was read does not make a rig.
    #[error("no valid rig: {0}")]
    Rig(#[from] RigError),
}

impl Fault {
    /// A file that the system does not give.
    pub(crate) fn unreadable(error: &std::io::Error) -> Self {
        Self::Unreadable(match error.kind() {
            std::io::ErrorKind::NotFound => "there is no such file".into(),
            _ => error.to_string(),
        })
    }

    /// What to do about it, where the sentence of the fault does not say so: it is told of a rig that is left out, too.
    fn remedy(&self) -> &'static str {
        if self.is_of_rig() { "; `riglab rig` makes a new rig for it" } else { "" }
    }

    /// Whether it is the rig that is broken, skin or weights, and not the mesh.
    fn is_of_rig(&self) -> bool {
        match self {
            Self::NotFinite { used, .. } | Self::AccessorType { used, .. } => OF_RIG.contains(used),
            Self::Reference { from, to, .. } => from.starts_with("skin ") || *to == "skin",
            Self::AttributeCount { .. }
            | Self::AttributeMissing { .. }
            | Self::JointIndex { .. }
            | Self::EmptySkin(_)
            | Self::JointTwice { .. }
            | Self::InverseBindCount { .. }
            | Self::Singular { .. }
            | Self::JointNotFinite { .. } => true,
            _ => false,
        }
    }

    /// Whether the file may be sound without its rig: a fault of it, or one of bytes that does not tell whose they are.
    pub(crate) fn may_lie_in_rig(&self) -> bool {
        let of_bytes = matches!(
            self,
            Self::Reference { .. }
                | Self::ViewBounds { .. }
                | Self::AccessorBounds { .. }
                | Self::Stride { .. }
                | Self::ComponentType { .. }
                | Self::AccessorType { .. }
                | Self::SparseIndex { .. }
                | Self::Compressed { .. }
                | Self::VertexNotFinite { .. }
        );
        self.is_of_rig() || of_bytes
    }
}

/// What accessors of a rig are used as.
const OF_RIG: [&str; 3] = ["JOINTS", "WEIGHTS", "inverse bind matrices"];

/// Some names with their numbers.
fn listed(names: &[String]) -> String {
    const SHOWN: usize = 10;
    if names.is_empty() {
        return "none".into();
    }
    let shown: Vec<_> = names.iter().take(SHOWN).enumerate().map(|(i, name)| format!("{i} (`{name}`)")).collect();
    let more = names.len().saturating_sub(SHOWN);
    shown.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

/// What an extension does that is not read, and what helps.
fn unread(extension: &str) -> &'static str {
    match extension {
        "EXT_mesh_gpu_instancing" => {
            "which draws a mesh several times on one node, so that no joint could move one copy alone; make real copies of \
             them first, in the program that the file comes from"
        }
        _ => "which is not known; export the file without it",
    }
}
