//! What a document has beside its rig is in what is written.

mod common;

use common::{INDICES, JOINTS, POSITION, Tiny, WEIGHTS, renamed};
use riglab_asset::export::{self, ExportNote, ExportOptions, Exported, Influences, JointFrames};
use riglab_asset::{ImportOptions, Imported, Warning, import, import_bytes};
use riglab_core::{HumanBone, Humanoid, JointId, Rig, SkinWeights};
use serde_json::{Value, json};

/// The smallest PNG header there is; nothing looks further.
const PICTURE: &[u8] = b"\x89PNG\r\n\x1a\nnot a picture, but its bytes";

fn read(bytes: &[u8]) -> Imported {
    import_bytes("tiny.glb", bytes, &ImportOptions::default()).unwrap()
}

/// The file written with another rig; its mesh is that of the file.
fn onto(bytes: &[u8], rig: impl FnOnce(&Rig) -> Rig, options: ExportOptions) -> Exported {
    let imported = read(bytes);
    let rig = rig(imported.rig().unwrap());
    export::onto_bytes("tiny.glb", bytes, None, &imported, &rig, &options).unwrap()
}

fn strip(bytes: &[u8]) -> Exported {
    export::strip_bytes("tiny.glb", bytes, None, &ImportOptions::default()).unwrap()
}

/// JSON and binary chunk.
fn parts(bytes: &[u8]) -> (Value, Vec<u8>) {
    let length = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let json = serde_json::from_slice(&bytes[20..20 + length(12)]).unwrap();
    (json, bytes.get(28 + length(12)..).unwrap_or_default().to_vec())
}

/// The bytes of a view.
fn view((json, binary): &(Value, Vec<u8>), number: &Value) -> Vec<u8> {
    let view = &json["bufferViews"][number.as_u64().unwrap() as usize];
    let at = |key: &str| view.get(key).map_or(0, |v| v.as_u64().unwrap() as usize);
    binary[at("byteOffset")..at("byteOffset") + at("byteLength")].to_vec()
}

/// Pictures by number, where they are in the file.
fn pictures(of: &(Value, Vec<u8>)) -> Vec<Vec<u8>> {
    let images = of.0["images"].as_array().into_iter().flatten();
    images.filter(|i| i.get("bufferView").is_some()).map(|i| view(of, &i["bufferView"])).collect()
}

/// A document's asset without the word of who wrote the file.
fn unmarked(document: &Value) -> Value {
    let mut asset = document["asset"].clone();
    let extras = asset.get_mut("extras").and_then(Value::as_object_mut);
    let empty = extras.is_some_and(|extras| extras.remove("writer").is_some() && extras.is_empty());
    if empty {
        asset.as_object_mut().unwrap().remove("extras");
    }
    asset
}

#[test]
fn looks_and_pictures_of_all_rigs_stay_byte_for_byte() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    for path in common::files(&folder, &["glb", "vrm"]) {
        let before = parts(&std::fs::read(&path).unwrap());
        let imported = import(&path, &ImportOptions::default()).unwrap();
        let Some(rig) = imported.rig() else { continue };
        let options = ExportOptions::default();
        let written = [
            export::onto(&path, &imported, rig, &options),
            export::onto(&path, &imported, &renamed(rig), &options),
            export::strip(&path, &ImportOptions::default()),
        ];
        for exported in written {
            let after = parts(&exported.unwrap().bytes);
            for key in ["materials", "textures", "samplers", "cameras", "extras"] {
                assert_eq!(before.0.get(key), after.0.get(key), "{key} of {}", path.display());
            }
            let writer = after.0["asset"]["extras"]["writer"].as_str();
            assert!(writer.is_some_and(|said| said.starts_with("riglab ")), "who wrote {}", path.display());
            assert_eq!(unmarked(&before.0), unmarked(&after.0), "asset of {}", path.display());
            assert_eq!(pictures(&before), pictures(&after), "pictures of {}", path.display());
            let names = |json: &Value| -> Vec<Value> {
                json["meshes"].as_array().unwrap().iter().map(|m| m["name"].clone()).collect()
            };
            assert_eq!(names(&before.0), names(&after.0)[..names(&before.0).len()]);
        }
    }
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let bytes = Tiny::new().glb();
    for options in [ExportOptions::default(), ExportOptions { frames: JointFrames::AlongBone, ..Default::default() }] {
        assert_eq!(onto(&bytes, renamed, options), onto(&bytes, renamed, options));
    }
    assert_eq!(strip(&bytes), strip(&bytes));
    // Once written, nothing is left to change.
    let once = onto(&bytes, Rig::clone, ExportOptions::default()).bytes;
    assert_eq!(onto(&once, Rig::clone, ExportOptions::default()).bytes, once);
}

#[test]
fn what_lies_beside_a_file_comes_into_it() {
    use base64::Engine;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let tiny = Tiny::new();
    std::fs::write(at("a buffer.bin"), &tiny.binary).unwrap();
    std::fs::write(at("a.png"), PICTURE).unwrap();
    let data = base64::engine::general_purpose::STANDARD.encode(PICTURE);
    let images =
        json!([{"uri": "a.png", "name": "p"}, {"uri": format!("data:image/png;base64,{data}")}, {"uri": "none.png"}]);
    let document = Tiny::new().with("/buffers/0/uri", json!("a%20buffer.bin")).with("/images", images).document;
    std::fs::write(at("a.gltf"), document.to_string()).unwrap();

    let imported = import(at("a.gltf"), &ImportOptions::default()).unwrap();
    let rig = imported.rig().unwrap();
    let exported = export::onto(at("a.gltf"), &imported, rig, &ExportOptions::default()).unwrap();
    assert_eq!(exported.notes, [ExportNote::PictureLeft { image: 2, uri: "none.png".into(), outside: false }]);
    let after = parts(&exported.bytes);
    assert_eq!(pictures(&after), [PICTURE, PICTURE]);
    assert_eq!((&after.0["images"][0]["name"], &after.0["images"][0]["mimeType"]), (&json!("p"), &json!("image/png")));
    assert_eq!(after.0["images"][2], json!({"uri": "none.png"}));
    assert_eq!(read(&exported.bytes).rig(), Some(rig));
}

#[test]
fn only_weights_that_differ_are_written() {
    let bytes = Tiny::new().glb();
    let changed = onto(
        &bytes,
        |rig| {
            let rows = [vec![(0, 0.5), (1, 0.5)], vec![(1, 1.0)], vec![(0, 1.0)], vec![(1, 1.0)]];
            rig.with_weights(SkinWeights::normalized(rows).unwrap()).unwrap()
        },
        ExportOptions::default(),
    );
    let (before, after) = (parts(&bytes), parts(&changed.bytes));
    assert_eq!(
        (&before.0["nodes"], &before.0["skins"][0]["joints"]),
        (&after.0["nodes"], &after.0["skins"][0]["joints"])
    );
    let position = |of: &(Value, Vec<u8>)| {
        let accessor = &of.0["meshes"][0]["primitives"][0]["attributes"]["POSITION"];
        view(of, &of.0["accessors"][accessor.as_u64().unwrap() as usize]["bufferView"])
    };
    assert_eq!(position(&before), position(&after));
    let rig = read(&changed.bytes);
    let row = |v| rig.rig().unwrap().weights().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
    assert_eq!([row(0), row(1), row(2)], [vec![(0, 0.5), (1, 0.5)], vec![(1, 1.0)], vec![(0, 1.0)]]);
    // The old weights are gone, not just unnamed.
    assert_eq!(after.0["accessors"].as_array().unwrap().len(), 5);
}

#[test]
fn a_new_skeleton_takes_the_place_of_the_old_one() {
    let joint = |path: &str, node: usize| json!({"sampler": 0, "target": {"node": node, "path": path}});
    let animations =
        json!([{"channels": [joint("rotation", 2), joint("translation", 4)], "samplers": [{"input": 2, "output": 0}]}]);
    // Below the tip hangs a camera, so the way to it stays.
    let bytes = Tiny::new()
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"camera": 0}))
        .with("/nodes/-", json!({"name": "lamp"}))
        .with("/scenes", json!([{"nodes": [0, 1, 4]}]))
        .with("/cameras", json!([{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}]))
        .with("/animations", animations)
        .glb();
    let exported = onto(&bytes, renamed, ExportOptions::default());
    assert_eq!(exported.notes, [ExportNote::MotionDropped { channels: 1 }]);
    let after = parts(&exported.bytes).0;
    let names: Vec<&str> =
        after["nodes"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap_or("")).collect();
    assert_eq!(names, ["body", "hips", "tip", "", "lamp", "new hips", "new tip", "Armature"]);
    assert_eq!(after["scenes"], json!([{"nodes": [0, 1, 4, 7]}]));
    assert_eq!(after["animations"][0]["channels"], json!([joint("translation", 4)]));
    assert_eq!((&after["skins"][0]["joints"], after["skins"].as_array().unwrap().len()), (&json!([5, 6]), 1));

    let bare = parts(&onto(&Tiny::new().glb(), renamed, ExportOptions::default()).bytes).0;
    assert_eq!(bare["nodes"].as_array().unwrap().len(), 4);
}

#[test]
fn stripped_files_have_nothing_of_a_rig() {
    let stripped = strip(&Tiny::new().with("/nodes/0/extras", json!({"kept": 1})).glb());
    let (json, binary) = parts(&stripped.bytes);
    assert_eq!(json["nodes"], json!([{"name": "body", "mesh": 0, "extras": {"kept": 1}}]));
    assert_eq!(json["meshes"][0]["primitives"][0]["attributes"], json!({"POSITION": 0}));
    assert_eq!((json.get("skins"), json["accessors"].as_array().unwrap().len(), binary.len()), (None, 2, 48 + 24));
    let back = read(&stripped.bytes);
    assert_eq!(back.mesh(), read(&Tiny::new().glb()).mesh());
    // Nothing is left to strip.
    assert_eq!(strip(&stripped.bytes).bytes, stripped.bytes);
}

#[test]
fn a_mesh_on_two_nodes_becomes_two() {
    let bytes = Tiny::new()
        .with("/nodes/-", json!({"mesh": 0, "skin": 1, "scale": [1, 1, -1]}))
        .with("/nodes/-", json!({"name": "other", "translation": [5, 0, 0]}))
        .with("/skins/-", json!({"joints": [4]}))
        .with("/meshes/0/name", json!("twins"));
    let joints: Vec<u8> = [[0u8; 4]; 4].concat();
    let weights: Vec<u8> = [1.0f32, 0.0, 0.0, 0.0].repeat(4).iter().flat_map(|w| w.to_le_bytes()).collect();
    let bytes = bytes.with_accessor(5121, "VEC4", 4, &joints).with_accessor(5126, "VEC4", 4, &weights);
    let bytes = bytes
        .with("/meshes/0/primitives/0/attributes/JOINTS_0", json!(5))
        .with("/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(6))
        .glb();
    let imported = read(&bytes);
    let exported = onto(&bytes, renamed, ExportOptions::default());
    let back = read(&exported.bytes);
    assert_eq!(back.mesh(), imported.mesh());
    assert_eq!(back.rig().unwrap().weights(), imported.rig().unwrap().weights());
    assert_eq!(parts(&exported.bytes).0["meshes"].as_array().unwrap().len(), 2);
}

#[test]
fn mirrored_meshes_face_as_before_when_they_are_bound() {
    let bare = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]});
    let bytes = Tiny::new()
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"mesh": 1, "scale": [-1, 1, 1]}))
        .with("/meshes/-", bare)
        .glb();
    let before = read(&bytes);
    assert_eq!(before.mesh().triangles()[4..6], [[4, 5, 6], [4, 7, 5]]);
    let exported = onto(&bytes, renamed, ExportOptions::default());
    assert_eq!(exported.notes, [ExportNote::TrianglesTurned { surfaces: 1 }]);
    let back = read(&exported.bytes);
    assert_eq!(back.mesh(), before.mesh());
}

#[test]
fn meshes_stripped_of_what_mirrors_them_face_as_before() {
    let bare = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]});
    let hung = |tiny: Tiny, mesh: serde_json::Value| {
        tiny.with("/nodes/2/children", json!([3]))
            .with("/nodes/-", json!({"mesh": 1, "scale": [-1, 1, 1], "translation": [0, -2, 0]}))
            .with("/meshes/-", mesh)
    };
    // In the plane that its node mirrors it through it stands where it stood, turned.
    let flat = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.5, 0.0], [0.0, 0.0, 1.0f32]];
    let flat: Vec<u8> = flat.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let with_flat = Tiny::new().with_accessor(5126, "VEC3", 4, &flat);
    let of_flat = json!({"primitives": [{"attributes": {"POSITION": with_flat.accessors() - 1}, "indices": INDICES}]});
    // Mesh and joints under one node, so that the mesh's own node says what the skin does.
    let skinned = Tiny::new().with("/nodes/-", json!({"name": "all", "scale": [-1, 1, 1], "children": [0, 1]}));
    for (name, tiny) in [("hung", hung(Tiny::new(), bare)), ("flat", hung(with_flat, of_flat)), ("skinned", skinned)] {
        let bytes = tiny.glb();
        let before = read(&bytes);
        assert_eq!(read(&strip(&bytes).bytes).mesh(), before.mesh(), "{name}, stripped");
        let bound = onto(&bytes, renamed, ExportOptions::default());
        assert_eq!(read(&bound.bytes).mesh(), before.mesh(), "{name}, bound anew");
    }
}

#[test]
fn lines_go_with_the_mesh_they_are_on() {
    let line = json!({"attributes": {"POSITION": POSITION}, "mode": 3});
    let bytes = Tiny::new().with("/meshes/0/primitives/-", line).glb();
    let exported = onto(&bytes, renamed, ExportOptions::default());
    let after = parts(&exported.bytes);
    let weights = &after.0["meshes"][0]["primitives"][1]["attributes"]["WEIGHTS_0"];
    let accessor = &after.0["accessors"][weights.as_u64().unwrap() as usize];
    let shares: Vec<f32> =
        view(&after, &accessor["bufferView"]).as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert_eq!(shares[12..14], [0.75, 0.25]);
    assert_eq!(read(&exported.bytes).warnings(), [Warning::NoSurface { primitives: 1, still: Vec::new() }]);
}

#[test]
fn lines_without_a_surface_stand_where_their_skin_has_them() {
    let attributes = json!({"POSITION": POSITION, "JOINTS_0": JOINTS, "WEIGHTS_0": WEIGHTS});
    let bytes = Tiny::new()
        .with("/nodes/-", json!({"name": "armature", "scale": [0.5, 0.5, 0.5], "children": [1]}))
        .with("/nodes/-", json!({"name": "lines", "mesh": 1, "skin": 0, "translation": [9, 0, 0]}))
        .with("/meshes/-", json!({"primitives": [{"attributes": attributes, "mode": 1}]}))
        .glb();
    let body = read(&bytes).rig().unwrap().bounds().max;
    assert_eq!(body, [0.5, 1.25, 0.5]);
    let lines = |exported: &Exported| {
        let after = parts(&exported.bytes);
        let node = after.0["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "lines").unwrap().clone();
        let attributes =
            after.0["meshes"][node["mesh"].as_u64().unwrap() as usize]["primitives"][0]["attributes"].clone();
        let position = &after.0["accessors"][attributes["POSITION"].as_u64().unwrap() as usize];
        assert_eq!(position["max"], json!(body), "{node}");
        (node, attributes, after)
    };
    let bare = strip(&bytes);
    let (node, attributes, _) = lines(&bare);
    assert!(["translation", "skin"].iter().all(|key| node.get(key).is_none()) && attributes.get("WEIGHTS_0").is_none());
    // What stands so already stays as it is.
    let again = Tiny::new()
        .with("/nodes/-", json!({"name": "lines", "mesh": 1, "skin": 0}))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": POSITION, "JOINTS_0": JOINTS, "WEIGHTS_0": WEIGHTS}, "mode": 1}]}));
    let after = parts(&strip(&again.glb()).bytes).0;
    assert_eq!(after["meshes"][0]["primitives"][0]["attributes"], after["meshes"][1]["primitives"][0]["attributes"]);
    // With another rig they go with the surface near them.
    let (node, attributes, after) = lines(&onto(&bytes, renamed, ExportOptions::default()));
    let weights = &after.0["accessors"][attributes["WEIGHTS_0"].as_u64().unwrap() as usize];
    let shares: Vec<f32> =
        view(&after, &weights["bufferView"]).as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert_eq!((&shares[..2], &shares[12..14]), (&[1.0, 0.0][..], &[0.75, 0.25][..]));
    assert_eq!(after.0["skins"][node["skin"].as_u64().unwrap() as usize]["joints"].as_array().unwrap().len(), 2);
}

#[test]
fn influences_are_cut_to_what_is_asked_for() {
    let rig = |rig: &Rig| {
        let joints = (0..6u16).map(|j| riglab_core::Joint {
            name: format!("j{j}"),
            parent: j.checked_sub(1).map(riglab_core::JointId),
            head: [0.0, f32::from(j), 0.0],
        });
        let skeleton = riglab_core::Skeleton::new(joints.collect()).unwrap();
        let row: Vec<(u16, f64)> = (0..6).map(|j| (j, f64::from(j) + 1.0)).collect();
        Rig::new(skeleton, rig.mesh().clone(), SkinWeights::normalized(vec![row; 4]).unwrap()).unwrap()
    };
    let most = |influences| {
        let exported = onto(&Tiny::new().glb(), rig, ExportOptions { influences, ..Default::default() });
        let row: Vec<f32> = read(&exported.bytes).rig().unwrap().weights().row(0).map(|(_, w)| w).collect();
        (row, exported.notes)
    };
    let (row, notes) = most(Influences::Four);
    let near = |(row, wanted): (&f32, f32)| (row - wanted / 18.0).abs() < 1e-6;
    assert!(row.len() == 4 && row.iter().zip([3.0, 4.0, 5.0, 6.0]).all(near), "{row:?}");
    assert!(
        matches!(notes[..], [ExportNote::InfluencesCut { vertices: 4, most: 4, lost }] if (lost - 3.0 / 21.0).abs() < 1e-6)
    );
    let (row, notes) = most(Influences::Eight);
    assert_eq!((row.len(), notes.len()), (6, 0));
}

#[test]
fn turned_joints_stand_where_straight_ones_do() {
    let bytes = Tiny::new().with("/nodes/1/translation", json!([0.3, 1, 0.2])).glb();
    let imported = read(&bytes);
    let exported = onto(&bytes, renamed, ExportOptions { frames: JointFrames::AlongBone, ..Default::default() });
    let back = read(&exported.bytes);
    let (a, b) = (back.rig().unwrap(), imported.rig().unwrap());
    let near = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6)
    };
    assert!(near(a.skeleton().heads(), b.skeleton().heads()), "{:?}", a.skeleton().heads());
    assert!(near(a.mesh().positions(), b.mesh().positions()));
}

#[test]
fn rigs_of_other_meshes_and_changed_files_are_refused() {
    let bytes = Tiny::new().glb();
    let imported = read(&bytes);
    let rig = imported.rig().unwrap();
    let moved = rig.mesh().with_positions(rig.mesh().positions().iter().map(|p| p.map(|x| x + 1.0)).collect()).unwrap();
    let other = Rig::new(rig.skeleton().clone(), moved, rig.weights().clone()).unwrap();
    let options = ExportOptions::default();
    let error = export::onto_bytes("tiny.glb", &bytes, None, &imported, &other, &options).unwrap_err().to_string();
    assert!(error.starts_with("tiny.glb: the rig has another mesh"), "{error}");
    let changed = Tiny::new().with("/asset/copyright", json!("x")).glb();
    let error = export::onto_bytes("tiny.glb", &changed, None, &imported, rig, &options).unwrap_err().to_string();
    assert!(error.contains("not the one that was imported"), "{error}");
    let error = export::strip_bytes("a.obj", b"v 0 0 0\n", None, &ImportOptions::default()).unwrap_err().to_string();
    assert!(error.contains("only glTF, GLB and VRM"), "{error}");
}

#[test]
fn a_source_without_document_gives_a_plain_one() {
    let text = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n";
    let imported = import_bytes("a.obj", text, &ImportOptions::default()).unwrap();
    let tiny = read(&Tiny::new().glb());
    let rig = Rig::new(
        tiny.rig().unwrap().skeleton().clone(),
        imported.mesh().clone(),
        tiny.rig().unwrap().weights().clone(),
    );
    let rig = rig.unwrap();
    let exported = export::onto_bytes("a.obj", text, None, &imported, &rig, &ExportOptions::default()).unwrap();
    assert_eq!(read(&exported.bytes).rig(), Some(&rig));
    assert_eq!(parts(&exported.bytes).0["materials"].as_array().unwrap().len(), 1);
}

#[test]
fn documents_with_unknown_extensions_keep_their_numbers() {
    let named = Tiny::new().with("/extensionsUsed", json!(["ACME_rope", "GODOT_single_root"]));
    // One that is used nowhere names nothing.
    let bare = strip(&named.clone().glb());
    assert_eq!((parts(&bare.bytes).0["nodes"].as_array().unwrap().len(), &bare.notes[..]), (1, &[][..]));
    let stripped = strip(&named.with("/extensions", json!({"ACME_rope": {"node": 2}})).glb());
    let [stay @ ExportNote::JointsStay { nodes: 2, .. }] = &stripped.notes[..] else { panic!("{:?}", stripped.notes) };
    let told = stay.to_string();
    assert!(told.starts_with("2 nodes that were for the old rig alone stay") && told.contains("ACME_rope"), "{told}");
    let stripped = parts(&stripped.bytes).0;
    assert_eq!(stripped["nodes"].as_array().unwrap().len(), 3);
    assert_eq!(
        (&stripped["nodes"][2]["name"], &stripped["extensions"]["ACME_rope"]["node"]),
        (&json!("tip"), &json!(2))
    );
}

#[test]
fn files_are_written_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    export::write(&path, b"old").unwrap();
    export::write(&path, b"new").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"new");
    assert!(export::write(folder.path().join("none/a.glb"), b"x").is_err());
    // A folder cannot be replaced by a file; nothing stays behind.
    std::fs::create_dir(folder.path().join("taken")).unwrap();
    assert!(export::write(folder.path().join("taken"), b"x").is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    assert!(export::same_file(&path, folder.path().join("taken/../a.glb")));
    assert!(!export::same_file(&path, folder.path().join("b.glb")));
}

#[test]
fn human_bones_of_a_new_rig_are_written_in_the_words_of_the_version() {
    let bone = |name: &str| name.parse::<HumanBone>().unwrap();
    let body = |rig: &Rig| {
        let mut humanoid = Humanoid::default();
        humanoid.insert(bone("hips"), JointId(0));
        humanoid.insert(bone("leftThumbMetacarpal"), JointId(1));
        renamed(rig).with_humanoid(humanoid).unwrap()
    };
    let old = json!({"humanBones": [{"bone": "hips", "node": 2}], "armStretch": 0.05});
    let one = json!({"VRMC_vrm": {"specVersion": "1.0", "humanoid": {"humanBones": {"hips": {"node": 2}}}}});
    for extensions in [json!({"VRM": {"humanoid": old}}), one] {
        let bytes = Tiny::new().with("/extensions", extensions).glb();
        let exported = onto(&bytes, body, ExportOptions::default());
        let back = read(&exported.bytes);
        let bones: Vec<_> = back.rig().unwrap().humanoid().iter().collect();
        assert_eq!(bones, [(bone("hips"), JointId(0)), (bone("leftThumbMetacarpal"), JointId(1))]);
    }
    let zero = Tiny::new().with("/extensions", json!({"VRM": {"humanoid": {"humanBones": [], "armStretch": 0.05}}}));
    let after = parts(&onto(&zero.glb(), body, ExportOptions::default()).bytes).0;
    assert_eq!(after["extensions"]["VRM"]["humanoid"]["armStretch"], 0.05);
    assert_eq!(after["extensions"]["VRM"]["humanoid"]["humanBones"][1]["bone"], "leftThumbProximal");
    // A rig that knows of no body: bones of joints that are gone go.
    let after = parts(&onto(&zero.glb(), renamed, ExportOptions::default()).bytes).0;
    assert_eq!(after["extensions"]["VRM"]["humanoid"]["humanBones"], json!([]));
}

/// The file's mesh on a new skeleton of a single joint.
fn on_one_joint(bytes: &[u8]) -> Exported {
    let imported = read(bytes);
    let joint = riglab_core::Joint { name: "new".into(), parent: None, head: [0.0; 3] };
    let skeleton = riglab_core::Skeleton::new(vec![joint]).unwrap();
    let rows = vec![vec![(0u16, 1.0)]; imported.mesh().positions().len()];
    let rig = Rig::new(skeleton, imported.mesh().clone(), SkinWeights::normalized(rows).unwrap()).unwrap();
    export::onto_bytes("tiny.glb", bytes, None, &imported, &rig, &ExportOptions::default()).unwrap()
}

#[test]
fn meshes_bound_anew_stand_on_no_node_that_mirrors_them() {
    // A mirrored copy beside joints, and a bare model of which a part is one.
    let bare = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]});
    let mut loose = Tiny::new().with("/nodes/0", json!({"mesh": 1, "scale": [-1, 1, 1]})).with("/meshes/-", bare);
    loose.document.as_object_mut().unwrap().remove("skins");
    let skinned = Tiny::new().with("/nodes/-", json!({"name": "all", "scale": [-1, 1, 1], "children": [0, 1]}));
    for (name, tiny) in [("bare", loose), ("skinned", skinned)] {
        let bytes = tiny.glb();
        let imported = read(&bytes);
        let exported = on_one_joint(&bytes);
        let (document, _) = parts(&exported.bytes);
        for node in document["nodes"].as_array().unwrap().iter().filter(|node| node.get("skin").is_some()) {
            assert!(node.get("scale").is_none(), "{name}: {node}");
        }
        let listed: Vec<&Value> =
            document["nodes"].as_array().unwrap().iter().filter(|n| n.get("scale").is_some()).collect();
        assert!(
            listed.iter().all(|n| n.get("children").is_none()),
            "{name}: nothing is left below what mirrors: {listed:?}"
        );
        assert_eq!(read(&exported.bytes).mesh(), imported.mesh(), "{name}");
    }
}

#[test]
fn a_part_that_mirrors_itself_stays_below_its_parents() {
    let bare = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]});
    let of = |part: Value| {
        let mut tiny = Tiny::new()
            .with("/nodes/0", json!({"name": "group", "translation": [0, 0, 1], "children": [3]}))
            .with("/nodes/-", part)
            .with("/nodes/-", json!({"name": "socket"}))
            .with("/meshes/-", bare.clone());
        tiny.document.as_object_mut().unwrap().remove("skins");
        let exported = on_one_joint(&tiny.glb());
        let nodes = parts(&exported.bytes).0["nodes"].as_array().unwrap().clone();
        let at = nodes.iter().position(|node| node.get("skin").is_some()).unwrap();
        let group = nodes.iter().find(|node| node["name"] == "group").unwrap();
        let below = group["children"].as_array().is_some_and(|children| children.contains(&json!(at)));
        (nodes[at].clone(), below)
    };
    let (part, below) = of(json!({"name": "arm", "mesh": 1, "scale": [-1, 1, 1], "translation": [2, 0, 0]}));
    assert!(below && part.get("scale").is_none() && part.get("translation").is_none(), "{part}");
    // What hangs on it stays where it is.
    let (part, below) = of(json!({"name": "arm", "mesh": 1, "scale": [-1, 1, 1], "children": [4]}));
    assert!(!below && part.get("children").is_none(), "{part}");
}

#[test]
fn what_is_hidden_stays_hidden_at_the_top_of_the_scene() {
    let hidden = json!({"KHR_node_visibility": {"visible": false}});
    let shown = |bytes: &[u8]| {
        let json = parts(bytes).0;
        let roots = json["scenes"][0]["nodes"].as_array().unwrap().clone();
        let node = |n: &Value| json["nodes"][n.as_u64().unwrap() as usize].clone();
        let mesh = roots.iter().map(node).find(|node| node.get("mesh").is_some()).expect("at the top");
        (mesh["extensions"]["KHR_node_visibility"]["visible"] != false, json["extensionsUsed"].clone())
    };
    let group = |more: Value| {
        let mut own = json!({"name": "outfit", "children": [0], "scale": [2, 2, 2]});
        own.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        Tiny::new().with("/nodes/-", own).with("/scenes", json!([{"nodes": [1, 3]}]))
    };
    assert!(shown(&strip(&group(json!({})).glb()).bytes).0);
    let above = group(json!({"extensions": hidden}));
    assert_eq!(shown(&strip(&above.glb()).bytes), (false, json!(["KHR_node_visibility"])));
    // Of a node that others hang on, the mesh goes and the node stays.
    let holds = group(json!({})).with("/nodes/0/extensions", hidden).with("/nodes/0/children", json!([4]));
    let holds = holds.with("/nodes/-", json!({"name": "socket"})).with("/nodes/0/translation", json!([1, 0, 0]));
    assert!(!shown(&strip(&holds.glb()).bytes).0);
}

/// The tiny rig with a motion that shifts a node, and what hangs on its body.
fn shifted(node: usize, body: Value) -> Tiny {
    let shifts: Vec<u8> = [0.0f32, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let tiny = Tiny::new()
        .with_accessor(5126, "SCALAR", 2, &[0.0f32, 1.0].map(f32::to_le_bytes).concat())
        .with_accessor(5126, "VEC3", 2, &shifts);
    let channel = json!({"sampler": 0, "target": {"node": node, "path": "translation"}});
    tiny.with("/animations", json!([{"channels": [channel], "samplers": [{"input": 5, "output": 6}]}]))
        .with("/nodes/0", body)
        .with("/nodes/-", json!({"name": "hat"}))
        .with("/nodes/-", json!({"name": "far", "mesh": 0, "skin": 0}))
}

#[test]
fn what_hangs_on_a_node_that_its_mesh_left_moves_still() {
    let lod = json!({"MSFT_lod": {"ids": [4]}});
    let body = json!({
        "name": "body", "mesh": 0, "skin": 0, "translation": [9, 0, 0], "children": [3],
        "extensions": lod, "extras": {"MSFT_screencoverage": [0.5, 0.1], "own": 1},
    });
    // Below a scaled node, so that no mesh stays where it is.
    let above = json!({"name": "all", "scale": [2, 2, 2], "children": [0, 1]});
    let stripped = strip(&shifted(0, body).with("/nodes/-", above).glb());
    assert_eq!(stripped.notes, []);
    let json = parts(&stripped.bytes).0;
    let nodes = json["nodes"].as_array().unwrap();
    let target = &json["animations"][0]["channels"][0]["target"]["node"];
    let old = &nodes[target.as_u64().unwrap() as usize];
    assert_eq!((old.get("mesh"), &old["children"].as_array().unwrap().len()), (None, &1));
    // The simpler mesh goes with the mesh.
    assert_eq!((old.get("extensions"), &old["extras"]), (None, &json!({"own": 1})));
    let new = nodes.iter().find(|node| node["extensions"]["MSFT_lod"].is_object()).expect("with its levels");
    assert!(new.get("mesh").is_some() && new["extras"] == json!({"MSFT_screencoverage": [0.5, 0.1]}), "{new}");
    // What moves the mesh alone goes, as the mesh stands where the rest pose has it.
    let alone = strip(&shifted(0, json!({"name": "body", "mesh": 0, "skin": 0, "translation": [9, 0, 0]})).glb());
    assert_eq!(alone.notes, [ExportNote::MotionDropped { channels: 1 }]);
}

#[test]
fn what_hung_on_joints_is_told_where_they_go() {
    let socket = json!({"name": "WeaponSocket", "extras": {"slot": "sword"}});
    let stripped = strip(&Tiny::new().with("/nodes/-", socket).with("/nodes/2/children", json!([3])).glb());
    assert_eq!(stripped.notes, [ExportNote::HungLost { nodes: 1, bones: 0, constraints: 0 }]);
    assert_eq!(stripped.notes[0].to_string(), "with the old joints went 1 node that hung on them");
}

#[test]
fn expressions_move_each_copy_of_a_mesh() {
    let bind = json!({"mesh": 0, "index": 0, "weight": 100});
    let vrm = json!({"VRM": {"blendShapeMaster": {"blendShapeGroups": [{"name": "a", "binds": [bind]}]}}});
    let bytes = Tiny::new()
        .with("/nodes/-", json!({"name": "twin", "mesh": 0, "skin": 1}))
        .with("/nodes/-", json!({"name": "other", "translation": [5, 0, 0], "children": [5]}))
        .with("/nodes/-", json!({"name": "end"}))
        .with("/skins/-", json!({"joints": [4, 5]}))
        .with("/meshes/0/primitives/0/targets", json!([{"POSITION": POSITION}]))
        .with("/extensions", vrm)
        .with("/extensionsUsed", json!(["VRM"]))
        .glb();
    let json = parts(&onto(&bytes, renamed, ExportOptions::default()).bytes).0;
    let binds = json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"][0]["binds"].as_array().unwrap();
    let mut bound: Vec<&Value> = binds.iter().map(|bind| &bind["mesh"]).collect();
    bound.sort_by_key(|mesh| mesh.as_u64());
    assert_eq!((bound, json["meshes"].as_array().unwrap().len()), (vec![&json!(0), &json!(1)], 2));
}
