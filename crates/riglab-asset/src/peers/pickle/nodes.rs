//! What a pickle builds, without anything that could act.

use std::rc::Rc;

use super::super::fault::{PeerFault, shown};
use super::super::numbers::{Dtype, Numbers};

/// Number of a node.
pub(crate) type Id = u32;

/// A value. Values name each other by number, so that deep nesting and cycles, which hostile files
/// have, cost neither stack nor memory.
#[derive(Clone, Debug)]
pub(crate) enum Node {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(Rc<str>),
    Bytes(Rc<[u8]>),
    Tuple(Box<[Id]>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    Global(Global),
    Dtype(Dtype),
    /// An array before and after its state is set.
    Array(Option<Box<Stored>>),
    /// The bytes of a torch tensor, elsewhere in the archive.
    Storage {
        dtype: Dtype,
        key: Rc<str>,
    },
    Tensor(Box<Tensor>),
    /// Of a class or function that is not known, where such are read over.
    Foreign,
    /// Part of an asset that was handed out already.
    Gone,
}

/// The few names that pickled data needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Global {
    Reconstruct,
    Scalar,
    Ndarray,
    Dtype,
    OrderedDict,
    RebuildTensor,
    /// Beside those, of checkpoints: a tensor that is a parameter, and one of another class.
    RebuildParameter,
    RebuildFromType,
    Storage(Dtype),
}

impl Global {
    /// The known one of this name.
    pub(crate) fn of(module: &str, name: &str) -> Option<Self> {
        let storage = |kind, size| Some(Self::Storage(Dtype { kind, size, big: false }));
        match (module, name) {
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => Some(Self::Reconstruct),
            ("numpy.core.multiarray" | "numpy._core.multiarray", "scalar") => Some(Self::Scalar),
            ("numpy", "ndarray") => Some(Self::Ndarray),
            ("numpy", "dtype") => Some(Self::Dtype),
            ("collections", "OrderedDict") => Some(Self::OrderedDict),
            ("torch._utils", "_rebuild_tensor_v2") => Some(Self::RebuildTensor),
            ("torch", "FloatStorage") => storage(b'f', 4),
            ("torch", "DoubleStorage") => storage(b'f', 8),
            ("torch", "HalfStorage") => storage(b'f', 2),
            ("torch", "BFloat16Storage") => storage(b'g', 2),
            ("torch", "LongStorage") => storage(b'i', 8),
            ("torch", "IntStorage") => storage(b'i', 4),
            ("torch", "ShortStorage") => storage(b'i', 2),
            ("torch", "CharStorage") => storage(b'i', 1),
            ("torch", "ByteStorage") => storage(b'u', 1),
            ("torch", "BoolStorage") => storage(b'b', 1),
            _ => None,
        }
    }

    /// As [`Self::of`], of names that stand for tensors and dictionaries alone.
    pub(crate) fn of_tensors(module: &str, name: &str) -> Option<Self> {
        match (module, name) {
            ("torch._utils", "_rebuild_parameter" | "_rebuild_parameter_with_state") => Some(Self::RebuildParameter),
            ("torch._tensor", "_rebuild_from_type_v2") => Some(Self::RebuildFromType),
            ("torch" | "torch._utils" | "collections", _) => Self::of(module, name),
            _ => None,
        }
    }
}

/// An array of numpy.
#[derive(Clone, Debug)]
pub(crate) struct Stored {
    pub shape: Vec<usize>,
    pub dtype: Dtype,
    pub fortran: bool,
    /// Bytes, or a list for an array of objects.
    pub data: Id,
    /// Bytes that reading it takes beside those of `data`.
    pub beside: u64,
}

/// A tensor of torch: where its elements lie in a storage.
#[derive(Clone, Debug)]
pub(crate) struct Tensor {
    pub dtype: Dtype,
    pub key: Rc<str>,
    pub offset: usize,
    pub shape: Vec<usize>,
    pub strides: Vec<usize>,
}

/// A value among the nodes, to look at.
#[derive(Clone, Copy)]
pub(crate) struct View<'a> {
    pub nodes: &'a [Node],
    pub id: Id,
}

impl<'a> View<'a> {
    fn at(self, id: Id) -> Self {
        Self { nodes: self.nodes, id }
    }

    pub(crate) fn node(self) -> &'a Node {
        self.nodes.get(self.id as usize).unwrap_or(&Node::Gone)
    }

    /// A value of a dictionary; the last of equal keys, as in Python.
    pub(crate) fn get(self, key: &str) -> Option<Self> {
        let Node::Dict(pairs) = self.node() else { return None };
        let found = pairs.iter().rev().find(|(k, _)| matches!(self.at(*k).node(), Node::Text(t) if **t == *key));
        found.map(|(_, value)| self.at(*value))
    }

    /// Keys that are text, with their values.
    pub(crate) fn entries(self) -> impl Iterator<Item = (&'a str, Self)> {
        let pairs: &'a [(Id, Id)] = if let Node::Dict(pairs) = self.node() { pairs } else { &[] };
        pairs.iter().filter_map(move |&(key, value)| Some((self.at(key).text()?, self.at(value))))
    }

    pub(crate) fn is_dict(self) -> bool {
        matches!(self.node(), Node::Dict(_))
    }

    pub(crate) fn is_none(self) -> bool {
        matches!(self.node(), Node::None)
    }

    pub(crate) fn text(self) -> Option<&'a str> {
        if let Node::Text(text) = self.node() { Some(text) } else { None }
    }

    pub(crate) fn int(self) -> Option<i64> {
        match self.node() {
            Node::Int(n) => Some(*n),
            Node::Bool(b) => Some(i64::from(*b)),
            Node::Float(x) if x.fract() == 0.0 && x.abs() < 9e15 => Some(*x as i64),
            _ => None,
        }
    }

    /// Numbers of the members of a list, tuple or array of objects.
    fn ids(self) -> Option<&'a [Id]> {
        match self.node() {
            Node::List(ids) => Some(ids),
            Node::Tuple(ids) => Some(ids),
            Node::Array(Some(stored)) => match self.at(stored.data).node() {
                Node::List(ids) => Some(ids),
                _ => None,
            },
            _ => None,
        }
    }

    /// Members of a list, tuple or array of objects.
    pub(crate) fn members(self) -> Option<impl ExactSizeIterator<Item = Self> + 'a> {
        self.ids().map(|ids| ids.iter().map(move |&id| self.at(id)))
    }

    /// An array of numbers or text.
    pub(crate) fn numbers(self, field: &str) -> Result<Numbers<'a>, PeerFault> {
        let Node::Array(Some(stored)) = self.node() else {
            return Err(PeerFault::field(field, "is no array"));
        };
        let Node::Bytes(bytes) = self.at(stored.data).node() else {
            return Err(PeerFault::field(field, "is an array of objects, not of numbers"));
        };
        Numbers::new(stored.shape.clone(), stored.dtype, stored.fortran, &bytes[..])
            .map_err(|reason| PeerFault::field(field, reason))
    }

    /// Names: a list of texts, or an array of text.
    pub(crate) fn texts(self, field: &str) -> Result<Vec<String>, PeerFault> {
        let Some(members) = self.members() else { return self.numbers(field)?.texts(field) };
        let text = |v: View<'_>| v.text().map(str::to_owned);
        members.map(text).collect::<Option<_>>().ok_or_else(|| PeerFault::field(field, "is no list of text"))
    }
}

/// What a message calls a value.
pub(crate) fn kind(node: &Node) -> String {
    match node {
        Node::Global(g) => format!("the name {g:?}"),
        Node::Text(t) => format!("the text `{}`", shown(t)),
        Node::None => "None".to_owned(),
        Node::Int(_) | Node::Float(_) | Node::Bool(_) => "a number".to_owned(),
        Node::Bytes(_) => "bytes".to_owned(),
        Node::Tuple(_) | Node::List(_) => "a list".to_owned(),
        Node::Dict(_) => "a dictionary".to_owned(),
        Node::Gone => "part of an earlier asset".to_owned(),
        Node::Tensor(_) => "a tensor".to_owned(),
        Node::Foreign => "an object of Python".to_owned(),
        _ => "an array".to_owned(),
    }
}
