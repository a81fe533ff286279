//! Named tensors as torch and Lightning save them.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use super::archive::Input;
use super::fault::{PeerFault, shown};
use super::numbers::{Dtype, Numbers, elements};
use super::pickle::{self, Id, Node, Tensor, View};
use super::torch::TorchArchive;
use crate::ImportError;

/// Where the table of tensors stands in a checkpoint, most telling first; else the whole file is one, or the dictionary in
/// it that holds most tensors.
const TABLES: [&str; 4] = ["state_dict", "model_state_dict", "model", "module"];
/// What Lightning keeps of a module's settings.
const SETTINGS: &str = "hyper_parameters";
/// Dictionaries looked through for a table or a setting, and numbers of a setting, at most.
const LOOKED: usize = 10_000;

/// The tensors of a checkpoint: a zip archive as `torch.save` writes it since torch 1.6, of a table of names and
/// tensors or of a dictionary with one, as Lightning's `.ckpt` is.
///
/// What else the file holds (optimizers, settings, objects of any class) is read over; nothing is run, and nothing
/// that it names is looked up. Tensors are read when they are asked for.
pub struct TensorFile<'a> {
    name: String,
    file: TorchArchive<'a>,
    nodes: Vec<Node>,
    root: Id,
    table: BTreeMap<String, Box<Tensor>>,
    unread: Vec<String>,
    /// The storage that was read last: tensors that share one stand together.
    last: Option<(String, Vec<u8>)>,
}

/// A tensor of a [`TensorFile`].
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTensor {
    /// The type of its elements.
    pub kind: StoredKind,
    /// Lengths of its axes; none for a single number.
    pub shape: Vec<usize>,
    /// Its elements one after another, last axis fastest, least significant byte first.
    pub bytes: Vec<u8>,
}

/// How an element is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // the names say it
pub enum StoredKind {
    F64,
    F32,
    F16,
    Bf16,
    I64,
    I32,
    I16,
    I8,
    U8,
    Bool,
}

impl StoredKind {
    fn of(dtype: Dtype) -> Option<Self> {
        Some(match (dtype.kind, dtype.size) {
            (b'f', 8) => Self::F64,
            (b'f', 4) => Self::F32,
            (b'f', 2) => Self::F16,
            (b'g', 2) => Self::Bf16,
            (b'i', 8) => Self::I64,
            (b'i', 4) => Self::I32,
            (b'i', 2) => Self::I16,
            (b'i', 1) => Self::I8,
            (b'u', 1) => Self::U8,
            (b'b', 1) => Self::Bool,
            _ => return None,
        })
    }
}

impl<'a> TensorFile<'a> {
    /// Opens a file and reads its table; tensors are looked at later.
    ///
    /// # Errors
    /// What is wrong with the file, with its path before it.
    pub fn open(path: &'a Path) -> Result<Self, ImportError> {
        Self::of(&path.to_string_lossy(), Input::File(path))
    }

    /// As [`Self::open`], of bytes in memory; `name` stands in messages.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn from_bytes(name: &str, bytes: &'a [u8]) -> Result<Self, ImportError> {
        Self::of(name, Input::Bytes(bytes))
    }

    fn of(name: &str, input: Input<'a>) -> Result<Self, ImportError> {
        let fail = |fault: PeerFault| ImportError::new(name, fault.into());
        let mut file = TorchArchive::open(input).map_err(fail)?;
        let bytes = file.pickle().map_err(fail)?;
        let read = pickle::read_tensors("data.pkl", &mut &bytes[..], &mut file.archive.budget);
        let (nodes, root) = read.map_err(fail)?;
        file.archive.budget.give_back(bytes.len() as u64);
        let view = View { nodes: &nodes, id: root };
        let usual = TABLES.iter().filter_map(|key| view.get(key)).chain([view]).find(|v| !table(*v).is_empty());
        let found = usual.or_else(|| fullest(view)).ok_or_else(|| {
            let reason = "holds no table of named tensors; save the model's `state_dict()` with torch.save";
            fail(PeerFault::field("data.pkl", reason))
        })?;
        let (table, unread) = (table(found), unread(found));
        let length = input.len().map_or(0, |n| usize::try_from(n).unwrap_or(usize::MAX));
        let too_large =
            |t: &Tensor| elements(&t.shape).and_then(|n| n.checked_mul(t.dtype.size)).is_none_or(|n| n > length);
        if let Some((tensor, _)) = table.iter().find(|(_, t)| too_large(t)) {
            return Err(fail(PeerFault::field(&shown(tensor), "claims more numbers than the file has bytes for")));
        }
        Ok(Self { name: name.to_owned(), file, nodes, root, table, unread, last: None })
    }

    /// Names and shapes, sorted.
    pub fn shapes(&self) -> impl Iterator<Item = (&str, &[usize])> {
        self.table.iter().map(|(name, tensor)| (name.as_str(), tensor.shape.as_slice()))
    }

    /// Names in the table whose values are objects of a kind that is not read: tensors of other types (float8, complex,
    /// quantized), sparse ones and those on no device among them.
    pub fn unread(&self) -> &[String] {
        &self.unread
    }

    /// Steps of training that Lightning counted, if it says.
    pub fn step(&self) -> Option<u64> {
        View { nodes: &self.nodes, id: self.root }.get("global_step")?.int()?.try_into().ok()
    }

    /// A setting of the module by its key, wherever in Lightning's settings it stands: a whole number or a list of
    /// them.
    pub fn setting(&self, key: &str) -> Option<Vec<i64>> {
        let settings = View { nodes: &self.nodes, id: self.root }.get(SETTINGS)?;
        dictionaries(settings).into_iter().filter_map(|view| view.get(key)).find_map(|found| {
            let list = found.members().map(|all| all.take(LOOKED).map(View::int).collect());
            list.unwrap_or_else(|| found.int().map(|n| vec![n]))
        })
    }

    /// A tensor; `None` where there is none of the name.
    ///
    /// # Errors
    /// When its bytes are missing, damaged or fewer than its shape claims; the file's path stands before it.
    pub fn read(&mut self, name: &str) -> Result<Option<StoredTensor>, ImportError> {
        let Some(tensor) = self.table.get(name).cloned() else { return Ok(None) };
        let read = self.stored(&shown(name), &tensor);
        read.map(Some).map_err(|fault| ImportError::new(&self.name, fault.into()))
    }

    fn stored(&mut self, name: &str, tensor: &Tensor) -> Result<StoredTensor, PeerFault> {
        let fault = |reason: &str| PeerFault::field(name, reason);
        let mut dtype = tensor.dtype;
        dtype.big = self.file.big;
        let kind = StoredKind::of(dtype).ok_or_else(|| fault("has elements of a type that is not read"))?;
        if self.last.as_ref().is_none_or(|(key, _)| *key != *tensor.key) {
            if let Some((_, bytes)) = self.last.take() {
                self.file.archive.budget.give_back(bytes.len() as u64);
            }
            self.last = Some((tensor.key.to_string(), self.file.storage(&tensor.key)?));
        }
        let all = self.last.as_ref().map_or(&[][..], |(_, bytes)| bytes);
        let from = tensor.offset.checked_mul(dtype.size).filter(|from| *from <= all.len());
        let own = &all[from.ok_or_else(|| fault("starts beyond its storage"))?..];
        let (shape, strides) = (tensor.shape.clone(), tensor.strides.clone());
        let whole = elements(&shape).and_then(|count| count.checked_mul(dtype.size));
        let bytes = match whole.and_then(|length| own.get(..length)) {
            Some(own) if !dtype.big && in_order(&shape, &strides) => own.to_vec(),
            _ => {
                let numbers = Numbers::strided(shape.clone(), strides, dtype, Cow::Borrowed(own));
                numbers.map_err(|reason| fault(&reason))?.packed()
            }
        };
        Ok(StoredTensor { kind, shape, bytes })
    }
}

/// The tensors of a dictionary, by name.
fn table(view: View<'_>) -> BTreeMap<String, Box<Tensor>> {
    let tensor = |(name, value): (&str, View<'_>)| match value.node() {
        Node::Tensor(tensor) => Some((name.to_owned(), tensor.clone())),
        _ => None,
    };
    view.entries().filter_map(tensor).collect()
}

/// Names of a dictionary's objects of a kind that is not known.
fn unread(view: View<'_>) -> Vec<String> {
    view.entries().filter(|(_, value)| matches!(value.node(), Node::Foreign)).map(|(name, _)| name.to_owned()).collect()
}

/// A dictionary and those that stand in it and in one another, the nearest first, [`LOOKED`] at most. Each is there once: files
/// may put one into itself as often as they like.
fn dictionaries(root: View<'_>) -> Vec<View<'_>> {
    let (mut all, mut known, mut at) = (vec![root], HashSet::from([root.id]), 0);
    while at < all.len() && all.len() < LOOKED {
        let within = all[at].entries().map(|(_, value)| value).filter(|value| value.is_dict());
        let room = LOOKED - all.len();
        all.extend(within.filter(|value| known.insert(value.id)).take(room));
        at += 1;
    }
    all
}

/// The dictionary with most tensors of those that stand in one another; optimizers keep few in each.
fn fullest(root: View<'_>) -> Option<View<'_>> {
    let tensors = |view: &View<'_>| view.entries().filter(|(_, v)| matches!(v.node(), Node::Tensor(_))).count();
    // The first of those that hold as many.
    dictionaries(root).into_iter().rev().max_by_key(tensors).filter(|view| tensors(view) > 0)
}

/// Whether elements stand one after another, last axis fastest.
fn in_order(shape: &[usize], strides: &[usize]) -> bool {
    let mut step = 1usize;
    shape.len() == strides.len()
        && shape.iter().zip(strides).rev().all(|(length, stride)| {
            let fits = *length == 1 || *stride == step;
            step = step.saturating_mul(*length);
            fits
        })
}
