//! Vertices at rest, in the scene.

use std::collections::HashMap;

use glam::{DAffine3, DVec3, Vec3};
use riglab_core::SkinWeights;

use super::accessor::{Accessors, POSITION};
use super::bind::Binds;
use super::influences;
use super::nodes::Nodes;
use super::primitives::{SourceSet, Sources};
use super::skins::Skins;
use crate::influences::Repairs;
use crate::maps::{FLAT, is_flat, is_mirrored};
use crate::reading::LeftOut;
use crate::{Binding, Fault, Part, ReadJoint, VertexSet, Warning};

/// All that is needed to place vertices.
pub(super) struct Scene<'a, 'd> {
    pub(super) accessors: &'a Accessors<'d>,
    pub(super) nodes: &'a Nodes,
    pub(super) skins: &'a Skins,
    pub(super) binds: &'a Binds,
}

/// How an unskinned mesh goes into the scene.
enum Hold {
    /// With a joint of the reading.
    Joint(u16, DAffine3),
    /// By its node; there is no skeleton.
    Free(DAffine3),
    /// Not at all: on no joint, or flattened.
    None,
}

/// Nodes whose meshes are no part of what is seen of a model that has no skeleton, each list rising.
#[derive(Default)]
pub(super) struct Apart {
    pub(super) colliders: Vec<usize>,
    pub(super) unseen: Vec<usize>,
}

impl Scene<'_, '_> {
    /// Places what hangs on the skeleton, or everything but what stands `apart` where there is none. The triangles of
    /// meshes that their nodes mirror are turned round, so that they face outwards as the format says (3.7.4 of glTF 2.0):
    /// of skinned ones too, whose nodes move nothing else; and so are those that rest mirrors. What is not of the rig is
    /// given by its nodes.
    pub(super) fn place(
        &self,
        sources: Sources,
        joints: &[ReadJoint],
        apart: &Apart,
        warnings: &mut Vec<Warning>,
    ) -> Result<(Vec<VertexSet>, Vec<Part>, LeftOut), Fault> {
        let Sources { sets: sources, parts: stored, without_surface, bare, .. } = sources;
        let mut sets = Vec::with_capacity(sources.len());
        // The new number of each set that stays.
        let mut kept: HashMap<usize, usize> = HashMap::new();
        let mut repairs = Repairs::default();
        let (mut rigid, mut left_out) = (Vec::new(), Vec::new());
        let (mut bumped, mut unseen) = (Vec::new(), Vec::new());
        let mut mirrored = Vec::with_capacity(sources.len());
        for (number, source) in sources.into_iter().enumerate() {
            let node = source.place.node;
            if source.numbers.is_empty() {
                continue;
            }
            // A number and a position, and a slot and a weight for each influence. All sets together were asked for before.
            let size = 16 + 4 * 16 * source.influences().len();
            self.accessors.budget().piece(source.numbers.len(), size)?;
            let (set, turned) = match source.skin {
                Some(skin) => {
                    let set = self.skinned(source, skin)?;
                    repairs.add(&set.repairs);
                    (set, is_mirrored(self.nodes.global(node)) ^ self.binds.mirrors(skin))
                }
                None => match self.hold(node) {
                    Hold::Joint(joint, map) => {
                        rigid.push((node, joint));
                        let rows = source.numbers.iter().map(|_| [(joint, 1.0)]);
                        let weights = Some(SkinWeights::normalized(rows)?);
                        (self.unskinned(source, &map, weights, Binding::Rigid)?, is_mirrored(&map))
                    }
                    Hold::Free(_) if apart.unseen.binary_search(&node).is_ok() => {
                        unseen.push(node);
                        continue;
                    }
                    Hold::Free(_) if apart.colliders.binary_search(&node).is_ok() => {
                        bumped.push(node);
                        continue;
                    }
                    Hold::Free(map) => (self.unskinned(source, &map, None, Binding::Free)?, is_mirrored(&map)),
                    Hold::None => {
                        left_out.push(node);
                        continue;
                    }
                },
            };
            kept.insert(number, sets.len());
            mirrored.push(turned);
            sets.push(set);
        }
        let mut parts: Vec<Part> = Vec::with_capacity(stored.len());
        for mut part in stored {
            let Some(&vertex_set) = kept.get(&part.vertex_set) else { continue };
            if mirrored[vertex_set] {
                part.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
            }
            parts.push(Part { vertex_set, ..part });
        }
        repairs.warn(warnings);
        if without_surface > 0 {
            let moves = |node: &usize| matches!(self.hold(*node), Hold::Joint(..));
            let still = self.nodes.named(bare.into_iter().filter(|node| !moves(node)));
            warnings.push(Warning::NoSurface { primitives: without_surface, still });
        }
        rigid.dedup();
        left_out.dedup();
        bumped.dedup();
        unseen.dedup();
        if !rigid.is_empty() {
            let names = rigid.iter().map(|&(_, joint)| joints[usize::from(joint)].name.clone()).collect();
            warnings
                .push(Warning::RigidParts { nodes: self.nodes.named(rigid.iter().map(|&(n, _)| n)), joints: names });
        }
        let told = left_out.iter().map(|&node| (node, self.joint_above(node))).collect();
        if !left_out.is_empty() {
            warnings.push(Warning::LeftOut { nodes: self.nodes.named(left_out) });
        }
        if !bumped.is_empty() {
            warnings.push(Warning::Colliders { nodes: self.nodes.named(bumped) });
        }
        if !unseen.is_empty() {
            warnings.push(Warning::Unseen { nodes: self.nodes.named(unseen) });
        }
        Ok((sets, parts, told))
    }

    fn skinned(&self, source: SourceSet, skin: usize) -> Result<VertexSet, Fault> {
        let mut repairs = Repairs::default();
        let rows = influences::read(&source, skin, self.accessors, self.skins, &mut repairs)?;
        let maps = self.binds.maps(skin);
        let mut positions = Vec::with_capacity(source.numbers.len());
        for (at, &v) in source.numbers.iter().enumerate() {
            let p = point(&source, v)?;
            let row = rows.row(at);
            let total: f64 = row.iter().map(|(_, w)| w).sum();
            let sum =
                row.iter().fold(DVec3::ZERO, |sum, &(slot, w)| sum + maps[usize::from(slot)].transform_point3(p) * w);
            positions.push(placed(&source, v, sum / total)?);
        }
        let joints = self.skins.get(skin).map_or(&[][..], |s| &s.numbers);
        let (weights, unweighted) = rows.into_weights(|slot| joints[usize::from(slot)])?;
        Ok(VertexSet {
            numbers: source.numbers,
            positions,
            weights: Some(weights),
            unweighted,
            repairs,
            stored: source.positions.len(),
            binding: Binding::Skinned,
        })
    }

    /// From the space of a set's mesh to the scene, where it hangs on the skeleton or is free. The joints of
    /// a skin may have maps that differ a little: then that of the first.
    pub(super) fn map(&self, source: &SourceSet) -> Option<DAffine3> {
        match (source.skin, self.hold(source.place.node)) {
            (Some(skin), _) => self.binds.maps(skin).first().copied(),
            (None, Hold::Joint(_, map) | Hold::Free(map)) => Some(map),
            (None, Hold::None) => None,
        }
    }

    fn unskinned(
        &self,
        source: SourceSet,
        map: &DAffine3,
        weights: Option<SkinWeights>,
        binding: Binding,
    ) -> Result<VertexSet, Fault> {
        let mut positions = Vec::with_capacity(source.numbers.len());
        for &v in &source.numbers {
            positions.push(placed(&source, v, map.transform_point3(point(&source, v)?))?);
        }
        Ok(VertexSet {
            numbers: source.numbers,
            positions,
            weights,
            unweighted: Vec::new(),
            repairs: Repairs::default(),
            stored: source.positions.len(),
            binding,
        })
    }

    /// The nearest joint at or above a node.
    fn joint_above(&self, node: usize) -> Option<u16> {
        let up = std::iter::successors(Some(node), |&at| Some(self.nodes.parent(at)));
        up.take_while(|&at| at != self.nodes.top()).find_map(|at| self.skins.joint_of_node(at))
    }

    /// Where the mesh of a node belongs: to the nearest joint at or above it.
    ///
    /// It goes with that joint into the bind pose: node transforms count below the joint only.
    fn hold(&self, node: usize) -> Hold {
        let nodes = self.nodes;
        let mut below = DAffine3::IDENTITY;
        let mut at = node;
        while at != nodes.top() {
            if let Some(joint) = self.skins.joint_of_node(at) {
                let map = self.binds.frame(at) * below;
                return if is_flat(&map.matrix3, FLAT) { Hold::None } else { Hold::Joint(joint, map) };
            }
            below = *nodes.local(at) * below;
            at = nodes.parent(at);
        }
        if self.skins.len() == 0 && !is_flat(&below.matrix3, FLAT) { Hold::Free(below) } else { Hold::None }
    }
}

/// A vertex in mesh space.
fn point(source: &SourceSet, vertex: u32) -> Result<DVec3, Fault> {
    let p = Vec3::from(source.positions[vertex as usize]);
    if p.is_finite() {
        return Ok(p.as_dvec3());
    }
    Err(Fault::NotFinite { accessor: source.position_accessor(), used: POSITION.name, element: vertex as usize })
}

/// A vertex in the scene, as far as f32 reaches.
fn placed(source: &SourceSet, vertex: u32, at: DVec3) -> Result<[f32; 3], Fault> {
    let at = at.as_vec3();
    if at.is_finite() { Ok(at.into()) } else { Err(Fault::VertexNotFinite { place: source.place, vertex }) }
}
