//! A document of a model that comes from another format: surfaces with their looks, and no rig.

use std::collections::{BTreeSet, HashMap, HashSet};

use glam::{DAffine3, DQuat, DVec3};
use serde_json::{Value, json};

use super::draft::{ARRAY, Draft, ELEMENTS, F32, Layout, SCALAR, U32, VEC4};
use super::packed::picture_type;
use super::place::{add_child, hide};
use crate::maker::MAKER;

/// The extension that says how much brighter than white something glows.
const BRIGHTNESS: &str = "KHR_materials_emissive_strength";

/// What a sampler says of a picture's border.
const REPEATED: u32 = 10497;
const CLAMPED: u32 = 33071;

/// Textures by picture and the ways in which it ends along u and v.
type Textures = HashMap<(usize, [bool; 2]), usize>;

/// What other formats say of a model.
#[derive(Debug, Default)]
pub(crate) struct Model {
    pub(crate) name: String,
    pub(crate) objects: Vec<Object>,
    pub(crate) groups: Vec<Group>,
    pub(crate) looks: Vec<Look>,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) swings: Vec<Swing>,
}

/// A motion of blend shapes.
#[derive(Debug)]
pub(crate) struct Swing {
    pub(crate) name: String,
    /// Frames a second.
    pub(crate) rate: f32,
    pub(crate) frames: usize,
    /// Of each object that it moves, by its number, the weights of all its shapes, frame by frame.
    pub(crate) weights: Vec<(usize, Vec<f32>)>,
}

/// A node without a mesh.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) name: String,
    /// The one that it hangs on, which comes before it.
    pub(crate) parent: Option<usize>,
    /// Where it stands there, turned but in no other size. Those that objects hang on are in the scene's space.
    pub(crate) place: DAffine3,
}

/// A mesh on a node of its own, in the scene's space.
#[derive(Debug)]
pub(crate) struct Object {
    pub(crate) name: String,
    /// What it hangs on.
    pub(crate) group: Option<usize>,
    /// Whether the file holds it and does not show it.
    pub(crate) hidden: bool,
    pub(crate) patches: Vec<Patch>,
    pub(crate) shapes: Vec<Shape>,
}

/// A blend shape: what it adds to positions and normals at its full weight.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    pub(crate) name: String,
    /// How much of it is seen where nothing says otherwise.
    pub(crate) weight: f32,
    /// By patch, the vertices that it moves, rising, and how.
    pub(crate) offsets: Vec<Vec<(u32, [f32; 3])>>,
    /// The same of normals; nothing where it leaves them alone.
    pub(crate) normals: Vec<Vec<(u32, [f32; 3])>>,
}

impl Shape {
    /// Whether it says something of normals.
    fn bends(&self) -> bool {
        self.normals.iter().any(|own| !own.is_empty())
    }
}

/// Triangles of one look. Lists other than positions are empty or as long as those.
#[derive(Debug, Default)]
pub(crate) struct Patch {
    pub(crate) positions: Vec<[f32; 3]>,
    /// Of unit length.
    pub(crate) normals: Vec<[f32; 3]>,
    /// From the upper left corner of the picture.
    pub(crate) coordinates: Vec<[f32; 2]>,
    pub(crate) colours: Vec<[f32; 4]>,
    /// Further sets of either.
    pub(crate) more_coordinates: Vec<Vec<[f32; 2]>>,
    pub(crate) more_colours: Vec<Vec<[f32; 4]>>,
    pub(crate) indices: Vec<u32>,
    pub(crate) look: Option<usize>,
}

/// A material.
#[derive(Clone, Debug)]
pub(crate) struct Look {
    pub(crate) name: String,
    /// Linear, with alpha.
    pub(crate) colour: [f32; 4],
    /// Pictures, by number.
    pub(crate) picture: Option<usize>,
    pub(crate) normals: Option<usize>,
    pub(crate) glow_picture: Option<usize>,
    /// How each of those three lies on the surface.
    pub(crate) lies: [Lie; 3],
    /// Linear; more than 1 is brighter than white.
    pub(crate) glow: [f32; 3],
    /// How much of the picture of normals is seen.
    pub(crate) bumps: f32,
    /// Whether it is seen from behind as well.
    pub(crate) both_sides: bool,
    pub(crate) metallic: f32,
    pub(crate) roughness: f32,
    /// Whether the alpha of colour and picture is to be seen.
    pub(crate) transparent: bool,
}

/// How a picture lies on a surface: where texture coordinates are looked up in it, from its upper left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lie {
    pub(crate) offset: [f32; 2],
    pub(crate) scale: [f32; 2],
    /// The set of texture coordinates.
    pub(crate) set: usize,
    /// Whether it ends at its border, along u and v, in place of coming again.
    pub(crate) ends: [bool; 2],
}

impl Lie {
    pub(crate) const PLAIN: Self = Self { offset: [0.0; 2], scale: [1.0; 2], set: 0, ends: [false; 2] };

    /// Of a scale and an offset after it, both of coordinates from the lower left corner; plain where they say nothing.
    pub(crate) fn from_below([su, sv]: [f32; 2], [u, v]: [f32; 2]) -> Self {
        let lie = Self { offset: [u, 1.0 - sv - v], scale: [su, sv], ..Self::PLAIN };
        let sound = [lie.offset, lie.scale].as_flattened().iter().all(|x| x.is_finite()) && su != 0.0 && sv != 0.0;
        if sound { lie } else { Self::PLAIN }
    }

    /// Whether coordinates are looked up elsewhere than they say.
    fn is_moved(&self) -> bool {
        (self.offset, self.scale) != (Self::PLAIN.offset, Self::PLAIN.scale)
    }
}

impl Look {
    /// Grey and rough.
    pub(crate) fn plain(name: &str) -> Self {
        Self {
            name: name.into(),
            colour: [0.8, 0.8, 0.8, 1.0],
            picture: None,
            normals: None,
            glow_picture: None,
            lies: [Lie::PLAIN; 3],
            glow: [0.0; 3],
            bumps: 1.0,
            both_sides: false,
            metallic: 0.0,
            roughness: 0.8,
            transparent: false,
        }
    }

    /// All pictures that it names.
    fn pictures(&mut self) -> [&mut Option<usize>; 3] {
        [&mut self.picture, &mut self.normals, &mut self.glow_picture]
    }

    /// Of the brightest of the colours that it glows in.
    fn brightness(&self) -> f32 {
        self.glow.into_iter().fold(0.0, f32::max)
    }

    /// The pictures that it shows, and how they lie.
    fn shown(&self) -> impl Iterator<Item = (usize, Lie)> {
        let pictures = [self.picture, self.normals, self.glow_picture];
        pictures.into_iter().zip(self.lies).filter_map(|(picture, lie)| Some((picture?, lie)))
    }

    /// Whether a picture lies on the surface otherwise than texture coordinates say.
    fn is_placed(&self) -> bool {
        self.shown().any(|(_, lie)| lie.is_moved())
    }
}

/// A picture's file, of a kind that glTF knows.
#[derive(Debug)]
pub(crate) struct Picture {
    pub(crate) name: String,
    pub(crate) bytes: Vec<u8>,
}

/// Whether glTF without extensions can hold a picture.
pub(crate) fn is_picture(bytes: &[u8]) -> bool {
    matches!(picture_type(bytes), Some("image/png" | "image/jpeg"))
}

impl Model {
    /// Gives patches that have no texture coordinates looks without pictures, which glTF asks coordinates for. Pictures that
    /// nothing shows then go. How many patches there were.
    pub(crate) fn drop_unplaced_pictures(&mut self) -> usize {
        let mut pictured: Vec<bool> =
            self.looks.iter_mut().map(|look| look.pictures().iter().any(|picture| picture.is_some())).collect();
        pictured.push(false);
        let none = self.looks.len();
        let patches = || self.objects.iter().flat_map(|object| &object.patches);
        let placed: HashSet<usize> = patches().filter(|p| !p.coordinates.is_empty()).filter_map(|p| p.look).collect();
        let unplaced = |patch: &Patch| patch.coordinates.is_empty() && pictured[patch.look.unwrap_or(none)];
        let mut bare: HashMap<usize, usize> = HashMap::new();
        let mut count = 0;
        for patch in self.objects.iter_mut().flat_map(|object| &mut object.patches).filter(|patch| unplaced(patch)) {
            let Some(look) = patch.look else { continue };
            count += 1;
            patch.look = Some(*bare.entry(look).or_insert_with(|| {
                let mut own = Look { lies: [Lie::PLAIN; 3], ..self.looks[look].clone() };
                own.pictures().into_iter().for_each(|picture| *picture = None);
                if placed.contains(&look) {
                    self.looks.push(own);
                    return self.looks.len() - 1;
                }
                self.looks[look] = own;
                look
            }));
        }
        if count > 0 {
            self.drop_unnamed_pictures();
        }
        count
    }

    fn drop_unnamed_pictures(&mut self) {
        let named: HashSet<usize> = self.looks.iter_mut().flat_map(Look::pictures).filter_map(|of| *of).collect();
        let mut numbers: HashMap<usize, usize> = HashMap::new();
        let all = std::mem::take(&mut self.pictures).into_iter().enumerate();
        for (number, picture) in all.filter(|(number, _)| named.contains(number)) {
            numbers.insert(number, self.pictures.len());
            self.pictures.push(picture);
        }
        for of in self.looks.iter_mut().flat_map(Look::pictures) {
            *of = of.and_then(|number| numbers.get(&number).copied());
        }
    }

    /// As a GLB; its length where that is more than the format can say.
    pub(crate) fn into_glb(self) -> Result<Vec<u8>, usize> {
        let mut draft = Draft::new(json!({"asset": {"version": "2.0", "generator": MAKER}, "scene": 0}));
        let textures = self.textures(&mut draft);
        if self.looks.iter().any(Look::is_placed) {
            draft.uses("KHR_texture_transform");
        }
        if self.looks.iter().any(|look| look.brightness() > 1.0) {
            draft.uses(BRIGHTNESS);
        }
        for look in &self.looks {
            draft.push("materials", material(look, &textures));
        }
        let mut nodes = Vec::with_capacity(self.objects.len());
        for object in &self.objects {
            let mut patches: Vec<Value> = object.patches.iter().map(|patch| primitive(&mut draft, patch)).collect();
            // Programs expect all shapes of a mesh to say it, or none.
            let bend = object.shapes.iter().any(Shape::bends);
            for ((own, patch), at) in patches.iter_mut().zip(&object.patches).zip(0..) {
                let count = patch.positions.len();
                let target = |shape: &Shape| {
                    let mut target = json!({"POSITION": offsets(&mut draft, count, shape.offsets.get(at))});
                    if bend && !patch.normals.is_empty() {
                        target["NORMAL"] = json!(offsets(&mut draft, count, shape.normals.get(at)));
                    }
                    target
                };
                let targets: Vec<Value> = object.shapes.iter().map(target).collect();
                if !targets.is_empty() {
                    own["targets"] = json!(targets);
                }
            }
            let mut mesh = json!({"name": object.name, "primitives": patches});
            if !object.shapes.is_empty() {
                // Where programs look for the names.
                let names: Vec<&str> = object.shapes.iter().map(|shape| shape.name.as_str()).collect();
                mesh["extras"] = json!({"targetNames": names});
            }
            if object.shapes.iter().any(|shape| shape.weight != 0.0) {
                mesh["weights"] = json!(object.shapes.iter().map(|shape| shape.weight).collect::<Vec<_>>());
            }
            let mesh = draft.push("meshes", mesh);
            let node = draft.push("nodes", json!({"name": object.name, "mesh": mesh}));
            if object.hidden {
                hide(&mut draft, node);
            }
            nodes.push(node);
        }
        for swing in &self.swings {
            let input = draft.times(swing.frames, swing.rate);
            let (mut samplers, mut channels): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
            for (object, weights) in &swing.weights {
                let bytes: Vec<u8> = weights.iter().flat_map(|weight| weight.to_le_bytes()).collect();
                let output = draft.accessor(&bytes, SCALAR, None);
                channels
                    .push(json!({"sampler": samplers.len(), "target": {"node": nodes[*object], "path": "weights"}}));
                samplers.push(json!({"input": input, "output": output, "interpolation": "LINEAR"}));
            }
            draft.push("animations", json!({"name": swing.name, "samplers": samplers, "channels": channels}));
        }
        let groups: Vec<usize> = self.groups.iter().map(|group| draft.push("nodes", group.node())).collect();
        let mut roots = Vec::new();
        let above = self.objects.iter().map(|object| object.group).chain(self.groups.iter().map(|group| group.parent));
        for (&node, group) in nodes.iter().chain(&groups).zip(above) {
            match group {
                Some(group) => add_child(&mut draft.list_mut("nodes")[groups[group]], node),
                None => roots.push(node),
            }
        }
        let mut scene = json!({"nodes": roots});
        if !self.name.is_empty() {
            scene["name"] = json!(self.name);
        }
        draft.push("scenes", scene);
        draft.into_glb()
    }

    /// Adds the pictures, each with a texture for each way in which materials let it end.
    fn textures(&self, draft: &mut Draft) -> Textures {
        let mut ends: Vec<BTreeSet<[bool; 2]>> = vec![BTreeSet::new(); self.pictures.len()];
        for (picture, lie) in self.looks.iter().flat_map(Look::shown) {
            ends[picture].insert(lie.ends);
        }
        // What is shown by none is there all the same.
        for own in ends.iter_mut().filter(|own| own.is_empty()) {
            own.insert(Lie::PLAIN.ends);
        }
        let samplers: BTreeSet<[bool; 2]> = ends.iter().flatten().copied().collect();
        let mut textures = Textures::new();
        for (number, (picture, ends)) in self.pictures.iter().zip(ends).enumerate() {
            let view = draft.view(&picture.bytes, None, None);
            let kind = picture_type(&picture.bytes);
            let image = draft.push("images", json!({"name": picture.name, "bufferView": view, "mimeType": kind}));
            for ends in ends {
                let sampler = samplers.range(..ends).count();
                let texture = draft.push("textures", json!({"source": image, "sampler": sampler}));
                textures.insert((number, ends), texture);
            }
        }
        for ends in samplers {
            // Repeated, with mipmaps: what OBJ and FBX mean where they say nothing.
            let [s, t] = ends.map(|ends| if ends { CLAMPED } else { REPEATED });
            draft.push("samplers", json!({"wrapS": s, "wrapT": t, "minFilter": 9987, "magFilter": 9729}));
        }
        textures
    }
}

impl Group {
    fn node(&self) -> Value {
        let mut node = json!({"name": self.name});
        let (_, turn, at) = self.place.to_scale_rotation_translation();
        if at != DVec3::ZERO {
            node["translation"] = json!(at.as_vec3().to_array());
        }
        if turn != DQuat::IDENTITY {
            node["rotation"] = json!(turn.normalize().as_quat().to_array());
        }
        node
    }
}

fn primitive(draft: &mut Draft, patch: &Patch) -> Value {
    let mut attributes = json!({"POSITION": draft.vectors(&patch.positions, true, Some(ARRAY))});
    if !patch.normals.is_empty() {
        attributes["NORMAL"] = json!(draft.vectors(&patch.normals, false, Some(ARRAY)));
    }
    let layout = || Layout { component: F32, shape: "VEC2", size: 8 };
    for (set, number) in numbered(&patch.coordinates, &patch.more_coordinates) {
        attributes[format!("TEXCOORD_{number}")] = json!(floats(draft, set.as_flattened(), layout()));
    }
    for (set, number) in numbered(&patch.colours, &patch.more_colours) {
        attributes[format!("COLOR_{number}")] = json!(floats(draft, set.as_flattened(), VEC4));
    }
    let corners: Vec<u8> = patch.indices.iter().flat_map(|v| v.to_le_bytes()).collect();
    let layout = Layout { component: U32, shape: "SCALAR", size: 4 };
    let mut own = json!({"attributes": attributes, "indices": draft.accessor(&corners, layout, Some(ELEMENTS))});
    if let Some(look) = patch.look {
        own["material"] = json!(look);
    }
    own
}

/// The first set, if there is one, and further ones, with their numbers.
fn numbered<'a, T>(first: &'a [T], more: &'a [Vec<T>]) -> impl Iterator<Item = (&'a [T], usize)> {
    let first = Some(first).filter(|set| !set.is_empty());
    first.into_iter().chain(more.iter().map(Vec::as_slice)).zip(0..)
}

/// An accessor of what is added to `count` positions or normals, with those alone that are moved.
fn offsets(draft: &mut Draft, count: usize, moved: Option<&Vec<(u32, [f32; 3])>>) -> usize {
    let moved = moved.map_or(&[][..], Vec::as_slice);
    let bound = |pick: fn(f32, f32) -> f32| -> [f32; 3] {
        // What is not moved is 0.
        let start = if moved.len() < count { 0.0 } else { moved.first().map_or(0.0, |_| f32::NAN) };
        std::array::from_fn(|k| moved.iter().map(|(_, by)| by[k]).fold(start, pick))
    };
    let mut accessor = json!({
        "componentType": F32, "type": "VEC3", "count": count, "min": bound(f32::min), "max": bound(f32::max),
    });
    if !moved.is_empty() {
        let numbers: Vec<u8> = moved.iter().flat_map(|(vertex, _)| vertex.to_le_bytes()).collect();
        let values: Vec<u8> = moved.iter().flat_map(|(_, by)| *by).flat_map(f32::to_le_bytes).collect();
        let (numbers, values) = (draft.view(&numbers, None, None), draft.view(&values, None, None));
        accessor["sparse"] = json!({
            "count": moved.len(),
            "indices": {"bufferView": numbers, "componentType": U32},
            "values": {"bufferView": values},
        });
    }
    draft.push("accessors", accessor)
}

fn floats(draft: &mut Draft, all: &[f32], layout: Layout) -> usize {
    let bytes: Vec<u8> = all.iter().flat_map(|x| x.to_le_bytes()).collect();
    draft.accessor(&bytes, layout, Some(ARRAY))
}

fn texture(picture: usize, lie: Lie, textures: &Textures) -> Value {
    let mut info = json!({"index": textures[&(picture, lie.ends)]});
    if lie.set > 0 {
        info["texCoord"] = json!(lie.set);
    }
    if lie.is_moved() {
        info["extensions"] = json!({"KHR_texture_transform": {"offset": lie.offset, "scale": lie.scale}});
    }
    info
}

fn material(look: &Look, textures: &Textures) -> Value {
    let [colour_lies, normals_lie, glow_lies] = look.lies;
    let mut surface = json!({
        "baseColorFactor": look.colour,
        "metallicFactor": look.metallic,
        "roughnessFactor": look.roughness,
    });
    if let Some(picture) = look.picture {
        surface["baseColorTexture"] = texture(picture, colour_lies, textures);
    }
    let mut all = json!({"name": look.name, "pbrMetallicRoughness": surface});
    if let Some(picture) = look.normals {
        all["normalTexture"] = texture(picture, normals_lie, textures);
        if look.bumps != 1.0 {
            all["normalTexture"]["scale"] = json!(look.bumps);
        }
    }
    if let Some(picture) = look.glow_picture {
        all["emissiveTexture"] = texture(picture, glow_lies, textures);
    }
    if look.glow != [0.0; 3] {
        // A factor is 1 at most.
        let over = look.brightness().max(1.0);
        all["emissiveFactor"] = json!(look.glow.map(|x| x / over));
        if over > 1.0 {
            all["extensions"] = json!({BRIGHTNESS: {"emissiveStrength": over}});
        }
    }
    if look.both_sides {
        all["doubleSided"] = json!(true);
    }
    if look.transparent {
        all["alphaMode"] = json!("BLEND");
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_texture_coordinates_gets_no_picture() {
        let patch = |look: usize, mapped: bool| Patch {
            positions: vec![[0.0; 3]; 3],
            coordinates: if mapped { vec![[0.0; 2]; 3] } else { Vec::new() },
            look: Some(look),
            ..Patch::default()
        };
        let look = |picture: Option<usize>| Look { picture, ..Look::plain("cloth") };
        let picture = |name: &str| Picture { name: name.into(), bytes: Vec::new() };
        let patches = vec![patch(0, true), patch(0, false), patch(1, false), patch(2, false), patch(1, false)];
        let mut model = Model {
            objects: vec![Object { name: String::new(), group: None, hidden: false, patches, shapes: Vec::new() }],
            looks: vec![look(Some(1)), look(Some(0)), look(None)],
            pictures: vec![picture("hidden"), picture("shown")],
            ..Model::default()
        };
        assert_eq!(model.drop_unplaced_pictures(), 3);
        let looks: Vec<_> = model.objects[0].patches.iter().map(|patch| patch.look.unwrap()).collect();
        assert_eq!(looks, [0, 3, 1, 2, 1]);
        assert_eq!(model.looks.iter().map(|look| look.picture).collect::<Vec<_>>(), [Some(0), None, None, None]);
        let names: Vec<_> = model.pictures.iter().map(|picture| picture.name.as_str()).collect();
        assert_eq!(names, ["shown"]);
        assert_eq!(model.drop_unplaced_pictures(), 0, "once is enough");
    }
}
