//! Which nodes are joints, and where they were bound.
//!
//! Joints are the bones that clusters name, whatever kind of node they are, and the bones (limb nodes) that hold
//! a mesh without skin; also the limb nodes above them, which some writers give no cluster when they move no
//! vertex. Limb nodes below the last of these are ends of the writer's making, and are left out.

use std::collections::HashSet;

use glam::{DAffine3, DVec3};
use riglab_core::RigError;
use ufbx::{Mesh, Scene};

use super::scene::{Nodes, affine, number};
use super::shown;
use crate::maps::{FLAT, Likeness, corners, is_flat};
use crate::names::Names;
use crate::reading::{Posed, ToldSkin};
use crate::{Fault, ReadJoint, Warning, skeletons};

/// The joints of a file.
pub(super) struct Joints {
    /// Nodes by joint, depth first.
    nodes: Vec<usize>,
    /// Joints by node.
    number: Vec<Option<u16>>,
    parents: Vec<Option<u16>>,
    /// From joint space to the file's world when bound, by node; for joints only.
    frames: Vec<Option<DAffine3>>,
    /// By mesh, where it has a skin.
    skins: Vec<Option<Skin>>,
    /// The skins that the file shows in another pose.
    posed: Vec<usize>,
}

/// What is told of them: ufbx gives both poses in the same size.
const SHOWN: Posed = Posed { size: 1.0, off: 0.0 };

/// What binds a mesh.
pub(super) struct Skin {
    /// Its number in warnings: that of its first deformer.
    deformer: usize,
    /// The joint of each cluster, the skin deformers of the mesh one after the other.
    pub(super) joints: Vec<u16>,
    /// From the mesh to the file's world when bound.
    pub(super) map: DAffine3,
    /// The cluster whose bone no other of the skin lies above.
    highest: usize,
    /// Nodes with the map from mesh to joint when bound, by cluster.
    clusters: Vec<(usize, DAffine3)>,
}

impl Joints {
    pub(super) fn read(scene: &Scene, nodes: &Nodes<'_>, warnings: &mut Vec<Warning>) -> Result<Self, Fault> {
        let mut frames: Vec<Option<DAffine3>> = vec![None; nodes.all.len()];
        let mut skins: Vec<Option<Skin>> = Vec::with_capacity(scene.meshes.len());
        for mesh in &scene.meshes {
            skins.push(Skin::read(mesh, nodes, &mut frames));
        }
        let (mut bent, mut posed) = (Vec::new(), Vec::new());
        for (mesh, skin) in (&scene.meshes).into_iter().zip(&mut skins) {
            let Some(skin) = skin else { continue };
            let Placed { bends, stands_elsewhere } = skin.place(mesh, nodes, &mut frames)?;
            bent.extend(bends.then_some(skin.deformer));
            posed.extend(stands_elsewhere.then_some(skin.deformer));
        }
        if !bent.is_empty() {
            warnings.push(Warning::Bent { skins: bent });
        }
        warnings.extend(Posed::warning(posed.iter().map(|&skin| (skin, SHOWN))));

        let is_joint = joint_nodes(nodes, &skins);
        let joints: Vec<usize> = nodes.order.iter().copied().filter(|&n| is_joint[n]).collect();
        let mut number = vec![None; nodes.all.len()];
        for (at, &node) in joints.iter().enumerate() {
            number[node] = Some(u16::try_from(at).map_err(|_| RigError::TooManyJoints(joints.len()))?);
        }
        for skin in skins.iter_mut().flatten() {
            skin.joints = skin.clusters.iter().filter_map(|(node, _)| number[*node]).collect();
        }
        let parents = parents(nodes, &joints, &number);
        let mut all = Self { nodes: joints, number, parents, frames, skins, posed };
        all.complete_frames(nodes);
        Ok(all)
    }

    /// What binds the mesh of this number.
    pub(super) fn skin(&self, mesh: usize) -> Option<&Skin> {
        self.skins.get(mesh)?.as_ref()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    pub(super) fn is_joint(&self, node: usize) -> bool {
        self.number[node].is_some()
    }

    /// The nearest joint at or above a node.
    pub(super) fn at_or_above(&self, nodes: &Nodes<'_>, mut node: usize) -> Option<u16> {
        loop {
            if let Some(joint) = self.number[node] {
                return Some(joint);
            }
            node = nodes.parent(node)?;
        }
    }

    /// From where the file's pose has a joint to where it was bound; `None` where it is flattened.
    pub(super) fn unposed(&self, nodes: &Nodes<'_>, joint: u16) -> Option<DAffine3> {
        let node = self.nodes[usize::from(joint)];
        let world = nodes.world(node);
        (!is_flat(&world.matrix3, FLAT)).then(|| self.frame(node) * world.inverse())
    }

    /// The node of each joint, and what takes the file's world at rest to the space of the joint; `None` where a joint is
    /// flattened.
    pub(super) fn to_joints(&self) -> Option<Vec<(usize, DAffine3)>> {
        let to_joint = |&node: &usize| Some(self.frame(node)).filter(is_sound).map(|frame| (node, frame.inverse()));
        self.nodes.iter().map(to_joint).collect()
    }

    /// Whether each node is a joint or stands above one, so that it moves one.
    pub(super) fn movers(&self, nodes: &Nodes<'_>) -> Vec<bool> {
        let mut moves: Vec<bool> = self.number.iter().map(Option::is_some).collect();
        for &node in nodes.order.iter().rev() {
            if let Some(parent) = nodes.parent(node) {
                moves[parent] |= moves[node];
            }
        }
        moves
    }

    /// Where the node stands below which all joints hang; the world's origin where that differs.
    pub(super) fn origin(&self, nodes: &Nodes<'_>) -> DVec3 {
        let mut above =
            self.nodes.iter().zip(&self.parents).filter(|(_, p)| p.is_none()).map(|(&n, _)| nodes.parent(n));
        match above.next() {
            Some(Some(first)) if above.all(|a| a == Some(first)) => {
                nodes.space.transform_point3(nodes.world(first).translation)
            }
            _ => DVec3::ZERO,
        }
    }

    /// The joints of the reading; names changed are told in a warning.
    pub(super) fn reading(&self, nodes: &Nodes<'_>, warnings: &mut Vec<Warning>) -> Result<Vec<ReadJoint>, Fault> {
        let mut names = Names::default();
        let mut renamed: Option<(usize, (usize, String, String))> = None;
        let skeletons = skeletons::group(&self.parents, self.skins.iter().flatten().map(|skin| &skin.joints[..]));
        let mut joints = Vec::with_capacity(self.nodes.len());
        for (i, &node) in self.nodes.iter().enumerate() {
            let wanted: &str = &nodes.all[node].element.name;
            let name = names.unique(wanted, || format!("joint_{node}"));
            if name != wanted {
                renamed.get_or_insert_with(|| (0, (node, wanted.to_owned(), name.clone()))).0 += 1;
            }
            let head = nodes.space.transform_point3(self.frame(node).translation).as_vec3();
            if !head.is_finite() {
                return Err(Fault::JointNotFinite { name: shown(&name), node });
            }
            let parent = self.parents[i].map(usize::from);
            joints.push(ReadJoint { name, node, parent, head: head.into(), skeleton: skeletons[i] });
        }
        warnings.extend(renamed.map(|(joints, first)| Warning::Renamed { joints, first }));
        Ok(joints)
    }

    /// What warnings say of each skin, and whose it is.
    pub(super) fn told(&self, joints: &[ReadJoint]) -> Vec<ToldSkin> {
        let shown: HashSet<usize> = self.posed.iter().copied().collect();
        let one = |skin: &Skin| {
            let skeleton = joints[usize::from(*skin.joints.first()?)].skeleton;
            let posed = shown.contains(&skin.deformer).then_some(SHOWN);
            Some(ToldSkin { number: skin.deformer, skeleton, posed })
        };
        self.skins.iter().flatten().filter_map(one).collect()
    }

    fn frame(&self, node: usize) -> DAffine3 {
        self.frames[node].unwrap_or(DAffine3::IDENTITY)
    }

    /// Frames of joints that no cluster names: as they stand to the first joint below that has one, else to the
    /// nearest above, else as the file's pose has them.
    fn complete_frames(&mut self, nodes: &Nodes<'_>) {
        let bound: Vec<bool> = self.frames.iter().map(Option::is_some).collect();
        let moved = |frames: &[Option<DAffine3>], from: usize, to: usize| {
            let (frame, world) = (frames[from]?, nodes.world(from));
            (!is_flat(&world.matrix3, FLAT)).then(|| frame * world.inverse() * nodes.world(to))
        };
        // From the last: the first child comes last, so that it counts.
        for (&node, parent) in self.nodes.iter().zip(&self.parents).rev() {
            let Some(above) = parent.map(|p| self.nodes[usize::from(p)]).filter(|&a| !bound[a]) else { continue };
            if let Some(frame) = moved(&self.frames, node, above) {
                self.frames[above] = Some(frame);
            }
        }
        for (&node, parent) in self.nodes.iter().zip(&self.parents) {
            if self.frames[node].is_none() {
                let above = parent.and_then(|p| moved(&self.frames, self.nodes[usize::from(p)], node));
                self.frames[node] = Some(above.unwrap_or_else(|| nodes.world(node)));
            }
        }
    }
}

/// What [`Skin::place`] found.
struct Placed {
    /// Its bind matrices contradict each other.
    bends: bool,
    /// The file was saved in another pose.
    stands_elsewhere: bool,
}

impl Skin {
    /// The clusters of a mesh, whose bones get their frames; a later skin overrides an earlier one.
    fn read(mesh: &Mesh, nodes: &Nodes<'_>, frames: &mut [Option<DAffine3>]) -> Option<Self> {
        let mut clusters = Vec::new();
        for cluster in (&mesh.skin_deformers).into_iter().flat_map(|skin| &skin.clusters) {
            // All have one, or the numbers of clusters in the weights would not fit.
            let node = number(cluster.bone_node.as_ref()?);
            let bind = affine(&cluster.bind_to_world);
            if is_sound(&bind) {
                *frames.get_mut(node)? = Some(bind);
            }
            clusters.push((node, affine(&cluster.geometry_to_bone)));
        }
        let highest = (0..clusters.len()).min_by_key(|&c| nodes.rank(clusters[c].0))?;
        let deformer = mesh.skin_deformers.first().map_or(0, |s| s.element.typed_id as usize);
        Some(Self { deformer, joints: Vec::new(), map: DAffine3::IDENTITY, highest, clusters })
    }

    /// Finds the one map by which all clusters take the mesh to the world.
    fn place(&mut self, mesh: &Mesh, nodes: &Nodes<'_>, frames: &mut [Option<DAffine3>]) -> Result<Placed, Fault> {
        let (top, to_top) = self.clusters[self.highest];
        let frame = frames[top].unwrap_or_else(|| nodes.world(top));
        self.map = frame * to_top;
        if !is_sound(&self.map) {
            let (mesh, bone) = (shown(&mesh.element.name), shown(&nodes.all[top].element.name));
            return Err(Fault::Fbx(format!("mesh `{mesh}`: the bind matrices of its bone `{bone}` are singular")));
        }
        let Some(like) = bounds(mesh).map(|bounds| Likeness::under(&self.map, corners(bounds))) else {
            return Ok(Placed { bends: false, stands_elsewhere: false });
        };
        let differs = |map: DAffine3| is_sound(&map) && !like.same(&map, &self.map);
        let bends = self.clusters.iter().any(|(node, to_joint)| frames[*node].is_some_and(|f| differs(f * *to_joint)));
        if bends {
            for (node, to_joint) in self.clusters.iter().filter(|(_, to_joint)| is_sound(to_joint)) {
                frames[*node] = Some(self.map * to_joint.inverse());
            }
        }
        let stands_elsewhere = self.clusters.iter().any(|(node, to_joint)| differs(nodes.world(*node) * *to_joint));
        Ok(Placed { bends, stands_elsewhere })
    }
}

/// Whether a map can be inverted.
fn is_sound(map: &DAffine3) -> bool {
    !is_flat(&map.matrix3, FLAT) && map.translation.is_finite()
}

/// The box around the control points; those that are not finite are told where they are used.
fn bounds(mesh: &Mesh) -> Option<(DVec3, DVec3)> {
    let points = mesh.vertices.iter().map(|v| DVec3::new(v.x, v.y, v.z)).filter(|p| p.is_finite());
    points.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))
}

/// Which nodes are joints.
fn joint_nodes(nodes: &Nodes<'_>, skins: &[Option<Skin>]) -> Vec<bool> {
    let is_bone = |node: usize| nodes.all[node].bone.is_some();
    let mut is_joint = vec![false; nodes.all.len()];
    for (node, _) in skins.iter().flatten().flat_map(|s| &s.clusters) {
        is_joint[*node] = true;
    }
    // Whether a joint, or an unskinned mesh that no bone further down holds, lies at or below a node.
    let mut carries = is_joint.clone();
    for &node in nodes.order.iter().rev() {
        if let Some(mesh) = &nodes.all[node].mesh {
            let skinned = skins.get(mesh.element.typed_id as usize).is_some_and(Option::is_some);
            carries[node] |= !skinned && mesh.num_faces > 0;
        }
        if carries[node] {
            is_joint[node] |= is_bone(node);
            if let Some(parent) = nodes.parent(node) {
                carries[parent] = true;
            }
        }
    }
    is_joint
}

/// The nearest joint above each joint.
fn parents(nodes: &Nodes<'_>, joints: &[usize], number: &[Option<u16>]) -> Vec<Option<u16>> {
    // The nearest joint at or above each node, parents first.
    let mut nearest: Vec<Option<u16>> = vec![None; nodes.all.len()];
    for &node in &nodes.order {
        nearest[node] = number[node].or_else(|| nearest[nodes.parent(node)?]);
    }
    joints.iter().map(|&node| nearest[nodes.parent(node)?]).collect()
}
