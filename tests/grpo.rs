//! GRPO from the shipped model, and from a skeleton model, by the product's commands: first steps, a kill in the middle
//! of a rollout, and the refined model at work.

mod binary;

use std::fs;
use std::path::Path;

use binary::{corpus, must, refusal, riglab, text};
use serde_json::Value;

const SETTINGS: &str = "\
extends = 'skintokens/grpo_quick.toml'
[rollout]
meshes = 1
group = 4
epochs = 2
minibatches = 2
vertices = 48
precision = 'fp32'
[reward]
resolution = 32
[train]
steps = 8
save_every = 3
validate_every = 4
[train.schedule]
warmup = 1
[held_out]
draws = 2
[eval]
validation_assets = 2
vertices = 64
";

fn lines(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    text.lines().map(|l| serde_json::from_str(l).expect("each line is JSON")).collect()
}

#[test]
fn rewards_refine_a_model() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 14);
    let config = dir.path().join("grpo.toml");
    fs::write(&config, format!("{SETTINGS}[data]\ncorpora = ['{}']\n", corpus.display())).unwrap();

    let whole = dir.path().join("whole");
    must(&["train", text(&config), "--run", text(&whole)]);
    let all = lines(&whole);
    let steps: Vec<&Value> = all.iter().filter(|l| l["train/loss"].is_number()).collect();
    assert_eq!(steps.len(), 8);
    let of = |step: usize, name: &str| steps[step][&format!("train/{name}")].as_f64().unwrap_or(f64::NAN);
    for step in [0, 4] {
        // Before the first update on a rollout, new and old policy are one; the sampler and the trainer agree.
        assert!((of(step, "ratio") - 1.0).abs() < 1e-5, "{}", steps[step]);
        assert!(of(step, "clip_fraction") == 0.0 && of(step, "sampler_gap") < 1e-4, "{}", steps[step]);
        assert_eq!(of(step, "valid"), 1.0);
        assert!(of(step, "spread") > 0.0 && of(step, "entropy") > 0.0);
        let total = 5.0 * of(step, "coverage") + of(step, "containment") + of(step, "skinning") + of(step, "motion");
        assert!((of(step, "reward") - total).abs() < 1e-9);
    }
    assert_eq!(of(0, "divergence"), 0.0);
    assert!((1..8).all(|step| of(step, "divergence") > 0.0), "the policy moves");
    assert!(of(3, "reward") == of(0, "reward") && of(4, "reward") != of(0, "reward"), "four steps a rollout");

    // Gone over once, the policy that drew is the one that learns: it is not asked twice, and says the same.
    let once = dir.path().join("once");
    let sets = ["rollout.epochs=1", "rollout.minibatches=1", "train.steps=2", "rollout.dead='mask'"];
    let args: Vec<&str> = sets.iter().flat_map(|set| ["--set", *set]).collect();
    must(&[&["train", text(&config), "--run", text(&once)][..], &args].concat());
    let own = lines(&once);
    let own: Vec<&Value> = own.iter().filter(|l| l["train/loss"].is_number()).collect();
    for name in ["reward", "length", "spread", "sampler_gap"] {
        let (a, b) = (own[0][&format!("train/{name}")].as_f64().unwrap(), of(0, name));
        assert!((a - b).abs() < 1e-9 * b.abs().max(1e-3), "{name}: {a} and {b}");
    }
    assert!(own.iter().all(|l| l["train/ratio"] == 1.0 && l["train/clip_fraction"] == 0.0), "{own:?}");
    assert!(own[0]["train/divergence"] == 0.0 && own[1]["train/divergence"].as_f64() > Some(0.0), "{own:?}");

    // Stopped after 3 steps, in the middle of the first rollout.
    let broken = dir.path().join("broken");
    must(&["train", text(&config), "--run", text(&broken), "--set", "train.keep=9"]);
    let checkpoints = broken.join("checkpoints");
    for name in ["step-00000004", "step-00000006", "step-00000008"] {
        let _ = fs::remove_dir_all(checkpoints.join(name));
    }
    for name in ["best", "last"] {
        fs::remove_file(checkpoints.join(name)).unwrap();
    }
    must(&["train", "--resume", text(&broken)]);
    assert_eq!(fs::read(whole.join("metrics.jsonl")).unwrap(), fs::read(broken.join("metrics.jsonl")).unwrap());
    let weights = |run: &Path| fs::read(run.join("checkpoints/step-00000008/model.safetensors")).unwrap();
    assert!(weights(&whole) == weights(&broken), "a resumed run is the unbroken run");
    // Without the rollout it cannot be.
    fs::remove_dir_all(checkpoints.join("step-00000008")).unwrap();
    fs::remove_dir_all(checkpoints.join("step-00000006")).unwrap();
    fs::remove_dir_all(checkpoints.join("step-00000004")).unwrap();
    fs::remove_file(checkpoints.join("step-00000003/task.safetensors")).unwrap();
    let said = refusal(&mut riglab(&["train", "--resume", text(&broken)]));
    assert!(said.contains("rollout"), "{said}");

    let said = String::from_utf8(must(&["eval", text(&whole), "--json", "--pictures", "1"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let rows = evaluation["report"]["rows"].as_array().unwrap();
    let methods: Vec<&str> = rows.iter().take(4).map(|r| r["skeletons"]["method"].as_str().unwrap()).collect();
    assert_eq!(methods, ["before", "after", "before, greedy", "after, greedy"]);
    let assets = |k: usize| rows[k]["skeletons"]["assets"].as_u64().unwrap();
    assert_eq!(assets(0), 2 * assets(2), "two draws a mesh");
    let gain = &evaluation["report"]["gains"][0]["reward"];
    let total = |k: usize| rows[k]["rewards"]["total"].as_f64().unwrap();
    assert!((gain["difference"].as_f64().unwrap() - (total(1) - total(0))).abs() < 1e-9, "{gain}");
    assert_eq!(rows[1]["skeletons"]["valid"], 1.0);
    let report = dir.path().join("report.html");
    must(&["report", text(&whole), "-o", text(&report)]);
    let html = fs::read_to_string(&report).unwrap();
    assert!(html.contains("Before and after") && html.contains("data:image/png"));

    // What was refined rigs, and can be handed on.
    let mesh = fs::read_dir(dir.path().join("files")).unwrap().map(|e| e.unwrap().path());
    let mesh = mesh.filter(|p| p.extension().is_some_and(|e| e == "glb")).min().unwrap();
    let (rigged, again) = (dir.path().join("a.glb"), dir.path().join("b.glb"));
    let rig = ["rig", text(&mesh), "-o", text(&rigged), "--skeleton", "predict", "--skins", "1", "--json"];
    let drawn = |more: &[&str]| {
        let said: Value = serde_json::from_slice(&must(&[&rig[..], more].concat()).stdout).unwrap();
        said["samples"].as_array().unwrap().len()
    };
    let by_the_start = drawn(&[]);
    assert_eq!(
        (by_the_start > 1, drawn(&["--checkpoint", text(&whole)])),
        (true, by_the_start),
        "rigs as its start does"
    );
    // Another checkpoint than the best is named by its folder.
    let checkpoints = whole.join("checkpoints");
    let best = fs::read_link(checkpoints.join("best")).unwrap();
    let steps = fs::read_dir(&checkpoints).unwrap().map(|e| e.unwrap().path());
    let mut others = steps.filter(|p| !p.is_symlink() && !p.ends_with(&best));
    let other = others.next().expect("more than one is kept");
    let said = must(&[&rig[..], &["--checkpoint", text(&other)]].concat()).stdout;
    let step = serde_json::from_slice::<Value>(&said).unwrap()["steps"].as_u64().unwrap();
    assert!(other.ends_with(format!("step-{step:08}")), "{step}");
    let file = dir.path().join("model.safetensors");
    must(&["checkpoint", "export", text(&whole), "-o", text(&file)]);
    assert!(fs::metadata(&file).unwrap().len() > 1_000_000);
    refused_with_another_start(&whole, &mesh, &[]);
    let few = ["--samples", "1", "--skins", "1"];
    must(
        &[&["rig", text(&mesh), "-o", text(&again), "--skeleton", "predict", "--checkpoint", text(&file)][..], &few]
            .concat(),
    );
}

#[test]
fn meshes_without_rigs_are_enough_to_train_on() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 14);
    // What a scanner gives: an OBJ, beside a rigged file whose rig is left behind.
    let scans = dir.path().join("scans");
    fs::create_dir(&scans).unwrap();
    let bar = "v 0 0 0\nv 1 0 0\nv 1 3 0\nv 0 3 0\nv 0 0 1\nv 1 0 1\nv 1 3 1\nv 0 3 1\nf 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\n\
               f 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    fs::write(scans.join("bar.obj"), bar).unwrap();
    let rigged = fs::read_dir(dir.path().join("files")).unwrap().map(|e| e.unwrap().path());
    let rigged = rigged.filter(|p| p.extension().is_some_and(|e| e == "glb")).min().unwrap();
    fs::copy(rigged, scans.join("creature.glb")).unwrap();
    let meshes = dir.path().join("meshes.h5");
    let said = must(&["dataset", "import", text(&scans), "-o", text(&meshes), "--meshes"]);
    assert!(String::from_utf8(said.stdout).unwrap().contains("2 assets (meshes 2)"));

    let config = dir.path().join("grpo.toml");
    let data = format!("[data]\ncorpora = ['{}', '{}']\ntrain = ['meshes']\n", corpus.display(), meshes.display());
    fs::write(&config, format!("{SETTINGS}{data}")).unwrap();
    let run = dir.path().join("run");
    must(&["train", text(&config), "--run", text(&run), "--set", "train.steps=4"]);
    let all = lines(&run);
    let steps: Vec<&Value> = all.iter().filter(|l| l["train/loss"].is_number()).collect();
    assert!(steps.len() == 4 && steps.iter().all(|l| l["train/valid"] == 1.0), "{steps:?}");
    // Whoever learns from rigs does not see them.
    let skeletons = dir.path().join("skeletons.toml");
    let data = format!("[data]\ncorpora = ['{}']\n", meshes.display());
    fs::write(&skeletons, format!("extends = 'quickstart/unirig_skeleton.toml'\n{data}")).unwrap();
    let said = refusal(&mut riglab(&["train", text(&skeletons)]));
    assert!(said.contains("no asset in `train`") && said.contains("meshes.h5 holds bare meshes"), "{said}");
    let both = format!("[\"{}\", \"{}\"]", corpus.display(), meshes.display());
    let both = format!("data.corpora={both}");
    for task in ["unirig_skeleton", "unirig_skin", "fsq_cvae"] {
        let preset = format!("quickstart/{task}.toml");
        for split in ["data.train=['train', 'meshes']", "data.validate='meshes'"] {
            let said = refusal(&mut riglab(&["train", &preset, "--set", &both, "--set", split]));
            assert!(said.contains("meshes.h5: 2 of its 2 assets are bare meshes") && said.contains("grpo"), "{said}");
        }
    }
}

#[test]
fn a_policy_that_runs_away_is_stopped() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 14);
    let config = dir.path().join("grpo.toml");
    let more = "[guard]\ndivergence = 1e-6\n";
    fs::write(&config, format!("{SETTINGS}{more}[data]\ncorpora = ['{}']\n", corpus.display())).unwrap();
    let run = dir.path().join("run");
    let said = refusal(&mut riglab(&["train", text(&config), "--run", text(&run)]));
    assert!(said.contains("guard.divergence") && said.contains("objective.beta"), "{said}");
    let start = "start.model='no such model'";
    let said = refusal(&mut riglab(&["train", text(&config), "--set", start]));
    assert!(said.contains("no such model"), "{said}");
}

#[test]
fn a_skeleton_model_is_refined_by_what_is_about_joints() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 14);
    let data = format!("[data]\ncorpora = ['{}']\n", corpus.display());
    let skeletons = dir.path().join("skeletons.toml");
    let small = "[model]\nextends = 'model/unirig_skeleton/tiny.toml'\n[train]\nsteps = 12\n[eval]\nvalidation_assets = 1\n\
                 consensus = 1\n[limits]\njoints = 24\ntokens = 96\n";
    fs::write(&skeletons, format!("extends = 'quickstart/unirig_skeleton.toml'\n{small}{data}")).unwrap();
    let start_run = dir.path().join("start");
    must(&["train", text(&skeletons), "--run", text(&start_run)]);

    let config = dir.path().join("grpo.toml");
    let settings = SETTINGS.replace("skintokens/grpo_quick.toml", "unirig/skeleton_grpo.toml");
    fs::write(&config, format!("{settings}[start]\nmodel = '{}'\n{data}", start_run.display())).unwrap();
    let (run, broken) = (dir.path().join("run"), dir.path().join("broken"));
    must(&["train", text(&config), "--run", text(&run)]);
    let steps: Vec<Value> = lines(&run).into_iter().filter(|l| l["train/loss"].is_number()).collect();
    assert_eq!(steps.len(), 8);
    let of = |step: usize, name: &str| steps[step][&format!("train/{name}")].as_f64().unwrap_or(f64::NAN);
    for step in [0, 4] {
        assert!((of(step, "ratio") - 1.0).abs() < 1e-5, "{}", steps[step]);
        assert!(of(step, "clip_fraction") == 0.0 && of(step, "sampler_gap") < 1e-4, "{}", steps[step]);
        assert!(of(step, "valid") == 1.0 && of(step, "spread") > 0.0 && of(step, "entropy") > 0.0);
        assert!((of(step, "reward") - 5.0 * of(step, "coverage") - of(step, "containment")).abs() < 1e-9);
    }
    assert!(of(0, "divergence") == 0.0 && (1..8).all(|step| of(step, "divergence") > 0.0), "the policy moves");

    // Stopped in the middle of a rollout.
    must(&["train", text(&config), "--run", text(&broken), "--set", "train.keep=9"]);
    for name in ["step-00000004", "step-00000006", "step-00000008", "best", "last"] {
        let path = broken.join("checkpoints").join(name);
        let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
    }
    must(&["train", "--resume", text(&broken)]);
    assert_eq!(fs::read(run.join("metrics.jsonl")).unwrap(), fs::read(broken.join("metrics.jsonl")).unwrap());

    let said = String::from_utf8(must(&["eval", text(&run), "--json", "--pictures", "1"]).stdout).unwrap();
    let evaluation: Value = serde_json::from_str(&said).unwrap();
    let row = &evaluation["report"]["rows"][1];
    assert!(row["skeletons"]["method"] == "after" && row["skeletons"]["valid"] == 1.0, "{row}");
    assert!(row["rewards"]["coverage"].as_f64() > Some(0.0) && row["rewards"]["skinning"] == 0.0, "{row}");
    assert!(!evaluation["gallery"].as_array().unwrap().is_empty());

    // It can be refined further, from any of its checkpoints.
    let (further, start) = (dir.path().join("further"), format!("start.model='{}/checkpoints/last'", run.display()));
    must(&["train", text(&config), "--run", text(&further), "--set", &start, "--set", "train.steps=1"]);
    let steps: Vec<Value> = lines(&further).into_iter().filter(|l| l["train/loss"].is_number()).collect();
    assert!(steps.len() == 1 && steps[0]["train/divergence"] == 0.0, "{steps:?}");

    // Weights cannot be judged.
    let said = refusal(&mut riglab(&["train", text(&config), "--set", "reward.weights=[5.0, 1.0, 1.0, 1.0]"]));
    assert!(said.contains("reward.weights") && said.contains("skeleton model"), "{said}");
    let mesh = fs::read_dir(dir.path().join("files")).unwrap().map(|e| e.unwrap().path());
    let mesh = mesh.filter(|p| p.extension().is_some_and(|e| e == "glb")).min().unwrap();
    let out = dir.path().join("a.glb");
    // It rigs as what it was refined from does, with weights by another; as one file, too.
    let file = dir.path().join("model.safetensors");
    must(&["checkpoint", "export", text(&run), "-o", text(&file)]);
    let made = [&start_run, &run, &file].map(|checkpoint| {
        let said = must(&["rig", text(&mesh), "-o", text(&out), "--json", "--checkpoint", text(checkpoint)]).stdout;
        let said: Value = serde_json::from_slice(&said).unwrap();
        assert_eq!(said["weights_by"], "tokenrig_small");
        fs::read(&out).unwrap()
    });
    assert!(made[0] != made[1] && made[1] == made[2], "what was refined is what draws");

    // What is too long to be trained on may be evaluated on.
    let short = ["--set", "limits.joints=1"];
    let said = refusal(&mut riglab(&[&["train", text(&skeletons)][..], &short].concat()));
    assert!(said.contains("no asset of a corpus fits limits.joints = 1"), "{said}");
    let other = dir.path().join("short.json");
    must(&[&["eval", text(&start_run), "-o", text(&other), "--pictures", "0"][..], &short].concat());

    // Where it started may be moved, and is then named anew.
    let moved = dir.path().join("moved");
    fs::rename(&start_run, &moved).unwrap();
    let said =
        refusal(&mut riglab(&["checkpoint", "export", text(&run), "-o", text(&out.with_extension("safetensors"))]));
    assert!(said.contains("--set start.model=PATH"), "{said}");
    let named = ["--set", &format!("start.model='{}'", moved.display())];
    must(&[&["checkpoint", "export", text(&run), "-o", text(&file)][..], &named].concat());
    fs::rename(&moved, &start_run).unwrap();
    refused_with_another_start(&run, &mesh, &["--set", &format!("start.model='{}'", start_run.display())]);
}

/// What was begun from another model makes nothing, whether that one is named or not.
fn refused_with_another_start(run: &Path, mesh: &Path, named: &[&str]) {
    let info = run.join("run.json");
    let kept = fs::read_to_string(&info).unwrap();
    let mut other: Value = serde_json::from_str(&kept).unwrap();
    assert_eq!(other["companions"][0][0], "start.model");
    other["companions"][0][1] = "0123456789abcdef".into();
    fs::write(&info, other.to_string()).unwrap();
    let (wrong, exported) = (run.with_extension("glb"), run.with_extension("safetensors"));
    let export = ["checkpoint", "export", text(run), "-o", text(&exported)];
    for command in [
        vec!["rig", text(mesh), "-o", text(&wrong), "--checkpoint", text(run)],
        export.to_vec(),
        [&export[..], named].concat(),
    ] {
        let said = refusal(&mut riglab(&command));
        assert!(said.contains("start.model has other weights") && said.contains("0123456789ab"), "{command:?}: {said}");
    }
    assert!(!wrong.exists() && !exported.exists());
    fs::write(&info, kept).unwrap();
}

#[test]
fn what_is_masked_teaches_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 14);
    let config = dir.path().join("grpo.toml");
    // Where stretching costs as good as nothing, all rigs have the same motion reward.
    let more = format!("[data]\ncorpora = ['{}']\n", corpus.display());
    fs::write(
        &config,
        format!("{SETTINGS}{more}")
            .replace("[reward]", "[reward]\nweights = [0.0, 0.0, 0.0, 1.0]\nstretch_scale = 1e-30"),
    )
    .unwrap();
    let weights = |run: &Path| fs::read(run.join("checkpoints/last/model.safetensors")).unwrap();
    let trained = |name: &str, steps: usize| {
        let run = dir.path().join(name);
        let steps = format!("train.steps={steps}");
        must(&["train", text(&config), "--run", text(&run), "--set", &steps, "--set", "rollout.dead='mask'"]);
        run
    };
    let (short, long) = (trained("short", 1), trained("long", 3));
    assert!(weights(&short) == weights(&long));
    let steps: Vec<Value> = lines(&long).into_iter().filter(|l| l["train/loss"].is_number()).collect();
    assert!(steps.iter().all(|s| s["train/loss"] == 0.0 && s["train/grad_norm"] == 0.0 && s["train/dead"] == 1.0));
}
