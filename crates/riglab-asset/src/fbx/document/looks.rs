//! Materials as Phong's, with the pictures that they show.

use fbxcel::writer::v7400::binary::Error;

use super::{Kind, id, layers};
use crate::fbx::file::Value::{Bytes, Double, Int, Text};
use crate::fbx::file::{Class, File, Property, class_name};
use crate::gltf::contents::{Contents, Look, Map, Of, Picture};

/// Whether a material is seen from behind as well. The format has no property for it, and what models say of culling is the
/// same in nearly all files: this one is riglab's.
pub(in crate::fbx) const BOTH_SIDES: &str = "DoubleSided";

/// Maps of all materials, each with its material's number.
fn maps(contents: &Contents) -> impl Iterator<Item = (usize, &Map)> {
    contents.looks.iter().enumerate().flat_map(|(look, own)| own.maps.iter().map(move |map| (look, map)))
}

pub(super) fn map_count(contents: &Contents) -> usize {
    maps(contents).count()
}

pub(super) fn write(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (number, look) in contents.looks.iter().enumerate() {
        material(file, number, look)?;
    }
    for (number, (_, map)) in maps(contents).enumerate() {
        texture(file, number, map, &contents.pictures[map.picture])?;
    }
    contents.pictures.iter().enumerate().try_for_each(|(number, picture)| video(file, number, picture))
}

/// What programs read of a material: roughness as shininess and metallic as reflection, as Blender has it, opacity in both of
/// the ways that there are.
fn material(file: &mut File, number: usize, look: &Look) -> Result<(), Error> {
    let [r, g, b, alpha] = look.colour;
    let shininess = 100.0 * (1.0 - look.roughness).max(0.0).powi(2);
    file.object(Class::Material, (id(Kind::Material, number), &look.name, ""), |file| {
        file.leaf("Version", &[Int(102)])?;
        file.leaf("ShadingModel", &[Text("phong")])?;
        file.leaf("MultiLayer", &[Int(0)])?;
        let mut all = vec![
            ("DiffuseColor", Property::Colour([r, g, b])),
            ("DiffuseFactor", Property::Number(1.0)),
            ("EmissiveColor", Property::Colour(look.glow)),
            ("EmissiveFactor", Property::Number(look.glow_strength)),
            ("TransparentColor", Property::Colour([1.0; 3])),
            ("TransparencyFactor", Property::Number(1.0 - alpha)),
            ("Opacity", Property::Number(alpha)),
            ("SpecularColor", Property::Colour([1.0; 3])),
            ("SpecularFactor", Property::Number(0.25)),
            ("Shininess", Property::Number(shininess)),
            ("ShininessExponent", Property::Number(shininess)),
            ("ReflectionFactor", Property::Number(look.metallic)),
        ];
        // Without a picture of normals Blender would make a place for one.
        let has_bumps = look.maps.iter().any(|map| map.of == Of::Normals);
        all.extend(has_bumps.then_some(("BumpFactor", Property::Number(look.bumps))));
        all.extend(look.both_sides.then_some((BOTH_SIDES, Property::Yes(true))));
        file.properties(&all)
    })
}

fn texture(file: &mut File, number: usize, map: &Map, picture: &Picture) -> Result<(), Error> {
    let name = stem(&picture.name);
    // From the lower left corner. What is scaled here is the picture, not where it is looked up.
    let scale = map.scale.map(|s| 1.0 / s);
    let below = [map.offset[0], 1.0 - map.scale[1] - map.offset[1]];
    let moved = [-below[0] * scale[0], -below[1] * scale[1]].map(|x| x + 0.0);
    let wrap = map.ends.map(|ends| Property::Choice(ends.into()));
    file.object(Class::Texture, (id(Kind::Texture, number), name, ""), |file| {
        file.leaf("Type", &[Text("TextureVideoClip")])?;
        file.leaf("Version", &[Int(202)])?;
        file.leaf("TextureName", &[Text(&class_name(name, "Texture"))])?;
        file.leaf("Media", &[Text(&class_name(name, "Video"))])?;
        file.leaf("FileName", &[Text(&picture.name)])?;
        file.leaf("RelativeFilename", &[Text(&picture.name)])?;
        file.properties(&[
            ("UVSet", Property::Words(&layers::coordinates_name(map.set))),
            ("UseMaterial", Property::Yes(true)),
            ("WrapModeU", wrap[0]),
            ("WrapModeV", wrap[1]),
            ("Translation", Property::Vector([moved[0], moved[1], 0.0])),
            ("Scaling", Property::Vector([scale[0], scale[1], 1.0])),
        ])?;
        file.leaf("ModelUVTranslation", &[Double(0.0), Double(0.0)])?;
        file.leaf("ModelUVScaling", &[Double(1.0), Double(1.0)])?;
        file.leaf("Texture_Alpha_Source", &[Text("None")])?;
        file.leaf("Cropping", &[Int(0), Int(0), Int(0), Int(0)])
    })
}

fn video(file: &mut File, number: usize, picture: &Picture) -> Result<(), Error> {
    file.object(Class::Video, (id(Kind::Video, number), stem(&picture.name), "Clip"), |file| {
        file.leaf("Type", &[Text("Clip")])?;
        file.properties(&[("Path", Property::Path(&picture.name))])?;
        file.leaf("UseMipMap", &[Int(0)])?;
        file.leaf("Filename", &[Text(&picture.name)])?;
        file.leaf("RelativeFilename", &[Text(&picture.name)])?;
        if picture.bytes.is_empty() {
            return Ok(());
        }
        file.leaf("Content", &[Bytes(&picture.bytes)])
    })
}

/// Without what stands after the dot.
fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Pictures with their maps, maps with materials. Materials with the models of nodes that show them, in the order of the mesh's
/// slots.
pub(super) fn connect(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (number, (look, map)) in maps(contents).enumerate() {
        let (texture, material) = (id(Kind::Texture, number), id(Kind::Material, look));
        let property = match map.of {
            Of::Colour => "DiffuseColor",
            Of::Normals => "NormalMap",
            Of::Glow => "EmissiveColor",
        };
        file.connect_property(texture, material, property)?;
        if map.of == Of::Colour && contents.looks[look].is_clear {
            file.connect_property(texture, material, "TransparentColor")?;
        }
        file.connect(id(Kind::Video, map.picture), texture)?;
    }
    for (number, node) in contents.nodes.iter().enumerate() {
        for &look in node.mesh.into_iter().flat_map(|mesh| &contents.meshes[mesh].looks) {
            file.connect(id(Kind::Material, look), super::models::shows(contents, number))?;
        }
    }
    Ok(())
}
