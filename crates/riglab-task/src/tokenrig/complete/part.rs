//! What a person may have given of a skeleton that is known whole.

use riglab_core::{Joint, JointId, Skeleton};
use riglab_random::{Draw, Stream};

/// The root and a share of the other joints, one at least of all and each after its parent: the next is any joint that hangs on
/// one that was taken. Order, names and places stay.
pub fn part(skeleton: &Skeleton, share: f64, random: &mut Stream) -> Option<Skeleton> {
    let count = ((share * skeleton.len() as f64).round() as usize).clamp(1, skeleton.len());
    let children = skeleton.children();
    let (mut taken, mut open) = (vec![false; skeleton.len()], vec![0]);
    for _ in 0..count {
        let joint = open.swap_remove(random.below(open.len()));
        taken[joint] = true;
        open.extend(children[joint].iter().map(|child| child.index()));
    }
    let mut place = vec![None; skeleton.len()];
    let mut joints = Vec::with_capacity(count);
    for joint in skeleton.ids().filter(|joint| taken[joint.index()]) {
        place[joint.index()] = u16::try_from(joints.len()).ok().map(JointId);
        joints.push(Joint {
            name: skeleton.name(joint).to_owned(),
            parent: skeleton.parent(joint).and_then(|p| place[p.index()]),
            head: skeleton.head(joint),
        });
    }
    Skeleton::new(joints).ok()
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;

    #[test]
    fn parts_are_trees_of_as_many_joints_and_differ() {
        // Two chains of four from a root.
        let joint = |k: u16| Joint {
            name: format!("j{k}"),
            parent: (k > 0).then(|| JointId(if k == 5 { 0 } else { k - 1 })),
            head: [f32::from(k), 0.0, 0.0],
        };
        let whole = Skeleton::new((0..9).map(joint).collect()).unwrap();
        let of = |share, key| part(&whole, share, &mut stream(0, "test", &[key])).unwrap();
        assert_eq!([0.0, 0.1, 0.5, 1.0].map(|share| of(share, 1).len()), [1, 1, 5, 9].map(|n: usize| n));
        assert_eq!(of(1.0, 1), whole);
        assert_eq!(of(0.5, 1), of(0.5, 1));
        assert!((2..20).any(|key| of(0.5, key) != of(0.5, 1)));
        for key in 0..20 {
            let own = of(0.5, key);
            for joint in own.ids().skip(1) {
                let number: u16 = own.name(joint)[1..].parse().unwrap();
                let parent = own.parent(joint).unwrap();
                assert_eq!(own.name(parent), format!("j{}", if number == 5 { 0 } else { number - 1 }));
                assert_eq!(own.head(joint)[0], f32::from(number));
            }
        }
    }
}
