//! Skins: which nodes are joints, and where they were bound.

use glam::{DAffine3, DMat4};
use riglab_core::RigError;

use super::accessor::{Accessors, INVERSE_BIND};
use super::bind::Binds;
use super::document::{self, Document};
use super::nodes::Nodes;
use crate::maps::{FLAT, is_flat};
use crate::names::Names;
use crate::{Fault, ReadJoint, Warning, skeletons};

/// A matrix is taken for singular when its smallest stretch is less than this share of its largest:
/// what f32 cannot tell from 0.
const SINGULAR: f64 = 1e-12;

/// All skins of a file over the joints they share.
pub(super) struct Skins {
    skins: Vec<Skin>,
    /// The nodes that are joints, depth first: the joints of the reading.
    joints: Vec<usize>,
    /// Which joint of the reading each node is.
    number: Vec<Option<u16>>,
    /// The index of each joint's parent among the joints.
    parents: Vec<Option<u16>>,
}

/// One skin.
pub(super) struct Skin {
    /// Nodes by slot; each once.
    pub(super) joints: Vec<usize>,
    /// The same as joints of the reading.
    pub(super) numbers: Vec<u16>,
    /// Mesh to joint at rest, by slot, where the file has them.
    pub(super) inverse_binds: Option<Vec<DAffine3>>,
    /// The node that `skin.skeleton` names.
    pub(super) skeleton: Option<usize>,
}

impl Skins {
    pub(super) fn read(
        document: &Document,
        nodes: &Nodes,
        accessors: &Accessors<'_>,
        warnings: &mut Vec<Warning>,
    ) -> Result<Self, Fault> {
        let mut skins = Vec::with_capacity(document.skins.len());
        // In which skin a node was last seen.
        let mut seen = vec![usize::MAX; nodes.len()];
        for (number, skin) in document.skins.iter().enumerate() {
            let missing =
                |index| Fault::Reference { from: format!("skin {number}"), to: "node", index, count: nodes.len() };
            if skin.joints.is_empty() {
                return Err(Fault::EmptySkin(number));
            }
            for &node in &skin.joints {
                let seen = seen.get_mut(node).ok_or_else(|| missing(node))?;
                if *seen == number {
                    return Err(Fault::JointTwice { skin: number, node });
                }
                *seen = number;
            }
            if let Some(node) = skin.skeleton.filter(|n| *n >= nodes.len()) {
                return Err(missing(node));
            }
            skins.push(Skin {
                joints: skin.joints.clone(),
                numbers: Vec::new(),
                inverse_binds: inverse_binds(number, skin, accessors)?,
                skeleton: skin.skeleton,
            });
        }
        let joints: Vec<usize> = nodes.order().iter().copied().filter(|&n| seen[n] != usize::MAX).collect();
        let too_many = || Fault::Rig(RigError::TooManyJoints(joints.len()));
        let mut number = vec![None; nodes.len()];
        for (at, &node) in joints.iter().enumerate() {
            number[node] = Some(u16::try_from(at).map_err(|_| too_many())?);
        }
        for skin in &mut skins {
            skin.numbers = skin.joints.iter().filter_map(|&node| number[node]).collect();
        }
        let parents = parents(nodes, &joints, &number);
        warn_of_zero_scales(nodes, &joints, warnings);
        Ok(Self { skins, joints, number, parents })
    }

    pub(super) fn len(&self) -> usize {
        self.skins.len()
    }

    pub(super) fn get(&self, skin: usize) -> Option<&Skin> {
        self.skins.get(skin)
    }

    pub(super) fn iter(&self) -> std::slice::Iter<'_, Skin> {
        self.skins.iter()
    }

    /// The nodes that are joints, depth first.
    pub(super) fn joint_nodes(&self) -> &[usize] {
        &self.joints
    }

    /// Which joint of the reading a node is.
    pub(super) fn joint_of_node(&self, node: usize) -> Option<u16> {
        self.number[node]
    }

    /// The joints of the reading; names changed are told in a warning.
    pub(super) fn joints(
        &self,
        document: &Document,
        binds: &Binds,
        warnings: &mut Vec<Warning>,
    ) -> Result<Vec<ReadJoint>, Fault> {
        let mut names = Names::default();
        let mut renamed: Option<(usize, (usize, String, String))> = None;
        let skeletons = skeletons::group(&self.parents, self.skins.iter().map(|skin| &skin.numbers[..]));
        let mut joints = Vec::with_capacity(self.joints.len());
        for (i, &node) in self.joints.iter().enumerate() {
            let wanted = document.nodes[node].name.as_deref().unwrap_or_default();
            let name = names.unique(wanted, || format!("joint_{node}"));
            if name != wanted {
                renamed.get_or_insert_with(|| (0, (node, wanted.to_owned(), name.clone()))).0 += 1;
            }
            let head = binds.head(node).as_vec3();
            if !head.is_finite() {
                return Err(Fault::JointNotFinite { name, node });
            }
            let parent = self.parents[i].map(usize::from);
            joints.push(ReadJoint { name, node, parent, head: head.into(), skeleton: skeletons[i] });
        }
        warnings.extend(renamed.map(|(joints, first)| Warning::Renamed { joints, first }));
        Ok(joints)
    }
}

fn inverse_binds(
    number: usize,
    skin: &document::Skin,
    accessors: &Accessors<'_>,
) -> Result<Option<Vec<DAffine3>>, Fault> {
    let Some(accessor) = skin.inverse_bind_matrices else { return Ok(None) };
    accessors.check(accessor, || format!("skin {number}"))?;
    let matrices = accessors.matrices(accessor, skin.joints.len())?;
    if matrices.len() < skin.joints.len() {
        return Err(Fault::InverseBindCount { skin: number, found: matrices.len(), wanted: skin.joints.len() });
    }
    let mut binds = Vec::with_capacity(matrices.len());
    for (joint, (matrix, &node)) in matrices.iter().zip(&skin.joints).enumerate() {
        if !matrix.iter().all(|x| x.is_finite()) {
            return Err(Fault::NotFinite { accessor, used: INVERSE_BIND.name, element: joint });
        }
        // The last row is 0 0 0 1 by the format, and written with rounding errors by some.
        let m = DMat4::from_cols_array(&matrix.map(f64::from));
        let bind = DAffine3::from_mat4(m);
        if is_flat(&bind.matrix3, SINGULAR) {
            return Err(Fault::Singular { skin: number, joint, node });
        }
        binds.push(bind);
    }
    Ok(Some(binds))
}

/// The nearest joint above each joint, by index.
fn parents(nodes: &Nodes, joints: &[usize], number: &[Option<u16>]) -> Vec<Option<u16>> {
    // The nearest joint at or above each node, parents first.
    let mut nearest: Vec<Option<u16>> = vec![None; nodes.len() + 1];
    for &node in nodes.order() {
        nearest[node] = number[node].or(nearest[nodes.parent(node)]);
    }
    joints.iter().map(|&node| nearest[nodes.parent(node)]).collect()
}

/// Nodes at or above joints that flatten what lies below.
fn warn_of_zero_scales(nodes: &Nodes, joints: &[usize], warnings: &mut Vec<Warning>) {
    let mut visited = vec![false; nodes.len() + 1];
    visited[nodes.top()] = true;
    let mut flat = Vec::new();
    for &joint in joints {
        let mut node = joint;
        while !visited[node] {
            visited[node] = true;
            if is_flat(&nodes.local(node).matrix3, FLAT) {
                flat.push(node);
            }
            node = nodes.parent(node);
        }
    }
    if !flat.is_empty() {
        flat.sort_unstable();
        warnings.push(Warning::ZeroScale { nodes: nodes.named(flat) });
    }
}
