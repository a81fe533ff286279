//! Which joint is moved after which.

use riglab_core::{Skeleton, Springs};

/// All joints, each after its parent; what swings also after its center and after what carries its colliders.
///
/// Springs may wait for each other in circles: then one goes first, and finds the others as the last frame left
/// them.
pub(crate) fn order(skeleton: &Skeleton, springs: &Springs) -> Vec<u16> {
    let mut waits: Vec<Vec<u16>> = skeleton.parents().iter().map(|p| p.iter().map(|p| p.0).collect()).collect();
    for (number, spring) in springs.springs().iter().enumerate() {
        let mut above: Vec<u16> = springs.stops(number).map(|c| c.joint.0).chain(spring.center.map(|c| c.0)).collect();
        above.sort_unstable();
        above.dedup();
        for joint in &spring.joints {
            waits[joint.joint.index()].extend(&above);
        }
    }
    let mut order = Vec::with_capacity(waits.len());
    let mut met = vec![false; waits.len()];
    // Joints begun, and how many of those they wait for are behind them: no recursion, chains may be long.
    let mut open: Vec<(u16, usize)> = Vec::new();
    for joint in 0..waits.len() as u16 {
        if !std::mem::replace(&mut met[usize::from(joint)], true) {
            open.push((joint, 0));
        }
        while let Some((joint, behind)) = open.last_mut() {
            match waits[usize::from(*joint)].get(*behind) {
                Some(&next) => {
                    *behind += 1;
                    if !std::mem::replace(&mut met[usize::from(next)], true) {
                        open.push((next, 0));
                    }
                }
                None => {
                    order.push(*joint);
                    open.pop();
                }
            }
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use riglab_core::{Collider, Joint, JointId, Shape, Spring, SpringJoint, Swing};

    use super::*;

    fn skeleton(parents: &[u16]) -> Skeleton {
        let joint = |(j, parent): (usize, Option<JointId>)| Joint { name: j.to_string(), parent, head: [0.0; 3] };
        let parents = std::iter::once(None).chain(parents.iter().map(|p| Some(JointId(*p))));
        Skeleton::new(parents.enumerate().map(joint).collect()).unwrap()
    }

    fn spring(joint: u16, groups: &[usize]) -> Spring {
        let joint = SpringJoint { joint: JointId(joint), tail: Some([1.0; 3]), swing: Swing::default() };
        Spring { joints: vec![joint], groups: groups.to_vec(), ..Spring::default() }
    }

    fn ball(joint: u16) -> Collider {
        Collider { joint: JointId(joint), shape: Shape::Sphere { center: [0.0; 3], radius: 0.1 } }
    }

    #[test]
    fn what_swings_comes_after_what_stops_it() {
        let springs = Springs::new(vec![spring(1, &[0])], vec![ball(3)], vec![vec![0]]).unwrap();
        assert_eq!(order(&skeleton(&[0, 0, 2]), &springs), [0, 2, 3, 1]);
    }

    #[test]
    fn circles_end_and_long_chains_do_too() {
        let springs =
            Springs::new(vec![spring(1, &[1]), spring(2, &[0])], vec![ball(1), ball(2)], vec![vec![0], vec![1]]);
        let mut all = order(&skeleton(&[0, 0]), &springs.unwrap());
        all.sort_unstable();
        assert_eq!(all, [0, 1, 2]);
        // Its own child stops it, which waits for it.
        let springs = Springs::new(vec![spring(1, &[0])], vec![ball(2)], vec![vec![0]]).unwrap();
        assert_eq!(order(&skeleton(&[0, 1]), &springs).len(), 3);
        let long: Vec<u16> = (0..60_000).collect();
        assert_eq!(order(&skeleton(&long), &Springs::default()).len(), 60_001);
    }
}
