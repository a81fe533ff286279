//! Materials, and the pictures that they show.

use std::collections::{HashMap, HashSet};

use serde_json::Value;

use super::Left;
use crate::gltf::accessor::Accessors;
use crate::gltf::export::model::is_picture;
use crate::pictures::for_gltf;

const TINT: &str = "tint of a picture that few programs show";

/// A material.
#[derive(Debug)]
pub(crate) struct Look {
    pub(crate) name: String,
    /// Linear, with alpha, which is 1 where it is not to be seen.
    pub(crate) colour: [f64; 4],
    /// Whether the alpha of the colour's picture is to be seen.
    pub(crate) is_clear: bool,
    /// Linear.
    pub(crate) glow: [f64; 3],
    pub(crate) glow_strength: f64,
    pub(crate) metallic: f64,
    pub(crate) roughness: f64,
    /// How much of the picture of normals is seen.
    pub(crate) bumps: f64,
    /// Whether it is seen from behind as well.
    pub(crate) both_sides: bool,
    pub(crate) maps: Vec<Map>,
}

/// What a picture is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Of {
    Colour,
    Normals,
    Glow,
}

/// A picture on a surface.
#[derive(Debug)]
pub(crate) struct Map {
    pub(crate) of: Of,
    pub(crate) picture: usize,
    /// The set of texture coordinates.
    pub(crate) set: usize,
    /// Whether it ends at its border, along u and v, in place of coming again.
    pub(crate) ends: [bool; 2],
    /// Where coordinates, from the upper left corner, are looked up in it: scaled first, then moved.
    pub(crate) scale: [f64; 2],
    pub(crate) offset: [f64; 2],
}

/// A picture, as PNG or JPEG.
#[derive(Debug)]
pub(crate) struct Picture {
    /// A file's name.
    pub(crate) name: String,
    /// Empty where it is in a file of its own.
    pub(crate) bytes: Vec<u8>,
}

/// Of the number that each image of the document got, if it can be shown.
#[derive(Default)]
struct Pictures {
    all: Vec<Picture>,
    known: HashMap<usize, Option<usize>>,
    /// Names that are taken, in small letters.
    taken: HashSet<String>,
}

/// Materials in the order of the document, with what they show.
pub(super) fn read(json: &Value, accessors: &Accessors<'_>, left: &mut Left) -> (Vec<Look>, Vec<Picture>) {
    // Those of pictures in files of their own are given.
    let images = json["images"].as_array().map_or(&[][..], Vec::as_slice);
    let taken = images.iter().filter_map(outside).map(str::to_lowercase).collect();
    let mut reader = Reader { json, accessors, pictures: Pictures { taken, ..Pictures::default() }, left };
    let materials = json["materials"].as_array().map_or(&[][..], Vec::as_slice);
    let looks = materials.iter().enumerate().map(|(number, material)| reader.look(number, material)).collect();
    (looks, reader.pictures.all)
}

/// The look of a primitive without a material, by the format.
pub(super) fn plain() -> Look {
    Look {
        name: "default".into(),
        colour: [1.0; 4],
        is_clear: false,
        glow: [0.0; 3],
        glow_strength: 1.0,
        metallic: 1.0,
        roughness: 1.0,
        bumps: 1.0,
        both_sides: false,
        maps: Vec::new(),
    }
}

struct Reader<'a, 'd, 'l> {
    json: &'a Value,
    accessors: &'a Accessors<'d>,
    pictures: Pictures,
    left: &'l mut Left,
}

impl Reader<'_, '_, '_> {
    fn count(&mut self, what: &'static str, found: bool) {
        if found {
            *self.left.entry(what).or_default() += 1;
        }
    }

    fn look(&mut self, number: usize, material: &Value) -> Look {
        let plain = plain();
        let pbr = &material["pbrMetallicRoughness"];
        let name = material["name"].as_str().filter(|name| !name.is_empty());
        let has_alpha = ["BLEND", "MASK"].iter().any(|mode| material["alphaMode"] == *mode);
        let mut colour = numbers(&pbr["baseColorFactor"], plain.colour);
        if !has_alpha {
            colour[3] = 1.0;
        }
        let strength = &material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"];
        let mut glow = numbers(&material["emissiveFactor"], plain.glow);
        let mut glow_strength = strength.as_f64().unwrap_or(plain.glow_strength);
        // A picture of what does not glow would glow elsewhere, where the picture is the whole colour.
        let glows = glow_strength > 0.0 && glow.iter().any(|x| *x > 0.0);
        let bumps = material["normalTexture"]["scale"].as_f64().unwrap_or(plain.bumps);
        let maps = [
            (Of::Colour, Some(&pbr["baseColorTexture"])),
            (Of::Normals, Some(&material["normalTexture"]).filter(|_| bumps != 0.0)),
            (Of::Glow, Some(&material["emissiveTexture"]).filter(|_| glows)),
        ];
        let maps: Vec<Map> = maps.into_iter().filter_map(|(of, texture)| self.map(of, texture?)).collect();
        let is_mapped = |of: Of| maps.iter().any(|map| map.of == of);
        if is_mapped(Of::Glow) {
            // How bright it is stays where the colour is not looked at.
            let most = glow.into_iter().fold(0.0, f64::max);
            (glow, glow_strength) = (glow.map(|x| x / most), glow_strength * most);
        }
        // Few programs multiply the two.
        self.count(TINT, is_mapped(Of::Colour) && colour[..3] != [1.0; 3]);
        self.count(TINT, is_mapped(Of::Glow) && glow != [1.0; 3]);
        let metal_map = !pbr["metallicRoughnessTexture"].is_null();
        self.count("metallic-roughness map", metal_map);
        self.count("occlusion map", !material["occlusionTexture"].is_null());
        let is_clear = has_alpha && is_mapped(Of::Colour);
        // Elsewhere what is half clear is so; here it is seen or is not.
        self.count("material with an alpha cutoff", material["alphaMode"] == "MASK" && (is_clear || colour[3] < 1.0));
        self.extensions(material);
        let is_unlit =
            ["KHR_materials_unlit", "VRMC_materials_mtoon"].iter().any(|name| !material["extensions"][name].is_null());
        let metallic = pbr["metallicFactor"].as_f64().unwrap_or(plain.metallic);
        // Where a map alone says how much of a metal it is, and is left, most is none: all of it would be dark.
        let unsaid = metal_map && metallic == 1.0;
        Look {
            name: name.map_or_else(|| format!("material {number}"), str::to_owned),
            is_clear,
            glow,
            glow_strength,
            // What no light falls on is no metal, whatever the format has for one where nothing is said.
            metallic: if is_unlit || unsaid { 0.0 } else { metallic },
            roughness: pbr["roughnessFactor"].as_f64().unwrap_or(1.0),
            bumps,
            both_sides: material["doubleSided"] == true,
            colour,
            maps,
        }
    }

    /// Counts what extensions say of a material.
    fn extensions(&mut self, material: &Value) {
        let names = material["extensions"].as_object().into_iter().flatten().map(|(name, _)| name.as_str());
        let told = ["KHR_materials_emissive_strength"];
        let any = names.clone().any(|name| !told.contains(&name));
        self.count("material with extensions", any);
    }

    fn map(&mut self, of: Of, info: &Value) -> Option<Map> {
        let texture = &self.json["textures"][index(&info["index"])?];
        let picture = self.picture(texture)?;
        let sampler = index(&texture["sampler"]).map_or(&Value::Null, |sampler| &self.json["samplers"][sampler]);
        const ENDS: u64 = 33071;
        const MIRRORED: u64 = 33648;
        let wraps = ["wrapS", "wrapT"].map(|key| sampler[key].as_u64());
        self.count("mirrored repeat of a picture", wraps.contains(&Some(MIRRORED)));
        let transform = &info["extensions"]["KHR_texture_transform"];
        let turned = transform["rotation"].as_f64().is_some_and(|by| by != 0.0);
        self.count("turn of a picture", turned);
        let (mut scale, mut offset) = (numbers(&transform["scale"], [1.0; 2]), numbers(&transform["offset"], [0.0; 2]));
        // A turned one would lie elsewhere; scales of 0 have no way back.
        if turned || scale.contains(&0.0) {
            (scale, offset) = ([1.0; 2], [0.0; 2]);
        }
        let set = index(&transform["texCoord"]).or(index(&info["texCoord"])).unwrap_or(0);
        Some(Map { of, picture, set, ends: wraps.map(|wrap| wrap == Some(ENDS)), scale, offset })
    }

    /// The picture of a texture: of several files the one that all programs read.
    fn picture(&mut self, texture: &Value) -> Option<usize> {
        let others = ["EXT_texture_webp", "MSFT_texture_dds", "KHR_texture_basisu", "EXT_texture_avif"];
        let others = others.map(|name| index(&texture["extensions"][name]["source"]));
        let mut found = None;
        for image in [index(&texture["source"])].into_iter().chain(others).flatten() {
            found = found.or_else(|| self.image(image));
        }
        self.count("picture of a kind that is not read", found.is_none());
        found
    }

    fn image(&mut self, number: usize) -> Option<usize> {
        if let Some(known) = self.pictures.known.get(&number) {
            return *known;
        }
        let image = &self.json["images"][number];
        let own = index(&image["bufferView"]).and_then(|view| self.accessors.view(view, String::new).ok());
        let bytes = own.and_then(|view| for_gltf("", view.bytes.to_vec()));
        let found = match (bytes, outside(image)) {
            (Some(bytes), _) => Some(self.embedded(number, image["name"].as_str(), bytes)),
            (None, Some(uri)) => Some(Picture { name: uri.to_owned(), bytes: Vec::new() }),
            (None, None) => None,
        };
        let place = found.map(|picture| {
            self.pictures.all.push(picture);
            self.pictures.all.len() - 1
        });
        self.pictures.known.insert(number, place);
        place
    }

    /// Called as the image is, or after its number; no two alike, for programs write them into one folder.
    fn embedded(&mut self, number: usize, name: Option<&str>, bytes: Vec<u8>) -> Picture {
        debug_assert!(is_picture(&bytes));
        let ending = if bytes.starts_with(b"\x89PNG") { "png" } else { "jpg" };
        let plain = |c: char| if c.is_control() || "/\\:*?\"<>|".contains(c) { '_' } else { c };
        let own: String = name.unwrap_or_default().chars().take(80).map(plain).collect();
        let own = own.strip_suffix(".png").or(own.strip_suffix(".jpg")).or(own.strip_suffix(".jpeg")).unwrap_or(&own);
        let own = if own.is_empty() { format!("picture {number}") } else { own.to_owned() };
        let mut name = format!("{own}.{ending}");
        let mut again = number..;
        while !self.pictures.taken.insert(name.to_lowercase()) {
            name = format!("{own} {}.{ending}", again.next().unwrap_or_default());
        }
        Picture { name, bytes }
    }
}

/// The name of a picture in a file of its own.
fn outside(image: &Value) -> Option<&str> {
    image["uri"].as_str().filter(|uri| !uri.starts_with("data:"))
}

/// A number that names something.
fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|n| usize::try_from(n).ok())
}

/// Numbers of a list; `else_` where it has others than so many.
fn numbers<const N: usize>(list: &Value, else_: [f64; N]) -> [f64; N] {
    let all: Option<Vec<f64>> = list.as_array().and_then(|all| all.iter().map(Value::as_f64).collect());
    all.and_then(|all| all.try_into().ok()).unwrap_or(else_)
}
