//! A document without its rig.

use std::borrow::Cow;

use glam::DAffine3;

use super::super::accessor::Accessors;
use super::bake::Baker;
use super::bind::by_node;
use super::draft::{Draft, remove};
use super::meshes::Meshes;
use super::place::{self, Moved};
use super::remove::{self, Successors};
use super::scene::{Scene, Surface};
use super::vrm;
use crate::maps::is_mirrored;
use crate::{ExportNote, Fault, Reading};

/// Where the vertices of each set of a reading are shown.
fn shown(reading: &Reading) -> Vec<Cow<'_, [[f32; 3]]>> {
    let by = reading.shown_off;
    let sets = reading.vertex_sets.iter().map(|set| &set.positions[..]);
    if by == [0.0; 3] {
        return sets.map(Cow::from).collect();
    }
    let moved = |p: &[f32; 3]| std::array::from_fn(|k| (p[k] + by[k]).clamp(f32::MIN, f32::MAX));
    sets.map(|positions| positions.iter().map(moved).collect()).collect()
}

/// Takes the rig out; what it moved stays as the rest pose shows it, and where the file does. The maps of `scene` lead there.
pub(super) fn strip(
    draft: &mut Draft,
    accessors: &Accessors<'_>,
    scene: &Scene,
    reading: &Reading,
    notes: &mut Vec<ExportNote>,
) -> Result<(), Fault> {
    let mut meshes = Meshes::new(draft);
    let mut moved = Moved::new();
    let mut turned = 0;
    let placed = shown(reading);
    let at = |surface: &Surface| &placed[surface.set][..];
    for (node, surfaces) in by_node(scene.surfaces.iter()) {
        let global = *scene.nodes.global(node);
        let by_node = |p: [f32; 3]| global.transform_point3(glam::Vec3::from(p).as_dvec3()).as_vec3().to_array();
        // Without its skin, a mesh would be mirrored by the node that it stays on.
        let freed = is_mirrored(&global) && surfaces.iter().any(|s| s.skin.is_some());
        let stays = !freed && !scene.below_joint(node);
        if stays && surfaces.iter().all(|s| place::stands(s, at(s), by_node)) {
            continue;
        }
        let Some(mesh) = meshes.own(draft, node) else { continue };
        for surface in &surfaces {
            if surface.turned || !place::stands(surface, at(surface), |p| p) {
                let mut baker = Baker::new(accessors, surface.map);
                turned += usize::from(place::bake(draft, accessors, &mut baker, mesh, surface, at(surface))?);
            }
        }
        let first = surfaces[0];
        if !place::stands(first, at(first), |p| p) {
            let primitives = draft.list("meshes")[mesh]["primitives"].as_array().map_or(0, Vec::len);
            let mut baker = Baker::new(accessors, first.map);
            for primitive in (0..primitives).filter(|p| !surfaces.iter().any(|s| s.primitives.contains(p))) {
                baker.primitive(draft, (mesh, primitive), None)?;
            }
        }
        place::to_top(draft, &scene.nodes, node, &mut moved);
    }
    for bound in &scene.bound {
        if bound.map == *scene.nodes.global(bound.node) && !scene.below_joint(bound.node) {
            continue;
        }
        let Some(mesh) = meshes.own(draft, bound.node) else { continue };
        if bound.map != DAffine3::IDENTITY {
            let primitives = draft.list("meshes")[mesh]["primitives"].as_array().map_or(0, Vec::len);
            let mut baker = Baker::new(accessors, bound.map);
            (0..primitives).try_for_each(|primitive| baker.primitive(draft, (mesh, primitive), None))?;
        }
        place::to_top(draft, &scene.nodes, bound.node, &mut moved);
    }
    if turned > 0 {
        notes.push(ExportNote::TrianglesTurned { surfaces: turned });
    }
    for node in draft.list_mut("nodes") {
        remove(node, "skin");
    }
    remove::influences(draft);
    let parts = vrm::strip(draft);
    if !parts.is_empty() {
        notes.push(ExportNote::VrmDropped { parts });
    }
    let successors = Successors { meshes: moved, ..Successors::default() };
    let hung = scene.carried(draft);
    let lost = remove::old_rig(draft, scene, &successors, notes);
    remove::tell_hung(&hung, &lost, notes);
    Ok(())
}
