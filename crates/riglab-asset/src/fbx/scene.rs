//! The nodes as a tree, and the way from the file's axes and unit to ours.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec3};
use ufbx::{CoordinateAxis, Matrix, Node, Scene, SceneSettings};

use crate::NodeName;

/// The nodes of a scene by their number in it.
pub(super) struct Nodes<'a> {
    /// By number.
    pub(super) all: Vec<&'a Node>,
    /// Numbers depth first, children in the order of the file. The root, which is no node of the file, is among them.
    pub(super) order: Vec<usize>,
    /// Where each node stands in `order`.
    rank: Vec<usize>,
    /// From the world of the file to metres, y up.
    pub(super) space: DAffine3,
}

impl<'a> Nodes<'a> {
    pub(super) fn new(scene: &'a Scene) -> Self {
        let all: Vec<&Node> = (&scene.nodes).into_iter().collect();
        let mut order = Vec::with_capacity(all.len());
        let mut rank = vec![usize::MAX; all.len()];
        // A list, not recursion: chains may be as long as files.
        let mut stack = vec![number(&scene.root_node)];
        while let Some(node) = stack.pop() {
            if rank.get(node) == Some(&usize::MAX) {
                rank[node] = order.len();
                order.push(node);
                let first = stack.len();
                stack.extend((&all[node].children).into_iter().map(number));
                stack[first..].reverse();
            }
        }
        Self { all, order, rank, space: to_metres_y_up(&scene.settings) }
    }

    pub(super) fn parent(&self, node: usize) -> Option<usize> {
        self.all[node].parent.as_ref().map(|p| number(p)).filter(|&p| p < self.all.len())
    }

    pub(super) fn rank(&self, node: usize) -> usize {
        self.rank[node]
    }

    /// Nodes as messages name them.
    pub(super) fn named(&self, nodes: impl IntoIterator<Item = usize>) -> Vec<NodeName> {
        let name = |number: usize| self.all[number].element.name.to_string();
        nodes.into_iter().map(|number| NodeName { number, name: name(number) }).collect()
    }

    /// How many nodes show each mesh, by its number.
    pub(super) fn copies(&self) -> HashMap<u32, usize> {
        let mut copies = HashMap::new();
        for mesh in self.all.iter().filter_map(|node| node.mesh.as_deref()) {
            *copies.entry(mesh.element.typed_id).or_default() += 1;
        }
        copies
    }

    /// From a node's space to the file's world, in the pose in which the file was saved.
    pub(super) fn world(&self, node: usize) -> DAffine3 {
        affine(&self.all[node].node_to_world)
    }
}

/// A node's number in its scene.
pub(super) fn number(node: &Node) -> usize {
    node.element.typed_id as usize
}

pub(super) fn affine(m: &Matrix) -> DAffine3 {
    DAffine3::from_cols_array(&[m.m00, m.m10, m.m20, m.m01, m.m11, m.m21, m.m02, m.m12, m.m22, m.m03, m.m13, m.m23])
}

/// Settings that make no space (axes missing or not three, a unit that is no length) are left out.
fn to_metres_y_up(settings: &SceneSettings) -> DAffine3 {
    let axes = [settings.axes.right, settings.axes.up, settings.axes.front].map(direction);
    let rows = DMat3::from_cols(axes[0], axes[1], axes[2]);
    let turn = if rows.determinant().abs() == 1.0 { rows.transpose() } else { DMat3::IDENTITY };
    let unit = settings.unit_meters;
    let unit = if unit.is_normal() && unit > 0.0 { unit } else { 1.0 };
    DAffine3::from_mat3(turn * unit)
}

fn direction(axis: CoordinateAxis) -> DVec3 {
    match axis {
        CoordinateAxis::PositiveX => DVec3::X,
        CoordinateAxis::NegativeX => DVec3::NEG_X,
        CoordinateAxis::PositiveY => DVec3::Y,
        CoordinateAxis::NegativeY => DVec3::NEG_Y,
        CoordinateAxis::PositiveZ => DVec3::Z,
        CoordinateAxis::NegativeZ => DVec3::NEG_Z,
        CoordinateAxis::Unknown => DVec3::ZERO,
    }
}
