//! A rig as a binary FBX 7.4 file.

use std::io::{self, Cursor};

use fbxcel::low::FbxVersion;
use fbxcel::low::v7400::ArrayAttributeEncoding;
use fbxcel::writer::v7400::binary::{Error, FbxFooter, Writer};
use riglab_core::{Rig, SkinWeights, Vec3};

/// The three belong together: programs by the format's owner check that the first follows from the second, and
/// that the footer begins with what follows from both. With a fixed time, equal rigs make equal bytes.
const FILE_ID: [u8; 16] =
    [0x28, 0xb3, 0x2a, 0xeb, 0xb6, 0x24, 0xcc, 0xc2, 0xbf, 0xc8, 0xb0, 0x2a, 0xa9, 0x2b, 0xfc, 0xf1];
const CREATION_TIME: &str = "1970-01-01 10:00:00:000";
const FOOTER_ID: [u8; 16] =
    [0xfa, 0xbc, 0xab, 0x09, 0xd0, 0xc8, 0xd4, 0x66, 0xb1, 0x76, 0xfb, 0x83, 0x1c, 0xf7, 0x26, 0x7e];

const CREATOR: &str = concat!("riglab ", env!("CARGO_PKG_VERSION"));

/// What stands between an object's name and its class.
const CLASS: &str = "\0\x01";

/// Numbers of objects. Those of joints count from theirs, a thousand thousands apart: a rig has fewer.
const SCENE: i64 = 1_000_000;
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
    let mut file = File(Writer::new(Cursor::new(Vec::new()), FbxVersion::V7_4)?);
    file.header()?;
    file.settings()?;
    let joints = rig.skeleton().len() as i32;
    file.node("Documents", &[], |file| {
        file.leaf("Count", &[Int(1)])?;
        file.node("Document", &[Long(SCENE), Text(""), Text("Scene")], |file| file.leaf("RootNode", &[Long(0)]))
    })?;
    file.leaf("References", &[])?;
    file.node("Definitions", &[], |file| {
        let kinds = [
            ("GlobalSettings", 1),
            ("Model", joints + 2),
            ("NodeAttribute", joints + 1),
            ("Geometry", 1),
            ("Deformer", joints + 1),
            ("Pose", 1),
        ];
        file.leaf("Version", &[Int(100)])?;
        file.leaf("Count", &[Int(kinds.iter().map(|(_, count)| count).sum())])?;
        for (kind, count) in kinds {
            file.node("ObjectType", &[Text(kind)], |file| file.leaf("Count", &[Int(count)]))?;
        }
        Ok(())
    })?;
    file.node("Objects", &[], |file| {
        file.mesh(rig)?;
        file.skeleton(rig)?;
        file.skin(rig)?;
        file.pose(rig)
    })?;
    file.node("Connections", &[], |file| file.connections(rig))?;
    file.node("Takes", &[], |file| file.leaf("Current", &[Text("")]))?;
    let footer = FbxFooter { unknown1: Some(&FOOTER_ID), ..FbxFooter::default() };
    Ok(file.0.finalize(&footer)?.into_inner())
}

/// A value of a node.
enum Value<'a> {
    Int(i32),
    Long(i64),
    Double(f64),
    Flag(bool),
    Text(&'a str),
    Bytes(&'a [u8]),
    Ints(&'a [i32]),
    Doubles(&'a [f64]),
}
use Value::{Bytes, Double, Doubles, Flag, Int, Ints, Long, Text};

struct File(Writer<Cursor<Vec<u8>>>);

impl File {
    fn node(
        &mut self,
        name: &str,
        values: &[Value<'_>],
        inner: impl FnOnce(&mut Self) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut writer = self.0.new_node(name)?;
        for value in values {
            match *value {
                Int(v) => writer.append_i32(v),
                Long(v) => writer.append_i64(v),
                Double(v) => writer.append_f64(v),
                Flag(v) => writer.append_bool(v),
                Text(v) => writer.append_string_direct(v),
                Bytes(v) => writer.append_binary_direct(v),
                Ints(v) => writer.append_arr_i32_from_iter(encoding(v.len()), v.iter().copied()),
                Doubles(v) => writer.append_arr_f64_from_iter(encoding(v.len()), v.iter().copied()),
            }?;
        }
        inner(self)?;
        self.0.close_node()
    }

    fn leaf(&mut self, name: &str, values: &[Value<'_>]) -> Result<(), Error> {
        self.node(name, values, |_| Ok(()))
    }

    fn header(&mut self) -> Result<(), Error> {
        self.node("FBXHeaderExtension", &[], |file| {
            file.leaf("FBXHeaderVersion", &[Int(1003)])?;
            file.leaf("FBXVersion", &[Int(7400)])?;
            file.leaf("EncryptionType", &[Int(0)])?;
            file.leaf("Creator", &[Text(CREATOR)])
        })?;
        self.leaf("FileId", &[Bytes(&FILE_ID)])?;
        self.leaf("CreationTime", &[Text(CREATION_TIME)])?;
        self.leaf("Creator", &[Text(CREATOR)])
    }

    fn settings(&mut self) -> Result<(), Error> {
        // Axes count x, y, z from 0; the unit is in centimetres.
        let axes = [("Up", 1), ("Front", 2), ("Coord", 0), ("OriginalUp", 1)];
        self.node("GlobalSettings", &[], |file| {
            file.leaf("Version", &[Int(1000)])?;
            file.node("Properties70", &[], |file| {
                for (axis, number) in axes {
                    for (name, value) in [(format!("{axis}Axis"), number), (format!("{axis}AxisSign"), 1)] {
                        file.leaf("P", &[Text(&name), Text("int"), Text("Integer"), Text(""), Int(value)])?;
                    }
                }
                for name in ["UnitScaleFactor", "OriginalUnitScaleFactor"] {
                    file.leaf("P", &[Text(name), Text("double"), Text("Number"), Text(""), Double(100.0)])?;
                }
                Ok(())
            })
        })
    }

    fn mesh(&mut self, rig: &Rig) -> Result<(), Error> {
        let mesh = rig.mesh();
        let points: Vec<f64> = mesh.positions().iter().flatten().map(|&x| x.into()).collect();
        // The last corner of a polygon has its bits turned over.
        let corners: Vec<i32> =
            mesh.triangles().iter().flat_map(|&[a, b, c]| [a as i32, b as i32, !(c as i32)]).collect();
        self.node("Geometry", &[Long(GEOMETRY), Text(&named("mesh", "Geometry")), Text("Mesh")], |file| {
            file.leaf("GeometryVersion", &[Int(124)])?;
            file.leaf("Vertices", &[Doubles(&points)])?;
            file.leaf("PolygonVertexIndex", &[Ints(&corners)])
        })?;
        self.model(MESH, "mesh", "Mesh", [0.0; 3])
    }

    fn skeleton(&mut self, rig: &Rig) -> Result<(), Error> {
        self.attribute(ARMATURE_ATTRIBUTE, "Armature", "Null", "Null")?;
        self.model(ARMATURE, "Armature", "Null", [0.0; 3])?;
        let skeleton = rig.skeleton();
        for joint in skeleton.ids() {
            let (number, name) = (joint.index() as i64, skeleton.name(joint));
            let (head, from) = (skeleton.head(joint), skeleton.parent(joint).map_or([0.0; 3], |p| skeleton.head(p)));
            let translation = std::array::from_fn(|k| f64::from(head[k]) - f64::from(from[k]));
            self.attribute(JOINT_ATTRIBUTES + number, name, "LimbNode", "Skeleton")?;
            self.model(JOINTS + number, name, "LimbNode", translation)?;
        }
        Ok(())
    }

    fn attribute(&mut self, id: i64, name: &str, kind: &str, flags: &str) -> Result<(), Error> {
        self.node("NodeAttribute", &[Long(id), Text(&named(name, "NodeAttribute")), Text(kind)], |file| {
            file.leaf("TypeFlags", &[Text(flags)])
        })
    }

    fn model(&mut self, id: i64, name: &str, kind: &str, [x, y, z]: [f64; 3]) -> Result<(), Error> {
        const TRANSLATION: &str = "Lcl Translation";
        self.node("Model", &[Long(id), Text(&named(name, "Model")), Text(kind)], |file| {
            file.leaf("Version", &[Int(232)])?;
            file.node("Properties70", &[], |file| {
                let kind = [Text(TRANSLATION), Text(TRANSLATION), Text(""), Text("A")];
                file.leaf("P", &kind.into_iter().chain([x, y, z].map(Double)).collect::<Vec<_>>())
            })?;
            file.leaf("Shading", &[Flag(true)])?;
            file.leaf("Culling", &[Text("CullingOff")])
        })
    }

    fn skin(&mut self, rig: &Rig) -> Result<(), Error> {
        self.node("Deformer", &[Long(SKIN), Text(&named("skin", "Deformer")), Text("Skin")], |file| {
            file.leaf("Version", &[Int(101)])?;
            file.leaf("Link_DeformAcuracy", &[Double(50.0)])
        })?;
        let columns = columns(rig.weights(), rig.skeleton().len());
        for (joint, (vertices, weights)) in rig.skeleton().ids().zip(columns) {
            let (name, head) = (rig.skeleton().name(joint), rig.skeleton().head(joint));
            let id = CLUSTERS + joint.index() as i64;
            self.node("Deformer", &[Long(id), Text(&named(name, "SubDeformer")), Text("Cluster")], |file| {
                file.leaf("Version", &[Int(100)])?;
                file.leaf("UserData", &[Text(""), Text("")])?;
                if !vertices.is_empty() {
                    file.leaf("Indexes", &[Ints(&vertices)])?;
                    file.leaf("Weights", &[Doubles(&weights)])?;
                }
                file.leaf("Transform", &[Doubles(&moved(head, -1.0))])?;
                file.leaf("TransformLink", &[Doubles(&moved(head, 1.0))])
            })?;
        }
        Ok(())
    }

    fn pose(&mut self, rig: &Rig) -> Result<(), Error> {
        let joints = (JOINTS..).zip(rig.skeleton().heads().iter().copied());
        let all: Vec<(i64, Vec3)> = [(MESH, [0.0; 3]), (ARMATURE, [0.0; 3])].into_iter().chain(joints).collect();
        self.node("Pose", &[Long(POSE), Text(&named("pose", "Pose")), Text("BindPose")], |file| {
            file.leaf("Type", &[Text("BindPose")])?;
            file.leaf("Version", &[Int(100)])?;
            file.leaf("NbPoseNodes", &[Int(all.len() as i32)])?;
            for (id, place) in all {
                file.node("PoseNode", &[], |file| {
                    file.leaf("Node", &[Long(id)])?;
                    file.leaf("Matrix", &[Doubles(&moved(place, 1.0))])
                })?;
            }
            Ok(())
        })
    }

    /// Which object belongs to which; 0 is the scene's root.
    fn connections(&mut self, rig: &Rig) -> Result<(), Error> {
        let fixed = [(ARMATURE, 0), (ARMATURE_ATTRIBUTE, ARMATURE), (MESH, 0), (GEOMETRY, MESH), (SKIN, GEOMETRY)];
        let skeleton = rig.skeleton();
        let of_joints = skeleton.ids().flat_map(|joint| {
            let number = joint.index() as i64;
            let parent = skeleton.parent(joint).map_or(ARMATURE, |p| JOINTS + p.index() as i64);
            let (node, cluster) = (JOINTS + number, CLUSTERS + number);
            [(node, parent), (JOINT_ATTRIBUTES + number, node), (cluster, SKIN), (node, cluster)]
        });
        for (what, to) in fixed.into_iter().chain(of_joints) {
            self.leaf("C", &[Text("OO"), Long(what), Long(to)])?;
        }
        Ok(())
    }
}

/// Matrices and the like do not get smaller.
fn encoding(values: usize) -> Option<ArrayAttributeEncoding> {
    (values > 64).then_some(ArrayAttributeEncoding::Zlib)
}

/// An object's name with its class.
fn named(name: &str, class: &str) -> String {
    let name = name.replace(|c: char| c.is_control(), " ");
    format!("{name}{CLASS}{class}")
}

/// A translation as a matrix, column by column.
fn moved(by: Vec3, sign: f64) -> [f64; 16] {
    let mut m = [0.0; 16];
    [m[0], m[5], m[10], m[15]] = [1.0; 4];
    for k in 0..3 {
        // Plus 0, for the zero of -x would be negative.
        m[12 + k] = sign * f64::from(by[k]) + 0.0;
    }
    m
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
