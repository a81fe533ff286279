//! Small files that ask for much get an answer soon, in little memory.

mod common;
#[path = "common/peak.rs"]
mod peak;

use std::fmt::Write;
use std::time::{Duration, Instant};

use common::{JOINTS, POSITION, Tiny, WEIGHTS};
use riglab_asset::{Fault, ImportError, ImportOptions, Imported, import_bytes};
use serde_json::{Value, json};

/// In a debug build on a busy machine; what grows with the square of the file would take minutes.
const LIMIT: Duration = Duration::from_secs(10);

/// Nodes, skins or primitives asked for.
const MANY: usize = 20_000;

fn soon(what: &str, bytes: &[u8]) -> Result<Imported, ImportError> {
    let start = Instant::now();
    let (result, peak) = peak::of(|| import_bytes(what, bytes, &ImportOptions::default()));
    println!("{what}: {:?}, {} bytes, {peak:?}", start.elapsed(), bytes.len());
    assert!(peak.is_fair(bytes.len()), "{what}: {peak:?} for a file of {}", bytes.len());
    assert!(start.elapsed() < LIMIT, "{what} took {:?}", start.elapsed());
    result
}

fn skinned(position: usize) -> Value {
    json!({"POSITION": position, "JOINTS_0": JOINTS, "WEIGHTS_0": WEIGHTS})
}

#[test]
fn many_nodes_with_one_mesh() {
    let mut tiny = Tiny::new();
    tiny.document["nodes"].as_array_mut().unwrap().extend(vec![json!({"mesh": 0, "skin": 0}); MANY]);
    assert_eq!(soon("nodes", &tiny.glb()).unwrap().mesh().positions().len(), 4 * (MANY + 1));
}

#[test]
fn many_primitives_over_the_same_or_over_other_vertices() {
    let same = vec![json!({"attributes": skinned(POSITION), "indices": 3}); MANY];
    let rig = soon("same", &Tiny::new().with("/meshes/0/primitives", json!(same)).glb()).unwrap();
    assert_eq!(rig.mesh().triangles().len(), 4);

    let mut tiny = Tiny::new();
    let accessor = tiny.document["accessors"][POSITION].clone();
    tiny.document["accessors"].as_array_mut().unwrap().extend(vec![accessor; MANY]);
    let other: Vec<_> = (0..MANY).map(|i| json!({"attributes": skinned(5 + i), "indices": 3})).collect();
    let rig = soon("other", &tiny.with("/meshes/0/primitives", json!(other)).glb()).unwrap();
    assert_eq!(rig.mesh().positions().len(), 4 * MANY);
}

#[test]
fn a_chain_of_joints_under_many_skins() {
    let mut nodes = String::new();
    for n in 1..MANY {
        write!(nodes, r#"{{"children":[{n}]}},"#).unwrap();
    }
    // Each skin spans the whole chain, or begins one joint below the one before.
    for span in ["the root", "all over"] {
        let mut skins = String::new();
        for n in 1..MANY {
            let first = if span == "the root" { 0 } else { n - 1 };
            write!(skins, r#"{{"joints":[{},{first}]}},"#, MANY - 1).unwrap();
        }
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"nodes":[{nodes}{{}}],"skins":[{}]}}"#,
            skins.trim_end_matches(',')
        );
        let result = soon(&format!("skins from {span}"), json.as_bytes());
        assert_eq!(result.unwrap_err().fault, Fault::NothingBound);
    }
}

#[test]
fn claims_without_bytes_behind_them() {
    // Zeros without end, again and again.
    let zeros = json!({"componentType": 5126, "type": "VEC3", "count": 1 << 20});
    let mut tiny = Tiny::new();
    tiny.document["accessors"].as_array_mut().unwrap().extend(vec![zeros; MANY]);
    let many: Vec<_> = (0..MANY).map(|i| json!({"attributes": {"POSITION": 5 + i}, "indices": 3})).collect();
    let result = soon("zeros", &tiny.with("/meshes/0/primitives", json!(many)).glb());
    assert!(matches!(result.unwrap_err().fault, Fault::Unfolded { .. }));

    // The same many corners, again and again.
    let indices = vec![0u8; 100_000];
    let tiny = Tiny::new().with_accessor(5121, "SCALAR", indices.len(), &indices);
    let many = vec![json!({"attributes": skinned(POSITION), "indices": 5}); MANY];
    let result = soon("corners", &tiny.with("/meshes/0/primitives", json!(many)).glb());
    assert!(matches!(result.unwrap_err().fault, Fault::Unfolded { .. }));

    let many: serde_json::Map<_, _> = (0..MANY)
        .flat_map(|i| [(format!("JOINTS_{i}"), json!(JOINTS)), (format!("WEIGHTS_{i}"), json!(WEIGHTS))])
        .chain([("POSITION".to_owned(), json!(POSITION))])
        .collect();
    let result = soon("sets", &Tiny::new().with("/meshes/0/primitives/0/attributes", json!(many)).glb());
    assert!(matches!(result.unwrap_err().fault, Fault::TooLarge { .. }));
}

#[test]
fn equal_names_and_vertices_without_weights() {
    let mut tiny = Tiny::new();
    let nodes = tiny.document["nodes"].as_array_mut().unwrap();
    nodes.extend(vec![json!({"name": "bone"}); MANY]);
    let joints: Vec<_> = (3..MANY + 3).collect();
    tiny.document["skins"] = json!([{"joints": joints}]);
    let rig = soon("names", &tiny.glb()).unwrap().into_asset().unwrap().rig;
    assert_eq!(rig.skeleton().name(riglab_core::JointId(MANY as u16 - 1)), format!("bone.{}", MANY - 1));

    // A flat fan of which every second vertex has no weight.
    let count = 2 * MANY;
    let positions: Vec<u8> =
        (0..count).flat_map(|i| [0.0, i as f32, (i * i % 7) as f32]).flat_map(f32::to_le_bytes).collect();
    let weights: Vec<u8> = (0..count).flat_map(|i| [(i % 2) as u8 * 255, 0, 0, 0]).collect();
    let tiny = Tiny::new()
        .with_accessor(5126, "VEC3", count, &positions)
        .with_accessor(5121, "VEC4", count, &vec![0; 4 * count])
        .with_accessor(5121, "VEC4", count, &weights)
        .with("/accessors/7/normalized", json!(true));
    let primitive = json!({"attributes": {"POSITION": 5, "JOINTS_0": 6, "WEIGHTS_0": 7}, "mode": 6});
    assert!(soon("weights", &tiny.with("/meshes/0/primitives/0", primitive).glb()).is_ok());
}

#[test]
fn a_mesh_on_too_many_nodes_is_refused_with_what_to_do() {
    let count = 3_600u16;
    let positions: Vec<u8> = (0..count)
        .flat_map(|i| [0.0, f32::from(i), f32::from((i % 7).pow(2) % 7)])
        .flat_map(f32::to_le_bytes)
        .collect();
    let mut tiny = Tiny::new().with_accessor(5126, "VEC3", count.into(), &positions);
    tiny.document["skins"] = json!([]);
    tiny.document["meshes"][0]["primitives"] = json!([{"attributes": {"POSITION": 5}}]);
    tiny.document["nodes"] = json!(vec![json!({"mesh": 0}); 100]);
    assert_eq!(soon("copies", &tiny.glb()).unwrap().mesh().positions().len(), 100 * usize::from(count));
    tiny.document["nodes"] = json!(vec![json!({"mesh": 0}); 3_000]);
    let said = soon("more copies", &tiny.glb()).unwrap_err().to_string();
    assert!(said.contains("put fewer nodes on one mesh"), "{said}");
}

#[test]
fn props_on_hundreds_of_nodes_are_no_bomb() {
    // A grid of 50 x 50 vertices that some 500 nodes show: a file of 100 kB.
    let side = 50u16;
    let at = |i: u16, k: u16| [f32::from(i), 0.0, f32::from(k)];
    let positions: Vec<u8> =
        (0..side).flat_map(|i| (0..side).map(move |k| at(i, k))).flatten().flat_map(f32::to_le_bytes).collect();
    let cell = |v: u16| [v, v + 1, v + side, v + 1, v + side + 1, v + side];
    let indices: Vec<u16> =
        (0..side - 1).flat_map(|i| (0..side - 1).map(move |k| i * side + k)).flat_map(cell).collect();
    let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
    let count = usize::from(side * side);
    let mut tiny =
        Tiny::new().with_accessor(5126, "VEC3", count, &positions).with_accessor(5123, "SCALAR", indices.len(), &bytes);
    tiny.document["skins"] = json!([]);
    tiny.document["meshes"][0]["primitives"] = json!([{"attributes": {"POSITION": 5}, "indices": 6}]);
    tiny.document["nodes"] = (0..500).map(|n| json!({"mesh": 0, "translation": [0, n, 0]})).collect();
    let bytes = tiny.glb();
    let (result, peak) = peak::of(|| import_bytes("props", &bytes, &ImportOptions::default()));
    let mesh = result.unwrap().mesh().clone();
    assert_eq!((mesh.positions().len(), mesh.triangles().len()), (500 * count, 500 * indices.len() / 3));
    assert_eq!(mesh.positions()[count][1], 1.0);
    assert!(peak.total < 256 << 20, "{peak:?} for {}", bytes.len());

    // Each of many parts of it counts, however small.
    let part = json!({"attributes": {"POSITION": 0}, "indices": 3});
    tiny.document["meshes"][0]["primitives"] = json!(vec![part; 2_000]);
    tiny.document["nodes"] = json!(vec![json!({"mesh": 0}); MANY]);
    assert!(matches!(soon("parts", &tiny.glb()).unwrap_err().fault, Fault::Shown { .. }));
}

#[test]
fn small_files_that_stand_for_large_ones() {
    // A sheet of triangles on many nodes.
    let corners = 30_000u32;
    let indices: Vec<u8> = (0..corners).flat_map(|i| [i % 4, (i + 1) % 4]).map(|i| i as u8).collect();
    let mut tiny = Tiny::new().with_accessor(5121, "SCALAR", indices.len(), &indices);
    tiny.document["meshes"][0]["primitives"][0]["indices"] = json!(5);
    tiny.document["nodes"].as_array_mut().unwrap().extend(vec![json!({"mesh": 0, "skin": 0}); MANY]);
    assert!(matches!(soon("sheets", &tiny.glb()).unwrap_err().fault, Fault::Shown { .. }));

    // JSON that takes many times its bytes in memory: more nodes than joints can be, and values without sense.
    let nodes = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{}{{}}]}}"#, "{},".repeat(70_000));
    assert!(matches!(soon("empty nodes", nodes.as_bytes()).unwrap_err().fault, Fault::TooLarge { .. }));
    let values = format!(r#"{{"asset":{{"version":"2.0"}},"extensions":[{}0]}}"#, "0,".repeat(1 << 21));
    assert!(matches!(soon("values", values.as_bytes()).unwrap_err().fault, Fault::TooLarge { .. }));
}
