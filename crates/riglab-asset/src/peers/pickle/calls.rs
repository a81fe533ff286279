//! What calls in a pickle may make: arrays, types, tensors.

use super::super::fault::PeerFault;
use super::super::numbers::Dtype;
use super::machine::Machine;
use super::nodes::{Global, Id, Node, Stored, Tensor, View, kind};

/// Bytes of one number or text of numpy: names are shorter.
const MOST: usize = 4096;

impl Machine<'_, '_> {
    /// What a call gives.
    pub(super) fn call(&self, callable: Id, arguments: Id) -> Result<Node, PeerFault> {
        let Node::Global(callable) = *self.node(callable) else {
            return Err(self.fault(format!("it calls {}", kind(self.node(callable)))));
        };
        let Node::Tuple(arguments) = self.node(arguments) else {
            return Err(self.fault("it calls something without a tuple of arguments"));
        };
        match callable {
            Global::Reconstruct => Ok(Node::Array(None)),
            Global::Dtype => {
                let name = self.argument(arguments, 0)?.text().unwrap_or_default();
                // The type of an empty text, which arrays never have.
                let empty = (name == "U0").then_some(Dtype { kind: b'U', size: 0, big: false });
                let dtype = Dtype::parse(name).or(empty);
                dtype.map(Node::Dtype).ok_or_else(|| self.fault(format!("the type `{}` is not read", short(name))))
            }
            Global::Scalar => self.scalar(arguments),
            Global::OrderedDict => Ok(Node::Dict(Vec::new())),
            Global::RebuildTensor => self.tensor(arguments),
            Global::Ndarray | Global::RebuildParameter | Global::RebuildFromType | Global::Storage(_) => {
                Err(self.fault(format!("it calls the name {callable:?}")))
            }
        }
    }

    pub(super) fn argument(&self, arguments: &[Id], at: usize) -> Result<View<'_>, PeerFault> {
        let id = *arguments.get(at).ok_or_else(|| self.fault("a call has too few arguments"))?;
        Ok(View { nodes: &self.nodes, id })
    }

    /// A number or text of numpy: (type, bytes).
    fn scalar(&self, arguments: &[Id]) -> Result<Node, PeerFault> {
        let (dtype, bytes) = (self.argument(arguments, 0)?, self.argument(arguments, 1)?);
        match (dtype.node(), bytes.node()) {
            (Node::Dtype(dtype), Node::Bytes(bytes)) if bytes.len() == dtype.size && dtype.size <= MOST => {
                Ok(match dtype.kind {
                    b'i' | b'u' | b'b' => Node::Int(dtype.int(bytes)),
                    b'U' | b'S' => Node::Text(dtype.text(bytes).into()),
                    _ => Node::Float(dtype.float(bytes)),
                })
            }
            _ => Err(self.fault("a scalar of numpy has no type, or not its number of bytes")),
        }
    }

    /// Sets the state of an array or a type.
    pub(super) fn build(&mut self, target: Id, state: Id) -> Result<(), PeerFault> {
        if self.open {
            // The state of what is read over, or attributes of a dictionary.
            return Ok(());
        }
        let state = match (self.node(target), self.node(state)) {
            // The attributes of an ordered dictionary: none that matters.
            (Node::Dict(_), _) => return Ok(()),
            (_, Node::Tuple(state)) => &state[..state.len().min(8)],
            _ => return Err(self.fault("the state of an array is no tuple")),
        };
        let built = match self.node(target) {
            Node::Dtype(dtype) => Node::Dtype(self.typed(*dtype, state)?),
            Node::Array(_) => Node::Array(Some(Box::new(self.stored(state)?))),
            other => return Err(self.fault(format!("it sets the state of {}", kind(other)))),
        };
        self.replace(target, built)
    }

    /// (version, byte order, ..., element size at 5, ...)
    fn typed(&self, mut dtype: Dtype, state: &[Id]) -> Result<Dtype, PeerFault> {
        dtype.big = self.argument(state, 1)?.text() == Some(">");
        if matches!(dtype.kind, b'U' | b'S') {
            let size = self.argument(state, 5)?.int().and_then(|n| usize::try_from(n).ok());
            dtype.size = size.filter(|n| *n < 1 << 22).ok_or_else(|| self.fault("a type of text has no size"))?;
        }
        Ok(dtype)
    }

    /// (version, shape, type, Fortran's order, data)
    fn stored(&self, state: &[Id]) -> Result<Stored, PeerFault> {
        let shape = self.lengths(self.argument(state, 1)?)?;
        let Node::Dtype(dtype) = *self.argument(state, 2)?.node() else {
            return Err(self.fault("an array has no type"));
        };
        let fortran = self.argument(state, 3)?.int() == Some(1);
        let data = self.argument(state, 4)?;
        let beside = match data.node() {
            Node::Bytes(bytes) => dtype.unpacked(bytes.len()),
            Node::List(_) => 0,
            _ => return Err(self.fault("an array has no data")),
        };
        Ok(Stored { shape, dtype, fortran, data: data.id, beside })
    }

    fn lengths(&self, tuple: View<'_>) -> Result<Vec<usize>, PeerFault> {
        let all = tuple.members().filter(|m| m.len() <= 8);
        let all = all.and_then(|m| m.map(|v| usize::try_from(v.int()?).ok()).collect());
        all.ok_or_else(|| self.fault("a shape is no short list of lengths"))
    }

    /// ("storage", type, key, device, count)
    pub(super) fn storage(&self, id: Id) -> Result<Node, PeerFault> {
        let parts: Vec<View<'_>> = View { nodes: &self.nodes, id }.members().into_iter().flatten().take(3).collect();
        match parts[..] {
            // A storage of a type that is not known, or something else that lies outside.
            [_, kind, _] if self.open && !matches!(kind.node(), Node::Global(Global::Storage(_))) => Ok(Node::Foreign),
            _ if self.open && parts.len() < 3 => Ok(Node::Foreign),
            [word, kind, key] if word.text() == Some("storage") => match (kind.node(), key.text()) {
                (Node::Global(Global::Storage(dtype)), Some(key)) => {
                    Ok(Node::Storage { dtype: *dtype, key: key.into() })
                }
                _ => Err(self.fault("a storage has no known type or no key")),
            },
            _ => Err(self.fault("it refers to something that is no storage")),
        }
    }

    /// (storage, offset, shape, strides, ...)
    pub(super) fn tensor(&self, arguments: &[Id]) -> Result<Node, PeerFault> {
        let Node::Storage { dtype, key } = self.argument(arguments, 0)?.node() else {
            return Err(self.fault("a tensor has no storage"));
        };
        let offset = self.argument(arguments, 1)?.int().and_then(|n| usize::try_from(n).ok());
        let offset = offset.ok_or_else(|| self.fault("a tensor has no offset"))?;
        let shape = self.lengths(self.argument(arguments, 2)?)?;
        let strides = self.lengths(self.argument(arguments, 3)?)?;
        Ok(Node::Tensor(Box::new(Tensor { dtype: *dtype, key: key.clone(), offset, shape, strides })))
    }
}

fn short(name: &str) -> String {
    super::super::fault::shown(name)
}
