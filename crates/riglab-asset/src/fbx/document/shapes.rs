//! Blend shapes: a deformer for each mesh that has some, and a channel with a shape for each of them.

use fbxcel::writer::v7400::binary::Error;

use super::{Kind, id};
use crate::fbx::file::Value::{Double, Doubles, Int, Ints};
use crate::fbx::file::{Class, File, Property};
use crate::gltf::contents::{Contents, Shape};

/// What full weight is in the format.
pub(super) const FULL: f64 = 100.0;

/// The number of each mesh's first shape among all.
pub(super) fn firsts(contents: &Contents) -> Vec<usize> {
    let count = |first: &mut usize, n: usize| Some(std::mem::replace(first, *first + n));
    contents.meshes.iter().map(|mesh| mesh.shapes.len()).scan(0, count).collect()
}

/// How many deformers there are, and how many shapes.
pub(super) fn count(contents: &Contents) -> (usize, usize) {
    let having = contents.meshes.iter().filter(|mesh| !mesh.shapes.is_empty()).count();
    (having, contents.meshes.iter().map(|mesh| mesh.shapes.len()).sum())
}

pub(super) fn write(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (number, (mesh, first)) in contents.meshes.iter().zip(firsts(contents)).enumerate() {
        if mesh.shapes.is_empty() {
            continue;
        }
        file.object(Class::Deformer, (id(Kind::Shapes, number), &mesh.name, "BlendShape"), |file| {
            file.leaf("Version", &[Int(100)])
        })?;
        for (shape, own) in mesh.shapes.iter().zip(first..) {
            channel(file, own, shape)?;
            geometry(file, own, shape)?;
        }
    }
    Ok(())
}

fn channel(file: &mut File, number: usize, shape: &Shape) -> Result<(), Error> {
    let percent = FULL * shape.weight;
    file.object(Class::SubDeformer, (id(Kind::Channel, number), &shape.name, "BlendShapeChannel"), |file| {
        file.leaf("Version", &[Int(100)])?;
        file.leaf("DeformPercent", &[Double(percent)])?;
        file.properties(&[("DeformPercent", Property::Number(percent))])?;
        file.leaf("FullWeights", &[Doubles(&[FULL])])
    })
}

/// What is added to points and normals.
fn geometry(file: &mut File, number: usize, shape: &Shape) -> Result<(), Error> {
    let doubles = |all: &[[f32; 3]]| -> Vec<f64> { all.iter().flatten().map(|&x| x.into()).collect() };
    let points: Vec<i32> = shape.points.iter().map(|&point| point as i32).collect();
    file.object(Class::Geometry, (id(Kind::Shape, number), &shape.name, "Shape"), |file| {
        file.leaf("Version", &[Int(100)])?;
        file.leaf("Indexes", &[Ints(&points)])?;
        file.leaf("Vertices", &[Doubles(&doubles(&shape.offsets))])?;
        match shape.has_normals {
            true => file.leaf("Normals", &[Doubles(&doubles(&shape.normals))]),
            false => Ok(()),
        }
    })
}

pub(super) fn connect(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (number, (mesh, first)) in contents.meshes.iter().zip(firsts(contents)).enumerate() {
        if mesh.shapes.is_empty() {
            continue;
        }
        file.connect(id(Kind::Shapes, number), id(Kind::Geometry, number))?;
        for own in first..first + mesh.shapes.len() {
            file.connect(id(Kind::Channel, own), id(Kind::Shapes, number))?;
            file.connect(id(Kind::Shape, own), id(Kind::Channel, own))?;
        }
    }
    Ok(())
}
