//! RigNet's skeleton text: `LEVEL NAME X Y Z PARENT`, a line a joint, with or without a number for
//! the order of siblings after it.

use std::collections::HashMap;

use super::super::array_rig::ArrayRig;
use super::super::fault::{PeerFault, shown};
use super::obj::coordinate;

/// Whether a text may be of this kind: a level, a name and three coordinates.
pub(super) fn is_one(text: &str) -> bool {
    let words: Vec<&str> =
        text.lines().find(|l| !l.trim().is_empty()).unwrap_or("").split_whitespace().take(8).collect();
    matches!(words.len(), 6 | 7)
        && words[0].parse::<u32>().is_ok()
        && words[2..5].iter().all(|w| w.parse::<f32>().is_ok())
}

/// The joints in the text.
pub(super) fn read(text: &str) -> Result<ArrayRig, PeerFault> {
    let mut rig = ArrayRig::default();
    let mut numbers: HashMap<&str, usize> = HashMap::new();
    let mut parents = Vec::new();
    for (line, content) in (1..).zip(text.lines()) {
        let fault = |reason: String| PeerFault::Line { line, reason };
        let mut words = content.split_whitespace();
        let Some(level) = words.next() else { continue };
        level.parse::<u32>().map_err(|_| fault(format!("`{}` is no level", shown(level))))?;
        let name = words.next().ok_or_else(|| fault("the joint's name is missing".into()))?;
        if numbers.insert(name, rig.joints.len()).is_some() {
            return Err(fault(format!("duplicate joint name `{}`", shown(name))));
        }
        let mut axis = || coordinate(words.next(), line);
        rig.joints.push([axis()?, axis()?, axis()?]);
        rig.names.push(name.to_owned());
        parents.push((words.next().ok_or_else(|| fault("the parent is missing".into()))?, line));
    }
    let find = |&(name, line): &(&str, usize)| match numbers.get(name) {
        Some(&joint) => Ok(Some(joint)),
        None if name == "None" => Ok(None),
        None => Err(PeerFault::Line { line, reason: format!("unknown joint `{}`", shown(name)) }),
    };
    rig.parents = parents.iter().map(find).collect::<Result<_, _>>()?;
    Ok(rig)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_names_and_parents_are_read() {
        let text = "0 hips 0 1 0 None\n1 spine 0 2 0 hips 0\n\n1 leg 0 0.5 0 hips 1\n";
        assert!(is_one(text) && !is_one("joints a 0 0 0"));
        let rig = read(text).unwrap();
        assert_eq!(rig.names, ["hips", "spine", "leg"]);
        assert_eq!(rig.parents, [None, Some(0), Some(0)]);
        assert!(read("0 a 0 0 0 z").unwrap_err().to_string().contains("unknown joint `z`"));
        assert!(read("x a 0 0 0 z").unwrap_err().to_string().contains("no level"));
    }
}
