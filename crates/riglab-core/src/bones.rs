//! Bones as line segments.
//!
//! glTF stores joints only. A bone here is what a joint moves: the segments from its head to each
//! child's head; a leaf is extended beyond its parent's direction.

use glam::Vec3A;

use crate::{JointId, Skeleton, Vec3};

/// A line segment, possibly of length 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Start.
    pub a: Vec3,
    /// End.
    pub b: Vec3,
}

impl Segment {
    /// Where along the segment the point nearest to `p` lies, 0 at `a`, 1 at `b`, and how far it is.
    pub fn nearest(&self, p: Vec3) -> (f32, f32) {
        let (a, b, p) = (Vec3A::from(self.a), Vec3A::from(self.b), Vec3A::from(p));
        let along = b - a;
        let length2 = along.length_squared();
        let t = if length2 > 0.0 { ((p - a).dot(along) / length2).clamp(0.0, 1.0) } else { 0.0 };
        (t, (a + along * t - p).length())
    }

    /// As [`Self::nearest`], of the nearest of a bone's segments; 0 and infinity where it has none.
    pub fn nearest_of(bone: &[Self], p: Vec3) -> (f32, f32) {
        let all = bone.iter().map(|segment| segment.nearest(p));
        all.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0.0, f32::INFINITY))
    }

    /// Length.
    pub fn length(&self) -> f32 {
        (Vec3A::from(self.b) - Vec3A::from(self.a)).length()
    }
}

/// How far a leaf's bone reaches, as a share of the bone to its parent.
const LEAF_EXTENT: f32 = 0.5;

impl Skeleton {
    /// The segments of every joint: one to each child; for a leaf one of half its parent bone's
    /// length and direction; for a root without children a single point.
    pub fn segments(&self) -> Vec<Vec<Segment>> {
        let children = self.children();
        self.ids()
            .map(|joint| {
                let a = self.head(joint);
                match (children[joint.index()].as_slice(), self.parent(joint)) {
                    ([], None) => vec![Segment { a, b: a }],
                    ([], Some(parent)) => vec![Segment { a, b: extended(self.head(parent), a) }],
                    (all, _) => all.iter().map(|&c| Segment { a, b: self.head(c) }).collect(),
                }
            })
            .collect()
    }

    /// The tail of every joint's bone: the only child's head, the mean of several, or the extended
    /// leaf. A joint whose children's mean is itself keeps a tail at its head.
    pub fn tails(&self) -> Vec<Vec3> {
        self.segments()
            .into_iter()
            .map(|segments| {
                let n = segments.len() as f32;
                let sum = segments.iter().fold(glam::Vec3::ZERO, |sum, s| sum + glam::Vec3::from(s.b));
                (sum / n).into()
            })
            .collect()
    }

    /// Whether the joint has no children.
    pub fn is_leaf(&self, joint: JointId) -> bool {
        !self.parents().contains(&Some(joint))
    }
}

fn extended(parent: Vec3, head: Vec3) -> Vec3 {
    std::array::from_fn(|k| head[k] + LEAF_EXTENT * (head[k] - parent[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Joint;

    #[test]
    fn leaves_reach_half_a_bone_further() {
        let joint = |name: &str, parent: Option<u16>, y| Joint {
            name: name.into(),
            parent: parent.map(JointId),
            head: [0.0, y, 0.0],
        };
        let s = Skeleton::new(vec![joint("a", None, 0.0), joint("b", Some(0), 2.0)]).unwrap();
        assert_eq!(s.tails(), [[0.0, 2.0, 0.0], [0.0, 3.0, 0.0]]);
        assert!(s.is_leaf(JointId(1)) && !s.is_leaf(JointId(0)));
    }

    #[test]
    fn of_several_segments_the_nearest_counts() {
        let bone = [Segment { a: [0.0; 3], b: [2.0, 0.0, 0.0] }, Segment { a: [0.0; 3], b: [0.0, 2.0, 0.0] }];
        assert_eq!(Segment::nearest_of(&bone, [0.5, 0.1, 0.0]), (0.25, 0.1));
        assert_eq!(Segment::nearest_of(&bone, [0.1, 1.0, 0.0]), (0.5, 0.1));
        assert_eq!(Segment::nearest_of(&[], [0.0; 3]), (0.0, f32::INFINITY));
    }

    #[test]
    fn distance_is_to_the_segment_not_the_line() {
        let s = Segment { a: [0.0; 3], b: [1.0, 0.0, 0.0] };
        assert_eq!(s.nearest([0.5, 2.0, 0.0]), (0.5, 2.0));
        assert_eq!(s.nearest([4.0, 4.0, 0.0]), (1.0, 5.0));
        assert_eq!(Segment { a: [1.0; 3], b: [1.0; 3] }.nearest([1.0, 1.0, 3.0]), (0.0, 2.0));
    }
}
