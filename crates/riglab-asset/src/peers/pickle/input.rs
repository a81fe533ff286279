//! What stands behind an instruction: numbers, lengths, texts and names.

use std::io::Read;

use super::super::fault::PeerFault;
use super::machine::Machine;
use super::nodes::{Id, Node};

impl Machine<'_, '_> {
    pub(super) fn bytes<const N: usize>(&mut self) -> Result<[u8; N], PeerFault> {
        let mut out = [0; N];
        self.input.read_exact(&mut out).map_err(|e| self.fault(format!("it ends early ({e})")))?;
        Ok(out)
    }

    pub(super) fn length(&mut self, width: usize) -> Result<u64, PeerFault> {
        let mut all = [0; 8];
        for byte in &mut all[..width] {
            *byte = self.bytes::<1>()?[0];
        }
        Ok(u64::from_le_bytes(all))
    }

    /// Bytes of a claimed length, which the budget bounds.
    pub(super) fn take(&mut self, length: u64) -> Result<Vec<u8>, PeerFault> {
        self.budget.take(length, self.member)?;
        let mut out = Vec::with_capacity(length as usize);
        let got = (&mut *self.input).take(length).read_to_end(&mut out);
        match got {
            Ok(n) if n as u64 == length => Ok(out),
            Ok(_) => Err(self.fault("it ends early")),
            Err(e) => Err(self.fault(e.to_string())),
        }
    }

    pub(super) fn text(&mut self, op: u8) -> Result<Id, PeerFault> {
        let length = self.length(match op {
            0x8c => 1,
            b'X' => 4,
            _ => 8,
        })?;
        let bytes = self.take(length)?;
        let text = String::from_utf8(bytes).map_err(|_| self.fault("a text in it is not UTF-8"))?;
        self.add(Node::Text(text.into()))
    }

    /// A whole number of any length, which is told in `width` bytes; of more than 64 bits none is needed.
    pub(super) fn long(&mut self, width: usize) -> Result<Node, PeerFault> {
        let length = self.length(width)?;
        let bytes = self.take(length)?;
        if bytes.len() > 8 && self.open {
            return Ok(Node::Foreign);
        }
        if bytes.len() > 8 {
            return Err(self.fault("a number in it has more than 64 bits"));
        }
        let fill = if bytes.last().is_some_and(|b| *b >= 0x80) { 0xff } else { 0 };
        Ok(Node::Int(i64::from_le_bytes(std::array::from_fn(|k| bytes.get(k).copied().unwrap_or(fill)))))
    }

    /// A line of the two that name something.
    pub(super) fn line(&mut self) -> Result<String, PeerFault> {
        let mut out = Vec::new();
        loop {
            match self.bytes::<1>()?[0] {
                b'\n' => break,
                byte if out.len() < 256 => out.push(byte),
                _ => return Err(self.fault("a name in it is too long")),
            }
        }
        String::from_utf8(out).map_err(|_| self.fault("a name in it is not UTF-8"))
    }
}
