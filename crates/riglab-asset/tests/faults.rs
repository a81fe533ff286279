//! The smallest broken file for every way in which a file can be wrong.

mod common;

use common::{INDICES, INVERSE_BIND, JOINTS, POSITION, Tiny, WEIGHTS};
use riglab_asset::{Fault, ImportOptions, Imported, import, import_bytes};
use serde_json::{Value, json};

fn read(bytes: &[u8]) -> Result<Imported, Fault> {
    import_bytes("tiny.glb", bytes, &ImportOptions::default()).map_err(|e| e.fault)
}

/// The fault of the tiny rig with one value replaced.
fn fault(pointer: &str, value: Value) -> Fault {
    read(&Tiny::new().with(pointer, value).glb()).expect_err(pointer)
}

macro_rules! assert_fault {
    ($fault:expr, $pattern:pat) => {{
        let fault = $fault;
        assert!(matches!(fault, $pattern), "{fault:?}");
    }};
}

#[test]
fn the_tiny_rig_itself_is_sound() {
    let imported = read(&Tiny::new().glb()).unwrap();
    assert_eq!(imported.warnings(), []);
    let rig = imported.rig().unwrap();
    assert_eq!(rig.skeleton().heads(), [[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]);
    assert_eq!((rig.mesh().positions().len(), rig.mesh().triangles().len()), (4, 4));
}

#[test]
fn files_that_are_no_gltf() {
    let of = |name: &str, bytes: &[u8]| import_bytes(name, bytes, &ImportOptions::default()).unwrap_err().fault;
    assert_fault!(of("a.glb", b""), Fault::Empty);
    assert_fault!(of("a.glb", b"\x89PNG"), Fault::NotAModel("a PNG picture"));
    for fbx in [&b"Kaydara FBX Binary  \0"[..], b"; FBX 7.3.0 project file"] {
        let fault = of("a.glb", fbx);
        let read = cfg!(feature = "fbx");
        assert!(
            if read { matches!(fault, Fault::Fbx(_)) } else { matches!(fault, Fault::OtherFormat { .. }) },
            "{fault:?}"
        );
        assert!(fault.to_string().contains("FBX") && fault.to_string().contains("GLB"), "{fault}");
    }
    assert_fault!(of("a.obj", b"v 0 0 0"), Fault::NoMesh);
    assert_fault!(of("a.obj", b"v 0 0 zero"), Fault::Obj(_));
    assert_fault!(of("a.gltf", b"{"), Fault::Json { .. });
    assert_fault!(import("no such file.glb", &ImportOptions::default()).unwrap_err().fault, Fault::Unreadable(_));
    let text = import("no such file.glb", &ImportOptions::default()).unwrap_err().to_string();
    assert_eq!(text, "no such file.glb: cannot be read: there is no such file");
    assert_fault!(import("tests", &ImportOptions::default()).unwrap_err().fault, Fault::Folder);
}

#[test]
fn extensions_that_change_geometry() {
    assert_fault!(fault("/extensionsRequired", json!(["XX_unknown"])), Fault::RequiredExtension(_));
    let said = fault("/extensionsRequired", json!(["EXT_mesh_gpu_instancing"])).to_string();
    assert!(said.contains("EXT_mesh_gpu_instancing, which draws a mesh several times"), "{said}");
    let harmless = json!(["VRMC_vrm", "KHR_materials_unlit", "KHR_mesh_quantization", "EXT_meshopt_compression"]);
    assert!(read(&Tiny::new().with("/extensionsRequired", harmless).glb()).is_ok());
    // Not required, but without plain bytes beside.
    let draco = json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}});
    let compressed = Tiny::new().with("/meshes/0/primitives/0/extensions", draco);
    assert!(read(&compressed.glb()).is_ok());
    let mut compressed = compressed;
    compressed.document["accessors"][POSITION].as_object_mut().unwrap().remove("bufferView");
    let broken = |read: Result<_, _>, name: &str| match read.map(|_: Imported| ()).unwrap_err() {
        Fault::Compressed { extension, reason, .. } => assert!(extension == name && !reason.is_empty()),
        other => panic!("{other}"),
    };
    broken(read(&compressed.glb()), "KHR_draco_mesh_compression");
    // Settings that are none, and settings that cannot be true.
    for meshopt in [
        json!({}),
        json!({"buffer": 0, "byteLength": 8, "byteStride": 12, "count": 1u64 << 40, "mode": "ATTRIBUTES"}),
        json!({"buffer": 0, "byteLength": 8, "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"}),
    ] {
        let view = Tiny::new().with("/bufferViews/0/extensions", json!({"EXT_meshopt_compression": meshopt}));
        broken(read(&view.glb()), "EXT_meshopt_compression");
    }
}

#[test]
fn numbers_that_name_nothing() {
    for (pointer, what) in [
        ("/nodes/0/mesh", "mesh"),
        ("/nodes/0/skin", "skin"),
        ("/nodes/0/children", "child node"),
        ("/skins/0/joints", "node"),
        ("/skins/0/skeleton", "node"),
        ("/skins/0/inverseBindMatrices", "accessor"),
        ("/meshes/0/primitives/0/indices", "accessor"),
        ("/meshes/0/primitives/0/attributes/POSITION", "accessor"),
        ("/meshes/0/primitives/0/attributes/JOINTS_0", "accessor"),
        ("/accessors/0/bufferView", "buffer view"),
        ("/bufferViews/0/buffer", "buffer"),
    ] {
        let list = pointer.ends_with("children") || pointer.ends_with("joints");
        let fault = fault(pointer, if list { json!([77]) } else { json!(77) });
        match &fault {
            Fault::Reference { from, to, index: 77, .. } => {
                assert_eq!(*to, what, "{pointer}");
                assert!(from.contains(|c: char| c.is_ascii_digit()), "{pointer}: {from}");
            }
            _ => panic!("{pointer}: {fault:?}"),
        }
    }
}

#[test]
fn bytes_that_are_not_there() {
    assert_fault!(fault("/buffers/0", json!({"byteLength": 10})), Fault::ViewBounds { found: 10, .. });
    assert_fault!(fault("/bufferViews/0/byteOffset", json!(u64::MAX - 7)), Fault::ViewBounds { view: 0, .. });
    assert_fault!(fault("/accessors/0/byteOffset", json!(4)), Fault::AccessorBounds { accessor: POSITION, .. });
    assert_fault!(fault("/accessors/0/byteOffset", json!(u64::MAX - 7)), Fault::AccessorBounds { .. });
    assert_fault!(fault("/accessors/3/count", json!(3_000_000)), Fault::AccessorBounds { accessor: INDICES, .. });
    assert_fault!(fault("/accessors/0/count", json!(4_000_000_000u64)), Fault::TooLarge { .. });
    assert_fault!(fault("/bufferViews/0/byteStride", json!(8)), Fault::Stride { stride: 8, size: 12, .. });
    assert_fault!(fault("/bufferViews/0/byteStride", json!(u32::MAX)), Fault::AccessorBounds { .. });
    assert_fault!(fault("/buffers/0", json!({"byteLength": 9, "uri": "x.bin"})), Fault::BufferFile { .. });
    assert_fault!(fault("/buffers/0", json!({"byteLength": 9, "uri": "../x.bin"})), Fault::UriOutside { .. });
    assert_fault!(fault("/buffers/0", json!({"byteLength": 9, "uri": "http://a/x"})), Fault::UriScheme { .. });
    assert_fault!(fault("/buffers/0", json!({"byteLength": 9, "uri": "data:;base64,*"})), Fault::Base64 { .. });
    let json_only = Tiny::new().document.to_string();
    assert_fault!(read(json_only.as_bytes()).unwrap_err(), Fault::NoBinaryChunk(0));
}

#[test]
fn accessors_of_the_wrong_kind() {
    assert_fault!(fault("/accessors/0/componentType", json!(5130)), Fault::ComponentType { found: 5130, .. });
    for (accessor, component) in [(JOINTS, 5126), (WEIGHTS, 5125), (INDICES, 5126), (INVERSE_BIND, 5123)] {
        let pointer = format!("/accessors/{accessor}/componentType");
        assert_fault!(fault(&pointer, json!(component)), Fault::AccessorType { .. });
    }
    assert_fault!(fault("/accessors/0/type", json!("VEC2")), Fault::AccessorType { accessor: POSITION, .. });
    assert_fault!(fault("/accessors/1/count", json!(3)), Fault::AttributeCount { found: 3, wanted: 4, .. });
    let sparse = |index: u8| {
        let tiny = Tiny::new().with_accessor(5121, "SCALAR", 1, &[index, 0, 0, 0]);
        let values = json!({"bufferView": 0});
        let indices = json!({"bufferView": 5, "componentType": 5121});
        read(&tiny.with("/accessors/0/sparse", json!({"count": 1, "indices": indices, "values": values})).glb())
    };
    assert!(sparse(3).is_ok());
    assert_fault!(sparse(4).unwrap_err(), Fault::SparseIndex { index: 4, count: 4, .. });
}

#[test]
fn numbers_that_are_not_finite() {
    for (accessor, at) in [(POSITION, 0), (WEIGHTS, 64), (INVERSE_BIND, 152)] {
        for value in [f32::NAN, f32::INFINITY] {
            let fault = read(&Tiny::new().with_bytes(at, &value.to_le_bytes()).glb()).unwrap_err();
            assert!(matches!(fault, Fault::NotFinite { accessor: a, .. } if a == accessor), "{fault:?}");
        }
    }
    // Finite numbers that f32 cannot hold.
    let far = Tiny::new().with("/nodes/-", json!({"translation": [1e300, 0, 0], "children": [1]}));
    assert_fault!(read(&far.glb()).unwrap_err(), Fault::JointNotFinite { node: 1, .. });
    let large = Tiny::new().with("/nodes/-", json!({"scale": [1e30, 1e30, 1e30], "children": [1]}));
    let large = large.with_bytes(0, &1e20f32.to_le_bytes());
    assert_fault!(read(&large.glb()).unwrap_err(), Fault::VertexNotFinite { vertex: 0, .. });
    assert_fault!(fault("/nodes/1/translation", json!([0, 0])), Fault::Json { .. });
}

#[test]
fn primitives_that_do_not_add_up() {
    assert_fault!(fault("/meshes/0/primitives/0/mode", json!(7)), Fault::Mode { mode: 7, .. });
    assert_fault!(
        read(&Tiny::new().with_bytes(128, &[9, 0]).glb()).unwrap_err(),
        Fault::VertexIndex { vertex: 9, count: 4, .. }
    );
    assert_fault!(
        read(&Tiny::new().with_bytes(48, &[5]).glb()).unwrap_err(),
        Fault::JointIndex { vertex: 0, joint: 5, count: 2, .. }
    );
    let attributes = json!({"POSITION": POSITION, "WEIGHTS_0": WEIGHTS});
    assert_fault!(fault("/meshes/0/primitives/0/attributes", attributes), Fault::AttributeMissing { .. });
    assert_fault!(fault("/meshes/0/primitives/0/mode", json!(0)), Fault::NothingBound);
    assert_fault!(fault("/meshes/0/primitives", json!([])), Fault::NothingBound);
    assert_fault!(read(br#"{"asset":{"version":"2.0"}}"#).unwrap_err(), Fault::NoMesh);
}

#[test]
fn nodes_and_skins_that_make_no_skeleton() {
    assert_fault!(fault("/nodes/2/children", json!([1])), Fault::Cycle(1 | 2));
    assert_fault!(fault("/nodes/0/children", json!([2])), Fault::TwoParents { node: 2, first: 0, second: 1 });
    assert_fault!(fault("/skins/0/joints", json!([])), Fault::EmptySkin(0));
    assert_fault!(fault("/skins/0/joints", json!([1, 1])), Fault::JointTwice { skin: 0, node: 1 });
    assert_fault!(fault("/accessors/4/count", json!(1)), Fault::InverseBindCount { found: 1, wanted: 2, .. });
    assert_fault!(
        read(&Tiny::new().with_bytes(152, &[0; 16]).glb()).unwrap_err(),
        Fault::Singular { skin: 0, joint: 0, node: 1 }
    );
}

#[test]
fn a_bare_mesh_is_no_asset() {
    let mut tiny = Tiny::new();
    tiny.document.as_object_mut().unwrap().remove("skins");
    tiny.document["nodes"][0].as_object_mut().unwrap().remove("skin");
    let imported = read(&tiny.glb()).unwrap();
    assert!(imported.rig().is_none());
    assert_eq!(imported.mesh().positions().len(), 4);
    assert_fault!(imported.into_asset().unwrap_err().fault, Fault::NoSkeleton);
}
