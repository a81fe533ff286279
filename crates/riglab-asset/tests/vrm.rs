//! Human bones, springs and colliders of VRM files.

mod common;

use common::{Tiny, data, files};
use riglab_asset::{ImportOptions, Imported, Warning, import, import_bytes};
use riglab_core::{JointId, Rig, Shape, SpringJoint, Vec3};
use serde_json::{Value, json};

/// The tiny rig with another node below `tip`, no joint, and an extension.
fn tiny(name: &str, extension: Value) -> Imported {
    let tiny = Tiny::new()
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"name": "end", "translation": [0, 0.5, 0]}))
        .with("/nodes/1/scale", json!([2, 2, 2]))
        .with("/extensions", json!({name: extension}));
    import_bytes("tiny.vrm", &tiny.glb(), &ImportOptions::default()).unwrap()
}

fn vrm_warnings(imported: &Imported) -> Vec<String> {
    let vrm = imported.warnings().iter().filter(|w| matches!(w, Warning::Vrm { .. }));
    vrm.map(ToString::to_string).collect()
}

fn near(a: Vec3, b: Vec3) -> bool {
    (0..3).all(|k| (a[k] - b[k]).abs() < 1e-5)
}

#[test]
fn a_chain_may_end_in_a_node_that_is_no_joint() {
    let imported = tiny(
        "VRMC_springBone",
        json!({
            "colliders": [
                {"node": 3, "shape": {"sphere": {"offset": [0, 0, 1], "radius": 0.25}}},
                {"node": 1, "shape": {"capsule": {"offset": [1, 0, 0], "tail": [0, 1, 0], "radius": 0.5}}},
            ],
            "colliderGroups": [{"colliders": [1, 0]}],
            "springs": [{
                "name": "tail",
                "center": 1,
                "joints": [{"node": 2, "stiffness": 2, "dragForce": 0.25, "hitRadius": 0.1}, {"node": 3}],
                "colliderGroups": [0, 0],
            }],
        }),
    );
    assert_eq!(vrm_warnings(&imported), [""; 0]);
    let rig = imported.rig().unwrap();
    let spring = &rig.springs().springs()[0];
    assert_eq!((spring.name.as_str(), &spring.groups[..], spring.center), ("tail", &[0][..], Some(JointId(0))));
    let [SpringJoint { joint: JointId(1), tail: Some(tail), swing }] = spring.joints[..] else {
        panic!("{:?}", spring.joints)
    };
    // The bind pose has no scale: what is below `tip` stands as its own transform says.
    let tip = rig.skeleton().head(JointId(1));
    assert!(near(tail, [tip[0], tip[1] + 0.5, tip[2]]), "{tail:?} {tip:?}");
    assert_eq!((swing.stiffness, swing.drag, swing.gravity_direction), (2.0, 0.25, [0.0, -1.0, 0.0]));
    let [end, hips] = rig.springs().colliders() else { panic!() };
    // The first hangs on the joint above its node.
    assert_eq!((end.joint, hips.joint), (JointId(1), JointId(0)));
    let Shape::Sphere { center, radius } = end.shape else { panic!() };
    assert!(near(center, [tail[0], tail[1], tail[2] + 1.0]) && (radius - 0.25).abs() < 1e-6, "{center:?}");
    let Shape::Capsule { from, to, radius } = hips.shape else { panic!() };
    let hips = rig.skeleton().head(JointId(0));
    assert!(near(from, [hips[0] + 1.0, hips[1], hips[2]]) && near(to, [hips[0], hips[1] + 1.0, hips[2]]));
    assert!((radius - 0.5).abs() < 1e-6);
}

#[test]
fn values_out_of_range_are_told_and_brought_into_it() {
    let joint = json!({"node": 1, "stiffness": -1, "dragForce": 7, "hitRadius": "wide", "gravityDir": [0, 0, 0]});
    let springs = json!([{"joints": [joint, {"node": 2}]}, {"joints": [{"node": 2}, {"node": 1}]}]);
    let imported = tiny("VRMC_springBone", json!({"springs": springs}));
    let text = vrm_warnings(&imported).concat();
    assert!(text.contains("stiffness of -1") && text.contains("drag of 7"), "{text}");
    let springs = imported.rig().unwrap().springs();
    let swing = springs.springs()[0].joints[0].swing;
    assert_eq!((swing.stiffness, swing.drag, swing.hit_radius), (0.0, 1.0, 0.0));
    assert_eq!(swing.gravity_direction, [0.0, -1.0, 0.0]);
    // The second goes up, and its joints are taken.
    assert_eq!(springs.springs().len(), 1);
}

#[test]
fn vrm_0_names_thumbs_otherwise_and_swings_its_leaves() {
    let imported = tiny(
        "VRM",
        json!({
            "humanoid": {"humanBones": [{"bone": "leftThumbProximal", "node": 1}, {"bone": "leftThumbIntermediate", "node": 2}]},
            "secondaryAnimation": {
                "boneGroups": [{
                    "comment": "both", "stiffiness": 3, "dragForce": 0.5, "hitRadius": 0.01, "center": -1,
                    "gravityPower": 1, "gravityDir": {"x": 0, "y": 0, "z": 2}, "bones": [1, 2], "colliderGroups": [0],
                }, {"bones": []}],
                "colliderGroups": [{"node": 1, "colliders": [{"offset": {"x": 1, "y": 2, "z": 3}, "radius": 1}]}],
            },
        }),
    );
    assert_eq!(vrm_warnings(&imported), [""; 0]);
    let rig = imported.rig().unwrap();
    let names: Vec<_> = rig.humanoid().iter().map(|(bone, joint)| (bone.name(), joint.0)).collect();
    assert_eq!(names, [("leftThumbMetacarpal", 0), ("leftThumbProximal", 1)]);
    let [spring] = rig.springs().springs() else { panic!() };
    let [hips, tip] = spring.joints[..] else { panic!() };
    let heads = rig.skeleton().heads();
    assert_eq!(hips.tail, Some(heads[1]));
    // Its first child, though it is no joint.
    assert!(near(tip.tail.unwrap(), [heads[1][0], heads[1][1] + 0.5, heads[1][2]]));
    assert_eq!((tip.swing.stiffness, tip.swing.gravity_direction), (3.0, [0.0, 0.0, -1.0]));
    let Shape::Sphere { center, .. } = rig.springs().colliders()[0].shape else { panic!() };
    assert!(near(center, [heads[0][0] + 1.0, heads[0][1] + 2.0, heads[0][2] - 3.0]));
}

/// What the joints of both have in common: VRM 1.0 has no swing of leaves, and looks the other way.
fn swings_alike(zero: &Rig, one: &Rig) {
    let (a, b) = (zero.springs().by_joint(zero.skeleton().len()), one.springs().by_joint(one.skeleton().len()));
    let mut compared = 0;
    for joint in one.skeleton().ids() {
        let Some(b) = b[joint.index()] else { continue };
        let a = a[joint.index()].expect("swings in both");
        assert_eq!(a.swing, b.swing);
        assert!(near(turned(a.tail.unwrap()), b.tail.unwrap()), "{a:?} {b:?}");
        compared += 1;
    }
    assert!(compared > 0);
    for (a, b) in zero.springs().colliders().iter().zip(one.springs().colliders()) {
        let (Shape::Sphere { center: p, radius: r }, Shape::Sphere { center: q, radius: s }) = (a.shape, b.shape)
        else {
            panic!("spheres in both")
        };
        assert!(near(turned(p), q) && (r - s).abs() < 1e-6 && a.joint == b.joint, "{a:?} {b:?}");
    }
    assert_eq!(zero.springs().colliders().len(), one.springs().colliders().len());
    assert_eq!(zero.humanoid(), one.humanoid());
}

/// By half a turn about y.
fn turned([x, y, z]: Vec3) -> Vec3 {
    [-x, y, -z]
}

#[test]
fn both_versions_of_a_model_tell_the_same() {
    let Some(folder) = data("RIGLAB_RIGS_ORIGINAL", "rigs_original") else { return };
    let [zero, one] = ["godette_vrm0.vrm", "godette_vrm1_derived.vrm"].map(|name| folder.join(name));
    if !(zero.is_file() && one.is_file()) {
        println!("skipped: no godette_vrm0.vrm and godette_vrm1_derived.vrm in {}", folder.display());
        return;
    }
    let [zero, one] = [zero, one].map(|path| import(path, &ImportOptions::default()).unwrap());
    swings_alike(zero.rig().unwrap(), one.rig().unwrap());
}

#[test]
fn real_files_have_bodies_and_nothing_broken() {
    let Some(folder) = data("RIGLAB_RIGS_ORIGINAL", "rigs_original") else { return };
    let mut bodies = 0;
    for path in files(&folder, &["vrm"]) {
        let Ok(imported) = import(&path, &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        bodies += usize::from(!rig.humanoid().is_empty() || !rig.springs().is_empty());
        println!("{}: {} human bones, {:?}", path.display(), rig.humanoid().len(), vrm_warnings(&imported));
        println!("  {} springs, {} colliders", rig.springs().springs().len(), rig.springs().colliders().len());
    }
    assert!(bodies > 0);
}
