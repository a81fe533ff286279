//! The nodes of a file that hold no mesh and are none of its rig's: groups of meshes, and places such as sockets.

use glam::DAffine3;
use ufbx::Node;

use super::joints::Joints;
use super::model::counted;
use super::scene::{Nodes, affine};
use crate::gltf::export::model::Group;

/// What of the nodes is in a model, and what is not.
#[derive(Default)]
pub(super) struct Groups {
    pub(super) all: Vec<Group>,
    /// The nearest group above each node.
    above: Vec<Option<usize>>,
    /// Of what is left, how much.
    pub(super) left: Vec<String>,
}

impl Groups {
    pub(super) fn read(nodes: &Nodes<'_>, joints: &Joints) -> Self {
        let count = nodes.all.len();
        let moves_rig = joints.movers(nodes);
        // Joints and what is below them: it goes with its joint, which a node beside the skeleton would not.
        let mut below_joint = vec![false; count];
        let mut holds_mesh = vec![false; count];
        for &node in &nodes.order {
            below_joint[node] = joints.is_joint(node) || nodes.parent(node).is_some_and(|parent| below_joint[parent]);
        }
        for &node in nodes.order.iter().rev() {
            holds_mesh[node] |= nodes.all[node].mesh.is_some();
            if let Some(parent) = nodes.parent(node) {
                holds_mesh[parent] |= holds_mesh[node];
            }
        }
        let mut own = Self { above: vec![None; count], ..Self::default() };
        // The group that each node is.
        let mut number: Vec<Option<usize>> = vec![None; count];
        let (mut cameras, mut lights, mut carried, mut below) = (0, 0, 0, 0);
        let mut places: Vec<DAffine3> = Vec::new();
        for &at in &nodes.order {
            let node = nodes.all[at];
            let parent = nodes.parent(at);
            own.above[at] = parent.and_then(|p| number[p].or(own.above[p]));
            below += usize::from(!below_joint[at] && parent.is_some_and(|p| nodes.all[p].mesh.is_some()));
            cameras += usize::from(node.camera.is_some());
            lights += usize::from(node.light.is_some());
            // An armature is of the rig as joints are.
            if node.is_root || !is_bare(node) || moves_rig[at] {
                continue;
            }
            if below_joint[at] {
                carried += 1;
                continue;
            }
            // Meshes are in the scene's space, and so is what holds them.
            let place = if holds_mesh[at] { DAffine3::IDENTITY } else { place(nodes, at) };
            let within = own.above[at].map_or(place, |above| places[above].inverse() * place);
            number[at] = Some(own.all.len());
            own.all.push(Group { name: node.element.name.to_string(), parent: own.above[at], place: within });
            places.push(place);
        }
        let left = [
            counted(cameras, "camera", "cameras"),
            counted(lights, "light", "lights"),
            counted(carried, "empty node below a joint", "empty nodes below joints"),
            counted(below, "node's place below a mesh", "nodes' places below meshes"),
        ];
        own.left = left.into_iter().flatten().collect();
        own
    }

    /// The nearest group above a node.
    pub(super) fn above(&self, node: usize) -> Option<usize> {
        self.above[node]
    }
}

/// Whether a node is for nothing but its place and what hangs on it. Limb nodes that are no joints are ends of bones.
fn is_bare(node: &Node) -> bool {
    let empty = node.mesh.is_none() && node.bone.is_none() && node.camera.is_none() && node.light.is_none();
    empty && !node.is_geometry_transform_helper && !node.is_scale_helper
}

/// Where a node stands in the scene, and how it is turned; its scale is often that of the file's unit.
fn place(nodes: &Nodes<'_>, node: usize) -> DAffine3 {
    let map = nodes.space * affine(&nodes.all[node].node_to_world);
    let (_, turn, at) = map.to_scale_rotation_translation();
    let turn = if turn.is_finite() && turn.length() > 0.5 { turn.normalize() } else { glam::DQuat::IDENTITY };
    let at = if at.as_vec3().is_finite() { at } else { glam::DVec3::ZERO };
    DAffine3::from_rotation_translation(turn, at)
}
