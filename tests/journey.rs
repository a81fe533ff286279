//! The whole way by the product's commands, at the smallest scale that still learns something.

mod binary;

use std::fs;
use std::path::{Path, PathBuf};

use binary::{config, corpus, corpus_of, must, refusal, riglab, text};
use serde_json::Value;

#[test]
fn from_files_to_a_report() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus_of(dir.path(), 24, "1500..2500");
    let stats = String::from_utf8(must(&["dataset", "stats", text(&corpus), "--json"]).stdout).unwrap();
    let stats: Value = serde_json::from_str(&stats).unwrap();
    assert_eq!(stats["all"]["assets"], 24);
    must(&["dataset", "verify", text(&corpus)]);

    let settings = "[train]\nsteps = 120\nema = 0.9\nvalidate_every = 15\n[train.schedule]\nwarmup = 10\n[eval]\nprefixes = [2, 16]\n";
    let config = config(dir.path(), &corpus, settings);
    let run = dir.path().join("run");
    let tried = must(&["train", text(&config), "--dry-run", "--json"]).stdout;
    let tried: Value = serde_json::from_slice(&tried).unwrap();
    must(&["train", text(&config), "--run", text(&run)]);
    let info: Value = serde_json::from_str(&fs::read_to_string(run.join("run.json")).unwrap()).unwrap();
    assert_eq!(tried["parameters"], info["parameters"]);
    let parts: u64 = tried["parts"].as_array().unwrap().iter().map(|p| p[1].as_u64().unwrap()).sum();
    assert_eq!(Some(parts), tried["parameters"].as_u64());
    let memory: f64 = tried["memory_mb"].as_array().unwrap().iter().map(|part| part[1].as_f64().unwrap()).sum();
    assert!(tried["peak_memory_mb"].as_f64() > Some(0.999 * memory), "{tried}");
    // Each parameter that is a matrix takes part in three products at least.
    assert!(tried["flops"].as_f64() > Some(6.0 * parts as f64) && tried["seconds"].as_f64() > Some(0.0), "{tried}");
    let metrics: Vec<Value> = fs::read_to_string(run.join("metrics.jsonl"))
        .unwrap()
        .lines()
        .map(|l| serde_json::from_str(l).expect("each line is JSON"))
        .collect();
    let losses: Vec<f64> = metrics.iter().filter_map(|l| l["train/loss"].as_f64()).collect();
    assert_eq!(losses.len(), 120);
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert!(mean(&losses[100..]) < 0.9 * mean(&losses[..20]), "it learns: {losses:?}");
    let ious: Vec<f64> = metrics.iter().filter_map(|l| l["eval/iou_rule@val"].as_f64()).collect();
    assert_eq!(ious.len(), 8);
    assert!(ious[7] > 0.63 && ious[7] > 1.2 * ious[0], "{ious:?}");
    let info: Value = serde_json::from_str(&fs::read_to_string(run.join("run.json")).unwrap()).unwrap();
    assert_eq!(info["outcome"], "finished");
    let board: Vec<_> = fs::read_dir(run.join("tensorboard")).unwrap().collect();
    assert_eq!(board.len(), 1);

    let report = dir.path().join("report.html");
    must(&["report", text(&run), "-o", text(&report)]);
    assert!(fs::read_to_string(&report).unwrap().contains("Not evaluated yet"));
    let said = String::from_utf8(must(&["eval", text(&run), "--json", "--pictures", "1"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let rows = evaluation["report"]["rows"].as_array().unwrap();
    for method in
        ["raw", "rule", "rule, codes exchanged", "nearest bone", "1/d^2, top 4, cut 0.15", "geodesic nearest bone"]
    {
        assert!(rows.iter().any(|r| r["method"] == method), "no row {method}");
    }
    must(&["report", text(&run), "-o", text(&report)]);
    let html = fs::read_to_string(&report).unwrap();
    assert!(html.matches("data:image/png").count() >= 2 && html.contains("<svg") && html.contains("config.toml"));

    // The resolved config repeats the run.
    let again = dir.path().join("again");
    must(&["train", text(&run.join("config.toml")), "--run", text(&again)]);
    let read = |run: &Path| fs::read(run.join("checkpoints/step-00000120/model.safetensors")).unwrap();
    assert!(read(&run) == read(&again));
}

#[test]
fn creatures_are_the_same_for_the_same_seed() {
    let dir = tempfile::tempdir().unwrap();
    let make = |name: &str, seed: &str| {
        let out = dir.path().join(name);
        must(&["synth", "-o", text(&out), "--count", "3", "--seed", seed, "--triangles", "400..600"]);
        let mut files: Vec<_> = fs::read_dir(out).unwrap().map(|e| e.unwrap().path()).collect();
        files.sort();
        files.iter().map(|f| fs::read(f).unwrap()).collect::<Vec<_>>()
    };
    let first = make("a", "1");
    assert_eq!(first.len(), 4);
    assert!(first == make("b", "1"));
    assert!(first != make("c", "2"));
    // At once as a corpus, they are the same.
    let (one, other) = (dir.path().join("d.h5"), dir.path().join("e.h5"));
    must(&["synth", "-o", text(&one), "--count", "3", "--seed", "1", "--triangles", "400..600"]);
    must(&["dataset", "import", text(&dir.path().join("a")), "-o", text(&other)]);
    let shown = |corpus: &std::path::Path| {
        let out = must(&["dataset", "inspect", text(corpus), "--json"]).stdout;
        let each = String::from_utf8(out).unwrap();
        let counts = |l: &str| {
            let v: Value = serde_json::from_str(l).unwrap();
            ["vertices", "triangles", "joints", "nonzero_weights", "category", "licence"].map(|k| v[k].clone())
        };
        let mut all: Vec<_> = each.lines().map(|l| format!("{:?}", counts(l))).collect();
        all.sort();
        all
    };
    assert_eq!(shown(&one), shown(&other));
    // To the last bit, so that merging leaves each in once.
    let both = dir.path().join("both.h5");
    let merged = must(&["dataset", "merge", text(&one), text(&other), "-o", text(&both)]).stdout;
    assert!(String::from_utf8(merged).unwrap().contains("3 assets, 3 repeated ones left out"));
}

/// A corpus whose assets are all tested on, of a few other files.
fn tests_alone(dir: &Path) -> PathBuf {
    let (files, corpus) = (dir.join("mine"), dir.join("mine.h5"));
    must(&["synth", "-o", text(&files), "--count", "3", "--seed", "9", "--triangles", "800..1600"]);
    must(&["dataset", "import", text(&files), "-o", text(&corpus), "--all-in", "test_new"]);
    corpus
}

#[test]
fn from_files_to_skeletons() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 18);
    let config = dir.path().join("config.toml");
    let text_of = format!(
        "extends = 'quickstart/unirig_skeleton.toml'\n[data]\ncorpora = ['{}']\nweights = [1.0]\n\
         [model]\nextends = 'model/unirig_skeleton/tiny.toml'\n[limits]\njoints = 60\ntokens = 400\n\
         [sampling]\nrigs = 4\ncloud = {{ points = 256 }}\n\
         [train]\nsteps = 60\nema = 0.9\nvalidate_every = 30\nprecision = 'fp32'\n[train.schedule]\nwarmup = 5\n\
         [eval]\nvalidation_assets = 2\nretrieval_points = 64\n",
        corpus.display()
    );
    fs::write(&config, text_of).unwrap();
    let run = dir.path().join("run");
    must(&["train", text(&config), "--run", text(&run)]);
    let lines = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let metrics: Vec<Value> = lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let losses: Vec<f64> = metrics.iter().filter_map(|l| l["train/loss"].as_f64()).collect();
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert_eq!(losses.len(), 60);
    assert!(mean(&losses[50..]) < 0.95 * mean(&losses[..10]), "it learns: {losses:?}");
    let last = metrics.iter().rev().find(|l| l["eval/j2j_all@val"].is_number()).unwrap();
    // The grammar lets nothing through that is no tree, however little was learned.
    assert_eq!(last["eval/valid@val"], 1.0);
    let said = String::from_utf8(must(&["eval", text(&run), "--json", "--pictures", "1"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let rows = evaluation["report"]["rows"].as_array().unwrap();
    for method in ["model", "retrieval", "template fit"] {
        let row = rows.iter().find(|r| r["method"] == method).unwrap();
        assert!(row["valid"] == 1.0 && row["j2j"].as_f64().unwrap() > 0.0, "{row}");
    }
    let report = dir.path().join("report.html");
    must(&["report", text(&run), "-o", text(&report)]);
    let html = fs::read_to_string(&report).unwrap();
    assert!(html.contains("retrieval") && html.contains("data:image/png"));
    // Several are sampled, and one is taken. A checkpoint's folder names its run.
    let (out, half) = (dir.path().join("agreed.json"), run.join("checkpoints/step-00000030"));
    let agreed = ["eval", text(&half), "--pictures", "0", "--set", "eval.consensus=3", "-o", text(&out)];
    let said = String::from_utf8(must(&agreed).stdout).unwrap();
    assert!(said.contains("of 3 sampled skeletons") && said.contains("100.0%"), "{said}");
    let agreed: Value = serde_json::from_slice(&fs::read(out).unwrap()).unwrap();
    assert_eq!(agreed["checkpoint"]["step"], 30);
    // Test rigs alone, which nothing is retrieved for. The weights of the training's corpora are not theirs.
    let (alone, out) = (tests_alone(dir.path()), dir.path().join("alone.json"));
    let set = format!("data.corpora=['{}']", alone.display());
    must(&["eval", text(&run), "--pictures", "0", "--set", &set, "-o", text(&out)]);
    let found: Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    let rows = found["report"]["rows"].as_array().unwrap();
    assert!(rows.len() == 1 && rows[0]["method"] == "model" && rows[0]["compared"].as_u64() > Some(0), "{rows:?}");
    let said = refusal(&mut riglab(&["eval", text(&half), "--checkpoint", "last"]));
    assert!(said.contains("step-00000030 names a checkpoint and --checkpoint last another"), "{said}");
    let said = refusal(&mut riglab(&["eval", text(&run.join("checkpoints/lost"))]));
    assert!(said.contains("there are: best, last, step-00000030, step-00000060"), "{said}");

    // The resolved config repeats the run, with another number of workers.
    let again = dir.path().join("again");
    must(&["train", text(&run.join("config.toml")), "--run", text(&again), "--set", "train.workers=3"]);
    let read = |run: &Path| fs::read(run.join("checkpoints/step-00000060/model.safetensors")).unwrap();
    assert!(read(&run) == read(&again));
}

#[test]
fn from_files_to_weights_for_given_skeletons() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 18);
    let run_with = |name: &str, points: &str, loss: &str, steps: usize| {
        let config = dir.path().join(format!("{name}.toml"));
        let text_of = format!(
            "extends = 'quickstart/unirig_skin.toml'\n[data]\ncorpora = ['{}']\n\
             [model]\nextends = 'model/unirig_skin/tiny.toml'\n{points}\n\
             [sampling]\nrigs = 3\npoints = 192\nqueries = 96\npool = 256\nresolution = 32\n{loss}\n\
             [train]\nsteps = {steps}\nema = 0.9\nvalidate_every = {}\n[train.schedule]\nwarmup = 5\n\
             [eval]\nbaseline_resolution = 32\nvalidation_assets = 2\n",
            corpus.display(),
            steps / 2
        );
        fs::write(&config, text_of).unwrap();
        let run = dir.path().join(name);
        must(&["train", text(&config), "--run", text(&run)]);
        let lines = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
        (run, lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect::<Vec<Value>>())
    };
    let freeze = "[loss]\nfreeze = { probability = 0.5, share = 0.5 }";
    let (run, metrics) = run_with("run", "", freeze, 80);
    let losses: Vec<f64> = metrics.iter().filter_map(|l| l["train/skin"].as_f64()).collect();
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert_eq!(losses.len(), 80);
    assert!(mean(&losses[60..]) < 0.8 * mean(&losses[..20]), "it learns: {losses:?}");
    assert!(metrics.iter().filter(|l| l["train/skin"].is_number()).all(|l| l["train/physics"].as_f64() > Some(0.0)));
    let said = String::from_utf8(must(&["eval", text(&run), "--json", "--pictures", "1"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let rows = evaluation["report"]["rows"].as_array().unwrap();
    for method in ["raw", "rule", "nearest bone", "geodesic nearest bone", "geodesic 1/d^16, top 4, cut 0.15"] {
        assert!(rows.iter().any(|r| r["method"] == method && r["motion"].as_f64() > Some(0.0)), "no row {method}");
    }
    // Weights spread before they are cut: another rule of the same network.
    let plain = dir.path().join("plain.json");
    must(&["eval", text(&run), "--pictures", "0", "--set", "eval.spread=0.0", "-o", text(&plain)]);
    let plain: Value = serde_json::from_slice(&fs::read(plain).unwrap()).unwrap();
    let l1 = |of: &Value, method: &str| {
        let rows = of["report"]["rows"].as_array().unwrap();
        rows.iter().find(|r| r["method"] == method).unwrap()["pooled"]["l1"].as_f64().unwrap()
    };
    assert_eq!((&evaluation["report"]["spread"], &plain["report"]["spread"]), (&0.35.into(), &0.0.into()));
    assert_eq!(l1(&evaluation, "raw"), l1(&plain, "raw"));
    assert_ne!(l1(&evaluation, "rule"), l1(&plain, "rule"));
    // Test rigs alone: there is nothing to choose a cut by, and no evaluation that chose one.
    let hidden = run.join("hidden.json");
    fs::rename(run.join("eval.json"), &hidden).unwrap();
    let (set, out) = (format!("data.corpora=['{}']", tests_alone(dir.path()).display()), dir.path().join("alone.json"));
    let eval = ["eval", text(&run), "--pictures", "0", "-o", text(&out), "--set", &set];
    let said = refusal(&mut riglab(&eval));
    assert!(
        said.contains("no asset in `val` by which to choose") && said.contains("--set eval.cuts='[0.1]'"),
        "{said}"
    );
    let cut = |more: &[&str]| {
        let said = must(&[&eval[..], more].concat()).stderr;
        let found: Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
        (found["report"]["cut"].as_f64().unwrap(), String::from_utf8(said).unwrap())
    };
    assert!((cut(&["--set", "eval.cuts=[0.1]"]).0 - 0.1).abs() < 1e-6);
    // The one that the run's own evaluation chose.
    fs::rename(&hidden, run.join("eval.json")).unwrap();
    let (own, said) = cut(&[]);
    assert!(
        Some(own) == evaluation["report"]["cut"].as_f64() && said.contains("no asset to choose a cut by"),
        "{said}"
    );
    assert!(said.contains("next: riglab report") && said.contains("--eval"), "{said}");
    // It outlives an evaluation of another checkpoint in its place.
    fs::copy(run.join("eval.json"), &hidden).unwrap();
    let other = if evaluation["checkpoint"]["step"] == 40 { "step-00000080" } else { "step-00000040" };
    must(&["eval", text(&run), "--pictures", "0", "--checkpoint", other]);
    assert_eq!(cut(&[]).0, own);
    fs::rename(&hidden, run.join("eval.json")).unwrap();
    let other = dir.path().join("other.html");
    must(&["report", text(&run), "--eval", text(&out), "-o", text(&other)]);
    assert!(fs::read_to_string(&other).unwrap().contains("mine.h5"));
    let report = dir.path().join("report.html");
    must(&["report", text(&run), "-o", text(&report)]);
    let html = fs::read_to_string(&report).unwrap();
    assert!(html.contains("given the skeletons") && html.contains("data:image/png"));

    // The resolved config repeats the run, with another number of workers.
    let again = dir.path().join("again");
    must(&["train", text(&run.join("config.toml")), "--run", text(&again), "--set", "train.workers=3"]);
    let read = |run: &Path| fs::read(run.join("checkpoints/step-00000080/model.safetensors")).unwrap();
    assert!(read(&run) == read(&again));

    // How the hair of an avatar swings, as the run tells it.
    let files = dir.path().join("avatars");
    must(&["synth", "-o", text(&files), "--count", "1", "--plans", "anime", "--triangles", "800..1600"]);
    let avatar = fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).find(|p| text(p).ends_with("glb")).unwrap();
    let swings = |name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        must(&[&["simulate", text(&avatar), "-o", text(&out), "--seconds", "1", "--fps", "30"], more].concat());
        fs::read(out).unwrap()
    };
    let told = swings("told.glb", &["--attributes", text(&run)]);
    assert!(told == swings("again.glb", &["--attributes", text(&run)]) && told != swings("own.glb", &[]));
    // New weights for its skeleton, and none for a mesh without one.
    let again = dir.path().join("skinned.glb");
    must(&["skin", text(&avatar), "-o", text(&again), "--checkpoint", text(&run)]);
    let joints = |file: &Path| {
        let said: Value = serde_json::from_slice(&must(&["inspect", text(file), "--json"]).stdout).unwrap();
        said["joints"].clone()
    };
    assert!(joints(&again) == joints(&avatar) && !joints(&again).is_null());
    let predicted = ["rig", text(&avatar), "-o", "x.glb", "--checkpoint", text(&run)];
    assert!(refusal(&mut riglab(&predicted)).contains("riglab skin"));
    let other = ["simulate", text(&avatar), "-o", "x.glb", "--attributes", text(dir.path())];
    assert!(refusal(&mut riglab(&other)).contains("config.toml"));

    // The backbone, and the losses of the release.
    let points = "[model.points]\nencoder = 'ptv3'\n[model.points.ptv3]\ngrid = 0.05\ndepths = [1, 1]\nchannels = [8, 16]\n\
                  heads = [1, 2]\npatch = 64";
    let loss = "[loss]\nskin = 0.0\nreleased = { vertex = 5.0, normalization = 10.0, l1 = 0.3, bce = 1.0, zero_l1 = 1.0, \
                non_zero_l1 = 1.0, degrees = 30.0 }";
    let (run, metrics) = run_with("released", points, loss, 20);
    assert!(metrics.iter().all(|l| l["train/loss"].as_f64().is_none_or(f64::is_finite)));
    assert!(metrics[0]["train/normalization"].as_f64().unwrap() > 0.0 && metrics[0]["train/skin"].is_null());
    must(&["eval", text(&run), "--pictures", "0"]);
}
