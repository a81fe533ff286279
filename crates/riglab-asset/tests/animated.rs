//! Motions written as animations: what is read again is what was written.

mod common;

use common::{Tiny, dance, data, files};
use riglab_asset::export::{ExportFault, ExportNote, ExportOptions, animate, moving};
use riglab_asset::{ImportOptions, Imported, Resample, import, import_bytes};
use riglab_core::{Asset, Clip, Provenance, Rig};
use serde_json::{Value, json};

const RATE: f32 = 20.0;

fn reading() -> ImportOptions {
    ImportOptions { clips: Some(Resample { rate: RATE, ..Resample::default() }), ..ImportOptions::default() }
}

/// How far maps of the first clip read are from those written, in sizes of the rig.
fn off(read: &Imported, rig: &Rig, clip: &Clip) -> f32 {
    let found = &read.clips[0];
    assert_eq!((found.name(), found.frames(), found.joints()), (clip.name(), clip.frames(), clip.joints()));
    assert_eq!(read.rig().unwrap(), rig);
    let size = rig.bounds().diagonal();
    let apart = |frame: usize| {
        let pairs = found.frame(frame).into_iter().zip(clip.frame(frame)).zip(rig.skeleton().heads());
        let ends = pairs.flat_map(|((a, b), head)| {
            let head = glam::Vec3::from(*head);
            [head, head + size * glam::Vec3::X, head + size * glam::Vec3::Y]
                .map(|p| (a.transform_point3(p) - b.transform_point3(p)).length())
        });
        ends.fold(0.0, f32::max) / size
    };
    (0..clip.frames()).map(apart).fold(0.0, f32::max)
}

#[test]
fn motions_of_real_rigs_come_back() {
    let Some(folder) = data("RIGLAB_RIGS", "rigs") else { return };
    let mut checked = 0;
    for file in files(&folder, &["glb", "gltf", "vrm"]).into_iter().step_by(7) {
        let imported = import(&file, &reading()).unwrap();
        let Some(rig) = imported.rig() else { continue };
        let clip = dance(rig, 6, RATE);
        let bytes = std::fs::read(&file).unwrap();
        let out = animate(&bytes, file.parent(), &imported, rig.skeleton(), &clip).unwrap();
        let again = import_bytes("again.glb", &out.bytes, &reading()).unwrap();
        let off = off(&again, rig, &clip);
        // Uneven scales, rounding of scales included, shear what turns below them.
        let limit = 3e-4 + 20.0 * uneven(&document(&out.bytes));
        assert!(off < limit, "{}: {off}, and {limit} is allowed", file.display());
        // Those without a name are called by their number, which is one more.
        let others = again.clips[1..].iter().map(Clip::maps);
        assert!(others.eq(imported.clips.iter().map(Clip::maps)), "{}", file.display());
        assert!(out == animate(&bytes, file.parent(), &imported, rig.skeleton(), &clip).unwrap());
        checked += 1;
    }
    assert!(checked > 10);
}

/// The tiny rig, whose parts the tests change.
fn tiny(change: impl FnOnce(Tiny) -> Tiny) -> (Vec<u8>, Imported) {
    let bytes = change(Tiny::new()).glb();
    let imported = import_bytes("tiny.glb", &bytes, &reading()).unwrap();
    (bytes, imported)
}

fn document(glb: &[u8]) -> Value {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&glb[20..20 + length]).unwrap()
}

/// By which share scales of a node differ most.
fn uneven(document: &Value) -> f32 {
    let scales = document["nodes"].as_array().unwrap().iter().filter_map(|n| n["scale"].as_array());
    let of = |scale: &Vec<Value>| {
        let all = scale.iter().map(|s| s.as_f64().unwrap().abs() as f32);
        all.clone().fold(0.0, f32::max) / all.fold(f32::MAX, f32::min) - 1.0
    };
    scales.map(of).fold(0.0, f32::max)
}

#[test]
fn nodes_with_matrices_and_poses_are_moved_too() {
    let matrix = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 1]);
    let (bytes, imported) = tiny(|t| t.with("/nodes/2", json!({"name": "tip", "matrix": matrix})));
    let rig = imported.rig().unwrap();
    let clip = dance(rig, 5, RATE);
    let out = animate(&bytes, None, &imported, rig.skeleton(), &clip).unwrap();
    assert!(off(&import_bytes("again.glb", &out.bytes, &reading()).unwrap(), rig, &clip) < 1e-5);
    let nodes = &document(&out.bytes)["nodes"];
    assert!(nodes[2].get("matrix").is_none() && nodes[2]["translation"] == json!([0.0, 1.0, 0.0]), "{nodes}");
}

#[test]
fn an_asset_keeps_its_motions_in_their_order() {
    let (_, imported) = tiny(|t| t);
    let rig = imported.rig().unwrap().clone();
    let (first, second) = (dance(&rig, 5, RATE), dance(&rig, 9, RATE));
    let second = Clip::new("second".into(), RATE, second.joints(), second.maps().to_vec()).unwrap();
    let (clips, provenance) = (vec![first.clone(), second], Provenance::default());
    let asset = Asset { name: "a".into(), rig: rig.clone(), clips, provenance };
    let out = moving(&asset, &ExportOptions::default()).unwrap();
    let read = import_bytes("a.glb", &out.bytes, &reading()).unwrap();
    assert!(off(&read, &rig, &first) < 1e-5);
    assert_eq!((read.clips.len(), read.clips[1].name(), read.clips[1].frames()), (2, "second", 9));
}

#[test]
fn joints_that_vanish_with_what_they_hang_on_are_told() {
    let (_, imported) = tiny(|t| t);
    let rig = imported.rig().unwrap().clone();
    let still = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
    let told_of = |motions: &[&str], [hips, tip]: [[[f32; 3]; 4]; 2]| {
        let clip = |name: &&str| Clip::new((*name).into(), RATE, 2, vec![still, still, hips, tip]).unwrap();
        let clips = motions.iter().map(clip).collect();
        let asset = Asset { name: "a".into(), rig: rig.clone(), clips, provenance: Provenance::default() };
        moving(&asset, &ExportOptions::default()).unwrap().notes
    };
    let told = |maps| told_of(&["burst"], maps);
    let note = ExportNote::MotionSwallowed { motion: "burst".into(), joints: 1, others: 0 };
    let words = "motion `burst` scales joints to 0: 1 joint on them vanishes, too, but is seen in the source";
    assert_eq!(note.to_string(), words);
    assert_eq!(told([[[0.0; 3]; 4], still]), [note]);
    // Of many motions in one line.
    let all = told_of(&["burst", "blast", "bang"], [[[0.0; 3]; 4], still]);
    let words =
        "3 motions scale joints to 0, `burst` the most: 1 joint on them vanishes, too, but is seen in the source";
    assert_eq!(all.iter().map(ToString::to_string).collect::<Vec<_>>(), [words]);
    // What is nothing itself loses nothing.
    assert_eq!([told([[[0.0; 3]; 4]; 2]), told([still, [[0.0; 3]; 4]])], [[], []]);
}

#[test]
fn a_rig_that_stands_still_has_one_channel() {
    let (bytes, imported) = tiny(|t| t);
    let rig = imported.rig().unwrap();
    let rest = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
    let clip = Clip::new("still".into(), RATE, 2, vec![rest; 2]).unwrap();
    let out = animate(&bytes, None, &imported, rig.skeleton(), &clip).unwrap();
    let animation = &document(&out.bytes)["animations"][0];
    assert_eq!(animation["channels"].as_array().unwrap().len(), 1, "{animation}");
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let (bytes, imported) = tiny(|t| t);
    let rig = imported.rig().unwrap();
    let (names, parents, heads) = rig.skeleton().clone().into_parts();
    let joint =
        |((name, parent), head): ((String, _), _)| riglab_core::Joint { name: format!("{name}2"), parent, head };
    let other = names.into_iter().zip(parents).zip(heads).map(joint).collect();
    let other = riglab_core::Skeleton::new(other).unwrap();
    let clip = dance(rig, 2, RATE);
    let fault = |e: Result<_, riglab_asset::export::ExportError>| {
        e.map(|_: riglab_asset::export::Exported| ()).unwrap_err().fault
    };
    assert!(matches!(fault(animate(&bytes, None, &imported, &other, &clip)), ExportFault::OtherMotion(_)));
    let rest = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
    let short = Clip::new("c".into(), RATE, 1, vec![rest]).unwrap();
    assert!(matches!(fault(animate(&bytes, None, &imported, rig.skeleton(), &short)), ExportFault::OtherMotion(_)));
    assert_eq!(fault(animate(&bytes[1..], None, &imported, rig.skeleton(), &clip)), ExportFault::OtherSource);
}
