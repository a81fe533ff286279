//! Where bones end, by the rule of UniRig's release.

/// The end of each bone: of one with one child the child's head; of others the head and half the way from
/// the parent; of a root that branches, half again its own position and a step up, as released.
pub(crate) fn tails(heads: &[[f32; 3]], parents: &[Option<usize>]) -> Vec<[f32; 3]> {
    // How many children each joint has, and the last of them: no list of lists, which would cost more than the rest.
    let mut children = vec![(0_usize, 0_usize); heads.len()];
    for (joint, parent) in parents.iter().enumerate() {
        if let Some(parent) = *parent {
            children[parent] = (children[parent].0 + 1, joint);
        }
    }
    let distance = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
    let end = |joint: usize| -> [f32; 3] {
        let head = heads[joint];
        match (children[joint], parents[joint]) {
            ((1, only), _) => heads[only],
            ((below @ 1.., _), None) => {
                let own = heads.iter().zip(parents).filter(|(_, parent)| **parent == Some(joint));
                let mean = own.map(|(child, _)| distance(*child, head)).sum::<f32>() / below as f32;
                let onward = [head[0], head[1], head[2] + 0.5 * mean];
                std::array::from_fn(|k| head[k] + 0.5 * onward[k])
            }
            (_, parent) => {
                let from = parent.map_or(head, |p| heads[p]);
                if distance(head, from) <= 1e-9 {
                    return [head[0], head[1], head[2] + 0.5];
                }
                std::array::from_fn(|k| head[k] + 0.5 * (head[k] - from[k]))
            }
        }
    };
    (0..heads.len()).map(end).collect()
}
