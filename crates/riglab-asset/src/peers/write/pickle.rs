//! Pickles as Python's own readers take them: protocol 3 with numpy's old module name, which numpy 1
//! and 2 both read, and protocol 2 for torch.

/// Parts of a pickle, one after the other.
#[derive(Default)]
pub(super) struct Pickle(pub Vec<u8>);

impl Pickle {
    pub(super) fn new(protocol: u8) -> Self {
        Self(vec![0x80, protocol])
    }

    pub(super) fn op(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub(super) fn text(&mut self, text: &str) -> &mut Self {
        self.op(b"X").op(&(text.len() as u32).to_le_bytes()).op(text.as_bytes())
    }

    pub(super) fn int(&mut self, n: usize) -> &mut Self {
        match i32::try_from(n) {
            Ok(n) => self.op(b"J").op(&n.to_le_bytes()),
            // With a zero on top, so that it does not count as negative.
            Err(_) => self.op(&[0x8a, 9]).op(&(n as u64).to_le_bytes()).op(&[0]),
        }
    }

    /// A tuple of numbers.
    pub(super) fn ints(&mut self, all: &[usize]) -> &mut Self {
        self.op(b"(");
        for &n in all {
            self.int(n);
        }
        self.op(b"t")
    }

    /// An array of numpy; `kind` as `f4`.
    pub(super) fn array(&mut self, kind: &str, shape: &[usize], data: &[u8]) -> &mut Self {
        self.begin_array(shape).dtype(kind, if kind.ends_with('1') { "|" } else { "<" }, 0).op(b"\x89");
        // Claimed in four bytes: protocol 3 has no longer form, and numpy writes none.
        self.op(b"B").op(&(data.len() as u32).to_le_bytes()).op(data).op(b"tb")
    }

    /// An array of objects, which `members` puts on a list; ends with what follows.
    pub(super) fn objects(&mut self, shape: &[usize], members: impl FnOnce(&mut Self)) -> &mut Self {
        self.begin_objects(shape);
        members(self);
        self.end_objects()
    }

    /// What stands before the members of an array of objects.
    pub(super) fn begin_objects(&mut self, shape: &[usize]) -> &mut Self {
        self.begin_array(shape).dtype("O8", "|", 63).op(b"\x89](")
    }

    /// What stands after them.
    pub(super) fn end_objects(&mut self) -> &mut Self {
        self.op(b"etb")
    }

    fn begin_array(&mut self, shape: &[usize]) -> &mut Self {
        self.op(b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\0\x85C\x01b\x87R(K\x01").ints(shape)
    }

    fn dtype(&mut self, kind: &str, order: &str, flags: u8) -> &mut Self {
        self.op(b"cnumpy\ndtype\n").text(kind).op(b"\x89\x88\x87R(K\x03").text(order);
        self.op(b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK").op(&[flags]).op(b"tb")
    }

    pub(super) fn end(mut self) -> Vec<u8> {
        self.op(b".");
        self.0
    }
}
