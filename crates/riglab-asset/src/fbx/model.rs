//! The surfaces and looks of a file, without its rig.

use std::collections::HashMap;

use glam::{DAffine3, DVec3};
use ufbx::{Material, MaterialMap, Mesh, Texture};

use super::joints::Joints;
use super::meshes::{Hold, MAX_POLYGON, hold, point, span};
use super::scene::{Nodes, affine};
use super::shown;
use crate::budget::{Budget, PART, TRIANGLE};
use crate::gltf::export::model::{Look, Model, Object, Patch, Picture, is_picture};
use crate::maps::{FLAT, is_flat};
use crate::{Fault, Place};

/// Bytes of a vertex: position, normal, coordinates and colour, as read and as written.
const CORNER: u64 = 2 * (12 + 12 + 8 + 16);

/// What comes of a file: the model, and the names of pictures that `find` did not find.
///
/// Meshes stand where [`super::read`] has them, and those that hang on no joint where their nodes do. `find` gives the
/// contents of a picture by its name.
pub(crate) fn model(
    name: &str,
    bytes: &[u8],
    find: impl Fn(&str) -> Option<Vec<u8>>,
) -> Result<(Model, Vec<String>), Fault> {
    let scene = super::load(bytes, false)?;
    let nodes = Nodes::new(&scene);
    let joints = Joints::read(&scene, &nodes, &mut Vec::new())?;
    let budget = Budget::new(bytes.len());
    let mut pictures = Pictures { find, known: HashMap::new(), found: Vec::new(), missing: Vec::new() };
    let looks = (&scene.materials).into_iter().map(|material| look(material, &mut pictures)).collect();
    let mut model = Model { name: name.into(), looks, ..Model::default() };
    let mut copies = nodes.copies();
    for (number, node) in nodes.all.iter().enumerate() {
        let Some(mesh) = node.mesh.as_deref() else { continue };
        // A corner may become a vertex of its own: position, normal, coordinates, index and the key that finds it.
        budget.piece(mesh.num_triangles.saturating_mul(3), 64)?;
        // As in `meshes`, the first node asks for all. Half of what there is of a mesh is in the GLB.
        let copies = copies.remove(&mesh.element.typed_id).unwrap_or(0);
        budget.show(PART + mesh.num_triangles as u64 * TRIANGLE, copies)?;
        let map = match hold(&nodes, &joints, number, mesh) {
            Hold::Skin(skin) => skin.map,
            Hold::Joint(_, map) | Hold::Free(map) => map,
            Hold::None => affine(&node.geometry_to_world),
        };
        let map = nodes.space * map;
        if is_flat(&map.matrix3, FLAT) {
            continue;
        }
        let of_node: Vec<usize> = (&node.materials).into_iter().map(number_of).collect();
        let of_mesh: Vec<usize> = (&mesh.materials).into_iter().map(number_of).collect();
        let materials = if of_node.is_empty() { of_mesh } else { of_node };
        let place = Place { node: number, mesh: mesh.element.typed_id as usize, primitive: 0 };
        let patches = patches(mesh, place, &map, &materials)?;
        let vertices: usize = patches.iter().map(|patch| patch.positions.len()).sum();
        budget.show(vertices as u64 * CORNER, copies)?;
        if !patches.is_empty() {
            model.objects.push(Object { name: node.element.name.to_string(), patches });
        }
    }
    model.pictures = pictures.found;
    Ok((model, pictures.missing))
}

fn number_of(material: &Material) -> usize {
    material.element.typed_id as usize
}

/// What makes two corners one vertex: control point, and what the lists of normals, coordinates and colours say.
type Corner = [u32; 4];

/// A patch on its way: the vertex of each corner met so far.
#[derive(Default)]
struct Growing {
    patch: Patch,
    known: HashMap<Corner, u32>,
}

/// The triangles of a mesh by material, in the order in which materials are first used.
fn patches(mesh: &Mesh, place: Place, map: &DAffine3, materials: &[usize]) -> Result<Vec<Patch>, Fault> {
    let broken = |what: &str| Fault::Fbx(format!("mesh `{}`: {what}", shown(&mesh.element.name)));
    let mirrored = map.matrix3.determinant() < 0.0;
    let of_normals = map.matrix3.inverse().transpose();
    let mut order: Vec<Option<usize>> = Vec::new();
    let mut growing: Vec<Growing> = Vec::new();
    let mut cut = vec![0; mesh.max_face_triangles.min(MAX_POLYGON as usize) * 3];
    for (face_number, face) in (&mesh.faces).into_iter().enumerate() {
        let corners = span(face);
        if corners.end > mesh.vertex_indices.len() {
            return Err(broken("a polygon reaches past the corners"));
        }
        let (first, count) = (face.index_begin, face.num_indices);
        let found: Vec<[u32; 3]> = match count {
            0..=2 => continue,
            3 => vec![[first, first + 1, first + 2]],
            _ if count > MAX_POLYGON => (1..count - 1).map(|k| [first, first + k, first + k + 1]).collect(),
            _ => {
                let found = ufbx::triangulate_face(&mut cut, mesh, *face) as usize;
                cut.as_chunks::<3>().0.iter().take(found).copied().collect()
            }
        };
        let slot = mesh.face_material.get(face_number).map(|slot| *slot as usize);
        let look = slot.and_then(|slot| materials.get(slot)).copied();
        let at = order.iter().position(|known| *known == look).unwrap_or_else(|| {
            order.push(look);
            growing.push(Growing { patch: Patch { look, ..Patch::default() }, known: HashMap::new() });
            order.len() - 1
        });
        for mut triangle in found {
            if mirrored {
                triangle.swap(1, 2);
            }
            for corner in triangle {
                let vertex = growing[at].vertex(mesh, place, corner as usize, map, &of_normals)?;
                growing[at].patch.indices.push(vertex);
            }
        }
    }
    let mut patches: Vec<Patch> = growing.into_iter().map(|g| g.patch).filter(|p| !p.indices.is_empty()).collect();
    for patch in &mut patches {
        let triangles = patch.indices.as_chunks().0;
        patch.normals = crate::rigging::complete_normals(&patch.normals, &patch.positions, triangles);
    }
    Ok(patches)
}

impl Growing {
    /// The vertex of a corner, made where it is not there.
    fn vertex(
        &mut self,
        mesh: &Mesh,
        place: Place,
        corner: usize,
        map: &DAffine3,
        of_normals: &glam::DMat3,
    ) -> Result<u32, Fault> {
        let value = |indices: &[u32]| indices.get(corner).copied().unwrap_or(u32::MAX);
        let control = value(mesh.vertex_indices.as_ref());
        if control as usize >= mesh.vertices.len() {
            let (name, count) = (shown(&mesh.element.name), mesh.vertices.len());
            let what =
                format!("mesh `{name}`: a polygon names vertex {control}, an index out of range: there are {count}");
            return Err(Fault::Fbx(what));
        }
        let normal = value(mesh.vertex_normal.indices.as_ref());
        let coordinates = value(mesh.vertex_uv.indices.as_ref());
        let colour = value(mesh.vertex_color.indices.as_ref());
        if let Some(&known) = self.known.get(&[control, normal, coordinates, colour]) {
            return Ok(known);
        }
        let patch = &mut self.patch;
        let number = patch.positions.len() as u32;
        patch.positions.push(point(mesh, place, control, map)?);
        let own = mesh.vertex_normal.values.get(normal as usize);
        let turned = own.map_or(DVec3::ZERO, |n| (*of_normals * DVec3::new(n.x, n.y, n.z)).normalize_or_zero());
        patch.normals.push(turned.as_vec3().to_array());
        if mesh.vertex_uv.exists {
            let own = mesh.vertex_uv.values.get(coordinates as usize);
            let finite = |x: f64| if (x as f32).is_finite() { x as f32 } else { 0.0 };
            patch.coordinates.push(own.map_or([0.0; 2], |uv| [finite(uv.x), finite(1.0 - uv.y)]));
        }
        if mesh.vertex_color.exists {
            let own = mesh.vertex_color.values.get(colour as usize);
            patch.colours.push(own.map_or([1.0; 4], |c| [c.x, c.y, c.z, c.w].map(unit)));
        }
        self.known.insert([control, normal, coordinates, colour], number);
        Ok(number)
    }
}

fn unit(x: f64) -> f32 {
    if x.is_finite() { (x as f32).clamp(0.0, 1.0) } else { 0.0 }
}

/// Pictures by texture.
struct Pictures<F> {
    find: F,
    known: HashMap<u32, Option<usize>>,
    found: Vec<Picture>,
    missing: Vec<String>,
}

impl<F: Fn(&str) -> Option<Vec<u8>>> Pictures<F> {
    fn number(&mut self, map: &MaterialMap) -> Option<usize> {
        let texture: &Texture = map.texture.as_deref().filter(|_| map.texture_enabled)?;
        let key = texture.element.element_id;
        if let Some(known) = self.known.get(&key) {
            return *known;
        }
        let embedded: &[u8] = texture.content.as_ref();
        let names = [&texture.relative_filename, &texture.filename].map(|name| name.to_string());
        let bytes = match is_picture(embedded) {
            true => Some(embedded.to_vec()),
            false => names.iter().find_map(|name| (self.find)(name)).filter(|bytes| is_picture(bytes)),
        };
        let number = bytes.map(|bytes| {
            self.found.push(Picture { name: texture.element.name.to_string(), bytes });
            self.found.len() - 1
        });
        if number.is_none() {
            self.missing.push(names[0].clone());
        }
        self.known.insert(key, number);
        number
    }
}

fn look<F: Fn(&str) -> Option<Vec<u8>>>(material: &Material, pictures: &mut Pictures<F>) -> Look {
    let plain = Look::plain(&material.element.name);
    let pbr = &material.pbr;
    let number = |map: &MaterialMap| map.has_value.then(|| unit(map.value_vec4.x));
    let picture = pictures.number(&pbr.base_color);
    let colour = pbr.base_color.has_value.then_some(pbr.base_color.value_vec4).map(|c| [c.x, c.y, c.z].map(unit));
    // Where there is a picture, it is the colour: few programs multiply the two.
    let [r, g, b] = match picture {
        Some(_) => [1.0; 3],
        None => colour.unwrap_or([0.8; 3]),
    };
    let alpha = number(&pbr.opacity).filter(|a| *a > 0.0).unwrap_or(1.0);
    let strength = number(&pbr.emission_factor).unwrap_or(1.0);
    let glow = pbr.emission_color.has_value.then_some(pbr.emission_color.value_vec4);
    Look {
        colour: [r, g, b, alpha],
        picture,
        normals: pictures.number(&pbr.normal_map),
        glow: glow.map_or([0.0; 3], |c| [c.x, c.y, c.z].map(|x| unit(x) * strength)),
        metallic: number(&pbr.metalness).unwrap_or(0.0),
        roughness: number(&pbr.roughness).unwrap_or(plain.roughness),
        transparent: alpha < 1.0,
        ..plain
    }
}
