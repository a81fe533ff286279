//! Members of the first list: handed out when they are complete, and let go of.

use std::ops::ControlFlow;

use super::super::fault::PeerFault;
use super::machine::{Machine, NONE};
use super::nodes::{Id, Node, View};

impl Machine<'_, '_> {
    /// A member of the first list is complete when the next one begins.
    pub(super) fn hand_out_finished(&mut self) -> Result<ControlFlow<()>, PeerFault> {
        let Some(&mark) = self.marks.last() else { return Ok(ControlFlow::Continue(())) };
        let below = mark.checked_sub(1).and_then(|at| self.stack.get(at));
        if self.list.is_none() || below != self.list.as_ref() || self.stack.len() != mark + 1 {
            return Ok(ControlFlow::Continue(()));
        }
        match self.node(self.stack[mark]) {
            Node::Dict(pairs) if !pairs.is_empty() => {
                let id = self.stack.pop().unwrap_or(NONE);
                // The value about to be pushed is a node already.
                self.hand_out(&[id], 1)
            }
            _ => Ok(ControlFlow::Continue(())),
        }
    }

    /// Hands out members and lets go of them; the last `keep` nodes belong to what follows.
    pub(super) fn hand_out(&mut self, members: &[Id], keep: usize) -> Result<ControlFlow<()>, PeerFault> {
        let Some(each) = self.each.as_mut() else { return Ok(ControlFlow::Continue(())) };
        for &id in members {
            if each(View { nodes: &self.nodes, id }).is_break() {
                return Ok(ControlFlow::Break(()));
            }
            // A member comes once, or a few bytes could ask for any amount of work.
            if let Some(node) = self.nodes.get_mut(id as usize).filter(|node| matches!(node, Node::Dict(_))) {
                *node = Node::Gone;
            }
        }
        if keep == 0 {
            self.let_go();
        } else {
            self.release_heavy(keep);
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Empties the nodes of finished members, but for the last `keep`: their numbers stay taken until
    /// the batch of members ends.
    fn release_heavy(&mut self, keep: usize) {
        let end = self.nodes.len().saturating_sub(keep);
        for at in self.released.min(end)..end {
            if let Some(bytes) = heavy(&self.nodes[at]) {
                self.nodes[at] = Node::Gone;
                self.budget.give_back(bytes);
                self.held = self.held.saturating_sub(bytes);
            }
        }
        self.released = end;
    }

    /// Drops the nodes of finished members. Text, types and names are kept where the memo holds them:
    /// later members refer to them. A hostile pickle may still hold numbers of dropped nodes, which is
    /// why every look-up bears with numbers that name nothing or something else.
    fn let_go(&mut self) {
        let finished = self.nodes.split_off(self.base);
        self.budget.give_back(self.held);
        self.held = 0;
        let mut moved = vec![None; finished.len()];
        for slot in &mut self.memo[self.memo_base..] {
            let at = slot.and_then(|id| (id as usize).checked_sub(self.base)).filter(|at| *at < finished.len());
            let Some(at) = at else { continue };
            if let (Node::Tuple(parts), None) = (&finished[at], moved[at]) {
                // Such as the shape that equal assets share; its numbers come with it.
                if let Some(plain) = plain_parts(parts, &finished, self.base).filter(|_| self.tuples < TUPLES) {
                    let first = self.nodes.len() as Id;
                    let ids = (first..).take(plain.len()).collect();
                    self.nodes.extend(plain);
                    self.nodes.push(Node::Tuple(ids));
                    moved[at] = Some(self.nodes.len() as Id - 1);
                    self.tuples += 1;
                }
                *slot = moved[at];
                continue;
            }
            if moved[at].is_some() {
                *slot = moved[at];
                continue;
            }
            let light = matches!(&finished[at], Node::Text(_) | Node::Dtype(_) | Node::Global(_))
                || matches!(&finished[at], Node::Bytes(b) if b.len() < 64);
            *slot = light.then(|| {
                *moved[at].get_or_insert_with(|| {
                    self.nodes.push(finished[at].clone());
                    self.nodes.len() as Id - 1
                })
            });
        }
        self.base = self.nodes.len();
        self.released = self.base;
        self.memo_base = self.memo.len();
    }
}

/// Tuples that are kept at most: no data has more that its assets share.
const TUPLES: usize = 4096;
/// Parts of a tuple that is kept.
const PARTS: usize = 8;

/// The parts of a small tuple of numbers and words, where it is one.
fn plain_parts(parts: &[Id], finished: &[Node], base: usize) -> Option<Vec<Node>> {
    if parts.len() > PARTS {
        return None;
    }
    let plain = |id: &Id| {
        let node = finished.get((*id as usize).checked_sub(base)?)?;
        matches!(node, Node::None | Node::Bool(_) | Node::Int(_) | Node::Float(_) | Node::Text(_)).then(|| node.clone())
    };
    parts.iter().map(plain).collect()
}

/// What a node holds beside itself, if letting go of it is worth while.
pub(super) fn heavy(node: &Node) -> Option<u64> {
    match node {
        Node::Bytes(bytes) if bytes.len() >= 64 => Some(bytes.len() as u64),
        Node::Array(Some(stored)) if stored.beside > 0 => Some(stored.beside),
        _ => None,
    }
}
