//! What checkpoints have beside tensors: read over, run never.
//!
//! A checkpoint of training holds optimizers, settings and whatever else a program kept, of classes that are not
//! known here. Each becomes a [`Node::Foreign`]: a value that nothing can be done with, but to hold keys or members,
//! as classes made from dictionaries and lists do.

use super::super::fault::PeerFault;
use super::machine::Machine;
use super::nodes::{Global, Id, Node};

impl Machine<'_, '_> {
    /// Instructions that only checkpoints need. What is pushed, if anything.
    pub(super) fn step_beyond(&mut self, op: u8) -> Result<Option<Id>, PeerFault> {
        let id = match op {
            // An object of a class and arguments, or of a class, arguments and arguments by name.
            0x81 | 0x92 => {
                for _ in 0..if op == 0x81 { 2 } else { 3 } {
                    self.pop()?;
                }
                self.add(Node::Foreign)?
            }
            // Sets are read as lists.
            0x8f => self.add(Node::List(Vec::new()))?,
            0x90 => {
                // Nothing is handed out, so nothing is to end.
                let _ = self.append_all()?;
                return Ok(None);
            }
            0x91 => {
                let items = self.pop_mark()?;
                self.tuple(items)?
            }
            0x8b => self.long(4).and_then(|n| self.add(n))?,
            // Bytes that may change, and registered classes by number.
            0x96 => {
                let length = self.length(8)?;
                let bytes = self.take(length)?;
                self.add(Node::Bytes(bytes.into()))?
            }
            0x82..=0x84 => {
                self.length(usize::from(1u8 << (op - 0x82)))?;
                self.add(Node::Foreign)?
            }
            b'2' => {
                self.budget.take(8, self.member)?;
                self.top()?
            }
            b'1' => {
                self.pop_mark()?;
                return Ok(None);
            }
            _ => return Err(self.fault(format!("it has the instruction {op:#04x}, which is not read"))),
        };
        Ok(Some(id))
    }

    /// What a call of anything gives.
    pub(super) fn call_any(&self, callable: Id, arguments: Id) -> Result<Node, PeerFault> {
        let (Node::Global(name), Node::Tuple(all)) = (self.node(callable), self.node(arguments)) else {
            return Ok(Node::Foreign);
        };
        match name {
            Global::OrderedDict => Ok(Node::Dict(Vec::new())),
            Global::RebuildTensor => self.tensor_or_foreign(all),
            // (tensor, ...)
            Global::RebuildParameter => Ok(match self.argument(all, 0)?.node() {
                Node::Tensor(tensor) => Node::Tensor(tensor.clone()),
                _ => Node::Foreign,
            }),
            // (what makes it, its class, arguments, state)
            Global::RebuildFromType => match (self.argument(all, 0)?.node(), self.argument(all, 2)?.node()) {
                (Node::Global(Global::RebuildTensor), Node::Tuple(own)) => self.tensor_or_foreign(own),
                _ => Ok(Node::Foreign),
            },
            _ => Ok(Node::Foreign),
        }
    }

    fn tensor_or_foreign(&self, arguments: &[Id]) -> Result<Node, PeerFault> {
        match self.argument(arguments, 0)?.node() {
            Node::Foreign => Ok(Node::Foreign),
            _ => self.tensor(arguments),
        }
    }

    /// A value of an unknown class that is given keys or members is a dictionary or list of them.
    pub(super) fn become_of(&mut self, id: Id, made: impl FnOnce() -> Node) {
        if let Some(node) = self.nodes.get_mut(id as usize).filter(|node| matches!(node, Node::Foreign)) {
            *node = made();
        }
    }
}
