//! Which joints are of one skeleton.

/// The skeleton of each joint, numbered from 0 in the order of joints: trees are joined by the skins that bind them
/// together. `parents` come before their children; `skins` list joints.
pub(crate) fn group<'a>(parents: &[Option<u16>], skins: impl Iterator<Item = &'a [u16]>) -> Vec<usize> {
    // The tree of each joint as the joint that is its root.
    let mut tree: Vec<usize> = Vec::with_capacity(parents.len());
    for (i, parent) in parents.iter().enumerate() {
        tree.push(parent.map_or(i, |p| tree[usize::from(p)]));
    }
    let mut group: Vec<usize> = (0..parents.len()).collect();
    for skin in skins {
        let mut trees = skin.iter().map(|&j| tree[usize::from(j)]);
        let Some(first) = trees.next().map(|t| leader(&mut group, t)) else { continue };
        for t in trees {
            let (first, other) = (leader(&mut group, first), leader(&mut group, t));
            group[other.max(first)] = other.min(first);
        }
    }
    let mut numbers: Vec<Option<usize>> = vec![None; parents.len()];
    let mut next = 0;
    tree.iter()
        .map(|&t| {
            *numbers[leader(&mut group, t)].get_or_insert_with(|| {
                next += 1;
                next - 1
            })
        })
        .collect()
}

/// The lowest of a group; shortens the way there.
fn leader(group: &mut [usize], mut at: usize) -> usize {
    while group[at] != at {
        group[at] = group[group[at]];
        at = group[at];
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skins_join_trees() {
        let parents = [None, Some(0), None, None, Some(3), None];
        let skins: [&[u16]; 3] = [&[1], &[5, 4, 2], &[]];
        assert_eq!(group(&parents, skins.into_iter()), [0, 0, 1, 1, 1, 1]);
        assert_eq!(group(&[], [].into_iter()), [] as [usize; 0]);
    }

    #[test]
    fn a_skin_whose_first_tree_is_not_the_lowest_joins_all() {
        let skins: [&[u16]; 1] = [&[2, 0, 1]];
        assert_eq!(group(&[None; 3], skins.into_iter()), [0, 0, 0]);
    }
}
