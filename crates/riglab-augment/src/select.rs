//! Taking joints and vertices out of a draft.

use riglab_core::{HumanBone, JointId};

use crate::draft::Draft;
use crate::rules::Colliders;

impl Draft {
    /// Keeps the vertices that are marked and the triangles all of whose corners are. Gives back
    /// whether it did: nothing changes when no triangle would be left.
    pub(crate) fn keep_vertices(&mut self, keep: &[bool]) -> bool {
        if keep.iter().all(|k| *k) {
            return true;
        }
        let whole = |t: &[u32; 3]| t.iter().all(|&v| keep[v as usize]);
        if !self.triangles.iter().any(whole) {
            return false;
        }
        if let Some(normals) = &mut self.normals {
            retain(&mut normals.vertices, |v| keep[v]);
            retain(&mut normals.triangles, |t| whole(&self.triangles[t]));
        }
        let mut number = vec![u32::MAX; keep.len()];
        let (mut count, mut end) = (0, 0);
        for (v, number) in number.iter_mut().enumerate().filter(|(v, _)| keep[*v]) {
            let span = self.offsets[v] as usize..self.offsets[v + 1] as usize;
            self.positions[count] = self.positions[v];
            self.joints.copy_within(span.clone(), end);
            self.weights.copy_within(span.clone(), end);
            end += span.len();
            *number = count as u32;
            count += 1;
            // Rows before this one are done: their offsets are free.
            self.offsets[count] = end as u32;
        }
        self.positions.truncate(count);
        self.offsets.truncate(count + 1);
        self.joints.truncate(end);
        self.weights.truncate(end);
        self.triangles.retain(whole);
        self.triangles.as_flattened_mut().iter_mut().for_each(|v| *v = number[*v as usize]);
        true
    }

    /// Keeps the joints that are marked, and the root. Weights of the others, their children,
    /// springs' centres and, if they stay, colliders go to the nearest ancestor that is kept.
    pub(crate) fn keep_joints(&mut self, keep: &[bool], colliders: Colliders) {
        let mut keep = keep.to_vec();
        keep[0] = true;
        self.keep_tree(&keep, colliders);
    }

    /// The same where the root may go, too: those that are marked must have a common ancestor among them,
    /// which takes what hung on joints above it.
    pub(crate) fn keep_tree(&mut self, keep: &[bool], colliders: Colliders) {
        let kept = |joint: usize| keep[joint];
        if (0..keep.len()).all(kept) {
            return;
        }
        // Parents come first, so the heir of a parent is known before it is asked for.
        let mut heir = vec![JointId(0); keep.len()];
        let mut count = 0;
        for joint in 0..keep.len() {
            if kept(joint) {
                heir[joint] = JointId(count as u16);
                self.names.swap(count, joint);
                self.heads[count] = self.heads[joint];
                self.parents[count] = self.parents[joint].filter(|_| count > 0).map(|p| heir[p.index()]);
                self.motion.origins[count] = self.motion.origins[joint];
                self.motion.rest[count] = self.motion.rest[joint];
                count += 1;
            } else if let Some(parent) = self.parents[joint] {
                heir[joint] = heir[parent.index()];
            }
        }
        self.names.truncate(count);
        self.heads.truncate(count);
        self.parents.truncate(count);
        self.motion.origins.truncate(count);
        self.motion.rest.truncate(count);
        self.humanoid.retain(|(_, joint)| kept(joint.index()));
        self.humanoid.iter_mut().for_each(|(_, joint)| *joint = heir[joint.index()]);
        for spring in &mut self.springs {
            spring.joints.retain(|j| kept(j.joint.index()));
            spring.joints.iter_mut().for_each(|j| j.joint = heir[j.joint.index()]);
            spring.center = spring.center.map(|j| heir[j.index()]);
        }
        self.springs.retain(|s| !s.joints.is_empty());
        if colliders == Colliders::Go {
            self.keep_colliders(&kept);
        }
        self.colliders.iter_mut().for_each(|c| c.joint = heir[c.joint.index()]);
        self.merge_weights(&heir);
    }

    /// Drops the colliders of other joints; groups name those that are left.
    fn keep_colliders(&mut self, kept: &dyn Fn(usize) -> bool) {
        let mut number = Vec::with_capacity(self.colliders.len());
        let mut count = 0;
        for collider in &self.colliders {
            let stays = kept(collider.joint.index());
            number.push(stays.then_some(count));
            count += usize::from(stays);
        }
        self.colliders.retain(|c| kept(c.joint.index()));
        for group in &mut self.groups {
            *group = group.iter().filter_map(|&c| number[c]).collect();
        }
    }

    /// Gives weights to other joints; those that meet on a vertex are added.
    fn merge_weights(&mut self, heir: &[JointId]) {
        let (mut from, mut end) = (0, 0);
        for offset in &mut self.offsets[1..] {
            let (start, until) = (end, *offset as usize);
            for k in from..until {
                let (joint, weight) = (heir[usize::from(self.joints[k])].0, self.weights[k]);
                // Numbers mostly rise still: the place is at the end or near it.
                let mut at = end;
                while at > start && self.joints[at - 1] > joint {
                    at -= 1;
                }
                if at > start && self.joints[at - 1] == joint {
                    self.weights[at - 1] += weight;
                    continue;
                }
                self.joints.copy_within(at..end, at + 1);
                self.weights.copy_within(at..end, at + 1);
                (self.joints[at], self.weights[at]) = (joint, weight);
                end += 1;
            }
            (from, *offset) = (until, end as u32);
        }
        self.joints.truncate(end);
        self.weights.truncate(end);
    }

    /// Swaps left and right of the human bones: in a mirror, a left hand is a right hand.
    pub(crate) fn mirror_humanoid(&mut self) {
        self.humanoid.iter_mut().for_each(|(bone, _): &mut (HumanBone, _)| *bone = bone.mirrored());
    }
}

fn retain<T>(items: &mut Vec<T>, keep: impl Fn(usize) -> bool) {
    let mut at = 0;
    items.retain(|_| {
        at += 1;
        keep(at - 1)
    });
}

/// Marks the ancestors of what is marked, and the root.
pub(crate) fn close_upwards(keep: &mut [bool], parents: &[Option<JointId>]) {
    keep[0] = true;
    for joint in (0..keep.len()).rev() {
        if let (true, Some(parent)) = (keep[joint], parents[joint]) {
            keep[parent.index()] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draft::tests::{after, chain, origins};

    /// Without joint 2.
    const KEEP: [bool; 6] = [true, true, false, true, true, true];

    #[test]
    fn children_weights_and_springs_go_to_the_nearest_ancestor() {
        let done = after(|d| d.keep_joints(&KEEP, Colliders::Stay));
        let (rig, skeleton) = (&done.rig, done.rig.skeleton());
        assert_eq!(origins(&done), [0, 1, 3, 4, 5]);
        let parents = [None, Some(0), Some(1), Some(2), Some(1)];
        assert_eq!(skeleton.parents(), parents.map(|p| p.map(JointId)));
        assert_eq!(skeleton.name(JointId(2)), "joint 3");
        // Halfway between joints 1 and 2, at 2, and halfway between 2 and 3.
        let row = |v: usize| rig.weights().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
        assert_eq!((row(6), row(8), row(10)), (vec![(1, 1.0)], vec![(1, 1.0)], vec![(1, 0.5), (2, 0.5)]));
        let spring = &rig.springs().springs()[0];
        assert_eq!((spring.joints[0].joint, spring.joints[1].joint), (JointId(2), JointId(3)));
        assert_eq!((spring.center, rig.springs().colliders()[1].joint), (Some(JointId(1)), JointId(1)));
        // A bone whose joint is gone is gone.
        let bones: Vec<_> = rig.humanoid().iter().map(|(b, j)| (b.name(), j.0)).collect();
        assert_eq!(bones, [("hips", 0), ("leftFoot", 3)]);
    }

    #[test]
    fn colliders_of_what_is_gone_are_gone_and_so_are_empty_springs() {
        let done = after(|d| d.keep_joints(&KEEP, Colliders::Go));
        let springs = done.rig.springs();
        assert_eq!((springs.colliders().len(), springs.groups()), (2, [vec![0, 1]].as_slice()));
        let done = after(|d| d.keep_joints(&[false, true, true, false, false, true], Colliders::Go));
        assert!(done.rig.springs().springs().is_empty());
        // The root stays whatever is asked.
        assert_eq!(origins(&done), [0, 1, 2, 5]);
    }

    #[test]
    fn the_root_of_what_is_kept_takes_what_hung_above_it() {
        let done = after(|d| d.keep_tree(&[false, false, true, false, true, false], Colliders::Stay));
        assert_eq!(origins(&done), [2, 4]);
        assert_eq!(done.rig.skeleton().parents(), [None, Some(JointId(0))]);
        assert!((0..8).all(|v| done.rig.weights().row(v).eq([(JointId(0), 1.0)])));
        let springs = done.rig.springs();
        assert!(springs.colliders().iter().all(|c| c.joint == JointId(0)));
        assert_eq!(springs.springs()[0].center, Some(JointId(0)));
    }

    #[test]
    fn vertices_go_with_their_triangles_and_weights() {
        let keep: Vec<bool> = (0..18).map(|v| v >= 6).collect();
        let done = after(|d| assert!(d.keep_vertices(&keep)));
        let (mesh, old) = (done.rig.mesh(), chain());
        assert_eq!((mesh.positions(), mesh.triangles()[0]), (&old.mesh().positions()[6..], [0, 2, 1]));
        assert_eq!((mesh.triangles().len(), done.rig.weights().rows()), (10, 12));
        assert!((0..12).all(|v| done.rig.weights().row(v).eq(old.weights().row(v + 6))));
    }

    #[test]
    fn the_last_triangle_stays() {
        let keep: Vec<bool> = (0..18).map(|v| v < 2).collect();
        assert_eq!(after(|d| assert!(!d.keep_vertices(&keep))).rig, chain());
    }
}
