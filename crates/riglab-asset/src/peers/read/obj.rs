//! OBJ with the vertices in the order of the file, because weights count them.

use riglab_core::Vec3;

use super::super::fault::{PeerFault, shown};
use crate::marked::unmarked;
use crate::wavefront::joined;

/// Vertices and triangles; polygons are cut into fans from their first corner. Everything but `v`
/// and `f` lines is passed over, and so are comments behind them; a line goes on in the next one after a backslash. Names may
/// be in any encoding.
pub(super) fn read(bytes: &[u8]) -> Result<(Vec<Vec3>, Vec<[u32; 3]>), PeerFault> {
    let text = String::from_utf8_lossy(unmarked(bytes));
    let mut vertices: Vec<Vec3> = Vec::new();
    let mut faces: Vec<[u32; 3]> = Vec::new();
    // A face may name vertices that come later: those are checked at the end.
    let mut highest = (0, 0);
    for (line, content) in joined(&text) {
        let fault = |reason: String| PeerFault::Line { line, reason };
        let mut words = content.split_whitespace().take_while(|word| !word.starts_with('#'));
        match words.next() {
            Some("v") => {
                let mut next = || coordinate(words.next(), line);
                vertices.push([next()?, next()?, next()?]);
            }
            Some("f") => {
                let mut first = None;
                let mut last = None;
                let mut corners = 0;
                for word in words {
                    let index = word.split('/').next().unwrap_or_default();
                    let vertex = match index.parse::<i64>() {
                        Ok(n) if n > 0 => Some(n - 1),
                        Ok(n) if n < 0 => Some(n.saturating_add(vertices.len() as i64)),
                        _ => None,
                    };
                    let vertex = vertex.and_then(|v| u32::try_from(v).ok());
                    let vertex = vertex.ok_or_else(|| fault(format!("`{}` is no corner of a face", shown(word))))?;
                    highest = highest.max((vertex, line));
                    match (first, last) {
                        (Some(a), Some(b)) => faces.push([a, b, vertex]),
                        (None, _) => {
                            first = Some(vertex);
                            corners += 1;
                            continue;
                        }
                        _ => {}
                    }
                    last = Some(vertex);
                    corners += 1;
                }
                if corners < 3 {
                    return Err(fault(format!("a face has {corners} corners")));
                }
            }
            _ => {}
        }
    }
    if !faces.is_empty() && highest.0 as usize >= vertices.len() {
        let (vertex, line) = highest;
        let reason = format!("a face names vertex {}, there are {}", u64::from(vertex) + 1, vertices.len());
        return Err(PeerFault::Line { line, reason });
    }
    Ok((vertices, faces))
}

/// A finite number.
pub(super) fn coordinate(word: Option<&str>, line: usize) -> Result<f32, PeerFault> {
    let fault = |reason: String| PeerFault::Line { line, reason };
    let word = word.ok_or_else(|| fault("a coordinate is missing".into()))?;
    let value: f32 = word.parse().map_err(|_| fault(format!("`{}` is not a number", shown(word))))?;
    if value.is_finite() { Ok(value) } else { Err(fault(format!("`{}` is not finite", shown(word)))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_keep_their_order_and_corners_may_have_any_form() {
        let text = "# x\r\nv 9 9 9 1.0\nv 0 0 0 .5 .5 .5\nv 1 0 0\nv 1 1 0\nf 4/1/1 2//3 3/7\nf -3 -2 -1 1\nl 1 2\n";
        let (vertices, faces) = read(text.as_bytes()).unwrap();
        assert_eq!(vertices[0], [9.0; 3]);
        assert_eq!(faces, [[3, 1, 2], [1, 2, 3], [1, 3, 0]]);
    }

    #[test]
    fn comments_and_lines_that_go_on_are_read_as_elsewhere() {
        let text = "v 0 0 0 # a\n# \\\nv 1 \\\n 0 0\nv 1 1 0\nf 1 2 \\\n3 # left foot\n";
        assert_eq!(read(format!("{text}f 1 2").as_bytes()).unwrap_err().to_string(), "line 8: a face has 2 corners");
        let (vertices, faces) = read(text.as_bytes()).unwrap();
        assert_eq!((vertices.len(), vertices[1], faces), (3, [1.0, 0.0, 0.0], vec![[0, 1, 2]]));
    }

    #[test]
    fn a_last_line_that_would_go_on_counts_and_names_may_be_in_any_encoding() {
        let (vertices, faces) = read(b"o caf\xe9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 \\\n3 \\").unwrap();
        assert_eq!((vertices.len(), faces), (3, vec![[0, 1, 2]]));
    }

    #[test]
    fn broken_lines_are_named() {
        let cases = [
            ("v 0 0\n", "line 1: a coordinate is missing"),
            ("v 0 0 x\n", "line 1: `x` is not a number"),
            ("v 0 0 inf\n", "line 1: `inf` is not finite"),
            ("v 0 0 0\nf 1 1\n", "line 2: a face has 2 corners"),
            ("v 0 0 0\nf 1 1 2\n", "line 2: a face names vertex 2, there are 1"),
            ("v 0 0 0\nf 0 1 1\n", "line 2: `0` is no corner of a face"),
            ("v 0 0 0\nf -2 1 1\n", "line 2: `-2` is no corner of a face"),
        ];
        for (text, wanted) in cases {
            assert_eq!(read(text.as_bytes()).unwrap_err().to_string(), wanted);
        }
    }
}
