//! The fields of a corpus file.
//!
//! Readable with any HDF5 library; with h5py for instance:
//!
//! ```python
//! f = h5py.File("corpus.h5")
//! i = list(f["name"].asstr()).index("fox.glb")
//! v0, v1 = f["vertex_offsets"][i:i + 2]
//! vertices = f["vertices"][v0:v1]
//! w0, w1 = f["weight_offsets"][i:i + 2]
//! rows = numpy.repeat(numpy.arange(v1 - v0), f["influences"][v0:v1])
//! columns, weights = f["weight_joints"][w0:w1], f["weights"][w0:w1]
//! ```
//!
//! n assets, V vertices, F triangles, J joints, W non-zero weights, C clips and M maps over all of them.
//! Positions are in each source's own units and axes (glTF: y up).
//!
//! | dataset | shape, type | what |
//! |---|---|---|
//! | `name` | n, string | identifies the asset; unique |
//! | `split` | n, string | `train`, `val`, `test_seen`, `test_new` or a name of the user's |
//! | `source`, `licence`, `author`, `category` | n, string | provenance; empty where unknown |
//! | `checksum` | n, string | BLAKE3 of the source file, hexadecimal; with those read beside it, as a glTF's buffers |
//! | `notes` | n, string | what the importer repaired or wants known, a line each |
//! | `digest` | n, string | BLAKE3 of the asset's arrays, for `riglab dataset verify` |
//! | `joint_names` | n, string | names in joint order, a line each |
//! | `humanoid` | n, string | JSON: the joint's number of each human bone, by its name in VRM 1.0; empty where none |
//! | `springs` | n, string | JSON: springs, colliders and groups of colliders (`riglab_core::Springs`); empty where none |
//! | `vertex_offsets`, `face_offsets`, `joint_offsets`, `weight_offsets`, `clip_offsets`, `map_offsets` | n + 1, i64 | where each asset's rows begin in the tables below |
//! | `vertices` | V × 3, f32 | positions at rest |
//! | `faces` | F × 3, u32 | corners, counted within the asset |
//! | `joints` | J × 3, f32 | heads at rest, parents before children |
//! | `parents` | J, i32 | counted within the asset; -1 for the root |
//! | `influences` | V, u16 | how many weights each vertex has |
//! | `weight_joints` | W, u16 | their joints, rising within a vertex |
//! | `weights` | W, f32 | their shares; each vertex' sum to 1 |
//! | `clip_names` | C, string | what the source calls each motion |
//! | `clip_rates` | C, f32 | frames a second |
//! | `clip_frames` | C, u32 | frames |
//! | `clip_maps` | M × 12, f32 | for each frame and joint of each clip, from rest to pose: where the axes go, then where the origin goes |
//!
//! Attributes of the file: `format` = `riglab-corpus`, `schema` = 2, `riglab_version`.

/// The attribute `format`.
pub const FORMAT: &str = "riglab-corpus";
/// The attribute `schema` that this code writes and reads.
pub const SCHEMA: u32 = 2;

/// Columns of strings, one an asset.
pub(crate) const TEXTS: [&str; 11] =
    ["name", "split", "source", "licence", "author", "category", "checksum", "notes", "digest", "humanoid", "springs"];
/// Where `split` stands among them.
pub(crate) const SPLIT: usize = 1;
/// Where `digest` stands among them.
pub(crate) const DIGEST: usize = 8;
/// Columns of strings with several lines, or several strings an asset.
pub(crate) const JOINT_NAMES: &str = "joint_names";
pub(crate) const CLIP_NAMES: &str = "clip_names";
/// Offsets, one more than assets.
pub(crate) const OFFSETS: [&str; 6] =
    ["vertex_offsets", "face_offsets", "joint_offsets", "weight_offsets", "clip_offsets", "map_offsets"];
