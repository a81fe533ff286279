//! MagicArticulate's merge of near joints, which is part of its metric.

use super::Joints;

/// Joints nearer than this are one.
const SAME: f64 = 0.0025;
/// Parts of a skeleton nearer than this are joined at a point, others by a bone.
const JOIN: f64 = 0.02;

/// Joints and bones (parent, child), not necessarily a tree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    /// Positions.
    pub joints: Vec<[f64; 3]>,
    /// Numbers of the two ends.
    pub bones: Vec<[usize; 2]>,
}

impl Graph {
    /// Of a skeleton, in its own units.
    pub fn of(joints: &Joints) -> Self {
        let bones = joints.parents.iter().enumerate().filter_map(|(child, parent)| parent.map(|p| [p, child]));
        Self { joints: joints.positions.clone(), bones: bones.collect() }
    }

    /// The same with near joints merged, those in no bone dropped, and parts connected; units of the unit cube.
    /// The joint `root` stays wherever it is known.
    pub fn merged(&self, root: Option<usize>) -> Self {
        let joints = &self.joints;
        // In the order of the file: each joint not yet taken takes all near ones that come later.
        let mut name: Vec<usize> = (0..joints.len()).collect();
        let mut taken = vec![false; joints.len()];
        for first in 0..joints.len() {
            if taken[first] {
                continue;
            }
            let near = |&j: &usize| j == first || (!taken[j] && distance(joints[first], joints[j]) < SAME);
            let group: Vec<usize> = (first..joints.len()).filter(near).collect();
            let kept = root.filter(|r| group.contains(r)).unwrap_or(first);
            for j in group {
                (taken[j], name[j]) = (true, kept);
            }
        }
        let mut bones: Vec<[usize; 2]> = Vec::new();
        for bone in self.bones.iter().map(|b| b.map(|j| name[j])) {
            if bone[0] != bone[1] && !bones.contains(&bone) {
                bones.push(bone);
            }
        }
        let mut used = vec![false; joints.len()];
        bones.iter().flatten().chain(root.map(|r| &name[r])).for_each(|&j| used[j] = true);
        let mut out = Self { joints: joints.clone(), bones };
        out.keep(&used);
        out.connect();
        out
    }

    /// Drops joints; no bone may hang on them.
    fn keep(&mut self, used: &[bool]) {
        let number: Vec<usize> = used
            .iter()
            .scan(0, |next, &u| {
                *next += usize::from(u);
                Some(*next - usize::from(u))
            })
            .collect();
        self.joints = self.joints.iter().zip(used).filter(|(_, u)| **u).map(|(p, _)| *p).collect();
        self.bones.iter_mut().for_each(|b| *b = b.map(|j| number[j]));
    }

    /// While there are several parts: the two joints of different parts that are nearest become one, or a bone
    /// joins them. Of the two the one stays whose part has the lower first joint; the bone goes from it.
    fn connect(&mut self) {
        loop {
            let part = self.parts();
            if part.windows(2).all(|p| p[0] == p[1]) {
                return;
            }
            let first = |joint: usize| part.iter().position(|p| *p == part[joint]);
            let mut best: Option<(f64, usize, usize)> = None;
            for a in 0..self.joints.len() {
                for b in a + 1..self.joints.len() {
                    let d = distance(self.joints[a], self.joints[b]);
                    if part[a] != part[b] && best.is_none_or(|(least, ..)| d < least) {
                        best = Some((d, a, b));
                    }
                }
            }
            let Some((d, a, b)) = best else { return };
            let [a, b] = if first(a) < first(b) { [a, b] } else { [b, a] };
            if d < JOIN {
                self.bones.iter_mut().flatten().for_each(|j| *j = if *j == b { a } else { *j });
                let used: Vec<bool> = (0..self.joints.len()).map(|j| j != b).collect();
                self.keep(&used);
            } else {
                self.bones.push([a, b]);
            }
        }
    }

    /// The number of each joint's part.
    fn parts(&self) -> Vec<usize> {
        let mut above: Vec<usize> = (0..self.joints.len()).collect();
        fn top(above: &mut [usize], mut j: usize) -> usize {
            while above[j] != j {
                above[j] = above[above[j]];
                j = above[j];
            }
            j
        }
        for [a, b] in &self.bones {
            let (a, b) = (top(&mut above, *a), top(&mut above, *b));
            above[b] = a;
        }
        (0..self.joints.len()).map(|j| top(&mut above, j)).collect()
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> [f64; 3] {
        [x, 0.0, 0.0]
    }

    #[test]
    fn near_joints_are_one_and_their_bone_goes() {
        let chain = Graph { joints: vec![at(0.0), at(0.001), at(0.5), at(0.501)], bones: vec![[0, 1], [1, 2], [2, 3]] };
        let merged = chain.merged(None);
        assert_eq!(merged, Graph { joints: vec![at(0.0), at(0.5)], bones: vec![[0, 1]] });
        // A known root gives its position to the joint.
        assert_eq!(chain.merged(Some(1)).joints, [at(0.001), at(0.5)]);
    }

    #[test]
    fn a_joint_alone_is_dropped_unless_it_is_the_root() {
        let single = Graph { joints: vec![at(0.0)], bones: vec![] };
        assert_eq!((single.merged(None).joints.len(), single.merged(Some(0)).joints.len()), (0, 1));
    }

    #[test]
    fn parts_are_connected() {
        let joints = vec![at(0.0), at(0.1), at(0.11), at(0.2), at(0.5), at(0.6)];
        let parts = Graph { joints, bones: vec![[0, 1], [2, 3], [4, 5]] }.merged(Some(0));
        assert_eq!(parts.joints, [at(0.0), at(0.1), at(0.2), at(0.5), at(0.6)]);
        assert_eq!(parts.bones, [[0, 1], [1, 2], [3, 4], [2, 3]]);
    }

    #[test]
    fn of_two_joints_the_one_in_the_earlier_part_stays() {
        // The part of joint 0 goes on in joint 3, which lies near joint 1 of another.
        let two =
            |gap: f64| Graph { joints: vec![at(0.0), at(0.1 + gap), at(0.2), at(0.1)], bones: vec![[0, 3], [1, 2]] };
        let one = two(0.01).merged(None);
        assert_eq!((one.joints, one.bones), (vec![at(0.0), at(0.2), at(0.1)], vec![[0, 2], [2, 1]]));
        assert_eq!(two(0.05).merged(None).bones, [[0, 3], [1, 2], [3, 1]]);
    }
}
