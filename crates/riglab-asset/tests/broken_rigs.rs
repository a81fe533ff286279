//! A rig that cannot be read is refused by what needs it, and no hindrance to what takes it out.

mod common;

use common::{INVERSE_BIND, JOINTS, POSITION, Tiny, WEIGHTS, glb};
use riglab_asset::export::{self, ExportNote, ExportOptions};
use riglab_asset::rigging::{Subject, SubjectNote, SubjectOptions};
use riglab_asset::{Fault, ImportOptions, Warning, import_bytes};
use riglab_core::{Joint, Skeleton, SkinWeights};
use serde_json::{Value, json};

/// The tiny rig, broken in each of the ways that leave its mesh whole.
fn broken() -> Vec<(&'static str, Tiny)> {
    let nan = f32::NAN.to_le_bytes();
    let of = |pointer: &str, value: Value| Tiny::new().with(pointer, value);
    vec![
        ("NaN in an inverse bind", Tiny::new().with_bytes(152, &nan)),
        ("a flat inverse bind", Tiny::new().with_bytes(152, &[0; 16])),
        ("NaN in a weight", Tiny::new().with_bytes(64, &nan)),
        ("a joint out of range", Tiny::new().with_bytes(48, &[5])),
        ("no joints", of("/skins/0/joints", json!([]))),
        ("a joint twice", of("/skins/0/joints", json!([1, 1]))),
        ("a joint that is no node", of("/skins/0/joints", json!([1, 77]))),
        ("no such skin", of("/nodes/0/skin", json!(77))),
        ("no such matrices", of("/skins/0/inverseBindMatrices", json!(77))),
        ("too few matrices", of(&format!("/accessors/{INVERSE_BIND}/count"), json!(1))),
        ("matrices beyond the file", of(&format!("/accessors/{INVERSE_BIND}/byteOffset"), json!(64))),
        ("joints of floats", of(&format!("/accessors/{JOINTS}/componentType"), json!(5126))),
        ("too few weights", of(&format!("/accessors/{WEIGHTS}/count"), json!(3))),
        ("no weights", of("/meshes/0/primitives/0/attributes", json!({"POSITION": POSITION, "JOINTS_0": JOINTS}))),
    ]
}

fn document(glb: &[u8]) -> Value {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&glb[20..20 + length]).unwrap()
}

#[test]
fn a_broken_rig_is_refused_where_it_is_wanted_with_a_remedy() {
    for (what, tiny) in broken() {
        let options = SubjectOptions { keep_rig: true, ..SubjectOptions::default() };
        let said = [
            import_bytes("a.glb", &tiny.glb(), &ImportOptions::default()).unwrap_err().to_string(),
            Subject::from_bytes("a.glb", &tiny.glb(), None, &options).unwrap_err().to_string(),
        ];
        assert_eq!(said[0], said[1]);
        // Bytes that are not there may be anybody's.
        assert!(
            what == "matrices beyond the file" || said[0].ends_with("; `riglab rig` makes a new rig for it"),
            "{said:?}"
        );
    }
}

#[test]
fn a_model_with_a_broken_rig_is_rigged_as_its_nodes_place_it() {
    let sound = import_bytes("a.glb", &Tiny::new().glb(), &ImportOptions::default()).unwrap();
    for (what, tiny) in broken() {
        let tiny = tiny.with("/nodes/0/translation", json!([0, 0, 3]));
        let subject = Subject::from_bytes("a.glb", &tiny.glb(), None, &SubjectOptions::default()).unwrap();
        let moved: Vec<_> = sound.mesh().positions().iter().map(|[x, y, z]| [*x, *y, z + 3.0]).collect();
        assert_eq!((subject.mesh().positions(), subject.mesh().triangles()), (&moved[..], sound.mesh().triangles()));
        let told = |n: &SubjectNote| matches!(n, SubjectNote::Stripped(ExportNote::RigBroken(_)));
        assert!(subject.notes().iter().any(told), "{what}: {:?}", subject.notes());
        let joint = Joint { name: "root".into(), parent: None, head: [0.0; 3] };
        let weights = SkinWeights::normalized(vec![[(0, 1.0)]; 4]).unwrap();
        let rig = subject.rigged(Skeleton::new(vec![joint]).unwrap(), weights).unwrap();
        let exported = subject.attach(&rig, &ExportOptions::default()).unwrap();
        let back = import_bytes("b.glb", &exported.bytes, &ImportOptions::default()).unwrap();
        assert_eq!((back.rig(), back.warnings()), (Some(&rig), &[Warning::SingleJoint][..]), "{what}");
        // Of the old joints nothing stays, where the file says which they are.
        let nodes = document(&exported.bytes)["nodes"].to_string();
        assert_eq!(nodes.contains("hips") || nodes.contains("tip"), what == "no joints", "{what}: {nodes}");
    }
}

#[test]
fn a_broken_rig_is_taken_out_with_its_motions() {
    let motion = json!([{"channels": [{"sampler": 0, "target": {"node": 2, "path": "scale"}}],
        "samplers": [{"input": 0, "output": 0}]}]);
    for (what, tiny) in broken().into_iter().filter(|(what, _)| *what != "no joints") {
        let tiny = tiny.with("/animations", motion.clone());
        let stripped = export::strip_bytes("a.glb", &tiny.glb(), None, &ImportOptions::default()).unwrap();
        let (first, more) = stripped.notes.split_at(2);
        assert!(matches!(first, [ExportNote::RigBroken(_), ExportNote::MotionDropped { channels: 1 }]), "{what}");
        // Where it is no joint, the tip is one of the nodes that hang on joints.
        let hung = ExportNote::HungLost { nodes: 1, bones: 0, constraints: 0 };
        let hangs = ["a joint twice", "a joint that is no node"].contains(&what);
        assert_eq!(more, if hangs { vec![hung] } else { vec![] }, "{what}");
        let json = document(&stripped.bytes);
        assert_eq!((&json["skins"], &json["animations"]), (&Value::Null, &Value::Null), "{what}");
        assert_eq!(json["nodes"], json!([{"name": "body", "mesh": 0}]), "{what}");
        assert_eq!(json["meshes"][0]["primitives"][0]["attributes"].as_object().unwrap().len(), 1, "{what}");
        let bare = import_bytes("b.glb", &stripped.bytes, &ImportOptions::default()).unwrap();
        assert_eq!(bare.warnings(), [Warning::NoSkeleton], "{what}");
    }
    let (_, nan) = &broken()[0];
    let stripped = export::strip_bytes("a.glb", &nan.glb(), None, &ImportOptions::default()).unwrap();
    assert_eq!(
        stripped.notes[0].to_string(),
        "the old rig cannot be read and was left out: accessor 4 (inverse bind matrices) has a number that is not finite \
         (NaN or infinity) in element 0; the model stands where its nodes place it"
    );
}

#[test]
fn a_broken_mesh_is_refused_with_and_without_its_rig() {
    let nan = Tiny::new().with_bytes(0, &f32::NAN.to_le_bytes());
    let corner = Tiny::new().with_bytes(128, &[9, 0]);
    let both = Tiny::new().with_bytes(0, &f32::NAN.to_le_bytes()).with("/skins/0/joints", json!([]));
    for tiny in [nan, corner, both] {
        let subject = Subject::from_bytes("a.glb", &tiny.glb(), None, &SubjectOptions::default()).unwrap_err();
        let of_mesh = |fault: &Fault| {
            matches!(fault, Fault::NotFinite { accessor: POSITION, .. } | Fault::VertexIndex { vertex: 9, .. })
        };
        assert!(of_mesh(&subject.fault), "{subject}");
        assert!(!subject.to_string().contains("riglab rig"), "{subject}");
        let stripped = export::strip_bytes("a.glb", &tiny.glb(), None, &ImportOptions::default()).unwrap_err();
        assert!(stripped.to_string().ends_with(&subject.fault.to_string()), "{stripped}");
    }
    // Nor is a file read whose JSON is none.
    let cut = glb(br#"{"asset":{"version":"2.0"},"skins":[{"joints":[]}"#, &[]);
    let fault = Subject::from_bytes("a.glb", &cut, None, &SubjectOptions::default()).unwrap_err().fault;
    assert!(matches!(fault, Fault::Json { .. }), "{fault}");
}
