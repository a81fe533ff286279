//! The surfaces and looks of a file, without its rig.

use std::collections::{BTreeSet, HashMap};

use glam::{DAffine3, DVec3};
use ufbx::{
    AnimCurve, AnimLayer, AnimProp, AnimStack, Element, ElementType, Material, Mesh, PropFlags, Scene, VertexVec2,
    VertexVec4,
};

use super::clips::time;
use super::groups::Groups;
use super::hidden::hidden;
use super::joints::Joints;
use super::looks::{Looks, Pictures, look};
use super::meshes::{Hold, MAX_POLYGON, hold, point, span};
use super::scene::{Nodes, affine};
use super::shapes::{in_between, shapes, swings};
use super::{Load, shown};
use crate::budget::{Budget, PART, TRIANGLE};
use crate::gltf::export::model::{Model, Object, Patch};
use crate::maker::is_maker;
use crate::maps::{FLAT, is_flat};
use crate::rigging::linear;
use crate::warning::of_number;
use crate::{Fault, Place, Resample};

/// Bytes of a vertex: position, normal, coordinates and colour, as read and as written.
const CORNER: u64 = 2 * (12 + 12 + COORDINATES + COLOUR);
const COORDINATES: u64 = 8;
const COLOUR: u64 = 16;

/// What of a file is not in its model.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Left {
    /// The names of pictures that were not found.
    pub(crate) missing: Vec<String>,
    /// Of those that are of no kind that is read.
    pub(crate) other: Vec<String>,
    /// The properties of materials whose pictures are not taken over, or not as they lie.
    pub(crate) maps: BTreeSet<String>,
    /// Of what else is left, how much.
    pub(crate) things: Vec<String>,
}

/// What comes of a file.
#[derive(Debug)]
pub(crate) struct Taken {
    pub(crate) model: Model,
    /// Where the vertices of each object come from.
    pub(crate) origins: Vec<Origin>,
    /// Frames a second that the file is worked on in.
    pub(crate) rate: f32,
    /// How many animations move something.
    pub(crate) animations: usize,
    /// How many of those that move joints move parts that hang there as well.
    pub(crate) part_motions: usize,
    pub(crate) left: Left,
}

/// Where an object's vertices come from.
#[derive(Debug)]
pub(crate) struct Origin {
    /// The node that shows the mesh, as parts of a reading have it.
    pub(crate) node: usize,
    /// Control points, by patch and vertex.
    pub(crate) controls: Vec<Vec<u32>>,
}

/// The surfaces and looks of a file.
///
/// Meshes stand where [`super::read`] has them, and those that hang on no joint where their nodes do. `find` gives the
/// contents of a picture by its name.
pub(crate) fn model(name: &str, bytes: &[u8], find: impl Fn(&str) -> Option<Vec<u8>>) -> Result<Taken, Fault> {
    // Motions that cannot be read are no reason to refuse the surface.
    let (scene, still) = match super::load(bytes, Load { motions: true, pictures: true }) {
        Ok(scene) => (scene, false),
        Err(_) => (super::load(bytes, Load { motions: false, pictures: true })?, true),
    };
    let nodes = Nodes::new(&scene);
    let joints = Joints::read(&scene, &nodes, &mut Vec::new())?;
    let budget = Budget::new(bytes.len());
    let mut groups = Groups::read(&nodes, &joints);
    let mut left = Left { things: things_left(&scene), ..Left::default() };
    left.things.append(&mut groups.left);
    let mut pictures = Pictures::new(find, left);
    let is_ours = is_maker(scene.metadata.creator.as_bytes());
    let materials: Vec<&Material> = (&scene.materials).into_iter().collect();
    let looks = materials.iter().map(|material| look(material, &mut pictures, is_ours)).collect();
    let mut looks = Looks::new(looks, materials);
    let mut model = Model { name: name.into(), ..Model::default() };
    let (mut origins, mut meshes) = (Vec::new(), Vec::new());
    let (mut copies, hidden) = (nodes.copies(), hidden(&nodes));
    for (number, node) in nodes.all.iter().enumerate() {
        let Some(mesh) = node.mesh.as_deref() else { continue };
        // A corner may become a vertex of its own: position, normal, coordinates, index and the key that finds it.
        let more = COORDINATES * further(mesh.uv_sets.len()) + COLOUR * further(mesh.color_sets.len());
        budget.piece(mesh.num_triangles.saturating_mul(3), 96 + 2 * more as usize)?;
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
        let materials: Vec<usize> = materials.into_iter().map(|of| looks.on(of, mesh, &mut pictures.left)).collect();
        let place = Place { node: number, mesh: mesh.element.typed_id as usize, primitive: 0 };
        let (patches, controls) = patches(mesh, place, &map, &materials)?;
        let vertices: usize = patches.iter().map(|patch| patch.positions.len()).sum();
        budget.show(vertices as u64 * (CORNER + 2 * more), copies)?;
        if !patches.is_empty() {
            let shapes = shapes(mesh, &map, (&patches, &controls), &budget, copies)?;
            let (name, group, hidden) = (node.element.name.to_string(), groups.above(number), hidden[number]);
            model.objects.push(Object { name, group, hidden, patches, shapes });
            origins.push(Origin { node: number, controls });
            meshes.push(mesh);
        }
    }
    model.looks = looks.all;
    model.groups = groups.all;
    model.pictures = pictures.found;
    let rate = scene.settings.frames_per_second as f32;
    let rate = if (1.0..=240.0).contains(&rate) { rate } else { Resample::default().rate };
    let moving = joints.movers(&nodes);
    let (swings, too_long) = swings(&scene, &meshes, rate, &moving);
    model.swings = swings;
    let mut left = pictures.left;
    left.things.extend(still.then(|| "motions of blend shapes, which could not be read".to_owned()));
    let (one, many) = ("blend shape's in-between shapes", "blend shapes' in-between shapes");
    left.things.extend(counted(in_between(&meshes), one, many));
    left.things.extend(counted(too_long, "long motion of blend shapes", "long motions of blend shapes"));
    let part_motions = part_motions(&scene, &nodes, &joints, &moving);
    Ok(Taken { model, origins, rate, animations: animations(&scene), part_motions, left })
}

/// How many animations of joints move a mesh without a skin as well, by its own node or by one between it and its joint.
fn part_motions(scene: &Scene, nodes: &Nodes<'_>, joints: &Joints, moving: &[bool]) -> usize {
    let mut of_parts = vec![false; nodes.all.len()];
    for (number, node) in nodes.all.iter().enumerate() {
        let Some(mesh) = node.mesh.as_deref() else { continue };
        if matches!(hold(nodes, joints, number, mesh), Hold::Skin(_)) {
            continue;
        }
        let mut at = Some(number);
        while let Some(own) = at.filter(|own| !moving[*own] && !of_parts[*own]) {
            of_parts[own] = true;
            at = nodes.parent(own);
        }
    }
    let moves_part = |prop: &AnimProp| {
        prop.element.type_ == ElementType::Node
            && of_parts.get(prop.element.typed_id as usize) == Some(&true)
            && is_moved(prop)
    };
    let of_part = |stack: &AnimStack| (&stack.layers).into_iter().flat_map(|layer| &layer.anim_props).any(moves_part);
    (&scene.anim_stacks).into_iter().filter(|stack| time(stack, moving).is_some() && of_part(stack)).count()
}

/// Whether curves take a property elsewhere than where it is: exporters write some for what is still, too.
fn is_moved(prop: &AnimProp) -> bool {
    let rest = prop.element.props.find_prop(&prop.prop_name).map(|own| own.value_vec4);
    let rest = rest.map(|own| [own.x, own.y, own.z]);
    let is_moved = |k: usize, curve: &AnimCurve| {
        let (low, high) = (curve.min_value, curve.max_value);
        let rest = rest.map_or(low, |rest| rest[k]);
        low.min(rest) < high.max(rest) - 1e-4 * rest.abs().max(1.0)
    };
    let curves = prop.anim_value.curves.iter().enumerate();
    curves.filter_map(|(k, curve)| Some((k, curve.as_ref()?))).any(|(k, curve)| is_moved(k, curve))
}

/// How many animations have keys of something else than blend shapes. Exporters write one for files at rest, too, with no
/// curves in it.
fn animations(scene: &Scene) -> usize {
    let moves = |layer: &AnimLayer| {
        let others = (&layer.anim_props).into_iter().filter(|prop| prop.element.type_ != ElementType::BlendChannel);
        others.flat_map(|prop| &prop.anim_value.curves).any(Option::is_some)
    };
    (&scene.anim_stacks).into_iter().filter(|stack| (&stack.layers).into_iter().any(moves)).count()
}

/// What of a scene no model has, beside its rig, motions and pictures.
fn things_left(scene: &Scene) -> Vec<String> {
    let holders = (&scene.nodes).into_iter().filter(|node| node.mesh.is_some()).map(|node| &node.element);
    let owners = holders.chain((&scene.materials).into_iter().map(|material| &material.element));
    let own: usize = owners.map(own_properties).sum();
    counted(own, "user property", "user properties").into_iter().collect()
}

/// How many sets there are beside the first.
fn further(sets: usize) -> u64 {
    sets.saturating_sub(1) as u64
}

/// So many of something, if any.
pub(crate) fn counted(n: usize, one: &str, many: &str) -> Option<String> {
    (n > 0).then(|| of_number(n, one, many))
}

/// How many properties a user gave an element; those that programs give all are none.
fn own_properties(of: &Element) -> usize {
    let named = |name: &str| ["currentUVSet", "MaxHandle", "UDP3DSMAX", "lockInfluenceWeights"].contains(&name);
    (&of.props.props)
        .into_iter()
        .filter(|prop| prop.flags.has_any(PropFlags::USER_DEFINED) && !named(&prop.name))
        .count()
}

fn number_of(material: &Material) -> usize {
    material.element.typed_id as usize
}

/// What makes two corners one vertex: control point, normal, coordinates and colour, and those of further sets. Their values, as
/// files may list them for each corner anew; normals by steps of [`ALIKE`].
type Corner = (u32, [i32; 3], [u32; 2], [u32; 4], Vec<u32>);

/// Normals that differ by a quarter of a degree look the same: programs round those of corners, each otherwise.
const ALIKE: f32 = 1.0 / 256.0;

/// A patch on its way: the vertex of each corner met so far.
#[derive(Default)]
struct Growing {
    patch: Patch,
    /// The control point of each vertex.
    controls: Vec<u32>,
    known: HashMap<Corner, u32>,
}

/// The triangles of a mesh by material, in the order in which materials are first used; and the control points of their
/// vertices.
fn patches(
    mesh: &Mesh,
    place: Place,
    map: &DAffine3,
    materials: &[usize],
) -> Result<(Vec<Patch>, Vec<Vec<u32>>), Fault> {
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
            growing.push(Growing { patch: Patch { look, ..Patch::default() }, ..Growing::default() });
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
    let drawn = growing.into_iter().filter(|g| !g.patch.indices.is_empty());
    let (mut patches, controls): (Vec<Patch>, Vec<_>) = drawn.map(|g| (g.patch, g.controls)).unzip();
    for patch in &mut patches {
        let triangles = patch.indices.as_chunks().0;
        patch.normals = crate::rigging::complete_normals(&patch.normals, &patch.positions, triangles);
    }
    Ok((patches, controls))
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
        let own = mesh.vertex_normal.values.get(value(mesh.vertex_normal.indices.as_ref()) as usize);
        let turned = own.map_or(DVec3::ZERO, |n| (*of_normals * DVec3::new(n.x, n.y, n.z)).normalize_or_zero());
        let normal = turned.as_vec3().to_array();
        let coordinates = coordinates(&mesh.vertex_uv, corner);
        let colour = colour(&mesh.vertex_color, corner);
        let more_coordinates: Vec<[f32; 2]> =
            (&mesh.uv_sets).into_iter().skip(1).map(|set| self::coordinates(&set.vertex_uv, corner)).collect();
        let more_colours: Vec<[f32; 4]> =
            (&mesh.color_sets).into_iter().skip(1).map(|set| self::colour(&set.vertex_color, corner)).collect();
        // -0 and 0 are one value.
        let bits = |x: f32| (x + 0.0).to_bits();
        let step = |x: f32| (x / ALIKE).round() as i32;
        let more =
            more_coordinates.as_flattened().iter().chain(more_colours.as_flattened()).map(|x| bits(*x)).collect();
        let key = (control, normal.map(step), coordinates.map(bits), colour.map(bits), more);
        if let Some(&known) = self.known.get(&key) {
            return Ok(known);
        }
        let patch = &mut self.patch;
        let number = patch.positions.len() as u32;
        patch.positions.push(point(mesh, place, control, map)?);
        self.controls.push(control);
        patch.normals.push(normal);
        if mesh.vertex_uv.exists {
            patch.coordinates.push(coordinates);
        }
        if mesh.vertex_color.exists {
            patch.colours.push(colour);
        }
        push_each(&mut patch.more_coordinates, more_coordinates);
        push_each(&mut patch.more_colours, more_colours);
        self.known.insert(key, number);
        Ok(number)
    }
}

/// The values of further sets at a vertex, each to its set.
fn push_each<T>(sets: &mut Vec<Vec<T>>, values: Vec<T>) {
    sets.resize_with(values.len(), Vec::new);
    sets.iter_mut().zip(values).for_each(|(set, value)| set.push(value));
}

/// Those of a corner, from the upper left corner of the picture; 0 where there are none.
fn coordinates(of: &VertexVec2, corner: usize) -> [f32; 2] {
    let own = of.indices.get(corner).and_then(|at| of.values.get(*at as usize));
    let finite = |x: f64| if (x as f32).is_finite() { x as f32 } else { 0.0 };
    own.map_or([0.0; 2], |uv| [finite(uv.x), finite(1.0 - uv.y)])
}

/// That of a corner, linear; white where there is none.
fn colour(of: &VertexVec4, corner: usize) -> [f32; 4] {
    let own = of.indices.get(corner).and_then(|at| of.values.get(*at as usize));
    let [r, g, b, a] = own.map_or([1.0; 4], |c| [c.x, c.y, c.z, c.w].map(unit));
    [linear(r), linear(g), linear(b), a]
}

/// From 0 to 1; 0 for what is no number.
pub(super) fn unit(x: f64) -> f32 {
    if x.is_finite() { (x as f32).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gltf::export::model::Lie;

    /// A triangle with two sets of coordinates and a blend shape, and with what is said of its material 5, pictures from 10 on
    /// included.
    fn file(material: &str, more: &str, connections: &str) -> Vec<u8> {
        let set = |n: u32| {
            format!(
                "LayerElementUV: {n} {{\nName: \"map{n}\"\nMappingInformationType: \"ByPolygonVertex\"\n\
                 ReferenceInformationType: \"Direct\"\nUV: *6 {{ a: 0,0,1,0,0,1 }}\n}}\n"
            )
        };
        let layer =
            |n: u32| format!("Layer: {n} {{\nLayerElement: {{\nType: \"LayerElementUV\"\nTypedIndex: {n}\n}}\n}}\n");
        format!(
            "; FBX 7.4.0 project file\nFBXHeaderExtension: {{\nFBXHeaderVersion: 1003\nFBXVersion: 7400\n}}\n\
             Objects: {{\nGeometry: 2, \"Geometry::\", \"Mesh\" {{\nVertices: *9 {{ a: 0,0,0,1,0,0,0,1,0 }}\n\
             PolygonVertexIndex: *3 {{ a: 0,1,-3 }}\n{}{}{}{}}}\n\
             Geometry: 3, \"Geometry::up\", \"Shape\" {{\nIndexes: *1 {{ a: 0 }}\nVertices: *3 {{ a: 0,0,1 }}\n}}\n\
             Deformer: 6, \"Deformer::\", \"BlendShape\" {{\n}}\n\
             Deformer: 7, \"SubDeformer::up\", \"BlendShapeChannel\" {{\nFullWeights: *1 {{ a: 100 }}\n}}\n\
             Model: 1, \"Model::body\", \"Mesh\" {{\nVersion: 232\nProperties70: {{\n\
             P: \"currentUVSet\", \"KString\", \"\", \"U\", \"map0\"\nP: \"price\", \"KString\", \"\", \"U\", \"9\"\n}}\n}}\n\
             Material: 5, \"Material::cloth\", \"\" {{\nVersion: 102\nShadingModel: \"lambert\"\nProperties70: {{\n\
             P: \"DiffuseColor\", \"Color\", \"\", \"A\",0.1,0.2,0.9\n{material}\n}}\n}}\n{more}}}\n\
             Connections: {{\nC: \"OO\",1,0\nC: \"OO\",2,1\nC: \"OO\",5,1\nC: \"OO\",6,2\nC: \"OO\",7,6\nC: \"OO\",3,7\n\
             {connections}}}\n",
            set(0),
            set(1),
            layer(0),
            layer(1),
        )
        .into_bytes()
    }

    fn texture(id: u32, name: &str, more: &str) -> String {
        format!(
            "Texture: {id}, \"Texture::t{id}\", \"\" {{\nType: \"TextureVideoClip\"\nVersion: 202\nFileName: \"{name}\"\n\
             RelativeFilename: \"{name}\"\nProperties70: {{\n{more}\n}}\n}}\n"
        )
    }

    fn on(id: u32, property: &str) -> String {
        format!("C: \"OP\",{id},5,\"{property}\"\n")
    }

    fn find(name: &str) -> Option<Vec<u8>> {
        let kind = name.rsplit_once('.')?.1;
        let png = [b"\x89PNG\r\n\x1a\n", name.as_bytes()].concat();
        ["png", "tga"].contains(&kind).then(|| if kind == "png" { png } else { vec![0; 18] })
    }

    fn read(material: &str, more: &str, connections: &str) -> (Model, Left) {
        let taken = model("m", &file(material, more, connections), find).unwrap();
        (taken.model, taken.left)
    }

    #[test]
    fn further_sets_of_coordinates_and_colours_stay() {
        // Corners that differ in a further set alone are vertices of their own.
        let (mut model, _) = read("", "", "");
        let patch = &model.objects[0].patches[0];
        assert_eq!(patch.more_coordinates, [[[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]]]);
        let (mut sets, mut colours) = (vec![vec![[1.0f32; 2]]], Vec::new());
        push_each(&mut sets, vec![[2.0; 2]]);
        push_each(&mut colours, vec![[0.5f32; 4]]);
        assert_eq!((sets, colours), (vec![vec![[1.0; 2], [2.0; 2]]], vec![vec![[0.5; 4]]]));
        let patch = &mut model.objects[0].patches[0];
        (patch.colours, patch.more_colours) = (vec![[1.0; 4]; 3], vec![vec![[0.5; 4]; 3]]);
        let glb = String::from_utf8_lossy(&model.into_glb().unwrap()).into_owned();
        for name in ["TEXCOORD_0", "TEXCOORD_1", "COLOR_0", "COLOR_1"] {
            assert!(glb.contains(&format!("\"{name}\"")), "{name}");
        }
    }

    #[test]
    fn what_no_model_has_is_told() {
        let (model, left) = read("", "", "");
        // A blend shape is: the first corner goes up.
        let [shape] = &model.objects[0].shapes[..] else { panic!("{:?}", model.objects) };
        assert_eq!(
            (shape.name.as_str(), shape.weight, &shape.offsets),
            ("up", 0.0, &vec![vec![(0, [0.0, 0.0, 0.01])]])
        );
        let glb = String::from_utf8_lossy(&model.into_glb().unwrap()).into_owned();
        assert!(glb.contains(r#""targetNames":["up"]"#) && glb.contains(r#""max":[0.0,0.0,0.00999"#), "{glb}");
        let things = ["1 user property"];
        assert_eq!(left, Left { things: things.map(String::from).to_vec(), ..Left::default() });
        // A stack without curves moves nothing.
        let stack = "AnimationStack: 20, \"AnimStack::Take\", \"\" {\n}\nAnimationLayer: 21, \"AnimLayer::Base\", \"\" {\n}\n\
            AnimationCurveNode: 22, \"AnimCurveNode::T\", \"\" {\n}\n";
        let connections = "C: \"OO\",21,20\nC: \"OO\",22,21\nC: \"OP\",22,1,\"Lcl Translation\"\n";
        let moving =
            |more: &str, connections: &str| super::model("m", &file("", more, connections), find).unwrap().animations;
        assert_eq!(moving(stack, connections), 0);
        let curve = "AnimationCurve: 23, \"AnimCurve::\", \"\" {\nKeyVer: 4008\nKeyTime: *1 { a: 0 }\n\
            KeyValueFloat: *1 { a: 1 }\nKeyAttrFlags: *1 { a: 24836 }\nKeyAttrDataFloat: *4 { a: 0,0,0,0 }\n\
            KeyAttrRefCount: *1 { a: 1 }\n}\n";
        assert_eq!(moving(&format!("{stack}{curve}"), &format!("{connections}C: \"OP\",23,22,\"d|X\"\n")), 1);
    }

    #[test]
    fn what_a_file_does_not_show_is_hidden_in_the_model() {
        // Levels below a group of them, each a mesh of the one geometry, and one beside.
        let model = |id: u32, kind: &str, own: &str| {
            format!("Model: {id}, \"Model::m{id}\", \"{kind}\" {{\nVersion: 232\nProperties70: {{\n{own}\n}}\n}}\n")
        };
        let hidden = r#"P: "Visibility", "Visibility", "", "A", 0"#;
        let own = r#"P: "Visibility Inheritance", "Visibility Inheritance", "", "", 0"#;
        let more = [
            model(31, "LodGroup", ""),
            "NodeAttribute: 40, \"NodeAttribute::\", \"LodGroup\" {\n}\n".into(),
            model(32, "Mesh", ""),
            model(33, "Mesh", ""),
            model(34, "Null", hidden),
            model(35, "Mesh", ""),
            model(36, "Mesh", own),
        ];
        let connections = "C: \"OO\",31,0\nC: \"OO\",40,31\nC: \"OO\",32,31\nC: \"OO\",33,31\nC: \"OO\",34,0\n\
            C: \"OO\",35,34\nC: \"OO\",36,34\nC: \"OO\",2,32\nC: \"OO\",2,33\nC: \"OO\",2,35\nC: \"OO\",2,36\n";
        let (model, _) = read("", &more.concat(), connections);
        let hidden: Vec<_> = model.objects.iter().filter(|o| o.hidden).map(|o| o.name.clone()).collect();
        assert_eq!((model.objects.len(), hidden.join(" ")), (5, "m33 m35".into()));
        let glb = String::from_utf8_lossy(&model.into_glb().unwrap()).into_owned();
        assert_eq!(glb.matches(r#""KHR_node_visibility":{"visible":false}"#).count(), 2, "{glb}");
        assert!(glb.contains(r#""extensionsUsed":["KHR_node_visibility"]"#), "{glb}");
    }

    #[test]
    fn in_between_shapes_are_told() {
        let half =
            "Geometry: 8, \"Geometry::half\", \"Shape\" {\nIndexes: *1 { a: 0 }\nVertices: *3 { a: 0,0,0.2 }\n}\n";
        let file = String::from_utf8(file("", half, "C: \"OO\",8,7\n")).unwrap();
        let file = file.replace("FullWeights: *1 { a: 100 }", "FullWeights: *2 { a: 100,50 }");
        let taken = super::model("m", file.as_bytes(), find).unwrap();
        let [shape] = &taken.model.objects[0].shapes[..] else { panic!("{:?}", taken.model.objects) };
        assert_eq!((shape.name.as_str(), &shape.offsets), ("up", &vec![vec![(0, [0.0, 0.0, 0.01])]]));
        assert_eq!(taken.left.things, ["1 user property", "1 blend shape's in-between shapes"]);
    }

    /// An animation of a curve from 0 to `to` in a tenth of a second, of a property of an element.
    fn curve(to: f64, element: u32, property: &str) -> (String, String) {
        let second = 46_186_158_000_u64;
        let more = format!(
            "AnimationStack: 20, \"AnimStack::Talk\", \"\" {{\n}}\nAnimationLayer: 21, \"AnimLayer::Base\", \"\" {{\n}}\n\
             AnimationCurveNode: 22, \"AnimCurveNode::\", \"\" {{\n}}\nAnimationCurve: 23, \"AnimCurve::\", \"\" {{\n\
             KeyVer: 4008\nKeyTime: *2 {{ a: {second},{} }}\nKeyValueFloat: *2 {{ a: 0,{to} }}\n\
             KeyAttrFlags: *1 {{ a: 24836 }}\nKeyAttrDataFloat: *4 {{ a: 0,0,0,0 }}\nKeyAttrRefCount: *1 {{ a: 2 }}\n}}\n",
            second + second / 10
        );
        let connections = format!(
            "C: \"OO\",21,20\nC: \"OO\",22,21\nC: \"OP\",22,{element},\"{property}\"\nC: \"OP\",23,22,\"d|{property}\"\n"
        );
        (more, connections)
    }

    #[test]
    fn blend_shapes_keep_their_motions() {
        let (more, connections) = curve(50.0, 7, "DeformPercent");
        let taken = super::model("m", &file("", &more, &connections), find).unwrap();
        let [swing] = &taken.model.swings[..] else { panic!("{:?}", taken.model.swings) };
        // A file that does not say its rate has 24 or 30 frames a second; the time begins where the motion does.
        let frames = (0.1 * swing.rate + 1e-3).floor() as usize + 1;
        assert_eq!((swing.name.as_str(), swing.frames, swing.weights.len()), ("Talk", frames, 1));
        let (object, weights) = &swing.weights[0];
        assert_eq!((*object, weights.len(), weights[0]), (0, frames, 0.0));
        let last = 0.5 * (frames - 1) as f32 / (0.1 * swing.rate);
        assert!((weights[frames - 1] - last).abs() < 1e-3, "{weights:?} for {last}");
        // It is no animation that is left, and told as none.
        assert_eq!((taken.animations, taken.left.things.len()), (0, 1), "{:?}", taken.left);
        let glb = String::from_utf8_lossy(&taken.model.into_glb().unwrap()).into_owned();
        assert!(glb.contains(r#""channels":[{"sampler":0,"target":{"node":0,"path":"weights"}}]"#), "{glb}");

        // What moves the node is one that is.
        let (more, connections) = curve(1.0, 1, "Lcl Translation");
        let taken =
            super::model("m", &file("", &more, &connections.replace("d|Lcl Translation", "d|X")), find).unwrap();
        assert_eq!((taken.animations, taken.model.swings.len()), (1, 0));
    }

    #[test]
    fn of_materials_by_other_programs_is_believed_what_they_mean() {
        let look = |name: &str, value: f64| {
            let told = format!("P: \"{name}\", \"Number\", \"\", \"A\",{value}\n");
            let glow = "P: \"EmissiveColor\", \"Color\", \"\", \"A\",0.5,0.25,0\n";
            read(&(told + glow), "", "").0.looks.remove(0)
        };
        // What mirrors is no metal for that.
        assert_eq!(look("ReflectionFactor", 1.0).metallic, 0.0);
        assert_eq!([0.5, 3.0, 0.0, -1.0].map(|bumps| look("BumpFactor", bumps).bumps), [0.5, 3.0, 1.0, 1.0]);
        assert_eq!([2.0, 0.5, -1.0].map(|factor| look("EmissiveFactor", factor).glow[0]), [1.0, 0.25, 0.0]);
        assert_eq!(look("EmissiveFactor", 8.0).glow, [4.0, 2.0, 0.0]);
    }

    #[test]
    fn surfaces_are_as_clear_as_old_materials_say() {
        let alpha = |material: &str| {
            let (model, _) = read(material, "", "");
            (model.looks[0].colour[3], model.looks[0].transparent)
        };
        let factor = |x: f64| format!("P: \"TransparencyFactor\", \"Number\", \"\", \"A\",{x}\n");
        let colour = |x: f64| format!("P: \"TransparentColor\", \"Color\", \"\", \"A\",{x},{x},{x}\n");
        let opacity = |x: f64| format!("P: \"Opacity\", \"double\", \"Number\", \"\",{x}\n");
        for (material, wanted) in [
            (String::new(), 1.0),
            (opacity(0.5), 0.5),
            (factor(0.25) + &colour(1.0), 0.75),
            (factor(0.5) + &colour(0.5), 0.75),
            (factor(0.5) + &colour(1.0) + &opacity(0.5), 0.5),
            // Nothing of a colour, or a colour of nothing.
            (factor(0.0) + &colour(1.0), 1.0),
            (factor(1.0) + &colour(0.0), 1.0),
            // All hidden: not meant.
            (factor(1.0) + &colour(1.0), 1.0),
            (opacity(0.0), 1.0),
        ] {
            assert_eq!(alpha(&material), (wanted, wanted < 1.0), "{material}");
        }
    }

    #[test]
    fn pictures_are_placed_and_those_left_are_told() {
        // A scale of 2 shows the middle half of a picture, as in ufbx.
        let placed =
            "P: \"Translation\", \"Vector\", \"\", \"A\",0.5,0.25,0\nP: \"Scaling\", \"Vector\", \"\", \"A\",2,4,1";
        let turned = "P: \"Rotation\", \"Vector\", \"\", \"A\",0,0,90";
        let more = texture(10, "a.png", placed) + &texture(11, "e.png", turned) + &texture(12, "s.png", "");
        let more = more + &texture(13, "n.tga", "") + &texture(14, "gone.jpg", "");
        let connections =
            on(10, "DiffuseColor") + &on(10, "TransparentColor") + &on(11, "EmissiveColor") + &on(12, "SpecularColor");
        let connections = connections + &on(13, "NormalMap");
        let (model, left) = read("", &more, &connections);
        let look = &model.looks[0];
        assert_eq!((look.picture, look.normals, look.glow_picture), (Some(0), None, Some(1)));
        let lie = Lie { offset: [-0.25, 1.0 - 0.25 + 0.0625], scale: [0.5, 0.25], ..Lie::PLAIN };
        assert_eq!((look.lies, look.glow, look.transparent), ([lie, Lie::PLAIN, Lie::PLAIN], [1.0; 3], true));
        let maps = ["EmissiveColor (as they are turned)", "SpecularColor"].map(String::from);
        assert_eq!((left.maps, left.other, left.missing), (maps.into(), vec!["n.tga".to_owned()], vec![]));
        // By their files, not by the texture, which is called after its use.
        assert_eq!(model.pictures.iter().map(|picture| picture.name.as_str()).collect::<Vec<_>>(), ["a", "e"]);
        let glb = String::from_utf8_lossy(&model.into_glb().unwrap()).into_owned();
        assert!(glb.contains(r#""emissiveTexture":{"index":1}"#) && glb.contains("KHR_texture_transform"), "{glb}");
        // By whichever name the file gives, and found by it.
        let absolute = |name: &str| {
            texture(14, name, "").replace(&format!("RelativeFilename: \"{name}\""), "RelativeFilename: \"\"")
        };
        for more in [&more, &absolute("gone.jpg")] {
            let (_, left) = read("", more, &on(14, "DiffuseColor"));
            assert_eq!((left.missing, left.other), (vec!["gone.jpg".to_owned()], vec![]));
        }
        assert_eq!(read("", &absolute("a.png"), &on(14, "DiffuseColor")).0.looks[0].picture, Some(0));
    }

    #[test]
    fn pictures_lie_by_the_coordinates_that_they_name_and_end_where_they_do() {
        let own = |set: &str| {
            format!(
                "P: \"UVSet\", \"KString\", \"\", \"\", \"{set}\"\nP: \"WrapModeU\", \"enum\", \"\", \"\",1\n\
                 P: \"WrapModeV\", \"enum\", \"\", \"\",0"
            )
        };
        let more = texture(10, "a.png", &own("map1")) + &texture(11, "a.png", "");
        let (model, left) = read("", &more, &(on(10, "DiffuseColor") + &on(11, "EmissiveColor")));
        let lie = Lie { set: 1, ends: [true, false], ..Lie::PLAIN };
        assert_eq!((model.looks[0].lies, left.maps.len()), ([lie, Lie::PLAIN, Lie::PLAIN], 0));
        let glb = String::from_utf8_lossy(&model.into_glb().unwrap()).into_owned();
        for part in [
            r#""textures":[{"sampler":0,"source":0},{"sampler":1,"source":0}]"#,
            r#""baseColorTexture":{"index":1,"texCoord":1}"#,
            r#""emissiveTexture":{"index":0}"#,
            r#""wrapS":33071,"wrapT":10497"#,
        ] {
            assert!(glb.contains(part), "{part} in {glb}");
        }
        // One that is not there is the first.
        let told = |set: &str| read("", &texture(10, "a.png", &own(set)), &on(10, "DiffuseColor"));
        assert_eq!(told("gone").0.looks[0].lies[0].set, 0);
        let maps = "DiffuseColor (by the coordinates `gone`, which are not there)".to_owned();
        assert_eq!((told("gone").1.maps, told("default").1.maps.len()), ([maps].into(), 0));
    }

    #[test]
    fn a_material_on_meshes_with_their_sets_in_other_places_is_a_look_for_each() {
        let more = texture(10, "a.png", "P: \"UVSet\", \"KString\", \"\", \"\", \"map1\"");
        let file = String::from_utf8(file("", &more, &on(10, "DiffuseColor"))).unwrap();
        // The mesh once more, with sets of the other's names.
        let start = file.find("Geometry: 2,").unwrap();
        let mesh = file[start..file.find("Geometry: 3,").unwrap()].replace("Geometry: 2,", "Geometry: 4,");
        let mesh = mesh.replace("\"map0\"", "\"mapX\"").replace("\"map1\"", "\"map0\"").replace("\"mapX\"", "\"map1\"");
        let node = "Model: 8, \"Model::other\", \"Mesh\" {\nVersion: 232\n}\n";
        let file = file.replacen("Objects: {\n", &format!("Objects: {{\n{mesh}{node}"), 1);
        let file =
            file.replacen("Connections: {\n", "Connections: {\nC: \"OO\",8,0\nC: \"OO\",4,8\nC: \"OO\",5,8\n", 1);
        let model = super::model("m", file.as_bytes(), find).unwrap().model;
        let sets: Vec<usize> =
            (model.objects.iter()).map(|object| model.looks[object.patches[0].look.unwrap()].lies[0].set).collect();
        assert_eq!((sets.len(), sets.iter().sum::<usize>(), model.looks.len()), (2, 1, 2), "{sets:?}");
    }
}
