//! A finished GLB as FBX: what ufbx sees in it, and what comes back as a rig.
#![cfg(feature = "fbx")]

mod common;

use common::Tiny;
use riglab_asset::export::{self, ExportOptions, Influences};
use riglab_asset::{FbxFile, ImportOptions, Imported, Resample, Warning, glb_to_fbx, import, import_bytes, rigging};
use riglab_core::{Springs, skin};
use serde_json::{Value, json};
use ufbx::{Scene, SceneRoot};

fn floats(all: &[f32]) -> Vec<u8> {
    all.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn written(tiny: &Tiny) -> FbxFile {
    let file = glb_to_fbx(&tiny.glb()).unwrap();
    assert_eq!(glb_to_fbx(&tiny.glb()).unwrap().bytes, file.bytes);
    file
}

/// What ufbx reads, without a word on it.
fn scene(bytes: &[u8]) -> SceneRoot {
    let scene = ufbx::load_memory(bytes, Default::default()).unwrap();
    let warnings: Vec<String> = (&scene.metadata.warnings).into_iter().map(|w| w.description.to_string()).collect();
    assert_eq!(warnings, [] as [&str; 0]);
    scene
}

fn read(name: &str, bytes: &[u8]) -> Imported {
    let clips = Some(Resample { rate: 30.0, frames: 100 });
    import_bytes(name, bytes, &ImportOptions { clips, ..Default::default() }).unwrap()
}

/// A rig that nods as it goes.
fn nodding() -> Tiny {
    let turns = [[0.0, 0.0, 0.0, 1.0], [0.6, 0.0, 0.0, 0.8], [0.0, 0.8, 0.6, 0.0]];
    Tiny::new()
        .with_accessor(5126, "SCALAR", 3, &floats(&[0.0, 0.5, 2.0]))
        .with_accessor(5126, "VEC4", 3, &floats(turns.as_flattened()))
        .with_accessor(5126, "VEC3", 3, &floats(&[0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 1.0, 1.0, 0.0]))
        .with(
            "/animations",
            json!([{"name": "nod", "samplers": [{"input": 5, "output": 6}, {"input": 5, "output": 7}],
                    "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}},
                                 {"sampler": 1, "target": {"node": 1, "path": "translation"}}]}]),
        )
}

#[test]
fn a_rig_and_its_motion_come_back() {
    let tiny =
        nodding().with("/nodes/1/rotation", json!([0.0, 0.0, 0.6, 0.8])).with("/nodes/0/scale", json!([2, 2, 2]));
    let file = written(&tiny);
    let scene = scene(&file.bytes);
    assert_eq!(scene.anim_stacks.len(), 1);
    let (was, is) = (read("a.glb", &tiny.glb()), read("a.fbx", &file.bytes));
    let (old, new) = (was.rig().unwrap(), is.rig().unwrap());
    assert_eq!(old.skeleton().names(), new.skeleton().names());
    assert_eq!((old.mesh().triangles(), old.mesh().positions().len()), (new.mesh().triangles(), 4));
    assert_eq!(was.clips[0].frames(), is.clips[0].frames());
    for frame in 0..was.clips[0].frames() {
        let at = |of: &Imported| skin(of.rig().unwrap(), &of.clips[0].frame(frame)).unwrap();
        for (a, b) in at(&was).as_flattened().iter().zip(at(&is).as_flattened()) {
            // Of angles: the bound of what a turn may be off is 0.1 degrees.
            assert!((a - b).abs() < 5e-3, "frame {frame}: {a} and {b}");
        }
    }
}

#[test]
fn a_joint_keeps_its_place_where_only_the_next_one_moves() {
    // `a` turns the hips and moves the tip; that the hips move, too, is another animation's affair.
    let moved = |name: &str, channels: Value| {
        json!({"name": name, "channels": channels,
               "samplers": [{"input": 5, "output": 6}, {"input": 5, "output": 7}]})
    };
    let to =
        |sampler: usize, node: usize, path: &str| json!({"sampler": sampler, "target": {"node": node, "path": path}});
    let tiny = Tiny::new()
        .with_accessor(5126, "SCALAR", 2, &floats(&[0.0, 1.0]))
        .with_accessor(5126, "VEC4", 2, &floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.6, 0.8]))
        .with_accessor(5126, "VEC3", 2, &floats(&[0.0, 1.0, 0.0, 0.0, 2.5, 0.0]))
        .with(
            "/animations",
            json!([
                moved("a", json!([to(0, 1, "rotation"), to(1, 2, "translation")])),
                moved("b", json!([to(1, 1, "translation")]))
            ]),
        );
    let (was, is) = (read("a.glb", &tiny.glb()), read("a.fbx", &written(&tiny).bytes));
    assert_eq!((was.clips.len(), is.clips.len()), (2, 2));
    for (old, new) in was.clips.iter().zip(&is.clips) {
        let at =
            |of: &Imported, clip: &riglab_core::Clip| skin(of.rig().unwrap(), &clip.frame(clip.frames() - 1)).unwrap();
        for (a, b) in at(&was, old).as_flattened().iter().zip(at(&is, new).as_flattened()) {
            assert!((a - b).abs() < 5e-3, "{}: {a} and {b}", old.name());
        }
    }
}

#[test]
fn of_several_roots_each_moves_by_itself() {
    // The first goes to nothing, and the second aside.
    let tiny = Tiny::new()
        .with("/nodes/1", json!({"name": "hips", "translation": [0, 1, 0]}))
        .with("/nodes/2", json!({"name": "tip", "translation": [0, 2, 0]}))
        .with_accessor(5126, "SCALAR", 2, &floats(&[0.0, 1.0]))
        .with_accessor(5126, "VEC3", 2, &floats(&[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        .with_accessor(5126, "VEC3", 2, &floats(&[0.0, 2.0, 0.0, 3.0, 2.0, 0.0]))
        .with(
            "/animations",
            json!([{"name": "burst", "samplers": [{"input": 5, "output": 6}, {"input": 5, "output": 7}],
                    "channels": [{"sampler": 0, "target": {"node": 1, "path": "scale"}},
                                 {"sampler": 1, "target": {"node": 2, "path": "translation"}}]}]),
        );
    let is = read("a.glb", &back_bytes(&tiny));
    let was = read("a.glb", &tiny.glb());
    let roots = |of: &Imported| {
        let told = of.warnings().iter().find(|told| matches!(told, Warning::SeveralRoots { .. }));
        (of.rig().unwrap().skeleton().parents().to_vec(), told.map(ToString::to_string))
    };
    assert_eq!((roots(&was), roots(&was).0.len()), (roots(&is), 2));
    assert!(roots(&is).1.is_some(), "{:?}", is.warnings());
    let [clip] = &is.clips[..] else { panic!("{} clips", is.clips.len()) };
    let ends = skin(is.rig().unwrap(), &clip.frame(clip.frames() - 1)).unwrap();
    let far = |at: [f32; 3]| (0..3).map(|k| (at[k] - [3.0, 2.5, 0.0][k]).abs()).fold(0.0, f32::max);
    assert!(ends.iter().any(|at| far(*at) < 1e-4), "{ends:?}");
}

/// With normals, two sets of coordinates, colours and a material that shows a picture.
fn dressed() -> Tiny {
    let picture = b"\x89PNG\r\n\x1a\nnothing";
    let tiny = Tiny::new()
        .with_accessor(5126, "VEC3", 4, &floats(&[[0.0, 0.0, 2.0]; 4].concat()))
        .with_accessor(5126, "VEC2", 4, &floats(&[0.0, 0.25, 1.0, 0.25, 0.0, 1.0, 0.5, 0.5]))
        .with_accessor(5126, "VEC2", 4, &floats(&[[0.5, 0.5]; 4].concat()))
        .with_accessor(5121, "VEC3", 4, &[55; 12])
        .with_accessor(5121, "SCALAR", picture.len(), picture)
        .with("/accessors/8/normalized", json!(true));
    let view = tiny.document["bufferViews"].as_array().unwrap().len() - 1;
    let transform = json!({"KHR_texture_transform": {"offset": [0.25, 0.5], "scale": [0.5, 0.25], "texCoord": 1}});
    let pbr = json!({"baseColorFactor": [1, 1, 1, 0.5], "metallicFactor": 0.25, "roughnessFactor": 0.5,
                     "baseColorTexture": {"index": 0, "extensions": transform}, "metallicRoughnessTexture": {"index": 0}});
    let primitive = "/meshes/0/primitives/0";
    tiny.with(&format!("{primitive}/attributes/NORMAL"), json!(5))
        .with(&format!("{primitive}/attributes/TEXCOORD_0"), json!(6))
        .with(&format!("{primitive}/attributes/TEXCOORD_1"), json!(7))
        .with(&format!("{primitive}/attributes/COLOR_0"), json!(8))
        .with(&format!("{primitive}/material"), json!(0))
        .with(
            "/materials",
            json!([{"name": "cloth", "pbrMetallicRoughness": pbr, "alphaMode": "BLEND",
                                    "emissiveFactor": [0.5, 0, 0], "normalTexture": {"index": 0, "scale": 0.5}}]),
        )
        .with("/textures", json!([{"source": 0, "sampler": 0}]))
        .with("/samplers", json!([{"wrapS": 33071}]))
        .with("/images", json!([{"name": "cloth.png", "mimeType": "image/png", "bufferView": view}]))
}

fn number(scene: &Scene, property: &str) -> f64 {
    scene.materials[0].element.props.find_prop(property).unwrap().value_vec4.x
}

#[test]
fn corners_keep_what_they_have() {
    let scene = scene(&written(&dressed()).bytes);
    let mesh = &scene.meshes[0];
    let normals: Vec<f64> = (&mesh.vertex_normal.values).into_iter().map(|n| n.z).collect();
    assert!(normals.len() == 12 && normals.iter().all(|z| *z == 1.0), "{normals:?}");
    let sets: Vec<&str> = (&mesh.uv_sets).into_iter().map(|set| &set.name[..]).collect();
    assert_eq!(sets, ["UVMap", "UVMap2"]);
    // Corners 0, 2 and 1 of the first triangle; v from below.
    let uv = |corner: usize| {
        let uv = mesh.vertex_uv.values[mesh.vertex_uv.indices[corner] as usize];
        [uv.x, uv.y]
    };
    assert_eq!([uv(0), uv(1), uv(2)], [[0.0, 0.75], [0.0, 0.0], [1.0, 0.75]]);
    let colour = mesh.vertex_color.values[0];
    let light = ((colour.x + 0.055) / 1.055).powf(2.4);
    assert!((light - 55.0 / 255.0).abs() < 1e-6 && colour.w == 1.0, "{}", colour.x);
}

#[test]
fn skinned_meshes_under_nodes_that_mirror_face_outwards() {
    let mirror = |children: Value| json!({"name": "all", "scale": [-1, 1, 1], "children": children});
    let alone = dressed().with("/nodes/0/scale", json!([-1, 1, 1]));
    let with_joints = dressed().with("/nodes/-", mirror(json!([0, 1])));
    let joints = dressed().with("/nodes/-", mirror(json!([1])));
    for (tiny, what) in [(&alone, "alone"), (&with_joints, "with its joints"), (&joints, "its joints alone")] {
        let (was, is) = (read("a.glb", &tiny.glb()), read("a.fbx", &written(tiny).bytes));
        assert_eq!(was.mesh().triangles(), is.mesh().triangles(), "{what}");
        assert_eq!(was.mesh().positions(), is.mesh().positions(), "{what}");
    }
    // Of corners 0, 1 and 2 of the first triangle, which were 0, 2 and 1.
    let scene = scene(&written(&alone).bytes);
    let uv = |corner: usize| {
        let of = &scene.meshes[0].vertex_uv;
        let uv = of.values[of.indices[corner] as usize];
        [uv.x, uv.y]
    };
    assert_eq!([uv(0), uv(1), uv(2)], [[0.0, 0.75], [1.0, 0.75], [0.0, 0.0]]);
}

#[test]
fn materials_and_pictures_come_along() {
    let file = written(&dressed());
    let scene = scene(&file.bytes);
    assert_eq!(&scene.materials[0].element.name[..], "cloth");
    let wanted = [("Opacity", 0.5), ("TransparencyFactor", 0.5), ("ReflectionFactor", 0.25), ("Shininess", 25.0)];
    for (property, value) in wanted.into_iter().chain([("BumpFactor", 0.5), ("EmissiveColor", 0.5)]) {
        assert_eq!(number(&scene, property), value, "{property}");
    }
    let texture = scene.materials[0].fbx.diffuse_color.texture.as_deref().unwrap();
    assert_eq!((&texture.uv_set[..], &texture.relative_filename[..]), ("UVMap2", "cloth.png"));
    assert_eq!(texture.content.as_ref(), b"\x89PNG\r\n\x1a\nnothing");
    // The upper left corner of the coordinates, and of the part of the picture that is looked up.
    let m = &texture.uv_to_texture;
    assert_eq!([m.m00, m.m11, m.m03, m.m03 + 0.0 * m.m13], [0.5, 0.25, 0.25, 0.25]);
    assert_eq!(1.0 - (m.m11 * 1.0 + m.m13), 0.5);
    assert_eq!(scene.textures.len(), 2);
    assert!(scene.materials[0].fbx.normal_map.texture.is_some());
    assert_eq!(file.left.parts(), ["1 metallic-roughness map"]);
}

/// The GLB once it went to FBX and back.
fn back_bytes(tiny: &Tiny) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("back.fbx");
    std::fs::write(&path, written(tiny).bytes).unwrap();
    let how = ExportOptions::default();
    rigging::dressed(&path, &ImportOptions::default(), &Springs::default(), &how).unwrap().0.bytes
}

/// Its document, and what was told on the way to FBX.
fn back(tiny: &Tiny) -> (Value, Vec<String>) {
    let bytes = back_bytes(tiny);
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..20 + length]).unwrap(), written(tiny).left.parts())
}

#[test]
fn a_picture_of_a_glow_shows_as_much_as_the_material_glows() {
    let glowing = |factor: Value| {
        dressed().with("/materials/0/emissiveTexture", json!({"index": 0})).with("/materials/0/emissiveFactor", factor)
    };
    let glow = |factor: Value| {
        let (json, left) = back(&glowing(factor));
        let material = &json["materials"][0];
        (material["emissiveTexture"].clone(), material["emissiveFactor"].clone(), left.len())
    };
    let picture = json!({"index": 0});
    // The default of the format is none.
    assert_eq!(glow(Value::Null), (Value::Null, Value::Null, 1));
    assert_eq!(glow(json!([0, 0, 0])), (Value::Null, Value::Null, 1));
    assert_eq!(glow(json!([0.25, 0.25, 0.25])), (picture.clone(), json!([0.25, 0.25, 0.25]), 1));
    // A colour in front of the picture is told.
    assert_eq!(glow(json!([0.5, 0.25, 0])), (picture, json!([0.5, 0.5, 0.5]), 2));
}

#[test]
fn materials_come_back_from_fbx_as_they_were() {
    let strength = "KHR_materials_emissive_strength";
    let pbr = json!({"baseColorFactor": [0.5, 0.25, 0.75, 1], "metallicFactor": 1, "roughnessFactor": 0.5});
    let wanted = json!({"name": "cloth", "pbrMetallicRoughness": pbr, "doubleSided": true,
                        "normalTexture": {"index": 0, "scale": 0.25},
                        "emissiveFactor": [1, 0.5, 0], "extensions": {strength: {"emissiveStrength": 4}}});
    let tiny = dressed().with("/materials/0", wanted.clone());
    let (json, left) = back(&tiny.with("/extensionsUsed", json!([strength])));
    let number = |json: &Value, pointer: &str| json.pointer(pointer).and_then(Value::as_f64).unwrap();
    let material = &json["materials"][0];
    for pointer in [
        "/pbrMetallicRoughness/metallicFactor",
        "/pbrMetallicRoughness/baseColorFactor/0",
        "/normalTexture/scale",
        "/emissiveFactor/1",
        "/extensions/KHR_materials_emissive_strength/emissiveStrength",
    ] {
        let (is, was) = (number(material, pointer), number(&wanted, pointer));
        assert!((is - was).abs() < 1e-6, "{pointer}: {is}, not {was}");
    }
    assert_eq!((&material["doubleSided"], &material["alphaMode"]), (&json!(true), &Value::Null));
    assert_eq!((&json["extensionsUsed"], left.len()), (&json!([strength]), 0), "{left:?}");

    // Of what the format has no words for, nothing is said.
    let (json, _) = back(&dressed().with("/materials/0", json!({"normalTexture": {"index": 0, "scale": 0}})));
    let material = &json["materials"][0];
    assert_eq!([&material["doubleSided"], &material["normalTexture"], &material["extensions"]], [&Value::Null; 3]);
    assert_eq!(json["extensionsUsed"], Value::Null);
}

#[test]
fn metal_that_a_map_alone_says_is_none_without_it() {
    let metal = |pbr: Value| {
        let file = written(&dressed().with("/materials/0", json!({"pbrMetallicRoughness": pbr})));
        number(&scene(&file.bytes), "ReflectionFactor")
    };
    let map = json!({"index": 0});
    assert_eq!(metal(json!({"metallicRoughnessTexture": map})), 0.0);
    assert_eq!(metal(json!({"metallicRoughnessTexture": map, "metallicFactor": 0.75})), 0.75);
    assert_eq!(metal(json!({})), 1.0);
}

#[test]
fn pictures_keep_their_coordinates_and_borders_through_fbx() {
    let (json, _) = back(&dressed());
    let material = &json["materials"][0];
    let sampler = |info: &Value| {
        let texture = &json["textures"][info["index"].as_u64().unwrap() as usize];
        let own = &json["samplers"][texture["sampler"].as_u64().unwrap() as usize];
        (info["texCoord"].clone(), own["wrapS"].clone(), own["wrapT"].clone())
    };
    let colour = &material["pbrMetallicRoughness"]["baseColorTexture"];
    assert_eq!(sampler(colour), (json!(1), json!(33071), json!(10497)));
    assert_eq!(sampler(&material["normalTexture"]), (Value::Null, json!(33071), json!(10497)));
}

#[test]
fn normals_of_shapes_come_back_from_fbx() {
    let of_third = |by: [f32; 3]| floats(&[[0.0; 3], [0.0; 3], by, [0.0; 3]].concat());
    let tiny = dressed().with_accessor(5126, "VEC3", 4, &of_third([0.0, 0.5, 0.0])).with_accessor(
        5126,
        "VEC3",
        4,
        &of_third([0.25, 0.0, -0.5]),
    );
    let count = tiny.accessors();
    let shapes = |targets: Value| {
        let tiny = tiny.clone().with("/meshes/0/primitives/0/targets", targets);
        let json = back(&tiny).0;
        let targets = json["meshes"][0]["primitives"][0]["targets"].as_array().unwrap().clone();
        let normals = targets.iter().map(|target| {
            let own = &json["accessors"][target["NORMAL"].as_u64()? as usize];
            Some((own["sparse"]["count"].as_u64(), own["min"].clone(), own["max"].clone()))
        });
        normals.collect::<Vec<_>>()
    };
    let bent = Some((Some(1), json!([0.0, 0.0, -0.5]), json!([0.25, 0.0, 0.0])));
    assert_eq!(shapes(json!([{"POSITION": count - 2, "NORMAL": count - 1}])), [bent]);
    assert_eq!(shapes(json!([{"POSITION": count - 2}])), [None]);
}

#[test]
fn splines_too_long_to_be_sampled_are_told() {
    let told = |end: f32| {
        let values = [[0.0f32; 3], [0.0, 1.0, 0.0], [0.0; 3], [0.0; 3], [0.0, 2.0, 0.0], [0.0; 3]].concat();
        let tiny = Tiny::new()
            .with_accessor(5126, "SCALAR", 2, &floats(&[0.0, end]))
            .with_accessor(5126, "VEC3", 6, &floats(&values))
            .with(
                "/animations",
                json!([{"samplers": [{"input": 5, "output": 6, "interpolation": "CUBICSPLINE"}],
                        "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}},
                                     {"sampler": 0, "target": {"node": 2, "path": "scale"}}]}]),
            );
        written(&tiny).left.parts()
    };
    assert_eq!(told(10.0), [] as [&str; 0]);
    assert_eq!(told(1e6), ["2 splines of a motion too long to be sampled"]);
}

#[test]
fn what_is_given_in_the_spaces_of_its_joints_stands_where_they_hold_it() {
    let tiny = dressed().with("/nodes/2/rotation", json!([0.6, 0.0, 0.0, 0.8]));
    let tiny = tiny.with("/skins/0/inverseBindMatrices", Value::Null);
    let (was, is) = (read("a.glb", &tiny.glb()), read("a.fbx", &written(&tiny).bytes));
    let near = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.len() == b.len() && a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-5)
    };
    assert!(near(was.mesh().positions(), is.mesh().positions()), "{:?}", is.mesh().positions());
    let [old, new] = [&was, &is].map(|of| of.rig().unwrap().skeleton());
    assert!(near(old.heads(), new.heads()), "{:?}", new.heads());
    assert_eq!((was.mesh().triangles(), is.warnings()), (is.mesh().triangles(), was.warnings()));
    // Those along z of the third vertex, which the tip alone holds, turn with it.
    let scene = scene(&written(&tiny).bytes);
    let mesh = &scene.meshes[0];
    let corners = (0..12).filter(|&corner| mesh.vertex_indices[corner] == 2);
    let normals = corners.map(|corner| mesh.vertex_normal.values[mesh.vertex_normal.indices[corner] as usize]);
    let normals: Vec<f32> = normals.flat_map(|n| [n.x as f32, n.y as f32, n.z as f32]).collect();
    assert!(near(normals.as_chunks::<3>().0, &[[0.0, -0.96, 0.28]; 3]), "{normals:?}");
}

#[test]
fn a_cutoff_of_alpha_is_told() {
    let told = |tiny: Tiny| written(&tiny.with("/materials/0/alphaMode", json!("MASK"))).left.parts();
    assert_eq!(told(dressed()), ["1 material with an alpha cutoff", "1 metallic-roughness map"]);
    // What is seen in any case is not cut.
    assert_eq!(told(dressed().with("/materials/0", json!({"name": "bare"}))), [] as [&str; 0]);
}

#[test]
fn shapes_keep_their_weights_and_motions() {
    let offsets = [[0.0; 3], [0.0; 3], [0.0, 0.5, 0.0], [0.0; 3]].concat();
    let tiny = Tiny::new()
        .with_accessor(5126, "VEC3", 4, &floats(&offsets))
        .with_accessor(5126, "SCALAR", 2, &floats(&[1.0, 2.0]))
        .with_accessor(5126, "SCALAR", 2, &floats(&[0.0, 1.0]))
        .with("/meshes/0/primitives/0/targets", json!([{"POSITION": 5}]))
        .with("/meshes/0/extras", json!({"targetNames": ["smile"]}))
        .with("/nodes/0/weights", json!([0.25]))
        .with(
            "/animations",
            json!([{"samplers": [{"input": 6, "output": 7, "interpolation": "STEP"}],
                    "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]}]),
        );
    let scene = scene(&written(&tiny).bytes);
    let channel = &scene.blend_channels[0];
    assert_eq!((&channel.element.name[..], channel.weight), ("smile", 0.25));
    let shape = &scene.blend_shapes[0];
    assert_eq!((shape.num_offsets, shape.offset_vertices[0], shape.position_offsets[0].y), (1, 2, 0.5));
    let keys = &scene.anim_curves[0].keyframes;
    assert_eq!([keys[0].time, keys[0].value, keys[1].time, keys[1].value], [1.0, 0.0, 2.0, 100.0]);
}

#[test]
fn primitives_over_the_same_vertices_keep_their_own_shapes() {
    let up = |vertex: usize| {
        let mut offsets = [[0.0f32; 3]; 4];
        offsets[vertex][1] = 0.5;
        floats(offsets.as_flattened())
    };
    let tiny = Tiny::new().with_accessor(5126, "VEC3", 4, &up(1)).with_accessor(5126, "VEC3", 4, &up(2));
    let primitive = tiny.document["meshes"][0]["primitives"][0].clone();
    let of = |target: Option<usize>| {
        let mut own = primitive.clone();
        own["targets"] = target.map_or(json!([]), |accessor| json!([{"POSITION": accessor}]));
        own
    };
    let vertices = |own: &[Value]| {
        let tiny = tiny.clone().with("/meshes/0/primitives", json!(own)).with("/nodes/0/weights", json!([1.0]));
        let options = ImportOptions { shaped: true, ..Default::default() };
        let shown = import_bytes("a.glb", &tiny.glb(), &options).unwrap();
        let mut raised: Vec<f32> = shown.mesh().positions().iter().map(|p| p[1]).collect();
        raised.retain(|y| *y == 0.5 || *y == 3.0);
        let scene = scene(&written(&tiny).bytes);
        let offsets: usize = (&scene.blend_shapes).into_iter().map(|shape| shape.num_offsets).sum();
        (shown.mesh().positions().len(), raised, offsets)
    };
    assert_eq!(vertices(&[of(Some(5)), of(Some(5))]), (4, vec![0.5], 1));
    assert_eq!(vertices(&[of(None), of(Some(6))]), (8, vec![3.0], 1));
    assert_eq!(vertices(&[of(Some(5)), of(Some(6))]), (8, vec![0.5, 3.0], 2));
}

#[test]
fn pictures_are_called_by_names_of_their_own() {
    let image = dressed().document["images"][0].clone();
    let named = |name: &str| {
        let mut own = image.clone();
        own["name"] = json!(name);
        own
    };
    let images = [named("skin"), named("skin 2"), named("SKIN"), named("b"), json!({"uri": "B.png"})];
    let textures: Vec<Value> = (0..images.len()).map(|n| json!({"source": n})).collect();
    let shows = |n: usize| json!({"name": format!("m{n}"), "pbrMetallicRoughness": {"baseColorTexture": {"index": n}}});
    let materials: Vec<Value> = (0..images.len()).map(shows).collect();
    let tiny = dressed().with("/images", json!(images)).with("/textures", json!(textures));
    let primitive = tiny.document["meshes"][0]["primitives"][0].clone();
    let primitives: Vec<Value> = (0..images.len())
        .map(|n| {
            let mut own = primitive.clone();
            own["material"] = json!(n);
            own
        })
        .collect();
    let tiny = tiny.with("/materials", json!(materials)).with("/meshes/0/primitives", json!(primitives));
    let scene = scene(&written(&tiny).bytes);
    let mut names: Vec<String> = (&scene.textures).into_iter().map(|t| t.relative_filename.to_string()).collect();
    names.sort();
    assert_eq!(names, ["B.png", "SKIN 3.png", "b 3.png", "skin 2.png", "skin.png"]);
}

#[test]
fn nodes_stand_where_they_stood() {
    // A mesh on a joint, one below a turned and scaled node, and a camera's node.
    let tiny = Tiny::new()
        .with("/nodes/2/mesh", json!(1))
        .with(
            "/nodes/-",
            json!({"translation": [1, 2, 3], "rotation": [0.6, 0.0, 0.0, 0.8], "scale": [1, 2, 3], "children": [4]}),
        )
        .with("/nodes/-", json!({"name": "prop", "mesh": 1, "translation": [0, 0, 1]}))
        .with("/nodes/-", json!({"name": "eye", "camera": 0}))
        .with("/cameras", json!([{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": 0}, "indices": 3}]}));
    let file = written(&tiny);
    let scene = scene(&file.bytes);
    assert_eq!(file.left.parts(), ["1 camera"]);
    let find = |name: &str| (&scene.nodes).into_iter().find(|node| &node.element.name[..] == name).unwrap();
    assert!(find("hips").bone.is_some() && find("node 3").bone.is_none());
    let m = &find("prop").node_to_world;
    let place = glam::DQuat::from_xyzw(0.6, 0.0, 0.0, 0.8) * glam::DVec3::new(0.0, 0.0, 3.0);
    for (is, wanted) in [m.m03, m.m13, m.m23].into_iter().zip((place + glam::DVec3::new(1.0, 2.0, 3.0)).to_array()) {
        assert!((is - wanted).abs() < 1e-9, "{is} for {wanted}");
    }
    let held = find("mesh 1");
    assert_eq!(&held.parent.as_ref().unwrap().element.name[..], "tip");
}

/// As the commands write it.
fn exported(path: &std::path::Path, imported: &Imported) -> Option<Vec<u8>> {
    let options = ExportOptions { influences: Influences::All, ..ExportOptions::default() };
    let exported = match imported.rig() {
        Some(rig) => export::onto(path, imported, rig, &options),
        None => export::strip(path, &ImportOptions::default()),
    };
    exported.ok().map(|of| of.bytes)
}

#[test]
fn the_corpus_keeps_its_rigs() {
    let folders =
        [("RIGLAB_RIGS", "rigs"), ("RIGLAB_RIGS_ORIGINAL", "rigs_original"), ("RIGLAB_RIGS_HARD", "rigs_hard")];
    let mut compared = 0;
    for folder in folders.iter().filter_map(|(variable, default)| common::data(variable, default)) {
        for path in common::files(&folder, &["glb", "gltf", "vrm"]) {
            let name = path.display().to_string();
            let Ok(imported) = import(&path, &ImportOptions::default()) else { continue };
            let Some(glb) = exported(&path, &imported) else { continue };
            let file = glb_to_fbx(&glb).unwrap_or_else(|e| panic!("{name}: {e}"));
            drop(scene(&file.bytes));
            let back = import_bytes("back.fbx", &file.bytes, &ImportOptions::default());
            let (Some(rig), Ok(back)) = (imported.rig(), back) else { continue };
            let is = back.rig().unwrap_or_else(|| panic!("{name} has no rig"));
            let joints = |rig: &riglab_core::Rig| (rig.skeleton().names().to_vec(), rig.skeleton().parents().to_vec());
            assert_eq!(joints(rig), joints(is), "{name}");
            let far = 1e-4 * rig.bounds().diagonal();
            for (a, b) in rig.skeleton().heads().as_flattened().iter().zip(is.skeleton().heads().as_flattened()) {
                assert!((a - b).abs() <= far, "{name}: a head is {} away", (a - b).abs());
            }
            compared += 1;
        }
    }
    println!("{compared} rigs are the same after FBX");
}

#[test]
fn what_is_hidden_stays_hidden() {
    let hidden = json!({"KHR_node_visibility": {"visible": false}});
    let tiny = Tiny::new();
    let other = json!({"name": "other", "mesh": 0, "extensions": hidden});
    let mut nodes = tiny.document["nodes"].as_array().unwrap().clone();
    let mesh = nodes.iter().position(|node| node.get("mesh").is_some()).unwrap();
    nodes.push(other);
    let tiny = tiny.with("/nodes", json!(nodes));
    let mut scene_nodes = tiny.document["scenes"][0]["nodes"].as_array().cloned().unwrap_or_default();
    scene_nodes.push(json!(nodes.len() - 1));
    let tiny = tiny.with("/scenes", json!([{"nodes": scene_nodes}]));
    let scene = scene(&written(&tiny).bytes);
    let shown = |name: &str| (&scene.nodes).into_iter().find(|node| &*node.element.name == name).unwrap().visible;
    assert!(!shown("other") && shown(nodes[mesh]["name"].as_str().unwrap_or(&format!("node {mesh}"))));
}

#[test]
fn coordinates_of_signed_shorts_are_read_and_what_cannot_be_is_told() {
    let corners: Vec<u8> = [0i16, 0, 32767, 0, 0, -32767, 1, 1].iter().flat_map(|x| x.to_le_bytes()).collect();
    let tiny = Tiny::new().with_accessor(5122, "VEC2", 4, &corners);
    let attributes = |tiny: &Tiny, name: &str, accessor: usize| {
        let mut own = tiny.document["meshes"][0]["primitives"][0]["attributes"].clone();
        own[name] = json!(accessor);
        own
    };
    let own = attributes(&tiny, "TEXCOORD_0", 5);
    let tiny = tiny.with("/accessors/5/normalized", json!(true)).with("/meshes/0/primitives/0/attributes", own);
    let file = written(&tiny);
    let scene = scene(&file.bytes);
    let values: Vec<f64> = scene.meshes[0].vertex_uv.values.iter().map(|uv| uv.x).collect();
    assert!(values.iter().any(|x| (x - 1.0).abs() < 1e-6), "{values:?}");
    // A colour of a type that the format does not have.
    let colours = attributes(&tiny, "COLOR_0", 5);
    let told = written(&tiny.with("/meshes/0/primitives/0/attributes", colours)).left.parts();
    assert_eq!(told, ["1 list of normals, coordinates, colours or offsets that cannot be read"]);
}
