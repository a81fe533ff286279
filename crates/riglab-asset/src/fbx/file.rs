//! Binary FBX 7.4 as nested nodes with values: what all files that are written have in common.

use std::io::Cursor;

use fbxcel::low::FbxVersion;
use fbxcel::low::v7400::ArrayAttributeEncoding;
use fbxcel::writer::v7400::binary::{Error, FbxFooter, Writer};
use glam::DAffine3;

/// The three belong together: programs by the format's owner check that the first follows from the second, and
/// that the footer begins with what follows from both. With a fixed time, equal rigs make equal bytes.
const FILE_ID: [u8; 16] =
    [0x28, 0xb3, 0x2a, 0xeb, 0xb6, 0x24, 0xcc, 0xc2, 0xbf, 0xc8, 0xb0, 0x2a, 0xa9, 0x2b, 0xfc, 0xf1];
const CREATION_TIME: &str = "1970-01-01 10:00:00:000";
const FOOTER_ID: [u8; 16] =
    [0xfa, 0xbc, 0xab, 0x09, 0xd0, 0xc8, 0xd4, 0x66, 0xb1, 0x76, 0xfb, 0x83, 0x1c, 0xf7, 0x26, 0x7e];

const CREATOR: &str = concat!("riglab ", env!("CARGO_PKG_VERSION"));

/// Where a file says which one it was made of: a word of riglab's own, which others pass over.
const MADE_OF: &str = "MadeOf";

/// What binary files end in.
pub(crate) const END: [u8; 16] =
    [0xf8, 0x5a, 0x8c, 0x6a, 0xde, 0xf5, 0xd9, 0x7e, 0xec, 0xe9, 0x0c, 0xe3, 0x75, 0x8f, 0x29, 0x0b];

/// What a file that starts like this says it was made of.
pub(crate) fn made_of(start: &[u8]) -> Option<String> {
    // Behind the name stand the kind of the value, its length, and it.
    let named = [MADE_OF.as_bytes(), b"S"].concat();
    let at = start.windows(named.len()).position(|word| word == named)? + named.len();
    let length = u32::from_le_bytes(*start.get(at..)?.first_chunk()?) as usize;
    let value = start.get(at + 4..)?.get(..length)?;
    Some(String::from_utf8_lossy(value).into_owned())
}

/// What stands between an object's name and its class.
const CLASS: &str = "\0\x01";

/// The number of the scene, among those of objects.
const SCENE: i64 = 1_000_000;

/// A value of a node.
#[derive(Clone, Copy)]
pub(super) enum Value<'a> {
    Int(i32),
    Long(i64),
    Double(f64),
    Flag(bool),
    Text(&'a str),
    Bytes(&'a [u8]),
    Ints(&'a [i32]),
    Longs(&'a [i64]),
    Floats(&'a [f32]),
    Doubles(&'a [f64]),
}
use Value::{Bytes, Double, Doubles, Flag, Floats, Int, Ints, Long, Longs, Text};

/// What a property of an object says. The format has two names for most kinds.
#[derive(Clone, Copy)]
pub(super) enum Property<'a> {
    /// Parts of a node's own transform, which motions may change.
    Placing([f64; 3]),
    /// Whether a node is shown, and what is below it.
    Shown(bool),
    Vector([f64; 3]),
    Colour([f64; 3]),
    /// What motions may change.
    Number(f64),
    Double(f64),
    Whole(i32),
    Choice(i32),
    Yes(bool),
    Words(&'a str),
    Path(&'a str),
    Time(i64),
}

pub(super) struct File(Writer<Cursor<Vec<u8>>>);

/// A file: header and settings, then how many objects of each kind there are (`kinds`), the objects and their connections.
/// `made_of`: the file that it says it was made of.
pub(super) fn file(
    made_of: Option<&str>,
    kinds: &[(&str, usize)],
    objects: impl FnOnce(&mut File) -> Result<(), Error>,
    connections: impl FnOnce(&mut File) -> Result<(), Error>,
) -> Result<Vec<u8>, Error> {
    let mut file = File(Writer::new(Cursor::new(Vec::new()), FbxVersion::V7_4)?);
    file.header(made_of)?;
    file.settings()?;
    file.node("Documents", &[], |file| {
        file.leaf("Count", &[Int(1)])?;
        file.node("Document", &[Long(SCENE), Text(""), Text("Scene")], |file| file.leaf("RootNode", &[Long(0)]))
    })?;
    file.leaf("References", &[])?;
    file.node("Definitions", &[], |file| {
        let kinds: Vec<(&str, i32)> = kinds.iter().map(|&(kind, count)| (kind, count as i32)).collect();
        file.leaf("Version", &[Int(100)])?;
        file.leaf("Count", &[Int(kinds.iter().map(|(_, count)| count).sum())])?;
        for (kind, count) in kinds.into_iter().filter(|(_, count)| *count > 0) {
            file.node("ObjectType", &[Text(kind)], |file| file.leaf("Count", &[Int(count)]))?;
        }
        Ok(())
    })?;
    file.node("Objects", &[], objects)?;
    file.node("Connections", &[], connections)?;
    file.node("Takes", &[], |file| file.leaf("Current", &[Text("")]))?;
    let footer = FbxFooter { unknown1: Some(&FOOTER_ID), ..FbxFooter::default() };
    Ok(file.0.finalize(&footer)?.into_inner())
}

impl File {
    pub(super) fn node(
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
                Longs(v) => writer.append_arr_i64_from_iter(encoding(v.len()), v.iter().copied()),
                Floats(v) => writer.append_arr_f32_from_iter(encoding(v.len()), v.iter().copied()),
                Doubles(v) => writer.append_arr_f64_from_iter(encoding(v.len()), v.iter().copied()),
            }?;
        }
        inner(self)?;
        self.0.close_node()
    }

    pub(super) fn leaf(&mut self, name: &str, values: &[Value<'_>]) -> Result<(), Error> {
        self.node(name, values, |_| Ok(()))
    }

    /// An object of a class; `kind` says which of the class.
    pub(super) fn object(
        &mut self,
        class: Class,
        (id, name, kind): (i64, &str, &str),
        inner: impl FnOnce(&mut Self) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (node, of) = class.names();
        self.node(node, &[Long(id), Text(&class_name(name, of)), Text(kind)], inner)
    }

    pub(super) fn properties(&mut self, all: &[(&str, Property<'_>)]) -> Result<(), Error> {
        self.node("Properties70", &[], |file| {
            all.iter().try_for_each(|(name, property)| file.property(name, *property))
        })
    }

    fn property(&mut self, name: &str, property: Property<'_>) -> Result<(), Error> {
        let mut of = |kind: &str, label: &str, flags: &str, values: &[Value<'_>]| {
            let head = [Text(name), Text(kind), Text(label), Text(flags)];
            self.leaf("P", &head.iter().chain(values).copied().collect::<Vec<_>>())
        };
        match property {
            // Each is a kind of its own.
            Property::Placing(v) => of(name, "", "A", &v.map(Double)),
            Property::Shown(v) => of(name, "", "A", &[Double(v.into())]),
            Property::Vector(v) => of("Vector", "", "A", &v.map(Double)),
            Property::Colour(v) => of("Color", "", "A", &v.map(Double)),
            Property::Number(v) => of("Number", "", "A", &[Double(v)]),
            Property::Double(v) => of("double", "Number", "", &[Double(v)]),
            Property::Whole(v) => of("int", "Integer", "", &[Int(v)]),
            Property::Choice(v) => of("enum", "", "", &[Int(v)]),
            Property::Yes(v) => of("bool", "", "", &[Int(v.into())]),
            Property::Words(v) => of("KString", "", "", &[Text(v)]),
            Property::Path(v) => of("KString", "XRefUrl", "", &[Text(v)]),
            Property::Time(v) => of("KTime", "Time", "", &[Long(v)]),
        }
    }

    /// Says which object belongs to which; 0 is the scene's root.
    pub(super) fn connect(&mut self, what: i64, to: i64) -> Result<(), Error> {
        self.leaf("C", &[Text("OO"), Long(what), Long(to)])
    }

    /// The same of a property.
    pub(super) fn connect_property(&mut self, what: i64, to: i64, property: &str) -> Result<(), Error> {
        self.leaf("C", &[Text("OP"), Long(what), Long(to), Text(property)])
    }

    fn header(&mut self, made_of: Option<&str>) -> Result<(), Error> {
        self.node("FBXHeaderExtension", &[], |file| {
            file.leaf("FBXHeaderVersion", &[Int(1003)])?;
            file.leaf("FBXVersion", &[Int(7400)])?;
            file.leaf("EncryptionType", &[Int(0)])?;
            file.leaf("Creator", &[Text(CREATOR)])?;
            made_of.map_or(Ok(()), |name| file.leaf(MADE_OF, &[Text(name)]))
        })?;
        self.leaf("FileId", &[Bytes(&FILE_ID)])?;
        self.leaf("CreationTime", &[Text(CREATION_TIME)])?;
        self.leaf("Creator", &[Text(CREATOR)])
    }

    fn settings(&mut self) -> Result<(), Error> {
        // Axes count x, y, z from 0; the unit is in centimetres.
        let axes = [("Up", 1), ("Front", 2), ("Coord", 0), ("OriginalUp", 1)];
        // Of times: 30 frames a second.
        const THIRTY: i32 = 6;
        self.node("GlobalSettings", &[], |file| {
            file.leaf("Version", &[Int(1000)])?;
            file.node("Properties70", &[], |file| {
                for (axis, number) in axes {
                    file.property(&format!("{axis}Axis"), Property::Whole(number))?;
                    file.property(&format!("{axis}AxisSign"), Property::Whole(1))?;
                }
                for name in ["UnitScaleFactor", "OriginalUnitScaleFactor"] {
                    file.property(name, Property::Double(100.0))?;
                }
                file.property("TimeMode", Property::Choice(THIRTY))
            })
        })
    }

    pub(super) fn attribute(&mut self, id: i64, name: &str, kind: &str, flags: &str) -> Result<(), Error> {
        self.object(Class::NodeAttribute, (id, name, kind), |file| file.leaf("TypeFlags", &[Text(flags)]))
    }

    pub(super) fn model(
        &mut self,
        (id, name, kind): (i64, &str, &str),
        properties: &[(&str, Property<'_>)],
    ) -> Result<(), Error> {
        self.object(Class::Model, (id, name, kind), |file| {
            file.leaf("Version", &[Int(232)])?;
            file.properties(properties)?;
            file.leaf("Shading", &[Flag(true)])?;
            file.leaf("Culling", &[Text("CullingOff")])
        })
    }

    /// What binds a mesh: clusters hang on it.
    pub(super) fn skin(&mut self, id: i64) -> Result<(), Error> {
        self.object(Class::Deformer, (id, "skin", "Skin"), |file| {
            file.leaf("Version", &[Int(101)])?;
            file.leaf("Link_DeformAcuracy", &[Double(50.0)])
        })
    }

    /// What hangs on a joint: points and their weights. The maps are those from the mesh to the joint, and to the scene when it
    /// was bound from the joint and from what its skeleton hangs on, which Blender looks for.
    pub(super) fn cluster(
        &mut self,
        (id, name): (i64, &str),
        (points, weights): (&[i32], &[f64]),
        [transform, link, above]: [&DAffine3; 3],
    ) -> Result<(), Error> {
        self.object(Class::SubDeformer, (id, name, "Cluster"), |file| {
            file.leaf("Version", &[Int(100)])?;
            file.leaf("UserData", &[Text(""), Text("")])?;
            if !points.is_empty() {
                file.leaf("Indexes", &[Ints(points)])?;
                file.leaf("Weights", &[Doubles(weights)])?;
            }
            file.leaf("Transform", &[Doubles(&matrix(transform))])?;
            file.leaf("TransformLink", &[Doubles(&matrix(link))])?;
            file.leaf("TransformAssociateModel", &[Doubles(&matrix(above))])
        })
    }

    /// Where nodes stood when meshes were bound.
    pub(super) fn bind_pose(&mut self, id: i64, places: &[(i64, DAffine3)]) -> Result<(), Error> {
        self.object(Class::Pose, (id, "pose", "BindPose"), |file| {
            file.leaf("Type", &[Text("BindPose")])?;
            file.leaf("Version", &[Int(100)])?;
            file.leaf("NbPoseNodes", &[Int(places.len() as i32)])?;
            for (id, place) in places {
                file.node("PoseNode", &[], |file| {
                    file.leaf("Node", &[Long(*id)])?;
                    file.leaf("Matrix", &[Doubles(&matrix(place))])
                })?;
            }
            Ok(())
        })
    }
}

/// Classes of objects.
#[derive(Clone, Copy)]
pub(super) enum Class {
    Model,
    NodeAttribute,
    Geometry,
    Deformer,
    SubDeformer,
    Pose,
    Material,
    Texture,
    Video,
    Stack,
    Layer,
    CurveNode,
    Curve,
}

impl Class {
    /// The name of nodes that are one, and of the class.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Model => ("Model", "Model"),
            Self::NodeAttribute => ("NodeAttribute", "NodeAttribute"),
            Self::Geometry => ("Geometry", "Geometry"),
            Self::Deformer => ("Deformer", "Deformer"),
            Self::SubDeformer => ("Deformer", "SubDeformer"),
            Self::Pose => ("Pose", "Pose"),
            Self::Material => ("Material", "Material"),
            Self::Texture => ("Texture", "Texture"),
            Self::Video => ("Video", "Video"),
            Self::Stack => ("AnimationStack", "AnimStack"),
            Self::Layer => ("AnimationLayer", "AnimLayer"),
            Self::CurveNode => ("AnimationCurveNode", "AnimCurveNode"),
            Self::Curve => ("AnimationCurve", "AnimCurve"),
        }
    }
}

/// Matrices and the like do not get smaller.
fn encoding(values: usize) -> Option<ArrayAttributeEncoding> {
    (values > 64).then_some(ArrayAttributeEncoding::Zlib)
}

/// An object's name with its class.
pub(super) fn class_name(name: &str, class: &str) -> String {
    let name = name.replace(|c: char| c.is_control(), " ");
    format!("{name}{CLASS}{class}")
}

/// A map as a matrix, column by column.
fn matrix(of: &DAffine3) -> [f64; 16] {
    // Plus 0, for zeros may be negative.
    glam::DMat4::from(*of).to_cols_array().map(|x| x + 0.0)
}

/// Three points of each triangle. The last corner of a polygon has its bits turned over.
pub(super) fn polygons(triangles: &[[u32; 3]]) -> Vec<i32> {
    triangles.iter().flat_map(|&[a, b, c]| [a as i32, b as i32, !(c as i32)]).collect()
}
