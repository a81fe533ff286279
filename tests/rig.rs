//! `riglab rig` and `riglab skin`: models in, rigged models out.

mod binary;

use std::fs;
use std::path::{Path, PathBuf};

use binary::{must, refusal, riglab, text};
use serde_json::Value;

/// Rigged creatures, and the same without their rigs.
fn creatures(dir: &Path, count: &str) -> Vec<(PathBuf, PathBuf)> {
    let files = dir.join("rigged");
    must(&["synth", "-o", text(&files), "--count", count, "--plans", "biped,quadruped", "--triangles", "1500..2500"]);
    fs::create_dir_all(dir.join("bare")).unwrap();
    let mut all: Vec<PathBuf> = fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).collect();
    all.retain(|p| p.extension().is_some_and(|e| e == "glb"));
    all.sort();
    all.into_iter()
        .map(|file| {
            let bare = dir.join("bare").join(file.file_name().unwrap());
            must(&["strip", text(&file), text(&bare)]);
            (file, bare)
        })
        .collect()
}

fn inspect(file: &Path) -> Value {
    serde_json::from_slice(&must(&["inspect", text(file), "--json", "--all-vertices"]).stdout).unwrap()
}

/// Heads of all joints by name, in the file's units.
fn joints(v: &Value) -> Vec<(String, [f64; 3])> {
    let joint = |j: &Value| {
        let head = j["head"].as_array().unwrap();
        (j["name"].as_str().unwrap().to_string(), std::array::from_fn(|k| head[k].as_f64().unwrap()))
    };
    v["joints"].as_array().unwrap().iter().map(joint).collect()
}

/// It is a rig: a tree with one root, and weights that sum to 1 at every vertex.
fn sound(file: &Path) -> Value {
    let v = inspect(file);
    let all = v["joints"].as_array().unwrap();
    assert!(!all.is_empty());
    assert_eq!(all.iter().filter(|j| j["parent"].is_null()).count(), 1, "{}", file.display());
    let samples = v["samples"].as_array().unwrap();
    assert_eq!(samples.len() as u64, v["vertices"].as_u64().unwrap());
    for sample in samples {
        let weights: Vec<f64> = sample["weights"].as_object().unwrap().values().map(|w| w.as_f64().unwrap()).collect();
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-3 && weights.len() <= 4, "{sample}");
    }
    v
}

#[test]
fn a_model_is_rigged_by_what_comes_with_the_program() {
    let dir = tempfile::tempdir().unwrap();
    let bare = &creatures(dir.path(), "2")[0].1;
    let before = fs::read(bare).unwrap();
    let make = |name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let said = must(&[&["rig", text(bare), "-o", text(&out), "--json"], more].concat()).stdout;
        let said: Value = serde_json::from_slice(&said).unwrap();
        assert_eq!(said["joints"], sound(&out)["joints"].as_array().unwrap().len());
        assert_eq!(said["out"], text(&out));
        fs::read(out).unwrap()
    };
    let told = ["--samples", "64", "--skins", "8", "--temperature", "1"];
    assert!(make("a.glb", &[]) == make("b.glb", &told), "same seed, same bytes, and as its config says");
    let mean = make("m.glb", &["--skins", "3"]);
    assert!(mean == make("n.glb", &["--skins", "3"]) && mean != make("o.glb", &["--skins", "1"]));
    let drawn = make("c.glb", &["--samples", "4", "--seed", "3"]);
    assert!(drawn == make("d.glb", &["--samples", "4", "--seed", "3"]));
    assert!(drawn != make("e.glb", &["--samples", "4", "--seed", "4"]));
    assert!(fs::read(bare).unwrap() == before, "the input stays");
    let card = String::from_utf8(must(&["checkpoint", "show"]).stdout).unwrap();
    assert!(card.contains("Licence") && card.contains("parameters"), "{card}");
}

#[test]
fn a_given_skeleton_stays_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    for (rigged, bare) in creatures(dir.path(), "4") {
        let truth = joints(&inspect(&rigged));
        let out = dir.path().join("out.glb");
        for args in [
            vec!["skin", text(&rigged), "-o", text(&out), "--skins", "2"],
            vec!["rig", text(&rigged), "-o", text(&out), "--skins", "1", "--skeleton", "keep"],
            vec!["rig", text(&bare), "-o", text(&out), "--skins", "1", "--skeleton", text(&rigged)],
        ] {
            must(&args);
            let made = joints(&sound(&out));
            assert_eq!(made.len(), truth.len());
            for (name, head) in &truth {
                let (_, own) = made.iter().find(|(n, _)| n == name).expect("every joint is there");
                assert!((0..3).all(|k| (own[k] - head[k]).abs() < 1e-4), "{name}: {own:?} {head:?}");
            }
        }
    }
}

#[test]
fn a_skeleton_that_is_begun_is_completed() {
    let dir = tempfile::tempdir().unwrap();
    let (rigged, bare) = &creatures(dir.path(), "2")[0];
    let truth = inspect(rigged);
    let (all, heads) = (truth["joints"].as_array().unwrap(), joints(&truth));
    // The first half, parents before children, as a person may write it.
    let given = all.len() / 2;
    let mut lines = vec![format!("root {}", heads[0].0)];
    for (joint, (name, [x, y, z])) in all[..given].iter().zip(&heads) {
        lines.push(format!("joints {name} {x} {y} {z}"));
        lines.extend(joint["parent"].as_u64().map(|parent| format!("hier {} {name}", heads[parent as usize].0)));
    }
    let (begun, out) = (dir.path().join("begun.txt"), dir.path().join("out.glb"));
    fs::write(&begun, lines.join("\n")).unwrap();
    let complete = |model: &Path, from: &str| {
        let said = must(&["rig", text(model), "-o", text(&out), "--skeleton", from, "--complete", "--json"]).stdout;
        let said: Value = serde_json::from_slice(&said).unwrap();
        (said["added"].as_u64().unwrap() as usize, sound(&out))
    };
    for (model, from, count) in [(bare, text(&begun), given), (rigged, "keep", all.len())] {
        let (added, made) = complete(model, from);
        let own = joints(&made);
        assert_eq!(own.len(), count + added);
        assert!(count == all.len() || added > 0, "half a creature lacks something");
        for (name, head) in &heads[..count] {
            let (_, found) = own.iter().find(|(n, _)| n == name).expect("every given joint is there");
            assert!((0..3).all(|k| (found[k] - head[k]).abs() < 1e-4), "{name}: {found:?} {head:?}");
        }
        let parent = |of: &Value, name: &str| {
            let all = of["joints"].as_array().unwrap();
            let joint = all.iter().find(|joint| joint["name"] == name).unwrap();
            joint["parent"].as_u64().map(|p| all[p as usize]["name"].clone())
        };
        assert!(heads[..count].iter().all(|(name, _)| parent(&made, name) == parent(&truth, name)));
    }
    let mut wrong = riglab(&["rig", text(bare), "-o", text(&out), "--complete"]);
    assert!(refusal(&mut wrong).contains("--skeleton"));
}

#[test]
fn the_best_of_several_is_told_by_likelihood_or_rewards() {
    let dir = tempfile::tempdir().unwrap();
    let bare = &creatures(dir.path(), "2")[0].1;
    let out = dir.path().join("out.glb");
    let rig = |more: &[&str]| {
        let args = [&["rig", text(bare), "-o", text(&out), "--samples", "4", "--seed", "3"], more].concat();
        String::from_utf8(must(&args).stdout).unwrap()
    };
    let line = |rank: &str| serde_json::from_str::<Value>(&rig(&["--rank", rank, "--json"])).unwrap();
    let of = |v: &Value, key: &str| -> Vec<f64> {
        let each = v["samples"].as_array().unwrap().iter();
        each.map(|s| s.pointer(key).and_then(Value::as_f64).unwrap_or(f64::NAN)).collect()
    };
    let best = |all: &[f64]| (0..all.len()).max_by(|&a, &b| all[a].total_cmp(&all[b])).unwrap() as u64;
    let (likely, worth) = (line("likelihood"), line("rewards"));
    assert_eq!(likely["sample"].as_u64(), Some(best(&of(&likely, "/likelihood"))));
    assert_eq!(worth["sample"].as_u64(), Some(best(&of(&worth, "/rewards/total"))));
    assert_eq!(of(&worth, "/likelihood"), of(&likely, "/likelihood"));
    assert!(likely["rewards"].is_null() && worth["rewards"]["coverage"].as_f64().unwrap() > 0.0);
    sound(&out);
    let said = rig(&["--rank", "rewards"]);
    assert!(said.contains("of 4 by rewards: R = ") && said.contains("containment R_vk"), "{said}");
}

#[test]
fn joints_of_another_file_land_in_a_model_that_lies() {
    let dir = tempfile::tempdir().unwrap();
    let (rigged, bare) = &creatures(dir.path(), "2")[0];
    let truth = joints(&inspect(rigged));
    // The model as a program with z up leaves it: as an OBJ, which is stood up, and as a GLB, which keeps its axes.
    let up = inspect(bare);
    let mut obj = String::new();
    let lying = |p: [f64; 3]| [p[0], -p[2], p[1]];
    for sample in up["samples"].as_array().unwrap() {
        let p = sample["position"].as_array().unwrap();
        let [x, y, z] = lying(std::array::from_fn(|k| p[k].as_f64().unwrap()));
        obj += &format!("v {x} {y} {z}\n");
    }
    (1..up["vertices"].as_u64().unwrap() - 1).for_each(|v| obj += &format!("f {v} {} {}\n", v + 1, v + 2));
    let (model, out) = (dir.path().join("lying.obj"), dir.path().join("out.glb"));
    fs::write(&model, obj).unwrap();
    let near = |wanted: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let made = joints(&inspect(&out));
        for (name, head) in &truth {
            let (_, own) = made.iter().find(|(n, _)| n == name).expect("every joint is there");
            let head = wanted(*head);
            assert!((0..3).all(|k| (own[k] - head[k]).abs() < 1e-4), "{name}: {own:?} {head:?}");
        }
    };
    let skin = |model: &Path, up: &[&str]| {
        must(
            &[&["skin", text(model), "-o", text(&out), "--skins", "1", "--skeleton", text(rigged), "--up"], up]
                .concat(),
        );
        near(&|p| p);
    };
    // The joints' file stands, the model's lies: the model is stood up, and they are where they belong.
    skin(&model, &["z"]);
    skin(&model, &["z", "--skeleton-up", "y"]);
    // Both of one space, said to lie: turned alike, and back.
    skin(bare, &["-y"]);
    let mut wrong = riglab(&["skin", text(rigged), "-o", text(&out), "--skeleton-up", "y"]);
    assert!(refusal(&mut wrong).contains("--skeleton"));
}

/// A mesh of an OBJ as a text PLY and a text STL.
fn as_scan_and_print(obj: &str) -> [String; 2] {
    let rows = |word: &'static str| obj.lines().filter_map(move |line| line.strip_prefix(word));
    let (vertices, faces): (Vec<&str>, Vec<&str>) = (rows("v ").collect(), rows("f ").collect());
    let corners = |face: &str| -> Vec<usize> {
        let first = |word: &str| word.split('/').next().unwrap().parse::<usize>().unwrap() - 1;
        face.split_whitespace().map(first).collect()
    };
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n{}\n",
        vertices.len(),
        faces.len(),
        vertices.join("\n")
    );
    let mut stl = String::from("solid creature\n");
    for face in faces {
        let [a, b, c] = corners(face)[..] else { panic!("{face}") };
        ply += &format!("3 {a} {b} {c}\n");
        let lines: String = [a, b, c].map(|v| format!("vertex {}\n", vertices[v])).concat();
        stl += &format!("facet normal 0 0 0\nouter loop\n{lines}endloop\nendfacet\n");
    }
    [ply, stl + "endsolid creature\n"]
}

#[test]
fn scans_and_prints_are_rigged_as_an_obj_is() {
    let dir = tempfile::tempdir().unwrap();
    let bare = creatures(dir.path(), "1").remove(0).1;
    let path = |name: &str| dir.path().join(name);
    must(&["convert", text(&bare), text(&path("a.obj"))]);
    let [ply, stl] = as_scan_and_print(&fs::read_to_string(path("a.obj")).unwrap());
    let (input, out) = (path("scans"), path("out"));
    fs::create_dir(&input).unwrap();
    fs::write(input.join("scan.PLY"), ply).unwrap();
    fs::write(input.join("print.stl"), stl).unwrap();
    fs::copy(path("a.obj"), input.join("mesh.obj")).unwrap();
    must(&["rig", text(&input), "-o", text(&out), "--samples", "1", "--skins", "1"]);
    let triangles = inspect(&bare)["triangles"].clone();
    for (name, made) in [("scan.PLY", "scan.glb"), ("print.stl", "print.glb"), ("mesh.obj", "mesh.glb")] {
        assert_eq!(sound(&out.join(made))["triangles"], triangles, "{made}");
        must(&["view", text(&input.join(name)), "--png", text(&path("seen.png"))]);
        must(&["convert", text(&input.join(name)), text(&path("again.obj"))]);
        must(&["convert", text(&input.join(name)), text(&path("again.glb"))]);
        assert_eq!(inspect(&path("again.glb"))["triangles"], triangles, "{name}");
    }
    let corpus = path("meshes.h5");
    let said = must(&["dataset", "import", text(&input), "-o", text(&corpus), "--meshes"]).stdout;
    assert!(String::from_utf8(said).unwrap().contains("3 assets"));
}

#[test]
fn a_folder_is_rigged_file_by_file() {
    let dir = tempfile::tempdir().unwrap();
    creatures(dir.path(), "2");
    let (input, out) = (dir.path().join("bare"), dir.path().join("out"));
    fs::write(input.join("broken.obj"), "f 1 2 3\n").unwrap();
    let output = riglab(&["rig", text(&input), "-o", text(&out), "--samples", "8", "--skins", "1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "one of them failed");
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("2 rigged") && said.contains("1 left out"), "{said}");
    assert!(said.contains("% of the model's size apart"), "{said}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("broken.obj"));
    let made: Vec<PathBuf> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(made.len(), 2);
    made.iter().for_each(|file| drop(sound(file)));
    // Begun again, it goes on where it was.
    fs::remove_file(&made[0]).unwrap();
    let few = ["--samples", "1", "--skins", "1"];
    let again = [&["rig", text(&input), "-o", text(&out), "--skip-existing"][..], &few].concat();
    let kept = fs::metadata(&made[1]).unwrap().modified().unwrap();
    let said = String::from_utf8(riglab(&again).output().unwrap().stdout).unwrap();
    assert!(said.contains("1 rigged") && said.contains("1 already there"), "{said}");
    assert!(made[0].exists() && fs::metadata(&made[1]).unwrap().modified().unwrap() == kept);
    // What cannot be rigged is tried each time; without it there is nothing to do.
    fs::rename(input.join("broken.obj"), dir.path().join("broken.obj")).unwrap();
    let done = must(&again);
    let said = String::from_utf8(done.stdout).unwrap();
    assert_eq!(said, format!("nothing to do: all 2 results are there already in {}\n", out.display()));
    assert!(!String::from_utf8_lossy(&done.stderr).contains("rigging"), "no progress of nothing");
    let lines = String::from_utf8(must(&[&again[..], &["--json"]].concat()).stdout).unwrap();
    assert!(lines.lines().count() == 2 && lines.lines().all(|line| line.contains("is there already")), "{lines}");
    fs::rename(dir.path().join("broken.obj"), input.join("broken.obj")).unwrap();
    // Into the other format, too.
    let other = dir.path().join("fbx");
    riglab(&[&["rig", text(&input), "-o", text(&other), "--to", "fbx"][..], &few].concat()).output().unwrap();
    let rigged = |entry: fs::DirEntry| joints(&inspect(&entry.path())).len();
    let all: Vec<usize> = fs::read_dir(&other).unwrap().map(|entry| rigged(entry.unwrap())).collect();
    assert!(all.len() == 2 && all.iter().all(|joints| *joints > 1), "{all:?}");
    #[cfg(unix)]
    {
        // Whoever ends it is told how to go on.
        let third = dir.path().join("third");
        let mut child = riglab(&["rig", text(&input), "-o", text(&third)]);
        let mut child = child.stderr(std::process::Stdio::piped()).spawn().unwrap();
        while fs::read_dir(&third).map_or(0, Iterator::count) == 0 {
            assert_eq!(child.try_wait().unwrap(), None, "it is not done yet");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT).unwrap();
        let ended = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        let told = "of 3 models are done; the same command with --skip-existing goes on";
        assert!(ended.status.code() == Some(130) && said.contains(told), "{said}");
    }
    let one = dir.path().join("one.glb");
    let said = refusal(&mut riglab(&["rig", text(&made[0]), "-o", text(&one), "--skip-existing"]));
    assert!(said.contains("is for a folder of models"), "{said}");
    // A name that is no UTF-8 ends neither the folder nor its lines.
    let odd = <std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(b"l\xfc.glb");
    let first = fs::read_dir(&input).unwrap().map(|e| e.unwrap().path()).find(|p| !p.ends_with("broken.obj")).unwrap();
    fs::rename(first, input.join(odd)).unwrap();
    std::os::unix::fs::symlink("nowhere", input.join("dangling.glb")).unwrap();
    let said =
        riglab(&[&["rig", text(&input), "-o", text(&out), "--json"][..], &few].concat()).output().unwrap().stdout;
    let all: Vec<Value> = String::from_utf8(said).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    // What cannot be looked at is left out, too.
    let (unread, lines): (Vec<Value>, Vec<Value>) =
        all.into_iter().partition(|line| line["file"].as_str().unwrap().ends_with("dangling.glb"));
    assert!(unread.len() == 1 && unread[0]["error"].is_string(), "{unread:?}");
    let failed: Vec<&Value> = lines.iter().filter(|l| l["error"].is_string()).collect();
    assert!(lines.len() == 3 && failed.len() == 1, "{lines:?}");
    assert!(failed[0]["file"].as_str().unwrap().ends_with("broken.obj"));
    let apart = |line: &&Value| line["error"].is_null() && !line["apart"].is_null();
    assert_eq!(lines.iter().filter(apart).count(), 0, "one draw has no others");
}

#[test]
fn a_result_of_another_model_is_not_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(dir.path(), "2");
    let (input, few) = (dir.path().join("in"), ["--samples", "1", "--skins", "1"]);
    fs::create_dir(&input).unwrap();
    must(&["convert", text(&all[0].1), text(&input.join("fox.obj"))]);
    for (format, ending) in [("glb", "glb"), ("fbx", "fbx")] {
        let out = dir.path().join(format);
        let again = || {
            let args = ["rig", text(&input), "-o", text(&out), "--to", format, "--skip-existing", "--json"];
            let said = String::from_utf8(must(&[&args[..], &few].concat()).stdout).unwrap();
            let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
            lines.iter().filter(|line| line["skipped"].is_string()).count()
        };
        let of = |name: &str| inspect(&out.join(name))["triangles"].clone();
        // Of two that are called alike, the one that comes later takes the name of the first.
        let other = input.join(format!("fox.{ending}"));
        assert_eq!((again(), again()), (0, 1));
        assert_eq!(of(&format!("fox.{ending}")), inspect(&all[0].1)["triangles"]);
        must(&["convert", text(&all[1].1), text(&other)]);
        assert_eq!((again(), again()), (0, 2));
        assert_eq!(of(&format!("fox.{ending}")), inspect(&all[1].1)["triangles"]);
        assert_eq!(of(&format!("fox.obj.{ending}")), inspect(&all[0].1)["triangles"]);
        // What was cut off is made again.
        let cut = out.join(format!("fox.{ending}"));
        let bytes = fs::read(&cut).unwrap();
        fs::write(&cut, &bytes[..bytes.len() - 100]).unwrap();
        assert_eq!(again(), 1);
        assert_eq!(fs::read(&cut).unwrap(), bytes);
        fs::remove_file(other).unwrap();
    }
}

#[test]
fn a_vrm_without_data_of_vrm_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let bare = creatures(dir.path(), "1").remove(0).1;
    let [plain, out] = ["plain.vrm", "out.vrm"].map(|name| dir.path().join(name));
    fs::copy(bare, &plain).unwrap();
    let said = must(&["rig", text(&plain), "-o", text(&out), "--samples", "1", "--skins", "1"]).stderr;
    let said = String::from_utf8(said).unwrap();
    assert!(said.contains("out.vrm is a plain GLB, as there is no data of VRM in it"), "{said}");
}

#[test]
fn the_file_of_the_skeleton_is_no_output() {
    let dir = tempfile::tempdir().unwrap();
    let (rigged, bare) = creatures(dir.path(), "1").remove(0);
    let (bones, before) = (dir.path().join("out/a.glb"), fs::read(&rigged).unwrap());
    for (input, name) in [("in", "out"), ("in/a.glb", "out/a.glb")] {
        fs::create_dir_all(dir.path().join("in")).unwrap();
        fs::create_dir_all(dir.path().join("out")).unwrap();
        fs::copy(&bare, dir.path().join("in/a.glb")).unwrap();
        fs::copy(&rigged, &bones).unwrap();
        let [input, out] = [input, name].map(|name| dir.path().join(name));
        let said = refusal(&mut riglab(&["rig", text(&input), "-o", text(&out), "--skeleton", text(&bones)]));
        assert!(said.contains("inputs are never changed") && fs::read(&bones).unwrap() == before, "{said}");
    }
}

#[test]
fn what_cannot_be_rigged_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (rigged, bare) = creatures(dir.path(), "1").remove(0);
    let path = |name: &str| dir.path().join(name);
    fs::write(path("points.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\n").unwrap();
    let points = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    fs::write(path("points.ply"), format!("ply\nformat ascii 1.0\n{points}")).unwrap();
    fs::write(path("cut.stl"), [255; 100]).unwrap();
    fs::write(path("no.safetensors"), b"no checkpoint").unwrap();
    let out = path("out.glb");
    for (args, wanted) in [
        (vec!["rig", text(&path("points.obj")), "-o", text(&out)], "points.obj"),
        (vec!["rig", text(&path("points.ply")), "-o", text(&out)], "points.ply: the file has no mesh with triangles"),
        (vec!["rig", text(&path("cut.stl")), "-o", text(&out)], "cut.stl: cannot be read as STL"),
        (vec!["rig", text(&path("none.glb")), "-o", text(&out)], "none.glb"),
        (vec!["rig", text(&bare), "-o", text(&bare)], "never changed"),
        (vec!["rig", text(&bare), "-o", "out.npz"], "only GLB"),
        (vec!["skin", text(&bare), "-o", text(&out)], "no skeleton to keep"),
        (vec!["rig", text(&bare), "-o", text(&out), "--template", "cat"], "there is no template `cat`"),
        (
            vec!["rig", text(&rigged), "-o", text(&out), "--skeleton", "keep", "--names", "vrm"],
            "keeps its joints' names",
        ),
        (
            vec!["rig", text(&bare), "-o", text(&out), "--checkpoint", text(&path("no.safetensors"))],
            "not a riglab model",
        ),
        (vec!["rig", text(&bare), "-o", text(&out), "--checkpoint", text(&rigged)], "not a riglab model"),
        (vec!["rig", text(&bare), "-o", text(&out), "--device", "cuda:9"], "GPUs"),
        (vec!["rig", text(&bare), "-o", text(&out), "--samples", "0"], "is not in 1..=4096"),
        (vec!["rig", text(&bare), "-o", text(&out), "--max-triangles", "10"], "triangles"),
    ] {
        let said = refusal(&mut riglab(&args));
        assert!(said.contains(wanted), "{args:?}: {said}");
        assert!(!out.exists());
    }
    // As a line of JSON, too, whatever it is.
    for wrong in [["--template", "cat"], ["--names", "vrm"]] {
        let args = [&["rig", text(&bare), "-o", text(&out), "--json"][..], &wrong].concat();
        let args = if wrong[0] == "--names" { [&args[..], &["--skeleton", "keep"]].concat() } else { args };
        let said: Value = serde_json::from_slice(&riglab(&args).output().unwrap().stdout).unwrap();
        assert!(said["file"] == text(&bare) && said["error"].is_string(), "{said}");
    }
    // What is wrong for all models of a folder is told once, before the first.
    let (all, out) = (bare.parent().unwrap(), path("all"));
    fs::copy(&bare, all.join("again.glb")).unwrap();
    for (option, wanted) in
        [(["--template", "cat"], "there is no template `cat`"), (["--skeleton", "no.glb"], "no.glb")]
    {
        let said = refusal(&mut riglab(&[&["rig", text(all), "-o", text(&out)][..], &option].concat()));
        assert!(said.matches(wanted).count() == 1 && !said.contains("left out") && !out.exists(), "{said}");
    }
}

/// With an auto-encoder that is told what geometry alone says: trained, evaluated without any code, and rigged with.
#[test]
fn tokenrig_stands_on_an_auto_encoder_with_a_prior() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = binary::corpus_of(dir.path(), 8, "400..800");
    let path = |name: &str| dir.path().join(name);
    let (auto, run) = (path("auto"), path("run"));
    let corpora = format!("data.corpora=[{:?}]", text(&corpus));
    let train = |config: &str, run: &Path, sets: &[&str]| {
        let mut all = vec!["train", config, "--run", text(run), "--set", &corpora];
        sets.iter().for_each(|set| all.extend(["--set", set]));
        must(&all);
    };
    let tiny = "model={ extends = \"model/fsq_cvae/tiny.toml\", extensions = { bone_geometry = true, prior = true } }";
    let few = ["train.steps=6", "train.validate_every=6"];
    train("skintokens/fsq_cvae_with_prior.toml", &auto, &[&few[..], &[tiny, "eval.prefixes=[0, 4]"]].concat());
    let said = String::from_utf8(must(&["eval", text(&auto), "--json", "--pictures", "0"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let rows = evaluation["report"]["rows"].as_array().unwrap();
    let of = |tokens: u64| rows.iter().filter(|r| r["method"] == "rule" && r["tokens"] == tokens).count();
    assert!(of(0) > 0 && of(0) == of(4), "{rows:?}");

    // As one file, which a training takes as well as the folder.
    let file = path("auto.safetensors");
    must(&["checkpoint", "export", text(&auto), "-o", text(&file), "--half"]);
    let shown = String::from_utf8(must(&["checkpoint", "show", text(&file)]).stdout).unwrap();
    assert!(shown.contains("task fsq_cvae") && shown.contains("6 steps"), "{shown}");
    // Which becomes a run's folder again, to be evaluated.
    let again = path("auto-again");
    must(&["checkpoint", "export", text(&file), "-o", text(&again)]);
    let said = must(&["eval", text(&again), "--json", "--pictures", "0", "--set", &corpora]).stdout;
    let evaluation: Value = serde_json::from_slice(&said).unwrap();
    assert_eq!(evaluation["report"]["rows"].as_array().unwrap().len(), rows.len());
    let skin = format!("skin.run={:?}", text(&file));
    let model = "model={ extends = \"model/tokenrig/tiny.toml\", tell_region = true, tell_rule = true, tell_place = true, shape = { sorted = true } }";
    let small = ["sampling.rigs=4", "sampling.cloud.points=128", "sampling.variants=2", "eval.consensus=4"];
    let drawn = ["eval.validation_assets=2", "eval.skins=2", "eval.without_codes=0.5"];
    train("quickstart/tokenrig.toml", &run, &[&few[..], &[&skin, model], &small, &drawn].concat());
    // What is pooled is the model's, not the auto-encoder's own.
    let [pooled, alone] = ["eval.without_codes=0.5", "eval.without_codes=0"].map(|set| {
        let said = must(&["eval", text(&run), "--json", "--pictures", "0", "--set", set]).stdout;
        let evaluation: Value = serde_json::from_slice(&said).unwrap();
        let rows = evaluation["report"]["skin"].as_array().unwrap();
        let iou =
            |method: &str| rows.iter().find(|r| r["method"] == method).unwrap()["pooled"]["iou"].as_f64().unwrap();
        ["given: model", "given: auto-encoder"].map(iou)
    });
    assert!(pooled[0] > 0.1 && pooled[0] != alone[0] && pooled[1] == alone[1], "{pooled:?} {alone:?}");
    let bare = &creatures(dir.path(), "1")[0].1;
    must(&["rig", text(bare), "-o", text(&path("out.glb")), "--checkpoint", text(&run)]);
    sound(&path("out.glb"));

    // Codes that are told what lies near their joints, and a rule's codes, are told it wherever they are read.
    let refined = path("refined");
    let start = format!("start.model={:?}", text(&run));
    let rollout = "rollout={ meshes = 1, group = 2, epochs = 2, vertices = 48, precision = \"fp32\" }";
    let other = ["train.steps=1", "train.validate_every=1", "reward.resolution=32", "held_out.draws=1"];
    let few = ["eval.validation_assets=1", "eval.vertices=64", "train.precision=\"fp32\""];
    train("skintokens/grpo_quick.toml", &refined, &[&[start.as_str(), rollout], &other[..], &few].concat());
    let metrics = fs::read_to_string(refined.join("metrics.jsonl")).unwrap();
    let first: Value = serde_json::from_str(metrics.lines().next().unwrap()).unwrap();
    assert!(first["train/sampler_gap"].as_f64().unwrap() < 1e-4, "{first}");
}

/// UniRig's two stages one after the other, of runs and of files; or the first before what comes with the program.
#[test]
fn stages_of_unirig_rig_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = binary::corpus_of(dir.path(), 8, "400..800");
    let path = |name: &str| dir.path().join(name);
    let corpora = format!("data.corpora=[{:?}]", text(&corpus));
    let train = |config: &str, run: &Path, sets: &[&str]| {
        let mut all = vec!["train", config, "--run", text(run), "--set", &corpora, "--set", "train.steps=2"];
        sets.iter().for_each(|set| all.extend(["--set", set]));
        must(&all);
    };
    let (skeletons, weights) = (path("skeletons"), path("weights"));
    let limits =
        ["limits={ joints = 80, tokens = 480 }", "sampling.rigs=4", "eval.consensus=3", "eval.validation_assets=1"];
    let tiny = "model={ extends = \"model/unirig_skeleton/tiny.toml\" }";
    train("quickstart/unirig_skeleton.toml", &skeletons, &[&limits[..], &[tiny]].concat());
    let few =
        ["sampling={ rigs = 2, points = 192, queries = 96, pool = 256, resolution = 32 }", "eval.validation_assets=1"];
    let tiny = "model={ extends = \"model/unirig_skin/tiny.toml\" }";
    train("quickstart/unirig_skin.toml", &weights, &[&few[..], &[tiny, "eval.baseline_resolution=32"]].concat());
    let files = [path("s.safetensors"), path("w.safetensors")];
    for (run, file) in [&skeletons, &weights].into_iter().zip(&files) {
        must(&["checkpoint", "export", text(run), "-o", text(file)]);
    }

    let bare = &creatures(dir.path(), "1")[0].1;
    let rig = |name: &str, checkpoint: &Path, more: &[&str]| {
        let out = path(name);
        let all = ["rig", text(bare), "-o", text(&out), "--json", "--checkpoint", text(checkpoint)];
        let said: Value = serde_json::from_slice(&must(&[&all[..], more].concat()).stdout).unwrap();
        (said, joints(&sound(&out)), fs::read(&out).unwrap())
    };
    let (said, by_shipped, _) = rig("a.glb", &skeletons, &[]);
    assert!(said["weights_by"] == "tokenrig_small" && said["samples"].as_array().unwrap().len() == 3, "{said}");
    let both = ["--weights", text(&weights)];
    let (said, by_stages, bytes) = rig("b.glb", &skeletons, &both);
    assert_eq!(said["weights_by"], text(&weights));
    assert_eq!(by_shipped, by_stages, "the same skeleton, whatever holds the vertices");
    assert!(rig("c.glb", &skeletons, &both).2 == bytes, "same seed, same bytes");
    assert!(rig("d.glb", &skeletons, &[&both[..], &["--seed", "1"]].concat()).2 != bytes);
    assert!(rig("e.glb", &files[0], &["--weights", text(&files[1])]).2 == bytes, "files as their runs");
    let (_, named, _) = rig("f.glb", &skeletons, &["--template", "Mixamo", "--samples", "1"]);
    assert!(named.iter().any(|(name, _)| name.starts_with("mixamorig:")), "{named:?}");
    let made = |checkpoint: &Path, name: &str| {
        must(&["skin", text(&path("b.glb")), "-o", text(&path(name)), "--checkpoint", text(checkpoint)]);
        fs::read(path(name)).unwrap()
    };
    assert!(made(&weights, "g.glb") == made(&files[1], "h.glb"));
    for (more, option) in [(["--rank", "rewards"], "--rank"), (["--temperature", "0.5"], "--temperature")] {
        let (from, out) = (path("b.glb"), path("x.glb"));
        let all = ["skin", text(&from), "-o", text(&out), "--checkpoint", text(&weights)];
        let said = refusal(&mut riglab(&[&all[..], &more].concat()));
        assert!(said.contains("which draws nothing") && said.contains(&format!("leave {option} out")), "{said}");
    }

    for (checkpoint, more, wanted) in [
        (&skeletons, ["--weights", text(&skeletons)], "writes skeletons alone"),
        (&skeletons, ["--rank", "rewards"], "leave --rank out"),
        (&skeletons, ["--skeleton", "keep"], "makes no weights for one that is given"),
        (&weights, ["--weights", text(&weights)], "--weights is for a --checkpoint that writes skeletons only"),
        (&weights, ["--samples", "1"], "give it as --weights"),
    ] {
        let out = path("x.glb");
        let all = ["rig", text(bare), "-o", text(&out), "--checkpoint", text(checkpoint)];
        let said = refusal(&mut riglab(&[&all[..], &more].concat()));
        assert!(said.contains(wanted), "{said}");
    }

    // Out of a file each becomes a run's folder again, which evaluates as the one that was trained: last,
    // as a run's weights are cut where its evaluation found it best.
    for (k, (run, file)) in [&skeletons, &weights].into_iter().zip(&files).enumerate() {
        let again = path(&format!("again-{k}"));
        must(&["checkpoint", "export", text(file), "-o", text(&again)]);
        let report = |run: &Path| {
            let said = must(&["eval", text(run), "--json", "--pictures", "0", "--set", &corpora]).stdout;
            serde_json::from_slice::<Value>(&said).unwrap()["report"]["rows"].take()
        };
        let rows = report(&again);
        assert!(rows.as_array().is_some_and(|rows| !rows.is_empty()) && rows == report(run), "{rows}");
        must(&["report", text(&again), "-o", text(&path("again.html"))]);
    }
}

/// From files to a model of one's own, at the smallest scale that still learns something.
#[test]
fn tokenrig_is_trained_evaluated_and_exported() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = binary::corpus_of(dir.path(), 16, "400..800");
    let path = |name: &str| dir.path().join(name);
    let set = |key: &str, value: &str| format!("{key}={value}");
    let corpora = set("data.corpora", &format!("[{:?}]", text(&corpus)));
    let auto = path("auto");
    must(&[
        "train",
        "skintokens/fsq_cvae_for_tokenrig.toml",
        "--run",
        text(&auto),
        "--set",
        &corpora,
        "--set",
        "model={ extends = \"model/fsq_cvae/tiny.toml\" }",
        "--set",
        "train.steps=8",
        "--set",
        "train.validate_every=8",
        "--set",
        "eval.prefixes=[4]",
    ]);
    let run = path("run");
    let weights = set("data.weights", "[]");
    let skin_run = set("skin.run", &format!("{:?}", text(&auto)));
    let mut all = vec!["train", "quickstart/tokenrig.toml", "--run", text(&run)];
    for value in [
        corpora.as_str(),
        &skin_run,
        "model={ extends = \"model/tokenrig/tiny.toml\" }",
        "train.steps=60",
        "train.ema=0.8",
        "train.schedule.warmup=5",
        "train.validate_every=60",
        "sampling.rigs=4",
        "sampling.cloud.points=128",
        "sampling.variants=2",
        "eval.validation_assets=2",
        "eval.consensus=12",
    ] {
        all.extend(["--set", value]);
    }
    must(&all);
    let metrics: Vec<Value> = fs::read_to_string(run.join("metrics.jsonl"))
        .unwrap()
        .lines()
        .map(|l| serde_json::from_str(l).expect("each line is JSON"))
        .collect();
    for (part, share) in [("train/skeleton", 0.95), ("train/skin", 0.9)] {
        let losses: Vec<f64> = metrics.iter().filter_map(|l| l[part].as_f64()).collect();
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        assert_eq!(losses.len(), 60);
        assert!(mean(&losses[50..]) < share * mean(&losses[..10]), "{part} learns: {losses:?}");
    }
    let said = String::from_utf8(must(&["eval", text(&run), "--json", "--pictures", "1"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let skeletons = evaluation["report"]["skeletons"]["rows"].as_array().unwrap();
    assert!(skeletons.iter().filter(|r| r["method"] == "model").all(|r| r["valid"] == 1.0), "{skeletons:?}");
    let skin = evaluation["report"]["skin"].as_array().unwrap();
    let rules = ["generated: nearest bone", "generated: geodesic nearest bone", "given: heat diffusion"];
    for method in ["generated: model", "given: model", "given: auto-encoder"].into_iter().chain(rules) {
        assert!(skin.iter().any(|r| r["method"] == method), "no row {method}");
    }
    let report = path("report.html");
    must(&["report", text(&run), "-o", text(&report)]);
    assert!(fs::read_to_string(&report).unwrap().contains("generated: model"));

    // As one file it says the same as the run.
    let file = path("model.safetensors");
    must(&["checkpoint", "export", text(&run), "-o", text(&file), "--name", "mine"]);
    let bare = &creatures(dir.path(), "1")[0].1;
    let made = |checkpoint: &Path, name: &str| {
        must(&["rig", text(bare), "-o", text(&path(name)), "--checkpoint", text(checkpoint)]);
        sound(&path(name));
        fs::read(path(name)).unwrap()
    };
    assert!(made(&run, "a.glb") == made(&file, "b.glb"));

    // With another auto-encoder than that of its training it makes nothing, whether that one is named or not.
    let info = run.join("run.json");
    let kept = fs::read_to_string(&info).unwrap();
    let mut other: Value = serde_json::from_str(&kept).unwrap();
    other["companions"][0][1] = "0123456789abcdef".into();
    fs::write(&info, other.to_string()).unwrap();
    let (wrong, exported) = (path("wrong.glb"), path("wrong.safetensors"));
    for command in [
        vec!["rig", text(bare), "-o", text(&wrong), "--checkpoint", text(&run)],
        vec!["checkpoint", "export", text(&run), "-o", text(&exported)],
        vec!["checkpoint", "export", text(&run), "-o", text(&exported), "--set", &skin_run],
    ] {
        let said = refusal(&mut riglab(&command));
        assert!(said.contains("skin.run has other weights") && said.contains("0123456789ab"), "{command:?}: {said}");
    }
    assert!(!wrong.exists() && !exported.exists());
    fs::write(&info, kept).unwrap();
    must(&["checkpoint", "export", text(&run), "-o", text(&exported), "--set", &skin_run]);
    let said = String::from_utf8(must(&["checkpoint", "show", text(&file)]).stdout).unwrap();
    assert!(said.starts_with("mine\n"), "{said}");

    // Out of the file it becomes a run again, which evaluates as the first one did.
    let again = path("again");
    let card = path("card.md");
    fs::write(&card, "How far to trust it.").unwrap();
    must(&["checkpoint", "export", text(&file), "-o", text(&again), "--card", text(&card)]);
    let said = refusal(&mut riglab(&["checkpoint", "export", text(&file), "-o", text(&again)]));
    assert!(said.contains("again exists"), "{said}");
    // Wherever its folder is moved to, and whatever is done from there.
    let elsewhere = path("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    fs::rename(&again, elsewhere.join("moved")).unwrap();
    let args = ["eval", "moved", "--json", "--pictures", "0", "--set", &corpora, "--set", &weights];
    let done = riglab(&args).current_dir(&elsewhere).output().unwrap();
    let told = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && told.contains("whether these assets were trained on is not known"), "{told}");
    let second: Value = serde_json::from_slice(&done.stdout).unwrap();
    for part in ["skeletons", "skin"] {
        assert_eq!(second["report"][part], evaluation["report"][part], "{part}");
    }

    // What was said of it goes along, into a file again, and a name that it was given.
    let (moved, last) = (elsewhere.join("moved"), path("last.safetensors"));
    must(&["checkpoint", "export", text(&moved), "-o", text(&last), "--name", "theirs"]);
    let copy = path("copy.safetensors");
    must(&["checkpoint", "export", text(&last), "-o", text(&copy)]);
    let said = String::from_utf8(must(&["checkpoint", "show", text(&copy)]).stdout).unwrap();
    assert!(said.starts_with("theirs\n") && said.contains("How far to trust it."), "{said}");
    for (more, wanted) in [
        (["-o", "x.safetensors", "--checkpoint", "step-7"], "--checkpoint step-7 is for runs' folders"),
        (["-o", "x", "--name", "y"], "--name is for files"),
        (["-o", "x.bin", "--name", "y"], "a model's file ends in .safetensors"),
    ] {
        let said = refusal(&mut riglab(&[&["checkpoint", "export", text(&copy)], &more[..]].concat()));
        assert!(said.contains(wanted), "{said}");
    }

    // As once could be trained: the auto-encoder has another axis up. That is told, and the run is used all the same.
    let settings = auto.join("config.toml");
    let lying = fs::read_to_string(&settings).unwrap().replace("up = \"y\"", "up = \"z\"");
    fs::write(&settings, lying).unwrap();
    for command in [
        vec!["rig", text(bare), "-o", text(&wrong), "--checkpoint", text(&run)],
        vec!["eval", text(&run), "--pictures", "0", "--set", "eval.consensus=1"],
        vec!["train", "--resume", text(&run), "--set", "train.steps=61"],
    ] {
        let told = String::from_utf8(must(&command).stderr).unwrap();
        assert!(told.contains("warning: ") && told.contains("was trained with data.up = \"z\""), "{command:?}: {told}");
    }
}
