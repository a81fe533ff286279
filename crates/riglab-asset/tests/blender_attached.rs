//! What is attached as Blender reads it: bones, weights, and a mesh that follows them.
//!
//! Needs a Python with bpy: `RIGLAB_BPY=PYTHON cargo test --release -p riglab-asset --test blender_attached`.

mod common;

use std::collections::HashMap;
use std::path::Path;
use std::process::Command;

use riglab_asset::export::{self, ExportOptions, Influences, JointFrames};
use riglab_asset::rigging::{NameStyle, Subject, SubjectOptions, name_joints};
use riglab_asset::{ImportOptions, import};
use riglab_core::{Bounds, Rig, SkinWeights};
use serde_json::json;

#[test]
fn blender_reads_what_was_attached_and_bends_it() {
    let Some(python) = std::env::var_os("RIGLAB_BPY") else {
        println!("skipped: set RIGLAB_BPY to a Python that has bpy");
        return;
    };
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let mut files: Vec<_> = common::files(&folder, &["glb"]).into_iter().step_by(20).collect();
    if let Some(folder) = common::data("RIGLAB_RIGS_ORIGINAL", "rigs_original") {
        files.extend(common::files(&folder, &["glb", "vrm"]).into_iter().step_by(3));
    }
    let temp = tempfile::tempdir().unwrap();
    for (number, file) in files.iter().enumerate() {
        // Some are there to be refused.
        let Ok(imported) = import(file, &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        write(&temp.path().join(format!("{number}")), file, rig, number % 2 == 0);
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/read_attached.py");
    let run = |folder: &Path| Command::new(&python).arg(&script).arg(folder).output().expect("Python runs");
    let output = run(temp.path());
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{}", said.lines().filter(|line| line.starts_with("ATTACHED")).collect::<String>());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    // And another rig is noticed.
    let wrong = tempfile::tempdir().unwrap();
    let first = |ending: &str| Path::new("0").with_extension(ending);
    std::fs::copy(temp.path().join(first("glb")), wrong.path().join(first("glb"))).unwrap();
    let mut told: serde_json::Value =
        serde_json::from_slice(&std::fs::read(temp.path().join(first("json"))).unwrap()).unwrap();
    let last = told["joints"].as_array().unwrap().len() - 1;
    told["joints"][last]["head"] = json!([told["size"], 0.0, 0.0]);
    for row in told["vertices"].as_array_mut().unwrap().iter_mut() {
        row["weights"] = json!([["no joint", 1.0]]);
    }
    std::fs::write(wrong.path().join(first("json")), told.to_string()).unwrap();
    let output = run(wrong.path());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("off by") && said.contains("weights of"), "{said}");
}

/// The file with its true rig under other names, and beside it what that rig is.
fn write(to: &Path, file: &Path, rig: &Rig, along: bool) {
    let subject = Subject::read(file, &SubjectOptions::default()).unwrap();
    let key = |p: &[f32; 3]| p.map(|x| (x + 0.0).to_bits());
    let at: HashMap<_, _> = rig.mesh().positions().iter().enumerate().map(|(v, p)| (key(p), v)).collect();
    let rows = subject.mesh().positions().iter().map(|p| match at.get(&key(p)) {
        Some(&v) => rig.weights().row(v).map(|(j, w)| (j.0, f64::from(w))).collect(),
        None => vec![(0, 1.0)],
    });
    let weights = SkinWeights::normalized(rows).unwrap();
    let bounds = Bounds::of(subject.mesh().positions().iter().copied());
    let style = if along { NameStyle::Mixamo } else { NameStyle::Vrm };
    let (skeleton, _) = name_joints(rig.skeleton(), bounds, style).unwrap();
    let rig = subject.rigged(skeleton, weights).unwrap();
    let frames = if along { JointFrames::AlongBone } else { JointFrames::Parallel };
    let exported = subject.attach(&rig, &ExportOptions { influences: Influences::All, frames }).unwrap();
    let moving = export::preview(&exported.bytes).unwrap();
    std::fs::write(to.with_extension("glb"), moving.bytes).unwrap();
    let skeleton = rig.skeleton();
    let joint = |joint| {
        let parent = skeleton.parent(joint).map(|p| skeleton.name(p));
        json!({"name": skeleton.name(joint), "parent": parent, "head": skeleton.head(joint)})
    };
    let vertex = |(v, at): (usize, &[f32; 3])| {
        let weights: Vec<_> = rig.weights().row(v).map(|(j, w)| json!([skeleton.name(j), w])).collect();
        json!({"at": at, "weights": weights})
    };
    let told = json!({
        "source": file.file_name().unwrap().to_string_lossy(),
        "size": rig.bounds().diagonal(),
        "joints": skeleton.ids().map(joint).collect::<Vec<_>>(),
        "vertices": rig.mesh().positions().iter().enumerate().map(vertex).collect::<Vec<_>>(),
    });
    std::fs::write(to.with_extension("json"), told.to_string()).unwrap();
}
