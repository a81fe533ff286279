//! Human bones, springs and colliders written, and read back.

mod common;

use std::path::PathBuf;

use common::{Tiny, data, files, reborn};
use riglab_asset::export::{self, ExportNote, ExportOptions, Exported, Influences, JointFrames};
use riglab_asset::rigging::{Subject, SubjectOptions};
use riglab_asset::{ImportOptions, Imported, import, import_bytes};
use riglab_core::{
    Collider, HumanBone, Humanoid, Joint, JointId, Provenance, Rig, Shape, Skeleton, SkinWeights, Spring, SpringJoint,
    Springs, Swing, Vec3,
};
use serde_json::{Value, json};

const ALL: ExportOptions = ExportOptions { influences: Influences::All, frames: JointFrames::Parallel };
const ALONG: ExportOptions = ExportOptions { frames: JointFrames::AlongBone, ..ALL };

fn read(bytes: &[u8]) -> Imported {
    import_bytes("back.glb", bytes, &ImportOptions::default()).unwrap()
}

/// The JSON of a GLB.
fn document(bytes: &[u8]) -> Value {
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}

/// All VRM files that have a rig with a body.
fn bodies() -> Vec<(PathBuf, Imported)> {
    let folders = [("RIGLAB_RIGS_ORIGINAL", "rigs_original"), ("RIGLAB_RIGS_HARD", "rigs_hard")];
    let folders = folders.into_iter().filter_map(|(variable, name)| data(variable, name));
    let all = folders.flat_map(|folder| files(&folder, &["vrm"]));
    let read = all.filter_map(|path| Some((import(&path, &ImportOptions::default()).ok()?, path)));
    let with_body =
        |imported: &Imported| imported.rig().is_some_and(|rig| !rig.humanoid().is_empty() || !rig.springs().is_empty());
    read.filter(|(imported, _)| with_body(imported)).map(|(imported, path)| (path, imported)).collect()
}

/// What a joint's spring is, but for its other joints.
#[derive(Debug)]
struct Own<'a> {
    joint: SpringJoint,
    name: &'a str,
    center: Option<JointId>,
    stops: Vec<&'a Collider>,
}

/// By joint.
fn swinging(rig: &Rig) -> Vec<Option<Own<'_>>> {
    let mut all: Vec<Option<Own<'_>>> = rig.skeleton().ids().map(|_| None).collect();
    for (number, spring) in rig.springs().springs().iter().enumerate() {
        for joint in spring.joints.iter().filter(|j| j.tail.is_some()) {
            let stops = rig.springs().stops(number).collect();
            all[joint.joint.index()] = Some(Own { joint: *joint, name: &spring.name, center: spring.center, stops });
        }
    }
    all
}

fn near(a: Vec3, b: Vec3, most: f32) -> bool {
    (0..3).all(|k| (a[k] - b[k]).abs() <= most)
}

fn same_collider(a: &Collider, b: &Collider, most: f32) -> bool {
    let close = |a: f32, b: f32| (a - b).abs() <= most;
    a.joint == b.joint
        && match (a.shape, b.shape) {
            (Shape::Sphere { center: p, radius: r }, Shape::Sphere { center: q, radius: s }) => {
                near(p, q, most) && close(r, s)
            }
            (Shape::Capsule { from: p, to: t, radius: r }, Shape::Capsule { from: q, to: u, radius: s }) => {
                near(p, q, most) && near(t, u, most) && close(r, s)
            }
            _ => false,
        }
}

/// In what the bodies of two rigs of one skeleton differ. Joints that swing in `back` alone are counted.
fn compare(back: &Rig, rig: &Rig) -> Result<usize, String> {
    let most = 1e-6 * rig.bounds().diagonal();
    if back.humanoid() != rig.humanoid() {
        return Err(format!("human bones {:?} and {:?}", back.humanoid(), rig.humanoid()));
    }
    let mut more = 0;
    for (a, b) in swinging(back).into_iter().zip(swinging(rig)) {
        let (a, b) = match (a, b) {
            (Some(a), Some(b)) => (a, b),
            (None, None) => continue,
            (Some(_), None) => {
                more += 1;
                continue;
            }
            (None, Some(b)) => return Err(format!("{b:?} is gone")),
        };
        let plain = |s: Swing| Swing { gravity_direction: [0.0; 3], hit_radius: 0.0, ..s };
        let (s, t) = (a.joint.swing, b.joint.swing);
        let same = plain(s) == plain(t)
            && near(s.gravity_direction, t.gravity_direction, 1e-6)
            && (s.hit_radius - t.hit_radius).abs() <= most
            && near(a.joint.tail.unwrap(), b.joint.tail.unwrap(), most)
            && (a.name, a.center, a.stops.len()) == (b.name, b.center, b.stops.len())
            && a.stops.iter().all(|a| b.stops.iter().any(|b| same_collider(a, b, most)));
        if !same {
            return Err(format!("{a:?}\nand\n{b:?}"));
        }
    }
    Ok(more)
}

fn all_colliders(back: &Rig, rig: &Rig) {
    let (a, b) = (back.springs().colliders(), rig.springs().colliders());
    let most = 1e-6 * rig.bounds().diagonal();
    assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same_collider(a, b, most)), "{a:?}\n{b:?}");
}

#[test]
fn bodies_of_real_files_come_back_from_rigs_alone() {
    let mut springs = 0;
    for (path, imported) in bodies() {
        let rig = imported.rig().unwrap();
        for options in [ALL, ALONG] {
            let exported = export::alone("a", rig, &imported.provenance, &options).unwrap();
            let back = read(&exported.bytes);
            let back = back.rig().unwrap();
            assert_eq!(compare(back, rig), Ok(0), "{}", path.display());
            all_colliders(back, rig);
            // What stays of groups is in their order.
            let groups =
                |rig: &Rig| rig.springs().groups().iter().filter(|g| !g.is_empty()).cloned().collect::<Vec<_>>();
            assert_eq!(groups(back), groups(rig));
        }
        springs += rig.springs().springs().len();
        println!("{}: {} springs, {:?}", path.display(), rig.springs().springs().len(), {
            export::alone("a", rig, &imported.provenance, &ALL).unwrap().notes
        });
    }
    println!("{springs} springs");
}

#[test]
fn bodies_of_real_files_come_back_from_new_skeletons() {
    for (path, imported) in bodies() {
        let rig = reborn(imported.rig().unwrap());
        for options in [ALL, ALONG] {
            let exported = export::onto(&path, &imported, &rig, &options).unwrap();
            let back = read(&exported.bytes);
            let more = compare(back.rig().unwrap(), &rig).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            let told = exported.notes.iter().find_map(|note| match note {
                ExportNote::SpringsChanged { joints, capsules: 0 } => Some(*joints),
                _ => None,
            });
            assert_eq!(more, told.unwrap_or(0), "{}", path.display());
        }
    }
}

/// Joints in a row along x, and `side` above the second.
fn branched() -> Rig {
    let joint = |name: &str, parent: Option<u16>, head| Joint { name: name.into(), parent: parent.map(JointId), head };
    let skeleton = Skeleton::new(vec![
        joint("root", None, [0.0; 3]),
        joint("a", Some(0), [1.0, 0.0, 0.0]),
        joint("b", Some(1), [2.0, 0.0, 0.0]),
        joint("side", Some(1), [1.0, 1.0, 0.5]),
    ])
    .unwrap();
    let mesh = read(&Tiny::new().glb()).mesh().clone();
    let rows = vec![vec![(0u16, 0.25), (1, 0.25), (2, 0.25), (3, 0.25)]; mesh.positions().len()];
    let swing =
        Swing { stiffness: 0.7, drag: 0.3, gravity_power: 0.2, gravity_direction: [0.0, -0.6, 0.8], hit_radius: 0.05 };
    let own = |joint: u16, tail: Option<Vec3>| SpringJoint { joint: JointId(joint), tail, swing };
    let spring = Spring {
        name: "mane".into(),
        // The tail of the leaf `b` is no joint; that of `side` is its own way.
        joints: vec![own(1, Some([2.0, 0.0, 0.0])), own(2, Some([2.0, 0.3, 0.4])), own(3, Some([1.5, 1.0, 0.5]))],
        groups: vec![1],
        center: Some(JointId(0)),
    };
    let colliders = vec![
        Collider { joint: JointId(0), shape: Shape::Sphere { center: [0.0, 1.0, 0.0], radius: 0.5 } },
        Collider {
            joint: JointId(1),
            shape: Shape::Capsule { from: [1.0, 0.5, 0.0], to: [1.0, 1.5, 0.25], radius: 0.25 },
        },
    ];
    let springs = Springs::new(vec![spring], colliders, vec![vec![], vec![0, 1]]).unwrap();
    let rig = Rig::new(skeleton, mesh, SkinWeights::normalized(rows).unwrap()).unwrap();
    rig.with_springs(springs).unwrap()
}

fn alone(rig: &Rig, options: &ExportOptions) -> Exported {
    export::alone("a", rig, &Provenance::default(), options).unwrap()
}

#[test]
fn a_spring_that_branches_becomes_chains_of_one_name() {
    let rig = branched();
    for options in [ALL, ALONG] {
        let exported = alone(&rig, &options);
        let written = document(&exported.bytes);
        assert_eq!(written["extensionsUsed"], json!(["VRMC_springBone"]));
        let own = &written["extensions"]["VRMC_springBone"];
        let nodes = |spring: usize| -> Vec<String> {
            let joints = own["springs"][spring]["joints"].as_array().unwrap();
            let name = |joint: &Value| &written["nodes"][joint["node"].as_u64().unwrap() as usize]["name"];
            joints.iter().map(|joint| name(joint).as_str().unwrap().to_owned()).collect()
        };
        assert_eq!(
            (nodes(0), nodes(1)),
            (["a", "b", "b_tail"].map(String::from).to_vec(), ["side", "side_tail"].map(String::from).to_vec(),)
        );
        assert_eq!((&own["springs"][0]["name"], &own["springs"][1]["name"]), (&json!("mane"), &json!("mane")));
        // The group without colliders is gone.
        assert_eq!(own["colliderGroups"], json!([{"colliders": [0, 1]}]));
        assert_eq!(written["skins"][0]["joints"].as_array().unwrap().len(), 4);
        let back = read(&exported.bytes);
        let back = back.rig().unwrap();
        assert_eq!(compare(back, &rig), Ok(0));
        all_colliders(back, &rig);
        assert_eq!(back.skeleton().parents(), rig.skeleton().parents());
        assert_eq!(alone(&rig, &options), exported);
    }
}

#[test]
fn joints_of_another_spring_mark_no_tail() {
    let rig = branched();
    let [mut first, mut second] = [0, 0].map(|n| rig.springs().springs()[n].clone());
    // `a` ends where `b` begins, which swings by itself; and `side` is free to mark a tail.
    first.joints.truncate(1);
    second.joints = vec![second.joints[1]];
    let springs = Springs::new(vec![first, second], rig.springs().colliders().to_vec(), vec![vec![], vec![0, 1]]);
    let rig = rig.with_springs(springs.unwrap()).unwrap();
    let exported = alone(&rig, &ALL);
    let names: Vec<Value> =
        document(&exported.bytes)["nodes"].as_array().unwrap().iter().map(|n| n["name"].clone()).collect();
    assert!(names.contains(&json!("a_tail")) && names.contains(&json!("b_tail")), "{names:?}");
    assert_eq!(compare(read(&exported.bytes).rig().unwrap(), &rig), Ok(0));

    let mut third = rig.springs().springs()[0].clone();
    third.joints[0].tail = Some(rig.skeleton().head(JointId(3)));
    let springs = Springs::new(vec![third], rig.springs().colliders().to_vec(), rig.springs().groups().to_vec());
    let rig = rig.with_springs(springs.unwrap()).unwrap();
    let exported = alone(&rig, &ALL);
    assert_eq!(document(&exported.bytes)["nodes"].as_array().unwrap().len(), 5);
    assert_eq!(compare(read(&exported.bytes).rig().unwrap(), &rig), Ok(0));
}

#[test]
fn vrm_0_gets_its_own_form_and_a_note_of_what_it_cannot_say() {
    let bytes = Tiny::new().with("/extensions", json!({"VRM": {"secondaryAnimation": {"boneGroups": []}}})).glb();
    let imported = read(&bytes);
    let put = |rig: &Rig| export::onto_bytes("a.vrm", &bytes, None, &imported, rig, &ALONG).unwrap();
    let exported = put(&branched());
    // Nor is it a human.
    let [ExportNote::NotHuman { lacking }, springs] = &exported.notes[..] else { panic!("{:?}", exported.notes) };
    assert_eq!((lacking.len(), springs), (15, &ExportNote::SpringsChanged { joints: 0, capsules: 1 }));
    let written = document(&exported.bytes);
    assert!(written["extensions"].get("VRMC_springBone").is_none());
    let group = &written["extensions"]["VRM"]["secondaryAnimation"]["boneGroups"][0];
    let stated = f64::from(0.8f32);
    assert_eq!((&group["comment"], &group["gravityDir"]["z"]), (&json!("mane"), &json!(-stated)));
    // `a` takes those below it along.
    assert_eq!(group["bones"].as_array().unwrap().len(), 1);
    let back = read(&exported.bytes);
    let back = back.rig().unwrap();
    // Spheres a radius apart from one end of the capsule to the other.
    let spheres = back.springs().colliders().iter().filter(|c| c.joint == JointId(1));
    let centers: Vec<Vec3> = spheres
        .map(|c| match c.shape {
            Shape::Sphere { center, radius } => {
                assert!((radius - 0.25).abs() < 1e-6);
                center
            }
            Shape::Capsule { .. } => panic!("no capsules here"),
        })
        .collect();
    assert!(near(centers[0], [1.0, 0.5, 0.0], 1e-5) && near(centers[centers.len() - 1], [1.0, 1.5, 0.25], 1e-5));
    assert_eq!(centers.len(), 6);

    let rig = branched();
    let mut spring = rig.springs().springs()[0].clone();
    // `b` stands still below `a`; `side` swings another way.
    spring.joints.remove(1);
    spring.joints[1].swing.stiffness = 3.0;
    let ball = rig.springs().colliders()[0];
    let springs = Springs::new(vec![spring], vec![ball], vec![vec![], vec![0]]).unwrap();
    let rig = rig.with_springs(springs).unwrap();
    let exported = put(&rig);
    assert_eq!(exported.notes[1..], [ExportNote::SpringsChanged { joints: 1, capsules: 0 }]);
    assert_eq!(compare(read(&exported.bytes).rig().unwrap(), &rig), Ok(1));
}

#[test]
fn springs_that_changed_go_to_the_joints_that_are_there() {
    // Joints below a node with a scale, which their bind matrices have, too.
    let matrix = |y: f32| -> Vec<u8> {
        let mut m = [0.0f32; 16];
        (m[0], m[5], m[10], m[15], m[13]) = (0.5, 0.5, 0.5, 1.0, -y / 2.0);
        m.iter().flat_map(|x| x.to_le_bytes()).collect()
    };
    let tiny = Tiny::new()
        .with("/nodes/1/translation", json!([0, 0.5, 0]))
        .with("/nodes/2/translation", json!([0, 0.5, 0]))
        .with("/nodes/-", json!({"name": "above", "children": [1], "scale": [2, 2, 2]}));
    let start = tiny.document["bufferViews"][common::INVERSE_BIND]["byteOffset"].as_u64().unwrap() as usize;
    let bytes = tiny.with_bytes(start, &[matrix(1.0), matrix(2.0)].concat()).glb();
    let imported = read(&bytes);
    assert_eq!(imported.rig().unwrap().skeleton().heads(), [[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]);
    let swing = Swing { hit_radius: 0.5, ..Swing::default() };
    let own = |joint: u16, tail| SpringJoint { joint: JointId(joint), tail: Some(tail), swing };
    let spring =
        Spring { joints: vec![own(0, [0.0, 2.0, 0.0]), own(1, [0.0, 2.5, 1.0])], groups: vec![0], ..Spring::default() };
    let ball = Collider { joint: JointId(1), shape: Shape::Sphere { center: [1.0, 2.0, 3.0], radius: 0.25 } };
    let mut humanoid = Humanoid::default();
    humanoid.insert("hips".parse().unwrap(), JointId(0));
    let rig = imported.rig().unwrap().clone().with_humanoid(humanoid).unwrap();
    let rig = rig.with_springs(Springs::new(vec![spring], vec![ball], vec![vec![0]]).unwrap()).unwrap();
    let exported = export::onto_bytes("a.glb", &bytes, None, &imported, &rig, &ALL).unwrap();
    let written = document(&exported.bytes);
    let own = &written["extensions"]["VRMC_springBone"];
    assert_eq!(own["colliders"][0]["shape"]["sphere"], json!({"offset": [0.5, 0.0, 1.5], "radius": 0.125}));
    // In units of the scene, whatever the scale of its node.
    assert_eq!(own["springs"][0]["joints"][0]["hitRadius"], 0.5);
    assert_eq!(written["nodes"][1]["extras"], json!({"riglabHumanBone": "hips"}));
    assert_eq!(compare(read(&exported.bytes).rig().unwrap(), &rig), Ok(0));
    // Without a change nothing is written.
    let back = read(&exported.bytes);
    let again = export::onto_bytes("back.glb", &exported.bytes, None, &back, back.rig().unwrap(), &ALL).unwrap();
    assert_eq!(again.bytes, exported.bytes);
    let stripped = export::strip_bytes("a.glb", &exported.bytes, None, &ImportOptions::default()).unwrap().bytes;
    let mut bare = document(&stripped);
    // Who wrote it stands there all the same.
    assert!(bare["asset"]["extras"]["writer"].take().is_string());
    assert!(!bare.to_string().contains("VRM") && !bare.to_string().contains("riglab"), "{bare}");
}

#[test]
fn tails_of_vrm_0_go_by_nodes_that_are_no_joints_too() {
    let zero = json!({"VRM": {"secondaryAnimation": {"boneGroups": []}}});
    let own = |joint: u16, tail| SpringJoint { joint: JointId(joint), tail: Some(tail), swing: Swing::default() };
    let spring = Spring { joints: vec![own(0, [0.0, 2.0, 0.0]), own(1, [0.0, 2.07, 0.0])], ..Spring::default() };
    let springs = Springs::new(vec![spring], vec![], vec![]).unwrap();
    let tiny = Tiny::new().with("/extensions", zero);
    // Where the first node below the hips is none of the joints, it is not their tail.
    let helped = tiny
        .clone()
        .with("/nodes/1/children", json!([3, 2]))
        .with("/nodes/-", json!({"name": "helper", "translation": [0.5, 0, 0]}));
    for (tiny, added) in [(tiny, 0), (helped, 1)] {
        let bytes = tiny.glb();
        let imported = read(&bytes);
        let rig = imported.rig().unwrap().clone().with_springs(springs.clone()).unwrap();
        let exported = export::onto_bytes("a.vrm", &bytes, None, &imported, &rig, &ALL).unwrap();
        assert_eq!(compare(read(&exported.bytes).rig().unwrap(), &rig), Ok(0));
        let nodes = |bytes: &[u8]| document(bytes)["nodes"].as_array().unwrap().len();
        assert_eq!(nodes(&exported.bytes), nodes(&bytes) + added);
    }
}

/// A VRM 1.0 whose head has an eye that is no joint and carries a collider, and the inverse bind matrix of whose head is too
/// large by so much.
fn vrm_with_an_eye(too_large: f32) -> Tiny {
    let matrix = |scale: f32, [x, y]: [f32; 2]| {
        let mut m = [0.0f32; 16];
        (m[0], m[5], m[10], m[15], m[12], m[13]) = (scale, scale, scale, 1.0, -scale * x, -scale * y);
        m
    };
    let binds = [matrix(1.0, [0.0, 1.0]), matrix(1.0 + too_large, [1.0, 2.0])].concat();
    let binds: Vec<u8> = binds.iter().flat_map(|x| x.to_le_bytes()).collect();
    let bone = |node: usize| json!({"node": node});
    let springs = json!({
        "colliders": [{"node": 3, "shape": {"sphere": {"offset": [0, 0.1, 0], "radius": 0.25}}}],
        "colliderGroups": [{"colliders": [0]}],
        "springs": [{"joints": [bone(1), bone(2), bone(3)], "colliderGroups": [0]}],
    });
    let bones = json!({"hips": bone(1), "head": bone(2), "leftEye": bone(3)});
    let vrm = json!({"humanoid": {"humanBones": bones}, "lookAt": {"offsetFromHeadBone": [0, 0.06, 0]}});
    let follows = json!({"VRMC_node_constraint": {"constraint": {"roll": {"source": 1, "rollAxis": "X"}}}});
    let tiny = Tiny::new().with_accessor(5126, "MAT4", 2, &binds);
    let own = tiny.accessors() - 1;
    tiny.with("/skins/0/inverseBindMatrices", json!(own))
        .with("/nodes/2", json!({"name": "tip", "translation": [1, 1, 0], "children": [3], "extensions": follows}))
        .with("/nodes/-", json!({"name": "eye", "translation": [0, 0.25, 0.5]}))
        .with("/extensions", json!({"VRMC_vrm": vrm, "VRMC_springBone": springs}))
}

/// A file with other weights, as from what makes them for a skeleton and knows nothing of bodies.
fn skinned_anew(bytes: &[u8], rows: &[Vec<(u16, f64)>], options: &ExportOptions) -> Exported {
    let keep = SubjectOptions { keep_rig: true, ..SubjectOptions::default() };
    let subject = Subject::from_bytes("a.vrm", bytes, None, &keep).unwrap();
    let weights = SkinWeights::normalized(rows.iter().cloned()).unwrap();
    let rig = subject.rigged(subject.old_rig().unwrap().skeleton().clone(), weights).unwrap();
    subject.attach(&rig, options).unwrap()
}

#[test]
fn bodies_stay_where_weights_change() {
    let halves = vec![vec![(0, 0.5), (1, 0.5)]; 4];
    // Vertices move by what rounding left, and all stays as it was.
    let bytes = vrm_with_an_eye(2e-7).glb();
    let exported = skinned_anew(&bytes, &halves, &ALONG);
    assert_eq!(exported.notes, []);
    for key in ["nodes", "extensions"] {
        assert_eq!(document(&exported.bytes)[key], document(&bytes)[key]);
    }
    // By more: the joints are new, and what is said of the old ones is said of them, or told to be gone.
    let bytes = vrm_with_an_eye(1e-4).glb();
    let before = read(&bytes);
    let before = before.rig().unwrap();
    for options in [ALL, ALONG] {
        let exported = skinned_anew(&bytes, &halves, &options);
        let written = document(&exported.bytes);
        assert!(written["nodes"].as_array().unwrap().iter().any(|node| node["name"] == "Armature"));
        let back = read(&exported.bytes);
        assert_eq!(compare(back.rig().unwrap(), before), Ok(0));
        all_colliders(back.rig().unwrap(), before);
        let [ExportNote::NotHuman { lacking }, lost] = &exported.notes[..] else { panic!("{:?}", exported.notes) };
        assert!(lacking.len() == 13 && !lacking.contains(&"head".to_owned()), "{lacking:?}");
        assert_eq!(*lost, ExportNote::HungLost { nodes: 1, bones: 1, constraints: 1 });
        // Half of a right angle from the scene's y, as the bone is.
        let turned = if options == ALONG { 0.06 * 0.5f64.sqrt() } else { 0.0 };
        let offset = &written["extensions"]["VRMC_vrm"]["lookAt"]["offsetFromHeadBone"];
        let along = if options == ALONG { turned } else { 0.06 };
        for (k, wanted) in [-turned, along, 0.0].into_iter().enumerate() {
            assert!((offset[k].as_f64().unwrap() - wanted).abs() < 1e-6, "{offset}");
        }
    }
    // Files that are no VRM tell bones by extras.
    let plain = vrm_with_an_eye(1e-4)
        .with("/extensions", json!({}))
        .with("/nodes/1/extras", json!({"riglabHumanBone": "hips", "mine": 1}));
    let exported = skinned_anew(&plain.glb(), &halves, &ALONG);
    let back = read(&exported.bytes);
    assert_eq!(back.rig().unwrap().humanoid().joint("hips".parse().unwrap()), Some(JointId(0)));
}

#[test]
fn skins_take_in_the_joints_that_new_weights_need() {
    let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let mut bind = [0.0f32; 16];
    (bind[0], bind[5], bind[10], bind[15], bind[13]) = (1.0, 1.0, 1.0, 1.0, -1.0);
    let tiny = Tiny::new()
        .with_accessor(5121, "VEC4", 4, &[0; 16])
        .with_accessor(5126, "VEC4", 4, &floats(&[[1.0, 0.0, 0.0, 0.0]; 4].concat()))
        .with_accessor(5126, "MAT4", 1, &floats(&bind));
    let first = tiny.accessors() - 3;
    let attributes = json!({"POSITION": 0, "JOINTS_0": first, "WEIGHTS_0": first + 1});
    let tiny = tiny
        .with("/nodes/-", json!({"name": "cloth", "mesh": 1, "skin": 1}))
        .with("/meshes/-", json!({"primitives": [{"attributes": attributes, "indices": 3}]}))
        .with("/skins/-", json!({"joints": [1], "inverseBindMatrices": first + 2}));
    let rows: Vec<Vec<(u16, f64)>> =
        (0..8).map(|v| if v < 4 { vec![(0, 0.5), (1, 0.5)] } else { vec![(1, 1.0)] }).collect();
    let joined = |tiny: &Tiny| {
        let exported = skinned_anew(&tiny.glb(), &rows, &ALL);
        let (back, written) = (read(&exported.bytes), document(&exported.bytes));
        let rig = back.rig().unwrap();
        assert_eq!(rig.skeleton(), read(&tiny.glb()).rig().unwrap().skeleton());
        assert!((4..8).all(|v| rig.weights().row(v).map(|(j, w)| (j.0, w)).eq([(1, 1.0)])));
        (written["nodes"] == tiny.document["nodes"]).then(|| written["skins"][1]["joints"].clone())
    };
    assert_eq!(joined(&tiny), Some(json!([1, 2])));
    assert_eq!(joined(&tiny.clone().with("/skins/1/skeleton", json!(1))), Some(json!([1, 2])));
    // A joint that its root does not hold, and matrices that are not there.
    assert_eq!(joined(&tiny.clone().with("/skins/1/skeleton", json!(3))), None);
    assert_eq!(joined(&tiny.with("/skins/1", json!({"joints": [1]}))), None);
}

/// All bones that VRM asks for, on joints of their own; the left at `left` along x.
fn human(left: f32) -> Rig {
    let mut humanoid = Humanoid::default();
    let mut joints = Vec::new();
    for (number, bone) in (0u16..).zip(HumanBone::all().filter(|b| b.is_required())) {
        let x = if bone.name().starts_with("left") { left } else { -left };
        joints.push(Joint {
            name: format!("j{number}"),
            parent: (number > 0).then_some(JointId(0)),
            head: [x, 1.0, 0.0],
        });
        humanoid.insert(bone, JointId(number));
    }
    let mesh = read(&Tiny::new().glb()).mesh().clone();
    let rows = vec![vec![(0u16, 1.0)]; mesh.positions().len()];
    let rig = Rig::new(Skeleton::new(joints).unwrap(), mesh, SkinWeights::normalized(rows).unwrap()).unwrap();
    rig.with_humanoid(humanoid).unwrap()
}

#[test]
fn a_body_alone_becomes_a_vrm_where_its_author_chose_that_licence() {
    let licence = "https://vrm.dev/licenses/1.0/";
    let known = Provenance { licence: licence.into(), author: "Ann".into(), ..Provenance::default() };
    let put = |rig: &Rig, from: &Provenance| export::alone("body", rig, from, &ALL).unwrap();
    let exported = put(&human(1.0), &known);
    assert_eq!(exported.notes, []);
    let written = document(&exported.bytes);
    let meta = json!({"name": "body", "authors": ["Ann"], "licenseUrl": licence});
    assert_eq!(written["extensions"]["VRMC_vrm"]["meta"], meta);
    assert_eq!(written["extensionsUsed"], json!(["VRMC_vrm"]));
    let back = read(&exported.bytes);
    assert_eq!(back.rig().unwrap().humanoid(), human(1.0).humanoid());
    assert_eq!((back.provenance.licence.as_str(), back.provenance.author.as_str()), (licence, "Ann"));

    let mut part = Humanoid::default();
    part.insert("hips".parse().unwrap(), JointId(0));
    for (rig, from, why) in [
        (human(-1.0), known.clone(), "look along +z"),
        (human(1.0), Provenance { author: String::new(), ..known.clone() }, "no author"),
        (human(1.0), Provenance { licence: "CC-BY-4.0".into(), ..known.clone() }, "its licence is not"),
        (human(1.0).with_humanoid(part).unwrap(), known, "not all human bones"),
    ] {
        let exported = put(&rig, &from);
        assert!(exported.notes[0].to_string().contains(why), "{:?}", exported.notes);
        assert!(document(&exported.bytes).get("extensions").is_none());
        let back = read(&exported.bytes);
        assert_eq!(back.rig().unwrap().humanoid(), rig.humanoid());
        assert_eq!(back.provenance.licence, from.licence);
    }
}

#[test]
fn bones_that_extras_misname_are_left_out_and_told() {
    let extra = |name: Value| json!({"riglabHumanBone": name});
    let tiny = Tiny::new()
        .with("/nodes/0/extras", extra(json!("head")))
        .with("/nodes/1/extras", extra(json!("tail")))
        .with("/nodes/2/extras", extra(json!(7)));
    let imported = read(&tiny.glb());
    // The first is no joint, the last no name.
    assert!(imported.rig().unwrap().humanoid().is_empty());
    let told: Vec<String> = imported.warnings().iter().map(ToString::to_string).collect();
    assert!(told.len() == 1 && told[0].contains("`tail` is no human bone"), "{told:?}");
}
