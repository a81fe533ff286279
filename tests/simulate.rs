//! `riglab simulate`: spring bones on a motion, as an animation.

mod binary;

use std::fs;
use std::path::{Path, PathBuf};

use binary::{must, refusal, riglab, text};
use serde_json::Value;

/// Creatures as files: avatars have spring bones, fish have none.
fn creatures(dir: &Path) -> (PathBuf, PathBuf) {
    let files = dir.join("files");
    must(&["synth", "-o", text(&files), "--count", "4", "--plans", "anime,fish", "--triangles", "800..1600"]);
    let named = |plan: &str| {
        let mut all: Vec<PathBuf> = fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).collect();
        all.sort();
        all.into_iter().find(|p| text(p).contains(plan) && text(p).ends_with("glb")).unwrap()
    };
    (named("anime"), named("fish"))
}

fn simulate(input: &Path, out: &Path, more: &[&str]) -> Value {
    let made = must(&[&["simulate", text(input), "-o", text(out), "--json"], more].concat());
    serde_json::from_slice(&made.stdout).unwrap()
}

fn inspect(file: &Path) -> Value {
    let mut v: Value = serde_json::from_slice(&must(&["inspect", text(file), "--json"]).stdout).unwrap();
    v.as_object_mut().unwrap().remove("file");
    v
}

/// The JSON of a GLB.
fn document(file: &Path) -> Value {
    let glb = fs::read(file).unwrap();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&glb[20..20 + length]).unwrap()
}

#[test]
fn a_motion_is_played_with_the_springs_of_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let (avatar, _) = creatures(dir.path());
    let before = fs::read(&avatar).unwrap();
    let (out, sheet) = (dir.path().join("new/out.glb"), dir.path().join("new/sheet.png"));
    let said = simulate(&avatar, &out, &["--seconds", "2", "--fps", "30", "--png", text(&sheet)]);
    assert_eq!((&said["motion"], &said["frames"], &said["fps"]), (&"shake".into(), &61.into(), &30.0.into()));
    assert!(said["swinging"].as_u64().unwrap() > 3 && said["farthest"].as_f64().unwrap() > 0.01, "{said}");
    assert!(fs::read(&sheet).unwrap().starts_with(b"\x89PNG"));
    // The rig is as it was, and the document has one motion more.
    assert_eq!(inspect(&out), inspect(&avatar));
    assert!(fs::read(&avatar).unwrap() == before, "the input stays");
    let json = document(&out);
    let animations = json["animations"].as_array().unwrap();
    assert_eq!((animations.len(), &animations[0]["name"]), (1, &"shake with springs".into()));
    // What swings turns; the root is moved; others need no keys.
    let channels = animations[0]["channels"].as_array().unwrap().len() as u64;
    assert!(channels > said["swinging"].as_u64().unwrap() / 2 && channels < 2 * said["joints"].as_u64().unwrap());
    assert_eq!(json["accessors"][animations[0]["samplers"][0]["input"].as_u64().unwrap() as usize]["count"], 61);

    // Same seed, same bytes; another seed or motion, others.
    let again = |name: &str, more: &[&str]| {
        let path = dir.path().join(name);
        simulate(&avatar, &path, &[&["--seconds", "2", "--fps", "30"], more].concat());
        fs::read(path).unwrap()
    };
    let first = fs::read(&out).unwrap();
    assert!(first == again("a.glb", &[]));
    assert!(first != again("b.glb", &["--seed", "1"]));
    assert!(first != again("c.glb", &["--motion", "hop"]));
    assert!(first != again("d.glb", &["--lengths", "lagging"]));

    // The motion that was written is one of the file, and can be played in turn.
    let twice = dir.path().join("twice.glb");
    let said = simulate(&out, &twice, &["--motion", "shake with springs", "--fps", "30", "--seconds", "1"]);
    assert_eq!((&said["motion"], &said["frames"]), (&"shake with springs".into(), &31.into()));
    assert_eq!(document(&twice)["animations"].as_array().unwrap().len(), 2);
}

/// A GLB whose first motion lasts ten minutes and is there three times, with other names.
fn long(glb: &[u8], names: [&str; 3]) -> Vec<u8> {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut json: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let mut binary = glb[28 + length..].to_vec();
    let motion = json["animations"][0].clone();
    let times = motion["samplers"][0]["input"].as_u64().unwrap() as usize;
    let accessor = json["accessors"][times].clone();
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let offset = |of: &Value| of["byteOffset"].as_u64().unwrap_or(0) as usize;
    let last = offset(view) + offset(&accessor) + 4 * (accessor["count"].as_u64().unwrap() as usize - 1);
    binary[last..last + 4].copy_from_slice(&600f32.to_le_bytes());
    json["accessors"][times]["max"] = serde_json::json!([600.0]);
    json["animations"] = names
        .iter()
        .map(|name| {
            let mut own = motion.clone();
            own["name"] = (*name).into();
            own
        })
        .collect();
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = (28 + text.len() + binary.len()) as u32;
    let numbers = [2, total, text.len() as u32, binary.len() as u32].map(u32::to_le_bytes);
    let parts: [&[u8]; 9] =
        [b"glTF", &numbers[0], &numbers[1], &numbers[2], b"JSON", &text, &numbers[3], b"BIN\0", &binary];
    parts.concat()
}

#[test]
fn a_motion_is_played_however_long_others_are_and_a_limit_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let (avatar, _) = creatures(dir.path());
    let [short, file, out] = ["short.glb", "long.glb", "out.glb"].map(|name| dir.path().join(name));
    simulate(&avatar, &short, &["--seconds", "1", "--fps", "30"]);
    fs::write(&file, long(&fs::read(&short).unwrap(), ["walk", "run", "rest"])).unwrap();
    let said = simulate(&file, &out, &["--motion", "rest", "--fps", "30"]);
    assert_eq!((&said["motion"], &said["frames"]), (&"rest".into(), &18001.into()));
    for more in [&["--motion", "rest"][..], &[]] {
        let out = dir.path().join("none.glb");
        let args = ["simulate", text(&file), "-o", text(&out), "--fps", "1000"];
        let said = refusal(&mut riglab(&[&args[..], more].concat()));
        assert!(said.contains("longer than is read") && said.contains("--seconds") && !out.exists(), "{said}");
    }
    let said = refusal(&mut riglab(&["simulate", text(&file), "-o", text(&out), "--motion", "hops"]));
    assert!(said.contains("it has `walk`, `run`, `rest`"), "{said}");
}

#[test]
fn springs_are_guessed_by_names() {
    let dir = tempfile::tempdir().unwrap();
    let (_, fish) = creatures(dir.path());
    // A fish's joints are `tail_1` and the like.
    let out = dir.path().join("out.glb");
    let said = simulate(&fish, &out, &["--springs", "guess", "--motion", "turn", "--fps", "30", "--seconds", "1"]);
    assert!(said["swinging"].as_u64().unwrap() > 0, "{said}");
    assert!(said["farthest"].as_f64().unwrap() > 0.0, "{said}");
    // A spring that branches is written as several.
    let springs = inspect(&out)["springs"].as_array().unwrap().len() as u64;
    assert!(springs >= said["springs"].as_u64().unwrap(), "they are written");
}

#[test]
fn what_cannot_be_done_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let (avatar, fish) = creatures(dir.path());
    let out = dir.path().join("out.glb");
    let (avatar, fish, out) = (text(&avatar), text(&fish), text(&out));
    let bare = dir.path().join("bare.glb");
    must(&["strip", fish, text(&bare)]);
    for (args, words) in [
        (vec![fish, "-o", out], "has no spring bones\n\nhint: `--springs guess`"),
        (vec![text(&bare), "-o", out], "has no skeleton; `riglab rig"),
        (vec![avatar, "-o", avatar], "is the input itself"),
        (vec![avatar, "-o", "out.fbx"], "only GLB is written"),
        (vec![avatar, "-o", out, "--png", avatar], "is the input itself"),
        (vec![avatar, "-o", out, "--motion", "walk"], "has no motion `walk`; it has none, and there are `shake`"),
        (vec![avatar, "-o", out, "--fps", "0"], "--fps 0"),
        (vec![avatar, "-o", out, "--seconds", "nan"], "--seconds NaN"),
        (vec![avatar, "-o", out, "--seconds", "600", "--fps", "1000"], "too many for 600 s"),
        (vec!["nothing.glb", "-o", out], "nothing.glb"),
    ] {
        let said = refusal(&mut riglab(&[&["simulate"], &args[..]].concat()));
        assert!(said.contains(words), "{args:?}: {said}");
    }
    assert!(!Path::new(out).exists(), "nothing is left behind");
}
