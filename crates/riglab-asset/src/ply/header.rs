//! What the head of a PLY says of the rest.

use crate::marked::unmarked;
use crate::peers::shown;

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// A row a line.
    Ascii,
    Little,
    Big,
}

/// A kind of number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a number.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A column of an element's rows.
#[derive(Debug, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    /// Of its number, or of each number of its list.
    pub(super) kind: Kind,
    /// Of the number of those, where it is a list.
    pub(super) count: Option<Kind>,
}

/// A table.
#[derive(Debug, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) rows: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// The column of a number.
    pub(super) fn scalar(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.count.is_none() && p.name == name)
    }

    /// The column of a list.
    pub(super) fn list(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.count.is_some() && p.name == name)
    }
}

#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    /// In the order of the file.
    pub(super) elements: Vec<Element>,
    /// Files that comments name as textures.
    pub(super) pictures: Vec<String>,
    /// How many lines the head has.
    pub(super) lines: usize,
}

/// The head of a file, and the bytes behind it.
///
/// # Errors
/// What is wrong with it, with the line.
pub(super) fn read(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let bytes = unmarked(bytes);
    let mut encoding = None;
    let (mut elements, mut pictures): (Vec<Element>, Vec<String>) = (Vec::new(), Vec::new());
    // All lines end as the first does: a byte 10 behind a `\r` may be the first of the data.
    let end: &[u8] = match bytes.strip_prefix(b"ply") {
        Some([b'\r', b'\n', ..]) => b"\r\n",
        Some([b'\r', ..]) => b"\r",
        Some([b'\n', ..]) => b"\n",
        _ => return Err("it does not begin with a line `ply`".into()),
    };
    let mut rest = bytes;
    for number in 1.. {
        let Some(length) = rest.windows(end.len()).position(|own| own == end) else {
            return Err(format!("line {number}: the file ends before `end_header`"));
        };
        let line = String::from_utf8_lossy(&rest[..length]);
        rest = &rest[length + end.len()..];
        let words: Vec<&str> = line.split_whitespace().collect();
        let wrong = || format!("line {number}: `{}` is no line of the header", shown(&line));
        let kind =
            |word: &str| Kind::of(word).ok_or_else(|| format!("line {number}: `{}` is no kind of number", shown(word)));
        let property = match words[..] {
            [] | ["obj_info" | "comment", ..] => {
                if let Some(name) = line.trim().strip_prefix("comment TextureFile ") {
                    pictures.push(name.trim().to_owned());
                }
                continue;
            }
            ["ply"] if number == 1 => continue,
            ["format", name, ..] => {
                encoding = Some(match name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    _ => return Err(wrong()),
                });
                continue;
            }
            ["element", name, rows] => {
                let rows = rows.parse().map_err(|_| wrong())?;
                elements.push(Element { name: name.to_owned(), rows, properties: Vec::new() });
                continue;
            }
            ["property", "list", count, of, name] => {
                Property { name: name.to_owned(), kind: kind(of)?, count: Some(kind(count)?) }
            }
            ["property", of, name] => Property { name: name.to_owned(), kind: kind(of)?, count: None },
            ["end_header"] => {
                let encoding = encoding.ok_or("the header has no line `format`")?;
                return Ok((Header { encoding, elements, pictures, lines: number }, rest));
            }
            _ => return Err(wrong()),
        };
        let element = elements.last_mut().ok_or_else(|| format!("line {number}: a property of no element"))?;
        element.properties.push(property);
    }
    Err("the header does not end".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_tells_of_tables_whatever_ends_its_lines() {
        let text = "ply\nformat binary_big_endian 1.0\ncomment by hand\ncomment TextureFile a b.png \n\nobj_info 3\n\
            element vertex 8\nproperty float32 x\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";
        for end in ["\n", "\r\n", "\r"] {
            let bytes = [text.replace('\n', end).as_bytes(), b"\n1"].concat();
            let (header, rest) = read(&bytes).unwrap();
            assert_eq!((rest, header.encoding, header.lines), (&b"\n1"[..], Encoding::Big, 11));
            assert_eq!((&header.elements[0].name[..], header.elements[0].rows), ("vertex", 8));
            assert_eq!((header.elements[0].scalar("x"), header.elements[0].list("x")), (Some(0), None));
            assert_eq!((header.elements[1].list("vertex_indices"), header.pictures.len()), (Some(0), 1));
        }
        assert_eq!(read(text.as_bytes()).unwrap().0.pictures, ["a b.png"]);
        assert_eq!(read(format!("\u{feff}{text}").as_bytes()).unwrap(), read(text.as_bytes()).unwrap());
        let latin = b"ply\ncomment \xe9t\xe9\nformat ascii 1.0\nend_header\n";
        assert!(read(latin).unwrap().0.elements.is_empty());
    }

    #[test]
    fn what_is_no_header_is_told_by_its_line() {
        let of = |text: &str| read(text.as_bytes()).unwrap_err();
        assert_eq!(of("plywood"), "it does not begin with a line `ply`");
        assert_eq!(of("ply\nformat ascii 1.0\n"), "line 3: the file ends before `end_header`");
        assert_eq!(of("ply\nend_header\n"), "the header has no line `format`");
        assert_eq!(of("ply\nformat base64 1.0\n"), "line 2: `format base64 1.0` is no line of the header");
        assert_eq!(of("ply\nelement vertex -1\n"), "line 2: `element vertex -1` is no line of the header");
        assert_eq!(of("ply\nproperty int x\n"), "line 2: a property of no element");
        assert_eq!(of("ply\nelement a 1\nproperty int128 x\n"), "line 3: `int128` is no kind of number");
    }
}
