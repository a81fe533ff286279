//! STL, as programs for printing write it: text or binary. Corners in one place become one vertex, as the format has
//! triangles alone, and all solids of a text one mesh. Normals, which follow from the corners, and colours, which programs put
//! into spare bytes each in its own way, are not looked at.
//!
//! Which axis is up and what the units are the format does not say, so both stay.

use std::path::Path;

use riglab_core::Vec3;

use crate::format::Reads;
use crate::marked::unmarked;
use crate::peers::shown;
use crate::rigging::{Looks, SubjectNote, Unrigged, surface_model, twins};
use crate::surface::Surface;
use crate::{Fault, ImportOptions, Reading, Rights};

/// Bytes before the triangles of a binary file: 80 of any kind, and the number of triangles.
const HEAD: usize = 84;
/// Bytes of a triangle: its normal and corners, and two to spare.
const TRIANGLE: usize = 50;

/// Triangles for printing.
pub(crate) struct Stl;

impl Reads for Stl {
    fn name(&self) -> &'static str {
        "STL"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["stl"]
    }

    fn read(&self, bytes: &[u8], _: Option<&Path>, _: &ImportOptions) -> Result<(Reading, Rights), Fault> {
        Ok((read(bytes)?.into_reading(), Rights::default()))
    }

    fn looks(&self, file: &Unrigged<'_>, notes: &mut Vec<SubjectNote>) -> Result<Looks, Fault> {
        Ok(surface_model(&file.name, read(file.bytes)?, file.folder, notes).into())
    }
}

pub(crate) fn read(bytes: &[u8]) -> Result<Surface, Fault> {
    let corners = if is_text(bytes) { text(unmarked(bytes)) } else { binary(bytes) }.map_err(Fault::Stl)?;
    let first = twins(&corners);
    let triangles = first.as_chunks().0.to_vec();
    let surface = Surface { positions: corners, triangles, ..Surface::default() };
    surface.used().map_err(|corner| {
        let (triangle, corner) = (corner / 3, corner % 3);
        Fault::Stl(format!("corner {corner} of triangle {triangle}, counted from 0, is at no finite place"))
    })
}

/// Whether a file is a text. Heads of binary files begin with `solid`, too; these have a length that tells them, or bytes 0,
/// of which no text has any.
fn is_text(bytes: &[u8]) -> bool {
    let begins = unmarked(bytes).trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    begins && claimed(bytes) != Some(bytes.len() as u64) && !bytes[..bytes.len().min(1024)].contains(&0)
}

/// The length of a binary file by its head.
fn claimed(bytes: &[u8]) -> Option<u64> {
    let (count, _) = bytes.get(80..)?.split_first_chunk()?;
    Some(HEAD as u64 + TRIANGLE as u64 * u64::from(u32::from_le_bytes(*count)))
}

/// Three corners a triangle.
fn binary(bytes: &[u8]) -> Result<Vec<Vec3>, String> {
    let found = bytes.len();
    let claimed = claimed(bytes).ok_or_else(|| format!("it is no text, and has {found} bytes of a head of {HEAD}"))?;
    if claimed > found as u64 {
        let count = (claimed - HEAD as u64) / TRIANGLE as u64;
        return Err(format!(
            "its head tells of {count} triangles, which take {claimed} bytes, and it has {found}: it is cut off"
        ));
    }
    if claimed / TRIANGLE as u64 * 3 > u64::from(u32::MAX) {
        return Err("it has more corners than can be counted".into());
    }
    let triangles = bytes[HEAD..claimed as usize].chunks_exact(TRIANGLE);
    let number = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
    let numbers = triangles.flat_map(|one| one[12..48].as_chunks().0).map(number);
    Ok(numbers.collect::<Vec<f32>>().as_chunks().0.to_vec())
}

/// Three corners a triangle.
fn text(bytes: &[u8]) -> Result<Vec<Vec3>, String> {
    let mut all: Vec<Vec3> = Vec::new();
    let (mut facet, mut ended, mut lines) = (Vec::new(), true, 0);
    let mut before = None;
    for line in bytes.split_inclusive(|b| matches!(b, b'\n' | b'\r')) {
        // Between CR and LF there is no line.
        if before == Some(b'\r') && line == b"\n" {
            before = Some(b'\n');
            continue;
        }
        before = line.last().copied();
        lines += 1;
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let Some(word) = words.next() else { continue };
        match word.to_ascii_lowercase().as_slice() {
            b"solid" => ended = false,
            b"endsolid" => ended = true,
            b"vertex" => {
                let mut number = || {
                    let word = String::from_utf8_lossy(words.next().unwrap_or_default());
                    let number = word.parse().ok().filter(|x: &f32| x.is_finite());
                    number.ok_or_else(|| {
                        format!("line {lines}: `{}` is no coordinate, which is a finite number", shown(&word))
                    })
                };
                facet.push([number()?, number()?, number()?]);
            }
            // Of three corners by the format; more are a fan.
            b"endfacet" => {
                let [hub, rim @ ..] = facet.as_slice() else {
                    return Err(format!("line {lines}: a facet has no corners"));
                };
                if rim.len() < 2 {
                    return Err(format!("line {lines}: a facet has {} corners, not 3", facet.len()));
                }
                all.extend(rim.windows(2).flat_map(|w| [*hub, w[0], w[1]]));
                facet.clear();
            }
            b"facet" | b"outer" | b"endloop" => {}
            _ => {
                let line = String::from_utf8_lossy(line);
                return Err(format!("line {lines}: `{}` is no line of an STL", shown(line.trim())));
            }
        }
    }
    if ended { Ok(all) } else { Err(format!("line {lines}: it ends before `endsolid`: it is cut off")) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const CORNERS: [Vec3; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.5, 0.0], [-0.0, 0.0, 1.0]];
    const TRIANGLES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    /// A tetrahedron in two solids.
    fn as_text() -> String {
        let facet = |t: &[usize; 3]| {
            let vertex =
                |v: &usize| format!("      vertex {} {} {:e}\n", CORNERS[*v][0], CORNERS[*v][1], CORNERS[*v][2]);
            let corners: String = t.iter().map(vertex).collect();
            format!("  facet normal nan 0 0\n    outer loop\n{corners}    endloop\n  endfacet\n")
        };
        let solid = |of: &[[usize; 3]]| {
            format!("solid a facet\n{}endsolid a facet\n", of.iter().map(facet).collect::<String>())
        };
        solid(&TRIANGLES[..1]) + &solid(&TRIANGLES[1..])
    }

    fn as_binary(head: &[u8]) -> Vec<u8> {
        let mut out = head.to_vec();
        out.resize(80, b' ');
        out.extend(4u32.to_le_bytes());
        for t in TRIANGLES {
            let numbers = t.iter().flat_map(|v| CORNERS[*v]);
            out.extend([0.0f32; 3].into_iter().chain(numbers).flat_map(f32::to_le_bytes));
            out.extend([7, 7]);
        }
        out
    }

    /// The same as text and in binary.
    pub(crate) fn tetrahedra() -> [Vec<u8>; 2] {
        [as_text().into_bytes(), as_binary(b"by hand")]
    }

    #[test]
    fn both_forms_read_alike_with_corners_in_one_place_made_one() {
        let [text, binary] = tetrahedra().map(|bytes| read(&bytes).unwrap());
        assert_eq!(text, binary);
        // In the order in which they come.
        assert_eq!(text.positions, [CORNERS[0], CORNERS[2], CORNERS[1], CORNERS[3]]);
        assert_eq!(text.triangles, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]]);
        assert_eq!((text.stored, text.numbers.as_slice()), (12, &[0, 1, 2, 5][..]));
    }

    #[test]
    fn a_binary_file_may_begin_as_a_text_does() {
        let whole = read(&as_binary(b"by hand")).unwrap();
        let mut bytes = as_binary(b"solid made\nby hand");
        assert_eq!(read(&bytes).unwrap(), whole);
        // With bytes behind it its length does not tell.
        bytes.extend(b"more");
        assert_eq!(read(&bytes).unwrap(), whole);
    }

    #[test]
    fn text_is_read_in_any_case_and_without_names() {
        let read = |text: &str| read(text.as_bytes()).unwrap();
        let plain = read(&as_text());
        assert_eq!(read(&as_text().to_uppercase()), plain);
        assert_eq!(read(&as_text().replace(" a facet", "").replace('\n', "\r\n")), plain);
        for end in ["\n", "\r\n", "\r"] {
            let said =
                text(["solid", "facet normal 0 0 1", "outer loop", "vertex 0 x 0"].join(end).as_bytes()).unwrap_err();
            assert!(said.starts_with("line 4: `x`"), "{said}");
        }
        assert_eq!(read(&format!("\u{feff}{}", as_text())), plain);
        assert!(read("solid\nendsolid").triangles.is_empty());
    }

    #[test]
    fn what_is_wrong_is_told() {
        let of = |bytes: &[u8]| match read(bytes) {
            Err(Fault::Stl(told)) => told,
            other => panic!("{other:?}"),
        };
        let text = as_text();
        assert_eq!(
            of(text.replace("1.5", "inf").as_bytes()),
            "line 5: `inf` is no coordinate, which is a finite number"
        );
        let short = text.replacen("vertex 0 0 0e0", "", 1);
        assert_eq!(of(short.as_bytes()), "line 8: a facet has 2 corners, not 3");
        assert_eq!(of(b"solid a\nvertex 1 2\n"), "line 2: `` is no coordinate, which is a finite number");
        assert_eq!(of(b"solid a\nfacets\n"), "line 2: `facets` is no line of an STL");
        assert_eq!(of(b"GIF89a"), "it is no text, and has 6 bytes of a head of 84");
        let mut binary = as_binary(b"");
        binary[80..84].fill(255);
        assert_eq!(
            of(&binary),
            "its head tells of 4294967295 triangles, which take 214748364834 bytes, and it has 284: it is cut off"
        );
        let mut binary = as_binary(b"");
        binary[84 + 50 + 24..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(of(&binary), "corner 1 of triangle 1, counted from 0, is at no finite place");
    }

    #[test]
    fn files_cut_anywhere_are_refused_in_a_sentence() {
        for bytes in tetrahedra() {
            let (whole, last) = (read(&bytes).unwrap(), bytes.len() - " a facet\n".len());
            for cut in 0..bytes.len() {
                match read(&bytes[..cut]) {
                    // The name of the last solid may go; the first is a whole file.
                    Ok(read) if bytes.starts_with(b"solid") => {
                        assert!(cut >= last && read == whole || read.triangles.len() == 1, "{cut}");
                    }
                    Err(Fault::Stl(told)) => assert!(told.len() < 300, "{told}"),
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}
