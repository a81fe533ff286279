//! The pose in which a mesh was bound to its joints.
//!
//! Where nodes and inverse bind matrices tell the same, any reading gives the same rig up to its
//! place. Often they do not: the nodes stand in the pose of some animation. The bind pose is what a
//! rig is about, so heads come from the inverse bind matrices as far as they are known, and from the
//! nodes elsewhere, as in Blender's importer (with its option to guess the bind pose):
//!
//! 1. The *armature* of a skin is the deepest node above its joints. Nodes from a joint up to it are
//!    *bones*, joints or not.
//! 2. The bind pose of a bone is that of its parent bone times a local part without scale: from the
//!    inverse bind matrices of both where both are known, else the node's own. Beyond Blender: both are
//!    of one skin where one has both, as each skin starts from the space of its own mesh; where none
//!    has, and both skins show their bind pose, the node's own part, if it has no scale, is that pose's.
//! 3. All is placed by the armature's transform. That of the node that holds the mesh plays no part.
//! 4. Beyond Blender: where scales that are left out so would mirror what the file shows, and all skins are shown in their bind
//!    pose, bones stand at rest as their nodes do, scales and all. What is squashed alone stays so, as in Blender.
//! 5. Beyond Blender: bind pose times inverse bind matrix must be one map for all joints of a skin, or
//!    the rest pose would bend the mesh. If it is not, that of the first top joint serves for all, or
//!    that of a joint that another skin moved for the same reason; skins of the joints that were moved
//!    go with them.

use std::cmp::Ordering;
use std::collections::{HashSet, VecDeque};

use glam::{DAffine3, DVec3};

use super::accessor::Accessors;
use super::nodes::{Nodes, rigid};
use super::primitives::Sources;
use super::skins::{Skin, Skins};
use crate::Warning;
use crate::maps::{FLAT, Likeness, Reshaped, SAME, SkinBox, corners, is_flat};
use crate::reading::Posed;

/// Where joints and vertices are at rest.
pub(super) struct Binds {
    /// For each skin and slot, from mesh space to the scene.
    maps: Vec<Vec<DAffine3>>,
    /// From joint space to the scene, by node; for bones only.
    frames: Vec<Option<DAffine3>>,
    origin: DVec3,
    shown_off: DVec3,
    /// How the nodes show each skin, where that is another pose.
    posed: Vec<Option<Posed>>,
    /// Whether rest mirrors what the nodes show of each skin.
    mirrors: Vec<bool>,
}

impl Binds {
    pub(super) fn new(
        nodes: &Nodes,
        skins: &Skins,
        sources: &Sources,
        accessors: &Accessors<'_>,
        warnings: &mut Vec<Warning>,
    ) -> Self {
        let boxes = sources.skin_boxes(skins.len());
        let bones = bones(nodes, skins);
        let known = InverseBinds::of(nodes, skins, &boxes);
        let mut frames = frames(nodes, &bones, &known);
        if stands_as_shown(nodes, skins, &boxes, &known, &frames) {
            (0..nodes.len()).filter(|&node| bones[node]).for_each(|node| frames[node] = Some(*nodes.global(node)));
        }
        let common = nodes.common(skins.joint_nodes().iter().copied());
        let origin = frames[common].unwrap_or(*nodes.global(common)).translation;
        let origin = if origin.as_vec3().is_finite() { origin } else { DVec3::ZERO };

        let (maps, bent) = straighten(nodes, skins, &boxes, &mut frames);
        let mut posed = vec![None; skins.len()];
        let reshaped: Vec<Reshaped> =
            (skins.iter().zip(&maps)).map(|(skin, maps)| reshaped(nodes, skin, maps)).collect();
        // What the first skin says of that; whether all say the same.
        let (mut shown_off, mut agreed) = (None, true);
        for (number, skin) in skins.iter().enumerate() {
            let Some(corners) = boxes[number].map(corners) else { continue };
            let Some(inverse) = &skin.inverse_binds else {
                agreed = false;
                continue;
            };
            let slot = top_joint(nodes, skin);
            let top = maps[number][slot];
            let like = Likeness::under(&top, corners);
            let shift =
                |counts: &dyn Fn(usize) -> bool| shown_off_by(nodes, skin, inverse, (slot, &top), &like, counts);
            let of_holders = || {
                let held = held(nodes, skins, number, sources, accessors);
                shift(&|slot| held[slot])
            };
            if let Some(shift) = shift(&|_| true).or_else(of_holders) {
                let by = |shift| DAffine3::from_translation(shift) * top;
                let first = *shown_off.get_or_insert(if like.same(&by(shift), &top) { DVec3::ZERO } else { shift });
                agreed &= like.same(&by(first), &by(shift));
            } else {
                let size = match reshaped[number].squashed {
                    true => 1.0,
                    false => larger(&shown_by(nodes, skin, slot), &top),
                };
                let off = skin.joints.iter().map(|&joint| apart(nodes, &frames, joint, &like)).fold(0.0, f64::max);
                // Of what is shown in another size all is elsewhere.
                posed[number] = Some(Posed { size, off: if size == 1.0 { off } else { 0.0 } });
            }
        }
        let alike = agreed && bent.is_empty() && posed.iter().all(Option::is_none);
        let shown_off = shown_off.filter(|_| alike).unwrap_or(DVec3::ZERO);
        if !bent.is_empty() {
            warnings.push(Warning::Bent { skins: bent });
        }
        // Of what is shown in its bind pose only the shape is another.
        let is_pose = |skin: &usize| !(reshaped[*skin].is_any() && known.shown[*skin]);
        let told = (0..skins.len()).filter(is_pose).filter_map(|skin| Some((skin, posed[skin]?)));
        warnings.extend(Posed::warning(told));
        let mirrors = reshaped.iter().map(|own| own.mirrored).collect();
        let has_mesh = |number: &usize| boxes[*number].is_some();
        let told: Vec<usize> = (0..skins.len()).filter(has_mesh).filter(|&skin| reshaped[skin].is_any()).collect();
        if !told.is_empty() {
            let any = |what: fn(&Reshaped) -> bool| told.iter().any(|&skin| what(&reshaped[skin]));
            let (squashed, mirrored) = (any(|own| own.squashed), any(|own| own.mirrored));
            warnings.push(Warning::Reshaped { skins: told, squashed, mirrored });
        }
        Self { maps, frames, origin, shown_off, posed, mirrors }
    }

    /// From mesh space to the scene, by slot of a skin.
    pub(super) fn maps(&self, skin: usize) -> &[DAffine3] {
        &self.maps[skin]
    }

    /// From the space of a joint to the scene; the identity for nodes that are no bones.
    pub(super) fn frame(&self, node: usize) -> DAffine3 {
        self.frames[node].unwrap_or(DAffine3::IDENTITY)
    }

    /// Whether a node is a joint, or one between joints and what they have in common.
    pub(super) fn is_bone(&self, node: usize) -> bool {
        self.frames[node].is_some()
    }

    /// From the space of every node to the scene at rest: what is no bone goes with the node above it.
    pub(super) fn rests(&self, nodes: &Nodes) -> Vec<DAffine3> {
        let mut rests = vec![DAffine3::IDENTITY; nodes.len() + 1];
        for &node in nodes.order() {
            rests[node] = self.frames[node].unwrap_or_else(|| rests[nodes.parent(node)] * *nodes.local(node));
        }
        rests
    }

    /// Where a joint is at rest.
    pub(super) fn head(&self, node: usize) -> DVec3 {
        self.frame(node).translation
    }

    /// Where the deepest node above all joints is at rest.
    pub(super) fn origin(&self) -> DVec3 {
        self.origin
    }

    /// How the nodes show a skin, where that is another pose than the one it was bound in.
    pub(super) fn posed(&self, skin: usize) -> Option<Posed> {
        self.posed[skin]
    }

    /// Whether rest mirrors what the nodes show of a skin, which turns its surfaces inside out.
    pub(super) fn mirrors(&self, skin: usize) -> bool {
        self.mirrors[skin]
    }

    /// How far the nodes show all skins from where they are at rest, if that is the same for all and the pose is, too.
    pub(super) fn shown_off(&self) -> DVec3 {
        self.shown_off
    }
}

/// Which nodes are bones.
fn bones(nodes: &Nodes, skins: &Skins) -> Vec<bool> {
    let armature = |skin: &Skin| {
        let common = nodes.common(skin.joints.iter().copied().chain(skin.skeleton));
        if skin.joints.contains(&common) { nodes.parent(common) } else { common }
    };
    let mut ways: Vec<(usize, &Skin)> = skins.iter().map(|skin| (armature(skin), skin)).collect();
    // The highest armatures first: then whoever meets a bone on the way up may stop there.
    ways.sort_by_key(|(armature, _)| nodes.depth(*armature));
    let mut bones = vec![false; nodes.len() + 1];
    for (armature, skin) in ways {
        for &joint in &skin.joints {
            let mut node = joint;
            while node != armature && !bones[node] {
                bones[node] = true;
                node = nodes.parent(node);
            }
        }
    }
    bones
}

/// What is known of inverse bind matrices, by node.
struct InverseBinds<'a> {
    /// That of each skin of a node, skins rising.
    of_skins: Vec<Vec<(usize, &'a DAffine3)>>,
    /// Nodes whose space is that of meshes: the one above everything, and where `skin.skeleton` points.
    spaces: Vec<bool>,
    /// Whether the nodes of a skin's joints show it in its bind pose, whatever space its mesh is in.
    shown: Vec<bool>,
}

impl<'a> InverseBinds<'a> {
    fn of(nodes: &Nodes, skins: &'a Skins, boxes: &[SkinBox]) -> Self {
        let mut of_skins = vec![Vec::new(); nodes.len() + 1];
        let mut spaces = vec![false; nodes.len() + 1];
        spaces[nodes.top()] = true;
        let mut shown = vec![false; skins.len()];
        for (number, skin) in skins.iter().enumerate() {
            let Some(inverse_binds) = &skin.inverse_binds else { continue };
            if let Some(skeleton) = skin.skeleton {
                spaces[if skin.joints.contains(&skeleton) { nodes.parent(skeleton) } else { skeleton }] = true;
            }
            for (&node, inverse_bind) in skin.joints.iter().zip(inverse_binds) {
                of_skins[node].push((number, inverse_bind));
            }
            let posed = |slot: usize| *nodes.global(skin.joints[slot]) * inverse_binds[slot];
            // Hidden joints stand nowhere.
            if let Some(own) = boxes[number].filter(|_| !is_flat(&posed(0).matrix3, FLAT)) {
                let posed: Vec<DAffine3> = (0..skin.joints.len()).map(posed).collect();
                shown[number] = is_one(&posed, &posed[0], corners(own));
            }
        }
        Self { of_skins, spaces, shown }
    }

    /// From the bind pose of a node's parent to its own, as far as that is told.
    fn local(&self, nodes: &Nodes, node: usize) -> Option<DAffine3> {
        let parent = nodes.parent(node);
        let (above, own) = (&self.of_skins[parent], &self.of_skins[node]);
        let (last, inverse) = own.last()?;
        let Some((last_above, inverse_above)) = above.last() else {
            return self.spaces[parent].then(|| inverse.inverse());
        };
        // Of several skins the last counts.
        let (mut above, mut own) = (above.iter().rev().peekable(), own.iter().rev().peekable());
        while let (Some((a, inverse_above)), Some((b, inverse))) = (above.peek(), own.peek()) {
            match a.cmp(b) {
                Ordering::Equal => return Some(**inverse_above * inverse.inverse()),
                Ordering::Greater => drop(above.next()),
                Ordering::Less => drop(own.next()),
            }
        }
        // Two skins, whose meshes may be in unlike spaces: the nodes know better, unless a scale is to be left out of them.
        let shown = self.shown[*last] && self.shown[*last_above];
        let is_rigid = nodes.local(node).matrix3.abs_diff_eq(nodes.local_rigid(node).matrix3, SAME);
        (!(shown && is_rigid)).then(|| **inverse_above * inverse.inverse())
    }
}

/// Whether all maps take a box to one place, which is that of `one`.
fn is_one(maps: &[DAffine3], one: &DAffine3, corners: [DVec3; 8]) -> bool {
    let like = Likeness::under(one, corners);
    maps.iter().all(|map| like.same(map, one))
}

/// The placed bind pose of every bone.
fn frames(nodes: &Nodes, bones: &[bool], known: &InverseBinds<'_>) -> Vec<Option<DAffine3>> {
    let mut frames: Vec<Option<DAffine3>> = vec![None; nodes.len() + 1];
    for &node in nodes.order() {
        if !bones[node] {
            continue;
        }
        let parent = nodes.parent(node);
        let above = frames[parent].unwrap_or_else(|| placement(nodes, parent));
        let local = known.local(nodes, node).map_or_else(|| *nodes.local_rigid(node), |local| rigid(&local));
        frames[node] = Some(above * local);
    }
    frames
}

/// Whether bones are to stand at rest as their nodes do: these show all skins in their bind pose and own shape, and one of them
/// is mirrored in `frames`.
fn stands_as_shown(
    nodes: &Nodes,
    skins: &Skins,
    boxes: &[SkinBox],
    known: &InverseBinds<'_>,
    frames: &[Option<DAffine3>],
) -> bool {
    let flat = |node: usize| frames[node].is_some() && is_flat(&nodes.global(node).matrix3, FLAT);
    let is_shown = |number: usize, skin: &Skin| {
        let is_bound = skin.inverse_binds.is_none() || known.shown[number];
        is_bound && !Reshaped::by(&shown_by(nodes, skin, top_joint(nodes, skin))).is_any()
    };
    let bound = || skins.iter().enumerate().filter(|(number, _)| boxes[*number].is_some());
    bound().any(|(_, skin)| reshaped(nodes, skin, &skin_maps(skin, frames)).mirrored)
        && bound().all(|(number, skin)| is_shown(number, skin))
        && !(0..nodes.len()).any(flat)
}

/// Where the nodes show a skin, by one of its joints.
fn shown_by(nodes: &Nodes, skin: &Skin, slot: usize) -> DAffine3 {
    let inverse = skin.inverse_binds.as_ref().map_or(DAffine3::IDENTITY, |all| all[slot]);
    *nodes.global(skin.joints[slot]) * inverse
}

/// How some maps of a skin reshape it that its nodes show in its own shape.
fn reshaped(nodes: &Nodes, skin: &Skin, maps: &[DAffine3]) -> Reshaped {
    let slot = top_joint(nodes, skin);
    let shown = shown_by(nodes, skin, slot);
    if is_flat(&shown.matrix3, FLAT) {
        return Reshaped::default();
    }
    let (shown, own) = (Reshaped::by(&shown), Reshaped::by(&maps[slot]));
    Reshaped { squashed: own.squashed && !shown.squashed, mirrored: own.mirrored && !shown.mirrored }
}

/// The maps of each skin by slot, and the skins whose joints would bend their mesh: these are moved to where the mesh was
/// bound, and with them the joints of other skins that share some.
fn straighten(
    nodes: &Nodes,
    skins: &Skins,
    boxes: &[SkinBox],
    frames: &mut [Option<DAffine3>],
) -> (Vec<Vec<DAffine3>>, Vec<usize>) {
    let mut maps: Vec<Vec<DAffine3>> = skins.iter().map(|skin| skin_maps(skin, frames)).collect();
    let bends = |number: &usize| {
        let (Some(skin), Some(own)) = (skins.get(*number), boxes[*number]) else { return false };
        let maps = &maps[*number];
        skin.inverse_binds.is_some() && !is_one(maps, &maps[top_joint(nodes, skin)], corners(own))
    };
    let bent: Vec<usize> = (0..skins.len()).filter(bends).collect();
    if bent.is_empty() {
        return (maps, bent);
    }
    let mut of_joint: Vec<Vec<usize>> = vec![Vec::new(); nodes.len() + 1];
    for (number, skin) in skins.iter().enumerate() {
        skin.joints.iter().for_each(|&node| of_joint[node].push(number));
    }
    let mut moved = vec![false; nodes.len() + 1];
    let mut done = vec![false; skins.len()];
    let mut open: VecDeque<usize> = bent.iter().copied().collect();
    while let Some(number) = open.pop_front() {
        let (Some(skin), Some(own)) = (skins.get(number), boxes[number].map(corners)) else { continue };
        let Some(inverse) = skin.inverse_binds.as_ref().filter(|_| !std::mem::replace(&mut done[number], true)) else {
            continue;
        };
        let top = top_joint(nodes, skin);
        let lead = if moved[skin.joints[top]] { None } else { skin.joints.iter().position(|&node| moved[node]) };
        let lead = lead.unwrap_or(top);
        let own_maps = &mut maps[number];
        *own_maps = skin_maps(skin, frames);
        let map = own_maps[lead];
        if is_one(own_maps, &map, own) {
            continue;
        }
        own_maps.fill(map);
        for (&node, inverse) in skin.joints.iter().zip(inverse) {
            if !std::mem::replace(&mut moved[node], true) {
                frames[node] = Some(map * inverse.inverse());
                open.extend(of_joint[node].iter().filter(|&&other| !done[other]));
            }
        }
    }
    // Those are in the space of their joints.
    for (number, skin) in skins.iter().enumerate().filter(|(_, skin)| skin.inverse_binds.is_none()) {
        maps[number] = skin_maps(skin, frames);
    }
    (maps, bent)
}

/// From an armature to the scene; the identity where that would flatten everything.
fn placement(nodes: &Nodes, armature: usize) -> DAffine3 {
    let global = nodes.global(armature);
    if is_flat(&global.matrix3, FLAT) { DAffine3::IDENTITY } else { *global }
}

fn skin_maps(skin: &Skin, frames: &[Option<DAffine3>]) -> Vec<DAffine3> {
    let frame = |node: usize| frames[node].unwrap_or(DAffine3::IDENTITY);
    match &skin.inverse_binds {
        Some(inverse) => skin.joints.iter().zip(inverse).map(|(&node, inverse)| frame(node) * *inverse).collect(),
        // All are the identity, by the format: vertices are given in the space of their joints.
        None => skin.joints.iter().map(|&node| frame(node)).collect(),
    }
}

/// The slot of the first joint that no other of its skin lies above.
fn top_joint(nodes: &Nodes, skin: &Skin) -> usize {
    let top: HashSet<usize> = nodes.topmost(&skin.joints).into_iter().collect();
    skin.joints.iter().position(|node| top.contains(node)).unwrap_or(0)
}

/// How many times larger one map makes things than another; 1 where poses may explain it.
fn larger(one: &DAffine3, other: &DAffine3) -> f64 {
    let size = (one.matrix3.determinant() / other.matrix3.determinant()).abs().cbrt();
    if size.is_normal() && !(0.8..=1.25).contains(&size) { size } else { 1.0 }
}

/// How far from its place in the bind pose the nodes show a joint, as a share of the mesh's size. A hidden one stands nowhere.
fn apart(nodes: &Nodes, frames: &[Option<DAffine3>], joint: usize, like: &Likeness) -> f64 {
    let (shown, bound) = (nodes.global(joint), frames[joint]);
    let share = bound.map_or(0.0, |bound| like.apart(shown.translation, bound.translation));
    if share.is_finite() && !is_flat(&shown.matrix3, FLAT) { share } else { 0.0 }
}

/// Which joints of a skin, by slot, hold something: weights of a vertex, or a mesh that hangs on them. Of the others, such as the
/// leaf bones that some exporters add, inverse bind matrices are often wrong, and nothing shows it.
fn held(nodes: &Nodes, skins: &Skins, skin: usize, sources: &Sources, accessors: &Accessors<'_>) -> Vec<bool> {
    let joints = skins.get(skin).map_or(&[][..], |skin| &skin.joints);
    let mut held = vec![false; joints.len()];
    for set in sources.sets.iter().filter(|set| set.skin == Some(skin)) {
        for &(joints, weights) in set.influences() {
            // What cannot be read is told where it is read for its own sake.
            let (Ok(joints), Ok(weights)) = (accessors.joints(joints), accessors.weights(weights)) else { continue };
            let rows = set.numbers.iter().filter_map(|&v| joints.get(v as usize).zip(weights.get(v as usize)));
            for (&joint, &weight) in rows.flat_map(|(joints, weights)| joints.iter().zip(weights)) {
                if let Some(held) = held.get_mut(joint as usize).filter(|_| weight > 0.0) {
                    *held = true;
                }
            }
        }
    }
    for set in sources.sets.iter().filter(|set| set.skin.is_none()) {
        let mut node = set.place.node;
        while node != nodes.top() && skins.joint_of_node(node).is_none() {
            node = nodes.parent(node);
        }
        if let Some(slot) = joints.iter().position(|&joint| joint == node) {
            held[slot] = true;
        }
    }
    held
}

/// How far the nodes of a skin's joints show it from where its top joint (its slot and map) takes it to the scene in the bind
/// pose; `None` where joints that `counts` names by slot stand in another pose.
fn shown_off_by(
    nodes: &Nodes,
    skin: &Skin,
    inverse: &[DAffine3],
    (slot, top): (usize, &DAffine3),
    like: &Likeness,
    counts: &dyn Fn(usize) -> bool,
) -> Option<DVec3> {
    let posed = |slot: usize| *nodes.global(skin.joints[slot]) * inverse[slot];
    // Inverse bind matrices may carry a scale, as those of quantised meshes do. It is taken out bone by
    // bone, which shifts the whole rig: no matter of pose, but what is not of the rig stays where it was.
    let scaled = (inverse[slot].matrix3.determinant().abs().cbrt() - 1.0).abs() > SAME;
    let shift = match scaled && !is_flat(&posed(slot).matrix3, FLAT) {
        true => like.shift(&posed(slot), top),
        false => DVec3::ZERO,
    };
    let expected = DAffine3::from_translation(shift) * *top;
    // A hidden joint stands nowhere.
    let fits = |posed: DAffine3| is_flat(&posed.matrix3, FLAT) || like.same(&posed, &expected);
    (0..inverse.len()).filter(|&slot| counts(slot)).map(posed).all(fits).then_some(shift)
}
