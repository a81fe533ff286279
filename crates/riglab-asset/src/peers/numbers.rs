//! Arrays of numbers as the files store them, and what readers want of them.

use std::borrow::Cow;

use super::array_rig::{Array, SparseRows};
use super::fault::PeerFault;

/// Texts in an array, at most: they are names of joints.
const TEXTS: usize = 1 << 16;

/// How an element is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Dtype {
    /// `f` float, `i` signed, `u` unsigned, `b` truth value, `g` bfloat16, `U` text in UTF-32,
    /// `S` bytes, `O` objects.
    pub kind: u8,
    /// Bytes of an element.
    pub size: usize,
    /// Most significant byte first.
    pub big: bool,
}

impl Dtype {
    /// Of `<f4`, `|u1`, `<U10`, or `f4` as pickles have it.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (big, rest) = match text.split_at_checked(1)? {
            ("<" | "|" | "=", rest) => (false, rest),
            (">", rest) => (true, rest),
            _ => (false, text),
        };
        let (kind, size) = rest.split_at_checked(1)?;
        let kind = kind.as_bytes()[0];
        let size: usize = if kind == b'O' { 8 } else { size.parse().ok()? };
        let size = match (kind, size) {
            (b'f', 2 | 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8) | (b'b', 1) | (b'O', _) => size,
            // Four bytes a letter. Elements without bytes would come in any number.
            (b'U', 1..0x10_0000) => 4 * size,
            (b'S', 1..0x10_0000) => size,
            _ => return None,
        };
        Some(Self { kind, size, big })
    }

    /// Whether elements are numbers.
    pub(crate) fn is_number(self) -> bool {
        matches!(self.kind, b'f' | b'i' | b'u' | b'b' | b'g')
    }

    /// What so many stored bytes take once they are read: numbers become f32 or i64, texts strings.
    pub(crate) fn unpacked(self, stored: usize) -> u64 {
        let element = self.size.max(if self.is_number() { 8 } else { 32 });
        ((stored / self.size.max(1)) as u64).saturating_mul(element as u64)
    }

    fn bits(self, bytes: &[u8]) -> u64 {
        let add = |bits: u64, b: &u8| bits << 8 | u64::from(*b);
        if self.big { bytes.iter().fold(0, add) } else { bytes.iter().rev().fold(0, add) }
    }

    /// A stored number as f64.
    pub(crate) fn float(self, bytes: &[u8]) -> f64 {
        let bits = self.bits(bytes);
        match (self.kind, self.size) {
            (b'f', 2) => half::f16::from_bits(bits as u16).to_f64(),
            (b'f', 4) => f32::from_bits(bits as u32).into(),
            (b'f', _) => f64::from_bits(bits),
            (b'g', _) => half::bf16::from_bits(bits as u16).to_f64(),
            _ => self.int(bytes) as f64,
        }
    }

    /// A stored whole number; what is not whole, or too large, becomes `i64::MIN`, which no index is.
    pub(crate) fn int(self, bytes: &[u8]) -> i64 {
        let bits = self.bits(bytes);
        match self.kind {
            b'f' | b'g' => {
                let x = self.float(bytes);
                if x.fract() == 0.0 && x.abs() < 9e15 { x as i64 } else { i64::MIN }
            }
            b'i' => {
                let unused = 64 - 8 * self.size as u32;
                (bits << unused) as i64 >> unused
            }
            _ => i64::try_from(bits).unwrap_or(i64::MIN),
        }
    }

    /// A stored text.
    pub(crate) fn text(self, bytes: &[u8]) -> String {
        match self.kind {
            b'U' => {
                let letters = bytes.as_chunks::<4>().0.iter().map(|b| self.bits(b) as u32).take_while(|c| *c != 0);
                letters.map(|c| char::from_u32(c).unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
            }
            _ => String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned(),
        }
    }
}

/// An array over stored bytes. Made only where every element lies within the bytes.
#[derive(Clone, Debug)]
pub(crate) struct Numbers<'a> {
    pub shape: Vec<usize>,
    /// Steps along each axis, in elements.
    strides: Vec<usize>,
    pub dtype: Dtype,
    data: Cow<'a, [u8]>,
}

/// The product of lengths, if it fits.
pub(crate) fn elements(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |n, &len| n.checked_mul(len))
}

impl<'a> Numbers<'a> {
    /// Unbroken elements, last axis fastest or, in Fortran's order, slowest.
    pub(crate) fn new(
        shape: Vec<usize>,
        dtype: Dtype,
        fortran: bool,
        data: impl Into<Cow<'a, [u8]>>,
    ) -> Result<Self, String> {
        let data = data.into();
        let wanted = elements(&shape).and_then(|n| n.checked_mul(dtype.size));
        if dtype.size == 0 {
            return Err("has elements without bytes, of which there could be any number".to_owned());
        }
        if wanted != Some(data.len()) {
            return Err(format!("has {} bytes, its shape {shape:?} takes another number", data.len()));
        }
        let mut strides = vec![1; shape.len()];
        let mut step = 1usize;
        let axes: Vec<usize> = if fortran { (0..shape.len()).collect() } else { (0..shape.len()).rev().collect() };
        for axis in axes {
            strides[axis] = step;
            // No overflow: the product fits unless a length is 0, and then nothing is read.
            step = step.saturating_mul(shape[axis]);
        }
        Ok(Self { shape, strides, dtype, data })
    }

    /// Elements at any steps from the start of `data`.
    pub(crate) fn strided(
        shape: Vec<usize>,
        strides: Vec<usize>,
        dtype: Dtype,
        data: impl Into<Cow<'a, [u8]>>,
    ) -> Result<Self, String> {
        let data = data.into();
        let count = elements(&shape).ok_or("has a shape beyond all bounds")?;
        if shape.len() != strides.len() {
            return Err("has not one stride for each axis".to_owned());
        }
        if count > 0 {
            let reach = shape
                .iter()
                .zip(&strides)
                .try_fold(0usize, |sum, (len, step)| (len - 1).checked_mul(*step).and_then(|far| sum.checked_add(far)));
            let end = reach.and_then(|r| r.checked_add(1)).and_then(|r| r.checked_mul(dtype.size));
            if end.is_none_or(|end| end > data.len()) {
                return Err(format!("reaches beyond its {} bytes", data.len()));
            }
            // Steps of 0 repeat elements: a few bytes may claim any size.
            if count.saturating_mul(dtype.size) > data.len() {
                return Err(format!("repeats its {} bytes", data.len()));
            }
        }
        Ok(Self { shape, strides, dtype, data })
    }

    /// How many elements.
    pub(crate) fn len(&self) -> usize {
        elements(&self.shape).unwrap_or(0)
    }

    /// The bytes of all elements, last axis fastest.
    fn each(&self) -> impl Iterator<Item = &[u8]> {
        let mut at = vec![0usize; self.shape.len()];
        let mut offset = 0;
        (0..self.len()).map(move |_| {
            let element = &self.data[offset * self.dtype.size..][..self.dtype.size];
            for axis in (0..at.len()).rev() {
                at[axis] += 1;
                offset += self.strides[axis];
                if at[axis] < self.shape[axis] {
                    break;
                }
                offset -= self.strides[axis] * self.shape[axis];
                at[axis] = 0;
            }
            element
        })
    }

    /// The bytes of all elements one after another, last axis fastest, least significant first.
    pub(crate) fn packed(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.len() * self.dtype.size);
        for element in self.each() {
            let start = out.len();
            out.extend_from_slice(element);
            if self.dtype.big {
                out[start..].reverse();
            }
        }
        out
    }

    fn number(&self, field: &str) -> Result<(), PeerFault> {
        if self.dtype.is_number() { Ok(()) } else { Err(PeerFault::field(field, "holds no numbers")) }
    }

    /// Elements as f32, finite or not.
    pub(crate) fn floats(&self, field: &str) -> Result<Vec<f32>, PeerFault> {
        self.number(field)?;
        Ok(self.each().map(|b| self.dtype.float(b) as f32).collect())
    }

    /// Elements as whole numbers.
    pub(crate) fn ints(&self, field: &str) -> Result<Vec<i64>, PeerFault> {
        self.number(field)?;
        Ok(self.each().map(|b| self.dtype.int(b)).collect())
    }

    /// Elements as text.
    pub(crate) fn texts(&self, field: &str) -> Result<Vec<String>, PeerFault> {
        if !matches!(self.dtype.kind, b'U' | b'S') {
            return Err(PeerFault::field(field, "holds no text"));
        }
        if self.len() > TEXTS {
            return Err(PeerFault::TooLarge(field.to_owned()));
        }
        Ok(self.each().map(|b| self.dtype.text(b)).collect())
    }

    /// As an array of f32 with its shape.
    pub(crate) fn array(&self, field: &str) -> Result<Array, PeerFault> {
        Ok(Array { shape: self.shape.clone(), data: self.floats(field)? })
    }

    /// Rows of `N`, of a shape [rows, N] or, where the file has more columns, their first.
    pub(crate) fn rows<const N: usize>(&self, field: &str) -> Result<Vec<[f32; N]>, PeerFault> {
        let [_, columns] = self.matrix(field, N)?;
        let all = self.floats(field)?;
        Ok(all.chunks_exact(columns).map(|row| std::array::from_fn(|k| row[k])).collect())
    }

    /// Rows of `N` whole numbers, of a shape [rows, N]; an empty list of any shape has no rows.
    pub(crate) fn int_rows<const N: usize>(&self, field: &str) -> Result<Vec<[i64; N]>, PeerFault> {
        if self.len() == 0 {
            return Ok(Vec::new());
        }
        if self.matrix(field, N)?[1] != N {
            return Err(PeerFault::field(field, format!("has the shape {:?}, not [rows, {N}]", self.shape)));
        }
        Ok(self.ints(field)?.as_chunks::<N>().0.to_vec())
    }

    /// Its two lengths, the second at least `columns`.
    fn matrix(&self, field: &str, columns: usize) -> Result<[usize; 2], PeerFault> {
        match self.shape[..] {
            [rows, found] if found >= columns => Ok([rows, found]),
            _ => Err(PeerFault::field(field, format!("has the shape {:?}, not [rows, {columns}]", self.shape))),
        }
    }

    /// Adds the rows of a matrix without its zeros.
    pub(crate) fn append_sparse(&self, field: &str, rows: &mut SparseRows) -> Result<(), PeerFault> {
        self.number(field)?;
        let [_, columns] = self.matrix(field, 1)?;
        for (at, element) in self.each().enumerate() {
            let weight = self.dtype.float(element) as f32;
            if weight != 0.0 {
                rows.pairs.push(((at % columns) as u32, weight));
            }
            if at % columns == columns - 1 {
                rows.end_row();
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_is_read() {
        let cases: [(&str, &[u8], f64); 10] = [
            ("<f2", &[0x00, 0x3e], 1.5),
            ("<f4", &1.5f32.to_le_bytes(), 1.5),
            (">f8", &1.5f64.to_be_bytes(), 1.5),
            ("|i1", &[0xff], -1.0),
            ("<i2", &[0xfe, 0xff], -2.0),
            ("<i8", &(-3i64).to_le_bytes(), -3.0),
            ("|u1", &[0xff], 255.0),
            ("<u4", &7u32.to_le_bytes(), 7.0),
            ("|b1", &[1], 1.0),
            ("i4", &9i32.to_le_bytes(), 9.0),
        ];
        for (name, bytes, value) in cases {
            assert_eq!(Dtype::parse(name).unwrap().float(bytes), value, "{name}");
        }
        assert_eq!(Dtype::parse("<U2").unwrap().text(&[0x65, 0x51, 0, 0, 0, 0, 0, 0]), "\u{5165}");
        for bad in ["", "<", "<f3", "<c8", "|V4", "<i", "é", "<U99999999999", "<U0"] {
            assert_eq!(Dtype::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn orders_and_strides_give_the_same_rows() {
        let u1 = Dtype::parse("|u1").unwrap();
        let rows = |n: Numbers<'_>| n.int_rows::<3>("x").unwrap();
        let wanted = [[1, 2, 3], [4, 5, 6]];
        assert_eq!(rows(Numbers::new(vec![2, 3], u1, false, vec![1, 2, 3, 4, 5, 6]).unwrap()), wanted);
        assert_eq!(rows(Numbers::new(vec![2, 3], u1, true, vec![1, 4, 2, 5, 3, 6]).unwrap()), wanted);
        assert_eq!(rows(Numbers::strided(vec![2, 3], vec![1, 2], u1, vec![1, 4, 2, 5, 3, 6]).unwrap()), wanted);
    }

    #[test]
    fn shapes_that_do_not_fit_their_bytes_are_refused() {
        let f4 = Dtype::parse("<f4").unwrap();
        assert!(Numbers::new(vec![2], f4, false, vec![0; 4]).is_err());
        assert!(Numbers::new(vec![usize::MAX, 8], f4, false, vec![]).is_err());
        assert!(Numbers::strided(vec![2], vec![1], f4, vec![0; 4]).is_err());
        assert!(Numbers::strided(vec![1 << 40], vec![0], f4, vec![0; 4]).is_err());
        assert!(Numbers::strided(vec![2], vec![usize::MAX], f4, vec![0; 4]).is_err());
        assert!(Numbers::new(vec![usize::MAX, usize::MAX, 0], f4, false, vec![]).is_err());
        assert!(Numbers::strided(vec![3], vec![], f4, vec![]).is_err());
        assert!(Numbers::new(vec![1 << 40], Dtype { kind: b'U', size: 0, big: false }, false, vec![]).is_err());
    }
}
