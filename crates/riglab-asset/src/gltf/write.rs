//! A rig as a GLB file.

use riglab_core::{Asset, Rig, Vec3};
use serde_json::{Value, json};

/// Bytes of vertices and faces, as the GPU takes them: what a buffer view is for.
const ARRAY: u32 = 34962;
const ELEMENTS: u32 = 34963;
/// Component types.
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// Influences of one pair of JOINTS_n and WEIGHTS_n.
const SET: usize = 4;

/// The asset as a binary glTF 2.0 file: one mesh with normals, one skin, a node a joint.
///
/// Nothing is lost or rounded; normals are made anew: the inverse bind matrices hold the
/// joints' heads, every influence stands in as many sets of four as it takes, units and axes stay.
/// Joints have no orientation of their own, as in [`Rig`].
pub fn to_glb(asset: &Asset) -> Vec<u8> {
    let rig = &asset.rig;
    let mut file = Buffers::default();
    let attributes = attributes(rig, &mut file);
    let corners: Vec<u8> = rig.mesh().triangles().iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let indices = file.add(&corners, Some(ELEMENTS), U32, "SCALAR", 3 * rig.mesh().triangles().len());
    let skeleton = rig.skeleton();
    let bind: Vec<u8> = skeleton.heads().iter().flat_map(|h| matrix_to(*h)).flat_map(f32::to_le_bytes).collect();
    let bind = file.add(&bind, None, F32, "MAT4", skeleton.len());
    let mut nodes: Vec<Value> = skeleton
        .ids()
        .zip(skeleton.children())
        .map(|(joint, children)| {
            let from = skeleton.parent(joint).map_or([0.0; 3], |p| skeleton.head(p));
            let head = skeleton.head(joint);
            let translation: Vec3 = std::array::from_fn(|k| head[k] - from[k]);
            let mut node = json!({"name": skeleton.name(joint), "translation": translation});
            if !children.is_empty() {
                node["children"] = json!(children.iter().map(|c| c.index()).collect::<Vec<_>>());
            }
            node
        })
        .collect();
    let mesh_node = nodes.len();
    nodes.push(json!({"name": asset.name, "mesh": 0, "skin": 0}));
    let from = &asset.provenance;
    let mut header = json!({"version": "2.0", "generator": concat!("riglab ", env!("CARGO_PKG_VERSION"))});
    if !from.author.is_empty() {
        header["copyright"] = json!(from.author);
    }
    // Where model portals write it, too.
    if !from.licence.is_empty() {
        header["extras"] = json!({"license": from.licence, "author": from.author});
    }
    let document = json!({
        "asset": header,
        "scene": 0,
        "scenes": [{"nodes": [0, mesh_node]}],
        "nodes": nodes,
        "meshes": [{"name": asset.name, "primitives": [{"attributes": attributes, "indices": indices}]}],
        "skins": [{"joints": (0..skeleton.len()).collect::<Vec<_>>(), "inverseBindMatrices": bind, "skeleton": 0}],
        "accessors": file.accessors,
        "bufferViews": file.views,
        "buffers": [{"byteLength": file.bytes.len()}],
    });
    container(document.to_string().into_bytes(), file.bytes)
}

/// Positions with their bounds (glTF wants them), normals, and the weights in sets of four.
fn attributes(rig: &Rig, file: &mut Buffers) -> Value {
    let (mesh, weights) = (rig.mesh(), rig.weights());
    let n = mesh.positions().len();
    let floats = |of: &[Vec3]| of.iter().flatten().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let positions = file.add(&floats(mesh.positions()), Some(ARRAY), F32, "VEC3", n);
    let bound = |pick: fn(f32, f32) -> f32| -> Vec3 {
        std::array::from_fn(|k| mesh.positions().iter().map(|p| p[k]).reduce(pick).unwrap_or(0.0))
    };
    file.accessors[positions]["min"] = json!(bound(f32::min));
    file.accessors[positions]["max"] = json!(bound(f32::max));
    let normals = file.add(&floats(&mesh.vertex_normals()), Some(ARRAY), F32, "VEC3", n);
    let mut attributes = json!({"POSITION": positions, "NORMAL": normals});
    let most = (0..n).map(|v| weights.row(v).len()).max().unwrap_or(0);
    for set in 0..most.div_ceil(SET).max(1) {
        let (mut joints, mut shares) = (Vec::with_capacity(8 * n), Vec::with_capacity(16 * n));
        for v in 0..n {
            let row = weights.row(v).skip(set * SET).map(|(j, w)| (j.index() as u16, w));
            for (joint, share) in row.chain(std::iter::repeat((0, 0.0))).take(SET) {
                joints.extend(joint.to_le_bytes());
                shares.extend(share.to_le_bytes());
            }
        }
        attributes[format!("JOINTS_{set}")] = json!(file.add(&joints, Some(ARRAY), U16, "VEC4", n));
        attributes[format!("WEIGHTS_{set}")] = json!(file.add(&shares, Some(ARRAY), F32, "VEC4", n));
    }
    attributes
}

/// The inverse of a translation, column by column.
fn matrix_to(head: Vec3) -> [f32; 16] {
    let mut m = [0.0; 16];
    [m[0], m[5], m[10], m[15]] = [1.0; 4];
    for k in 0..3 {
        // 0 - x, for the zero of -x would be negative.
        m[12 + k] = 0.0 - head[k];
    }
    m
}

/// The binary chunk with views and accessors over it.
#[derive(Default)]
struct Buffers {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffers {
    /// Adds data as a view and an accessor over all of it; gives the accessor's number.
    fn add(&mut self, data: &[u8], target: Option<u32>, component: u32, kind: &str, count: usize) -> usize {
        let mut view = json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": data.len()});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend(data);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        let accessor =
            json!({"bufferView": self.views.len() - 1, "componentType": component, "type": kind, "count": count});
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

/// Header, JSON chunk, binary chunk.
fn container(mut json: Vec<u8>, bytes: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + json.len() + 8 + bytes.len();
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend((total as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", bytes)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Provenance, Skeleton, SkinWeights};

    use super::*;
    use crate::{ImportOptions, Warning, import_bytes};

    #[test]
    fn what_is_written_is_read_back() {
        let joint =
            |name: &str, parent: Option<u16>, head| Joint { name: name.into(), parent: parent.map(JointId), head };
        let joints = vec![
            joint("root", None, [0.1, -0.2, 0.3]),
            joint("arm", Some(0), [0.7, 0.123, 0.3]),
            joint("hand", Some(1), [1.1, 0.2, 1e-7]),
            joint("tip", Some(2), [1.4, 0.2, 0.1]),
            // The importer's order is depth first.
            joint("leg", Some(0), [0.1, -0.9, 0.0]),
        ];
        let skeleton = Skeleton::new(joints).unwrap();
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.1, 0.2], [0.3, 1.0, 0.7]], vec![[0, 1, 2]]).unwrap();
        // Five influences take two sets.
        let rows: Vec<Vec<(u16, f64)>> =
            vec![vec![(0, 0.5), (1, 0.2), (2, 0.1), (3, 0.1), (4, 0.1)], vec![(1, 1.0)], vec![(2, 0.25), (3, 0.75)]];
        let rig = Rig::new(skeleton, mesh, SkinWeights::normalized(rows).unwrap()).unwrap();
        let provenance = Provenance { licence: "CC0-1.0".into(), ..Provenance::default() };
        let asset = Asset { name: "test".into(), rig, clips: vec![], provenance };
        let back = import_bytes("test.glb", &to_glb(&asset), &ImportOptions::default()).unwrap();
        assert_eq!(back.provenance.licence, "CC0-1.0");
        assert!(matches!(back.warnings(), [Warning::FewTriangles(1)]));
        let rig = back.rig().unwrap();
        assert_eq!((rig.skeleton(), rig.mesh()), (asset.rig.skeleton(), asset.rig.mesh()));
        assert_eq!(rig.weights().joints(), asset.rig.weights().joints());
        for (a, b) in rig.weights().weights().iter().zip(asset.rig.weights().weights()) {
            // Rows are divided by their sum once more.
            assert!((a - b).abs() < 1e-6);
        }
    }
}
