//! Every file of the folder of hard cases ends as its manifest says.
//!
//! Left out, because they belong to parts that are not written yet: the broken references of VRM
//! humanoids and springs (those files must import with their geometry right, but are not yet asked for
//! their warnings). FBX may be refused by the manifest; it is read where the crate is built with the feature.

mod common;
#[path = "common/peak.rs"]
mod peak;

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::time::{Duration, Instant};

use riglab_asset::{Content, ImportError, ImportOptions, Imported, import};
use riglab_core::{Rig, Vec3};
use serde::Deserialize;

#[derive(Deserialize)]
struct Case {
    file: String,
    what: String,
    expect: String,
    reason_contains: Option<String>,
    expect_warning: Option<String>,
    joints: Option<usize>,
    vertices: Option<usize>,
    triangles: Option<usize>,
    humanoid: Option<usize>,
    springs: Option<usize>,
    spring_joints: Option<usize>,
    colliders: Option<usize>,
    same_as: Option<String>,
    same_tol: Option<f32>,
    #[serde(default)]
    optional: bool,
}

/// Times in a debug build on a busy machine are several times those of a release build.
const LIMIT: Duration = Duration::from_secs(2);

/// Bytes that a file may take.
const MEMORY: usize = 200 << 20;

#[test]
fn every_hard_file_ends_as_its_manifest_says() {
    let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") else { return };
    let manifest = std::fs::read(folder.join("manifest.json")).unwrap();
    let cases: Vec<Case> = serde_json::from_slice(&manifest).unwrap();
    let (mut wrong, mut checked) = (Vec::new(), 0);
    for case in &cases {
        checked += 1;
        let start = Instant::now();
        let (result, peak) = peak::of(|| import(folder.join(&case.file), &ImportOptions::default()));
        let mut faults = check(case, &result, &folder);
        if start.elapsed() > LIMIT {
            faults.push(format!("took {:?}", start.elapsed()));
        }
        if peak.total > MEMORY {
            faults.push(format!("took {peak:?}"));
        }
        wrong.extend(faults.into_iter().map(|fault| format!("{}: {fault}", case.file)));
    }
    assert!(wrong.is_empty(), "{} of {checked} files:\n{}", wrong.len(), wrong.join("\n"));
    println!("{checked} of {} files as the manifest says", cases.len());
}

fn check(case: &Case, result: &Result<Imported, ImportError>, folder: &Path) -> Vec<String> {
    let mut faults = Vec::new();
    let imported = match (case.expect.as_str(), result) {
        // Sound files that may be refused, or be read; quantised positions may have their own origin.
        ("reject", Ok(imported)) if case.optional => {
            let word = case.what.split(' ').find(|word| word.starts_with("ok_")).expect("says what it was made of");
            let other = import(folder.join(word), &ImportOptions::default()).unwrap();
            let [a, b] = [imported, &other].map(|i| i.rig().unwrap().skeleton().heads()[0]);
            let shift = std::array::from_fn(|k| b[k] - a[k]);
            return differences(imported.rig().unwrap(), other.rig().unwrap(), shift, 1e-3, 0.01);
        }
        ("reject", Ok(_)) => return vec!["imported, should be refused".into()],
        ("reject", Err(error)) => {
            let text = error.to_string();
            if !has_any(&text, case.reason_contains.as_deref().unwrap_or_default()) || !text.contains(&case.file) {
                faults.push(format!("refused with `{text}`"));
            }
            return faults;
        }
        (_, Err(error)) => return vec![format!("refused: {error}")],
        (_, Ok(imported)) => imported,
    };
    let warnings: Vec<String> = imported.warnings().iter().map(ToString::to_string).collect();
    match &case.expect_warning {
        Some(words) if warnings.iter().any(|w| has_any(w, words)) => {}
        Some(words) => faults.push(format!("no warning with {words}: {warnings:?}")),
        None if warnings.is_empty() => {}
        None => faults.push(format!("warnings: {warnings:?}")),
    }
    let shown = imported.inspect(false);
    for (what, found, wanted) in [
        ("joints", shown.joints.len(), case.joints),
        ("vertices", shown.file_vertices + shown.rigid_vertices, case.vertices),
        ("triangles", shown.file_triangles + shown.rigid_triangles, case.triangles),
        ("human bones", shown.humanoid.len(), case.humanoid),
        ("springs", shown.springs.springs().len(), case.springs),
        ("joints in springs", shown.springs.springs().iter().map(|s| s.joints.len()).sum(), case.spring_joints),
        ("colliders", shown.springs.colliders().len(), case.colliders),
    ] {
        if wanted.is_some_and(|wanted| wanted != found) {
            faults.push(format!("{found} {what} instead of {wanted:?}"));
        }
    }
    if let Some(other) = &case.same_as {
        let other = import(folder.join(other), &ImportOptions::default()).unwrap();
        let tolerance = case.same_tol.unwrap_or(1e-4);
        faults.extend(differences(imported.rig().unwrap(), other.rig().unwrap(), [0.0; 3], 1e-4, tolerance));
    }
    faults
}

/// Whether a text has one of some words parted by bars, upper or lower case.
fn has_any(text: &str, words: &str) -> bool {
    let text = text.to_lowercase();
    words.to_lowercase().split('|').any(|word| text.contains(word))
}

/// In what one rig differs from another: joints by name, the surface as triangles between the
/// vertices of the other, weights at those. The first is moved by `shift` before. `near` is a share of the diagonal.
fn differences(a: &Rig, b: &Rig, shift: Vec3, near: f32, weight_tolerance: f32) -> Vec<String> {
    let moved = |p: Vec3| -> Vec3 { std::array::from_fn(|k| p[k] + shift[k]) };
    let mut faults = Vec::new();
    let near = b.bounds().diagonal() * near;
    let (sa, sb) = (a.skeleton(), b.skeleton());
    let joint_b: HashMap<&str, _> = sb.ids().map(|j| (sb.name(j), j)).collect();
    for j in sa.ids() {
        let Some(&k) = joint_b.get(sa.name(j)) else {
            faults.push(format!("joint {} is not in the other", sa.name(j)));
            continue;
        };
        if distance(moved(sa.head(j)), sb.head(k)) > near {
            faults.push(format!("head of {} at {:?}, not {:?}", sa.name(j), sa.head(j), sb.head(k)));
        }
        if sa.parent(j).map(|p| sa.name(p)) != sb.parent(k).map(|p| sb.name(p)) {
            faults.push(format!("parent of {}", sa.name(j)));
        }
    }
    if sa.len() != sb.len() {
        faults.push(format!("{} joints, not {}", sa.len(), sb.len()));
    }
    let twin: Vec<u32> = a.mesh().positions().iter().map(|&p| nearest(b.mesh().positions(), moved(p))).collect();
    for (v, &w) in twin.iter().enumerate() {
        if distance(moved(a.mesh().positions()[v]), b.mesh().positions()[w as usize]) > near {
            faults.push(format!("vertex {v} lies on none of the other's"));
        }
        let of = |rig: &Rig, v: usize| -> HashMap<String, f32> {
            rig.weights().row(v).map(|(j, w)| (rig.skeleton().name(j).to_owned(), w)).collect()
        };
        let (ours, theirs) = (of(a, v), of(b, w as usize));
        let names: HashSet<&String> = ours.keys().chain(theirs.keys()).collect();
        let at = |row: &HashMap<String, f32>, name: &String| row.get(name).copied().unwrap_or(0.0);
        if names.iter().any(|name| (at(&ours, name) - at(&theirs, name)).abs() > weight_tolerance) {
            faults.push(format!("weights of vertex {v}: {ours:?}, not {theirs:?}"));
        }
    }
    // Either way round: the strips of one file face inwards.
    let sorted = |mut t: [u32; 3]| {
        t.sort_unstable();
        t
    };
    let mut ours: Vec<_> = a.mesh().triangles().iter().map(|t| sorted(t.map(|v| twin[v as usize]))).collect();
    let mut theirs: Vec<_> = b.mesh().triangles().iter().map(|t| sorted(*t)).collect();
    ours.sort_unstable();
    theirs.sort_unstable();
    if ours != theirs {
        faults.push("the triangles differ".into());
    }
    faults
}

fn nearest(points: &[Vec3], p: Vec3) -> u32 {
    let by_distance = |a: &u32, b: &u32| distance(points[*a as usize], p).total_cmp(&distance(points[*b as usize], p));
    (0..points.len() as u32).min_by(by_distance).unwrap()
}

fn distance(a: Vec3, b: Vec3) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
}

/// The vertices' weights by joint name, as the notes of the manifest give them.
#[test]
fn repaired_weights_are_those_of_the_notes() {
    let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") else { return };
    let row = |file: &str, vertex: usize| -> Vec<(String, f32)> {
        let imported = import(folder.join(file), &ImportOptions::default()).unwrap();
        let rig = imported.rig().unwrap();
        rig.weights().row(vertex).map(|(j, w)| (rig.skeleton().name(j).to_owned(), w)).collect()
    };
    let of = |pairs: &[(&str, f32)]| pairs.iter().map(|(n, w)| ((*n).to_owned(), *w)).collect::<Vec<_>>();
    assert_eq!(row("repair_joint_repeated_in_vertex.glb", 30), of(&[("bone1", 1.0)]));
    assert_eq!(row("repair_joint_repeated_in_vertex.glb", 31), of(&[("bone1", 0.25), ("bone2", 0.75)]));
    assert_eq!(row("repair_zero_weights.glb", 105), of(&[("bone3", 1.0)]));
}

/// Where a file without skin stands, its node transform decides.
#[test]
fn a_bare_mesh_is_placed_by_its_node() {
    let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") else { return };
    let imported = import(folder.join("warn_no_skin.glb"), &ImportOptions::default()).unwrap();
    let Content::Bare(mesh) = &imported.content else { panic!("has a rig") };
    let bounds = riglab_core::Bounds::of(mesh.positions().iter().copied()).unwrap();
    // The tube of height 2 has caps.
    assert!(distance(bounds.center(), [1.0, 3.0, 3.0]) < 0.05, "{bounds:?}");
    assert!((bounds.size()[1] - 2.0).abs() < 0.2, "{bounds:?}");
}
