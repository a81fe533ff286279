//! RigNet's rig text: `joints`, `root`, `hier` and `skin` lines in any order.

use std::collections::HashMap;

use super::super::array_rig::{ArrayRig, SparseRows};
use super::super::fault::{PeerFault, shown};
use super::obj::coordinate;

/// A skin line: its vertex, where it stands, and the words after the vertex.
struct SkinLine<'a> {
    vertex: u32,
    line: usize,
    words: &'a str,
}

/// Whether a text may be of this kind: its first word that matters.
pub(super) fn is_one(text: &str) -> bool {
    let first = text.split_whitespace().next();
    matches!(first, Some("joints" | "joint" | "root" | "hier" | "skin"))
}

/// The rig in the text; weights have a row for each vertex up to `vertices`, or, where that is not
/// known, up to the last that is named.
pub(super) fn read(text: &str, vertices: Option<usize>) -> Result<ArrayRig, PeerFault> {
    let mut rig = ArrayRig::default();
    let mut numbers: HashMap<&str, usize> = HashMap::new();
    let (mut root, mut hier, mut skin) = (None, Vec::new(), Vec::new());
    for (line, content) in (1..).zip(text.lines()) {
        let fault = |reason: String| PeerFault::Line { line, reason };
        let content = content.trim();
        let (word, rest) = content.split_once(char::is_whitespace).unwrap_or((content, ""));
        let mut words = rest.split_whitespace();
        let mut next = |what: &str| words.next().ok_or_else(|| fault(format!("{what} is missing")));
        match word {
            "" => {}
            "joints" | "joint" => {
                let name = next("the joint's name")?;
                if numbers.insert(name, rig.joints.len()).is_some() {
                    return Err(fault(format!("duplicate joint name `{}`", shown(name))));
                }
                let mut axis = || coordinate(words.next(), line);
                rig.joints.push([axis()?, axis()?, axis()?]);
                rig.names.push(name.to_owned());
            }
            "root" => {
                let name = next("the root's name")?;
                match root.replace((name, line)) {
                    Some((first, _)) if first != name => {
                        return Err(fault(format!("a second root, `{}` after `{}`", shown(name), shown(first))));
                    }
                    _ => {}
                }
            }
            "hier" => hier.push((next("the parent")?, next("the child")?, line)),
            "skin" => {
                let vertex = next("the vertex")?;
                let number = vertex.parse().ok().filter(|v| vertices.is_none_or(|n| (*v as usize) < n));
                let vertex: u32 = number.ok_or_else(|| {
                    fault(match vertices {
                        Some(n) => format!("vertex {} is out of range, the OBJ has {n} vertices", shown(vertex)),
                        None => format!("`{}` is no vertex number", shown(vertex)),
                    })
                })?;
                let words = rest.trim_start().split_once(char::is_whitespace).map_or("", |(_, words)| words);
                skin.push(SkinLine { vertex, line, words });
            }
            _ => {
                return Err(fault(format!(
                    "it starts with `{}`, but lines start with joints, root, hier or skin",
                    shown(word)
                )));
            }
        }
    }
    if rig.joints.is_empty() {
        return Err(PeerFault::NoRigText);
    }
    let find = |name: &str, line| {
        numbers
            .get(name)
            .copied()
            .ok_or_else(|| PeerFault::Line { line, reason: format!("unknown joint `{}`", shown(name)) })
    };
    (rig.parents, rig.root) = parents(&rig.names, root, &hier, find)?;
    rig.weights = weights(&skin, vertices, find)?;
    Ok(rig)
}

/// The parent of each joint, and the root.
fn parents<'a>(
    names: &[String],
    root: Option<(&'a str, usize)>,
    hier: &[(&'a str, &'a str, usize)],
    find: impl Fn(&str, usize) -> Result<usize, PeerFault>,
) -> Result<(Vec<Option<usize>>, Option<usize>), PeerFault> {
    let mut parents: Vec<Option<usize>> = vec![None; names.len()];
    for &(parent, child, line) in hier {
        let (p, c) = (find(parent, line)?, find(child, line)?);
        match parents[c].replace(p) {
            Some(first) if first != p => {
                return Err(PeerFault::TwoJointParents {
                    joint: format!("`{}`", shown(child)),
                    first: format!("`{}`", shown(&names[first])),
                    second: format!("`{}`", shown(parent)),
                });
            }
            _ => {}
        }
    }
    let Some((root, line)) = root else {
        return Err(PeerFault::field("root", "is missing: no line names the root joint"));
    };
    let root = find(root, line)?;
    if let Some(parent) = parents[root] {
        let quoted = |joint: usize| format!("`{}`", shown(&names[joint]));
        return Err(PeerFault::RootHasParent { root: quoted(root), parent: quoted(parent) });
    }
    Ok((parents, Some(root)))
}

fn weights(
    skin: &[SkinLine<'_>],
    vertices: Option<usize>,
    find: impl Fn(&str, usize) -> Result<usize, PeerFault>,
) -> Result<Option<SparseRows>, PeerFault> {
    if skin.is_empty() {
        return Ok(None);
    }
    let mut triples = Vec::new();
    let mut seen: HashMap<u32, usize> = HashMap::with_capacity(skin.len());
    for &SkinLine { vertex, line, words } in skin {
        let fault = |reason: String| PeerFault::Line { line, reason };
        if let Some(first) = seen.insert(vertex, line) {
            return Err(fault(format!("vertex {vertex} has a skin line already, line {first}")));
        }
        let mut words = words.split_whitespace();
        while let Some(name) = words.next() {
            let joint = find(name, line)?;
            let word = words.next().ok_or_else(|| fault(format!("the weight after `{}` is missing", shown(name))))?;
            let weight: f32 = word.parse().map_err(|_| fault(format!("`{}` is not a number", shown(word))))?;
            if !weight.is_finite() {
                return Err(fault(format!("the weight `{}` is not finite", shown(word))));
            }
            if weight < 0.0 {
                return Err(fault(format!("negative weight `{}`", shown(word))));
            }
            if weight > 0.0 {
                triples.push((vertex, joint as u32, weight));
            }
        }
    }
    // Without the mesh the last vertex named tells how many there are: not more than lines allow.
    let rows = match vertices {
        Some(count) => count,
        None => {
            let last = seen.keys().max().map_or(0, |v| *v as usize + 1);
            if last > 16 * skin.len() + 1024 {
                return Err(PeerFault::TooLarge(format!("vertex {}", last - 1)));
            }
            last
        }
    };
    Ok(Some(SparseRows::from_triples(rows, &triples)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_in_any_order() {
        let text = "hier a b\r\n\r\nskin 1 b 0.5 a 0.25 b 0.25\nroot a\njoint b 0 1 0\njoints a 0 0 0\n";
        let rig = read(text, Some(2)).unwrap();
        assert_eq!(rig.names, ["b", "a"]);
        assert_eq!(rig.parents, [Some(1), None]);
        assert_eq!(rig.weights.unwrap().row(1), [(0, 0.5), (1, 0.25), (0, 0.25)]);
    }

    #[test]
    fn faults_are_told_with_their_line() {
        let tree = "joints a 0 0 0\njoints b 0 1 0\nroot a\n";
        let cases = [
            ("", "neither a rig text"),
            ("joints a 0 0 0\njoints a 0 0 0\nroot a", "line 2: duplicate joint name `a`"),
            ("joints a 0 0 0", "no line names the root"),
            (&format!("{tree}root b"), "line 4: a second root"),
            (&format!("{tree}hier b a"), "joint `b` is its parent"),
            (&format!("{tree}hier a b\nskin 0 a 1\nskin 0 a 1"), "line 6: vertex 0 has a skin line already"),
            (&format!("{tree}hier a b\nskin 4000000000 a 1"), "would take more memory"),
            (&format!("{tree}hier a"), "line 4: the child is missing"),
            (&format!("{tree}bone a"), "line 4: it starts with `bone`"),
        ];
        for (text, wanted) in cases {
            let found = read(text, None).unwrap_err().to_string();
            assert!(found.contains(wanted), "{found} / {wanted}");
        }
    }
}
