//! Rules that all readers share: what arrays must be to be a rig's.

use riglab_core::Vec3;

use super::array_rig::ArrayRig;
use super::fault::{PeerFault, shown};

/// Triangles out of stored numbers.
pub(crate) fn faces(rows: &[[i64; 3]], vertices: usize) -> Result<Vec<[u32; 3]>, PeerFault> {
    let mut out = Vec::with_capacity(rows.len());
    for (face, row) in rows.iter().enumerate() {
        for &index in row {
            number(index, vertices, || format!("face {face}"), "vertex")?;
        }
        out.push(row.map(|v| v as u32));
    }
    Ok(out)
}

/// A stored number as an index below `count`.
pub(crate) fn number(
    index: i64,
    count: usize,
    what: impl Fn() -> String,
    to: &'static str,
) -> Result<usize, PeerFault> {
    let found = usize::try_from(index).ok().filter(|i| *i < count && u32::try_from(*i).is_ok());
    found.ok_or_else(|| PeerFault::Index { what: what(), to, index, count })
}

/// Parents out of numbers, with -1 for a root.
pub(crate) fn parents(
    numbers: impl IntoIterator<Item = Option<i64>>,
    joints: usize,
) -> Result<Vec<Option<usize>>, PeerFault> {
    let parent = |(joint, stored): (usize, Option<i64>)| match stored {
        None | Some(-1) => Ok(None),
        Some(p) => number(p, joints, || format!("`parents` of joint {joint}"), "joint").map(Some),
    };
    let out: Vec<_> = numbers.into_iter().enumerate().map(parent).collect::<Result<_, _>>()?;
    if out.len() == joints {
        Ok(out)
    } else {
        Err(PeerFault::field("parents", format!("has {} entries for {joints} joints", out.len())))
    }
}

/// Parents out of rows (parent, child), and the joint that is said to be the root.
pub(crate) fn parents_of_bones(
    bones: &[[i64; 2]],
    root: Option<i64>,
    joints: usize,
) -> Result<Vec<Option<usize>>, PeerFault> {
    let mut out: Vec<Option<usize>> = vec![None; joints];
    for (bone, &[parent, child]) in bones.iter().enumerate() {
        let named = |index| number(index, joints, || format!("bone {bone}"), "joint");
        let (parent, child) = (named(parent)?, named(child)?);
        match out[child].replace(parent) {
            // The same bone twice says nothing new.
            Some(first) if first != parent => {
                return Err(PeerFault::TwoJointParents {
                    joint: child.to_string(),
                    first: first.to_string(),
                    second: parent.to_string(),
                });
            }
            _ => {}
        }
    }
    if let Some(root) = root {
        let root = number(root, joints, || "`root_index`".to_owned(), "joint")?;
        if let Some(parent) = out[root] {
            return Err(PeerFault::RootHasParent { root: root.to_string(), parent: parent.to_string() });
        }
    }
    Ok(out)
}

/// Refuses arrays that do not fit together, numbers that are not finite and indices out of range.
pub(crate) fn check(rig: &ArrayRig) -> Result<(), PeerFault> {
    let joints = rig.joints.len();
    finite(&rig.vertices, "vertex")?;
    finite(&rig.joints, "joint")?;
    finite(&rig.tails, "the tail of joint")?;
    let per_joint = [("names", rig.names.len()), ("parents", rig.parents.len()), ("tails", rig.tails.len())];
    for (field, found) in per_joint {
        if found != 0 && found != joints {
            return Err(PeerFault::field(field, format!("has {found} entries for {joints} joints")));
        }
    }
    depth_first(&rig.parents, &rig.names)?;
    // The peers' readers drop such joints silently; their weights are lost then.
    if let Some(joint) = loose(rig).next() {
        return Err(PeerFault::Unreachable(named(joint, &rig.names)));
    }
    if u32::try_from(rig.vertices.len()).is_err() {
        return Err(PeerFault::field("vertices", "has more than 4,294,967,295 rows"));
    }
    let Some(weights) = &rig.weights else { return Ok(()) };
    if weights.rows() != rig.vertices.len() {
        let reason = format!("has {} rows for {} vertices", weights.rows(), rig.vertices.len());
        return Err(PeerFault::field("weights", reason));
    }
    for vertex in 0..weights.rows() {
        for &(joint, weight) in weights.row(vertex) {
            number(joint.into(), joints, || format!("a weight of vertex {vertex}"), "joint")?;
            if !weight.is_finite() {
                return Err(PeerFault::NotFinite { what: format!("a weight of vertex {vertex}") });
            }
        }
    }
    Ok(())
}

/// Joints without parent beside the root that the file names.
pub(crate) fn loose(rig: &ArrayRig) -> impl Iterator<Item = usize> {
    let of_root = rig.root.map(|root| rig.parents.iter().enumerate().filter(move |(j, p)| p.is_none() && *j != root));
    of_root.into_iter().flatten().map(|(joint, _)| joint)
}

fn finite(points: &[Vec3], what: &str) -> Result<(), PeerFault> {
    match points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        Some(at) => Err(PeerFault::NotFinite { what: format!("{what} {at}") }),
        None => Ok(()),
    }
}

/// Joints depth first, children in the order of the file: roots one after the other, each with all
/// that is below it. Names are for messages.
pub(crate) fn depth_first(parents: &[Option<usize>], names: &[String]) -> Result<Vec<usize>, PeerFault> {
    // Counting sort of the children by parent: `start[p]..start[p + 1]` are those of p.
    let mut start = vec![0u32; parents.len() + 2];
    for parent in parents.iter().flatten() {
        start[parent + 2] += 1;
    }
    for at in 2..start.len() {
        start[at] += start[at - 1];
    }
    let mut children = vec![0u32; parents.iter().flatten().count()];
    for (joint, parent) in parents.iter().enumerate().filter_map(|(j, p)| Some((j, (*p)?))) {
        let slot = &mut start[parent + 1];
        children[*slot as usize] = joint as u32;
        *slot += 1;
    }
    let mut order = Vec::with_capacity(parents.len());
    let mut open: Vec<usize> = (0..parents.len()).rev().filter(|&j| parents[j].is_none()).collect();
    while let Some(joint) = open.pop() {
        order.push(joint);
        let own = &children[start[joint] as usize..start[joint + 1] as usize];
        open.extend(own.iter().rev().map(|&c| c as usize));
    }
    if order.len() == parents.len() {
        return Ok(order);
    }
    let mut reached = vec![false; parents.len()];
    order.iter().for_each(|&j| reached[j] = true);
    let first = reached.iter().position(|r| !r).unwrap_or(0);
    Err(PeerFault::JointCycle(named(first, names)))
}

/// What a message calls a joint.
pub(crate) fn named(joint: usize, names: &[String]) -> String {
    names.get(joint).map_or_else(|| joint.to_string(), |n| format!("`{}`", shown(n)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trees_come_depth_first_and_cycles_are_named() {
        let names: Vec<String> = ["a", "b", "c", "d", "e"].map(String::from).to_vec();
        // c is the root of b and d, b of a; e stands alone.
        let order = depth_first(&[Some(1), Some(2), None, Some(2), None], &names).unwrap();
        assert_eq!(order, [2, 1, 0, 3, 4]);
        assert_eq!(depth_first(&[None, Some(2), Some(1)], &names), Err(PeerFault::JointCycle("`b`".into())));
        assert_eq!(depth_first(&[Some(0)], &[]), Err(PeerFault::JointCycle("0".into())));
        assert_eq!(depth_first(&[], &[]), Ok(vec![]));
    }

    #[test]
    fn bones_give_parents_or_a_fault() {
        assert_eq!(parents_of_bones(&[[1, 0], [1, 2], [1, 2]], Some(1), 3).unwrap(), [Some(1), None, Some(1)]);
        assert!(matches!(parents_of_bones(&[[0, 2], [1, 2]], None, 3), Err(PeerFault::TwoJointParents { .. })));
        assert!(matches!(parents_of_bones(&[[0, 1]], Some(1), 2), Err(PeerFault::RootHasParent { .. })));
        assert!(matches!(parents_of_bones(&[[0, 9]], None, 2), Err(PeerFault::Index { .. })));
        assert!(matches!(parents_of_bones(&[], Some(-1), 2), Err(PeerFault::Index { .. })));
    }
}
