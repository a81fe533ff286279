//! NPY: one array, after a header in the syntax of Python's literals.

use std::io::Read;

use super::array_rig::SparseRows;
use super::budget::Budget;
use super::fault::{PeerFault, shown};
use super::numbers::{Dtype, Numbers, elements};

/// Longest header that is read; numpy itself stops at 10,000 bytes.
const HEADER: usize = 1 << 16;

/// Bytes of a dense matrix looked at in one go.
const BLOCK: usize = 1 << 16;

/// The header of an array.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    pub dtype: Dtype,
    pub fortran: bool,
    pub shape: Vec<usize>,
}

/// Reads the header; what follows in `input` is the data.
pub(crate) fn header(member: &str, input: &mut dyn Read) -> Result<Header, PeerFault> {
    let fault = |reason: String| PeerFault::Npy { member: shown(member), reason };
    let mut start = [0; 8];
    input.read_exact(&mut start).map_err(|e| fault(e.to_string()))?;
    if start[..6] != *b"\x93NUMPY" {
        return Err(fault("it does not start as numpy's arrays do".into()));
    }
    let mut length = [0; 4];
    let width = if start[6] == 1 { 2 } else { 4 };
    input.read_exact(&mut length[..width]).map_err(|e| fault(e.to_string()))?;
    let length = u32::from_le_bytes(length) as usize;
    if !(1..=3).contains(&start[6]) || length > HEADER {
        return Err(fault(format!("version {} with a header of {length} bytes is not read", start[6])));
    }
    let mut text = vec![0; length];
    input.read_exact(&mut text).map_err(|e| fault(e.to_string()))?;
    let text = String::from_utf8_lossy(&text);
    parse(&text).ok_or_else(|| fault(format!("its header is not understood: {}", shown(text.trim()))))
}

/// Parses `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }`.
fn parse(text: &str) -> Option<Header> {
    let after = |key: &str| {
        let at = [format!("'{key}':"), format!("\"{key}\":")].iter().find_map(|k| Some(text.find(k)? + k.len()))?;
        Some(text[at..].trim_start())
    };
    let descr = after("descr")?;
    let quote = descr.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    let dtype = Dtype::parse(descr[1..].split(quote).next()?)?;
    let order = after("fortran_order")?;
    let fortran = order.starts_with("True");
    if !fortran && !order.starts_with("False") {
        return None;
    }
    let inner = after("shape")?.strip_prefix('(')?.split(')').next()?;
    let lengths = inner.split(',').map(str::trim).filter(|s| !s.is_empty());
    // Python 2 wrote long integers with an L.
    let shape: Vec<usize> = lengths.map(|s| s.trim_end_matches('L').parse().ok()).collect::<Option<_>>()?;
    (shape.len() <= 8).then_some(Header { dtype, fortran, shape })
}

/// Reads the data of an array of numbers or text.
pub(crate) fn numbers(
    member: &str,
    header: Header,
    input: &mut dyn Read,
    budget: &mut Budget,
) -> Result<Numbers<'static>, PeerFault> {
    let length = bytes_of(member, &header)?;
    budget.take(header.dtype.unpacked(length), member)?;
    let mut data = Vec::with_capacity(length);
    input.take(length as u64).read_to_end(&mut data).map_err(|e| damaged(member, e.to_string()))?;
    finish(member, input)?;
    Numbers::new(header.shape, header.dtype, header.fortran, data).map_err(|reason| damaged(member, reason))
}

/// Reads a matrix of which few elements are not zero, and keeps those.
pub(crate) fn sparse(
    member: &str,
    header: Header,
    input: &mut dyn Read,
    budget: &mut Budget,
    passing: &mut Budget,
) -> Result<(usize, SparseRows), PeerFault> {
    let [rows, columns] = header.shape[..] else {
        return Err(PeerFault::field(member, format!("has the shape {:?}, not [vertices, joints]", header.shape)));
    };
    let mut out = SparseRows::default();
    if header.fortran {
        numbers(member, header, input, budget)?.append_sparse(member, &mut out)?;
        return Ok((columns, out));
    }
    passing.take(bytes_of(member, &header)? as u64, member)?;
    if rows == 0 || columns == 0 {
        return Err(PeerFault::field(member, format!("has the shape {:?}: no weights", header.shape)));
    }
    let row_bytes = columns * header.dtype.size;
    let at_once = (BLOCK / row_bytes.max(1)).clamp(1, rows);
    let mut left = rows;
    let mut block = Vec::new();
    while left > 0 {
        let count = at_once.min(left);
        block.clear();
        let wanted = (count * row_bytes) as u64;
        input.take(wanted).read_to_end(&mut block).map_err(|e| damaged(member, e.to_string()))?;
        let (pairs, offsets) = (out.pairs.len(), out.offsets.len());
        let part = Numbers::new(vec![count, columns], header.dtype, false, &block[..]);
        part.map_err(|reason| damaged(member, reason))?.append_sparse(member, &mut out)?;
        budget.take(held(out.pairs.len() - pairs, out.offsets.len() - offsets), member)?;
        left -= count;
    }
    finish(member, input)?;
    Ok((columns, out))
}

/// What rows cost: twice their bytes, as lists double when they grow.
pub(crate) fn held(pairs: usize, rows: usize) -> u64 {
    16 * (pairs + rows) as u64
}

/// Reads to the end of a member, which is where an archive compares its sum.
fn finish(member: &str, input: &mut dyn Read) -> Result<(), PeerFault> {
    input.read(&mut [0]).map(drop).map_err(|e| damaged(member, e.to_string()))
}

fn bytes_of(member: &str, header: &Header) -> Result<usize, PeerFault> {
    if header.dtype.kind == b'O' {
        return Err(PeerFault::field(member, "is an array of objects, not of numbers"));
    }
    let bytes = elements(&header.shape).and_then(|n| n.checked_mul(header.dtype.size));
    bytes.ok_or_else(|| PeerFault::TooLarge(shown(member)))
}

fn damaged(member: &str, reason: String) -> PeerFault {
    PeerFault::Npy { member: shown(member), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_understood() {
        let f4 = Dtype { kind: b'f', size: 4, big: false };
        let wanted = |shape: &[usize]| Some(Header { dtype: f4, fortran: false, shape: shape.to_vec() });
        assert_eq!(parse("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }   \n"), wanted(&[3, 4]));
        assert_eq!(parse("{'shape': (), 'descr': \"<f4\", 'fortran_order': False}"), wanted(&[]));
        assert_eq!(parse("{'descr': '<f4', 'fortran_order': False, 'shape': (7L,)}"), wanted(&[7]));
        for bad in ["", "{'descr': [('a', '<f4')]}", "{'descr': '<f4', 'fortran_order': 1, 'shape': (3,)}"] {
            assert_eq!(parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_dense_matrix_is_kept_without_its_zeros() {
        let header = Header { dtype: Dtype { kind: b'f', size: 4, big: false }, fortran: false, shape: vec![2, 3] };
        let data: Vec<u8> = [0.0f32, 0.5, 0.5, 1.0, 0.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let read = |data: &[u8]| {
            let (mut budget, mut passing) = (Budget::of(100), Budget::passing(100));
            sparse("skin", header.clone(), &mut &data[..], &mut budget, &mut passing)
        };
        let (columns, rows) = read(&data).unwrap();
        assert_eq!((columns, rows.row(0), rows.row(1)), (3, &[(1, 0.5), (2, 0.5)][..], &[(0, 1.0)][..]));
        assert!(matches!(read(&data[..20]), Err(PeerFault::Npy { .. })));
    }

    #[test]
    fn claims_beyond_the_file_are_refused_before_they_are_allocated() {
        let dtype = Dtype { kind: b'f', size: 8, big: false };
        let header = Header { dtype, fortran: false, shape: vec![1 << 40] };
        let read = numbers("x", header, &mut &[][..], &mut Budget::of(1000));
        assert!(matches!(read, Err(PeerFault::TooLarge(_))));
    }
}
