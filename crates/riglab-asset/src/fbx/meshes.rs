//! Meshes at rest: polygons into triangles, control points into vertices, clusters into rows of weights.

use std::ops::Range;

use glam::{DAffine3, DVec3};
use riglab_core::SkinWeights;
use ufbx::{Face, Mesh};

use super::joints::{Joints, Skin};
use super::scene::{Nodes, affine};
use super::shown;
use crate::budget::{Budget, PART, RIGID_ROW, TRIANGLE, USED, VERTEX, row};
use crate::influences::{Repairs, Rows};
use crate::maps::{FLAT, is_flat};
use crate::reading::LeftOut;
use crate::triangles::{self, Dropped};
use crate::{Binding, Fault, Part, Place, ReadJoint, VertexSet, Warning};

/// Influences on a vertex: as many as most methods take joints. The search for repeated ones grows with the square.
const MAX_INFLUENCES: u32 = 256;

/// Polygons of more corners are cut as fans: cutting them well takes time that grows with the square.
pub(super) const MAX_POLYGON: u32 = 1 << 12;

/// How a mesh hangs on the skeleton.
pub(super) enum Hold<'a> {
    Skin(&'a Skin),
    Joint(u16, DAffine3),
    Free(DAffine3),
    /// On no joint, or flattened.
    None,
}

/// The meshes of all nodes, by node, and the nodes of those that are not of the rig.
pub(super) fn read(
    nodes: &Nodes<'_>,
    joints: &Joints,
    read_joints: &[ReadJoint],
    budget: &Budget,
    warnings: &mut Vec<Warning>,
) -> Result<(Vec<VertexSet>, Vec<Part>, LeftOut), Fault> {
    let (mut sets, mut parts) = (Vec::new(), Vec::new());
    let mut repairs = Repairs::default();
    let mut dropped = Dropped::default();
    let (mut rigid, mut left_out, mut without_surface) = (Vec::new(), Vec::new(), 0);
    let mut told = Vec::new();
    let mut copies = nodes.copies();
    for (number, node) in nodes.all.iter().enumerate() {
        let Some(mesh) = node.mesh.as_deref() else { continue };
        // Any number of nodes may show one mesh: the first asks for all of them, before there are copies.
        let copies = copies.remove(&mesh.element.typed_id).unwrap_or(0);
        let influences = (&mesh.skin_deformers).into_iter().map(|skin| skin.weights.len()).sum();
        budget.piece(mesh.num_triangles.saturating_mul(3), size_of::<u32>())?;
        budget.piece(mesh.num_vertices.min(mesh.num_indices), 16)?;
        budget.piece(influences, 16)?;
        budget.show(PART + mesh.num_triangles as u64 * TRIANGLE, copies)?;
        budget.show(influences as u64 * (row(1) - row(0)), copies)?;
        let mut triangles = triangles_of(mesh)?;
        if triangles.is_empty() {
            without_surface += 1;
            continue;
        }
        let hold = hold(nodes, joints, number, mesh);
        let stored = triangles.len();
        let used = triangles::renumber(&mut triangles, mesh.vertices.len());
        budget.show(used.len() as u64 * (USED + VERTEX + RIGID_ROW), copies)?;
        let now = triangles::keep_proper(&mut triangles, used.len());
        dropped.collapsed += now.collapsed;
        dropped.repeated += now.repeated;
        let mut own_repairs = Repairs::default();
        let (map, weights, unweighted, binding) = match hold {
            Hold::None => {
                left_out.push(number);
                told.push((number, joints.at_or_above(nodes, number)));
                continue;
            }
            Hold::Free(map) => (map, None, Vec::new(), Binding::Free),
            Hold::Joint(joint, map) => {
                rigid.push((number, joint));
                let weights = SkinWeights::normalized(used.iter().map(|_| [(joint, 1.0)]))?;
                (map, Some(weights), Vec::new(), Binding::Rigid)
            }
            Hold::Skin(skin) => {
                let (weights, unweighted) = rows(mesh, skin, &used, &mut own_repairs)?.into_weights(|joint| joint)?;
                (skin.map, Some(weights), unweighted, Binding::Skinned)
            }
        };
        repairs.add(&own_repairs);
        let map = nodes.space * map;
        if map.matrix3.determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let place = Place { node: number, mesh: mesh.element.typed_id as usize, primitive: 0 };
        parts.push(Part {
            node: number,
            primitive: 0,
            vertex_set: sets.len(),
            used: (0..used.len() as u32).collect(),
            triangles,
            stored,
        });
        sets.push(VertexSet {
            positions: used.iter().map(|&v| point(mesh, place, v, &map)).collect::<Result<_, _>>()?,
            numbers: used,
            weights,
            unweighted,
            repairs: own_repairs,
            stored: mesh.vertices.len(),
            binding,
        });
    }
    if without_surface > 0 {
        warnings.push(Warning::NoSurface { primitives: without_surface, still: Vec::new() });
    }
    let Dropped { collapsed, repeated } = dropped;
    if collapsed + repeated > 0 {
        warnings.push(Warning::Degenerate { collapsed, repeated });
    }
    repairs.warn(warnings);
    if !rigid.is_empty() {
        let names = rigid.iter().map(|&(_, joint)| read_joints[usize::from(joint)].name.clone()).collect();
        warnings.push(Warning::RigidParts { nodes: nodes.named(rigid.iter().map(|&(node, _)| node)), joints: names });
    }
    if !left_out.is_empty() {
        warnings.push(Warning::LeftOut { nodes: nodes.named(left_out) });
    }
    Ok((sets, parts, told))
}

pub(super) fn hold<'a>(nodes: &Nodes<'_>, joints: &'a Joints, node: usize, mesh: &Mesh) -> Hold<'a> {
    if let Some(skin) = joints.skin(mesh.element.typed_id as usize) {
        return Hold::Skin(skin);
    }
    let world = affine(&nodes.all[node].geometry_to_world);
    let sound = |map: &DAffine3| !is_flat(&map.matrix3, FLAT);
    match joints.at_or_above(nodes, node) {
        // With the joint into the bind pose.
        Some(joint) => match joints.unposed(nodes, joint).map(|unposed| unposed * world).filter(sound) {
            Some(map) => Hold::Joint(joint, map),
            None => Hold::None,
        },
        None if joints.is_empty() && sound(&world) => Hold::Free(world),
        None => Hold::None,
    }
}

/// The triangles of a mesh over its control points.
fn triangles_of(mesh: &Mesh) -> Result<Vec<[u32; 3]>, Fault> {
    let broken = |what: String| Fault::Fbx(format!("mesh `{}`: {what}", shown(&mesh.element.name)));
    let (corners, count) = (mesh.vertex_indices.as_ref(), mesh.vertices.len());
    if let Some(vertex) = corners.iter().find(|v| **v as usize >= count) {
        return Err(broken(format!("a polygon names vertex {vertex}, an index out of range: there are {count}")));
    }
    let mut triangles = Vec::with_capacity(mesh.num_triangles);
    let mut cut = vec![0; mesh.max_face_triangles.min(MAX_POLYGON as usize) * 3];
    for face in &mesh.faces {
        let polygon = corners.get(span(face)).ok_or_else(|| broken("a polygon reaches past the corners".into()))?;
        match polygon {
            [] | [_] | [_, _] => {}
            &[a, b, c] => triangles.push([a, b, c]),
            [hub, rim @ ..] if face.num_indices > MAX_POLYGON => {
                triangles.extend(rim.windows(2).map(|w| [*hub, w[0], w[1]]));
            }
            _ => {
                let found = ufbx::triangulate_face(&mut cut, mesh, *face) as usize;
                let found = cut.as_chunks::<3>().0.iter().take(found);
                triangles.extend(found.map(|t| t.map(|corner| corners[corner as usize])));
            }
        }
    }
    Ok(triangles)
}

pub(super) fn span(face: &Face) -> Range<usize> {
    let start = face.index_begin as usize;
    start..start.saturating_add(face.num_indices as usize)
}

/// The influences on the control points `used`, by joint.
fn rows(mesh: &Mesh, skin: &Skin, used: &[u32], repairs: &mut Repairs) -> Result<Rows, Fault> {
    let mut rows = Rows::with_capacity(used.len());
    for &v in used {
        let mut first_cluster = 0;
        let mut influences = 0;
        for deformer in &mesh.skin_deformers {
            let Some(vertex) = deformer.vertices.get(v as usize) else { continue };
            influences += vertex.num_weights;
            if influences > MAX_INFLUENCES {
                let (count, limit) = (influences.into(), MAX_INFLUENCES.into());
                let what = format!("the influences on vertex {v} of mesh `{}`", shown(&mesh.element.name));
                return Err(Fault::TooLarge { what, count, limit });
            }
            let start = vertex.weight_begin as usize;
            let weights = deformer.weights.get(start..start + vertex.num_weights as usize).unwrap_or_default();
            for influence in weights {
                if !influence.weight.is_finite() {
                    let what = format!("mesh `{}`: a weight of vertex {v} is not finite", shown(&mesh.element.name));
                    return Err(Fault::Fbx(what));
                }
                if let Some(&joint) = skin.joints.get(first_cluster + influence.cluster_index as usize) {
                    rows.push(joint, influence.weight);
                }
            }
            first_cluster += deformer.clusters.len();
        }
        rows.end(skin.joints.first().copied().unwrap_or(0), repairs);
    }
    Ok(rows)
}

/// A control point at rest.
pub(super) fn point(mesh: &Mesh, place: Place, vertex: u32, map: &DAffine3) -> Result<[f32; 3], Fault> {
    let p = mesh.vertices[vertex as usize];
    let at = map.transform_point3(DVec3::new(p.x, p.y, p.z)).as_vec3();
    if at.is_finite() { Ok(at.into()) } else { Err(Fault::VertexNotFinite { place, vertex }) }
}
