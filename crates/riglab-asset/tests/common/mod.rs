//! Where test data lies, and the smallest rig as a file to be altered.
#![allow(dead_code)] // each test uses a part

use std::path::{Path, PathBuf};

use riglab_core::{Clip, Joint, Pose, Rig, Skeleton};
use riglab_random::{Draw, stream};
use serde_json::{Value, json};

/// The folder that the environment variable names, else `../shared/DEFAULT` beside the workspace;
/// `None`, with a word about it, where there is no such folder.
pub fn data(variable: &str, default: &str) -> Option<PathBuf> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let folder = std::env::var_os(variable).map_or_else(|| shared.join(default), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no such folder {} (set {variable})", folder.display());
    None
}

/// Files in a folder with one of some endings, sorted.
pub fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<_> =
        entries.filter(|p| p.extension().is_some_and(|e| endings.iter().any(|w| e == *w))).collect();
    files.sort();
    files
}

/// Every joint turns, and the root goes somewhere.
pub fn dance(rig: &Rig, frames: u64, rate: f32) -> Clip {
    let size = rig.bounds().diagonal();
    let skeleton = rig.skeleton();
    let pose = |frame: u64| {
        let mut draw = stream(2, "dance", &[frame]);
        let mut pose = Pose::rest(skeleton.len());
        for joint in skeleton.ids() {
            pose.rotate(joint, std::array::from_fn(|_| 0.3 * draw.normal()));
        }
        pose.shift_root(std::array::from_fn(|_| 0.1 * size * draw.normal()));
        pose.transforms(skeleton)
            .unwrap()
            .into_iter()
            .map(|m| [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation].map(Into::into))
    };
    Clip::new("dance".into(), rate, skeleton.len(), (0..frames).flat_map(pose).collect()).unwrap()
}

/// The rig with other joint names: another skeleton.
pub fn renamed(rig: &Rig) -> Rig {
    let skeleton = rig.skeleton();
    let joints = skeleton.ids().map(|joint| Joint {
        name: format!("new {}", skeleton.name(joint)),
        parent: skeleton.parent(joint),
        head: skeleton.head(joint),
    });
    Rig::new(Skeleton::new(joints.collect()).unwrap(), rig.mesh().clone(), rig.weights().clone()).unwrap()
}

/// The same with human bones and springs.
pub fn reborn(rig: &Rig) -> Rig {
    renamed(rig).with_humanoid(rig.humanoid().clone()).unwrap().with_springs(rig.springs().clone()).unwrap()
}

/// A tetrahedron on two joints, `hips` at (0, 1, 0) and `tip` at (0, 2, 0).
#[derive(Clone)]
pub struct Tiny {
    pub document: Value,
    pub binary: Vec<u8>,
}

/// The accessors of [`Tiny`].
pub const POSITION: usize = 0;
pub const JOINTS: usize = 1;
pub const WEIGHTS: usize = 2;
pub const INDICES: usize = 3;
pub const INVERSE_BIND: usize = 4;

impl Tiny {
    pub fn new() -> Self {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.5, 0.0], [0.0, 0.0, 1.0f32]];
        let joints = [[0u8, 1, 0, 0]; 4];
        let weights = [[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.25, 0.75, 0.0, 0.0f32]];
        let indices = [0u16, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3];
        let matrix = |y: f32| {
            let mut m = [0.0f32; 16];
            (m[0], m[5], m[10], m[15], m[13]) = (1.0, 1.0, 1.0, 1.0, y);
            m
        };
        let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let chunks = [
            floats(positions.as_flattened()),
            joints.as_flattened().to_vec(),
            floats(weights.as_flattened()),
            indices.iter().flat_map(|i| i.to_le_bytes()).collect(),
            floats(&[matrix(-1.0), matrix(-2.0)].concat()),
        ];
        let mut views = Vec::new();
        let mut binary = Vec::new();
        for chunk in &chunks {
            views.push(json!({"buffer": 0, "byteOffset": binary.len(), "byteLength": chunk.len()}));
            binary.extend(chunk);
        }
        let accessor = |view: usize, component: u32, shape: &str, count: usize| json!({"bufferView": view, "componentType": component, "type": shape, "count": count});
        let document = json!({
            "asset": {"version": "2.0"},
            "nodes": [
                {"name": "body", "mesh": 0, "skin": 0},
                {"name": "hips", "translation": [0, 1, 0], "children": [2]},
                {"name": "tip", "translation": [0, 1, 0]},
            ],
            "meshes": [{"primitives": [{
                "attributes": {"POSITION": POSITION, "JOINTS_0": JOINTS, "WEIGHTS_0": WEIGHTS},
                "indices": INDICES,
            }]}],
            "skins": [{"joints": [1, 2], "inverseBindMatrices": INVERSE_BIND}],
            "accessors": [
                accessor(0, 5126, "VEC3", 4),
                accessor(1, 5121, "VEC4", 4),
                accessor(2, 5126, "VEC4", 4),
                accessor(3, 5123, "SCALAR", 12),
                accessor(4, 5126, "MAT4", 2),
            ],
            "bufferViews": views,
            "buffers": [{"byteLength": binary.len()}],
        });
        Self { document, binary }
    }

    /// With the value at a JSON pointer replaced, or added to its object or list (`-`).
    pub fn with(mut self, pointer: &str, value: Value) -> Self {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match self.document.pointer_mut(parent).unwrap() {
            Value::Array(list) if key == "-" => list.push(value),
            Value::Array(list) => list[key.parse::<usize>().unwrap()] = value,
            object => object[key] = value,
        }
        self
    }

    /// With bytes of the buffer replaced.
    pub fn with_bytes(mut self, at: usize, bytes: &[u8]) -> Self {
        self.binary[at..at + bytes.len()].copy_from_slice(bytes);
        self
    }

    /// With a buffer view and an accessor of these bytes, which is `self.accessors() - 1` then.
    pub fn with_accessor(mut self, component: u32, shape: &str, count: usize, bytes: &[u8]) -> Self {
        let view = json!({"buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len()});
        self.binary.extend(bytes);
        let views = self.document["bufferViews"].as_array().unwrap().len();
        let accessor = json!({"bufferView": views, "componentType": component, "type": shape, "count": count});
        let length = json!(self.binary.len());
        self.with("/bufferViews/-", view).with("/accessors/-", accessor).with("/buffers/0/byteLength", length)
    }

    pub fn accessors(&self) -> usize {
        self.document["accessors"].as_array().unwrap().len()
    }

    pub fn glb(&self) -> Vec<u8> {
        glb(self.document.to_string().as_bytes(), &self.binary)
    }
}

/// A GLB of two chunks.
pub fn glb(json: &[u8], binary: &[u8]) -> Vec<u8> {
    let mut json = json.to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = 12 + 8 + json.len() + 8 + binary.len();
    let mut bytes = [b"glTF".as_slice(), &2u32.to_le_bytes(), &(length as u32).to_le_bytes()].concat();
    for (kind, data) in [(b"JSON", json), (b"BIN\0", binary)] {
        bytes.extend((data.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(data);
    }
    bytes
}
