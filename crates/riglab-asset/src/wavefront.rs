//! Lines of Wavefront files, OBJ and MTL, as tobj takes them: it refuses a whole file, or panics, at lines that files have
//! and that other programs read.

mod fault;

use std::borrow::Cow;

use crate::marked::unmarked;

pub(crate) use fault::explain;

/// What of an OBJ is asked for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asked {
    /// Faces and the places of their corners.
    Surface,
    /// That, materials and colours of vertices.
    Looks,
    /// That, normals and texture coordinates.
    All,
}

/// The lines of an OBJ that tobj is given: valid UTF-8, without comments, points and lines (which it takes for faces), of
/// texture coordinates two numbers, of vertices three and what else is asked for. Colours and texture coordinates that some
/// vertices or corners have and others lack are NaN for those, as tobj gives lists of which is not known whose they are.
pub(crate) fn obj(bytes: &[u8], asked: Asked) -> Vec<u8> {
    let text = String::from_utf8_lossy(unmarked(bytes));
    let text = match text.contains('\\') {
        true => joined(&text).flat_map(|(_, line)| [line, "\n".into()]).collect::<String>().into(),
        false => text,
    };
    let is_coloured = |line: &str| line.split_whitespace().next() == Some("v") && numbers(line) >= 6;
    let coloured = asked != Asked::Surface && text.lines().any(is_coloured);
    let lacking = asked == Asked::All && some_lack_coordinates(&text);
    let mut out = String::with_capacity(text.len());
    if lacking {
        out.push_str("vt nan nan\n");
    }
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let Some(word) = words.next() else { continue };
        match word {
            "v" => {
                let words: Vec<&str> = words.take(numbers(line).min(6)).collect();
                out.push('v');
                let (place, colour) = words.split_at(words.len().min(3));
                match colour {
                    &[weight] => out.push_str(&weighted(place, weight, coloured)),
                    _ => place.iter().for_each(|number| out.extend([" ", number])),
                }
                for k in (0..3).filter(|_| coloured) {
                    let own = colour.get(k).filter(|own| colour.len() == 3 && own.parse::<f32>().is_ok());
                    out.extend([" ", own.unwrap_or(&"nan")]);
                }
            }
            "f" => {
                out.push('f');
                words.take_while(|word| !word.starts_with('#')).for_each(|corner| {
                    out.push(' ');
                    match lacking {
                        true => out.push_str(&shifted(corner)),
                        false => out.push_str(corner),
                    }
                });
            }
            "o" | "g" => out.push_str(line.trim()),
            "usemtl" | "mtllib" if asked != Asked::Surface => {
                let name = line.trim()[word.len()..].trim();
                if name.is_empty() {
                    continue;
                }
                out.push_str(word);
                out.push(' ');
                out.push_str(name);
            }
            "vt" if asked == Asked::All => {
                // What is left out is 0, and what is no number none.
                let mut given = words.take_while(|word| !word.starts_with('#'));
                let mut number = || match given.next().unwrap_or("0") {
                    word if word.parse::<f32>().is_ok() => word,
                    _ => "nan",
                };
                out.push_str(&format!("vt {} {}", number(), number()));
            }
            "vn" if asked == Asked::All => out.push_str(line.trim()),
            _ => continue,
        }
        out.push('\n');
    }
    out.into_bytes()
}

/// A place and its weight, by which tobj divides it, but not where a colour follows.
fn weighted(place: &[&str], weight: &str, coloured: bool) -> String {
    let number = |word: &str| word.parse::<f32>().ok();
    let divided = || -> Option<String> {
        let weight = number(weight).filter(|weight| coloured && *weight != 0.0)?;
        place.iter().map(|word| Some(format!(" {}", number(word)? / weight))).collect()
    };
    divided().unwrap_or_else(|| format!(" {} {weight}", place.join(" ")))
}

/// Whether some corners of faces have texture coordinates, and others none.
fn some_lack_coordinates(text: &str) -> bool {
    let (mut with, mut without) = (false, false);
    for line in text.lines() {
        let mut words = line.split_whitespace();
        if words.next() != Some("f") {
            continue;
        }
        for corner in words.take_while(|word| !word.starts_with('#')) {
            match coordinates(corner) {
                Some(_) => with = true,
                None => without = true,
            }
        }
        if with && without {
            return true;
        }
    }
    false
}

/// Which texture coordinates the corner of a face has; tobj takes number 0 for none.
fn coordinates(corner: &str) -> Option<&str> {
    corner.split('/').nth(1).filter(|number| !["", "0"].contains(number))
}

/// The corner of a face where others come first that are none: with these where it has none.
fn shifted(corner: &str) -> String {
    let number = match coordinates(corner) {
        None => "1".into(),
        // What counts from the end does so still.
        Some(own) => own.parse::<u64>().map_or_else(|_| own.to_owned(), |own| own.saturating_add(1).to_string()),
    };
    let mut parts = corner.split('/');
    let (place, normal) = (parts.next().unwrap_or_default(), parts.nth(1));
    let normal = normal.filter(|normal| !normal.is_empty()).map_or(String::new(), |normal| format!("/{normal}"));
    format!("{place}/{number}{normal}")
}

/// How many numbers a line gives behind its first word.
fn numbers(line: &str) -> usize {
    line.split_whitespace().skip(1).take_while(|word| !word.starts_with('#')).count()
}

/// Lines with the numbers that they start at; those that go on in the next one after a backslash as one, whose last need not
/// be there. Comments do not go on.
pub(crate) fn joined(text: &str) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    fn begun(line: &str) -> Option<&str> {
        line.trim_end().strip_suffix('\\').filter(|_| !line.trim_start().starts_with('#'))
    }
    let mut lines = (1..).zip(text.lines());
    std::iter::from_fn(move || {
        let (number, line) = lines.next()?;
        let Some(first) = begun(line) else { return Some((number, Cow::Borrowed(line))) };
        let mut whole = first.to_owned();
        for (_, line) in lines.by_ref() {
            let part = begun(line);
            whole.push(' ');
            whole.push_str(part.unwrap_or(line));
            if part.is_none() {
                break;
            }
        }
        Some((number, Cow::Owned(whole)))
    })
}

/// The lines of a material library that tobj is given. A colour of one number is a grey, as the format has it; what gives
/// no numbers where they belong (`Kd spectral`), and pictures without a name, are left out, and `Tr` becomes `d`.
pub(crate) fn mtl(bytes: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(unmarked(bytes));
    let mut out = String::with_capacity(text.len());
    let mut dissolves = false;
    for line in text.lines() {
        let line = line.trim();
        let mut words = line.split_whitespace();
        let Some(word) = words.next() else { continue };
        let number = |word: &&str| word.parse::<f32>().is_ok();
        dissolves = dissolves && word != "newmtl" || word == "d";
        match word {
            // How much is seen through it, which tobj does not know. Files that tell both mean `d`.
            "Tr" => {
                let Some(clear) = words.next().and_then(|word| word.parse::<f32>().ok()).filter(|_| !dissolves) else {
                    continue;
                };
                out.push_str(&format!("d {}", 1.0 - clear));
            }
            "Ka" | "Kd" | "Ks" | "Ke" => {
                let given: Vec<&str> = words.take_while(number).take(3).collect();
                let Some(first) = given.first() else { continue };
                let part = |k: usize| given.get(k).unwrap_or(first);
                out.push_str(&format!("{word} {} {} {}", part(0), part(1), part(2)));
            }
            "Ns" | "Ni" | "d" => {
                // `d -halo 0.5` has its number last.
                let Some(given) = words.find(number) else { continue };
                out.push_str(&format!("{word} {given}"));
            }
            "illum" if words.next().is_none_or(|model| model.parse::<u8>().is_err()) => continue,
            "newmtl" if line == word => out.push_str("newmtl unnamed"),
            _ if word.starts_with('#') || (line == word && is_picture(word)) => continue,
            _ => out.push_str(line),
        }
        out.push('\n');
    }
    out.into_bytes()
}

/// Whether a word of a material names a picture.
fn is_picture(word: &str) -> bool {
    word.starts_with("map_") || ["bump", "disp", "decal", "norm", "refl"].contains(&word)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(bytes: Vec<u8>) -> String {
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn what_is_seen_through_a_material_is_what_it_does_not_hide() {
        let of = |lines: &str| text(mtl(lines.as_bytes()));
        assert_eq!(of("newmtl a\nTr 0.25\n"), "newmtl a\nd 0.75\n");
        // Who tells both means `d`, first or last; the next material is another.
        assert_eq!(of("newmtl a\nd 0.5\nTr 0.5\nnewmtl b\nTr 1\nd 1"), "newmtl a\nd 0.5\nnewmtl b\nd 0\nd 1\n");
        assert_eq!(of("newmtl a\nTr clear"), "newmtl a\n");
    }

    #[test]
    fn lines_that_no_face_is_made_of_are_left_out() {
        let file =
            b"# \xe9\n v 0 0 0 1\nv 1 0 0 .5 .5\nv\t0 1 0\r\nl 1 2 3\np 1\nusemtl\tred\nusemtl \nvt 1\nf 1 2 \\\n 3\n";
        assert_eq!(text(obj(file, Asked::Surface)), "v 0 0 0 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
        let all = "v 0 0 0 1\nv 1 0 0\nv 0 1 0\nusemtl red\nvt 1 0\nf 1 2 3\n";
        assert_eq!(text(obj(file, Asked::All)), all);
        // A name may hold what begins a comment elsewhere.
        let file = b"v 0 0 0 # first\nusemtl Material #25\nf 1 2 3 # left foot\nf 1 2 3 #\n";
        assert_eq!(text(obj(file, Asked::Looks)), "v 0 0 0\nusemtl Material #25\nf 1 2 3\nf 1 2 3\n");
    }

    #[test]
    fn a_byte_order_mark_costs_no_line() {
        assert_eq!(text(obj(b"\xef\xbb\xbfv 0 0 0\nv 1 0 0\n", Asked::All)), "v 0 0 0\nv 1 0 0\n");
        assert_eq!(text(mtl(b"\xef\xbb\xbfnewmtl a\nKd 1 1 1\n")), "newmtl a\nKd 1 1 1\n");
        // Nor does what is wrong stand elsewhere.
        assert_eq!(explain(b"\xef\xbb\xbfv 0 0 x\n", ""), explain(b"v 0 0 x\n", ""));
    }

    #[test]
    fn colours_and_coordinates_are_kept_where_some_have_them() {
        let all = b"v 0 0 0 1 0 0 1\nv 1 0 0 0 1 0\n";
        assert_eq!(text(obj(all, Asked::Looks)), "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\n");
        assert_eq!(text(obj(all, Asked::Surface)), "v 0 0 0\nv 1 0 0\n");
        let some = b"v 0 0 0 1 0 0\nv 1 0 0\nv 1 0 3 2\nv 1 0 0 1 1 x\n";
        let wanted = "v 0 0 0 1 0 0\nv 1 0 0 nan nan nan\nv 0.5 0 1.5 nan nan nan\nv 1 0 0 1 1 nan\n";
        assert_eq!(text(obj(some, Asked::All)), wanted);
        let some = b"vt .5 1 # a\nvt\nvt x inf\nf 1/1/2 2/-1 3 # b\nf 1//2 2/ 3/0\n";
        let wanted = "vt nan nan\nvt .5 1\nvt 0 0\nvt nan inf\nf 1/2/2 2/-1 3/1\nf 1/1/2 2/1 3/1\n";
        assert_eq!(text(obj(some, Asked::All)), wanted);
        assert_eq!(text(obj(some, Asked::Looks)), "f 1/1/2 2/-1 3\nf 1//2 2/ 3/0\n");
        assert_eq!(text(obj(b"vt 1 # a\nf 1/1 2/1 3/1\n", Asked::All)), "vt 1 0\nf 1/1 2/1 3/1\n");
    }

    #[test]
    fn odd_lines_of_a_library_cost_no_more_than_themselves() {
        let file =
            b"newmtl a\nKd .8\nKs 1 .5\nKe spectral x.rfl\nKa\nd -halo .5\nNs\nillum two\nillum 2\nmap_Kd\nbump \n\
            map_Kd a b.png\nnewmtl\nKd xyz 1 1 1\n";
        let wanted = "newmtl a\nKd .8 .8 .8\nKs 1 .5 1\nd .5\nillum 2\nmap_Kd a b.png\nnewmtl unnamed\n";
        assert_eq!(text(mtl(file)), wanted);
        tobj::load_mtl_buf(&mut wanted.as_bytes()).unwrap();
    }
}
