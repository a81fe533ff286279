//! PLY, as scanners and their programs write it: text or binary, of either order of bytes. Polygons and strips become
//! triangles; elements and properties that are not known are passed over, and nothing beside the file is opened.
//!
//! Which axis is up and what the units are the format does not say, so both stay.

mod header;
mod rows;

use std::path::Path;

use header::{Element, Kind};
use rows::{Row, Rows};

use crate::format::Reads;
use crate::marked::unmarked;
use crate::rigging::{Looks, SubjectNote, Unrigged, surface_model};
use crate::surface::Surface;
use crate::{Fault, ImportOptions, Reading, Rights, triangles};

/// What lists of corners are called.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// What a column of a vertex is called: place, normal, texture coordinates and colour.
const PLACE: [&[&str]; 3] = [&["x"], &["y"], &["z"]];
const NORMAL: [&[&str]; 3] = [&["nx"], &["ny"], &["nz"]];
const COORDINATES: [&[&str]; 2] = [&["s", "u", "texture_u"], &["t", "v", "texture_v"]];
const COLOUR: [&[&str]; 3] = [&["red", "r"], &["green", "g"], &["blue", "b"]];
const ALPHA: &[&str] = &["alpha", "a"];

/// Polygons of scanners, or points alone.
pub(crate) struct Ply;

impl Reads for Ply {
    fn name(&self) -> &'static str {
        "PLY"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["ply"]
    }

    fn starts(&self, bytes: &[u8]) -> bool {
        let text = unmarked(bytes);
        text.starts_with(b"ply\n") || text.starts_with(b"ply\r")
    }

    fn read(&self, bytes: &[u8], _: Option<&Path>, _: &ImportOptions) -> Result<(Reading, Rights), Fault> {
        Ok((read(bytes)?.into_reading(), Rights::default()))
    }

    fn looks(&self, file: &Unrigged<'_>, notes: &mut Vec<SubjectNote>) -> Result<Looks, Fault> {
        Ok(surface_model(&file.name, read(file.bytes)?, file.folder, notes).into())
    }
}

pub(crate) fn read(bytes: &[u8]) -> Result<Surface, Fault> {
    surface(bytes).map_err(Fault::Ply)
}

fn surface(bytes: &[u8]) -> Result<Surface, String> {
    let (header, rest) = header::read(bytes)?;
    let mut rows = Rows::new(rest, header.encoding, header.lines);
    let mut surface = Surface { pictures: header.pictures, ..Surface::default() };
    let mut placed = false;
    for element in &header.elements {
        let corners = CORNERS.iter().find_map(|name| element.list(name));
        match (element.name.as_str(), corners) {
            ("vertex", _) if !placed => {
                placed = true;
                vertices(element, &mut rows, &mut surface)?;
            }
            ("face", Some(column)) => {
                rows.read(element, Some(column), |row| polygon(&row.list, &mut surface.triangles))?;
                if element.list("texcoord").is_some() {
                    surface.left.push("texture coordinates of the corners of faces".into());
                }
            }
            ("tristrips", Some(column)) => {
                rows.read(element, Some(column), |row| strips(&row.list, &mut surface.triangles))?;
            }
            _ => rows.skip(element)?,
        }
    }
    let count = surface.positions.len();
    if let Some(vertex) = surface.triangles.as_flattened().iter().find(|v| **v as usize >= count) {
        return Err(format!("a face names vertex {vertex}, counted from 0, and there are {count}"));
    }
    surface
        .used()
        .map_err(|vertex| format!("vertex {vertex}, counted from 0, has a coordinate that is no finite number"))
}

/// The columns of these names, if all are there.
fn columns<const N: usize>(element: &Element, names: [&[&str]; N]) -> Option<[usize; N]> {
    let found = names.map(|names| names.iter().find_map(|name| element.scalar(name)));
    let all = found.iter().all(Option::is_some);
    all.then(|| found.map(Option::unwrap_or_default))
}

/// The vertices, with what is told of each.
fn vertices(element: &Element, rows: &mut Rows<'_>, surface: &mut Surface) -> Result<(), String> {
    let place = columns(element, PLACE).ok_or("its vertices have no properties x, y and z")?;
    let (normal, coordinates) = (columns(element, NORMAL), columns(element, COORDINATES));
    let (colour, alpha) = (columns(element, COLOUR), columns(element, [ALPHA]));
    let number = |row: &Row, column: usize| row.scalars[column] as f32;
    // Numbers of whole kinds are shares of the largest.
    let share = |row: &Row, column: usize| {
        let most = match element.properties[column].kind {
            Kind::F32 | Kind::F64 => 1.0,
            Kind::U16 => 65535.0,
            _ => 255.0,
        };
        (row.scalars[column] / most).clamp(0.0, 1.0) as f32
    };
    rows.read(element, None, |row| {
        surface.positions.push(place.map(|column| number(row, column)));
        surface.normals.extend(normal.map(|of| of.map(|column| number(row, column))));
        surface.coordinates.extend(coordinates.map(|of| of.map(|column| number(row, column))));
        surface.colours.extend(colour.map(|[r, g, b]| {
            let alpha = alpha.map_or(1.0, |[a]| share(row, a));
            [share(row, r), share(row, g), share(row, b), alpha]
        }));
        if surface.positions.len() > u32::MAX as usize { Err("is one more than can be counted".into()) } else { Ok(()) }
    })
}

/// A fan from the first corner; what has fewer than three is no face.
fn polygon(corners: &[f64], triangles: &mut Vec<[u32; 3]>) -> Result<(), String> {
    let [first, rim @ ..] = corners else { return Ok(()) };
    let first = corner(*first)?;
    // A corner may take one byte: what grows twofold would come to 24 a byte of the file.
    if triangles.capacity() - triangles.len() < rim.len() {
        triangles.reserve_exact(rim.len().max(triangles.len() / 2));
    }
    for w in rim.windows(2) {
        triangles.push([first, corner(w[0])?, corner(w[1])?]);
    }
    Ok(())
}

/// Strips of triangles, between which stands a number below 0.
fn strips(corners: &[f64], all: &mut Vec<[u32; 3]>) -> Result<(), String> {
    for strip in corners.split(|corner| *corner < 0.0) {
        let strip = strip.iter().map(|c| corner(*c)).collect::<Result<Vec<u32>, _>>()?;
        all.extend(triangles::from_indices(&strip, 5));
    }
    Ok(())
}

fn corner(of: f64) -> Result<u32, String> {
    let whole = of.fract() == 0.0 && (0.0..f64::from(u32::MAX)).contains(&of);
    if whole { Ok(of as u32) } else { Err(format!("names vertex {of}, which there is not")) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A quad at z = -3 with a colour a corner, an edge, a vertex that lies nowhere and that nothing names, and things that
    /// are not knsurface.
    const HEAD: &str = "comment by hand\nelement camera 1\nproperty list uchar double matrix\nelement vertex 5\n\
        property float quality\nproperty double x\nproperty float y\nproperty short z\nproperty char nx\n\
        property int8 ny\nproperty float nz\nproperty uchar red\nproperty uchar green\nproperty uint8 blue\n\
        property float32 s\nproperty float t\nelement nothing 4000000000\nelement face 2\n\
        property list uchar uint marks\nproperty list ushort int vertex_index\nproperty int group\nend_header\n";

    /// Each number with its kind.
    fn rows() -> Vec<Vec<(f64, Kind)>> {
        let mut rows = vec![vec![(2.0, Kind::U8), (0.5, Kind::F64), (-4.0, Kind::F64)]];
        let floats = |all: &[f64]| all.iter().map(|x| (*x, Kind::F32)).collect::<Vec<_>>();
        for [x, y, red] in
            [[f64::NAN, 0.0, 9.0], [0.0, 0.0, 0.0], [0.5, 0.0, 255.0], [0.5, -1.0, 51.0], [0.0, -1.0, 0.0]]
        {
            let place = [(f64::NAN, Kind::F32), (x, Kind::F64), (y, Kind::F32), (-3.0, Kind::I16)];
            let normal = [(0.0, Kind::I8), (0.0, Kind::I8), (2.0, Kind::F32)];
            let colour = [(red, Kind::U8), (255.0, Kind::U8), (0.0, Kind::U8)];
            rows.push([&place[..], &normal, &colour, &floats(&[x, 0.25])].concat());
        }
        for (marks, corners) in [(&[9.0, 9.0][..], &[1.0, 2.0, 3.0, 4.0][..]), (&[], &[1.0, 3.0])] {
            let mut row = vec![(marks.len() as f64, Kind::U8)];
            row.extend(marks.iter().map(|x| (*x, Kind::U32)));
            row.push((corners.len() as f64, Kind::U16));
            row.extend(corners.iter().map(|x| (*x, Kind::I32)));
            row.push((-7.0, Kind::I32));
            rows.push(row);
        }
        rows
    }

    fn quad(format: &str) -> Vec<u8> {
        let mut out = format!("ply\nformat {format} 1.0\n{HEAD}").into_bytes();
        for row in rows() {
            for (number, kind) in &row {
                let mut bytes = match kind {
                    Kind::U8 => vec![*number as u8],
                    Kind::I8 => vec![*number as i8 as u8],
                    Kind::I16 => (*number as i16).to_le_bytes().to_vec(),
                    Kind::U16 => (*number as u16).to_le_bytes().to_vec(),
                    Kind::I32 => (*number as i32).to_le_bytes().to_vec(),
                    Kind::U32 => (*number as u32).to_le_bytes().to_vec(),
                    Kind::F32 => (*number as f32).to_le_bytes().to_vec(),
                    Kind::F64 => number.to_le_bytes().to_vec(),
                };
                match format {
                    "ascii" => bytes = format!("{number} ").into_bytes(),
                    "binary_big_endian" => bytes.reverse(),
                    _ => {}
                }
                out.extend(bytes);
            }
            if format == "ascii" {
                out.extend(b"\r\n\n");
            }
        }
        out
    }

    /// The same in every encoding.
    pub(crate) fn quads() -> [Vec<u8>; 3] {
        ["ascii", "binary_little_endian", "binary_big_endian"].map(quad)
    }

    fn text(head: &str, rows: &str) -> Result<Surface, String> {
        surface(format!("ply\nformat ascii 1.0\n{head}\nend_header\n{rows}").as_bytes())
    }

    const POINTS: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    const FACES: &str = "element face 1\nproperty list uchar int vertex_indices";

    #[test]
    fn every_encoding_reads_alike_and_what_is_not_known_is_passed_over() {
        let [ascii, little, big] = quads().map(|bytes| read(&bytes).unwrap());
        assert_eq!(ascii.positions, [[0.0, 0.0, -3.0], [0.5, 0.0, -3.0], [0.5, -1.0, -3.0], [0.0, -1.0, -3.0]]);
        assert_eq!((ascii.numbers.as_slice(), ascii.stored), (&[1, 2, 3, 4][..], 5));
        assert_eq!(ascii.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!((ascii.normals[0], ascii.coordinates[1]), ([0.0, 0.0, 2.0], [0.5, 0.25]));
        let red: Vec<[f32; 4]> = [0.0, 1.0, 0.2, 0.0].map(|red| [red, 1.0, 0.0, 1.0]).into();
        assert_eq!(ascii.colours, red);
        assert!(ascii == little && little == big);
    }

    #[test]
    fn numbers_are_read_however_programs_write_them() {
        let read = text(&format!("{POINTS}{FACES}"), "0 .5 1.\n+1e0\t0 -nan\n\n 0 1 0\n3 0 1 2").unwrap_err();
        assert_eq!(read, "vertex 1, counted from 0, has a coordinate that is no finite number");
        let read = text(&format!("{POINTS}{FACES}"), "0 .5 1.\n+1e0\t0 1.5E1\n\n 0 1 0\n3 0 1 2").unwrap();
        assert_eq!(read.positions, [[0.0, 0.5, 1.0], [1.0, 0.0, 15.0], [0.0, 1.0, 0.0]]);
        // Two rows on a line would leave one out.
        let said = text(&format!("{POINTS}{FACES}"), "0 .5 1 +1e0 0 1.5E1\n0 1 0\n2 1 0\n3 0 1 2").unwrap_err();
        assert!(said.contains("has more numbers than its header tells of"), "{said}");
    }

    #[test]
    fn colours_of_floats_are_shares_and_alpha_goes_along() {
        let head = format!("{POINTS}property float r\nproperty float g\nproperty double b\nproperty ushort a\n{FACES}");
        let read = text(&head, "0 0 0 .5 2 -1 65535\n1 0 0 0 0 0 0\n0 1 0 0 0 nan 0\n3 0 1 2\n").unwrap();
        assert_eq!((read.colours[0], read.colours[1]), ([0.5, 1.0, 0.0, 1.0], [0.0; 4]));
        assert!(read.colours[2][2].is_nan());
    }

    #[test]
    fn strips_become_triangles() {
        let head = format!("{POINTS}element tristrips 1\nproperty list int int vertex_indices");
        let read = text(&head, "0 0 0\n1 0 0\n0 1 0\n8 0 1 2 0 -1 2 1 0").unwrap();
        assert_eq!(read.triangles, [[0, 1, 2], [1, 0, 2], [2, 1, 0]]);
    }

    #[test]
    fn points_alone_are_no_surface() {
        assert!(text(POINTS, "0 0 0\n1 0 0\n0 1 0").unwrap().into_reading().parts.is_empty());
    }

    #[test]
    fn what_is_wrong_is_told_with_its_row() {
        let all = format!("{POINTS}{FACES}");
        let of = |rows: &str| text(&all, rows).unwrap_err();
        assert_eq!(of("0 0 0\n1 0\n0 1 0\n3 0 1 2"), "line 11: row 1 of 3 of `vertex` has too few numbers");
        assert_eq!(of("0 0 0\n1 0 0\n0 1 0\n3 0 1"), "line 13: row 0 of 1 of `face` has too few numbers");
        assert_eq!(
            of("0 0 0\n1 0 0\n0 1 0\n3 0 1 -2"),
            "line 13: row 0 of 1 of `face` names vertex -2, which there is not"
        );
        assert_eq!(
            of("0 0 0\n1 0 0\n0 1 0\n3 0 1 x"),
            "line 13: row 0 of 1 of `face` names vertex NaN, which there is not"
        );
        assert_eq!(of("0 0 0\n1 0 0\n0 1 0\n-1"), "line 13: row 0 of 1 of `face` has a list of -1 numbers");
        assert_eq!(of("0 0 0\n1 0 0\n0 1 0\n3 0 1 3"), "a face names vertex 3, counted from 0, and there are 3");
        let flat = "element vertex 1\nproperty float x\nproperty list uchar float y";
        assert_eq!(text(flat, "1 1 1").unwrap_err(), "its vertices have no properties x, y and z");
    }

    /// Nothing is made for rows that the file cannot hold.
    #[test]
    fn claims_are_held_against_the_bytes_that_are_there() {
        let claims = POINTS.replace('3', "4000000000");
        assert_eq!(
            text(&claims, "0 0 0").unwrap_err(),
            "its header tells of 4000000000 rows of `vertex`, which take 24000000000 bytes at least, and 5 are left: it is cut off"
        );
        let binary = |head: &str, rows: &[u8]| {
            let head = format!("ply\nformat binary_little_endian 1.0\n{head}\nend_header\n");
            surface(&[head.as_bytes(), rows].concat()).unwrap_err()
        };
        let most = POINTS.replace('3', &u64::MAX.to_string());
        assert!(binary(&most, &[0; 36]).ends_with("and 36 are left: it is cut off"));
        let list = FACES.replace("uchar", "uint");
        let told = "row 0 of 1 of `face` is cut off: the file ends in it";
        assert_eq!(binary(&list, &[255; 4]), told);
        assert_eq!(binary(&FACES.replace("uchar", "char"), &[255; 4]), "row 0 of 1 of `face` has a list of -1 numbers");
    }

    #[test]
    fn files_cut_anywhere_are_refused_in_a_sentence() {
        for bytes in quads() {
            let whole = read(&bytes).unwrap();
            // What stands behind the last number of a text may go.
            let last = bytes.trim_ascii_end().len();
            for cut in 0..last {
                match read(&bytes[..cut]) {
                    // A digit less may be another number.
                    Ok(read) => assert!(cut + 1 == last && read == whole, "{cut}"),
                    Err(Fault::Ply(told)) => assert!(told.len() < 300, "{told}"),
                    Err(other) => panic!("{other}"),
                }
            }
        }
    }
}
