//! Materials, and the pictures that they show.

use std::collections::{HashMap, HashSet};

use ufbx::{Material, MaterialMap, Mesh, Texture, WrapMode};

use super::document::BOTH_SIDES;
use super::model::{Left, unit};
use super::shown;
use crate::gltf::export::model::{Lie, Look, Picture};
use crate::pictures::for_gltf;
use crate::rigging::stem;

/// Pictures by texture.
pub(super) struct Pictures<F> {
    find: F,
    known: HashMap<u32, Option<usize>>,
    /// By the contents of files.
    made: HashMap<[u8; 32], usize>,
    pub(super) found: Vec<Picture>,
    pub(super) left: Left,
}

impl<F: Fn(&str) -> Option<Vec<u8>>> Pictures<F> {
    /// None so far; `find` gives the contents of one by its name, and `left` is what else is not taken over.
    pub(super) fn new(find: F, left: Left) -> Self {
        Self { find, known: HashMap::new(), made: HashMap::new(), found: Vec::new(), left }
    }

    fn number(&mut self, map: &MaterialMap) -> Option<usize> {
        let texture: &Texture = map.texture.as_deref().filter(|_| map.texture_enabled)?;
        let key = texture.element.element_id;
        if let Some(known) = self.known.get(&key) {
            return *known;
        }
        let embedded: &[u8] = texture.content.as_ref();
        let names = [&texture.relative_filename, &texture.filename, &texture.absolute_filename];
        let names = names.map(|name| name.to_string());
        let name = names.iter().find(|name| !name.is_empty()).map_or("", String::as_str);
        // Exporters call textures after what they are for, many of one file alike.
        let of_files = names.iter().map(|name| stem(name)).find(|stem| !stem.is_empty());
        let called = of_files.unwrap_or_else(|| texture.element.name.to_string());
        let mut number = self.made(&called, name, embedded);
        let mut there = !embedded.is_empty();
        if number.is_none()
            && let Some(bytes) = names.iter().find_map(|name| (self.find)(name))
        {
            there = true;
            number = self.made(&called, name, &bytes);
        }
        if number.is_none() {
            let left = if there { &mut self.left.other } else { &mut self.left.missing };
            left.push(name.to_owned());
        }
        self.known.insert(key, number);
        number
    }

    /// The number of a picture by its contents, which several textures may have; `None` of what is none.
    fn made(&mut self, called: &str, name: &str, bytes: &[u8]) -> Option<usize> {
        let key = *blake3::hash(bytes).as_bytes();
        if let Some(known) = self.made.get(&key) {
            return Some(*known);
        }
        let bytes = for_gltf(name, bytes.to_vec())?;
        self.found.push(Picture { name: called.to_owned(), bytes });
        self.made.insert(key, self.found.len() - 1);
        Some(self.found.len() - 1)
    }

    /// The picture of a map and how it lies, by whichever set of coordinates; turned ones lie straight, which is told.
    fn placed(&mut self, map: &MaterialMap, property: &str) -> (Option<usize>, Lie) {
        let (Some(picture), Some(texture)) = (self.number(map), map.texture.as_deref()) else {
            return (None, Lie::PLAIN);
        };
        let m = &texture.uv_to_texture;
        let mut lie = Lie::PLAIN;
        if texture.has_uv_transform && m.m01.abs().max(m.m10.abs()) > 1e-6 * m.m00.abs().max(m.m11.abs()) {
            self.left.maps.insert(format!("{property} (as they are turned)"));
        } else if texture.has_uv_transform {
            lie = Lie::from_below([m.m00 as f32, m.m11 as f32], [m.m03 as f32, m.m13 as f32]);
        }
        (Some(picture), Lie { ends: [texture.wrap_u, texture.wrap_v].map(|wrap| wrap == WrapMode::Clamp), ..lie })
    }
}

/// How much of a surface is seen, from 0 to 1. Old materials say so as an opacity, or as a colour that is seen through them
/// times a factor; of several what hides most counts. 1 where a file hides all, as files do that mean nothing by it.
fn alpha(material: &Material) -> f32 {
    let fbx = &material.fbx;
    let mut all = vec![1.0];
    let pbr = &material.pbr.opacity;
    all.extend(pbr.has_value.then_some(pbr.value_vec4.x));
    all.extend(material.element.props.find_prop("Opacity").map(|opacity| opacity.value_vec4.x));
    let colour = &fbx.transparency_color;
    if colour.has_value && colour.texture.is_none() {
        let c = colour.value_vec4;
        let factor = if fbx.transparency_factor.has_value { fbx.transparency_factor.value_vec4.x } else { 1.0 };
        all.push(1.0 - factor * (c.x + c.y + c.z) / 3.0);
    }
    let least = all.into_iter().filter(|a| a.is_finite() && *a > 0.0).fold(1.0, f64::min);
    unit(least)
}

/// What of a light or of bumps is told: more than 1 as well, which surfaces cannot be.
fn amount(x: f64) -> f32 {
    if (x as f32).is_finite() { x.max(0.0) as f32 } else { 0.0 }
}

/// The maps that pictures are taken of, in the order of [`Look::lies`], with the names of their properties.
fn mapped(material: &Material) -> [(&MaterialMap, &'static str); 3] {
    let pbr = &material.pbr;
    [(&pbr.base_color, "DiffuseColor"), (&pbr.normal_map, "NormalMap"), (&pbr.emission_color, "EmissiveColor")]
}

/// Looks by material and by the sets of coordinates that its pictures lie by: meshes have those of one name in other places.
pub(super) struct Looks<'a> {
    /// Those of the materials first, in their order.
    pub(super) all: Vec<Look>,
    materials: Vec<&'a Material>,
    known: HashMap<(usize, [usize; 3]), usize>,
}

impl<'a> Looks<'a> {
    /// Of materials with the look of each.
    pub(super) fn new(all: Vec<Look>, materials: Vec<&'a Material>) -> Self {
        Self { all, materials, known: HashMap::new() }
    }

    /// The look of a material on a mesh. A set that is not there is the first, which is told in `left`.
    pub(super) fn on(&mut self, number: usize, mesh: &Mesh, left: &mut Left) -> usize {
        let Some(&material) = self.materials.get(number) else { return number };
        let sets = mapped(material).map(|(map, property)| {
            // What is called so where nobody chose.
            let named = map.texture.as_deref().map_or("", |texture| &texture.uv_set);
            let named = Some(named).filter(|name| !["", "default"].contains(name) && mesh.uv_sets.len() > 1);
            let at = |name: &str| (&mesh.uv_sets).into_iter().position(|set| *set.name == *name);
            named.map_or(0, |name| {
                at(name).unwrap_or_else(|| {
                    left.maps.insert(format!("{property} (by the coordinates `{}`, which are not there)", shown(name)));
                    0
                })
            })
        });
        if let Some(&known) = self.known.get(&(number, sets)) {
            return known;
        }
        let is_first = !self.known.keys().any(|(known, _)| *known == number);
        let place = if is_first { number } else { self.all.len() };
        if !is_first {
            self.all.push(self.all[number].clone());
        }
        self.all[place].lies.iter_mut().zip(sets).for_each(|(lie, set)| lie.set = set);
        self.known.insert((number, sets), place);
        place
    }
}

/// What a material shows, with its pictures; `is_ours` where riglab wrote the file, of whose properties more is known.
pub(super) fn look<F>(material: &Material, pictures: &mut Pictures<F>, is_ours: bool) -> Look
where
    F: Fn(&str) -> Option<Vec<u8>>,
{
    let plain = Look::plain(&material.element.name);
    let pbr = &material.pbr;
    let number = |map: &MaterialMap| map.has_value.then(|| unit(map.value_vec4.x));
    let [(picture, colour_lies), (normals, normals_lie), (glow_picture, glow_lies)] =
        mapped(material).map(|(map, property)| pictures.placed(map, property));
    let colour = pbr.base_color.has_value.then_some(pbr.base_color.value_vec4).map(|c| [c.x, c.y, c.z].map(unit));
    // Where there is a picture, it is the colour: few programs multiply the two.
    let [r, g, b] = match picture {
        Some(_) => [1.0; 3],
        None => colour.unwrap_or([0.8; 3]),
    };
    let alpha = alpha(material);
    // The picture of the colour once more: its alpha.
    let key = |map: &MaterialMap| map.texture.as_deref().map(|texture| texture.element.element_id);
    let clear = [&pbr.opacity, &material.fbx.transparency_color, &material.fbx.transparency_factor];
    let by_picture =
        picture.is_some() && clear.iter().any(|map| key(map).is_some() && key(map) == key(&pbr.base_color));
    let taken: HashSet<u32> =
        [&pbr.base_color, &pbr.normal_map, &pbr.emission_color].into_iter().filter_map(key).collect();
    for of in (&material.textures).into_iter().filter(|of| !taken.contains(&of.texture.element.element_id)) {
        pictures.left.maps.insert(shown(&of.material_prop));
    }
    let told = |map: &MaterialMap| map.has_value.then_some(map.value_vec4);
    let strength = told(&pbr.emission_factor).map_or(1.0, |factor| factor.x);
    let glow = told(&pbr.emission_color).map_or([0.0; 3], |c| [c.x, c.y, c.z]);
    // As with the colour.
    let glow = if glow_picture.is_some() { [1.0; 3] } else { glow };
    // Elsewhere it says how much is mirrored, which is not how much of a metal it is; Blender's files ufbx knows.
    let metalness = if is_ours { &material.fbx.reflection_factor } else { &pbr.metalness };
    // Programs that know nothing of bumps say 0.
    let bumps = told(&material.fbx.bump_factor).map(|factor| amount(factor.x)).filter(|bumps| *bumps > 0.0);
    let both_sides = material.element.props.find_prop(BOTH_SIDES).is_some_and(|told| told.value_int != 0);
    Look {
        colour: [r, g, b, alpha],
        picture,
        normals,
        glow_picture,
        lies: [colour_lies, normals_lie, glow_lies],
        bumps: bumps.unwrap_or(plain.bumps),
        both_sides,
        glow: glow.map(|x| amount(x * strength)),
        metallic: number(metalness).unwrap_or(0.0),
        roughness: number(&pbr.roughness).unwrap_or(plain.roughness),
        transparent: alpha < 1.0 || by_picture,
        ..plain
    }
}
