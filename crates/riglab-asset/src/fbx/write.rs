//! A rig alone as a binary FBX 7.4 file.

use std::io;

use fbxcel::writer::v7400::binary::Error;
use glam::{DAffine3, DVec3};
use riglab_core::{Rig, SkinWeights, Vec3};

use super::file::Value::{Doubles, Int, Ints};
use super::file::{Class, File, Property, file, polygons};

/// Numbers of objects. Those of joints count from theirs, a thousand thousands apart: a rig has fewer.
const ARMATURE: i64 = 2_000_000;
const ARMATURE_ATTRIBUTE: i64 = 3_000_000;
const MESH: i64 = 4_000_000;
const GEOMETRY: i64 = 5_000_000;
const SKIN: i64 = 6_000_000;
const POSE: i64 = 7_000_000;
const JOINTS: i64 = 10_000_000;
const JOINT_ATTRIBUTES: i64 = 20_000_000;
const CLUSTERS: i64 = 30_000_000;

/// The rig as a binary FBX 7.4 file: one mesh, a limb node a joint below an empty, one skin with a cluster a joint,
/// and a bind pose.
///
/// Axes are y up, the unit is the metre, so that coordinates stay those of the rig; numbers are doubles, nothing
/// is rounded. Joints have no orientation of their own, as in [`Rig`]. Equal rigs make equal bytes. Control
/// characters in names become spaces: the format parts names by them.
///
/// # Errors
/// Where the file would be larger than the format can tell (4 GiB).
pub fn to_fbx(rig: &Rig) -> io::Result<Vec<u8>> {
    write(rig).map_err(|error| io::Error::other(error.to_string()))
}

fn write(rig: &Rig) -> Result<Vec<u8>, Error> {
    let joints = rig.skeleton().len();
    let kinds = [
        ("GlobalSettings", 1),
        ("Model", joints + 2),
        ("NodeAttribute", joints + 1),
        ("Geometry", 1),
        ("Deformer", joints + 1),
        ("Pose", 1),
    ];
    let objects = |file: &mut File| {
        mesh(file, rig)?;
        skeleton(file, rig)?;
        skin(file, rig)?;
        pose(file, rig)
    };
    file(&kinds, objects, |file| connections(file, rig))
}

fn mesh(file: &mut File, rig: &Rig) -> Result<(), Error> {
    let mesh = rig.mesh();
    let points: Vec<f64> = mesh.positions().iter().flatten().map(|&x| x.into()).collect();
    file.object(Class::Geometry, (GEOMETRY, "mesh", "Mesh"), |file| {
        file.leaf("GeometryVersion", &[Int(124)])?;
        file.leaf("Vertices", &[Doubles(&points)])?;
        file.leaf("PolygonVertexIndex", &[Ints(&polygons(mesh.triangles()))])
    })?;
    model(file, (MESH, "mesh", "Mesh"), [0.0; 3])
}

fn skeleton(file: &mut File, rig: &Rig) -> Result<(), Error> {
    file.attribute(ARMATURE_ATTRIBUTE, "Armature", "Null", "Null")?;
    model(file, (ARMATURE, "Armature", "Null"), [0.0; 3])?;
    let skeleton = rig.skeleton();
    for joint in skeleton.ids() {
        let (number, name) = (joint.index() as i64, skeleton.name(joint));
        let (head, from) = (skeleton.head(joint), skeleton.parent(joint).map_or([0.0; 3], |p| skeleton.head(p)));
        let translation = std::array::from_fn(|k| f64::from(head[k]) - f64::from(from[k]));
        file.attribute(JOINT_ATTRIBUTES + number, name, "LimbNode", "Skeleton")?;
        model(file, (JOINTS + number, name, "LimbNode"), translation)?;
    }
    Ok(())
}

fn model(file: &mut File, what: (i64, &str, &str), at: [f64; 3]) -> Result<(), Error> {
    file.model(what, &[("Lcl Translation", Property::Placing(at))])
}

fn skin(file: &mut File, rig: &Rig) -> Result<(), Error> {
    file.skin(SKIN)?;
    let columns = columns(rig.weights(), rig.skeleton().len());
    for (joint, (vertices, weights)) in rig.skeleton().ids().zip(columns) {
        let (name, head) = (rig.skeleton().name(joint), rig.skeleton().head(joint));
        let id = CLUSTERS + joint.index() as i64;
        file.cluster((id, name), (&vertices, &weights), [&moved(head, -1.0), &moved(head, 1.0), &DAffine3::IDENTITY])?;
    }
    Ok(())
}

fn pose(file: &mut File, rig: &Rig) -> Result<(), Error> {
    let joints = (JOINTS..).zip(rig.skeleton().heads().iter().copied());
    let all = [(MESH, [0.0; 3]), (ARMATURE, [0.0; 3])].into_iter().chain(joints);
    file.bind_pose(POSE, &all.map(|(id, place)| (id, moved(place, 1.0))).collect::<Vec<_>>())
}

fn connections(file: &mut File, rig: &Rig) -> Result<(), Error> {
    let fixed = [(ARMATURE, 0), (ARMATURE_ATTRIBUTE, ARMATURE), (MESH, 0), (GEOMETRY, MESH), (SKIN, GEOMETRY)];
    let skeleton = rig.skeleton();
    let of_joints = skeleton.ids().flat_map(|joint| {
        let number = joint.index() as i64;
        let parent = skeleton.parent(joint).map_or(ARMATURE, |p| JOINTS + p.index() as i64);
        let (node, cluster) = (JOINTS + number, CLUSTERS + number);
        [(node, parent), (JOINT_ATTRIBUTES + number, node), (cluster, SKIN), (node, cluster)]
    });
    fixed.into_iter().chain(of_joints).try_for_each(|(what, to)| file.connect(what, to))
}

/// A translation.
fn moved(by: Vec3, sign: f64) -> DAffine3 {
    DAffine3::from_translation(sign * DVec3::from(by.map(f64::from)))
}

/// Vertices and weights by joint.
fn columns(weights: &SkinWeights, joints: usize) -> Vec<(Vec<i32>, Vec<f64>)> {
    let mut columns = vec![(Vec::new(), Vec::new()); joints];
    for v in 0..weights.rows() {
        for (joint, weight) in weights.row(v) {
            let (vertices, weights) = &mut columns[joint.index()];
            vertices.push(v as i32);
            weights.push(f64::from(weight));
        }
    }
    columns
}
