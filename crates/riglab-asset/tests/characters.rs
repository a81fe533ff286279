//! Several characters in one file.

mod common;

use std::ops::ControlFlow;

use common::{INDICES, INVERSE_BIND, JOINTS, POSITION, Tiny, WEIGHTS};
use riglab_asset::{
    Character, ImportOptions, Imported, NodeName, Resample, Warning, import, import_bytes, import_each,
};
use serde_json::json;

/// The tiny rig, and five units beside it another one of the same vertices, which has springs and moves.
fn two() -> Tiny {
    let primitive =
        json!({"attributes": {"POSITION": POSITION, "JOINTS_0": JOINTS, "WEIGHTS_0": WEIGHTS}, "indices": INDICES});
    Tiny::new()
        .with("/nodes/-", json!({"name": "other", "translation": [5, 0, 0], "children": [4, 6]}))
        .with("/nodes/-", json!({"name": "pelvis", "translation": [0, 1, 0], "children": [5]}))
        .with("/nodes/-", json!({"name": "top", "translation": [0, 1, 0]}))
        .with("/nodes/-", json!({"name": "body2", "mesh": 1, "skin": 1}))
        .with("/meshes/-", json!({"primitives": [primitive]}))
        .with("/skins/-", json!({"joints": [4, 5], "inverseBindMatrices": INVERSE_BIND}))
        .with_accessor(5126, "SCALAR", 1, &[0; 4])
        .with_accessor(5126, "VEC3", 1, &[1f32, 2.0, 3.0].map(f32::to_le_bytes).concat())
        .with(
            "/animations",
            json!([{"name": "hop", "samplers": [{"input": 5, "output": 6}],
                "channels": [{"sampler": 0, "target": {"node": 4, "path": "translation"}}]}]),
        )
        .with(
            "/extensions",
            json!({"VRMC_springBone": {
                "colliders": [{"node": 1, "shape": {"sphere": {}}}, {"node": 4, "shape": {"sphere": {"radius": 2}}}],
                "colliderGroups": [{"colliders": [0, 1]}],
                "springs": [{"joints": [{"node": 4}, {"node": 5}], "colliderGroups": [0]}],
            }}),
        )
}

fn read(character: Option<&str>) -> Result<Imported, String> {
    let character = character.map(|c| c.parse::<Character>().unwrap());
    let options = ImportOptions { character, clips: Some(Resample::default()), ..ImportOptions::default() };
    import_bytes("two.glb", &two().glb(), &options).map_err(|e| e.to_string())
}

#[test]
fn without_a_choice_all_are_read_and_it_is_told() {
    let imported = read(None).unwrap();
    assert_eq!(imported.reading.characters(), ["hips", "pelvis"]);
    assert_eq!(imported.rig().unwrap().skeleton().len(), 4);
    let separate = |w: &&Warning| matches!(w, Warning::SeparateSkeletons { skeletons: 2, .. });
    assert!(imported.warnings().iter().find(separate).unwrap().to_string().contains("--character"));
}

#[test]
fn one_is_read_with_all_that_is_its_own() {
    let (second, first) = (read(Some("1")).unwrap(), read(Some("hips")).unwrap());
    let [a, b] = [&first, &second].map(|i| i.rig().unwrap());
    assert_eq!(
        (a.skeleton().names(), b.skeleton().names()),
        (&["hips", "tip"].map(String::from)[..], &["pelvis", "top"].map(String::from)[..])
    );
    assert_eq!((a.mesh().triangles().len(), b.mesh().triangles().len()), (4, 4));
    assert_eq!(b.mesh().positions()[0], [5.0, 0.0, 0.0]);
    assert_eq!(a.weights(), b.weights());
    assert!(a.springs().springs().is_empty());
    assert_eq!((a.springs().colliders().len(), b.springs().stops(0).count()), (1, 1));
    // To (1, 2, 3) of its parent from (0, 1, 0).
    let maps = second.clips[0].maps();
    assert_eq!((second.clips[0].joints(), maps[1][3]), (2, [1.0, 1.0, 3.0]));
    assert!(!second.warnings().iter().any(|w| matches!(w, Warning::SeparateSkeletons { .. })));
    assert_eq!(second.inspect(false).joints.len(), 2);
}

/// The same, with faults of the second: a pose, weights, a sword on a joint, a mesh that is hidden there. A hat hangs on nothing.
fn one_of_two_is_faulty() -> Tiny {
    let rows = [[0.0f32; 4], [0.0; 4], [2.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]];
    let bytes: Vec<u8> = rows.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
    two()
        .with_accessor(5126, "VEC4", 4, &bytes)
        .with("/meshes/1/primitives/0/attributes/WEIGHTS_0", json!(7))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": POSITION}, "indices": INDICES}]}))
        .with("/nodes/5/translation", json!([1, 1, 0]))
        .with("/nodes/5/children", json!([8, 9]))
        .with("/nodes/-", json!({"name": "hat", "mesh": 2}))
        .with("/nodes/-", json!({"name": "sword", "mesh": 2}))
        .with("/nodes/-", json!({"name": "hidden", "mesh": 2, "scale": [0, 0, 0]}))
}

#[test]
fn of_faults_each_is_told_its_own() {
    let bytes = one_of_two_is_faulty().glb();
    let read = |name: &str, bytes: &[u8], number: usize| {
        let character = Some(Character::Number(number));
        import_bytes(name, bytes, &ImportOptions { character, ..ImportOptions::default() }).unwrap()
    };
    let first = read("two.glb", &bytes, 0);
    assert_eq!((first.warnings(), &first.provenance.notes[..]), (&[][..], &[][..]));
    let second = read("two.glb", &bytes, 1);
    let node = |number: usize, name: &str| vec![NodeName { number, name: name.into() }];
    let [Warning::RestIsNotBind { skins, .. }, others @ ..] = second.warnings() else {
        panic!("{:?}", second.warnings())
    };
    assert_eq!(skins, &[1]);
    assert_eq!(
        others,
        [
            Warning::NotNormalised { vertices: 1, sums: (2.0, 2.0) },
            Warning::Unweighted { vertices: 2 },
            Warning::RigidParts { nodes: node(8, "sword"), joints: vec!["top".into()] },
            Warning::LeftOut { nodes: node(9, "hidden") },
        ]
    );
    #[cfg(feature = "fbx")]
    {
        let fbx = riglab_asset::glb_to_fbx(&bytes).unwrap().bytes;
        assert_eq!(read("two.fbx", &fbx, 0).warnings(), []);
        let told = read("two.fbx", &fbx, 1);
        let has = |wanted: fn(&Warning) -> bool| told.warnings().iter().any(wanted);
        assert!(has(|w| matches!(w, Warning::RestIsNotBind { .. })), "{:?}", told.warnings());
        assert!(has(|w| matches!(w, Warning::RigidParts { .. })), "{:?}", told.warnings());
    }
}

#[test]
fn a_joint_without_scale_is_told_of_its_own_character() {
    let bytes = two().with("/nodes/5/scale", json!([0, 0, 0])).glb();
    let told = [0, 1].map(|number| {
        let options = ImportOptions { character: Some(Character::Number(number)), ..ImportOptions::default() };
        let read = import_bytes("two.glb", &bytes, &options).unwrap();
        read.warnings().iter().any(|warning| matches!(warning, Warning::ZeroScale { .. }))
    });
    assert_eq!(told, [false, true]);
}

#[test]
fn a_file_can_be_split() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("two.glb");
    std::fs::write(&path, two().glb()).unwrap();
    for (split, wanted) in [(false, vec!["two"]), (true, vec!["two-hips", "two-pelvis"])] {
        let mut names = Vec::new();
        import_each(&path, &ImportOptions { split, ..ImportOptions::default() }, |imported| {
            names.push(imported.unwrap().name);
            ControlFlow::Continue(())
        });
        assert_eq!(names, wanted);
    }
}

#[test]
fn those_of_a_file_that_is_split_are_as_each_is_alone() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("two.glb");
    for file in [two(), one_of_two_is_faulty()] {
        std::fs::write(&path, file.glb()).unwrap();
        let options = ImportOptions { split: true, clips: Some(Resample::default()), ..ImportOptions::default() };
        let mut number = 0;
        import_each(&path, &options, |split| {
            let character = Some(Character::Number(number));
            let alone = import(&path, &ImportOptions { character, split: false, ..options.clone() }).unwrap();
            let split = split.unwrap();
            assert!(split.parted && !alone.parted);
            assert_eq!((&split.content, &split.clips), (&alone.content, &alone.clips));
            assert_eq!((&split.provenance, split.warnings()), (&alone.provenance, alone.warnings()));
            number += 1;
            ControlFlow::Continue(())
        });
        assert_eq!(number, 2);
    }
}

#[test]
fn what_is_not_there_is_refused_with_what_is() {
    for wanted in ["2", "top", "nobody"] {
        let error = read(Some(wanted)).unwrap_err();
        assert!(error.contains("two.glb: no character") && error.contains("1 (`pelvis`)"), "{error}");
    }
}
