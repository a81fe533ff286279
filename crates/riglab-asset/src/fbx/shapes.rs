//! Blend shapes, and their motions.

use std::collections::{HashMap, HashSet};

use glam::{DAffine3, DVec3};
use ufbx::{BlendChannel, Mesh, Scene};

use super::clips::{begin, called, is_of_shape, time_of_shapes};
use crate::Fault;
use crate::budget::Budget;
use crate::gltf::export::model::{Patch, Shape, Swing};

/// Bytes of a vertex or normal that a blend shape moves, as read and as written.
const OFFSET: u64 = 2 * 16;

/// Bytes of a blend shape of a patch, most of them its lines in the document.
const SHAPE: u64 = 1000;

/// Weights of all motions of a file, each as often as its animation has layers: 16 MB, and seconds. Files claim long times in
/// few bytes.
const MAX_WEIGHTS: usize = 1 << 22;

/// The channels of a mesh that [`shapes`] makes a shape of each.
fn channels(mesh: &Mesh) -> impl Iterator<Item = &BlendChannel> {
    let all = (&mesh.blend_deformers).into_iter().flat_map(|deformer| &deformer.channels);
    all.filter(|channel| channel.keyframes.last().is_some())
}

/// How many channels of meshes have shapes on the way to their last, which [`shapes`] leaves out.
pub(super) fn in_between(meshes: &[&Mesh]) -> usize {
    // One mesh on several nodes is told once.
    let mut known = HashSet::new();
    let all = meshes.iter().flat_map(|mesh| channels(mesh));
    all.filter(|channel| channel.keyframes.len() > 1 && known.insert(channel.element.element_id)).count()
}

/// The blend shapes of a mesh, of each channel the last; `controls` are those of the vertices of its patches.
pub(super) fn shapes(
    mesh: &Mesh,
    map: &DAffine3,
    (patches, controls): (&[Patch], &[Vec<u32>]),
    budget: &Budget,
    copies: usize,
) -> Result<Vec<Shape>, Fault> {
    if channels(mesh).next().is_none() {
        return Ok(Vec::new());
    }
    // Where the vertices of each control point are.
    let mut places: HashMap<u32, Vec<(usize, u32)>> = HashMap::new();
    for (patch, controls) in controls.iter().enumerate() {
        for (vertex, control) in (0u32..).zip(controls) {
            places.entry(*control).or_default().push((patch, vertex));
        }
    }
    // What is added to values of control points, by patch and vertex.
    let spread = |values: &[ufbx::Vec3], of: &[u32], turned: &dyn Fn(DVec3, (usize, u32)) -> DVec3| {
        let mut moved: Vec<Vec<(u32, [f32; 3])>> = vec![Vec::new(); controls.len()];
        for (control, by) in of.iter().zip(values) {
            for &(patch, vertex) in places.get(control).map_or(&[][..], Vec::as_slice) {
                let by = turned(DVec3::new(by.x, by.y, by.z), (patch, vertex)).as_vec3();
                if by.is_finite() && by != glam::Vec3::ZERO {
                    moved[patch].push((vertex, by.to_array()));
                }
            }
        }
        for own in &mut moved {
            own.sort_unstable_by_key(|(vertex, _)| *vertex);
            own.dedup_by_key(|(vertex, _)| *vertex);
        }
        moved
    };
    let of_normals = map.matrix3.inverse().transpose();
    // The vertex's own normal was brought to length 1 when it was turned, and this is added to it then.
    let turned_normal = |by: DVec3, (patch, vertex): (usize, u32)| {
        let own = patches[patch].normals.get(vertex as usize).map_or(DVec3::ZERO, |&n| glam::Vec3::from(n).as_dvec3());
        of_normals * by * (map.matrix3.transpose() * own).length()
    };
    let mut shapes = Vec::new();
    for channel in channels(mesh) {
        let Some(last) = channel.keyframes.last() else { continue };
        let of = last.shape.offset_vertices.as_ref();
        let offsets = spread(last.shape.position_offsets.as_ref(), of, &|by, _| map.matrix3 * by);
        let normals = spread(last.shape.normal_offsets.as_ref(), of, &turned_normal);
        let moved: usize = offsets.iter().chain(&normals).map(Vec::len).sum();
        budget.show(OFFSET * moved as u64 + SHAPE * controls.len() as u64, copies)?;
        let weight = channel.weight as f32;
        let weight = if weight.is_finite() { weight } else { 0.0 };
        shapes.push(Shape { name: channel.element.name.to_string(), weight, offsets, normals });
    }
    Ok(shapes)
}

/// The motions of the blend shapes of `meshes`, by their number there, at a steady rate; and how many are longer than is
/// read. Each begins when the same animation does of joints, which are at or below the nodes that are `moving`.
pub(super) fn swings(scene: &Scene, meshes: &[&Mesh], rate: f32, moving: &[bool]) -> (Vec<Swing>, usize) {
    let (mut swings, mut too_long, mut room) = (Vec::new(), 0, MAX_WEIGHTS);
    for (number, stack) in (&scene.anim_stacks).into_iter().enumerate() {
        let Some(time) = time_of_shapes(stack) else { continue };
        let props = (&stack.layers).into_iter().flat_map(|layer| &layer.anim_props).filter(|prop| is_of_shape(prop));
        let told: HashSet<u32> = props.map(|prop| prop.element.element_id).collect();
        let moved = |mesh: &Mesh| channels(mesh).any(|channel| told.contains(&channel.element.element_id));
        let moved: Vec<(usize, &Mesh)> = meshes.iter().copied().enumerate().filter(|(_, mesh)| moved(mesh)).collect();
        if moved.is_empty() {
            continue;
        }
        let begin = begin(stack, moving).unwrap_or(*time.start());
        // The last frame is the last whole one; a thousandth of one for rounding of key times.
        let frames = ((time.end() - begin).max(0.0) * f64::from(rate) + 1e-3).floor() as usize;
        let frames = frames.saturating_add(1);
        let each: usize = moved.iter().map(|(_, mesh)| channels(mesh).count()).sum();
        let each = each.saturating_mul(stack.layers.len().max(1));
        let Some(left) = frames.checked_mul(each).and_then(|weights| room.checked_sub(weights)) else {
            too_long += 1;
            continue;
        };
        room = left;
        let at = |frame: usize| begin + frame as f64 / f64::from(rate);
        let weight = |channel: &BlendChannel, frame: usize| {
            let weight = ufbx::evaluate_blend_weight(&stack.anim, channel, at(frame)) as f32;
            if weight.is_finite() { weight } else { 0.0 }
        };
        let weights = |mesh: &Mesh| {
            (0..frames)
                .flat_map(|frame| channels(mesh).map(move |channel| (channel, frame)))
                .map(|(c, f)| weight(c, f))
                .collect()
        };
        let weights = moved.iter().map(|(object, mesh)| (*object, weights(mesh))).collect();
        swings.push(Swing { name: called(stack, number), rate, frames, weights });
    }
    (swings, too_long)
}
