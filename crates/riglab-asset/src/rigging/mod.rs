//! A model in, the same model with a rig out: all of rigging that is not the making of the rig.
//!
//! [`Subject`] reads a model, rigged or not, of any format: one mesh with y up, and the document it came from. Whoever
//! makes a skeleton and weights for that mesh (a network, a template, a person) hands them to
//! [`Subject::attach`], which writes the document again with them; [`preview`](crate::export::preview) adds a
//! motion that bends every joint, to see whether the rig works.
//!
//! The one idea: **every model is a document first.** A glTF is one. A rig that is in it is taken out, an OBJ, FBX,
//! PLY or STL is made into one, and from there on there is one way: import, attach.
//!
//! Holds: the input file is never changed; the mesh is in the file's own units, so that whoever normalises it
//! loses nothing; a turn of axes rounds nothing; what was written reads back with the joints and weights that were
//! attached.
//!
//! Leaves out: what a good rig is.

mod beside;
mod doubts;
#[cfg(feature = "fbx")]
mod dressed;
#[cfg(feature = "fbx")]
mod fbx;
mod looks;
mod mended;
mod names;
mod normals;
mod note;
mod obj;
mod pieces;
mod seams;
mod stand;
mod subject;
mod surface;
mod up;

#[cfg(feature = "fbx")]
pub use dressed::dressed;
pub(crate) use looks::{Looks, Row, RowsOf, Unrigged};
pub use names::{NameStyle, human_bones, humanoid, name_added, name_bones, name_joints, name_others};
pub(crate) use normals::complete as complete_normals;
pub use note::SubjectNote;
pub(crate) use obj::read as obj_model;
pub use seams::{agreed, twins};
pub(crate) use subject::stood;
pub use subject::{Origin, Subject, SubjectOptions};
pub(crate) use surface::model as surface_model;
pub use up::UpAxis;
#[cfg(feature = "fbx")]
pub(crate) use {fbx::looks as fbx_looks, obj::stem, surface::encoded, surface::linear};
