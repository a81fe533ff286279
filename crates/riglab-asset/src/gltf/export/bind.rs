//! A rig put into a document.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use glam::DAffine3;
use riglab_core::{JointId, Provenance, Rig, Spring, Vec3};
use serde_json::{Value, json};

use super::super::accessor::Accessors;
use super::bake::Baker;
use super::draft::{ARRAY, Draft, MAT4, index};
use super::meshes::Meshes;
use super::place::{self, Moved};
use super::remove::{self, Successors};
use super::rows::Rows;
use super::scene::{Leaves, Same, Scene, Surface, Weights};
use super::springs::{self, Joints};
use super::{animations, frames, humanoid, vrm};
use crate::nearest::nearest_others;
use crate::{ExportNote, ExportOptions, Fault, Influences, Reading};

/// How far a vertex may move where weights are written on the joints that are there, as a share of the rig's diagonal: what
/// their maps differ by rounding.
const SMALL: f64 = 1e-6;

/// What is written, and to what.
pub(super) struct Binder<'a, 'd> {
    pub(super) draft: &'a mut Draft,
    pub(super) accessors: &'a Accessors<'d>,
    pub(super) scene: &'a Scene,
    pub(super) options: &'a ExportOptions,
    pub(super) notes: &'a mut Vec<ExportNote>,
}

/// Surfaces by the node that holds them.
pub(super) fn by_node<'s>(surfaces: impl Iterator<Item = &'s Surface>) -> BTreeMap<usize, Vec<&'s Surface>> {
    let mut nodes: BTreeMap<usize, Vec<&Surface>> = BTreeMap::new();
    for surface in surfaces {
        nodes.entry(surface.node).or_default().push(surface);
    }
    nodes
}

impl Binder<'_, '_> {
    /// Writes the weights of the rig on the joints that are there already, with their skins; what fits is left
    /// as it is. False, and nothing done, where they cannot all be told so, or where vertices would be seen to move; of weights
    /// that are those of `before`, as read and mended, where any bit of them would, and no more is lost with the old joints.
    pub(super) fn keep_skeleton(&mut self, same: &Same<'_>, before: &Rig, reading: &Reading) -> Result<bool, Fault> {
        let weights = same.rig.weights();
        let most = self.options.influences.most();
        let changed: Vec<&Surface> = self
            .scene
            .surfaces
            .iter()
            .filter(|s| s.weights != Weights::Fit || s.vertices.clone().any(|v| weights.row(v).len() > most))
            .collect();
        let unseen = SMALL * f64::from(same.rig.bounds().diagonal());
        let fits = |surface: &&Surface| match surface.weights {
            Weights::Fit => surface.skin.is_some(),
            Weights::Mend { shift } | Weights::Change { shift } => shift <= unseen,
            Weights::Foreign => false,
        };
        let moves = |surface: &&Surface| matches!(surface.weights, Weights::Mend { shift } if shift > 0.0);
        let is_other = |surface: &&Surface| matches!(surface.weights, Weights::Change { .. });
        let only_mended = changed.iter().any(moves) && !changed.iter().any(is_other);
        if !changed.iter().all(fits) || only_mended && !self.loses(before) {
            return Ok(false);
        }
        let skins = self.widen_skins(&changed);
        // The slot of each of the rig's joints, by skin.
        let mut slots: HashMap<usize, HashMap<u16, u16>> = HashMap::new();
        for (skin, joints) in skins.iter().enumerate() {
            let slot_of: HashMap<usize, u16> = joints.iter().copied().zip(0..).collect();
            let by_joint = reading.joints.iter().zip(&same.joint_of);
            slots.insert(skin, by_joint.filter_map(|(j, &new)| Some((new, *slot_of.get(&j.node)?))).collect());
        }
        let mut meshes = Meshes::new(self.draft);
        let (mut cut, mut lost) = (0, 0.0f32);
        for (node, surfaces) in by_node(changed.into_iter()) {
            let Some(mesh) = meshes.own(self.draft, node) else { continue };
            for surface in surfaces {
                let skin = surface.skin.unwrap_or(0);
                let rows = self.rows(surface, same.rig, |joint| slots[&skin][&joint]);
                let attributes = rows.write(self.draft, skins[skin].len());
                for &primitive in &surface.primitives {
                    place::set_influences(self.draft, (mesh, primitive), &attributes);
                }
                (cut, lost) = (cut + rows.cut, lost.max(rows.lost));
            }
        }
        self.tell_cut(cut, lost);
        Ok(true)
    }

    /// Whether more than joints would go with the old ones.
    fn loses(&self, before: &Rig) -> bool {
        let draft = &*self.draft;
        let says_of_body = !before.humanoid().is_empty() || !before.springs().is_empty() || vrm::constrained(draft) > 0;
        says_of_body || !draft.list("animations").is_empty() || !self.scene.carried(draft).is_empty()
    }

    /// Gives skins the joints that new weights of their surfaces need, with the matrices that other skins have for them; gives
    /// the joints of all skins, as nodes, by slot.
    fn widen_skins(&mut self, changed: &[&Surface]) -> Vec<Vec<usize>> {
        let mut skins = self.scene.skins.clone();
        let mut lacking: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        for surface in changed.iter().filter(|surface| !surface.lacks.is_empty()) {
            lacking.entry(surface.skin.unwrap_or(0)).or_default().extend(&surface.lacks);
        }
        for (skin, nodes) in lacking {
            let scene = self.scene;
            let of = |&(other, slot): &(usize, usize)| Some(scene.inverse_binds[other].as_ref()?[slot]);
            let matrix = |node: &usize| scene.bound_by.get(node).and_then(of).unwrap_or(DAffine3::IDENTITY);
            let own = scene.inverse_binds[skin].iter().flatten().copied();
            let all: Vec<DAffine3> = own.chain(nodes.iter().map(matrix)).collect();
            skins[skin].extend(&nodes);
            let binds = self.draft.accessor(&frames::matrices(all.into_iter()), MAT4, None);
            let own = &mut self.draft.list_mut("skins")[skin];
            own["joints"] = json!(skins[skin]);
            own["inverseBindMatrices"] = json!(binds);
        }
        skins
    }

    /// Writes the human bones and springs of the rig on the joints that are there, where they are not those
    /// that were read. Of a rig without any those that are there stay.
    pub(super) fn change_body(&mut self, same: &Same<'_>, before: &Rig) {
        let (rig, skeleton) = (same.rig, same.rig.skeleton());
        let has = [!rig.humanoid().is_empty(), !rig.springs().is_empty()];
        let changed = [rig.humanoid() != before.humanoid(), rig.springs() != before.springs()];
        let [humanoid, springs] = [0, 1].map(|part| has[part] && changed[part]);
        if !humanoid && !springs {
            return;
        }
        // A root that was put above several is in no file.
        let Some(nodes) = same.nodes.iter().copied().collect::<Option<Vec<usize>>>() else {
            self.notes.push(ExportNote::BodyLeft);
            return;
        };
        let frames = nodes.iter().map(|&node| self.scene.rests[node]).collect();
        let joints = Joints { skeleton, nodes, frames, scene: Some(self.scene) };
        if humanoid {
            humanoid::set(self.draft, rig.humanoid(), |joint| joints.node(joint), &self.scene.is_joint);
        }
        if springs {
            springs::set(self.draft, rig.springs(), &joints, self.notes);
        }
    }

    /// Puts a skeleton of its own beside the meshes, and binds all of them to it. Old skins and joints go. It stands `off` from
    /// where the rig is, and so do the meshes, whose own places do not matter once they are skinned. Joints of `loose` stand
    /// beside the root. Human bones and springs that the rig lacks are those of `before`, a rig of the same skeleton.
    pub(super) fn new_skeleton(
        &mut self,
        rig: &Rig,
        before: Option<&Rig>,
        reading: &Reading,
        off: Vec3,
        loose: &[JointId],
    ) -> Result<(), Fault> {
        let (draft, scene) = (&mut *self.draft, self.scene);
        let skeleton = rig.skeleton();
        let springs = Some(rig.springs()).filter(|own| !own.is_empty()).or(before.map(Rig::springs));
        let humanoid = Some(rig.humanoid()).filter(|own| !own.is_empty()).or(before.map(Rig::humanoid));
        let turned = frames::of(skeleton, self.options.frames);
        // Springs go from joint to joint: what one may go to hangs there.
        let swings = |spring: &Spring| spring.joints.iter().any(|own| own.joint == JointId(0));
        let loose = if springs.is_some_and(|own| own.springs().iter().any(swings)) { &[] } else { loose };
        let root = frames::add_joints(draft, skeleton, &turned, loose);
        let roots: Vec<usize> = [root].into_iter().chain(loose.iter().map(|joint| root + joint.index())).collect();
        let armature = draft.push("nodes", json!({"name": "Armature", "children": roots}));
        if off != [0.0; 3] {
            draft.list_mut("nodes")[armature]["translation"] = json!(off);
        }
        let holders: Vec<usize> = scene.surfaces.iter().map(|s| s.node).collect();
        let moved = animations::moved_nodes(draft);
        let carrier = place::carrier(scene, &holders, &moved);
        match carrier {
            Some(carrier) => place::hang(draft, &scene.nodes, armature, carrier),
            None => place::add_to_scenes(draft, &scene.nodes, &holders, armature),
        }
        let (nodes, above) = place::idle(scene, &holders, &moved, carrier);
        if nodes + above > 0 && scene.skins.is_empty() {
            self.notes.push(ExportNote::MotionIdle { nodes, above });
        }
        let binds = draft.accessor(&frames::inverse_binds(&turned), MAT4, None);
        let joints: Vec<usize> = (root..root + skeleton.len()).collect();
        let skin = draft.push("skins", json!({"joints": joints, "inverseBindMatrices": binds}));

        let mut meshes = Meshes::new(self.draft);
        let mut moved = Moved::new();
        let (mut cut, mut lost, mut mirrored) = (0, 0.0f32, 0);
        for (node, surfaces) in by_node(scene.surfaces.iter()) {
            let Some(mesh) = meshes.own(self.draft, node) else { continue };
            for surface in &surfaces {
                let placed = &rig.mesh().positions()[surface.vertices.clone()];
                if surface.turned || !place::stands(surface, placed, |p| p) {
                    let mut baker = Baker::new(self.accessors, surface.map);
                    let turn = place::bake(self.draft, self.accessors, &mut baker, mesh, surface, placed)?;
                    mirrored += usize::from(turn);
                }
                let rows = self.rows(surface, rig, |joint| joint);
                let attributes = rows.write(self.draft, skeleton.len());
                for &primitive in &surface.primitives {
                    place::set_influences(self.draft, (mesh, primitive), &attributes);
                }
                (cut, lost) = (cut + rows.cut, lost.max(rows.lost));
            }
            let first = surfaces[0];
            let as_stored = place::stands(first, &rig.mesh().positions()[first.vertices.clone()], |p| p);
            let map = if as_stored { DAffine3::IDENTITY } else { first.map };
            let vertices: Vec<usize> = surfaces.iter().flat_map(|s| s.vertices.clone()).collect();
            let known = surfaces.iter().flat_map(|s| &s.primitives).copied().collect();
            self.others(rig, mesh, &known, map, &vertices)?;
            self.bind(node, skin, &mut moved);
        }
        let all: Vec<usize> = (0..rig.mesh().positions().len()).collect();
        for bound in &scene.bound {
            let Some(mesh) = meshes.own(self.draft, bound.node) else { continue };
            self.others(rig, mesh, &BTreeSet::new(), bound.map, &all)?;
            self.bind(bound.node, skin, &mut moved);
        }
        self.tell_cut(cut, lost);
        if mirrored > 0 {
            self.notes.push(ExportNote::TrianglesTurned { surfaces: mirrored });
        }
        let names: HashMap<&str, usize> = skeleton.names().iter().map(String::as_str).zip(root..).collect();
        let new = reading.joints.iter().filter_map(|j| Some((j.node, *names.get(j.name.as_str())?)));
        let successors = Successors { joints: new.collect(), meshes: moved };
        let joints = Joints { skeleton, nodes: joints, frames: turned, scene: None };
        vrm::turn_offsets(self.draft, scene, &joints, &successors.joints);
        // A VRM's own words stay where they are of the same joints, to which they are led.
        let told = before.is_some_and(|before| humanoid == Some(before.humanoid())) && humanoid::is_vrm(self.draft);
        if let Some(humanoid) = humanoid.filter(|_| !told) {
            humanoid::set(self.draft, humanoid, |joint| joints.node(joint), &scene.is_joint);
        }
        let before_springs = self.notes.len();
        if let Some(springs) = springs {
            springs::set(self.draft, springs, &joints, self.notes);
        }
        let hung = scene.carried(self.draft);
        let lost = remove::old_rig(self.draft, scene, &successors, self.notes);
        let lacking = humanoid::lacking_of_vrm(self.draft);
        if !lacking.is_empty() {
            self.notes.insert(before_springs, ExportNote::NotHuman { lacking });
        }
        remove::tell_hung(&hung, &lost, self.notes);
        Ok(())
    }

    /// The rows of all stored vertices of a surface. Those no triangle uses hang on the first joint.
    fn rows(&self, surface: &Surface, rig: &Rig, slot: impl Fn(u16) -> u16) -> Rows {
        let mut rows = Rows::new(self.options.influences);
        let mut used = surface.numbers.iter().zip(surface.vertices.clone()).peekable();
        for stored in 0..surface.stored.len() as u32 {
            rows.push(match used.next_if(|(number, _)| **number == stored) {
                Some((_, v)) => rig.weights().row(v).map(|(joint, weight)| (slot(joint.0), weight)).collect(),
                None => vec![(0, 1.0)],
            });
        }
        rows
    }

    /// Gives the node of a mesh the new skin.
    fn bind(&mut self, node: usize, skin: usize, moved: &mut Moved) {
        self.draft.list_mut("nodes")[node]["skin"] = json!(skin);
        match self.scene.leaves(node) {
            Leaves::Nothing => {}
            Leaves::OwnTransform => place::in_place(self.draft, &self.scene.nodes, node, moved),
            Leaves::ForTop => place::to_top(self.draft, &self.scene.nodes, node, moved),
        }
    }

    /// Lines, points and empty primitives of a mesh that is bound now, all but those `known`: each of their vertices, which
    /// `map` takes into the scene, goes with the nearest of some `vertices` of the rig.
    fn others(
        &mut self,
        rig: &Rig,
        mesh: usize,
        known: &BTreeSet<usize>,
        map: DAffine3,
        vertices: &[usize],
    ) -> Result<(), Fault> {
        let primitives = self.draft.list("meshes")[mesh]["primitives"].as_array().map_or(0, Vec::len);
        let mut baker = Baker::new(self.accessors, map);
        for primitive in (0..primitives).filter(|p| !known.contains(p)) {
            let position = &self.draft.list("meshes")[mesh]["primitives"][primitive]["attributes"]["POSITION"];
            let Some(position) = index(position) else { continue };
            self.accessors.check(position, || format!("mesh {mesh}, primitive {primitive}"))?;
            let own: Vec<[f32; 3]> = self
                .accessors
                .positions(position)?
                .iter()
                .map(|p| map.transform_point3(glam::Vec3::from(*p).as_dvec3()).as_vec3().to_array())
                .collect();
            if map != DAffine3::IDENTITY {
                baker.primitive(self.draft, (mesh, primitive), None)?;
            }
            let mut all: Vec<[f32; 3]> = vertices.iter().map(|&v| rig.mesh().positions()[v]).collect();
            let start = all.len() as u32;
            all.extend(own);
            let lacking: Vec<u32> = (start..all.len() as u32).collect();
            let mut rows = Rows::new(self.options.influences);
            for nearest in nearest_others(&all, &lacking) {
                let row = nearest.map(|n| rig.weights().row(vertices[n as usize]).map(|(j, w)| (j.0, w)).collect());
                rows.push(row.unwrap_or_else(|| vec![(0, 1.0)]));
            }
            let attributes = rows.write(self.draft, rig.skeleton().len());
            place::set_influences(self.draft, (mesh, primitive), &attributes);
        }
        Ok(())
    }

    fn tell_cut(&mut self, vertices: usize, lost: f32) {
        if vertices > 0 {
            let most = self.options.influences.most();
            self.notes.push(ExportNote::InfluencesCut { vertices, most, lost });
        }
    }
}

/// A document of a rig alone: one mesh with normals and a plain material, one skin.
pub(super) fn alone(
    rig: &Rig,
    name: &str,
    header: Value,
    from: &Provenance,
    options: &ExportOptions,
    notes: &mut Vec<ExportNote>,
) -> Draft {
    let mut draft = Draft::new(json!({"asset": header, "scene": 0}));
    let (mesh, skeleton) = (rig.mesh(), rig.skeleton());
    let positions = draft.vectors(mesh.positions(), true, Some(ARRAY));
    let normals = draft.vectors(&mesh.vertex_normals(), false, Some(ARRAY));
    let mut attributes = json!({"POSITION": positions, "NORMAL": normals});
    let rows = Rows::of(rig.weights(), options.influences);
    for (name, accessor) in rows.write(&mut draft, skeleton.len()) {
        attributes[name] = accessor;
    }
    if rows.cut > 0 {
        let most = options.influences.most();
        notes.push(ExportNote::InfluencesCut { vertices: rows.cut, most, lost: rows.lost });
    }
    // What collapsed triangles alone used is told by such a triangle, so that no vertex changes its number.
    let mut lone = vec![true; mesh.positions().len()];
    mesh.triangles().iter().flatten().for_each(|v| lone[*v as usize] = false);
    let lone = (0u32..).zip(&lone).filter(|(_, lone)| **lone).map(|(v, _)| [v; 3]);
    let mut corners = Vec::with_capacity(12 * mesh.triangles().len());
    for triangle in mesh.triangles().iter().copied().chain(lone) {
        triangle.iter().for_each(|v| corners.extend_from_slice(&v.to_le_bytes()));
    }
    let layout = super::draft::Layout { component: super::draft::U32, shape: "SCALAR", size: 4 };
    let indices = draft.accessor(&corners, layout, Some(super::draft::ELEMENTS));
    let turned = frames::of(skeleton, options.frames);
    let binds = draft.accessor(&frames::inverse_binds(&turned), MAT4, None);
    let root = frames::add_joints(&mut draft, skeleton, &turned, &[]);
    let body = draft.push("nodes", json!({"name": name, "mesh": 0, "skin": 0}));
    draft.json["scenes"] = json!([{"nodes": [root, body]}]);
    let joints: Vec<usize> = (root..root + skeleton.len()).collect();
    draft.json["skins"] = json!([{"joints": joints, "inverseBindMatrices": binds, "skeleton": root}]);
    let primitive = json!({"attributes": attributes, "indices": indices, "material": 0});
    draft.json["meshes"] = json!([{"name": name, "primitives": [primitive]}]);
    let look = json!({"baseColorFactor": [0.8, 0.8, 0.8, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8});
    draft.json["materials"] = json!([{"name": "default", "pbrMetallicRoughness": look}]);
    let joints = Joints { skeleton, nodes: joints, frames: turned, scene: None };
    humanoid::set_alone(&mut draft, name, rig, from, |joint| joints.node(joint), notes);
    springs::set(&mut draft, rig.springs(), &joints, notes);
    draft
}

impl Influences {
    /// How many a vertex may have.
    pub fn most(self) -> usize {
        match self {
            Self::Four => 4,
            Self::Eight => 8,
            Self::All => usize::MAX,
        }
    }
}
