//! Rows of tables behind the head of a PLY.

use super::header::{Element, Encoding, Kind};
use crate::peers::shown;

/// What is left of a file.
pub(super) struct Rows<'a> {
    rest: &'a [u8],
    encoding: Encoding,
    /// Lines that were read.
    line: usize,
}

/// The numbers of a row.
#[derive(Default)]
pub(super) struct Row {
    /// By column; of no meaning for lists. What is no number is NaN.
    pub(super) scalars: Vec<f64>,
    /// Of the list that was asked for.
    pub(super) list: Vec<f64>,
}

impl<'a> Rows<'a> {
    /// Behind a head of so many lines.
    pub(super) fn new(rest: &'a [u8], encoding: Encoding, line: usize) -> Self {
        Self { rest, encoding, line }
    }

    /// Reads the rows of a table, and the numbers of the list in one column of it. What the head claims is held against the
    /// bytes that are left before anything is made of it.
    ///
    /// # Errors
    /// Where it is wrong, and what `each` says.
    pub(super) fn read(
        &mut self,
        element: &Element,
        list: Option<usize>,
        mut each: impl FnMut(&Row) -> Result<(), String>,
    ) -> Result<(), String> {
        self.check(element)?;
        // Rows of nothing take no bytes, however many there are.
        if element.properties.is_empty() {
            return Ok(());
        }
        let mut row = Row { scalars: vec![0.0; element.properties.len()], list: Vec::new() };
        for number in 0..element.rows {
            row.list.clear();
            let read = match self.encoding {
                Encoding::Ascii => self.line(element, list, &mut row),
                Encoding::Little => self.bytes(element, list, &mut row, little),
                Encoding::Big => self.bytes(element, list, &mut row, big),
            };
            read.and_then(|()| each(&row)).map_err(|wrong| {
                let line = match self.encoding {
                    Encoding::Ascii => format!("line {}: ", self.line),
                    _ => String::new(),
                };
                format!("{line}row {number} of {} of `{}` {wrong}", element.rows, shown(&element.name))
            })?;
        }
        Ok(())
    }

    /// Passes over a table.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), String> {
        self.read(element, None, |_| Ok(()))
    }

    /// Whether the bytes that are left can hold so many rows.
    fn check(&self, element: &Element) -> Result<(), String> {
        let columns = element.properties.iter();
        let (least, left) = match self.encoding {
            // A digit and what ends it; the last line may have no end.
            Encoding::Ascii => (2 * columns.count(), self.rest.len() + 1),
            _ => (columns.map(|p| p.count.unwrap_or(p.kind).size()).sum(), self.rest.len()),
        };
        let wanted = u128::from(element.rows) * least as u128;
        if wanted > left as u128 {
            return Err(format!(
                "its header tells of {} rows of `{}`, which take {wanted} bytes at least, and {} are left: it is cut off",
                element.rows,
                shown(&element.name),
                self.rest.len()
            ));
        }
        Ok(())
    }

    /// A row of text.
    fn line(&mut self, element: &Element, list: Option<usize>, row: &mut Row) -> Result<(), String> {
        let line = loop {
            if self.rest.is_empty() {
                return Err("is not there: the file is cut off".into());
            }
            let end = self.rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
            let (line, behind) = self.rest.split_at(end.unwrap_or(self.rest.len()));
            let length = if behind.starts_with(b"\r\n") { 2 } else { usize::from(!behind.is_empty()) };
            self.rest = &behind[length..];
            self.line += 1;
            if !line.trim_ascii().is_empty() {
                break line;
            }
        };
        let words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let mut numbers = words.map(|word| {
            let text = std::str::from_utf8(word).unwrap_or_default();
            text.parse::<f64>().unwrap_or(f64::NAN)
        });
        let mut next = || numbers.next().ok_or("has too few numbers");
        for (at, property) in element.properties.iter().enumerate() {
            row.scalars[at] = next()?;
            if property.count.is_some() {
                for _ in 0..count(row.scalars[at])? {
                    let number = next()?;
                    if list == Some(at) {
                        row.list.push(number);
                    }
                }
            }
        }
        if numbers.next().is_some() { Err("has more numbers than its header tells of".into()) } else { Ok(()) }
    }

    /// A row of bytes.
    fn bytes(
        &mut self,
        element: &Element,
        list: Option<usize>,
        row: &mut Row,
        number: fn(Kind, &[u8]) -> f64,
    ) -> Result<(), String> {
        let mut take = |size: usize| {
            let (own, behind) = self.rest.split_at_checked(size).ok_or("is cut off: the file ends in it")?;
            self.rest = behind;
            Ok::<_, String>(own)
        };
        for (at, property) in element.properties.iter().enumerate() {
            let first = property.count.unwrap_or(property.kind);
            row.scalars[at] = number(first, take(first.size())?);
            if property.count.is_some() {
                let size = property.kind.size();
                let own = take(usize::try_from(count(row.scalars[at])?).unwrap_or(usize::MAX).saturating_mul(size))?;
                if list == Some(at) {
                    row.list.extend(own.chunks_exact(size).map(|bytes| number(property.kind, bytes)));
                }
            }
        }
        Ok(())
    }
}

/// How many numbers a list has.
fn count(of: f64) -> Result<u64, String> {
    let whole = of.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&of);
    if whole { Ok(of as u64) } else { Err(format!("has a list of {of} numbers")) }
}

fn little(kind: Kind, bytes: &[u8]) -> f64 {
    let mut own = [0; 8];
    own[..bytes.len()].copy_from_slice(bytes);
    value(kind, own)
}

fn big(kind: Kind, bytes: &[u8]) -> f64 {
    let mut own = [0; 8];
    own.iter_mut().zip(bytes.iter().rev()).for_each(|(to, from)| *to = *from);
    value(kind, own)
}

/// A number from its bytes, the lowest first; those behind it are 0.
fn value(kind: Kind, [a, b, c, d, e, f, g, h]: [u8; 8]) -> f64 {
    match kind {
        Kind::I8 => f64::from(a as i8),
        Kind::U8 => f64::from(a),
        Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
        Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
        Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
        Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
        Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
        Kind::F64 => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
    }
}
