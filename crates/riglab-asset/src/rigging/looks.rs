//! A model with its looks, on the way to a document: what formats of surfaces hand to rigging.

use std::path::Path;

use riglab_core::{Clip, JointId, Rig, Skeleton};

use super::SubjectOptions;
use crate::Reading;
use crate::gltf::export::model::Model;

/// A file to read a model from.
pub(crate) struct Unrigged<'a> {
    /// Where it is, for messages and for how it is read.
    pub path: &'a Path,
    /// Its name without folder and ending.
    pub name: String,
    pub bytes: &'a [u8],
    /// Where what belongs to it is looked for, if at all.
    pub folder: Option<&'a Path>,
    pub options: &'a SubjectOptions,
}

/// A model with its looks, and what goes beside it.
pub(crate) struct Looks {
    pub model: Model,
    /// The file's own rig, where it is kept.
    pub rig: Option<Rig>,
    /// Which of its rows each vertex of the document is that the model becomes, by what is read of that.
    pub rows: Option<RowsOf>,
    /// The joints of that rig that stand beside its root in the file.
    pub loose: Vec<JointId>,
    /// Its motions.
    pub motions: Option<Motions>,
    /// How many animations the file has.
    pub animations: usize,
}

/// What a vertex is in the rig of its file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    /// The number of its row.
    pub number: usize,
    /// Whether it is of a part that hangs on one joint without a skin.
    pub rigid: bool,
}

/// Rows of the vertices of a document; none of what the rig does not hold.
pub(crate) type RowsOf = Box<dyn FnOnce(&Reading) -> Vec<Option<Row>>>;

/// Motions that go with a skeleton.
#[derive(Clone, Debug)]
pub(crate) struct Motions {
    pub skeleton: Skeleton,
    pub clips: Vec<Clip>,
}

impl From<Model> for Looks {
    fn from(model: Model) -> Self {
        Self { model, rig: None, rows: None, loose: Vec::new(), motions: None, animations: 0 }
    }
}
