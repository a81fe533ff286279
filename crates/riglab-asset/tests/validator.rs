//! What is written against Khronos' validator: no error that the source does not have.
//!
//! Needs Node and `gltf-validator`: `npm install --prefix FOLDER gltf-validator`, then
//! `RIGLAB_GLTF_VALIDATOR=FOLDER cargo test --release -p riglab-asset --test validator`.

mod common;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use riglab_asset::export::{self, ExportOptions, Exported, Influences, JointFrames};
use riglab_asset::rigging::{NameStyle, Subject, SubjectOptions, name_joints};
use riglab_asset::{ImportOptions, import};
use riglab_core::{Bounds, Rig, SkinWeights};

/// The model and its bare mesh as OBJ, rigged anew, with the motion that shows it.
fn rigged(folder: &Path, file: &Path, rig: &Rig) -> Vec<Exported> {
    let obj = folder.join("mesh.obj");
    let mut text = String::from("v 0 0 0\nvt 0 0\n");
    for [x, y, z] in rig.mesh().positions() {
        writeln!(text, "v {x} {y} {z}").unwrap();
    }
    for [a, b, c] in rig.mesh().triangles().iter().map(|t| t.map(|v| v + 2)) {
        writeln!(text, "f {a}/1 {b}/1 {c}/1").unwrap();
    }
    std::fs::write(&obj, text).unwrap();
    let of = |path: &Path| {
        let subject = Subject::read(path, &SubjectOptions::default()).unwrap();
        let bounds = Bounds::of(subject.mesh().positions().iter().copied());
        let (skeleton, humanoid) = name_joints(rig.skeleton(), bounds, NameStyle::Mixamo).unwrap();
        let joints = skeleton.len();
        let rows = (0..subject.mesh().positions().len()).map(|v| (0..5).map(move |k| (((v + k) % joints) as u16, 0.2)));
        let weights = SkinWeights::normalized(rows).unwrap();
        let rig = subject.rigged(skeleton, weights).unwrap().with_humanoid(humanoid).unwrap();
        let frames = ExportOptions { frames: JointFrames::AlongBone, ..ExportOptions::default() };
        export::preview(&subject.attach(&rig, &frames).unwrap().bytes).unwrap()
    };
    vec![of(file), of(&obj)]
}

#[test]
fn exports_have_no_errors_that_their_sources_do_not_have() {
    let Some(validator) = std::env::var_os("RIGLAB_GLTF_VALIDATOR") else {
        println!("skipped: set RIGLAB_GLTF_VALIDATOR to a folder where `npm install gltf-validator` was run");
        return;
    };
    let mut files: Vec<PathBuf> = Vec::new();
    if let Some(folder) = common::data("RIGLAB_RIGS_ORIGINAL", "rigs_original") {
        files.extend(common::files(&folder, &["glb", "gltf", "vrm"]));
    }
    if let Some(folder) = common::data("RIGLAB_RIGS", "rigs") {
        files.extend(common::files(&folder, &["glb", "gltf", "vrm"]).into_iter().step_by(5));
    }
    let temp = tempfile::tempdir().unwrap();
    let mut pairs = String::new();
    for (number, file) in files.iter().enumerate() {
        // Some are there to be refused.
        let Ok(imported) = import(file, &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        let all = ExportOptions { influences: Influences::All, frames: JointFrames::Parallel };
        let four = ExportOptions { influences: Influences::Four, frames: JointFrames::AlongBone };
        let written = [
            export::onto(file, &imported, rig, &all),
            export::onto(file, &imported, rig, &four),
            export::onto(file, &imported, &common::renamed(rig), &four),
            export::onto(file, &imported, &common::reborn(rig), &four),
            export::alone("alone", rig, &imported.provenance, &four),
            export::strip(file, &ImportOptions::default()),
        ];
        let clip = common::dance(rig, 9, 30.0);
        // Weights that compression rounded are mended by `onto` alone.
        let bytes = export::onto(file, &imported, rig, &all).unwrap().bytes;
        let again = riglab_asset::import_bytes("again.glb", &bytes, &ImportOptions::default()).unwrap();
        let moved = export::animate(&bytes, None, &again, rig.skeleton(), &clip);
        let written = written.into_iter().chain([moved]).map(Result::unwrap);
        let written = written.chain(rigged(temp.path(), file, rig));
        for (way, exported) in written.enumerate() {
            let path = temp.path().join(format!("{number}_{way}.glb"));
            export::write(&path, &exported.bytes).unwrap();
            writeln!(pairs, "{}\t{}", file.display(), path.display()).unwrap();
        }
    }
    let list = temp.path().join("pairs.txt");
    std::fs::write(&list, &pairs).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/validator.mjs");
    let output = Command::new("node").arg(script).arg(validator).arg(list).output().expect("node runs");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.is_empty(), "{said}");
    println!("{} files as good as their sources", pairs.lines().count());
}
