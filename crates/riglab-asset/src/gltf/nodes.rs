//! The nodes as a forest, and where they stand.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::document::{Document, Node};
use crate::{Fault, NodeName};

/// Nodes under one another. "Above everything" counts as one more node, [`Nodes::top`], at the origin.
///
/// Everything here works through lists, never by recursion: node chains may be as long as files.
pub(super) struct Nodes {
    /// The parent of each node; of the top the top.
    parent: Vec<usize>,
    /// All nodes but the top, depth first, children in the order of the file.
    order: Vec<usize>,
    /// Where each node stands in `order`.
    rank: Vec<usize>,
    /// Where in `order` the nodes below each one end.
    end: Vec<usize>,
    /// How many nodes lie above; 0 for the top alone.
    depth: Vec<usize>,
    /// Some node further above, so that a way up takes a number of steps like the logarithm of its
    /// length (skew-binary jump pointers).
    jump: Vec<usize>,
    /// Node to parent.
    local: Vec<DAffine3>,
    /// The same without scale.
    local_rigid: Vec<DAffine3>,
    /// Node to scene.
    global: Vec<DAffine3>,
    /// What each node is called; empty where it has no name.
    names: Vec<String>,
}

impl Nodes {
    /// Checks that the nodes make a forest.
    pub(super) fn new(document: &Document) -> Result<Self, Fault> {
        let nodes = &document.nodes;
        let count = nodes.len();
        let top = count;
        let mut parent = vec![top; count + 1];
        for (node, children) in nodes.iter().map(|n| &n.children).enumerate() {
            for &child in children {
                if child >= count {
                    let from = format!("node {node}");
                    return Err(Fault::Reference { from, to: "child node", index: child, count });
                }
                if parent[child] != top {
                    return Err(Fault::TwoParents { node: child, first: parent[child], second: node });
                }
                parent[child] = node;
            }
        }

        let mut order = Vec::with_capacity(count);
        let mut stack: Vec<usize> = (0..count).rev().filter(|&n| parent[n] == top).collect();
        while let Some(node) = stack.pop() {
            order.push(node);
            stack.extend(nodes[node].children.iter().rev());
        }
        let mut rank = vec![usize::MAX; count + 1];
        for (at, &node) in order.iter().enumerate() {
            rank[node] = at;
        }
        if let Some(lost) = (0..count).find(|&n| rank[n] == usize::MAX) {
            // What cannot be reached hangs on a cycle; going up long enough ends in it.
            return Err(Fault::Cycle((0..count).fold(lost, |node, _| parent[node])));
        }

        let mut end: Vec<usize> = rank.iter().map(|r| r.saturating_add(1)).collect();
        for &node in order.iter().rev() {
            end[parent[node]] = end[parent[node]].max(end[node]);
        }

        let local: Vec<_> = nodes.iter().map(local).collect();
        let local_rigid = nodes.iter().zip(&local).map(|(node, local)| local_rigid(node, local)).collect();
        let mut depth = vec![0; count + 1];
        let mut jump = vec![top; count + 1];
        let mut global = vec![DAffine3::IDENTITY; count + 1];
        for &node in &order {
            let above = parent[node];
            depth[node] = depth[above] + 1;
            let (near, far) = (jump[above], jump[jump[above]]);
            jump[node] = if depth[above] - depth[near] == depth[near] - depth[far] { far } else { above };
            global[node] = global[above] * local[node];
        }
        let names = nodes.iter().map(|node| node.name.clone().unwrap_or_default()).collect();
        Ok(Self { parent, order, rank, end, depth, jump, local, local_rigid, global, names })
    }

    /// Nodes as messages name them.
    pub(super) fn named(&self, nodes: impl IntoIterator<Item = usize>) -> Vec<NodeName> {
        nodes.into_iter().map(|number| NodeName { number, name: self.names[number].clone() }).collect()
    }

    /// The node above everything; one more than the last.
    pub(super) fn top(&self) -> usize {
        self.order.len()
    }

    /// How many nodes, the top left out.
    pub(super) fn len(&self) -> usize {
        self.order.len()
    }

    pub(super) fn parent(&self, node: usize) -> usize {
        self.parent[node]
    }

    /// How many nodes lie above, the top counted.
    pub(super) fn depth(&self, node: usize) -> usize {
        self.depth[node]
    }

    /// All nodes, parents first, depth first.
    pub(super) fn order(&self) -> &[usize] {
        &self.order
    }

    /// Whether a node lies below another.
    pub(super) fn is_below(&self, node: usize, above: usize) -> bool {
        self.rank[above] < self.rank[node] && self.rank[node] < self.end[above]
    }

    /// A node and all below it, depth first.
    pub(super) fn subtree(&self, node: usize) -> &[usize] {
        &self.order[self.rank[node]..self.end[node]]
    }

    pub(super) fn local(&self, node: usize) -> &DAffine3 {
        &self.local[node]
    }

    pub(super) fn local_rigid(&self, node: usize) -> &DAffine3 {
        &self.local_rigid[node]
    }

    pub(super) fn global(&self, node: usize) -> &DAffine3 {
        &self.global[node]
    }

    /// Those of `nodes` that no other of them lies above, in depth-first order.
    pub(super) fn topmost(&self, nodes: &[usize]) -> Vec<usize> {
        let mut sorted = nodes.to_vec();
        sorted.sort_unstable_by_key(|&n| self.rank[n]);
        let mut end = 0;
        sorted.retain(|&n| {
            let free = self.rank[n] >= end;
            if free {
                end = self.end[n];
            }
            free
        });
        sorted
    }

    /// The deepest node that is, or lies above, all of `nodes`; the top if they have no other in
    /// common or are none.
    ///
    /// In depth-first order the first and the last of them have the same common ancestor as all.
    pub(super) fn common(&self, nodes: impl Iterator<Item = usize> + Clone) -> usize {
        let by_rank = |n: &usize| self.rank[*n];
        let (Some(mut node), Some(last)) = (nodes.clone().min_by_key(by_rank), nodes.max_by_key(by_rank)) else {
            return self.top();
        };
        let above_last = |node: usize| node == self.top() || self.end[node] > self.rank[last];
        while !above_last(node) {
            let jump = self.jump[node];
            node = if above_last(jump) { self.parent[node] } else { jump };
        }
        node
    }
}

/// A node's scale, rotation and translation. Those of a matrix are as good as it allows.
pub(super) fn parts(node: &Node) -> (DVec3, DQuat, DVec3) {
    match node.matrix {
        Some(_) => {
            let (own, rigid) = (local(node), rigid(&local(node)));
            let mirrored = if own.matrix3.determinant() < 0.0 { -1.0 } else { 1.0 };
            let lengths =
                [own.matrix3.x_axis, own.matrix3.y_axis, own.matrix3.z_axis].map(|axis| mirrored * axis.length());
            (lengths.into(), DQuat::from_mat3(&rigid.matrix3), own.translation)
        }
        None => (
            node.scale.map_or(DVec3::ONE, DVec3::from),
            rotation(node),
            node.translation.map_or(DVec3::ZERO, DVec3::from),
        ),
    }
}

fn local(node: &Node) -> DAffine3 {
    match &node.matrix {
        Some(m) => DAffine3::from_cols_array_2d(&[
            [m[0], m[1], m[2]],
            [m[4], m[5], m[6]],
            [m[8], m[9], m[10]],
            [m[12], m[13], m[14]],
        ]),
        None => {
            let (scale, rotation, translation) = parts(node);
            DAffine3::from_scale_rotation_translation(scale, rotation, translation)
        }
    }
}

fn local_rigid(node: &Node, local: &DAffine3) -> DAffine3 {
    match node.matrix {
        Some(_) => rigid(local),
        None => DAffine3::from_rotation_translation(rotation(node), local.translation),
    }
}

/// The node's rotation; none where the file's quaternion is 0.
fn rotation(node: &Node) -> DQuat {
    node.rotation.and_then(|q| normalized(DQuat::from_array(q))).unwrap_or(DQuat::IDENTITY)
}

fn normalized(q: DQuat) -> Option<DQuat> {
    let length = q.length();
    (length > 0.0 && length.is_finite()).then(|| DQuat::from_vec4(glam::DVec4::from(q) / length))
}

/// Rotation and translation of an affine map: scale and mirroring taken out.
///
/// The columns are brought to length 1 and read as if they were a rotation matrix; under shear the
/// quaternion is that of the reading, not of the nearest rotation, as in Blender.
pub(super) fn rigid(m: &DAffine3) -> DAffine3 {
    let [x, y, z] = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis].map(DVec3::normalize_or_zero);
    let mut axes = DMat3::from_cols(x, y, z);
    if axes.determinant() < 0.0 {
        axes = -axes;
    }
    let quaternion = if axes == DMat3::ZERO { None } else { normalized(as_quaternion(&axes)) };
    let rotation = quaternion.unwrap_or(DQuat::IDENTITY);
    DAffine3::from_rotation_translation(rotation, m.translation)
}

/// A matrix read as a quaternion, not normalised. Of the four ways to write it, the one with the
/// largest term is taken where the trace is not positive.
fn as_quaternion(m: &DMat3) -> DQuat {
    let at = |row: usize, column: usize| m.col(column)[row];
    let trace = at(0, 0) + at(1, 1) + at(2, 2);
    if trace > 0.0 {
        return DQuat::from_xyzw(at(2, 1) - at(1, 2), at(0, 2) - at(2, 0), at(1, 0) - at(0, 1), 1.0 + trace);
    }
    let mut i = 0;
    for k in 1..3 {
        if at(k, k) > at(i, i) {
            i = k;
        }
    }
    let (j, k) = ((i + 1) % 3, (i + 2) % 3);
    let mut q = [0.0; 4];
    q[i] = 1.0 + at(i, i) - at(j, j) - at(k, k);
    q[j] = at(j, i) + at(i, j);
    q[k] = at(k, i) + at(i, k);
    q[3] = at(k, j) - at(j, k);
    DQuat::from_array(q)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forest(children: &[&[usize]]) -> Result<Nodes, Fault> {
        let nodes = children.iter().map(|c| Node { children: c.to_vec(), ..Default::default() }).collect();
        Nodes::new(&Document { nodes, ..Default::default() })
    }

    #[test]
    fn order_is_depth_first_with_children_as_in_the_file() {
        let nodes = forest(&[&[], &[3, 0], &[], &[4], &[]]).unwrap();
        assert_eq!(nodes.order(), [1, 3, 4, 0, 2]);
        assert_eq!(nodes.common([4, 0].into_iter()), 1);
        assert_eq!(nodes.common([4, 3].into_iter()), 3);
        assert_eq!(nodes.common([4, 2, 0].into_iter()), nodes.top());
        assert_eq!(nodes.topmost(&[2, 4, 0, 3]), [3, 0, 2]);
        assert_eq!(nodes.topmost(&[0, 1, 4]), [1]);
    }

    #[test]
    fn what_is_no_forest_is_refused() {
        assert_eq!(forest(&[&[1], &[0]]).err(), Some(Fault::Cycle(0)));
        assert_eq!(forest(&[&[0]]).err(), Some(Fault::Cycle(0)));
        assert_eq!(forest(&[&[2], &[2], &[]]).err(), Some(Fault::TwoParents { node: 2, first: 0, second: 1 }));
        assert!(matches!(forest(&[&[7]]).err(), Some(Fault::Reference { index: 7, count: 1, .. })));
        // The cycle is 1-2; node 0 only hangs below it.
        assert!(matches!(forest(&[&[], &[2, 0], &[1]]).err(), Some(Fault::Cycle(1 | 2))));
    }

    #[test]
    fn a_hundred_thousand_nodes_in_a_chain_are_no_trouble() {
        let nodes = (1..=100_000).map(|n| Node { children: vec![n], ..Default::default() });
        let nodes = nodes.chain([Node::default()]).collect();
        let nodes = Nodes::new(&Document { nodes, ..Default::default() }).unwrap();
        assert_eq!(nodes.depth(100_000), 100_001);
        assert_eq!(nodes.common([70_000, 99_999].into_iter()), 70_000);
    }

    #[test]
    fn parts_of_a_matrix_make_it_again() {
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, -0.8), 2.0);
        for scale in [DVec3::new(1.0, 5.0, 2.0), DVec3::new(-1.0, -5.0, -2.0)] {
            let m = DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(1.0, 2.0, 3.0));
            let [x, y, z, t] = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation];
            let matrix = [x.extend(0.0), y.extend(0.0), z.extend(0.0), t.extend(1.0)].map(|c| c.to_array());
            let matrix = std::array::from_fn(|i| matrix[i / 4][i % 4]);
            let (s, r, t) = parts(&Node { matrix: Some(matrix), ..Default::default() });
            assert!(DAffine3::from_scale_rotation_translation(s, r, t).abs_diff_eq(m, 1e-12));
        }
    }

    #[test]
    fn rigid_takes_scale_and_mirroring_out() {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(0.6, 0.0, -0.8)] {
            for angle in [0.3, 1.7, 3.0, std::f64::consts::PI, 4.4] {
                let turn = DQuat::from_axis_angle(axis, angle);
                let moved = DAffine3::from_rotation_translation(turn, DVec3::new(1.0, 2.0, 3.0));
                for scale in [DVec3::splat(0.01), DVec3::splat(-3.0), DVec3::new(1.0, 5.0, 2.0)] {
                    let scaled = moved * DAffine3::from_scale(scale);
                    assert!(rigid(&scaled).abs_diff_eq(moved, 1e-12), "{axis} {angle} {scale}");
                }
            }
        }
        assert_eq!(rigid(&DAffine3::from_scale(DVec3::ZERO)), DAffine3::IDENTITY);
    }
}
