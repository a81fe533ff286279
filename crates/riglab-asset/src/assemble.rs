//! From a reading to a rig: one tree, one mesh, weights for every vertex. The same for all formats.

use std::collections::HashSet;
use std::ops::Range;

use riglab_core::{Clip, Humanoid, Joint, JointId, JointMap, Mesh, Rig, RigError, Skeleton, SkinWeights, Springs};

use crate::names::Names;
use crate::nearest::nearest_others;
use crate::rigging::UpAxis;
use crate::warning::MANY_JOINTS;
use crate::{Binding, Body, Content, Fault, ImportOptions, Part, Reading, Up, VertexSet, Warning, triangles};

/// A share of a mesh's size below which places may be rounded.
const COARSE: f32 = 1e-4;

/// What becomes of a skeleton with several roots, since a rig has one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RootPolicy {
    /// Loose roots become children of the root of the largest tree (by joints; the first of equals).
    #[default]
    Reattach,
    /// A new joint, `root`, stands above all, where the file's own transforms have their common origin.
    Virtual,
}

/// The rig or the bare mesh of a reading, and the rig's motions. Adds warnings about the whole to the
/// reading.
pub(crate) fn content(reading: &mut Reading, options: &ImportOptions) -> Result<(Content, Vec<Clip>), Fault> {
    let mut warnings = Vec::new();
    let mut clips = Vec::new();
    if options.up != UpAxis::Y {
        let places = reading.vertex_sets.iter_mut().flat_map(|set| &mut set.positions);
        places.chain(reading.joints.iter_mut().map(|joint| &mut joint.head)).for_each(|p| *p = options.up.to_y(*p));
        reading.origin = options.up.to_y(reading.origin);
    }
    if reading.up != Up::Y {
        warnings.push(Warning::TurnedUp);
    }
    let content = if reading.joints.is_empty() {
        if reading.parts.is_empty() {
            return Err(Fault::NoMesh);
        }
        warnings.push(Warning::NoSkeleton);
        Content::Bare(mesh(reading, &mut warnings)?)
    } else {
        if reading.parts.is_empty() {
            return Err(Fault::NothingBound);
        }
        let (skeleton, joint_of) = skeleton(reading, options.roots, &mut warnings)?;
        let mesh = mesh(reading, &mut warnings)?;
        let rig = Rig::new(skeleton, mesh, weights(reading, &joint_of)?)?;
        clips = reading.clips.iter().map(|clip| of_rig(clip, &joint_of, &rig)).collect::<Result<_, _>>()?;
        let (humanoid, springs) = body(&reading.body, &joint_of);
        Content::Rigged(rig.with_humanoid(humanoid)?.with_springs(springs)?)
    };
    let mesh = match &content {
        Content::Rigged(rig) => rig.mesh(),
        Content::Bare(mesh) => mesh,
    };
    warnings.extend(far(mesh));
    reading.warnings.extend(warnings);
    Ok((content, clips))
}

/// Told of a mesh that stands so far from the origin that single precision has few places in it: what stands at places on
/// Earth, as scans do.
fn far(mesh: &Mesh) -> Option<Warning> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in mesh.positions() {
        (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
    }
    let size = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
    // What lies between two numbers of 24 bits.
    let step = (0..3).map(|k| low[k].abs().max(high[k].abs())).fold(0.0, f32::max) * f32::EPSILON;
    (size > 0.0 && step > COARSE * size).then(|| Warning::Far { steps: (size / step) as usize })
}

/// The joints in one tree, and the number in it of each joint of the reading.
fn skeleton(
    reading: &Reading,
    policy: RootPolicy,
    warnings: &mut Vec<Warning>,
) -> Result<(Skeleton, Vec<u16>), RigError> {
    let joints = &reading.joints;
    // The virtual root takes a number of its own.
    if joints.len() >= usize::from(u16::MAX) {
        return Err(RigError::TooManyJoints(joints.len()));
    }
    if joints.len() == 1 {
        warnings.push(Warning::SingleJoint);
    }
    if joints.len() > MANY_JOINTS {
        warnings.push(Warning::ManyJoints(joints.len()));
    }
    let mut trees = trees(reading);
    let mut tree: Vec<Joint> = Vec::with_capacity(joints.len() + 1);
    if trees.len() > 1 {
        let roots: Vec<String> = trees.iter().map(|t| joints[t.start].name.clone()).collect();
        let remedy = match policy {
            RootPolicy::Reattach => {
                // `rev`, because `max_by_key` takes the last of equals.
                let largest = (0..trees.len()).rev().max_by_key(|&t| trees[t].len()).unwrap_or(0);
                trees[..=largest].rotate_right(1);
                format!("the others became children of `{}`", roots[largest])
            }
            RootPolicy::Virtual => {
                let mut names = Names::default();
                for joint in joints {
                    names.unique(&joint.name, String::new);
                }
                let name = names.unique("root", String::new);
                let remedy = format!("all became children of a new joint `{name}`");
                tree.push(Joint { name, parent: None, head: reading.up.to_y(reading.origin) });
                remedy
            }
        };
        warnings.push(match reading.skeletons() {
            1 => Warning::SeveralRoots { roots, remedy },
            skeletons => Warning::SeparateSkeletons { skeletons, roots, remedy },
        });
    }
    let mut joint_of = vec![0; joints.len()];
    for old in trees.into_iter().flatten() {
        let joint = &joints[old];
        joint_of[old] = tree.len() as u16;
        let parent = match joint.parent {
            Some(parent) => Some(JointId(joint_of[parent])),
            None if tree.is_empty() => None,
            None => Some(JointId(0)),
        };
        tree.push(Joint { name: joint.name.clone(), parent, head: reading.up.to_y(joint.head) });
    }
    Ok((Skeleton::new(tree)?, joint_of))
}

/// The joints of a reading's rig that are roots of the file, too, beside the rig's own: those that
/// [`RootPolicy::Reattach`] hung on that. None where the rig's root is none of the file.
#[cfg_attr(not(any(feature = "fbx", test)), expect(dead_code, reason = "FBX alone keeps a rig"))]
pub(crate) fn loose_roots(reading: &Reading, skeleton: &Skeleton) -> Vec<JointId> {
    let roots: HashSet<&str> = reading.roots().into_iter().map(|root| reading.joints[root].name.as_str()).collect();
    let of_file = |joint: &JointId| roots.contains(skeleton.name(*joint));
    let (own, loose): (Vec<JointId>, Vec<JointId>) =
        skeleton.ids().filter(of_file).partition(|joint| skeleton.parent(*joint).is_none());
    if own.is_empty() { own } else { loose }
}

/// The runs of joints that are one tree each.
fn trees(reading: &Reading) -> Vec<Range<usize>> {
    let roots = reading.roots();
    let ends = roots.iter().skip(1).copied().chain([reading.joints.len()]);
    roots.iter().zip(ends).map(|(&start, end)| start..end).collect()
}

/// The sets in the order of the rig's vertices: skinned ones first, then rigid parts.
pub(crate) fn ordered_sets(reading: &Reading) -> Vec<(usize, &VertexSet)> {
    let mut sets: Vec<_> = reading.vertex_sets.iter().enumerate().collect();
    sets.sort_by_key(|(_, set)| set.binding == Binding::Rigid);
    sets
}

fn mesh(reading: &Reading, warnings: &mut Vec<Warning>) -> Result<Mesh, RigError> {
    let mut parts_of: Vec<Vec<&Part>> = vec![Vec::new(); reading.vertex_sets.len()];
    for part in &reading.parts {
        parts_of[part.vertex_set].push(part);
    }
    // Room for all of it: what grows takes up to twice as much.
    let mut positions = Vec::with_capacity(reading.vertex_sets.iter().map(|set| set.positions.len()).sum());
    let mut all = Vec::with_capacity(reading.parts.iter().map(|part| part.triangles.len()).sum());
    let mut repeated = 0;
    for (number, set) in ordered_sets(reading) {
        let start = positions.len() as u32;
        positions.extend(set.positions.iter().map(|p| reading.up.to_y(*p)));
        let mut shared = Vec::new();
        let own = match &parts_of[number][..] {
            // Within a part they are unlike already.
            [part] => &part.triangles,
            // Parts that share vertices may repeat each other, as outlines drawn by a second material do.
            parts => {
                shared.extend(parts.iter().flat_map(|p| &p.triangles));
                repeated += triangles::keep_proper(&mut shared, set.positions.len()).repeated;
                &shared
            }
        };
        all.extend(own.iter().map(|t| t.map(|v| v + start)));
    }
    if repeated > 0 {
        warnings.push(Warning::Degenerate { collapsed: 0, repeated });
    }
    // A tetrahedron is the least that encloses anything.
    if all.len() < 4 {
        warnings.push(Warning::FewTriangles(all.len()));
    }
    Mesh::new(positions, all)
}

/// The rows of all vertices, by joint of the rig; vertices without weight take those of the nearest
/// vertex of their set.
fn weights(reading: &Reading, joint_of: &[u16]) -> Result<SkinWeights, RigError> {
    let bound = || reading.vertex_sets.iter().filter_map(|set| set.weights.as_ref());
    let mut offsets = Vec::with_capacity(1 + bound().map(SkinWeights::rows).sum::<usize>());
    offsets.push(0);
    let room = bound().map(SkinWeights::nonzero).sum();
    let (mut joints, mut weights) = (Vec::with_capacity(room), Vec::with_capacity(room));
    let mut row = Vec::new();
    for (_, set) in ordered_sets(reading) {
        let Some(own) = &set.weights else { continue };
        let mut lacking = set.unweighted.iter().zip(nearest_others(&set.positions, &set.unweighted)).peekable();
        for v in 0..own.rows() {
            let stand_in = lacking.next_if(|(u, _)| **u as usize == v).and_then(|(_, nearest)| nearest);
            row.clear();
            row.extend(own.row(stand_in.map_or(v, |w| w as usize)).map(|(j, w)| (joint_of[j.index()], w)));
            // Mostly joints stand in the rig as they were read.
            if !row.is_sorted_by_key(|(joint, _)| *joint) {
                row.sort_unstable_by_key(|(joint, _)| *joint);
            }
            joints.extend(row.iter().map(|(joint, _)| *joint));
            weights.extend(row.iter().map(|(_, weight)| *weight));
            offsets.push(joints.len() as u32);
        }
    }
    SkinWeights::new(offsets, joints, weights)
}

/// A clip by joint of the rig; a joint that the file does not have stands still.
fn of_rig(clip: &Clip, joint_of: &[u16], rig: &Rig) -> Result<Clip, RigError> {
    const STILL: JointMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
    let joints = rig.skeleton().len();
    let mut maps = vec![STILL; joints * clip.frames()];
    for (to, from) in maps.chunks_mut(joints).zip(clip.maps().chunks(clip.joints())) {
        for (&joint, map) in joint_of.iter().zip(from) {
            to[usize::from(joint)] = *map;
        }
    }
    Clip::new(clip.name().to_owned(), clip.rate(), joints, maps)
}

/// The body by joint of the rig.
fn body(body: &Body, joint_of: &[u16]) -> (Humanoid, Springs) {
    let new = |joint: JointId| JointId(joint_of[joint.index()]);
    let mut humanoid = Humanoid::default();
    for (bone, joint) in body.humanoid.iter() {
        humanoid.insert(bone, new(joint));
    }
    (humanoid, body.springs.clone().renumbered(new))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ReadJoint;
    use crate::influences::Repairs;

    /// Joints by name, parent and skeleton, a triangle bound to the first.
    fn reading(joints: &[(&str, Option<usize>, usize)]) -> Reading {
        let joints = joints.iter().enumerate().map(|(node, &(name, parent, skeleton))| ReadJoint {
            name: name.into(),
            node,
            parent,
            head: [node as f32, 0.0, 0.0],
            skeleton,
        });
        let set = VertexSet {
            numbers: vec![0, 1, 2],
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            weights: Some(SkinWeights::normalized(vec![vec![(0u16, 0.5), (1, 0.5)]; 3]).unwrap()),
            unweighted: vec![],
            repairs: Repairs::default(),
            stored: 3,
            binding: Binding::Skinned,
        };
        let part =
            Part { node: 0, primitive: 0, vertex_set: 0, used: vec![0, 1, 2], triangles: vec![[0, 1, 2]], stored: 1 };
        Reading {
            joints: joints.collect(),
            vertex_sets: vec![set],
            parts: vec![part],
            origin: [9.0; 3],
            ..Default::default()
        }
    }

    fn names_and_parents(rig: &Rig) -> Vec<(&str, Option<usize>)> {
        let s = rig.skeleton();
        s.ids().map(|j| (s.name(j), s.parent(j).map(JointId::index))).collect()
    }

    fn rig(reading: &mut Reading, roots: RootPolicy) -> Rig {
        match content(reading, &ImportOptions { roots, ..Default::default() }).unwrap().0 {
            Content::Rigged(rig) => rig,
            Content::Bare(_) => panic!("no rig"),
        }
    }

    #[test]
    fn loose_roots_go_below_the_root_of_the_largest_tree() {
        let mut r = reading(&[("ik", None, 0), ("hips", None, 0), ("spine", Some(1), 0), ("pole", None, 0)]);
        let rig = rig(&mut r, RootPolicy::Reattach);
        assert_eq!(names_and_parents(&rig), [("hips", None), ("spine", Some(0)), ("ik", Some(0)), ("pole", Some(0))]);
        assert_eq!(loose_roots(&r, rig.skeleton()), [JointId(2), JointId(3)]);
        // Bound to `ik` and `hips` before: rows follow their joints and rise.
        assert_eq!(rig.weights().row(0).collect::<Vec<_>>(), [(JointId(0), 0.5), (JointId(2), 0.5)]);
        assert!(matches!(r.warnings[..], [Warning::SeveralRoots { .. }, Warning::FewTriangles(1)]));
    }

    #[test]
    fn of_equal_trees_the_first_is_the_largest() {
        let mut r = reading(&[("a", None, 0), ("b", None, 0)]);
        assert_eq!(names_and_parents(&rig(&mut r, RootPolicy::Reattach)), [("a", None), ("b", Some(0))]);
    }

    #[test]
    fn a_virtual_root_has_a_name_of_its_own() {
        let mut r = reading(&[("root", None, 0), ("x", Some(0), 0), ("b", None, 1)]);
        let rig = rig(&mut r, RootPolicy::Virtual);
        assert_eq!(names_and_parents(&rig), [("root.001", None), ("root", Some(0)), ("x", Some(1)), ("b", Some(0))]);
        assert_eq!(rig.skeleton().heads()[0], [9.0; 3]);
        assert_eq!(loose_roots(&r, rig.skeleton()), []);
        assert!(matches!(r.warnings[0], Warning::SeparateSkeletons { skeletons: 2, .. }));
    }

    #[test]
    fn a_vertex_without_weight_takes_those_of_the_nearest() {
        let mut r = reading(&[("a", None, 0), ("b", Some(0), 0)]);
        let rows = [vec![(0u16, 1.0)], vec![(0, 1.0)], vec![(1, 1.0)]];
        r.vertex_sets[0].weights = Some(SkinWeights::normalized(rows).unwrap());
        r.vertex_sets[0].positions[1] = [0.1, 0.9, 0.0];
        r.vertex_sets[0].unweighted = vec![1];
        let rig = rig(&mut r, RootPolicy::Reattach);
        assert_eq!(rig.weights().row(1).collect::<Vec<_>>(), [(JointId(1), 1.0)]);
    }
}
