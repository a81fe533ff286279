//! Nodes as models.

use fbxcel::writer::v7400::binary::Error;
use glam::DVec3;

use super::{Kind, euler, id};
use crate::fbx::file::{File, Property};
use crate::gltf::contents::{Contents, Node};

/// How many there are.
pub(super) struct Count {
    pub(super) all: usize,
    pub(super) attributes: usize,
}

pub(super) fn count(contents: &Contents) -> Count {
    let held = contents.nodes.iter().filter(|node| is_held(node)).count();
    let meshes = contents.nodes.iter().filter(|node| kind(node) == "Mesh").count();
    Count { all: contents.nodes.len() + held, attributes: contents.nodes.len() - meshes }
}

/// Whether a node's mesh hangs below it: a model is a limb or a mesh.
fn is_held(node: &Node) -> bool {
    node.is_joint && node.mesh.is_some()
}

/// Which kind of model a node is.
fn kind(node: &Node) -> &'static str {
    match (node.is_joint, node.mesh) {
        (true, _) => "LimbNode",
        (false, Some(_)) => "Mesh",
        (false, None) => "Null",
    }
}

/// The model that shows the mesh of a node.
pub(super) fn shows(contents: &Contents, node: usize) -> i64 {
    let kind = if is_held(&contents.nodes[node]) { Kind::Held } else { Kind::Model };
    id(kind, node)
}

pub(super) fn write(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (number, node) in contents.nodes.iter().enumerate() {
        match kind(node) {
            "LimbNode" => file.attribute(id(Kind::Attribute, number), &node.name, "LimbNode", "Skeleton")?,
            "Null" => file.attribute(id(Kind::Attribute, number), &node.name, "Null", "Null")?,
            _ => {}
        }
        let turn = euler::of(node.turn);
        model(file, (id(Kind::Model, number), &node.name, kind(node)), [node.at, turn, node.scale], node.hidden)?;
        if let Some(mesh) = node.mesh.filter(|_| is_held(node)) {
            let own = (id(Kind::Held, number), &contents.meshes[mesh].name[..], "Mesh");
            model(file, own, [DVec3::ZERO, DVec3::ZERO, DVec3::ONE], node.hidden)?;
        }
    }
    Ok(())
}

/// A model with its place; angles in degrees.
fn model(file: &mut File, what: (i64, &str, &str), [at, turn, scale]: [DVec3; 3], hidden: bool) -> Result<(), Error> {
    /// Of how a place goes down the tree: what is below is scaled by what is above as a whole, as in glTF.
    const WHOLE: i32 = 1;
    let placing = |v: DVec3| Property::Placing(v.to_array().map(|x| x + 0.0));
    let mut properties = vec![
        ("InheritType", Property::Choice(WHOLE)),
        ("Lcl Translation", placing(at)),
        ("Lcl Rotation", placing(turn)),
        ("Lcl Scaling", placing(scale)),
    ];
    properties.extend(hidden.then_some(("Visibility", Property::Shown(false))));
    file.model(what, &properties)
}

/// Models with what is above them, what they are and what they show.
pub(super) fn connect(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (number, node) in contents.nodes.iter().enumerate() {
        let own = id(Kind::Model, number);
        file.connect(own, node.parent.map_or(0, |above| id(Kind::Model, above)))?;
        if kind(node) != "Mesh" {
            file.connect(id(Kind::Attribute, number), own)?;
        }
        if is_held(node) {
            file.connect(shows(contents, number), own)?;
        }
        if let Some(mesh) = node.mesh {
            file.connect(id(Kind::Geometry, mesh), shows(contents, number))?;
        }
    }
    Ok(())
}
