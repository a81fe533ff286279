//! A finished GLB as plain lists, for formats that are written from one: nodes, meshes, skins, materials, pictures, blend shapes
//! and motions.
//!
//! Nodes stand parents first; all that names a node names its place among these. What is read here was imported
//! before, so that little can be wrong with it; parts that no rig needs and that cannot be read are left out.

mod looks;
mod meshes;
mod motions;
mod shapes;

use std::collections::BTreeMap;

use glam::{DAffine3, DQuat, DVec3};
use serde_json::Value;

use super::accessor::Accessors;
use super::bind::Binds;
use super::buffers::Buffers;
pub(crate) use super::clips::{Path, Track};
use super::document::{self, Document};
use super::nodes::{Nodes, parts};
use super::skins::Skins;
use super::unseen::{hides, unseen};
use super::vrm::BONE_EXTRA;
use super::{primitives, split};
use crate::Fault;
use crate::budget::Budget;
use crate::names::Names;
pub(crate) use looks::{Look, Map, Of, Picture};
use meshes::Reader;
pub(crate) use motions::{Motion, Move};

/// What a GLB holds.
#[derive(Debug, Default)]
pub(crate) struct Contents {
    /// Parents first.
    pub(crate) nodes: Vec<Node>,
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) looks: Vec<Look>,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) clips: Vec<Motion>,
    pub(crate) left: Left,
}

/// What of a document is not among its contents: how much of each, by what one of them is called.
pub(crate) type Left = BTreeMap<&'static str, usize>;

/// A node in the space of the one that it hangs on.
#[derive(Debug)]
pub(crate) struct Node {
    /// Not empty; no two joints have the same.
    pub(crate) name: String,
    /// The one that it hangs on.
    pub(crate) parent: Option<usize>,
    pub(crate) scale: DVec3,
    pub(crate) turn: DQuat,
    pub(crate) at: DVec3,
    /// From its space to the scene in the bind pose.
    pub(crate) rest: DAffine3,
    /// Whether a skin names it.
    pub(crate) is_joint: bool,
    /// The mesh that it shows.
    pub(crate) mesh: Option<usize>,
    /// Whether the file does not show it.
    pub(crate) hidden: bool,
}

/// Surfaces of a node. Those with a skin or with shapes are of one node, others may be of several.
#[derive(Debug, Default)]
pub(crate) struct Mesh {
    pub(crate) name: String,
    pub(crate) points: Vec<[f32; 3]>,
    /// Of three different points.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// The materials that it shows, and for each triangle its place among these; both empty where the file has none.
    pub(crate) looks: Vec<usize>,
    pub(crate) slots: Vec<usize>,
    /// Of unit length, by corner; empty where the file has none.
    pub(crate) normals: Vec<[f32; 3]>,
    /// From the upper left corner of the picture.
    pub(crate) coordinates: Vec<Layer<2>>,
    /// Linear, with alpha.
    pub(crate) colours: Vec<Layer<4>>,
    pub(crate) skin: Option<Skin>,
    pub(crate) shapes: Vec<Shape>,
}

/// A blend shape: what it adds at its full weight.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    pub(crate) name: String,
    /// How much of it is seen where nothing moves it.
    pub(crate) weight: f64,
    /// Those that it moves; the lists are as long as each other.
    pub(crate) points: Vec<u32>,
    pub(crate) offsets: Vec<[f32; 3]>,
    /// What is added to normals.
    pub(crate) normals: Vec<[f32; 3]>,
    pub(crate) has_normals: bool,
}

/// A value for each corner of all triangles.
#[derive(Debug)]
pub(crate) struct Layer<const N: usize> {
    pub(crate) values: Vec<[f32; N]>,
    /// By corner.
    pub(crate) indices: Vec<u32>,
}

/// What binds a mesh.
#[derive(Debug)]
pub(crate) struct Skin {
    pub(crate) clusters: Vec<Cluster>,
    /// From the mesh to the scene when it was bound.
    pub(crate) map: DAffine3,
}

/// What hangs on a joint.
#[derive(Debug)]
pub(crate) struct Cluster {
    pub(crate) node: usize,
    /// Points, rising, and their weights, which sum to 1 over all clusters.
    pub(crate) points: Vec<u32>,
    pub(crate) weights: Vec<f64>,
    /// From the mesh to the joint.
    pub(crate) to_joint: DAffine3,
    /// From the joint to the scene when it was bound.
    pub(crate) bind: DAffine3,
}

impl Contents {
    /// Of a GLB that lies in one run of bytes.
    pub(crate) fn read(glb: &[u8]) -> Result<Self, Fault> {
        let chunks = split(glb)?;
        let document = Document::parse(chunks.json)?;
        let json: Value = serde_json::from_slice(document::body(chunks.json))
            .map_err(|e| Fault::Json { path: String::new(), reason: e.to_string() })?;
        let buffers = Buffers::new(&document, chunks.binary, None, Budget::new(glb.len()));
        let accessors = Accessors::new(&document, buffers);
        let nodes = Nodes::new(&document)?;
        let mut unheard = Vec::new();
        let skins = Skins::read(&document, &nodes, &accessors, &mut unheard)?;
        let sources = primitives::collect(&document, &accessors, &mut unheard)?;
        let binds = Binds::new(&nodes, &skins, &sources, &accessors, &mut unheard);

        let mut contents = Self::default();
        let mut number = vec![0; nodes.len()];
        nodes.order().iter().zip(0..).for_each(|(&node, own)| number[node] = own);
        let places = Places { document: &document, nodes: &nodes, skins: &skins, binds: &binds };
        contents.nodes = places.nodes(&number, &mut contents.left);
        (contents.looks, contents.pictures) = looks::read(&json, &accessors, &mut contents.left);
        let mut reader = Reader::new(&places, &json, &accessors, &sources, &number);
        for (node, own) in nodes.order().iter().zip(0..) {
            contents.nodes[own].mesh = reader.mesh(*node, &mut contents)?;
        }
        if reader.unread > 0 {
            contents.left.insert("list of normals, coordinates, colours or offsets that cannot be read", reader.unread);
        }
        contents.clips = motions::read(chunks.json, &places, &accessors, &number, &mut contents);
        count_left(&document, &json, sources.without_surface, &mut contents.left);
        Ok(contents)
    }
}

/// Where everything is.
struct Places<'a> {
    document: &'a Document,
    nodes: &'a Nodes,
    skins: &'a Skins,
    binds: &'a Binds,
}

impl Places<'_> {
    fn nodes(&self, number: &[usize], left: &mut Left) -> Vec<Node> {
        let rests = self.binds.rests(self.nodes);
        let unseen = unseen(self.document);
        let mut names = Names::default();
        let one = |&node: &usize| {
            let own = &self.document.nodes[node];
            let is_joint = self.skins.joint_of_node(node).is_some();
            let wanted = own.name.as_deref().unwrap_or_default();
            // As the importer calls them.
            let name = match is_joint {
                true => names.unique(wanted, || format!("joint_{node}")),
                false if wanted.is_empty() => format!("node {node}"),
                false => wanted.to_owned(),
            };
            let (scale, turn, at) = parts(own);
            let made = DAffine3::from_scale_rotation_translation(scale, turn, at);
            if !made.abs_diff_eq(*self.nodes.local(node), 1e-4 * scale.abs().max_element().max(1e-6)) {
                *left.entry("sheared node").or_default() += 1;
            }
            let parent = Some(self.nodes.parent(node)).filter(|above| *above != self.nodes.top());
            Node {
                name,
                parent: parent.map(|above| number[above]),
                scale,
                turn,
                at,
                rest: rests[node],
                is_joint,
                mesh: None,
                hidden: hides(own) || unseen.binary_search(&node).is_ok(),
            }
        };
        self.nodes.order().iter().map(one).collect()
    }
}

/// Counts what is in no list.
fn count_left(document: &Document, json: &Value, without_surface: usize, left: &mut Left) {
    let mut count = |what, n: usize| {
        if n > 0 {
            *left.entry(what).or_default() += n;
        }
    };
    let primitives = || document.meshes.iter().flat_map(|mesh| &mesh.primitives);
    count("set of points or lines", without_surface);
    count("set of tangents", primitives().filter(|of| of.attributes.contains_key("TANGENT")).count());
    let own = |of: &document::Primitive| of.attributes.keys().filter(|name| name.starts_with('_')).count();
    count("attribute of its own", primitives().map(own).sum());
    let of_node = |name: &str| document.nodes.iter().filter(|node| !node.extensions[name].is_null()).count();
    count("node of instances", of_node("EXT_mesh_gpu_instancing"));
    count("camera", json["cameras"].as_array().map_or(0, Vec::len));
    let extensions = &json["extensions"];
    let length = |list: &Value| list.as_array().map_or(0, Vec::len);
    count("light", length(&extensions["KHR_lights_punctual"]["lights"]));
    count("material variant", length(&extensions["KHR_materials_variants"]["variants"]));
    let (one, zero) = (&extensions["VRMC_vrm"], &extensions["VRM"]);
    let bones = one["humanoid"]["humanBones"].as_object().map_or(0, serde_json::Map::len);
    count("human bone", bones + length(&zero["humanoid"]["humanBones"]));
    let springs = length(&extensions["VRMC_springBone"]["springs"]);
    count("spring", springs + length(&zero["secondaryAnimation"]["boneGroups"]));
    let faces = ["preset", "custom"].map(|kind| one["expressions"][kind].as_object().map_or(0, serde_json::Map::len));
    count("expression", faces.iter().sum::<usize>() + length(&zero["blendShapeMaster"]["blendShapeGroups"]));
    let lists = ["nodes", "meshes", "materials", "scenes"].map(|list| json[list].as_array());
    count("object with extras", lists.into_iter().flatten().flatten().filter(|own| says_more(&own["extras"])).count());
}

/// Whether extras say something that is not told by another name: of shapes, and of human bones as riglab writes them.
fn says_more(extras: &Value) -> bool {
    match extras {
        Value::Null => false,
        Value::Object(members) => members.keys().any(|key| !["targetNames", BONE_EXTRA].contains(&key.as_str())),
        _ => true,
    }
}
