//! What is repaired on request alone: it guesses what was meant.
//!
//! Joints that no line of a rig text connects to its root go below the root. Copies of branching joints,
//! which RigNet's predictions have between a joint and each of its children so that bones can be told
//! apart on screen, are taken out again.

use super::array_rig::{ArrayRig, SparseRows};
use super::fault::PeerFault;
use super::fields;
use crate::Warning;

/// Repairs a rig and tells what was done.
pub(super) fn repair(rig: &mut ArrayRig) -> Result<Vec<Warning>, PeerFault> {
    let mut warnings = Vec::new();
    warnings.extend(attach(rig));
    // What follows relies on weights and parents that name joints.
    fields::check(rig)?;
    warnings.extend(fold(rig));
    Ok(warnings)
}

/// Puts loose joints below the root that the file names.
fn attach(rig: &mut ArrayRig) -> Option<Warning> {
    let root = rig.root?;
    let loose: Vec<usize> = fields::loose(rig).collect();
    let named = |joint: usize| rig.names.get(joint).cloned().unwrap_or_default();
    let warning = Warning::Attached { joints: loose.iter().map(|&j| named(j)).collect(), root: named(root) };
    for &joint in &loose {
        rig.parents[joint] = Some(root);
    }
    (!loose.is_empty()).then_some(warning)
}

/// Takes out joints `NAME_dup_K` whose parent is NAME; NAME gets their children and weights.
fn fold(rig: &mut ArrayRig) -> Option<Warning> {
    if rig.names.is_empty() || rig.parents.is_empty() {
        return None;
    }
    let copied = |joint: usize| {
        let parent = rig.parents[joint]?;
        let (name, number) = rig.names[joint].rsplit_once("_dup_")?;
        let is_number = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
        (is_number && rig.names[parent] == name).then_some(parent)
    };
    let copy_of: Vec<Option<usize>> = (0..rig.names.len()).map(copied).collect();
    // Joint by joint along the tree, as a copy may be of a copy.
    let mut kept: Vec<usize> = (0..copy_of.len()).collect();
    for joint in fields::depth_first(&rig.parents, &rig.names).ok()? {
        if let Some(parent) = copy_of[joint] {
            kept[joint] = kept[parent];
        }
    }
    let is_kept = |joint: &usize| copy_of[*joint].is_none();
    let order: Vec<usize> = (0..copy_of.len()).filter(is_kept).collect();
    let folded: Vec<String> = (0..copy_of.len()).filter(|j| !is_kept(j)).map(|j| rig.names[j].clone()).collect();
    if folded.is_empty() {
        return None;
    }
    let mut number = vec![0; copy_of.len()];
    for (new, &old) in order.iter().enumerate() {
        number[old] = new;
    }
    let new = |old: usize| number[kept[old]];
    rig.parents = order.iter().map(|&j| rig.parents[j].map(new)).collect();
    rig.names = order.iter().map(|&j| std::mem::take(&mut rig.names[j])).collect();
    rig.joints = order.iter().map(|&j| rig.joints[j]).collect();
    if !rig.tails.is_empty() {
        rig.tails = order.iter().map(|&j| rig.tails[j]).collect();
    }
    rig.root = rig.root.map(new);
    if let Some(rows) = &rig.weights {
        rig.weights = Some(summed(rows, new));
    }
    Some(Warning::FoldedCopies { joints: folded })
}

/// The rows by other numbers of joints; weights of what became one joint add up.
fn summed(rows: &SparseRows, new: impl Fn(usize) -> usize) -> SparseRows {
    let mut out = SparseRows { offsets: Vec::with_capacity(rows.offsets.len()), pairs: Vec::new() };
    out.offsets.push(0);
    for row in 0..rows.rows() {
        let start = out.pairs.len();
        out.pairs.extend(rows.row(row).iter().map(|&(joint, weight)| (new(joint as usize) as u32, weight)));
        out.pairs[start..].sort_by_key(|(joint, _)| *joint);
        let mut end = start;
        for at in start..out.pairs.len() {
            let (joint, weight) = out.pairs[at];
            if end > start && out.pairs[end - 1].0 == joint {
                out.pairs[end - 1].1 += weight;
            } else {
                out.pairs[end] = (joint, weight);
                end += 1;
            }
        }
        out.pairs.truncate(end);
        out.end_row();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(names: &[&str], parents: &[Option<usize>], weights: &[(u32, u32, f32)]) -> ArrayRig {
        ArrayRig {
            names: names.iter().map(|n| (*n).to_owned()).collect(),
            joints: (0..names.len()).map(|j| [j as f32, 0.0, 0.0]).collect(),
            parents: parents.to_vec(),
            root: Some(0),
            vertices: vec![[0.0; 3]; 2],
            weights: Some(SparseRows::from_triples(2, weights)),
            ..ArrayRig::default()
        }
    }

    #[test]
    fn copies_fold_into_what_they_copy() {
        let names = ["hips", "hips_dup_0", "leg", "hips_dup_1", "hips_dup_1_dup_0", "arm"];
        let parents = [None, Some(0), Some(1), Some(0), Some(3), Some(4)];
        let mut rig = rig(&names, &parents, &[(0, 1, 0.25), (0, 5, 0.5), (0, 4, 0.25), (1, 2, 1.0)]);
        let told = repair(&mut rig).unwrap();
        assert_eq!(rig.names, ["hips", "leg", "arm"]);
        assert_eq!(rig.parents, [None, Some(0), Some(0)]);
        assert_eq!(rig.joints, [[0.0; 3], [2.0, 0.0, 0.0], [5.0, 0.0, 0.0]]);
        let rows = rig.weights.unwrap();
        assert_eq!((rows.row(0), rows.row(1)), (&[(0, 0.5), (2, 0.5)][..], &[(1, 1.0)][..]));
        let text = told[0].to_string();
        assert!(text.contains("(`hips_dup_0`, `hips_dup_1`, `hips_dup_1_dup_0`)"), "{text}");
    }

    #[test]
    fn names_that_only_look_like_copies_stay() {
        // Of another joint, without number, and the root.
        let names = ["a_dup_0", "b_dup_0", "a_dup_0_dup_x", "a_dup_0_dup_"];
        let before = rig(&names, &[None, Some(0), Some(0), Some(0)], &[(0, 1, 1.0)]);
        let mut after = before.clone();
        assert_eq!(repair(&mut after), Ok(vec![]));
        assert_eq!(after, before);
    }

    #[test]
    fn loose_joints_go_below_the_root() {
        let mut rig = rig(&["hips", "leg", "ik", "pole"], &[None, Some(0), None, Some(2)], &[(0, 2, 1.0)]);
        assert!(matches!(fields::check(&rig), Err(PeerFault::Unreachable(joint)) if joint == "`ik`"));
        let told = repair(&mut rig).unwrap();
        assert_eq!(rig.parents, [None, Some(0), Some(0), Some(2)]);
        assert_eq!(told, [Warning::Attached { joints: vec!["ik".into()], root: "hips".into() }]);
    }

    #[test]
    fn cycles_stay_refused() {
        let mut rig = rig(&["a", "b", "c"], &[None, Some(2), Some(1)], &[(0, 0, 1.0)]);
        assert!(matches!(repair(&mut rig), Err(PeerFault::JointCycle(_))));
    }
}
