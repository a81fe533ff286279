//! Creatures survive being written and read, and other tools read them.
//!
//! The tests with other tools are skipped unless they are told where those are:
//! `RIGLAB_GLTF_VALIDATOR`, a folder where `npm install gltf-validator` was run, and `RIGLAB_BPY`, a
//! Python that has `bpy`. `cargo test --release -p riglab-synth --test files`

use std::path::{Path, PathBuf};
use std::process::Command;

use riglab_asset::{ImportOptions, import_bytes, to_glb};
use riglab_synth::{Options, Plan, creature};

#[test]
fn what_is_written_is_read_back() {
    for plan in Plan::ALL {
        for index in 0..2 {
            let asset = creature(11, index, &Options { plans: vec![plan], triangles: 1_000..=3_000 });
            let name = &asset.name;
            let read = import_bytes("a.glb", &to_glb(&asset), &ImportOptions::default()).expect("it is a rig");
            let (ours, theirs) = (&asset.rig, read.rig().expect("it has a skeleton"));
            assert_eq!(ours.mesh().triangles().len(), theirs.mesh().triangles().len(), "{name}");
            let map: Vec<_> = (ours.skeleton().ids())
                .map(|joint| {
                    let same = |&other: &_| theirs.skeleton().name(other) == ours.skeleton().name(joint);
                    theirs.skeleton().ids().find(same).unwrap_or_else(|| panic!("{name} lost a joint"))
                })
                .collect();
            assert_eq!(ours.skeleton().len(), theirs.skeleton().len(), "{name}");
            for (joint, &other) in ours.skeleton().ids().zip(&map) {
                let (a, b) = (ours.skeleton().head(joint), theirs.skeleton().head(other));
                let near = 1e-5 * ours.bounds().diagonal();
                assert!((0..3).all(|k| (a[k] - b[k]).abs() < near), "{name}: a joint moved");
                let parents = [ours.skeleton().parent(joint).map(|p| map[p.index()]), theirs.skeleton().parent(other)];
                assert_eq!(parents[0], parents[1], "{name}");
            }
            assert_eq!(ours.humanoid().len(), theirs.humanoid().len(), "{name}");
            let swings = |rig: &riglab_core::Rig| rig.springs().by_joint(rig.skeleton().len()).iter().flatten().count();
            assert_eq!(swings(ours), swings(theirs), "{name}: springs");
            assert_eq!(ours.springs().colliders().len(), theirs.springs().colliders().len(), "{name}");
        }
    }
}

/// Fifty creatures in a folder.
fn fifty() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for index in 0..50 {
        let asset = creature(12, index, &Options::default());
        std::fs::write(folder.path().join(format!("{}.glb", asset.name)), to_glb(&asset)).unwrap();
    }
    folder
}

fn beside(script: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests").join(script)
}

#[test]
fn the_khronos_validator_finds_no_error() {
    let Some(validator) = std::env::var_os("RIGLAB_GLTF_VALIDATOR") else {
        return println!("skipped: set RIGLAB_GLTF_VALIDATOR to a folder where `npm install gltf-validator` was run");
    };
    let folder = fifty();
    let output = Command::new("node").arg(beside("files.mjs")).arg(validator).arg(folder.path()).output();
    let output = output.expect("node runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn blender_opens_them() {
    let Some(python) = std::env::var_os("RIGLAB_BPY") else {
        return println!("skipped: set RIGLAB_BPY to a Python that has `bpy`");
    };
    let folder = fifty();
    let output = Command::new(python).arg(beside("files.py")).arg(folder.path()).output().expect("Python runs");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("OPENED"), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!said.contains("FAULT"), "{said}");
}
