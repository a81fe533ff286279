//! A finished GLB as a binary FBX 7.4 file, with all of it that the format has a form for.
//!
//! Nodes keep their names, places and tree: joints are limb nodes, what shows a mesh is a mesh, all else is an
//! empty. What FBX has no form for is told.

mod curves;
mod euler;
mod layers;
mod looks;
mod models;
mod motions;
mod shapes;
mod skins;

use std::collections::BTreeMap;

use fbxcel::writer::v7400::binary::Error;
use thiserror::Error as Fails;

use motions::Motions;

use super::file::{Class, File, file, polygons};
use crate::Fault;
use crate::fbx::file::Value;
use crate::gltf::contents::{Contents, Mesh};
use crate::warning::of_number;
pub(super) use looks::BOTH_SIDES;

/// Why a GLB cannot be written as FBX.
#[derive(Debug, Fails)]
pub enum FbxFault {
    /// What is wrong with the GLB.
    #[error(transparent)]
    Source(#[from] Fault),
    /// It is too large.
    #[error("the FBX would be larger than the format can say (4 GiB): {0}; leave out pictures or meshes")]
    TooLong(String),
}

/// Where the numbers of objects of a kind begin. There are never as many of one as lie between.
const STEP: i64 = 1_000_000_000;

/// What has numbers of its own.
#[derive(Clone, Copy)]
enum Kind {
    Model = 1,
    /// What says that a model is an empty or a limb.
    Attribute,
    /// The mesh of a node that is a joint, which hangs on it as a model of its own.
    Held,
    Geometry,
    Skin,
    Cluster,
    Pose,
    Material,
    Texture,
    Video,
    Shapes,
    Channel,
    Shape,
    Stack,
    Layer,
    CurveNode,
    Curve,
}

/// The number of the `at`th of a kind.
fn id(kind: Kind, at: usize) -> i64 {
    kind as i64 * STEP + at as i64
}

/// A binary FBX 7.4 file.
#[derive(Debug)]
pub struct FbxFile {
    /// It.
    pub bytes: Vec<u8>,
    /// What of its source it has no form for.
    pub left: FbxLeft,
}

/// How much of what a file has no form for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FbxLeft(BTreeMap<&'static str, usize>);

impl FbxLeft {
    /// And that of another file.
    pub fn add(&mut self, other: Self) {
        other.0.into_iter().for_each(|(one, n)| *self.0.entry(one).or_default() += n);
    }

    /// Each in words: `2 occlusion maps`.
    pub fn parts(&self) -> Vec<String> {
        self.0.iter().map(|(one, n)| of_number(*n, one, &plural(one))).collect()
    }

    /// A sentence on it, where there is something.
    pub fn note(&self) -> Option<String> {
        let all = self.parts();
        let (last, others) = all.split_last()?;
        let all = if others.is_empty() { last.clone() } else { format!("{} and {last}", others.join(", ")) };
        Some(format!("not written, as riglab's fbx files hold none: {all}"))
    }
}

/// Of what is counted; of `node of instances` the first word.
fn plural(one: &str) -> String {
    let end = [" of ", " that ", " with "].iter().filter_map(|word| one.find(word)).min().unwrap_or(one.len());
    format!("{}s{}", &one[..end], &one[end..])
}

/// A GLB that lies in one run of bytes as a binary FBX 7.4 file.
///
/// Axes are y up, the unit is the metre, so that numbers stay those of the GLB. Equal bytes make equal bytes. Control
/// characters in names become spaces: the format parts names by them.
///
/// # Errors
/// What is wrong with the GLB, or that the file would be too large.
pub fn glb_to_fbx(glb: &[u8]) -> Result<FbxFile, FbxFault> {
    let contents = Contents::read(glb)?;
    let motions = Motions::new(&contents);
    let bytes = write(&contents, &motions, crate::gltf::said_made_of(glb).as_deref())
        .map_err(|error| FbxFault::TooLong(error.to_string()))?;
    let mut left = contents.left;
    if motions.straightened > 0 {
        left.insert("spline of a motion too long to be sampled", motions.straightened);
    }
    Ok(FbxFile { bytes, left: FbxLeft(left) })
}

fn write(contents: &Contents, motions: &Motions, made_of: Option<&str>) -> Result<Vec<u8>, Error> {
    let clusters: usize = contents.meshes.iter().filter_map(|mesh| mesh.skin.as_ref()).map(|s| s.clusters.len()).sum();
    let skins = contents.meshes.iter().filter(|mesh| mesh.skin.is_some()).count();
    let models = models::count(contents);
    let (shaped, shapes) = shapes::count(contents);
    let [stacks, curve_nodes, curves] = motions.count();
    let kinds = [
        ("GlobalSettings", 1),
        ("Model", models.all),
        ("NodeAttribute", models.attributes),
        ("Geometry", contents.meshes.len() + shapes),
        ("Deformer", skins + clusters + shaped + shapes),
        ("Pose", usize::from(skins > 0)),
        ("Material", contents.looks.len()),
        ("Texture", looks::map_count(contents)),
        ("Video", contents.pictures.len()),
        ("AnimationStack", stacks),
        ("AnimationLayer", stacks),
        ("AnimationCurveNode", curve_nodes),
        ("AnimationCurve", curves),
    ];
    let objects = |file: &mut File| {
        contents.meshes.iter().enumerate().try_for_each(|(number, mesh)| geometry(file, number, mesh))?;
        models::write(file, contents)?;
        skins::write(file, contents)?;
        shapes::write(file, contents)?;
        looks::write(file, contents)?;
        motions.write(file)
    };
    let connections = |file: &mut File| {
        models::connect(file, contents)?;
        skins::connect(file, contents)?;
        shapes::connect(file, contents)?;
        looks::connect(file, contents)?;
        motions.connect(file)
    };
    file(made_of, &kinds, objects, connections)
}

fn geometry(file: &mut File, number: usize, mesh: &Mesh) -> Result<(), Error> {
    let points: Vec<f64> = mesh.points.iter().flatten().map(|&x| x.into()).collect();
    file.object(Class::Geometry, (id(Kind::Geometry, number), &mesh.name, "Mesh"), |file| {
        file.leaf("GeometryVersion", &[Value::Int(124)])?;
        file.leaf("Vertices", &[Value::Doubles(&points)])?;
        file.leaf("PolygonVertexIndex", &[Value::Ints(&polygons(&mesh.triangles))])?;
        layers::write(file, mesh)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_told_in_words() {
        let mut left = FbxLeft(BTreeMap::from([("node of instances", 1), ("camera", 2)]));
        left.add(FbxLeft(BTreeMap::from([("node of instances", 2)])));
        let note = "not written, as riglab's fbx files hold none: 2 cameras and 3 nodes of instances";
        assert_eq!(left.note().unwrap(), note);
        assert_eq!(FbxLeft::default().note(), None);
    }
}
