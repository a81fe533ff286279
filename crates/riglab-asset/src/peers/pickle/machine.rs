//! The stack machine.

use std::io::Read;
use std::ops::ControlFlow;
use std::rc::Rc;

use super::super::budget::Budget;
use super::super::fault::{PeerFault, shown};
use super::members::heavy;
use super::nodes::{Global, Id, Node, View, kind};

/// What each value costs beside its text or bytes: the node, its places on the stack and in the memo.
const NODE: u64 = 56;

/// Values that every pickle shares, so that a byte that stands for one costs no node.
pub(super) const NONE: Id = 0;
const TRUE: Id = 1;
const FALSE: Id = 2;
const EMPTY: Id = 3;

/// What becomes of a member of the first list.
pub(crate) type Handed<'a> = &'a mut dyn FnMut(View<'_>) -> ControlFlow<()>;

/// Reads a pickle. With `each`, members of its first list are handed out one by one and are missing in
/// what is returned; `each` may end the reading, which gives `None`.
///
/// `member` names the pickle in messages.
pub(crate) fn read(
    member: &str,
    input: &mut dyn Read,
    budget: &mut Budget,
    each: Option<Handed<'_>>,
) -> Result<Option<(Vec<Node>, Id)>, PeerFault> {
    start(member, input, budget, each, false)
}

/// Reads a pickle of tensors among anything else, as checkpoints are: what is no tensor, dictionary, list, text or
/// number becomes [`Node::Foreign`], whatever its name.
pub(crate) fn read_tensors(
    member: &str,
    input: &mut dyn Read,
    budget: &mut Budget,
) -> Result<(Vec<Node>, Id), PeerFault> {
    let read = start(member, input, budget, None, true)?;
    // Nothing is handed out, so nothing ends the reading early.
    read.ok_or_else(|| PeerFault::Pickle { member: shown(member), reason: "it ends early".into() })
}

fn start(
    member: &str,
    input: &mut dyn Read,
    budget: &mut Budget,
    each: Option<Handed<'_>>,
    open: bool,
) -> Result<Option<(Vec<Node>, Id)>, PeerFault> {
    let nodes = vec![Node::None, Node::Bool(true), Node::Bool(false), Node::Tuple(Box::default())];
    let shared = nodes.len();
    let mut machine = Machine {
        member,
        input,
        budget,
        nodes,
        stack: Vec::new(),
        marks: Vec::new(),
        memo: Vec::new(),
        each,
        open,
        list: None,
        base: shared,
        released: shared,
        memo_base: 0,
        tuples: 0,
        held: 0,
    };
    Ok(match machine.run()? {
        ControlFlow::Break(()) => None,
        ControlFlow::Continue(id) => Some((machine.nodes, id)),
    })
}

pub(super) struct Machine<'a, 'b> {
    pub(super) member: &'a str,
    pub(super) input: &'a mut dyn Read,
    pub(super) budget: &'a mut Budget,
    pub(super) nodes: Vec<Node>,
    pub(super) stack: Vec<Id>,
    /// Where on the stack the open marks stand.
    pub(super) marks: Vec<usize>,
    pub(super) memo: Vec<Option<Id>>,
    pub(super) each: Option<Handed<'b>>,
    /// Whether names beyond the list are read over.
    pub(super) open: bool,
    /// The list whose members are handed out.
    pub(super) list: Option<Id>,
    /// Nodes below are kept when a member is let go.
    pub(super) base: usize,
    /// Nodes between there and here were looked through for what is heavy.
    pub(super) released: usize,
    /// Memo entries from here on may name nodes above `base`.
    pub(super) memo_base: usize,
    /// Tuples kept for later members.
    pub(super) tuples: usize,
    /// What nodes from `base` on cost.
    pub(super) held: u64,
}

impl Machine<'_, '_> {
    pub(super) fn fault(&self, reason: impl Into<String>) -> PeerFault {
        PeerFault::Pickle { member: shown(self.member), reason: reason.into() }
    }

    pub(super) fn node(&self, id: Id) -> &Node {
        View { nodes: &self.nodes, id }.node()
    }

    fn run(&mut self) -> Result<ControlFlow<(), Id>, PeerFault> {
        loop {
            let op = self.bytes::<1>()?[0];
            match op {
                b'.' => return Ok(ControlFlow::Continue(self.pop()?)),
                b'(' => {
                    self.budget.take(8, self.member)?;
                    self.marks.push(self.stack.len());
                }
                0x80 => {
                    let version = self.bytes::<1>()?[0];
                    if version > 5 {
                        return Err(self.fault(format!("its protocol is {version}, up to 5 are read")));
                    }
                }
                // A frame tells how many bytes may be read ahead, which the reader below does anyway.
                0x95 => drop(self.bytes::<8>()?),
                b'0' => drop(self.pop()?),
                _ => {
                    if self.step(op)?.is_break() {
                        return Ok(ControlFlow::Break(()));
                    }
                }
            }
        }
    }

    /// Whatever puts a value on the stack or fills one.
    fn step(&mut self, op: u8) -> Result<ControlFlow<()>, PeerFault> {
        let id = match op {
            b'N' => NONE,
            0x88 => TRUE,
            0x89 => FALSE,
            b')' => EMPTY,
            b'J' => self.bytes().map(|b| Node::Int(i32::from_le_bytes(b).into())).and_then(|n| self.add(n))?,
            b'K' => self.bytes::<1>().map(|b| Node::Int(b[0].into())).and_then(|n| self.add(n))?,
            b'M' => self.bytes().map(|b| Node::Int(u16::from_le_bytes(b).into())).and_then(|n| self.add(n))?,
            b'G' => self.bytes().map(|b| Node::Float(f64::from_be_bytes(b))).and_then(|n| self.add(n))?,
            0x8a => self.long(1).and_then(|n| self.add(n))?,
            0x8c | b'X' | 0x8d => self.text(op)?,
            b'C' | b'B' | 0x8e => {
                let length = self.length(match op {
                    b'C' => 1,
                    b'B' => 4,
                    _ => 8,
                })?;
                let bytes = self.take(length)?;
                self.add(Node::Bytes(bytes.into()))?
            }
            b']' => {
                let id = self.add(Node::List(Vec::new()))?;
                if self.each.is_some() && self.list.is_none() {
                    self.list = Some(id);
                    (self.base, self.released, self.held) = (self.nodes.len(), self.nodes.len(), 0);
                    self.memo_base = self.memo.len();
                }
                id
            }
            b'}' => self.add(Node::Dict(Vec::new()))?,
            b't' => {
                let items = self.pop_mark()?;
                self.tuple(items)?
            }
            0x85..=0x87 => {
                let from = self.depth(usize::from(op - 0x84))?;
                let items = self.stack.split_off(from);
                self.tuple(items)?
            }
            b'a' => return self.append_one(),
            b'e' => return self.append_all(),
            b's' | b'u' => {
                self.set_items(op)?;
                return Ok(ControlFlow::Continue(()));
            }
            b'q' | b'r' | 0x94 => {
                self.memoize(op)?;
                return Ok(ControlFlow::Continue(()));
            }
            b'h' | b'j' => {
                let index = self.length(if op == b'h' { 1 } else { 4 })?;
                let found = usize::try_from(index).ok().and_then(|i| self.memo.get(i).copied().flatten());
                let id = found.ok_or_else(|| {
                    self.fault(format!(
                        "value {index} is used again, but was not stored or belongs to an earlier asset"
                    ))
                })?;
                self.budget.take(8, self.member)?;
                id
            }
            b'c' | 0x93 => self.global(op)?,
            b'R' => {
                let (arguments, callable) = (self.pop()?, self.pop()?);
                let node =
                    if self.open { self.call_any(callable, arguments)? } else { self.call(callable, arguments)? };
                self.add(node)?
            }
            b'b' => {
                let state = self.pop()?;
                let target = self.top()?;
                self.build(target, state)?;
                return Ok(ControlFlow::Continue(()));
            }
            b'Q' => {
                let id = self.pop()?;
                let node = self.storage(id)?;
                self.add(node)?
            }
            _ if self.open => match self.step_beyond(op)? {
                Some(id) => id,
                None => return Ok(ControlFlow::Continue(())),
            },
            _ => return Err(self.fault(format!("it has the instruction {op:#04x}, which data does not need"))),
        };
        let done = self.hand_out_finished()?;
        self.stack.push(id);
        Ok(done)
    }

    fn append_one(&mut self) -> Result<ControlFlow<()>, PeerFault> {
        let (item, list) = (self.pop()?, self.top()?);
        self.extend(list, &[item])
    }

    pub(super) fn append_all(&mut self) -> Result<ControlFlow<()>, PeerFault> {
        let items = self.pop_mark()?;
        let list = self.top()?;
        self.extend(list, &items)
    }

    fn extend(&mut self, list: Id, items: &[Id]) -> Result<ControlFlow<()>, PeerFault> {
        if self.list == Some(list) {
            return self.hand_out(items, 0);
        }
        self.become_of(list, || Node::List(Vec::new()));
        let Some(Node::List(ids)) = self.nodes.get_mut(list as usize) else {
            // Of what is read over, one of both is enough.
            let fault = self.fault("it appends to what is no list");
            return if self.open { Ok(ControlFlow::Continue(())) } else { Err(fault) };
        };
        ids.extend_from_slice(items);
        Ok(ControlFlow::Continue(()))
    }

    fn set_items(&mut self, op: u8) -> Result<(), PeerFault> {
        let items = if op == b'u' {
            self.pop_mark()?
        } else {
            let from = self.depth(2)?;
            self.stack.split_off(from)
        };
        let dict = self.top()?;
        self.become_of(dict, || Node::Dict(Vec::new()));
        let Some(Node::Dict(pairs)) = self.nodes.get_mut(dict as usize) else {
            let fault = self.fault("it sets keys of what is no dictionary");
            return if self.open { Ok(()) } else { Err(fault) };
        };
        pairs.extend(items.as_chunks::<2>().0.iter().map(|[key, value]| (*key, *value)));
        Ok(())
    }

    fn memoize(&mut self, op: u8) -> Result<(), PeerFault> {
        let index = match op {
            b'q' => self.length(1)? as usize,
            b'r' => self.length(4)? as usize,
            _ => self.memo.len(),
        };
        let id = self.top()?;
        // Numbers rise by one in what Python writes; gaps are allowed, far jumps are not.
        if index > self.memo.len() + 1024 {
            return Err(self.fault(format!("it stores value {index} after {}", self.memo.len())));
        }
        if index >= self.memo.len() {
            self.budget.take(8 * (index + 1 - self.memo.len()) as u64, self.member)?;
            self.memo.resize(index + 1, None);
        }
        self.memo[index] = Some(id);
        Ok(())
    }

    fn global(&mut self, op: u8) -> Result<Id, PeerFault> {
        let (module, name) = if op == b'c' {
            (self.line()?, self.line()?)
        } else {
            let (name, module) = (self.pop()?, self.pop()?);
            (self.text_of(module)?.to_string(), self.text_of(name)?.to_string())
        };
        if self.open {
            return self.add(Global::of_tensors(&module, &name).map_or(Node::Foreign, Node::Global));
        }
        let known = Global::of(&module, &name).ok_or_else(|| {
            // The older protocols write the name that Python 2 had for it.
            let module = if module == "__builtin__" { "builtins" } else { &module };
            PeerFault::ForbiddenGlobal { member: shown(self.member), global: shown(&format!("{module}.{name}")) }
        })?;
        self.add(Node::Global(known))
    }

    pub(super) fn text_of(&self, id: Id) -> Result<Rc<str>, PeerFault> {
        match self.node(id) {
            Node::Text(text) => Ok(text.clone()),
            other => Err(self.fault(format!("{} stands where text should", kind(other)))),
        }
    }

    pub(super) fn tuple(&mut self, items: Vec<Id>) -> Result<Id, PeerFault> {
        self.budget.take(4 * items.len() as u64, self.member)?;
        self.add(Node::Tuple(items.into()))
    }

    pub(super) fn add(&mut self, node: Node) -> Result<Id, PeerFault> {
        self.budget.take(NODE, self.member)?;
        self.held += NODE + heavy(&node).unwrap_or(0);
        self.nodes.push(node);
        Id::try_from(self.nodes.len() - 1).map_err(|_| self.fault("it has too many values"))
    }

    /// Puts an array's or a type's state in its place.
    pub(super) fn replace(&mut self, target: Id, built: Node) -> Result<(), PeerFault> {
        let more = heavy(&built).unwrap_or(0);
        self.budget.take(more, self.member)?;
        self.held += more;
        if let Some(node) = self.nodes.get_mut(target as usize) {
            *node = built;
        }
        Ok(())
    }

    pub(super) fn pop(&mut self) -> Result<Id, PeerFault> {
        let from = self.depth(1)?;
        Ok(self.stack.split_off(from)[0])
    }

    pub(super) fn top(&self) -> Result<Id, PeerFault> {
        Ok(self.stack[self.depth(1)?])
    }

    /// Where the topmost `count` values above the last mark begin.
    fn depth(&self, count: usize) -> Result<usize, PeerFault> {
        let floor = self.marks.last().copied().unwrap_or(0);
        let from = self.stack.len().checked_sub(count).filter(|from| *from >= floor);
        from.ok_or_else(|| self.fault("it takes more values than there are"))
    }

    pub(super) fn pop_mark(&mut self) -> Result<Vec<Id>, PeerFault> {
        let mark = self.marks.pop().ok_or_else(|| self.fault("it ends a group that was not begun"))?;
        Ok(self.stack.split_off(mark))
    }
}
