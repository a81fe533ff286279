//! Motions of skinned files.

mod common;

use common::{Tiny, data, files};
use riglab_asset::{ImportOptions, Imported, Resample, import, import_bytes};
use riglab_core::{Bounds, Vec3, skin};
use serde_json::{Value, json};

fn options(rate: f32) -> ImportOptions {
    ImportOptions { clips: Some(Resample { rate, ..Resample::default() }), ..ImportOptions::default() }
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// The tiny rig with an animation over accessors of times and values.
fn animated(times: &[f32], shape: &str, values: &[f32], channels: Value, samplers: Value) -> Tiny {
    let width = if shape == "VEC4" { 4 } else { 3 };
    Tiny::new()
        .with_accessor(5126, "SCALAR", times.len(), &floats(times))
        .with_accessor(5126, shape, values.len() / width, &floats(values))
        .with("/animations", json!([{"name": "wave", "channels": channels, "samplers": samplers}]))
}

fn read(tiny: &Tiny, rate: f32) -> Imported {
    import_bytes("tiny.glb", &tiny.glb(), &options(rate)).unwrap()
}

fn near(a: Vec3, b: Vec3) -> bool {
    (0..3).all(|k| (a[k] - b[k]).abs() < 1e-5)
}

#[test]
fn a_turned_joint_turns_its_vertices() {
    // `tip` turns from rest to 180 degrees about z within a second.
    let values = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    let channels = json!([
        {"sampler": 0, "target": {"node": 2, "path": "rotation"}},
        {"sampler": 0, "target": {"node": 0, "path": "weights"}},
    ]);
    let tiny = animated(&[2.0, 3.0], "VEC4", &values, channels, json!([{"input": 5, "output": 6}]));
    let imported = read(&tiny, 2.0);
    let rig = imported.rig().unwrap();
    let [clip] = &imported.clips[..] else { panic!("{:?}", imported.clips) };
    assert_eq!((clip.name(), clip.frames(), clip.joints(), clip.rate()), ("wave", 3, 2, 2.0));
    let poses: Vec<_> = (0..3).map(|f| skin(rig, &clip.frame(f)).unwrap()).collect();
    assert!(poses[0].iter().zip(rig.mesh().positions()).all(|(a, b)| near(*a, *b)));
    // (0, 2.5, 0) about (0, 2, 0): to the left, then down; the first vertex is held by `hips`.
    assert!(near(poses[1][2], [-0.5, 2.0, 0.0]) && near(poses[2][2], [0.0, 1.5, 0.0]), "{poses:?}");
    assert!(near(poses[2][0], rig.mesh().positions()[0]));
    // Without asking, nothing is read.
    assert!(import_bytes("tiny.glb", &tiny.glb(), &ImportOptions::default()).unwrap().clips.is_empty());
}

#[test]
fn joints_move_with_what_lies_above_them_from_any_pose() {
    // The file's nodes stand elsewhere than the bind pose; a node above the joints moves them back.
    let channels = json!([{"sampler": 0, "target": {"node": 3, "path": "translation"}}]);
    let tiny = animated(&[0.0], "VEC3", &[0.0, 5.0, 0.0], channels, json!([{"input": 5, "output": 6}]))
        .with("/nodes/-", json!({"name": "above", "children": [1]}))
        .with("/nodes/1/translation", json!([0, 3, 0]));
    let imported = read(&tiny, 30.0);
    let rig = imported.rig().unwrap();
    let posed = skin(rig, &imported.clips[0].frame(0)).unwrap();
    // In the bind pose `hips` is at (0, 1, 0), in the clip at (0, 8, 0), wherever the rest is placed.
    let file = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.5, 0.0], [0.0, 0.0, 1.0]];
    for (p, q) in posed.iter().zip(file) {
        assert!(near(*p, [q[0], q[1] + 7.0, q[2]]), "{p:?} {q:?}");
    }
}

#[test]
fn a_clip_that_cannot_be_read_is_left_out() {
    let channels =
        |node: usize, sampler: usize| json!([{"sampler": sampler, "target": {"node": node, "path": "scale"}}]);
    let sampler = json!([{"input": 5, "output": 6}]);
    for (times, values, channels, sampler, word) in [
        (vec![0.0, 1.0], vec![1.0; 3], channels(1, 0), sampler.clone(), "number of values"),
        (vec![1.0, 0.0], vec![1.0; 6], channels(1, 0), sampler.clone(), "do not rise"),
        (vec![0.0], vec![f32::NAN; 3], channels(1, 0), sampler.clone(), "not finite"),
        (vec![0.0], vec![1.0; 3], channels(7, 0), sampler.clone(), "node 7"),
        (vec![0.0], vec![1.0; 3], channels(1, 3), sampler.clone(), "no sampler"),
        (vec![0.0], vec![1.0; 3], channels(1, 0), json!([{"input": 5, "output": 99}]), "99"),
        (vec![0.0], vec![1.0; 3], channels(1, 0), json!([{"input": 5, "output": 6, "interpolation": "JUMP"}]), "JUMP"),
    ] {
        let imported = read(&animated(&times, "VEC3", &values, channels, sampler), 30.0);
        assert!(imported.clips.is_empty());
        let warnings: Vec<_> = imported.warnings().iter().map(ToString::to_string).collect();
        assert!(warnings.concat().contains(word), "{word}: {warnings:?}");
    }
}

#[test]
fn long_times_are_cut() {
    let channels = json!([{"sampler": 0, "target": {"node": 1, "path": "scale"}}]);
    let tiny = animated(&[0.0, 1e30], "VEC3", &[1.0; 6], channels, json!([{"input": 5, "output": 6}]));
    let imported = read(&tiny, 30.0);
    assert_eq!(imported.clips[0].frames(), Resample::default().frames);
    assert!(imported.warnings().iter().any(|w| w.to_string().contains("cut after 1024 frames: wave")));
}

#[test]
fn a_motion_that_is_asked_for_is_read_whatever_others_take() {
    let tiny = |name: &str| {
        let channels = json!([{"sampler": 0, "target": {"node": 1, "path": "translation"}}]);
        let values = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let tiny = animated(&[0.0, 600.0], "VEC3", &values, channels.clone(), json!([{"input": 5, "output": 6}]));
        let more = json!({"name": name, "channels": channels, "samplers": [{"input": 5, "output": 6}]});
        tiny.with("/animations/-", more.clone()).with("/animations/-", more)
    };
    let names = |motion: Option<&str>, rate: f32| {
        let clips = Some(Resample { rate, frames: usize::MAX });
        let options = ImportOptions { clips, motion: motion.map(str::to_owned), ..ImportOptions::default() };
        let read = import_bytes("tiny.glb", &tiny("last").glb(), &options).unwrap();
        let left = read.warnings().iter().any(|warning| warning.to_string().contains("longer than is read"));
        (read.clips.iter().map(|clip| clip.name().to_owned()).collect::<Vec<_>>(), left)
    };
    assert_eq!(names(None, 1000.0), (vec!["wave".into()], true));
    assert_eq!(names(Some("last"), 1000.0), (vec!["last".into()], false));
    assert_eq!(names(Some("last"), 10000.0), (vec![], true), "too long by itself");
    assert_eq!(names(Some("other"), 1.0), (vec![], false));
    assert_eq!(names(None, 1.0).0.len(), 3);
}

/// Posed as their makers meant, characters stay together.
#[test]
fn real_clips_move_and_do_not_tear() {
    let Some(folder) = data("RIGLAB_RIGS", "rigs") else { return };
    let (mut clips, mut moving) = (0, 0);
    for path in files(&folder, &["glb"]) {
        let imported = import(&path, &options(5.0)).unwrap();
        let Some(rig) = imported.rig() else { continue };
        let left_out = imported.warnings().iter().map(ToString::to_string).filter(|w| w.contains("animations"));
        assert_eq!(left_out.collect::<Vec<_>>(), [""; 0], "{}", path.display());
        let rest = Bounds::of(rig.mesh().positions().iter().copied()).unwrap().diagonal();
        for clip in &imported.clips {
            clips += 1;
            let mut first: Option<Vec<Vec3>> = None;
            for frame in [0, clip.frames() / 2] {
                let posed = skin(rig, &clip.frame(frame)).unwrap();
                let size = Bounds::of(posed.iter().copied()).unwrap().diagonal() / rest;
                // Some begin with a character that is scaled away.
                assert!((0.005..5.0).contains(&size), "{} {} {frame}: {size}", path.display(), clip.name());
                moving += usize::from(first.is_some_and(|f| f != posed));
                first = Some(posed);
            }
        }
    }
    println!("{clips} clips, {moving} of them move");
    assert!(moving * 2 > clips);
}
