//! Why a file of a peer's format cannot be read.

use thiserror::Error;

/// One way in which a text, npz, h5 or pt file can be wrong. Numbers count from 0 as in the file, but
/// lines from 1 as in editors.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PeerFault {
    /// A line of a text file.
    #[error("line {line}: {reason}")]
    Line {
        /// Which line.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A text without any joint.
    #[error("no line of the text starts with `joints`: neither a rig text nor a list of data folders")]
    NoRigText,
    /// Text in another encoding.
    #[error("the text is not UTF-8 from byte {0} on; save it as UTF-8")]
    NotUtf8(usize),
    /// The mesh of a rig text lies in a file of its own.
    #[error("the mesh that belongs to the rig text is missing: none of {0} is there, or only that of another text")]
    NoObjBeside(String),

    /// A container that cannot be opened.
    #[error("not a readable zip archive: {0}; the file may be cut short: fetch or write it again")]
    Zip(String),
    /// An archive of other things.
    #[error("the archive holds none of the known sets of arrays; its members are {0}")]
    UnknownMembers(String),
    /// Header or data of an NPY member.
    #[error("member `{member}` is no readable array: {reason}")]
    Npy {
        /// Which member.
        member: String,
        /// What is wrong.
        reason: String,
    },
    /// A pickle that does more than build arrays, lists, strings and numbers.
    #[error(
        "the pickle in `{member}` names `{global}`, which is not among the few names that data needs; nothing was run"
    )]
    ForbiddenGlobal {
        /// Which member.
        member: String,
        /// The name.
        global: String,
    },
    /// A pickle that is no pickle.
    #[error("the pickle in `{member}` cannot be read: {reason}")]
    Pickle {
        /// Which member.
        member: String,
        /// What is wrong.
        reason: String,
    },
    /// Before torch 1.6.
    #[error(
        "not a zip archive: a file of torch before 1.6, or none of torch; load it with torch and save it again, \
         which writes the zip form"
    )]
    LegacyTorch,
    /// HDF5 that cannot be read.
    #[error("cannot be read as HDF5: {0}")]
    Hdf5(String),
    /// What `riglab dataset import` makes.
    #[error(
        "it is a corpus of riglab, not a model: `riglab dataset inspect` lists its assets, `riglab convert --to glb` \
         writes them as files"
    )]
    Corpus,
    /// More than the file can honestly hold.
    #[error("{0} would take more memory than a file of this size may; it is damaged or made to harm")]
    TooLarge(String),

    /// An array that is not as its format has it.
    #[error("`{field}` {reason}")]
    Field {
        /// Its name.
        field: String,
        /// What is wrong.
        reason: String,
    },
    /// A number that names nothing.
    #[error("{what} names {to} {index}, which is out of range: there are {count}")]
    Index {
        /// What names it.
        what: String,
        /// The kind of thing named.
        to: &'static str,
        /// Its number.
        index: i64,
        /// How many there are.
        count: usize,
    },
    /// NaN or infinity.
    #[error("{what} is not finite (NaN or infinity)")]
    NotFinite {
        /// Which number.
        what: String,
    },
    /// Joints above themselves.
    #[error("joint {0} is not reachable from a root: it lies in a cycle or below one")]
    JointCycle(String),
    /// Joints have one parent.
    #[error("joint {joint} has two parents, {first} and {second}")]
    TwoJointParents {
        /// Which joint.
        joint: String,
        /// One.
        first: String,
        /// The other.
        second: String,
    },
    /// The root the file names is not one.
    #[error("the root is said to be joint {root}, but joint {parent} is its parent")]
    RootHasParent {
        /// The joint.
        root: String,
        /// Its parent.
        parent: String,
    },
    /// A joint beside the tree.
    #[error(
        "joint {0} is not reachable from the root: no `hier` line leads there; `riglab convert IN OUT --repair` puts it below the root"
    )]
    Unreachable(String),
    /// No weights at all.
    #[error("there is a skeleton, but no weight on any vertex: the file is the output of a skeleton stage, not a rig")]
    NoWeights,
    /// Points instead of a surface.
    #[error("there are {0} points, but no faces between them: no mesh to rig")]
    PointsOnly(usize),
    /// Joints whose parents are elsewhere.
    #[error("there are joints, but nothing says which is whose parent")]
    NoParents,
    /// Nothing but joints.
    #[error("there is a skeleton, but no mesh")]
    SkeletonOnly,

    /// Which one?
    #[error(
        "the file holds {0} assets; `--item N` of `riglab view`, `inspect` and `convert` takes one, by its number from 0; `riglab dataset import` takes all"
    )]
    Several(usize),
    /// Not that many.
    #[error("there is no asset {item}: the file holds {count}, counted from 0")]
    NoSuchItem {
        /// Asked for.
        item: usize,
        /// In the file.
        count: usize,
    },
    /// No asset at all.
    #[error("the file holds no asset")]
    NoAsset,
}

impl PeerFault {
    /// A field that is not as its format has it.
    pub(crate) fn field(field: &str, reason: impl Into<String>) -> Self {
        Self::Field { field: field.to_owned(), reason: reason.into() }
    }
}

/// Text of a file, made fit for a message: cut where it is long, control characters escaped.
pub(crate) fn shown(text: &str) -> String {
    let mut out: String = text.chars().take(60).flat_map(char::escape_debug).collect();
    if text.chars().nth(60).is_some() {
        out.push('…');
    }
    out
}
