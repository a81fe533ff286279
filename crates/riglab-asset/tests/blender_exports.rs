//! What is written back unchanged as Blender reads it: the bones, weights, vertices and materials of the source.
//!
//! Needs a Python with bpy: `RIGLAB_BPY=PYTHON cargo test --release -p riglab-asset --test blender_exports`.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use riglab_asset::export::{self, ExportOptions, Influences};
use riglab_asset::{ImportOptions, import};

/// Of the rigs; the originals are all asked.
const RIGS: usize = 50;

#[test]
fn blender_reads_exports_as_it_reads_their_sources() {
    let Some(python) = std::env::var_os("RIGLAB_BPY") else {
        println!("skipped: set RIGLAB_BPY to a Python that has bpy");
        return;
    };
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let rigs = common::files(&folder, &["glb", "vrm"]);
    let mut files: Vec<PathBuf> = rigs.iter().step_by((rigs.len() / RIGS).max(1)).take(RIGS).cloned().collect();
    if let Some(folder) = common::data("RIGLAB_RIGS_ORIGINAL", "rigs_original") {
        files.extend(common::files(&folder, &["glb", "vrm"]));
    }
    let temp = tempfile::tempdir().unwrap();
    let mut written = 0;
    for file in &files {
        let name = file.file_stem().unwrap().to_string_lossy();
        // Some are there to be refused.
        if name.starts_with("malformed_") {
            continue;
        }
        let imported = import(file, &ImportOptions::default()).unwrap();
        let rig = imported.rig().unwrap_or_else(|| panic!("{name} has no rig"));
        let options = ExportOptions { influences: Influences::All, ..ExportOptions::default() };
        let exported = export::onto(file, &imported, rig, &options).unwrap();
        std::fs::copy(file, temp.path().join(format!("{written}_{name}.before.glb"))).unwrap();
        std::fs::write(temp.path().join(format!("{written}_{name}.after.glb")), exported.bytes).unwrap();
        written += 1;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/compare_exports.py");
    let output = Command::new(&python).arg(&script).arg(temp.path()).output().expect("Python runs");
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{}", said.lines().filter(|line| line.starts_with("EXPORTS")).collect::<String>());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
