//! What of a document a rig is about: the primitives its vertices come from, and the joints.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ops::Range;
use std::rc::Rc;

use glam::{DAffine3, DVec3};
use riglab_core::{Rig, SkinWeights};

use super::super::accessor::Accessors;
use super::super::bind::Binds;
use super::super::influences;
use super::super::nodes::Nodes;
use super::super::placing;
use super::super::primitives::{self, SourceSet};
use super::super::skins::Skins;
use super::draft::Draft;
use super::{Source, rows};
use crate::assemble::ordered_sets;
use crate::influences::Repairs;
use crate::maps::is_mirrored;
use crate::{Fault, Reading, Warning};

/// How far from 1 a sum of rounded weights may be.
const EXACT: f64 = 1e-7;

/// Vertices of a rig and where they are in the document.
pub(super) struct Surface {
    pub(super) node: usize,
    /// Numbers of the primitives that draw from them.
    pub(super) primitives: Vec<usize>,
    pub(super) skin: Option<usize>,
    /// All positions as stored, used or not.
    pub(super) stored: Rc<[[f32; 3]]>,
    /// Which of them the rig has, rising.
    pub(super) numbers: Vec<u32>,
    /// Which set of the reading they are.
    pub(super) set: usize,
    /// Which vertices of the rig they are.
    pub(super) vertices: Range<usize>,
    /// From the mesh to the scene.
    pub(super) map: DAffine3,
    /// Whether its triangles face where they do because its node mirrors it, which no skin takes the place of.
    pub(super) turned: bool,
    /// What weights of a rig on the file's own joints mean for it.
    pub(super) weights: Weights,
    /// The joints, as nodes, that its skin has to take in for these weights.
    pub(super) lacks: BTreeSet<usize>,
}

/// What comes of writing a rig's weights on the joints and skin that are there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Weights {
    /// The file has them already.
    Fit,
    /// They are the file's, but for what was repaired as they were read. They can be written, as others can.
    Mend { shift: f64 },
    /// They can be written. Where the maps of joints differ a little, vertices move: at most so far.
    Change { shift: f64 },
    /// They cannot: a joint is not of the skin and cannot be, or there is no skin.
    Foreign,
}

/// What a node leaves when its mesh takes a skin.
pub(super) enum Leaves {
    Nothing,
    /// What moves it, which moves no skinned mesh.
    OwnTransform,
    /// All nodes above it.
    ForTop,
}

/// A node with a skin whose mesh has no surface, but lines or points that the skin moves.
pub(super) struct Bound {
    pub(super) node: usize,
    /// From the mesh to the scene.
    pub(super) map: DAffine3,
}

/// A document, looked at as the importer does.
pub(super) struct Scene {
    pub(super) nodes: Nodes,
    /// From each node to the scene at rest.
    pub(super) rests: Vec<DAffine3>,
    /// By node.
    pub(super) is_joint: Vec<bool>,
    /// The joints of each skin, as nodes, by slot.
    pub(super) skins: Vec<Vec<usize>>,
    /// The inverse bind matrices of each skin, by slot, where it has any. These and the next are asked of a rig on the file's own
    /// joints alone, and else empty.
    pub(super) inverse_binds: Vec<Option<Vec<DAffine3>>>,
    /// Which skin and slot says last where a joint, as a node, was bound.
    pub(super) bound_by: HashMap<usize, (usize, usize)>,
    /// In the order of the rig's vertices.
    pub(super) surfaces: Vec<Surface>,
    /// Those that the skeletons of the reading move, nodes rising.
    pub(super) bound: Vec<Bound>,
}

/// A rig on the joints of the reading.
pub(super) struct Same<'a> {
    pub(super) rig: &'a Rig,
    /// The rig's joint of each of the reading's.
    pub(super) joint_of: Vec<u16>,
    /// The same by node. Joints of characters that were not read are in none.
    by_node: HashMap<usize, u16>,
    /// The node of each of the rig's joints; none of a root that was put above several.
    pub(super) nodes: Vec<Option<usize>>,
}

impl<'a> Same<'a> {
    /// Joints have the same names in both.
    pub(super) fn new(rig: &'a Rig, reading: &Reading) -> Option<Self> {
        let names: HashMap<&str, u16> = rig.skeleton().names().iter().map(String::as_str).zip(0..).collect();
        let joint_of = reading.joints.iter().map(|joint| names.get(joint.name.as_str()).copied());
        let joint_of: Vec<u16> = joint_of.collect::<Option<_>>()?;
        let by_node: HashMap<usize, u16> =
            reading.joints.iter().map(|joint| joint.node).zip(joint_of.iter().copied()).collect();
        let mut nodes = vec![None; rig.skeleton().len()];
        by_node.iter().for_each(|(&node, &joint)| nodes[usize::from(joint)] = Some(node));
        Some(Self { rig, joint_of, by_node, nodes })
    }
}

impl Scene {
    /// Looks at a document whose reading is known. `None` where the document is not what was read.
    pub(super) fn new(
        source: &Source<'_, '_>,
        reading: &Reading,
        same: Option<&Same<'_>>,
    ) -> Result<Option<Self>, Fault> {
        let Source { document, accessors, rounded } = *source;
        // What is to be said of the file was said when it was read.
        let mut warnings = Vec::new();
        let nodes = Nodes::new(document)?;
        let skins = Skins::read(document, &nodes, accessors, &mut warnings)?;
        let sources = primitives::collect(document, accessors, &mut warnings)?;
        let binds = Binds::new(&nodes, &skins, &sources, accessors, &mut warnings);
        let scene = placing::Scene { accessors, nodes: &nodes, skins: &skins, binds: &binds };
        let bound_by = same.map(|_| bound_by(&skins)).unwrap_or_default();
        let bends = reading.warnings.iter().any(|warning| matches!(warning, Warning::Bent { .. }));
        let wider = Wider { nodes: &nodes, skins: &skins, binds: &binds, bound_by: &bound_by, bends };

        let source_of: HashMap<(usize, usize), usize> =
            sources.parts.iter().map(|part| ((part.node, part.primitive), part.vertex_set)).collect();
        let mut primitives_of: Vec<Vec<(usize, usize)>> = vec![Vec::new(); reading.vertex_sets.len()];
        for part in &reading.parts {
            primitives_of[part.vertex_set].push((part.node, part.primitive));
        }
        let mut surfaces = Vec::new();
        let mut start = 0;
        for (number, set) in ordered_sets(reading) {
            let vertices = start..start + set.positions.len();
            start = vertices.end;
            let own = &primitives_of[number];
            let Some(source) = own.first().and_then(|at| source_of.get(at)).map(|&s| &sources.sets[s]) else {
                return Ok(None);
            };
            let Some(map) = scene.map(source).filter(|_| source.numbers == set.numbers) else { return Ok(None) };
            let mut lacks = BTreeSet::new();
            let weights = match (same, source.skin) {
                (Some(same), Some(skin)) => {
                    let mut rows = Stored {
                        source,
                        skin,
                        wider: &wider,
                        placed: &set.positions,
                        unweighted: &set.unweighted,
                        lacks: &mut lacks,
                    };
                    rows.compare(accessors, rounded, same, vertices.clone())?
                }
                // A rigid part hangs on its joint and nothing else.
                (Some(same), None)
                    if set.weights.as_ref().is_some_and(|w| {
                        equal(w, |joint| same.joint_of[usize::from(joint)], same.rig, vertices.clone(), &[])
                    }) =>
                {
                    Weights::Fit
                }
                _ => Weights::Foreign,
            };
            surfaces.push(Surface {
                node: source.place.node,
                primitives: own.iter().map(|&(_, primitive)| primitive).collect(),
                skin: source.skin,
                stored: Rc::clone(&source.positions),
                numbers: source.numbers.clone(),
                set: number,
                vertices,
                map,
                turned: match source.skin {
                    Some(skin) => is_mirrored(nodes.global(source.place.node)) ^ binds.mirrors(skin),
                    None => is_mirrored(&map),
                },
                weights,
                lacks,
            });
        }
        let own: HashSet<usize> = reading.joints.iter().map(|joint| joint.node).collect();
        let bound = sources.bound.iter().filter_map(|&(node, skin)| {
            let moved = skins.get(skin)?.joints.iter().any(|joint| own.contains(joint));
            Some(Bound { node, map: *binds.maps(skin).first().filter(|_| moved)? })
        });
        let bound = bound.collect();
        let is_joint = (0..nodes.len()).map(|node| skins.joint_of_node(node).is_some()).collect();
        let rests = binds.rests(&nodes);
        let inverse_binds = skins.iter().filter(|_| same.is_some()).map(|skin| skin.inverse_binds.clone()).collect();
        let skins = skins.iter().map(|skin| skin.joints.clone()).collect();
        Ok(Some(Self { nodes, rests, is_joint, skins, inverse_binds, bound_by, surfaces, bound }))
    }

    /// What becomes of the node of a mesh that takes a skin: what a joint carries goes with the joint, and what mirrors a node
    /// turns its triangles, skinned or not. A node that alone mirrors itself need not leave those above it.
    pub(super) fn leaves(&self, node: usize) -> Leaves {
        if self.below_joint(node) || is_mirrored(self.nodes.global(self.nodes.parent(node))) {
            Leaves::ForTop
        } else if is_mirrored(self.nodes.global(node)) {
            Leaves::OwnTransform
        } else {
            Leaves::Nothing
        }
    }

    /// The nodes that hang on joints and are neither joints themselves nor meshes that are rigged: sockets, what colliders are
    /// of, eyes. What exporters put where bones end is nothing.
    pub(super) fn carried(&self, draft: &Draft) -> Vec<usize> {
        let rigged: HashSet<usize> = self.surfaces.iter().map(|s| s.node).collect();
        let name = |node: usize| draft.list("nodes").get(node).and_then(|own| own.get("name")?.as_str());
        let is_end = |node: usize| name(node).is_some_and(|name| name.ends_with("_end"));
        // Those above come first, so that no way up is gone twice.
        let mut below = vec![false; self.nodes.len() + 1];
        let mut carried = Vec::new();
        for &node in self.nodes.order() {
            let hangs = below[self.nodes.parent(node)];
            below[node] = hangs || self.is_joint[node];
            if hangs && !self.is_joint[node] && !rigged.contains(&node) && !is_end(node) {
                carried.push(node);
            }
        }
        carried
    }

    /// Whether a node is, or hangs below, a joint.
    pub(super) fn below_joint(&self, mut node: usize) -> bool {
        while node != self.nodes.top() {
            if self.is_joint[node] {
                return true;
            }
            node = self.nodes.parent(node);
        }
        false
    }
}

/// Which skin and slot, of those that have inverse bind matrices, is the last with each joint: what the importer goes by.
fn bound_by(skins: &Skins) -> HashMap<usize, (usize, usize)> {
    let known = skins.iter().enumerate().filter(|(_, skin)| skin.inverse_binds.is_some());
    known.flat_map(|(s, skin)| skin.joints.iter().enumerate().map(move |(slot, &node)| (node, (s, slot)))).collect()
}

/// What skins may take in: joints of others, as these have them.
struct Wider<'a> {
    nodes: &'a Nodes,
    skins: &'a Skins,
    binds: &'a Binds,
    bound_by: &'a HashMap<usize, (usize, usize)>,
    /// Whether the rest pose of a skin would bend its mesh, so that nothing is sure of any.
    bends: bool,
}

impl Wider<'_> {
    /// From the mesh of a skin to the scene, by a joint that another skin has and this one is to take in with the matrix that is
    /// there; `None` where it cannot, or the file might be read otherwise with it.
    fn map(&self, skin: usize, node: usize) -> Option<DAffine3> {
        let (other, slot) = *self.bound_by.get(&node).filter(|_| !self.bends)?;
        let own = self.skins.get(skin).filter(|own| own.inverse_binds.is_some())?;
        let below = |root: usize| node == root || self.nodes.is_below(node, root);
        if !own.skeleton.is_none_or(below) {
            return None;
        }
        // What lies between its joints and the node that they have in common is read as bones.
        let before = self.nodes.common(own.joints.iter().copied().chain(own.skeleton));
        let mut above = self.nodes.common([before, node].into_iter());
        if own.joints.contains(&above) || above == node {
            above = self.nodes.parent(above);
        }
        let mut ways = [before, node].into_iter();
        ways.all(|from| self.are_bones(from, above)).then(|| self.binds.maps(other)[slot])
    }

    /// Whether all nodes from one up to another, which is left out, are bones.
    fn are_bones(&self, mut node: usize, above: usize) -> bool {
        while node != above && node != self.nodes.top() {
            if !self.binds.is_bone(node) {
                return false;
            }
            node = self.nodes.parent(node);
        }
        true
    }
}

/// A skinned surface as the file has it.
struct Stored<'a> {
    source: &'a SourceSet,
    skin: usize,
    wider: &'a Wider<'a>,
    /// Where the vertices are.
    placed: &'a [[f32; 3]],
    /// Which of them have no weights in the file, rising.
    unweighted: &'a [u32],
    /// See [`Surface::lacks`].
    lacks: &'a mut BTreeSet<usize>,
}

impl Stored<'_> {
    /// The rows of the file against those of the rig.
    fn compare(
        &mut self,
        accessors: &Accessors<'_>,
        rounded: &HashSet<usize>,
        same: &Same<'_>,
        vertices: Range<usize>,
    ) -> Result<Weights, Fault> {
        let skins = self.wider.skins;
        let mut repairs = Repairs::default();
        let rows = influences::read(self.source, self.skin, accessors, skins, &mut repairs)?;
        let mut mended = Vec::new();
        repairs.warn(&mut mended);
        let nodes = skins.get(self.skin).map_or(&[][..], |skin| &skin.joints);
        // The rig's joint of each slot.
        let joints: Vec<Option<u16>> = nodes.iter().map(|node| same.by_node.get(node).copied()).collect();
        let all = (0..self.source.numbers.len()).map(|row| rows.row(row));
        let is_rounded = self.source.influences().iter().any(|(_, weights)| rounded.contains(weights));
        let off = |row: &[(u16, f64)]| (row.iter().map(|(_, w)| w).sum::<f64>() - 1.0).abs() > EXACT;
        if mended.is_empty() && is_rounded && all.clone().any(off) {
            mended.push(Warning::NotNormalised { vertices: 0, sums: (1.0, 1.0) });
        }
        if all.clone().flatten().any(|&(slot, _)| joints[usize::from(slot)].is_none()) {
            return Ok(Weights::Foreign);
        }
        let joint = |slot: u16| joints[usize::from(slot)].unwrap_or_default();
        let by_joint = all.map(|row| row.iter().map(|&(slot, weight)| (joint(slot), weight)));
        let stored = SkinWeights::normalized(by_joint)?;
        let equal_but = |but: &[u32]| equal(&stored, |joint| joint, same.rig, vertices.clone(), but);
        let equal = equal_but(&[]);
        // Vertices without weights in the file have some in any rig.
        let is_own = equal || (!self.unweighted.is_empty() && equal_but(self.unweighted));
        if equal && mended.is_empty() {
            return Ok(Weights::Fit);
        }
        let slots: HashMap<u16, u16> = joints.iter().zip(0..).filter_map(|(j, slot)| Some(((*j)?, slot))).collect();
        Ok(match self.shift(slots, same, vertices.clone()) {
            // Sums other than 1 are mended, unless that would move a vertex.
            Some(shift) if equal && shift > 0.0 && matches!(mended[..], [Warning::NotNormalised { .. }]) => {
                Weights::Fit
            }
            Some(shift) if is_own => Weights::Mend { shift },
            Some(shift) => Weights::Change { shift },
            None => Weights::Foreign,
        })
    }

    /// How far vertices move at most when the rig's weights are written; `None` where a joint is not of the
    /// skin and cannot be. `slots` are those of the rig's joints; joints that the skin is to take in get the next ones.
    fn shift(&mut self, mut slots: HashMap<u16, u16>, same: &Same<'_>, vertices: Range<usize>) -> Option<f64> {
        let mut maps = self.wider.binds.maps(self.skin).to_vec();
        let mut most: f64 = 0.0;
        let mut row: Vec<(u16, f32)> = Vec::new();
        for (vertex, (&number, placed)) in vertices.zip(self.source.numbers.iter().zip(self.placed)) {
            row.clear();
            for (joint, weight) in same.rig.weights().row(vertex) {
                let slot = match slots.get(&joint.0) {
                    Some(slot) => *slot,
                    None => {
                        let node = same.nodes[joint.index()]?;
                        maps.push(self.wider.map(self.skin, node)?);
                        self.lacks.insert(node);
                        let slot = u16::try_from(maps.len() - 1).ok()?;
                        slots.insert(joint.0, slot);
                        slot
                    }
                };
                row.push((slot, weight));
            }
            rows::normalise(&mut row);
            let p = glam::Vec3::from(self.source.positions[number as usize]).as_dvec3();
            let total: f64 = row.iter().map(|(_, w)| f64::from(*w)).sum();
            let sum = row
                .iter()
                .fold(DVec3::ZERO, |sum, &(slot, w)| sum + maps[usize::from(slot)].transform_point3(p) * f64::from(w));
            let at = (sum / total).as_vec3();
            if at.to_array().map(f32::to_bits) != placed.map(f32::to_bits) {
                most = most.max((at - glam::Vec3::from(*placed)).as_dvec3().length()).max(f64::MIN_POSITIVE);
            }
        }
        Some(most)
    }
}

/// Whether weights, by joints that `joint` takes to those of the rig, are those of some vertices of the rig.
/// `but` are those, rising, that may be others.
fn equal(weights: &SkinWeights, joint: impl Fn(u16) -> u16, rig: &Rig, vertices: Range<usize>, but: &[u32]) -> bool {
    let mut row: Vec<(u16, f32)> = Vec::new();
    weights.rows() == vertices.len()
        && vertices.enumerate().all(|(v, vertex)| {
            row.clear();
            row.extend(weights.row(v).map(|(own, weight)| (joint(own.0), weight)));
            row.sort_unstable_by_key(|(joint, _)| *joint);
            rig.weights().row(vertex).map(|(joint, weight)| (joint.0, weight)).eq(row.iter().copied())
                || but.binary_search(&(v as u32)).is_ok()
        })
}
