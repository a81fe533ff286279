//! In which order joints are written.

use std::collections::HashMap;

use crate::template::Part;
use crate::{Bones, EncodeFault, Siblings};

/// An order of joints, with the parts of a template in it.
#[derive(Debug, Default)]
pub(crate) struct Order {
    /// At each place, the joint as given.
    pub joints: Vec<usize>,
    /// Parts by the place of their first joint: the number in the vocabulary.
    pub parts: Vec<(usize, usize)>,
    /// Joints of parts: the place where the others begin.
    pub others: usize,
}

/// Depth first with sorted siblings, or as given.
pub(crate) fn walk(bones: &Bones<'_>, siblings: Siblings) -> Vec<usize> {
    let count = bones.joints.len();
    let axes = match siblings {
        Siblings::AsGiven => return (0..count).collect(),
        Siblings::YUp => [1, 2, 0],
        Siblings::ZUp => [2, 1, 0],
        Siblings::Zxy => [2, 0, 1],
    };
    // The children of each joint, one joint's after another's.
    let mut starts = vec![0; count + 1];
    bones.parents.iter().flatten().for_each(|&p| starts[p + 1] += 1);
    (0..count).for_each(|joint| starts[joint + 1] += starts[joint]);
    let (mut next, mut children) = (starts.clone(), vec![0; starts[count]]);
    for (joint, parent) in bones.parents.iter().enumerate() {
        if let Some(parent) = *parent {
            children[next[parent]] = joint;
            next[parent] += 1;
        }
    }
    let key = |joint: usize| axes.map(|axis| bones.joints[joint][axis]);
    let (mut order, mut open) = (Vec::with_capacity(count), vec![0]);
    while let Some(joint) = open.pop() {
        order.push(joint);
        let of = &mut children[starts[joint]..starts[joint + 1]];
        // The last comes off the stack first; joints at one place keep their order.
        of.sort_by(|&a, &b| {
            let places = key(a).iter().zip(&key(b)).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne());
            places.unwrap_or_else(|| a.cmp(&b)).reverse()
        });
        open.extend_from_slice(of);
    }
    order
}

/// Puts the joints of a template's parts first, in the template's order. A part that lacks a joint is passed
/// over; one that hangs on a joint of no part ends the search (UniRig's order step).
///
/// # Errors
/// Where two joints have one name, or a template's joint stands before its parent.
pub(crate) fn parts_first(
    bones: &Bones<'_>,
    order: Vec<usize>,
    parts: &[(usize, &'static Part)],
) -> Result<Order, EncodeFault> {
    let mut by_name = HashMap::with_capacity(bones.names.len());
    for (joint, name) in bones.names.iter().enumerate() {
        if by_name.insert(name.as_str(), joint).is_some() {
            return Err(EncodeFault::TwoOfOneName(name.clone()));
        }
    }
    let mut placed = vec![false; bones.joints.len()];
    let mut new = Order::default();
    for (number, part) in parts {
        let Some(joints) = part.joints.iter().map(|name| by_name.get(name).copied()).collect::<Option<Vec<_>>>() else {
            continue;
        };
        joints.iter().for_each(|&j| placed[j] = true);
        if joints.iter().any(|&j| bones.parents[j].is_some_and(|p| !placed[p])) {
            joints.iter().for_each(|&j| placed[j] = false);
            break;
        }
        new.parts.push((new.joints.len(), *number));
        new.joints.extend(joints);
    }
    new.others = new.joints.len();
    new.joints.extend(order.into_iter().filter(|&j| !placed[j]));
    let mut seen = vec![false; bones.joints.len()];
    for (place, &joint) in new.joints.iter().enumerate() {
        if bones.parents[joint].map_or(place > 0, |p| !seen[p]) {
            return Err(EncodeFault::TemplateOutOfOrder(bones.names[joint].clone()));
        }
        seen[joint] = true;
    }
    Ok(new)
}

/// The order in which UniRig's public code takes the bones of an armature: from the bone that is listed `first` up
/// to its root, then depth first with children as the arrays have them. Bones of other roots are left out, as
/// there; what that code sorts siblings by has one value for all of them. `None` where a parent or `first` is no
/// bone, or parents lead around in a circle.
pub fn extraction_order(parents: &[Option<usize>], first: usize) -> Option<Vec<usize>> {
    let mut children = vec![Vec::new(); parents.len()];
    for (bone, parent) in parents.iter().enumerate() {
        if let Some(parent) = parent {
            children.get_mut(*parent)?.push(bone);
        }
    }
    let (mut root, mut steps) = (first, 0);
    while let Some(parent) = *parents.get(root)? {
        (root, steps) = (parent, steps + 1);
        if steps > parents.len() {
            return None;
        }
    }
    let (mut order, mut open) = (Vec::new(), vec![root]);
    while let Some(bone) = open.pop() {
        order.push(bone);
        open.extend(children[bone].iter().rev());
    }
    Some(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn siblings_stand_as_asked_for() {
        // The last stands where the first child does.
        let joints = [[0.0; 3], [1.0, 2.0, 1.0], [2.0, 1.0, 1.0], [5.0; 3], [0.0, 3.0, 0.0], [1.0, 2.0, 1.0]];
        let parents = [None, Some(0), Some(0), Some(2), Some(0), Some(0)];
        let bones = Bones { joints: &joints, parents: &parents, names: &[] };
        for (siblings, order) in [
            (Siblings::AsGiven, [0, 1, 2, 3, 4, 5]),
            (Siblings::YUp, [0, 2, 3, 1, 5, 4]),
            (Siblings::ZUp, [0, 4, 2, 3, 1, 5]),
            (Siblings::Zxy, [0, 4, 1, 5, 2, 3]),
        ] {
            assert_eq!(walk(&bones, siblings), order, "{siblings:?}");
        }
    }
}
