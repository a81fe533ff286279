//! What the tiny rig comes to when it is told in other ways.

mod common;

use common::{INDICES, JOINTS, POSITION, Tiny, WEIGHTS};
use riglab_asset::export::{ExportNote, ExportOptions};
use riglab_asset::{Binding, ImportOptions, Imported, NodeName, RootPolicy, Warning, export, import, import_bytes};
use riglab_core::JointId;
use serde_json::json;

fn read(tiny: &Tiny) -> Imported {
    import_bytes("folder/tiny.glb", &tiny.glb(), &ImportOptions::default()).unwrap()
}

#[test]
fn provenance_names_file_checksum_and_rights() {
    let extras = json!({"license": "CC-BY-4.0 (http://creativecommons.org/licenses/by/4.0/)", "source": "https://x.y"});
    let tiny = Tiny::new().with("/asset/extras", extras).with("/asset/copyright", json!("Jane"));
    let asset = read(&tiny).into_asset().unwrap();
    assert_eq!(asset.name, "tiny");
    let p = asset.provenance;
    assert_eq!((p.source.as_str(), p.licence.as_str(), p.author.as_str()), ("folder/tiny.glb", "CC-BY-4.0", "Jane"));
    assert_eq!(p.checksum, blake3::hash(&tiny.glb()).to_hex().to_string());
    assert_eq!(p.notes, ["published at https://x.y"]);
}

#[test]
fn vrm_meta_comes_before_other_rights() {
    let meta = json!({"meta": {"authors": ["A", "B"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}});
    let tiny = Tiny::new().with("/asset/copyright", json!("Jane")).with("/extensions", json!({"VRMC_vrm": meta}));
    let provenance = read(&tiny).provenance;
    assert_eq!((provenance.author.as_str(), provenance.licence.as_str()), ("A, B", "https://vrm.dev/licenses/1.0/"));
}

#[test]
fn all_sets_of_influences_count() {
    let joints: Vec<u8> = [[1, 0, 0, 0]; 4].concat();
    let weights: Vec<u8> = [[1.0f32, 0.0, 0.0, 0.0]; 4].concat().iter().flat_map(|w| w.to_le_bytes()).collect();
    let tiny = Tiny::new().with_accessor(5121, "VEC4", 4, &joints).with_accessor(5126, "VEC4", 4, &weights);
    let tiny = tiny.with("/meshes/0/primitives/0/attributes/JOINTS_1", json!(5));
    let imported = read(&tiny.with("/meshes/0/primitives/0/attributes/WEIGHTS_1", json!(6)));
    let row = |v| imported.rig().unwrap().weights().row(v).collect::<Vec<_>>();
    assert_eq!(row(0), [(JointId(0), 0.5), (JointId(1), 0.5)]);
    assert_eq!(row(1), [(JointId(0), 0.25), (JointId(1), 0.75)]);
    assert!(imported.warnings().contains(&Warning::NotNormalised { vertices: 4, sums: (2.0, 2.0) }));
    assert!(imported.warnings().contains(&Warning::DuplicateInfluences { vertices: 3 }));
}

#[test]
fn primitives_that_share_accessors_share_vertices() {
    let attributes = json!({"POSITION": POSITION, "JOINTS_0": JOINTS, "WEIGHTS_0": WEIGHTS});
    let outline = json!({"attributes": attributes, "indices": 3});
    let imported = read(&Tiny::new().with("/meshes/0/primitives/-", outline));
    let mesh = imported.mesh();
    assert_eq!((mesh.positions().len(), mesh.triangles().len()), (4, 4));
    assert_eq!(imported.warnings(), [Warning::Degenerate { collapsed: 0, repeated: 4 }]);
    let shown = imported.inspect(true);
    assert_eq!((shown.vertices, shown.samples.len(), shown.triangles), (8, 8, 8));
    assert_eq!((shown.file_vertices, shown.file_triangles), (4, 8));
}

#[test]
fn loose_roots_can_go_below_a_virtual_one() {
    let mut tiny =
        Tiny::new().with("/nodes/2/translation", json!([0, 2, 0])).with("/nodes/-", json!({"children": [1, 2]}));
    tiny.document["nodes"][1].as_object_mut().unwrap().remove("children");
    let tiny = tiny.with("/nodes/3/translation", json!([0, 0, 0]));
    let options = ImportOptions { roots: RootPolicy::Virtual, ..Default::default() };
    let imported = import_bytes("a.glb", &tiny.glb(), &options).unwrap();
    assert_eq!(imported.reading.roots(), [0, 1]);
    let skeleton = imported.rig().unwrap().skeleton();
    assert_eq!(skeleton.names(), ["root", "hips", "tip"]);
    assert_eq!(skeleton.heads(), [[0.0; 3], [0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]);
    assert!(matches!(&imported.warnings()[0], Warning::SeveralRoots { roots, .. } if roots == &["hips", "tip"]));
    assert_eq!(read(&tiny).rig().unwrap().skeleton().names(), ["hips", "tip"]);
}

#[test]
fn bind_poses_that_contradict_each_other_leave_the_mesh_as_stored() {
    // Below a common node the pose of both roots is the nodes' own: for the tip not where it was bound.
    let mut tiny =
        Tiny::new().with("/nodes/2/translation", json!([0, 5, 0])).with("/nodes/-", json!({"children": [1, 2]}));
    tiny.document["nodes"][1].as_object_mut().unwrap().remove("children");
    let imported = read(&tiny);
    let rig = imported.rig().unwrap();
    assert_eq!(rig.skeleton().heads(), [[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]);
    assert_eq!(rig.mesh().positions()[2], [0.0, 2.5, 0.0]);
    let [bent, posed, roots] = imported.warnings() else { panic!("{:?}", imported.warnings()) };
    assert_eq!(bent, &Warning::Bent { skins: vec![0] });
    assert!(matches!(posed, Warning::RestIsNotBind { skins, .. } if skins == &[0]), "{posed:?}");
    assert!(matches!(roots, Warning::SeveralRoots { .. }));
}

#[test]
fn inverse_binds_of_joints_that_hold_nothing_tell_no_pose() {
    // A leaf bone whose inverse bind matrix leaves its turn out, as Blender writes them.
    let matrix = |y: f32| {
        let [x, y, z, w] = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, y, 0.0, 1.0f32]];
        [x, y, z, w].as_flattened().to_vec()
    };
    let binds: Vec<u8> = [-1.0, -2.0, -3.0].into_iter().flat_map(matrix).flat_map(f32::to_le_bytes).collect();
    let tiny = Tiny::new().with_accessor(5126, "MAT4", 3, &binds);
    let own = tiny.accessors() - 1;
    let tiny = tiny
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"name": "tip_leaf", "translation": [0, 1, 0], "rotation": [1, 0, 0, 0]}))
        .with("/skins/0", json!({"joints": [1, 2, 3], "inverseBindMatrices": own}));
    let imported = read(&tiny);
    assert_eq!(imported.warnings(), []);
    assert_eq!(imported.rig().unwrap().skeleton().heads()[2], [0.0, 3.0, 0.0]);
    // What hangs on it is placed by it.
    let tiny = tiny
        .with("/nodes/3/children", json!([4]))
        .with("/nodes/-", json!({"mesh": 1, "name": "ring"}))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": 3}]}));
    let imported = read(&tiny);
    assert!(matches!(imported.warnings(), [Warning::RestIsNotBind { .. }, ..]), "{:?}", imported.warnings());
}

#[test]
fn a_model_that_is_shown_in_another_size_than_it_was_bound_says_so() {
    let imported = read(&Tiny::new().with("/nodes/1/scale", json!([100, 100, 100])));
    let [posed @ Warning::RestIsNotBind { size, .. }] = imported.warnings() else {
        panic!("{:?}", imported.warnings())
    };
    assert!(
        (size - 100.0).abs() < 1e-9
            && posed.to_string().ends_with("the model has 0.010 of the size that the file shows")
    );
    // What is written has that size, too, unless the file's own nodes stay.
    let bytes = Tiny::new().with("/nodes/1/scale", json!([100, 100, 100])).glb();
    let resized = |notes: &[ExportNote]| matches!(notes, [ExportNote::Resized { size }] if (size - 0.01).abs() < 1e-9);
    let stripped = export::strip_bytes("a.glb", &bytes, None, &ImportOptions::default()).unwrap();
    assert!(resized(&stripped.notes), "{:?}", stripped.notes);
    let own = imported.rig().unwrap();
    let options = ExportOptions::default();
    let kept = export::onto_bytes("a.glb", &bytes, None, &imported, own, &options).unwrap();
    assert!(kept.notes.is_empty(), "{:?}", kept.notes);
    let renamed = export::onto_bytes("a.glb", &bytes, None, &imported, &common::renamed(own), &options).unwrap();
    assert!(resized(&renamed.notes), "{:?}", renamed.notes);
}

/// The hips have a scale that their inverse bind matrices undo, and a mesh hangs on the tip.
fn scaled(scale: [f32; 3]) -> Tiny {
    let matrix = |y: f32| {
        let [a, b, c] = scale.map(|s| 1.0 / s);
        [[a, 0.0, 0.0, 0.0], [0.0, b, 0.0, 0.0], [0.0, 0.0, c, 0.0], [0.0, y, 0.0, 1.0f32]].concat()
    };
    // The hips at 1, and the tip as much above as the scale says.
    let binds = [matrix(-1.0 / scale[1]), matrix(-1.0 / scale[1] - 1.0)].concat();
    let tiny =
        Tiny::new().with_accessor(5126, "MAT4", 2, &binds.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>());
    tiny.with("/skins/0/inverseBindMatrices", json!(5))
        .with("/nodes/1/scale", json!(scale))
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"mesh": 1, "name": "hat"}))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]}))
}

/// Six times the volumes of its two bodies, which are above 0 where they face outwards.
fn volumes(imported: &Imported) -> [f32; 2] {
    let places = imported.mesh().positions();
    let volume = |first: u32| {
        let own = imported.mesh().triangles().iter().filter(|t| t[0] / 4 == first);
        own.map(|t| t.map(|v| glam::Vec3::from(places[v as usize]))).map(|[a, b, c]| a.dot(b.cross(c))).sum()
    };
    [volume(0), volume(1)]
}

#[test]
fn what_is_shown_as_it_was_bound_is_not_mirrored_by_scales_of_joints() {
    let stored = read(&Tiny::new());
    for scale in [[-1.0, 1.0, 1.0], [-1.0, 0.5, 3.0]] {
        let imported = read(&scaled(scale));
        assert_eq!(imported.mesh().positions()[..4], *stored.mesh().positions(), "{scale:?}");
        let heads = imported.rig().unwrap().skeleton().heads();
        assert_eq!(heads, [[0.0, 1.0, 0.0], [0.0, 1.0 + scale[1], 0.0]]);
        assert!(matches!(imported.warnings(), [Warning::RigidParts { .. }]), "{:?}", imported.warnings());
        // What hangs on the tip is as large as that makes it.
        let [body, hat] = volumes(&imported);
        let times: f32 = scale.iter().product::<f32>().abs();
        assert!((body - 2.5).abs() < 1e-5 && (hat - 2.5 * times).abs() < 1e-4, "{scale:?}: {body} {hat}");
    }
}

#[test]
fn where_rest_squashes_or_mirrors_a_mesh_it_says_so_and_faces_outwards() {
    // Shown as it was bound, it is in no other pose.
    let told: Vec<String> = read(&scaled([1.0, 2.0, 1.0])).warnings().iter().map(Warning::to_string).collect();
    assert!(told.len() == 2 && told[0].contains("is squashed by what the file shows (skin 0)"), "{told:?}");
    // The tip stands elsewhere than it was bound.
    for (scale, said) in [([1.0, 2.0, 1.0], "is squashed by"), ([-1.0, 1.0, 1.0], "is mirrored by")] {
        let imported = read(&scaled(scale).with("/nodes/2/rotation", json!([0.0, 0.0, 0.6, 0.8])));
        let told: Vec<String> = imported.warnings().iter().map(Warning::to_string).collect();
        assert!(told.iter().any(|told| told.contains(said)), "{told:?}");
        assert!(told.iter().all(|told| !told.contains("of the size")), "{told:?}");
        assert!(volumes(&imported).iter().all(|volume| *volume > 0.0), "{:?}", volumes(&imported));
    }
}

#[test]
fn rigid_parts_go_into_the_bind_pose_with_their_joint() {
    // The tip is bent and turned over in the nodes; a mesh hangs on it, one up.
    let tiny = Tiny::new()
        .with("/nodes/2", json!({"name": "tip", "translation": [5, 1, 0], "rotation": [1, 0, 0, 0], "children": [3]}))
        .with("/nodes/-", json!({"mesh": 1, "name": "hand", "translation": [0, 1, 0]}))
        .with("/nodes/-", json!({"mesh": 1}))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": 3}]}));
    let imported = read(&tiny);
    let rig = imported.rig().unwrap();
    assert_eq!(rig.mesh().positions()[4..6], [[0.0, 3.0, 0.0], [1.0, 3.0, 0.0]]);
    assert_eq!(rig.weights().row(4).collect::<Vec<_>>(), [(JointId(1), 1.0)]);
    assert_eq!(imported.reading.vertex_sets[1].binding, Binding::Rigid);
    let [posed, others @ ..] = imported.warnings() else { panic!("{:?}", imported.warnings()) };
    // The tip stands 5 to the side of a mesh whose box is 1 by 2.5 by 1.
    let Warning::RestIsNotBind { skins, size, off } = posed else { panic!("{posed:?}") };
    assert!(skins == &[0] && *size == 1.0 && (off - 5.0 / 8.25f64.sqrt()).abs() < 1e-6, "{posed:?}");
    assert_eq!(
        others,
        [
            Warning::RigidParts {
                nodes: vec![NodeName { number: 3, name: "hand".into() }],
                joints: vec!["tip".into()]
            },
            Warning::LeftOut { nodes: vec![NodeName { number: 4, name: String::new() }] },
        ]
    );
    let told: Vec<String> = imported.warnings().iter().map(Warning::to_string).collect();
    assert!(told[1].ends_with("node 3 `hand` on `tip`") && told[2].contains(": node 4;"), "{told:?}");
}

#[test]
fn nodes_of_lines_alone_are_named_unless_a_joint_moves_them() {
    let lines = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "mode": 1}]});
    let tiny = Tiny::new()
        .with("/meshes/-", lines)
        .with("/nodes/2/children", json!([4]))
        .with("/nodes/-", json!({"mesh": 1, "name": "grid"}))
        .with("/nodes/-", json!({"mesh": 1, "name": "string"}));
    let still = vec![NodeName { number: 3, name: "grid".into() }];
    assert_eq!(read(&tiny).warnings(), [Warning::NoSurface { primitives: 2, still }]);
    let told = read(&tiny).warnings()[0].to_string();
    assert!(told.starts_with("2 primitives of") && told.ends_with("which stays where it is: node 3 `grid`"), "{told}");
}

#[test]
fn meshes_that_their_nodes_mirror_face_outwards() {
    let bare = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]});
    let signed_volume = |tiny: Tiny, first: usize| {
        let imported = read(&tiny);
        let mesh = imported.mesh();
        let corners = |t: &[u32; 3]| t.map(|v| glam::Vec3::from(mesh.positions()[v as usize]));
        mesh.triangles()[first..].iter().map(corners).map(|[a, b, c]| a.dot(b.cross(c))).sum::<f32>()
    };
    for scale in [[1, 1, 1], [-1, 1, 1], [1, -2, 1], [-1, -1, 1], [-1, -1, -1]] {
        let hung = Tiny::new()
            .with("/nodes/2/children", json!([3]))
            .with("/nodes/-", json!({"mesh": 1, "scale": scale}))
            .with("/meshes/-", bare.clone());
        assert!(signed_volume(hung, 4) > 0.0, "on a joint, {scale:?}");
        let free = Tiny::new().with("/skins", json!([])).with("/nodes/0", json!({"mesh": 0, "scale": scale}));
        assert!(signed_volume(free, 0) > 0.0, "alone, {scale:?}");
    }
}

#[test]
fn buffers_beside_the_file_are_found_and_links_out_of_the_folder_refused() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("own");
    std::fs::create_dir_all(own.join("sub folder")).unwrap();
    let tiny = Tiny::new();
    let write = |uri: &str| {
        let text = json!({"byteLength": tiny.binary.len(), "uri": uri});
        let document = Tiny::new().with("/buffers/0", text).document;
        std::fs::write(own.join("a.gltf"), document.to_string()).unwrap();
        import(own.join("a.gltf"), &ImportOptions::default())
    };
    std::fs::write(own.join("sub folder/a.bin"), &tiny.binary).unwrap();
    std::fs::write(folder.path().join("outside.bin"), &tiny.binary).unwrap();
    assert_eq!(write("sub%20folder/a.bin").unwrap().rig(), read(&tiny).rig());
    for uri in ["../outside.bin", "no.bin", "sub%20folder", ""] {
        assert!(write(uri).is_err(), "{uri}");
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.path().join("outside.bin"), own.join("link.bin")).unwrap();
        let error = write("link.bin").unwrap_err().to_string();
        assert!(error.contains("outside the folder"), "{error}");
    }
}

#[test]
fn json_of_inspect_has_what_scripts_read() {
    let imported = read(&Tiny::new());
    let json = serde_json::to_value(imported.inspect(false)).unwrap();
    assert_eq!(json["file"], "folder/tiny.glb");
    assert_eq!(json["joints"][1], json!({"name": "tip", "node": 2, "parent": 0, "head": [0.0, 2.0, 0.0]}));
    assert_eq!(json["joints"][0]["parent"], json!(null));
    assert_eq!((&json["vertices"], &json["triangles"]), (&json!(4), &json!(4)));
    assert_eq!(json["weight_totals"], json!({"hips": 1.75, "tip": 2.25}));
    let sample = json!({"node": 0, "primitive": 0, "vertex": 1, "position": [1.0, 0.0, 0.0], "weights": {"hips": 0.5, "tip": 0.5}});
    assert_eq!(json["samples"][1], sample);
    assert_eq!(json["warnings"], json!([]));
}

/// With the tiny mesh once more, bound to the joints `on`, each as high as its number, and all of it on the first. It is in a
/// space of its own: positions are `(p - offset) / scale`, and the inverse bind matrices take that back first, as quantised
/// meshes have it.
fn quantised(tiny: Tiny, on: &[usize], scale: f32, offset: f32) -> Tiny {
    let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let stored = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.5, 0.0], [0.0, 0.0, 1.0f32]];
    let stored = stored.map(|p| p.map(|x| (x - offset) / scale));
    let matrix = |joint: &usize| {
        let mut matrix = [0.0f32; 16];
        (matrix[0], matrix[5], matrix[10], matrix[15]) = (scale, scale, scale, 1.0);
        (matrix[12], matrix[13], matrix[14]) = (offset, offset - *joint as f32, offset);
        matrix
    };
    let number = tiny.accessors();
    let tiny = tiny
        .with_accessor(5126, "VEC3", 4, &floats(stored.as_flattened()))
        .with_accessor(5121, "VEC4", 4, &[0; 16])
        .with_accessor(5126, "VEC4", 4, &floats([[1.0, 0.0, 0.0, 0.0f32]; 4].as_flattened()))
        .with_accessor(5126, "MAT4", on.len(), &floats(&on.iter().flat_map(matrix).collect::<Vec<_>>()));
    let [mesh, skin] = ["meshes", "skins"].map(|list| tiny.document[list].as_array().unwrap().len());
    let attributes = json!({"POSITION": number, "JOINTS_0": number + 1, "WEIGHTS_0": number + 2});
    tiny.with("/nodes/-", json!({"mesh": mesh, "skin": skin}))
        .with("/meshes/-", json!({"primitives": [{"attributes": attributes, "indices": INDICES}]}))
        .with("/skins/-", json!({"joints": on, "inverseBindMatrices": number + 3}))
}

/// The tiny rig with an end above its tip, which no skin has yet.
fn with_end() -> Tiny {
    Tiny::new().with("/nodes/2/children", json!([3])).with("/nodes/-", json!({"name": "end", "translation": [0, 1, 0]}))
}

fn heads(imported: &Imported) -> Vec<[f32; 3]> {
    imported.reading.joints.iter().map(|joint| joint.head).collect()
}

const UPRIGHT: [[f32; 3]; 3] = [[0.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 3.0, 0.0]];

#[test]
fn joints_of_skins_with_meshes_in_unlike_spaces_are_where_all_were_bound() {
    // A joint of both skins, and none of both.
    for on in [&[2, 3][..], &[3]] {
        let imported = read(&quantised(with_end(), on, 0.25, 0.5));
        assert_eq!((heads(&imported), imported.warnings()), (UPRIGHT.to_vec(), &[][..]), "{on:?}");
        let positions = imported.mesh().positions();
        assert_eq!(positions[..4], positions[4..], "{on:?}");
    }
}

#[test]
fn a_skin_on_joints_that_another_had_moved_goes_with_them() {
    // The body's joints contradict each other below a common node, so they go to where it was bound; the hat follows, with
    // the joint that is its alone.
    let mut tiny =
        with_end().with("/nodes/2/translation", json!([0, 5, 0])).with("/nodes/-", json!({"children": [1, 2]}));
    tiny.document["nodes"][1].as_object_mut().unwrap().remove("children");
    for on in [&[2][..], &[2, 3], &[3, 2]] {
        let imported = read(&quantised(tiny.clone(), on, 0.25, 0.5));
        let positions = imported.mesh().positions();
        assert_eq!((positions[2], positions[6]), ([0.0, 2.5, 0.0], [0.0, 2.5, 0.0]), "{on:?}");
        assert_eq!(heads(&imported), UPRIGHT[..=on.len()], "{on:?}");
    }
}

#[test]
fn quantised_models_without_their_rig_stand_where_the_file_shows_them() {
    // The root's inverse bind matrix brings to size; the rig has no scale, and stands elsewhere. A hat hangs on nothing.
    let hat = json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]});
    let mut tiny = quantised(Tiny::new(), &[1], 0.25, 0.5).with("/nodes/-", json!({"mesh": 2})).with("/meshes/-", hat);
    tiny.document["nodes"][0] = json!({"name": "body"});
    let imported = read(&tiny);
    assert_eq!((imported.mesh().positions()[0], imported.reading.shown_off), ([-2.0, 1.0, -2.0], [2.0, -1.0, 2.0]));
    assert_eq!(serde_json::to_value(imported.inspect(false)).unwrap()["shown_off"], json!([2.0, -1.0, 2.0]));
    let bare = export::strip_bytes("a.glb", &tiny.glb(), None, &ImportOptions::default()).unwrap().bytes;
    let bare = import_bytes("a.glb", &bare, &ImportOptions::default()).unwrap();
    let shown = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.5, 0.0], [0.0, 0.0, 1.0]];
    assert_eq!(bare.mesh().positions(), [shown, shown].concat());
    // Of skins that are shown elsewhere by one and another way, nothing is moved.
    assert_eq!(read(&quantised(Tiny::new(), &[1], 0.25, 0.5)).reading.shown_off, [0.0; 3]);
}

#[test]
fn skinned_meshes_that_their_nodes_mirror_face_outwards() {
    let plain = read(&Tiny::new());
    let all = json!({"name": "all", "scale": [-1, 1, 1], "children": [0, 1]});
    let mirrored = read(&Tiny::new().with("/nodes/-", all));
    let turned: Vec<[u32; 3]> = plain.mesh().triangles().iter().map(|&[a, b, c]| [a, c, b]).collect();
    assert_eq!(mirrored.mesh().positions()[1], [-1.0, 0.0, 0.0]);
    assert_eq!(mirrored.mesh().triangles(), turned);
}
