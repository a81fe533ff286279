//! What the corners of a mesh have beside their points.

use fbxcel::writer::v7400::binary::Error;

use crate::fbx::file::File;
use crate::fbx::file::Value::{Doubles, Int, Ints, Text};
use crate::gltf::contents::{Layer, Mesh};
use crate::rigging::encoded;

/// An element of a layer: its name in the file, and its number among those of its kind.
type Element = (&'static str, usize);

/// What a set of texture coordinates is called; textures name it.
pub(super) fn coordinates_name(set: usize) -> String {
    numbered("UVMap", set)
}

fn numbered(name: &str, number: usize) -> String {
    if number == 0 { name.to_owned() } else { format!("{name}{}", number + 1) }
}

pub(super) fn write(file: &mut File, mesh: &Mesh) -> Result<(), Error> {
    let mut elements: Vec<Element> = Vec::new();
    if !mesh.normals.is_empty() {
        let values: Vec<f64> = mesh.normals.iter().flatten().map(|&x| x.into()).collect();
        element(file, &mut elements, ("LayerElementNormal", 0), ["", "ByPolygonVertex", "Direct"], |file| {
            file.leaf("Normals", &[Doubles(&values)])
        })?;
    }
    for (number, layer) in mesh.coordinates.iter().enumerate() {
        // From the lower left corner.
        let values: Vec<f64> = layer.values.iter().flat_map(|&[u, v]| [f64::from(u), 1.0 - f64::from(v)]).collect();
        let name = coordinates_name(number);
        let mapped = [&name[..], "ByPolygonVertex", "IndexToDirect"];
        element(file, &mut elements, ("LayerElementUV", number), mapped, |file| {
            file.leaf("UV", &[Doubles(&values)])?;
            file.leaf("UVIndex", &[Ints(&indices(layer))])
        })?;
    }
    for (number, layer) in mesh.colours.iter().enumerate() {
        // Of light as pictures have it; the alpha is a share.
        let encoded = |&[r, g, b, a]: &[f32; 4]| [encoded(r), encoded(g), encoded(b), a].map(f64::from);
        let values: Vec<f64> = layer.values.iter().flat_map(encoded).collect();
        let name = numbered("Color", number);
        let mapped = [&name[..], "ByPolygonVertex", "IndexToDirect"];
        element(file, &mut elements, ("LayerElementColor", number), mapped, |file| {
            file.leaf("Colors", &[Doubles(&values)])?;
            file.leaf("ColorIndex", &[Ints(&indices(layer))])
        })?;
    }
    if !mesh.looks.is_empty() {
        let slots: Vec<i32> = mesh.slots.iter().map(|&slot| slot as i32).collect();
        let mapped = ["", "ByPolygon", "IndexToDirect"];
        element(file, &mut elements, ("LayerElementMaterial", 0), mapped, |file| {
            file.leaf("Materials", &[Ints(&slots)])
        })?;
    }
    list(file, &elements)
}

fn indices<const N: usize>(layer: &Layer<N>) -> Vec<i32> {
    layer.indices.iter().map(|&at| at as i32).collect()
}

/// An element, with how its values go to corners.
fn element(
    file: &mut File,
    elements: &mut Vec<Element>,
    own: Element,
    [name, mapping, reference]: [&str; 3],
    values: impl FnOnce(&mut File) -> Result<(), Error>,
) -> Result<(), Error> {
    elements.push(own);
    file.node(own.0, &[Int(own.1 as i32)], |file| {
        file.leaf("Version", &[Int(101)])?;
        file.leaf("Name", &[Text(name)])?;
        file.leaf("MappingInformationType", &[Text(mapping)])?;
        file.leaf("ReferenceInformationType", &[Text(reference)])?;
        values(file)
    })
}

/// The layers: each has one element of a kind at most.
fn list(file: &mut File, elements: &[Element]) -> Result<(), Error> {
    for layer in 0..elements.iter().map(|(_, number)| number + 1).max().unwrap_or(0) {
        file.node("Layer", &[Int(layer as i32)], |file| {
            file.leaf("Version", &[Int(100)])?;
            for (kind, number) in elements.iter().filter(|(_, number)| *number == layer) {
                file.node("LayerElement", &[], |file| {
                    file.leaf("Type", &[Text(kind)])?;
                    file.leaf("TypedIndex", &[Int(*number as i32)])
                })?;
            }
            Ok(())
        })?;
    }
    Ok(())
}
