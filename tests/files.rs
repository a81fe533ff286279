//! Files in and out by the commands: inspect, convert, strip, and back into a corpus.

mod binary;

use std::fs;
use std::path::{Path, PathBuf};

use binary::{must, refusal, riglab, text};
use riglab_token::Template;
use serde_json::Value;

/// Every format that is written, by its name and the name of a file.
const FORMATS: [(&str, &str); 9] = [
    ("glb", "a.glb"),
    ("fbx", "a.fbx"),
    ("rignet", "a_rig.txt"),
    ("puppeteer", "p/a.txt"),
    ("puppeteer-h5", "a.h5"),
    ("articulation-xl", "a_axl.npz"),
    ("unirig", "raw_data.npz"),
    ("skintokens", "a_st.npz"),
    ("anymate", "a.pt"),
];

fn creatures(dir: &Path, count: u32) -> Vec<PathBuf> {
    must(&["synth", "-o", text(dir), "--count", &count.to_string(), "--triangles", "400..800"]);
    let names = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = names.filter(|p| p.extension().is_some_and(|e| e == "glb")).collect();
    files.sort();
    files
}

fn inspected(file: &Path) -> Value {
    let out = must(&["inspect", "--json", text(file)]);
    serde_json::from_slice(&out.stdout).unwrap()
}

#[test]
fn a_creature_goes_through_every_format_and_back() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let was = inspected(creature);
    for (format, name) in FORMATS {
        let file = dir.path().join(name);
        must(&["convert", text(creature), text(&file), "--to", format]);
        let back = dir.path().join(format!("{format}.glb"));
        must(&["convert", text(&file), text(&back)]);
        let is = inspected(&back);
        assert_eq!(is["joints"].as_array().map(Vec::len), was["joints"].as_array().map(Vec::len), "{format}");
        assert_eq!((&is["vertices"], &is["triangles"]), (&was["vertices"], &was["triangles"]), "{format}");
        let sum = |v: &Value| v["weight_totals"].as_object().unwrap().values().filter_map(Value::as_f64).sum::<f64>();
        assert!((sum(&is) - sum(&was)).abs() < 1e-2, "{format}");
    }
}

#[test]
fn what_is_left_out_of_a_corpus_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    must(&["synth", "-o", text(&path("c.h5")), "--count", "2", "--triangles", "400..800"]);
    must(&["convert", text(&path("c.h5")), text(&path("out/")), "--to", "glb"]);
    let written = fs::read_dir(path("out")).unwrap().map(|entry| entry.unwrap().path());
    let glb = written.filter(|p| p.extension().is_some_and(|e| e == "glb")).min().unwrap();
    fs::write(&glb, "mine").unwrap();
    let said = String::from_utf8(
        riglab(&["convert", text(&path("c.h5")), text(&path("out/")), "--to", "glb"]).output().unwrap().stdout,
    )
    .unwrap();
    assert!(said.contains("1 written") && said.contains("1 left out"), "{said}");
    refusal(&mut riglab(&["convert", text(&path("c.h5")), text(&path("out/")), "--to", "glb"]));
    assert_eq!(fs::read_to_string(glb).unwrap(), "mine");
}

#[test]
fn files_that_a_corpus_was_made_of_stay() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let creature = &creatures(&path("made"), 1)[0];
    fs::create_dir(path("mine")).unwrap();
    // As another program wrote it, with what no corpus holds.
    let bytes = fs::read(creature).unwrap();
    let at = bytes.windows(7).position(|w| w == b"riglab ").expect("who made it");
    let other = [&bytes[..at], b"blender", &bytes[at + 7..]].concat();
    fs::write(path("mine/own.glb"), &other).unwrap();
    must(&["dataset", "import", text(&path("mine")), "-o", text(&path("c.h5")), "--all-in", "train"]);
    for out in [path("mine/"), path("mine/own.glb")] {
        let said = refusal(&mut riglab(&["convert", text(&path("c.h5")), text(&out), "--to", "glb"]));
        assert!(said.contains("what the corpus was made of"), "{said}");
        assert_eq!(fs::read(path("mine/own.glb")).unwrap(), other);
    }
    must(&["convert", text(&path("c.h5")), text(&path("again/")), "--to", "glb"]);
    must(&["convert", text(&path("c.h5")), text(&path("again/")), "--to", "glb"]);
    // Its own as well, of any format: they are known by their contents.
    for (format, name) in [("glb", "made.glb"), ("fbx", "made.fbx"), ("puppeteer", "made.txt")] {
        let (folder, corpus) = (path(format), path(&format!("{format}.h5")));
        must(&["convert", text(creature), text(&folder.join(name)), "--to", format]);
        let before = fs::read(folder.join(name)).unwrap();
        must(&["dataset", "import", text(&folder), "-o", text(&corpus), "--all-in", "train"]);
        let into = format!("{}/", folder.display());
        let said = refusal(&mut riglab(&["convert", text(&corpus), &into, "--to", format]));
        assert!(said.contains("what the corpus was made of"), "{format}: {said}");
        assert_eq!(fs::read(folder.join(name)).unwrap(), before);
    }
    let said = refusal(&mut riglab(&["convert", text(&path("c.h5")), text(&path("d.h5"))]));
    assert!(said.contains("--to puppeteer-h5"), "{said}");
}

#[test]
fn meshes_of_a_corpus_are_no_rigs() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    creatures(&path("made"), 1);
    must(&["dataset", "import", text(&path("made")), "-o", text(&path("m.h5")), "--meshes"]);
    must(&["convert", text(&path("m.h5")), text(&path("out.glb"))]);
    let bytes = fs::read(path("out.glb")).unwrap();
    let json: Value =
        serde_json::from_slice(&bytes[20..20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize])
            .unwrap();
    assert!(json["skins"].is_null() && json["meshes"].is_array(), "{json}");
    must(&["convert", text(&path("m.h5")), text(&path("out.obj"))]);
    let said =
        refusal(&mut riglab(&["convert", text(&path("m.h5")), text(&path("out.npz")), "--to", "articulation-xl"]));
    assert!(said.contains("without a rig"), "{said}");
    let said = refusal(&mut riglab(&["tokens", text(&path("m.h5"))]));
    assert!(said.contains("1 mesh without a rig") && said.contains("no asset has a sequence"), "{said}");
}

#[cfg(unix)]
#[test]
fn pipes_are_told_as_what_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe.glb");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for command in
        [&["inspect", text(&pipe)][..], &["rig", text(&pipe), "-o", "out.glb"], &["strip", text(&pipe), "out.glb"]]
    {
        let said = refusal(&mut riglab(command));
        assert!(said.contains("a pipe or a device"), "{command:?}: {said}");
    }
}

#[test]
fn scans_stand_up_and_those_far_away_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let scan = |name: &str, far: f64| {
        let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
                    element face 4\nproperty list uchar int vertex_indices\nend_header\n";
        let rows: String = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.2, 0.2, 2.0]]
            .iter()
            .map(|[x, y, z]| format!("{} {} {z}\n", x + far, y + far))
            .collect();
        fs::create_dir_all(path("scans")).unwrap();
        fs::write(path("scans").join(name), format!("{head}{rows}3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n")).unwrap();
    };
    scan("near.ply", 0.0);
    must(&["dataset", "import", text(&path("scans")), "-o", text(&path("m.h5")), "--meshes", "--up", "z"]);
    must(&["convert", text(&path("m.h5")), text(&path("m.glb"))]);
    let said = String::from_utf8(must(&["inspect", text(&path("m.glb"))]).stdout).unwrap();
    assert!(said.contains("1.0000 x 2.0000 x 1.0000"), "{said}");
    scan("far.ply", 5_000_000.0);
    let said = String::from_utf8(must(&["inspect", text(&path("scans/far.ply"))]).stdout).unwrap();
    assert!(said.contains("so far from the origin that its places are rounded to"), "{said}");
    let said =
        refusal(&mut riglab(&["dataset", "import", text(&path("scans")), "-o", text(&path("x.h5")), "--up", "z"]));
    assert!(said.contains("--meshes"), "{said}");
}

#[test]
fn what_is_of_another_kind_is_not_written_over() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let creature = &creatures(&path("made"), 1)[0];
    let [creature, notes, png, glb, model] =
        [creature.clone(), path("notes.txt"), path("a.png"), path("a.glb"), path("a.safetensors")];
    let [from, notes, png, glb, model] = [&creature, &notes, &png, &glb, &model].map(|path| text(path));
    let calls = [
        (notes, vec!["convert", from, notes, "--to", "rignet"], "another name or folder"),
        (glb, vec!["convert", from, glb], "another name or folder"),
        (glb, vec!["strip", from, glb], "another name"),
        (glb, vec!["strip", "--in-place", from, glb], "another name"),
        (glb, vec!["rig", from, "-o", glb], "another name"),
        (glb, vec!["simulate", from, "-o", glb, "--springs", "guess"], "another name"),
        (png, vec!["view", from, "--png", png], "--png another name"),
        (model, vec!["checkpoint", "export", "-o", model], "--out another name"),
    ];
    for (file, call, remedy) in calls {
        fs::write(file, "mine").unwrap();
        let said = refusal(&mut riglab(&call));
        assert!(said.contains(&format!("{file} is there already")) && said.contains(remedy), "{said}");
        assert_eq!(fs::read_to_string(file).unwrap(), "mine");
        fs::remove_file(file).unwrap();
    }
    // Those of the kind are replaced.
    for call in
        [vec!["convert", from, notes, "--to", "rignet"], vec!["strip", from, glb], vec!["view", from, "--png", png]]
    {
        must(&call);
        must(&call);
    }
    // Where others wrote them, on request alone.
    let bytes = fs::read(glb).unwrap();
    let at = bytes.windows(7).position(|w| w == b"riglab ").expect("who made it");
    fs::write(glb, [&bytes[..at], b"blender", &bytes[at + 7..]].concat()).unwrap();
    let changed = fs::read_to_string(notes).unwrap().replacen("joints ", "joints my_", 1);
    fs::write(notes, changed).unwrap();
    for call in [vec!["convert", from, notes, "--to", "rignet"], vec!["strip", from, glb]] {
        let before = [notes, glb].map(|file| fs::read(file).unwrap());
        let said = refusal(&mut riglab(&call));
        assert!(said.contains("not marked as written by riglab") && said.contains("--overwrite"), "{said}");
        assert_eq!([notes, glb].map(|file| fs::read(file).unwrap()), before);
        must(&[&call[..], &["--overwrite"]].concat());
        must(&call);
    }
}

#[test]
fn a_folder_in_one_file_keeps_what_its_lists_say_beside_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let made = creatures(&path("made"), 2);
    let [first, second] = [0, 1].map(|k| made[k].file_name().unwrap().to_str().unwrap());
    fs::write(path("made/split.json"), serde_json::json!({"train": [first], "val": [second]}).to_string()).unwrap();
    let known = |folder: &Path, corpus: &Path| -> Vec<Value> {
        must(&["dataset", "import", text(folder), "-o", text(corpus)]);
        let listed = must(&["dataset", "inspect", text(corpus), "--json"]).stdout;
        let own = |line: &str| {
            let of: Value = serde_json::from_str(line).unwrap();
            ["split", "source", "licence", "author", "category"].map(|key| of[key].clone()).to_vec().into()
        };
        String::from_utf8(listed).unwrap().lines().map(own).collect()
    };
    let all = path("one/all.npz");
    let convert = || must(&["convert", text(&path("made")), text(&all), "--to", "articulation-xl"]).stderr;
    let said = String::from_utf8(convert()).unwrap();
    assert!(said.contains("what the folder knows of sources") && said.contains("split.json"), "{said}");
    assert_eq!(known(&path("one"), &path("one.h5")), known(&path("made"), &path("made.h5")));
    let said = String::from_utf8(convert()).unwrap();
    assert!(said.contains("split.json is there already"), "{said}");
    // Beside files in a folder, too, without those that were left out.
    fs::write(path("made/broken.glb"), "glTF").unwrap();
    fs::write(
        path("made/split.json"),
        serde_json::json!({"train": [first], "val": [second, "broken.glb"]}).to_string(),
    )
    .unwrap();
    let out = riglab(&["convert", text(&path("made")), text(&path("apart/")), "--to", "fbx"]).output().unwrap();
    assert!(!out.status.success() && path("apart/manifest.json").is_file(), "{out:?}");
    let listed: Value = serde_json::from_slice(&fs::read(path("apart/split.json")).unwrap()).unwrap();
    let fbx = |name: &str| name.replace(".glb", ".fbx");
    assert_eq!(listed, serde_json::json!({"train": [fbx(first)], "val": [fbx(second)]}));
    assert_eq!(known(&path("apart"), &path("apart.h5")), known(&path("made"), &path("made.h5")));
}

#[test]
fn bare_meshes_are_listed_as_such() {
    let dir = tempfile::tempdir().unwrap();
    let (made, corpus) = (dir.path().join("made"), dir.path().join("meshes.h5"));
    creatures(&made, 1);
    must(&["dataset", "import", text(&made), "-o", text(&corpus), "--meshes"]);
    let said = |more: &[&str]| {
        let all = [&["dataset", "inspect", text(&corpus)], more].concat();
        String::from_utf8(must(&all).stdout).unwrap()
    };
    assert!(said(&[]).contains(" t   bare  ") && !said(&[]).contains("1 j"), "{}", said(&[]));
    let of: Value = serde_json::from_str(&said(&["--json"])).unwrap();
    assert_eq!((&of["joints"], &of["nonzero_weights"], &of["bare"]), (&0.into(), &0.into(), &true.into()));
    let name = of["name"].as_str().unwrap();
    assert!(said(&[name]).contains(" triangles, bare, split `meshes`)"), "{}", said(&[name]));
    let of: Value = serde_json::from_str(&said(&[name, "--json"])).unwrap();
    assert_eq!((&of["joints"], &of["joint_names"]), (&0.into(), &serde_json::json!([])));
}

#[test]
fn what_a_format_cannot_hold_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let made = path("made");
    must(&["synth", "-o", text(&made), "--count", "2", "--plans", "anime", "--triangles", "500..1500"]);
    let avatar = fs::read_dir(&made).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().unwrap() == "glb");
    let (avatar, moved) = (avatar.unwrap(), path("moved.glb"));
    must(&["simulate", text(&avatar), "-o", text(&moved), "--seconds", "0.5"]);
    let told = |from: &Path, to: &Path, more: &[&str]| {
        let out = must(&[&["convert", text(from), text(to)], more].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        said.lines().filter(|line| line.contains("not written")).map(String::from).collect::<Vec<_>>()
    };
    let springs = inspected(&avatar)["springs"].as_array().unwrap().len();
    for (format, name) in FORMATS.iter().chain(&[("obj", "a.obj")]) {
        let said = told(&moved, &path(name), &["--to", format]);
        if *format == "glb" {
            assert!(said.is_empty(), "{said:?}");
            continue;
        }
        assert_eq!(said.len(), 1, "{said:?}");
        let start = format!("note: {}: not written, as riglab's {format} files hold none: ", moved.display());
        // An FBX holds motions, too.
        let moves = *format == "fbx" || said[0].contains("1 animation, ");
        assert!(said[0].starts_with(&start) && moves, "{said:?}");
        assert!(said[0].contains(&format!("{springs} springs")), "{said:?}");
    }
    // Of many files it is told once, of a corpus too.
    let said = told(&made, &path("apart"), &["--to", "rignet"]);
    assert!(said.len() == 1 && said[0].contains("made: not written"), "{said:?}");
    let corpus = path("c.h5");
    must(&["dataset", "import", text(&made), "-o", text(&corpus)]);
    assert_eq!(told(&corpus, &path("again"), &["--to", "unirig"]).len(), 1);
    assert!(told(&corpus, &path("whole"), &["--to", "glb"]).is_empty());
    let said = told(&corpus, &path("film"), &["--to", "fbx", "--influences", "4", "--frames", "bone"]);
    assert!(said.len() == 1 && said[0].contains("springs") && !said[0].contains("animation"), "{said:?}");
    // Neither is a file that can be drawn.
    let png = path("b.png");
    for (file, wanted) in [(&corpus, "c.h5: it is a corpus of riglab"), (&made, "made: it is a folder; give one of")] {
        let said = refusal(&mut riglab(&["view", text(file), "--png", text(&png)]));
        assert!(said.contains(wanted) && !said.contains('…'), "{said}");
    }
}

#[test]
fn a_picture_is_drawn_of_any_file() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let size = |png: &Path| {
        let bytes = fs::read(png).unwrap();
        assert_eq!(&bytes[1..4], b"PNG");
        let side = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
        (bytes.len(), side(16), side(20))
    };
    let draw = |file: &Path, more: &[&str]| {
        let png = dir.path().join("pictures").join("a.png");
        let args = [&["view", text(file), "--png", text(&png), "--size", "64"], more].concat();
        let said = String::from_utf8(must(&args).stdout).unwrap();
        (size(&png), said)
    };
    let ((plain, width, height), said) = draw(creature, &[]);
    assert!(said.contains("joints") && width.max(height) > 2 * 64 && width.min(height) > 48, "{said}");
    let names: Vec<String> =
        inspected(creature)["joints"].as_array().unwrap().iter().map(|j| j["name"].to_string()).collect();
    let bone = names[1].trim_matches('"');
    // A row of the skeleton and one of each bone.
    let ((_, _, taller), _) = draw(creature, &["--bone", bone, "--bone", names[2].trim_matches('"')]);
    assert!(taller > height);
    assert_ne!(draw(creature, &["--up", "z"]).0.0, plain);
    for (format, name) in FORMATS {
        let file = dir.path().join(name);
        must(&["convert", text(creature), text(&file), "--to", format]);
        assert!(draw(&file, &[]).1.contains("joints"), "{format}");
    }
    let bare = dir.path().join("bare.glb");
    let said = must(&["strip", text(creature), text(&bare)]).stdout;
    assert_eq!(String::from_utf8(said).unwrap(), format!("{}\n", bare.display()));
    let ((_, _, low), said) = draw(&bare, &["--dark"]);
    assert!(said.contains("no rig") && low < height, "{said}");
    let png = dir.path().join("b.png");
    for (args, wanted) in [
        (vec!["view", text(creature), "--png", text(&png), "--bone", "nonesuch"], "no joint is called `nonesuch`"),
        (vec!["view", text(&bare), "--png", text(&png), "--bone", bone], "no rig"),
        (vec!["view", text(creature), "--png", text(creature)], "only PNG"),
        (vec!["view", "nonesuch.glb", "--png", text(&png)], "nonesuch.glb"),
    ] {
        let said = refusal(&mut riglab(&args));
        assert!(said.contains(wanted) && !png.exists(), "{said}");
    }
}

#[test]
fn many_files_become_one_and_a_corpus() {
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("made");
    let count = creatures(&made, 4).len();
    let one = dir.path().join("set").join("all.npz");
    fs::create_dir(one.parent().unwrap()).unwrap();
    must(&["convert", text(&made), text(&one), "--to", "articulation-xl"]);
    let lines = |args: &[&str]| String::from_utf8_lossy(&must(args).stdout).lines().count();
    assert_eq!(lines(&["inspect", "--json", text(&one)]), count);
    assert_eq!(lines(&["inspect", "--json", text(&one), "--item", "3"]), 1);
    let said = refusal(&mut riglab(&["convert", text(&one), text(&dir.path().join("one.glb"))]));
    assert!(said.contains("one.glb") && said.contains("--item"), "{said}");
    // Whether or not there is such a file.
    must(&["convert", text(&one), text(&dir.path().join("one.glb")), "--item", "0"]);
    assert_eq!(refusal(&mut riglab(&["convert", text(&one), text(&dir.path().join("one.glb"))])), said);
    let corpus = dir.path().join("c.h5");
    must(&["dataset", "import", text(one.parent().unwrap()), "-o", text(&corpus)]);
    let listed = must(&["dataset", "inspect", text(&corpus), "--json"]).stdout;
    assert_eq!(String::from_utf8_lossy(&listed).lines().count(), count);
    // And apart again.
    let apart = dir.path().join("apart");
    must(&["convert", text(&one), text(&apart), "--to", "glb"]);
    assert_eq!(fs::read_dir(apart).unwrap().count(), count);
    // Files that are made of a corpus, and of one file that was made of it, are called alike, and a kind of note is a line.
    let of_corpus = dir.path().join("of_corpus.npz");
    let plain = dir.path().join("plain.h5");
    must(&["dataset", "import", text(&made), "-o", text(&plain)]);
    must(&["convert", text(&plain), text(&of_corpus), "--to", "articulation-xl"]);
    let names = |from: &Path, to: &str| {
        let to = dir.path().join(to);
        let said = String::from_utf8(must(&["convert", text(from), text(&to), "--to", "puppeteer-h5"]).stderr).unwrap();
        let lacking: Vec<&str> = said.lines().filter(|line| line.contains("joint names are not in it")).collect();
        assert!(lacking.len() == 1 && lacking[0].starts_with("note: ") && lacking[0].contains(", "), "{said}");
        let names = fs::read_dir(to).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.filter(|name| name.ends_with(".h5")).collect();
        names.sort();
        names
    };
    let once = names(&plain, "once/");
    assert!(once.len() == count && once.iter().all(|name| !name.contains(".glb")), "{once:?}");
    assert_eq!(names(&of_corpus, "twice/"), once);
    assert_eq!(names(&made, "thrice/"), once);
}

#[test]
fn a_rig_is_taken_out() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let bare = dir.path().join("bare.glb");
    must(&["strip", text(creature), text(&bare)]);
    let (was, is) = (inspected(creature), inspected(&bare));
    assert_eq!((&is["vertices"], &is["triangles"]), (&was["vertices"], &was["triangles"]));
    assert_eq!(is["joints"], Value::Array(vec![]));
    // A rig is needed for what holds rigs.
    let said = refusal(&mut riglab(&["convert", text(&bare), text(&dir.path().join("bare_rig.txt"))]));
    assert!(said.contains("bare.glb") && said.contains("skeleton"), "{said}");
    must(&["convert", text(&bare), text(&dir.path().join("bare.obj"))]);
}

#[test]
fn the_source_is_never_written_over_and_faults_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let before = fs::read(creature).unwrap();
    for args in [&["convert", text(creature), text(creature)][..], &["strip", text(creature), text(creature)]] {
        let said = refusal(&mut riglab(args));
        assert!(said.contains(text(creature)), "{said}");
        assert_eq!(fs::read(creature).unwrap(), before);
    }
    let nowhere = dir.path().join("nowhere.glb");
    let out = dir.path().join("out.glb");
    for args in [
        &["convert", text(&nowhere), text(&out)][..],
        &["strip", text(&nowhere), text(&out)],
        &["convert", text(creature), text(&nowhere), "--character", "9"],
    ] {
        let said = refusal(&mut riglab(args));
        assert!(said.contains("glb") && !out.exists() && !nowhere.exists(), "{said}");
    }
    let unclear = refusal(&mut riglab(&["convert", text(creature), text(&dir.path().join("x.npz"))]));
    assert!(unclear.contains("--to") && unclear.contains("unirig"), "{unclear}");
    for (name, format, ending) in [("out.glb", "obj", "obj"), ("out.npz", "glb", "glb"), ("out.txt", "glb", "glb")] {
        let out = dir.path().join(name);
        let apart = refusal(&mut riglab(&["convert", text(creature), text(&out), "--to", format]));
        assert!(apart.contains(&format!("ends in .{ending}")) && !out.exists(), "{apart}");
    }
    // What is no VRM is not called so.
    let vrm = dir.path().join("out.vrm");
    let said = refusal(&mut riglab(&["convert", text(creature), text(&vrm), "--to", "glb"]));
    assert!(said.contains("only what is a VRM is written as one") && !vrm.exists(), "{said}");
    let (rig, again) = (dir.path().join("rig.fbx"), dir.path().join("again.vrm"));
    must(&["convert", text(creature), text(&rig)]);
    let said = refusal(&mut riglab(&["convert", text(&rig), text(&again)]));
    assert!(said.contains("name it .glb") && !again.exists(), "{said}");
}

#[test]
fn a_corpus_becomes_files_again() {
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("made");
    let was: Vec<Value> = creatures(&made, 3).iter().map(|f| inspected(f)).collect();
    let (corpus, apart) = (dir.path().join("new/c.h5"), dir.path().join("apart"));
    must(&["dataset", "import", text(&made), "-o", text(&corpus)]);
    must(&["convert", text(&corpus), text(&apart), "--to", "glb"]);
    let mut files: Vec<_> = fs::read_dir(&apart).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    // What files do not say of themselves stands beside them, and is read back.
    let beside: Vec<_> = files.extract_if(.., |f| f.extension().unwrap() == "json").collect();
    assert!(beside.len() == 2 && beside[0].ends_with("manifest.json") && beside[1].ends_with("split.json"));
    let back = dir.path().join("back.h5");
    must(&["dataset", "import", text(&apart), "-o", text(&back)]);
    let known = |corpus: &Path| must(&["dataset", "inspect", text(corpus), "--json"]).stdout;
    assert_eq!(known(&back), known(&corpus));
    // Never over what is there.
    fs::write(&beside[0], "[]").unwrap();
    let said = must(&["convert", text(&corpus), text(&apart), "--to", "glb"]).stderr;
    assert!(String::from_utf8(said).unwrap().contains("manifest.json is there already"));
    assert_eq!(fs::read(&beside[0]).unwrap(), b"[]");
    let is: Vec<Value> = files.iter().map(|f| inspected(f)).collect();
    for (is, was) in is.iter().zip(&was) {
        for part in ["vertices", "triangles", "weight_totals"] {
            assert_eq!(is[part], was[part], "{part}");
        }
        // Nodes of the document may have other numbers.
        let joints = |v: &Value| -> Vec<Value> {
            let all = v["joints"].as_array().unwrap();
            all.iter().map(|j| serde_json::json!([j["name"], j["parent"], j["head"]])).collect()
        };
        assert_eq!(joints(is), joints(was));
    }
    assert_eq!(is.len(), was.len());
    must(&["convert", text(&corpus), text(&dir.path().join("second.obj")), "--item", "1"]);
    must(&["convert", text(&corpus), text(&dir.path().join("all.pt"))]);
    let said = refusal(&mut riglab(&["convert", text(&corpus), text(&dir.path().join("x.glb")), "--item", "3"]));
    assert!(said.contains("c.h5") && said.contains('3'), "{said}");
    for option in [&["--character", "1"][..], &["--repair"]] {
        let out = dir.path().join("x.glb");
        let all = ["convert", text(&corpus), text(&out), "--item", "0"];
        let said = refusal(&mut riglab(&[&all[..], option].concat()));
        assert!(said.contains(option[0]) && said.contains("for files of models"), "{said}");
    }
    let said = refusal(&mut riglab(&["inspect", text(&corpus)]));
    assert!(said.contains("dataset inspect"), "{said}");
}

#[test]
fn a_corpus_in_one_file_keeps_what_the_file_cannot_say_beside_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    creatures(&path("made"), 3);
    must(&["dataset", "import", text(&path("made")), "-o", text(&path("c.h5"))]);
    let known = |corpus: &Path| -> Vec<Value> {
        let listed = must(&["dataset", "inspect", text(corpus), "--json"]).stdout;
        let own = |line: &str| {
            let of: Value = serde_json::from_str(line).unwrap();
            ["split", "source", "licence", "author", "category"].map(|key| of[key].clone()).to_vec().into()
        };
        String::from_utf8(listed).unwrap().lines().map(own).collect()
    };
    for (format, name) in [("articulation-xl", "all.npz"), ("puppeteer-h5", "all.h5"), ("anymate", "all.pt")] {
        let folder = path(format);
        let said = must(&["convert", text(&path("c.h5")), text(&folder.join(name)), "--to", format, "--fit"]).stderr;
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("manifest.json and ") && said.contains("split.json"), "{said}");
        assert!(said.contains("reading: 3/3") && !said.contains("own loaders expect"), "{said}");
        let back = path(&format!("{format}.h5"));
        must(&["dataset", "import", text(&folder), "-o", text(&back)]);
        assert_eq!(known(&back), known(&path("c.h5")), "{format}");
        let said = must(&["convert", text(&path("c.h5")), text(&folder.join(name)), "--to", format]).stderr;
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("own loaders expect") && said.contains("split.json is there already"), "{said}");
    }
    // Of one asset in a place of any kind nothing is said beside it.
    must(&["convert", text(&path("c.h5")), text(&path("one/a.glb")), "--item", "0"]);
    assert_eq!(fs::read_dir(path("one")).unwrap().count(), 1);
    let said = refusal(&mut riglab(&["convert", text(&path("made")), text(&path("f/")), "--to", "unirig", "--fit"]));
    assert!(said.contains("articulation-xl, anymate") && said.contains("unirig is of any size"), "{said}");
    let said = refusal(&mut riglab(&["convert", text(&path("made")), text(&path("f/")), "--to", "glb", "--item", "3"]));
    assert!(said.contains("is a folder: --item") && !path("f").exists(), "{said}");
}

#[test]
fn what_one_file_of_many_cannot_hold_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    creatures(&path("made"), 2);
    // A chain of more joints than Anymate's pt has numbers for.
    let joints = (0..200).map(|k| format!("joints j{k} {k} 0 0\n")).collect::<String>();
    let tree = (1..200).map(|k| format!("hier j{} j{k}\n", k - 1)).collect::<String>();
    let skin = "root j0\nskin 0 j0 1\nskin 1 j0 1\nskin 2 j0 1\n";
    fs::write(path("made/long_rig.txt"), joints + skin + &tree).unwrap();
    fs::write(path("made/long.obj"), "v 0 0 0\nv 200 0 0\nv 0 9 0\nf 1 2 3\n").unwrap();
    must(&["dataset", "import", text(&path("made")), "-o", text(&path("c.h5")), "--all-in", "train"]);
    for input in ["c.h5", "made"] {
        let out = path(&format!("{input}.pt"));
        let done = riglab(&["convert", text(&path(input)), text(&out), "--to", "anymate"]).output().unwrap();
        let said = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(1), "{said}");
        let left_out: Vec<&str> = said.lines().filter(|line| line.starts_with("left out: ")).collect();
        assert!(left_out.len() == 1 && left_out[0].contains("`long") && left_out[0].contains("up to 127"), "{said}");
        let lines = must(&["inspect", "--json", text(&out)]).stdout;
        assert_eq!(String::from_utf8(lines).unwrap().lines().count(), 2);
    }
    // What else it has is not lost with the one file either.
    let lost = |folder: &str| {
        let done =
            riglab(&["convert", text(&path(folder)), text(&path("some.pt")), "--to", "anymate"]).output().unwrap();
        let said = String::from_utf8(done.stderr).unwrap();
        said.lines().find_map(|line| line.split_once(" hold none: ").map(|(_, what)| what.to_owned()))
    };
    must(&["convert", text(&path("made/long_rig.txt")), text(&path("long.glb"))]);
    fs::remove_file(path("made/long_rig.txt")).unwrap();
    let before = lost("made");
    fs::rename(path("long.glb"), path("made/long.glb")).unwrap();
    assert!(before.as_ref().is_some_and(|before| before.contains("material")) && before == lost("made"), "{before:?}");
}

#[test]
fn folders_come_back_from_one_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let made = creatures(&path("made"), 2);
    for (from, to) in [(&made[0], "in/a/x.glb"), (&made[1], "in/b/c/x.glb"), (&made[1], "in/x.glb")] {
        fs::create_dir_all(path(to).parent().unwrap()).unwrap();
        fs::copy(from, path(to)).unwrap();
    }
    for (file, format) in [("all.npz", "articulation-xl"), ("all.h5", "puppeteer-h5"), ("all.pt", "anymate")] {
        let back = path(&format!("{format}/"));
        must(&["convert", text(&path("in")), text(&path(file)), "--to", format]);
        must(&["convert", text(&path(file)), text(&back), "--to", "glb"]);
        for file in ["a/x.glb", "b/c/x.glb", "x.glb"] {
            assert!(back.join(file).is_file(), "{format}: {file}");
        }
        assert_eq!(fs::read_dir(&back).unwrap().count(), 3, "{format}");
    }
    // One asset alone, too.
    must(&["convert", text(&path("all.npz")), text(&path("one/")), "--to", "glb", "--item", "0"]);
    assert!(path("one/a/x.glb").is_file());
    // Also those of a corpus, and the only one of a corpus with what its file cannot say.
    must(&["dataset", "import", text(&path("in")), "-o", text(&path("c.h5"))]);
    for (item, file) in [("0", "a/x.glb"), ("1", "b/c/x.glb")] {
        must(&["convert", text(&path("c.h5")), text(&path("own/")), "--to", "glb", "--item", item]);
        assert!(path("own").join(file).is_file(), "{file}");
    }
    assert_eq!(fs::read_dir(path("own")).unwrap().count(), 2);
    fs::remove_dir_all(path("own/b")).unwrap();
    must(&["dataset", "import", text(&path("own")), "-o", text(&path("single.h5")), "--all-in", "val"]);
    must(&["convert", text(&path("single.h5")), text(&path("last/")), "--to", "glb"]);
    let splits: Value = serde_json::from_str(&fs::read_to_string(path("last/split.json")).unwrap()).unwrap();
    assert_eq!((splits, path("last/a/x.glb").is_file()), (serde_json::json!({"val": ["a/x.glb"]}), true));
}

#[cfg(unix)]
#[test]
fn what_cannot_be_looked_at_is_left_out_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    creatures(&path("in"), 2);
    std::os::unix::fs::symlink("nowhere", path("in/broken.glb")).unwrap();
    for (out, format) in [("out/", "obj"), ("all.pt", "anymate")] {
        let done = riglab(&["convert", text(&path("in")), text(&path(out)), "--to", format]).output().unwrap();
        assert_eq!(done.status.code(), Some(1), "{format}");
        let said = String::from_utf8(done.stdout).unwrap();
        assert!(said.contains('2') && said.contains("1 left out"), "{said}");
    }
}

#[test]
fn pairs_of_text_and_mesh_come_back_whatever_they_are_called() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    for (name, plan) in [("fox", "biped"), ("fox_rig", "quadruped"), ("fox_skin", "fish")] {
        let made = path(plan);
        must(&["synth", "-o", text(&made), "--count", "1", "--plans", plan, "--triangles", "400..800"]);
        let mut files = fs::read_dir(&made).unwrap().map(|entry| entry.unwrap().path());
        let file = files.find(|file| file.extension().is_some_and(|ending| ending == "glb")).unwrap();
        fs::create_dir_all(path("in")).unwrap();
        fs::rename(file, path("in").join(format!("{name}.glb"))).unwrap();
    }
    let shape = |file: &Path| {
        let v = inspected(file);
        (v["joints"].as_array().map(Vec::len), v["vertices"].clone(), v["triangles"].clone())
    };
    for (format, ending) in [("rignet", "_rig.txt"), ("puppeteer", ".txt")] {
        let out = path(format);
        must(&["convert", text(&path("in")), text(&out), "--to", format]);
        let said = must(&["dataset", "import", text(&out), "-o", text(&path("c.h5"))]).stdout;
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("3 assets") && said.contains("0 files left out"), "{said}");
        for name in ["fox", "fox_skin"] {
            let was = shape(&path("in").join(format!("{name}.glb")));
            assert_eq!(shape(&out.join(format!("{name}{ending}"))), was, "{format} {name}");
        }
    }
}

#[cfg(unix)]
#[test]
fn results_leave_protected_files_alone_and_private_ones_private() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let out = dir.path().join("out.glb");
    let set = |mode| fs::set_permissions(&out, fs::Permissions::from_mode(mode)).unwrap();
    must(&["convert", text(creature), text(&out)]);
    set(0o600);
    must(&["strip", text(creature), text(&out)]);
    assert_eq!(out.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    set(0o444);
    let before = fs::read(&out).unwrap();
    for command in ["strip", "convert"] {
        let said = refusal(&mut riglab(&[command, text(creature), text(&out), "--overwrite"]));
        assert!(said.contains("out.glb is there already and write-protected"), "{said}");
    }
    assert_eq!(fs::read(&out).unwrap(), before);
}

#[test]
fn what_has_no_sequence_of_tokens_is_told_and_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    creatures(&path("made"), 1);
    // The joints of a template, each below the one that is to be below it.
    let names: Vec<&str> = Template::of("mixamo").unwrap().parts[0].joints.iter().rev().copied().collect();
    let joints = names.iter().enumerate().map(|(k, name)| format!("joints {name} {k} 0 0\n")).collect::<String>();
    let tree = names.windows(2).map(|two| format!("hier {} {}\n", two[0], two[1])).collect::<String>();
    let skin = (0..3).map(|vertex| format!("skin {vertex} {} 1\n", names[0])).collect::<String>();
    fs::write(path("made/upside_rig.txt"), format!("{joints}root {}\n{tree}{skin}", names[0])).unwrap();
    fs::write(path("made/upside.obj"), "v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n").unwrap();
    must(&["dataset", "import", text(&path("made")), "-o", text(&path("c.h5")), "--all-in", "train"]);
    let released = ["--preset", "unirig-released", "--class", "mixamo"];
    let done = riglab(&[&["tokens", text(&path("c.h5")), "--json"][..], &released].concat()).output().unwrap();
    let lines = String::from_utf8(done.stdout).unwrap();
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let refused: Vec<&Value> = lines.iter().filter(|line| line["error"].is_string()).collect();
    assert!(refused.len() == 1 && refused[0]["name"] == "upside_rig.txt", "{lines:?}");
    assert!(lines.iter().any(|line| line["category"] == "all" && line["assets"] == 1), "{lines:?}");
    assert_eq!(done.status.code(), Some(1));
}

#[cfg(unix)]
#[test]
fn hidden_files_and_write_protected_corpora_are_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let made = creatures(&path("made"), 2);
    fs::create_dir_all(path("made/.git")).unwrap();
    for hidden in ["made/.git/a.glb", "made/._a.glb"] {
        fs::copy(&made[0], path(hidden)).unwrap();
    }
    assert!(std::process::Command::new("mkfifo").arg(path("made/pipe.glb")).status().unwrap().success());
    let import = ["dataset", "import", text(&path("made")), "-o", text(&path("c.h5"))].map(String::from);
    let import: Vec<&str> = import.iter().map(String::as_str).collect();
    for (args, skipped) in [
        (import.clone(), "hidden and not taken"),
        (vec!["curate", text(&path("made")), "-o", text(&path("k.h5"))], "hidden and not taken"),
        (vec!["convert", text(&path("made")), text(&path("out")), "--to", "obj"], "hidden and not taken"),
    ] {
        let done = riglab(&args).output().unwrap();
        let said = String::from_utf8(done.stderr).unwrap();
        assert_eq!(said.matches(skipped).count(), 1, "{args:?}: {said}");
        assert!(args[0] == "curate" || said.contains("pipe.glb: it is no plain file"), "{said}");
    }
    assert!(fs::read_dir(path("out")).unwrap().count() == 3 && path("out/manifest.json").is_file());
    let mut mode = path("c.h5").metadata().unwrap().permissions();
    mode.set_readonly(true);
    fs::set_permissions(path("c.h5"), mode).unwrap();
    assert!(refusal(&mut riglab(&import)).contains("c.h5: is there already and write-protected"));
}

#[test]
fn splits_that_the_folder_lists_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    creatures(&path("made"), 2);
    fs::write(path("made/split.json"), "{}").unwrap();
    let said = |more: &[&str]| {
        let base = ["dataset", "import", text(&path("made")), "-o", text(&path("c.h5"))].map(String::from);
        let base: Vec<&str> = base.iter().map(String::as_str).collect();
        String::from_utf8(must(&[&base, more].concat()).stderr).unwrap()
    };
    let told = said(&[]);
    assert!(told.contains("splits are those of") && !told.contains("--seed"), "{told}");
    assert!(said(&["--seed", "5"]).contains("--seed has no effect"));
    assert!(!said(&["--all-in", "train"]).contains("splits are those of"));
}

#[test]
fn test_rigs_of_a_corpus_are_posed_scaled_and_turned() {
    let dir = tempfile::tempdir().unwrap();
    let (made, corpus) = (dir.path().join("made"), dir.path().join("c.h5"));
    creatures(&made, 12);
    must(&["dataset", "import", text(&made), "-o", text(&corpus)]);
    let vary = |name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let args = [&["dataset", "vary", text(&corpus), "-o", text(&out)], more].concat();
        (String::from_utf8(must(&args).stdout).unwrap(), out)
    };
    let listed = |file: &Path| String::from_utf8(must(&["dataset", "inspect", text(file)]).stdout).unwrap();
    let shown = |file: &Path, name: &str| {
        String::from_utf8(must(&["dataset", "inspect", text(file), name, "--json"]).stdout).unwrap()
    };
    let (said, starred) = vary("s.h5", &[]);
    // A file that holds the time of day would be another one by now.
    std::thread::sleep(std::time::Duration::from_millis(1100));
    let (_, again) = vary("t.h5", &[]);
    let tests: Vec<String> = listed(&corpus)
        .lines()
        .filter(|l| l.contains("  test_"))
        .map(|l| l.split_whitespace().next().unwrap().to_owned())
        .collect();
    assert!(!tests.is_empty() && said.contains(&format!("12 assets, {} of them varied", tests.len())), "{said}");
    assert_eq!(listed(&starred), listed(&corpus), "names, splits and sizes stay");
    assert!(fs::read(&starred).unwrap() == fs::read(&again).unwrap(), "same seed, same bytes");
    assert!(shown(&starred, &tests[0]).contains("varied by augment/unirig_starred.toml with seed 0"));
    must(&["dataset", "verify", text(&starred)]);
    // A recipe of one's own, for another split.
    let recipe = dir.path().join("own.toml");
    fs::write(&recipe, "[rotate]\nprobability = 1.0\ndegrees = 20.0\n").unwrap();
    let set = ["--set", "rotate.degrees=5.0"];
    let (said, own) =
        vary("u.h5", &[&["--recipe", text(&recipe), "--split", "train", "--seed", "3"], &set[..]].concat());
    let trained =
        listed(&own).lines().find(|l| l.contains("  train")).unwrap().split_whitespace().next().unwrap().to_owned();
    assert!(shown(&own, &trained).contains("own.toml (rotate.degrees=5.0) with seed 3"));
    assert!(!said.contains(" 0 of them"), "{said}");
    for (more, wanted) in [
        (["--split", "nowhere"], "no split `nowhere`"),
        (["--set", "pose.degrees=900"], "pose.degrees"),
        (["--set", "poze=1"], "poze"),
    ] {
        let out = dir.path().join("no.h5");
        let said = refusal(&mut riglab(&[&["dataset", "vary", text(&corpus), "-o", text(&out)], &more[..]].concat()));
        assert!(said.contains(wanted) && !out.exists(), "{said}");
    }
    let said = refusal(&mut riglab(&["dataset", "vary", text(&corpus), "-o", text(&corpus)]));
    assert!(said.contains("give another file"), "{said}");
}

#[test]
fn options_that_cannot_hold_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let to = |name: &str| dir.path().join(name);
    let wrong = |args: &[&str], word: &str| {
        let said = refusal(&mut riglab(args));
        assert!(said.contains(word), "{said}");
    };
    wrong(&["convert", text(creature), text(&to("a.glb")), "--item", "1"], "no asset 1");
    wrong(&["convert", text(creature), text(&to("a.obj")), "--influences", "4"], "--influences");
    wrong(&["strip", text(creature), text(&to("a.fbx"))], "only GLB");
    wrong(&["dataset", "import", text(creature), "-o", text(&to("a.h5"))], "a file; give the folder");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    // A split file that names nothing of the folder leaves every asset without a split: told.
    fs::write(to("split.json"), r#"{"train": ["other.glb"]}"#).unwrap();
    let made = to("made");
    let out = must(&["dataset", "import", text(&made), "-o", text(&to("a.h5")), "--split", text(&to("split.json"))]);
    assert!(String::from_utf8_lossy(&out.stderr).contains("names none of the assets"));
}

#[cfg(target_os = "linux")]
#[test]
fn an_output_that_takes_no_more_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let out = riglab(&["inspect", text(creature)]).stdout(full).output().unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(said.contains("takes no more") && !said.contains("panicked"), "{said}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_import_leaves_nothing_behind() {
    use rustix::process::Signal;
    // As shells and schedulers count.
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        interrupt_import(signal, code);
    }
}

#[cfg(unix)]
fn interrupt_import(signal: rustix::process::Signal, interrupted: i32) {
    use std::time::{Duration, Instant};
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("made");
    creatures(&made, 40);
    let out = dir.path().join("out");
    fs::create_dir(&out).unwrap();
    let mut import = riglab(&["dataset", "import", text(&made), "-o", text(&out.join("c.h5"))]).spawn().unwrap();
    let start = Instant::now();
    // As soon as the corpus has been begun.
    while fs::read_dir(&out).unwrap().count() == 0 && start.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(1));
    }
    rustix::process::kill_process(rustix::process::Pid::from_child(&import), signal).unwrap();
    let code = import.wait().unwrap().code();
    let left: Vec<_> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name()).collect();
    match code {
        Some(code) if code == interrupted => assert!(left.is_empty(), "{left:?}"),
        // It was done before the signal came.
        code => assert_eq!((code, left), (Some(0), vec!["c.h5".into()])),
    }
}

#[cfg(unix)]
#[test]
fn what_nohup_started_goes_on_when_the_terminal_is_gone() {
    use rustix::process::{Pid, Signal, kill_process};
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("made");
    // As nohup does it.
    let of = ["synth", "-o", text(&made), "--count", "20", "--triangles", "400..800"];
    let synth = riglab(&of);
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]).arg(synth.get_program()).args(synth.get_args());
    let mut child = shell.spawn().unwrap();
    while fs::read_dir(&made).map_or(0, Iterator::count) == 0 {
        assert_eq!(child.try_wait().unwrap(), None, "it is not done yet");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    kill_process(Pid::from_child(&child), Signal::HUP).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(
        fs::read_dir(&made).unwrap().filter(|e| text(&e.as_ref().unwrap().path()).ends_with(".glb")).count(),
        20
    );
}

#[test]
fn a_folder_is_converted_below_itself_as_often_as_one_likes() {
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("made");
    creatures(&made, 2);
    fs::create_dir(made.join("sub")).unwrap();
    fs::write(made.join("sub/scan.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let out = made.join("out");
    let convert = |into: &Path| must(&["convert", text(&made), text(into), "--to", "glb"]);
    let said = String::from_utf8(convert(&out).stderr).unwrap();
    assert!(said.contains("not converted") && said.contains("sub/scan.obj"), "{said}");
    let again = convert(&out);
    let said = String::from_utf8(again.stderr).unwrap();
    assert!(said.contains("not taken as input: 2 files in the output folder"), "{said}");
    assert!(String::from_utf8_lossy(&again.stdout).starts_with("2 written"));
    // And the list of what they are.
    assert!(fs::read_dir(&out).unwrap().count() == 3 && out.join("manifest.json").is_file());
    // Into itself in another format, too.
    for format in ["rignet", "fbx", "unirig"] {
        let convert = || must(&["convert", text(&made), text(&made), "--to", format]);
        convert();
        let there = || fs::read_dir(&made).unwrap().count();
        let before = there();
        let said = String::from_utf8(convert().stderr).unwrap();
        assert!(said.contains(&format!("of {format} that riglab wrote")), "{said}");
        assert_eq!(there(), before, "{format}");
        let kept = ["glb", "json", "out", "sub"];
        for entry in fs::read_dir(&made).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_file() && !kept.iter().any(|ending| entry.extension().is_some_and(|e| e == *ending)) {
                fs::remove_file(entry).unwrap();
            }
        }
    }
    // Nowhere to write is told before anything is read.
    let file = dir.path().join("file");
    fs::write(&file, "").unwrap();
    let said = refusal(&mut riglab(&["convert", text(&made), text(&file.join("out/")), "--to", "glb"]));
    assert!(said.contains("nothing can be written into") && !said.contains("scan.obj: "), "{said}");
}

#[test]
fn a_file_keeps_its_name_where_others_would_take_it() {
    let dir = tempfile::tempdir().unwrap();
    let (made, both) = (dir.path().join("made"), dir.path().join("both"));
    let [first, second] = &creatures(&made, 2)[..] else { panic!("two") };
    fs::create_dir(&both).unwrap();
    must(&["convert", text(first), text(&both.join("a.fbx"))]);
    fs::copy(second, both.join("a.glb")).unwrap();
    fs::write(both.join("scan.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let (corpus, out) = (dir.path().join("c.h5"), dir.path().join("out"));
    let said = String::from_utf8(must(&["dataset", "import", text(&both), "-o", text(&corpus)]).stderr).unwrap();
    assert!(said.contains("not imported, as their formats hold no rig: scan.obj; --meshes"), "{said}");
    let joints = |file: &Path| {
        let shown = inspected(file);
        let all = shown["joints"].as_array().unwrap().iter().map(|joint| joint["head"].to_string());
        let mut all: Vec<String> = all.collect();
        all.sort();
        all
    };
    assert_ne!(joints(first), joints(second));
    for from in [&corpus, &both] {
        let said = String::from_utf8(must(&["convert", text(from), text(&out), "--to", "glb"]).stderr).unwrap();
        assert!(said.contains("a.fbx: written as ") && said.contains("a-2.glb, as another"), "{said}");
        for (written, of) in [("a.glb", second), ("a-2.glb", first)] {
            assert_eq!(joints(&out.join(written)), joints(of), "{written} of {}", from.display());
        }
        fs::remove_dir_all(&out).unwrap();
    }
}

#[test]
fn what_is_read_is_spared_in_every_format() {
    let dir = tempfile::tempdir().unwrap();
    let creature = &creatures(&dir.path().join("made"), 1)[0];
    let path = |name: &str| dir.path().join(name);
    for (format, name) in [("rignet", "a_rig.txt"), ("anymate", "a.pt"), ("articulation-xl", "a.npz")] {
        must(&["convert", text(creature), text(&path(name)), "--to", format]);
        let before = fs::read(path(name)).unwrap();
        let said = refusal(&mut riglab(&["convert", text(&path(name)), text(&path(name)), "--to", format]));
        assert!(said.contains(name) && said.contains("is the input"), "{said}");
        assert_eq!(fs::read(path(name)).unwrap(), before);
    }
    // The other half of a pair, too.
    let mesh = fs::read(path("a.obj")).unwrap();
    let said = refusal(&mut riglab(&["convert", text(&path("a_rig.txt")), text(&path("a.obj"))]));
    assert!(said.contains("a.obj"), "{said}");
    assert_eq!(fs::read(path("a.obj")).unwrap(), mesh);
    // Nor is someone's own mesh, where there is no text that it belongs to; a pair is written again.
    fs::write(path("own.obj"), "v 0 0 0\n").unwrap();
    let said = refusal(&mut riglab(&["convert", text(creature), text(&path("own_rig.txt")), "--to", "rignet"]));
    assert!(said.contains("own.obj") && fs::read(path("own.obj")).unwrap() == b"v 0 0 0\n", "{said}");
    let said = must(&["convert", text(creature), text(&path("a_rig.txt")), "--to", "rignet"]).stdout;
    let said = String::from_utf8(said).unwrap();
    assert!(said.contains("a_rig.txt") && said.contains("a.obj"), "both are named: {said}");
    // A bare model becomes a GLB, and a name without an ending is none.
    fs::write(path("b.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n").unwrap();
    let said = must(&["convert", text(&path("b.obj")), text(&path("b.glb"))]).stderr;
    let said = String::from_utf8(said).unwrap();
    assert!(!said.contains("not written"), "its looks come along: {said}");
    assert_eq!(said.matches("only 1 triangle").count(), 1, "told once: {said}");
    must(&["convert", text(&path("a.obj")), text(&path("bare.glb"))]);
    let shown = String::from_utf8(must(&["inspect", text(&path("bare.glb"))]).stdout).unwrap();
    assert!(shown.contains("vertices"), "{shown}");
    let said = refusal(&mut riglab(&["convert", text(creature), text(&path("none")), "--to", "puppeteer"]));
    assert!(said.contains("no ending") && !path("none").exists(), "{said}");
    // A corpus takes no other file's place.
    let made = path("made");
    let said = refusal(&mut riglab(&["dataset", "import", text(&made), "-o", text(&path("a.npz"))]));
    assert!(said.contains("a.npz") && said.contains("no corpus"), "{said}");
    assert!(fs::read(path("a.npz")).unwrap().starts_with(b"PK"));
}

#[cfg(unix)]
#[test]
fn links_are_followed_and_pairs_of_one_mesh_kept_apart() {
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("made");
    let creature = &creatures(&made, 1)[0];
    let link = dir.path().join("link.glb");
    let real = dir.path().join("real.glb");
    fs::copy(creature, &real).unwrap();
    std::os::unix::fs::symlink(&real, &link).unwrap();
    must(&["strip", "--in-place", text(&link), text(&link)]);
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(inspected(&real)["joints"], Value::Array(vec![]));
    // `x.glb` and `x_rig.txt` would both have `x.obj` as their mesh.
    let pairs = dir.path().join("in");
    fs::create_dir(&pairs).unwrap();
    fs::copy(creature, pairs.join("x.glb")).unwrap();
    must(&["convert", text(creature), text(&pairs.join("x_rig.txt"))]);
    let out = dir.path().join("out");
    must(&["convert", text(&pairs), text(&out), "--to", "puppeteer"]);
    let texts = fs::read_dir(&out).unwrap().map(|e| e.unwrap().path());
    let texts: Vec<_> = texts.filter(|p| p.extension().is_some_and(|e| e == "txt")).collect();
    assert_eq!(texts.len(), 2);
    texts.iter().for_each(|text_file| drop(must(&["inspect", text(text_file)])));
}

#[test]
fn rigs_are_judged_by_rewards_without_true_ones() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let made = creatures(&path("made"), 3);
    must(&["convert", text(&path("made")), text(&path("fbx/")), "--to", "fbx"]);
    let json = |args: &[&str]| -> Value {
        let out = must(&[&["rewards", "--json", "--set", "reward.resolution=48"], args].concat());
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let both = json(&[&format!("glb={}", text(&path("made"))), &format!("fbx={}", text(&path("fbx")))]);
    let totals = |k: usize| {
        let rigs = both["systems"][k]["rigs"].as_array().unwrap().iter();
        rigs.map(|rig| rig["total"].as_f64().unwrap()).collect::<Vec<f64>>()
    };
    // Of 8 at most; every part of a true rig is worth something.
    assert!(totals(0).len() == 3 && totals(0).iter().all(|r| (4.0..8.0).contains(r)), "{both}");
    let rig = &both["systems"][0]["rigs"][0];
    assert!(["coverage", "containment", "skinning", "motion"].iter().all(|r| rig[r].as_f64() > Some(0.1)), "{rig}");
    // The format changes a rig by rounding alone.
    assert!(totals(0).iter().zip(totals(1)).all(|(a, b)| (a - b).abs() < 1e-3), "{both}");
    assert_eq!(both["second_minus_first"]["R"]["n"], 3);
    let without = json(&["--set", "reward.weights.coverage=0", text(&made[0])]);
    let (with, without) = (totals(0)[0], without["systems"][0]["rigs"][0]["total"].as_f64().unwrap());
    assert!((with - 5.0 * rig["coverage"].as_f64().unwrap() - without).abs() < 1e-9, "{with} {without}");

    // A table of rewards replaces another one and nothing else; what has no rig is named.
    let csv = path("rewards.csv");
    (0..2).for_each(|_| drop(must(&["rewards", text(&path("made")), "-o", text(&csv)])));
    assert_eq!(fs::read_to_string(&csv).unwrap().lines().count(), 4);
    fs::write(path("mine.csv"), "a,b\n").unwrap();
    let said = refusal(&mut riglab(&["rewards", text(&made[0]), "-o", text(&path("mine.csv"))]));
    assert!(said.contains("no table of rewards"), "{said}");
    must(&["strip", text(&made[0]), text(&path("bare.glb"))]);
    let said = refusal(&mut riglab(&["rewards", text(&path("bare.glb"))]));
    assert!(said.contains("not judged: bare.glb"), "{said}");
    fs::create_dir(path("empty")).unwrap();
    let said = refusal(&mut riglab(&["rewards", text(&path("empty"))]));
    assert!(said.contains("empty: no rig to judge: no rigged file below it"), "{said}");
}
