//! What binds meshes to joints, and where all stood then.

use std::collections::BTreeMap;

use fbxcel::writer::v7400::binary::Error;
use glam::DAffine3;

use super::{Kind, id, models};
use crate::fbx::file::File;
use crate::gltf::contents::{Contents, Skin};

/// Meshes with their skins, and the number of each one's first cluster.
fn skins(contents: &Contents) -> impl Iterator<Item = (usize, &Skin, usize)> {
    let bound = contents.meshes.iter().enumerate().filter_map(|(number, mesh)| Some((number, mesh.skin.as_ref()?)));
    bound.scan(0, |first, (number, skin)| {
        let own = *first;
        *first += skin.clusters.len();
        Some((number, skin, own))
    })
}

pub(super) fn write(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (mesh, skin, first) in skins(contents) {
        let above = above(contents, skin);
        file.skin(id(Kind::Skin, mesh))?;
        for (cluster, number) in skin.clusters.iter().zip(first..) {
            let points: Vec<i32> = cluster.points.iter().map(|&point| point as i32).collect();
            let name = &contents.nodes[cluster.node].name;
            let of = (&points[..], &cluster.weights[..]);
            file.cluster((id(Kind::Cluster, number), name), of, [&cluster.to_joint, &cluster.bind, &above])?;
        }
    }
    match &pose(contents)[..] {
        [] => Ok(()),
        places => file.bind_pose(id(Kind::Pose, 0), places),
    }
}

/// From what the skeleton of a skin hangs on to the scene.
fn above(contents: &Contents, skin: &Skin) -> DAffine3 {
    let mut at = skin.clusters.first().map(|cluster| cluster.node);
    let mut highest = at;
    while let Some(node) = at {
        at = contents.nodes[node].parent;
        highest = at.filter(|above| contents.nodes[*above].is_joint).or(highest);
    }
    let above = highest.and_then(|joint| contents.nodes[joint].parent);
    above.map_or(DAffine3::IDENTITY, |node| contents.nodes[node].rest)
}

pub(super) fn connect(file: &mut File, contents: &Contents) -> Result<(), Error> {
    for (mesh, skin, first) in skins(contents) {
        file.connect(id(Kind::Skin, mesh), id(Kind::Geometry, mesh))?;
        for (cluster, number) in skin.clusters.iter().zip(first..) {
            file.connect(id(Kind::Cluster, number), id(Kind::Skin, mesh))?;
            file.connect(id(Kind::Model, cluster.node), id(Kind::Cluster, number))?;
        }
    }
    Ok(())
}

/// Where bound meshes, their joints and all nodes above either stood; programs want those as well.
fn pose(contents: &Contents) -> Vec<(i64, DAffine3)> {
    let mut places: BTreeMap<i64, DAffine3> = BTreeMap::new();
    for (number, node) in contents.nodes.iter().enumerate() {
        let Some(skin) = node.mesh.and_then(|mesh| contents.meshes[mesh].skin.as_ref()) else { continue };
        for start in skin.clusters.iter().map(|cluster| cluster.node).chain([number]) {
            let mut at = Some(start);
            while let Some(own) = at {
                if places.insert(id(Kind::Model, own), contents.nodes[own].rest).is_some() {
                    break;
                }
                at = contents.nodes[own].parent;
            }
        }
    }
    // Last, for a mesh may be above another's joints.
    for (number, node) in contents.nodes.iter().enumerate() {
        if let Some(skin) = node.mesh.and_then(|mesh| contents.meshes[mesh].skin.as_ref()) {
            places.insert(models::shows(contents, number), skin.map);
        }
    }
    places.into_iter().collect()
}
