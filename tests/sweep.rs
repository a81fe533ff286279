//! A sweep that is killed again and again ends with the table of the unbroken one, and a run that fails stops
//! nothing.

mod binary;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use std::process::Command;

use binary::{config, corpus, corpus_of, must, refusal, riglab, text};

/// Kills of the broken sweep.
const KILLS: usize = 3;

#[test]
fn a_killed_sweep_goes_on_to_the_same_table() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 12);
    let base = config(
        dir.path(),
        &corpus,
        "[train]\nsteps = 8\nsave_every = 2\nvalidate_every = 4\n[eval]\nvalidation_vertices = 50\nprefixes = [4]\n",
    );
    let (file, nowhere) = (dir.path().join("toy.toml"), dir.path().join("nowhere.h5"));
    let lines = [
        "[sweep]\nquestion = 'Does it go on?'\nseeds = [0, 1]\nevaluate = true",
        &format!("base = '{}'", base.display()),
        "[[sweep.arms]]\nname = 'with'\n[[sweep.arms]]\nname = 'without'\nset = { 'loss.dice' = 0.0 }",
        "[[sweep.arms]]\nname = 'continuous'\n[sweep.arms.set]\n'model.bottleneck' = 'gaussian'\n'loss.kl' = 0.001\n'loss.spread' = 0.0",
        // Sound as a config: it fails when the run begins.
        &format!("[[sweep.arms]]\nname = 'no corpus'\nset = {{ 'data.corpora' = ['{}'] }}", nowhere.display()),
        "[[sweep.metrics]]\nof = 'eval/iou_raw@val'\nbetter = 'higher'",
        "[[sweep.metrics]]\nof = 'eval.json:report.rows[split=test_new,method=raw,tokens=4].pooled.l1'\nname = 'L1'",
        "[[sweep.metrics]]\nof = 'eval.json:report.codebook.test_new.bits'\nname = 'bits'\nbetter = 'lower'",
    ];
    fs::write(&file, lines.join("\n")).unwrap();

    let (whole, broken) = (dir.path().join("whole"), dir.path().join("broken"));
    let start = Instant::now();
    let said = refusal(&mut riglab(&["sweep", text(&file), "-o", text(&whole)]));
    // Both for one reason, which is told once.
    assert!(said.contains("failed: no corpus (seed 0), no corpus (seed 1): train: "), "{said}");
    let again = format!("else try again with: riglab sweep {} --retry", whole.display());
    assert!(
        said.contains("2 jobs failed; where settings are at fault, correct the sweep's file") && said.contains(&again),
        "{said}"
    );
    let took = start.elapsed();
    let expected = result(&whole);
    let table = &expected["table.md"];
    assert!(table.contains("| continuous | 2 | 0 | ") && table.contains("| with | 2 | 0 | "), "{table}");
    assert!(table.contains("| no corpus | 0 | 2 | "), "{table}");
    let failed = fs::read_to_string(whole.join("attempts.jsonl")).unwrap();
    assert_eq!(failed.lines().count(), 4, "two runs, tried twice each: {failed}");
    assert!(expected["results.jsonl"].contains("nowhere.h5"));

    // A new call with the file, then by the folder alone, which would give a single job at a time more threads by itself.
    let on = || without_threads(&["sweep", text(&broken), "--jobs", "1"]);
    let mut kills = 0;
    for part in 0..KILLS {
        let call = if part == 0 { riglab(&["sweep", text(&file), "-o", text(&broken)]) } else { on() };
        kills += usize::from(killed_after(call, took.mul_f64(0.15 + 0.2 * part as f64 / KILLS as f64), &broken));
    }
    assert!(kills > 0, "the sweep was too short to be killed");
    let said = refusal(&mut on());
    assert!(said.contains("1 at a time with 1 thread each"), "{said}");
    assert_eq!(result(&broken), expected, "after {kills} kills");

    let status = must(&["sweep", text(&broken), "--status"]);
    let status = String::from_utf8_lossy(&status.stdout).into_owned();
    assert!(status.contains("6 finished, 2 failed") && status.contains("no corpus"), "{status}");
    // Another sweep is refused the folder, with what differs.
    fs::write(&file, lines.join("\n").replace("seeds = [0, 1]", "seeds = [0, 2]")).unwrap();
    let said = refusal(&mut riglab(&["sweep", text(&file), "-o", text(&broken)]));
    assert!(said.contains("holds another sweep") && said.contains("seed 1") && said.contains("hint"), "{said}");
    fs::write(&file, lines.join("\n").replace("loss.dice", "loss.dize")).unwrap();
    let said = refusal(&mut riglab(&["sweep", text(&file), "-o", text(&dir.path().join("new"))]));
    assert!(said.contains("without, seed 0") && said.contains("dize"), "{said}");
    assert!(!dir.path().join("new").exists());
    // What was missing is there now.
    fs::copy(&corpus, &nowhere).unwrap();
    must(&["sweep", text(&broken), "--retry"]);
    let table = &result(&broken)["table.md"];
    assert!(table.contains("| no corpus | 2 | 0 | ") && !table.contains("same corpora"), "{table}");
}

#[test]
fn what_does_not_belong_to_a_sweep_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let made = dir.path().join("c.h5");
    let (file, out) = (dir.path().join("toy.toml"), dir.path().join("out"));
    let base = config(dir.path(), &made, "");
    let write = |seeds: &str, more: &str| {
        let arms = "[[sweep.arms]]\nname = 'a'\n";
        fs::write(&file, format!("[sweep]\nseeds = [{seeds}]\nbase = '{}'\n{arms}{more}", base.display())).unwrap();
    };
    let arm = "[[sweep.arms]]\nname = 'b'\nset = { 'loss.dice' = 0.0 }\n";
    let plan = || fs::read_to_string(out.join("sweep.json")).unwrap();
    let dry = |more: &[&str]| riglab(&[&["sweep", text(&file), "-o", text(&out)], more].concat());
    // Alike with and without --dry-run, and the folder stays as it is.
    let refused = |why: &[&str]| {
        let before = out.exists().then(plan);
        for more in [&["--dry-run"][..], &[]] {
            let said = refusal(&mut dry(more));
            assert!(why.iter().all(|w| said.contains(w)), "{why:?}: {said}");
        }
        assert_eq!(out.exists().then(plan), before);
    };
    write("0", "[[sweep.metrics]]\nof = 'eval.jsn:report.rows[split=val].iou'\n");
    refused(&["toy.toml:7:6: `sweep.metrics[0].of`", "eval.jsn", "eval.json:"]);
    write("0", "[[sweep.metrics]]\nof = 'eval.json:report.rows[split=val.iou'\n");
    refused(&["toy.toml:7:6: `sweep.metrics[0].of`", "`[split=val.iou` is not closed"]);

    write("0", "[sweep.grid]\n'loss.bce' = [1.0, 2.0]\n");
    refused(&["sweep.grid", "did you mean `product`?"]);

    // An experiment is no sweep, and without a corpus no job has anything to learn from.
    let said = refusal(&mut riglab(&["sweep", text(&base), "-o", text(&out)]));
    assert!(said.contains("is an experiment of one run: `riglab train "), "{said}");
    write("0", "set = { 'data.corpora' = [] }\n");
    refused(&["`a`, seed 0: data.corpora names no corpus"]);

    write("0", "");
    let tried = dry(&["--dry-run"]).output().unwrap();
    assert!(tried.status.success() && !out.exists());
    let told = String::from_utf8_lossy(&tried.stderr).into_owned();
    assert!(told.contains("c.h5: no such corpus"), "{told}");
    let said = refusal(&mut dry(&[]));
    assert!(said.contains("1 job failed") && said.contains("--retry"), "no corpus: {said}");
    write("1", "");
    refused(&["holds another sweep", "seed 0"]);
    write("0", arm);
    // What failed may have failed by what its base says.
    config(dir.path(), &made, "[loss]\nbce = 3.0\n");
    let tried = dry(&["--dry-run"]).output().unwrap();
    assert!(String::from_utf8_lossy(&tried.stderr).contains("would be begun anew"), "{tried:?}");

    // As if the first job had been trained on another corpus of this name.
    let run = out.join("jobs/a/seed-0");
    fs::create_dir_all(&run).unwrap();
    let info = format!("{{\"outcome\": \"finished\", \"data\": [[\"{}\", \"0123456789abcdef\", 3]]}}", made.display());
    fs::write(run.join("run.json"), info).unwrap();
    refused(&["`a`, seed 0 has loss.bce = 1.0, where it would now have 3.0", "put the old value back"]);
    config(dir.path(), &made, "");
    fs::rename(corpus(&dir.path().join("other"), 3), &made).unwrap();
    refused(&["c.h5 has changed", "`a`, seed 0 read it", "0123456789ab, and `b`, seed 0", "put the old file back"]);

    // A folder's own jobs need no base any more.
    fs::remove_file(&base).unwrap();
    must(&["sweep", text(&out), "--dry-run"]);
    must(&["sweep", text(&out)]);
}

#[test]
fn a_seed_is_added_and_what_is_done_stays() {
    let dir = tempfile::tempdir().unwrap();
    let made = corpus(dir.path(), 12);
    let (file, out) = (dir.path().join("toy.toml"), dir.path().join("out"));
    let base = config(dir.path(), &made, "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 50\n");
    let write = |seeds: &str| {
        let arms = "[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'same'\nset = { 'loss.dice' = 0.5 }\n";
        fs::write(&file, format!("[sweep]\nseeds = [{seeds}]\nbase = '{}'\n{arms}", base.display())).unwrap();
    };
    let sweep = |more: &[&str]| must(&[&["sweep", text(&file), "-o", text(&out)], more].concat());
    write("0");
    let said = String::from_utf8(sweep(&[]).stderr).unwrap();
    assert!(said.contains("`a` and `same` have the same settings"), "{said}");
    let first = fs::read(out.join("jobs/same/seed-0/run.json")).unwrap();
    write("0, 1");
    let listed = String::from_utf8(sweep(&["--dry-run"]).stdout).unwrap();
    let folders: Vec<&str> = listed.lines().filter_map(|line| line.split(' ').next()).collect();
    assert_eq!(folders, ["jobs/a/seed-0", "jobs/same/seed-0", "jobs/a/seed-1", "jobs/same/seed-1"]);
    sweep(&[]);
    assert!(fs::read(out.join("jobs/same/seed-0/run.json")).unwrap() == first);
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    assert!(table.contains("| a | 2 | 0 |") && table.contains("| same | 2 | 0 |"), "{table}");
    // And one fewer is another sweep.
    write("0");
    let said = refusal(&mut riglab(&["sweep", text(&file), "-o", text(&out)]));
    assert!(said.contains("holds another sweep") && said.contains("can be added"), "{said}");
}

#[test]
fn an_arm_that_failed_is_corrected_and_the_rest_stays() {
    let dir = tempfile::tempdir().unwrap();
    let made = corpus(dir.path(), 12);
    let (file, out) = (dir.path().join("toy.toml"), dir.path().join("out"));
    let base = config(dir.path(), &made, "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 50\n");
    let write = |corpus: &str| {
        let arms = format!(
            "[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\nset = {{ 'data.corpora' = ['{corpus}'] }}\n"
        );
        fs::write(&file, format!("[sweep]\nseeds = [0]\nbase = '{}'\n{arms}", base.display())).unwrap();
    };
    let args = ["sweep", text(&file), "-o", text(&out)];
    write("nowhere.h5");
    let said = refusal(&mut riglab(&args));
    assert!(said.contains("1 job failed"), "{said}");
    let first = fs::read(out.join("jobs/a/seed-0/run.json")).unwrap();
    // Another plan's jobs are not the folder's: what failed was said otherwise.
    write(text(&made));
    let status = must(&[&args[..], &["--status"]].concat());
    let [shown, told] = [status.stdout, status.stderr].map(|said| String::from_utf8(said).unwrap());
    assert!(shown.contains("nowhere.h5") && told.contains("lists other jobs"), "{shown}{told}");
    // Nor is it begun anew on another corpus than the rest.
    let (kept, other) = (dir.path().join("kept.h5"), corpus(&dir.path().join("other"), 3));
    fs::rename(&made, &kept).and_then(|()| fs::rename(&other, &made)).unwrap();
    let said = refusal(&mut riglab(&args));
    assert!(said.contains("has changed: `a`, seed 0 read it") && said.contains("`b`, seed 0 would"), "{said}");
    fs::rename(&kept, &made).unwrap();
    let dry = String::from_utf8(must(&[&args[..], &["--dry-run"]].concat()).stderr).unwrap();
    assert!(
        dry.contains("would be begun anew") && dry.contains("`b`, seed 0") && !dry.contains("no such corpus"),
        "{dry}"
    );
    let said = String::from_utf8(must(&args).stderr).unwrap();
    assert!(said.contains("begun anew") && said.contains("replaced"), "{said}");
    assert!(fs::read(out.join("jobs/a/seed-0/run.json")).unwrap() == first);
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    assert!(table.contains("| a | 1 | 0 |") && table.contains("| b | 1 | 0 |"), "{table}");
}

#[test]
fn runs_that_learn_from_different_corpora_are_evaluated_on_the_same() {
    let dir = tempfile::tempdir().unwrap();
    // Other creatures: none of what is tested on in one was learned from in the other.
    let many = corpus(&dir.path().join("many"), 12);
    let few = corpus_of(&dir.path().join("few"), 9, "500..900");
    let (file, out) = (dir.path().join("toy.toml"), dir.path().join("out"));
    let more = "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 50\nprefixes = [4]\n";
    let base = config(dir.path(), &many, more);
    let write = |evaluation: &str| {
        let arm = |name: &str, corpus: &Path| {
            format!("[[sweep.arms]]\nname = '{name}'\nset = {{ 'data.corpora' = ['{}'] }}\n", text(corpus))
        };
        let of = "eval.json:report.rows[split=test_new,method=raw,tokens=4].pooled.l1";
        let metric = format!("[[sweep.metrics]]\nof = '{of}'\nname = 'L1'\nbetter = 'lower'\n");
        let head = format!("[sweep]\nseeds = [0, 1]\nbase = '{}'\n{evaluation}\n", text(&base));
        fs::write(&file, [head, arm("many", &many), arm("few", &few), metric].concat()).unwrap();
    };
    let args = ["sweep", text(&file), "-o", text(&out)];
    let sweep = || String::from_utf8(must(&args).stderr).unwrap();
    let mixed = "not comparable between points: runs of other corpora";
    let run = |point: &str, name: &str| fs::read_to_string(out.join(format!("jobs/{point}/seed-1/{name}"))).unwrap();

    // What no evaluation can have, and one that none is made with, are refused before anything runs.
    let all_in = |split: &str| {
        let made = dir.path().join(format!("{split}.h5"));
        must(&["dataset", "import", text(&many.with_file_name("files")), "-o", text(&made), "--all-in", split]);
        format!("evaluate = true\nevaluate_with = {{ 'eval.cuts' = [0.1, 0.2], 'data.corpora' = ['{}'] }}", text(&made))
    };
    let (untested, unchosen) = (all_in("train"), all_in("test_new"));
    for (evaluation, said) in [
        ("evaluate_with = { 'eval.prefixes' = [4] }", "add `evaluate = true`"),
        ("evaluate = true\nevaluate_with = { 'train.steps' = 3 }", "an evaluation cannot change"),
        ("evaluate = true\nevaluate_with = { 'eval.prefix' = [4] }", "prefixes"),
        // And what would be told after the training alone.
        ("evaluate = true\nevaluate_with = { 'data.corpora' = ['nowhere.h5'] }", "nowhere.h5: no such corpus"),
        ("evaluate = true\nevaluate_with = { 'data.test' = ['tset_new'] }", "no asset in `tset_new`; their splits are"),
        ("evaluate = true\nevaluate_with = { 'data.test' = ['test_new', 'tset'] }", "no asset in `tset`; their splits"),
        (
            untested.as_str(),
            "no asset in `test_seen` nor in `test_new`; their splits are `train` (12); name splits with assets in data.test",
        ),
        (unchosen.as_str(), "no asset in `val` (data.validate) by which to choose one of eval.cuts"),
        ("evaluate = true\nset = { 'data.test' = [] }", "sweep.evaluate: data.test names no split to evaluate"),
    ] {
        write(evaluation);
        let refused = refusal(&mut riglab(&args));
        assert!(refused.contains("evaluate") && refused.contains(said) && !out.exists(), "{refused}");
    }
    write("evaluate = true");
    let said = sweep();
    assert!(said.contains("not all runs are of the same corpora") && said.contains("evaluate_with = {"), "{said}");
    let (table, trained) = (fs::read_to_string(out.join("table.md")).unwrap(), run("few", "run.json"));
    assert!(table.contains(mixed) && !table.contains("Differences"), "{table}");

    write(&format!("evaluate = true\nevaluate_with = {{ 'data.corpora' = ['{}'] }}", text(&many)));
    let said = sweep();
    assert!(said.contains("not all runs learned from the same corpora") && !said.contains("evaluated on"), "{said}");
    assert_eq!(run("few", "run.json"), trained, "nothing is trained anew");
    let evaluation: serde_json::Value = serde_json::from_str(&run("few", "eval.json")).unwrap();
    assert_eq!(evaluation["data"][0][0], text(&many));
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    assert!(!table.contains(mixed) && table.contains("| L1 | few |"), "{table}");
    assert!(table.contains("Not all runs learned from the same corpora"), "{table}");
    // All is done: nothing is evaluated again.
    let before = fs::metadata(out.join("jobs/few/seed-1/eval.json")).unwrap().modified().unwrap();
    sweep();
    assert_eq!(fs::metadata(out.join("jobs/few/seed-1/eval.json")).unwrap().modified().unwrap(), before);

    // What is only to be evaluated asks for nothing that it learned from.
    fs::copy(&many, &few).unwrap();
    write(&format!("evaluate = true\nevaluate_with = {{ 'data.corpora' = ['{}'], 'eval.cuts' = [0.1] }}", text(&many)));
    sweep();
    assert_eq!(run("few", "run.json"), trained);
    write("evaluate = true");
    let refused = refusal(&mut riglab(&args));
    assert!(refused.contains("corpus.h5 has changed"), "{refused}");
    // And the best of what runs learned by heart is none.
    let train = format!("'data.corpora' = ['{}'], 'data.test' = ['train', 'test_new']", text(&many));
    write(&format!("evaluate = true\nevaluate_with = {{ {train} }}"));
    let said = sweep();
    assert!(
        said.contains("warning: evaluated on assets that were trained on") && said.contains("many, seed 1 ("),
        "{said}"
    );
    let table = fs::read_to_string(out.join("table.md")).unwrap();
    let noted = "not comparable between points: assets that runs were trained on";
    assert!(table.contains(noted) && !table.contains("Differences") && table.contains("data.test="), "{table}");
    assert!(fs::read_to_string(out.join("report.html")).unwrap().contains("riglab eval RUN --set"));
}

#[test]
fn what_evaluations_lack_is_told_before_anything_is_done() {
    let dir = tempfile::tempdir().unwrap();
    let made = corpus(dir.path(), 12);
    let path = |name: &str| dir.path().join(name);
    let (file, out, files) = (path("toy.toml"), path("out"), path("files"));
    let more = "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 50\nprefixes = [4]\n";
    let base = config(dir.path(), &made, more);
    let (rigger, other) = (path("tokenrig.toml"), path("other.toml"));
    let skin = format!("[data]\ncorpora = ['{}']\n[skin]\nrun = 'shipped_with_prior'\n", made.display());
    fs::write(&rigger, format!("extends = 'quickstart/tokenrig.toml'\n{skin}")).unwrap();
    fs::write(&other, "extends = 'config.toml'\n[data]\ntest = ['all']\n").unwrap();
    let import = |name: &str, more: &[&str]| {
        must(&[&["dataset", "import", text(&files), "-o", text(&path(name))], more].concat());
        text(&path(name)).to_owned()
    };
    let (bare, all) = (import("bare.h5", &["--meshes"]), import("all.h5", &["--all-in", "all"]));
    let write = |base: &Path, evaluation: &str| {
        let lines = format!("[sweep]\nseeds = [0]\nevaluate = true\nevaluate_with = {{ {evaluation} }}\n");
        fs::write(&file, format!("{lines}base = '{}'\n", base.display())).unwrap();
    };
    let args = ["sweep", text(&file), "-o", text(&out)];
    for (base, evaluation, said) in [
        (&base, "'data.corpora' = []".to_owned(), "data.corpora names no corpus"),
        (&base, format!("'data.corpora' = ['{0}', '{0}']", made.display()), "hold the same assets"),
        (&base, "'data.weights' = [1.0, 2.0]".into(), "data.weights has 2 numbers for 1 corpora"),
        (&base, format!("'data.corpora' = ['{bare}'], 'data.test' = ['meshes'], 'eval.cuts' = [0.1]"), "bare meshes"),
        (&rigger, "'skin.run' = 'runs/typo'".into(), "skin.run: runs/typo: there is no such file or folder"),
    ] {
        write(base, &evaluation);
        for more in [&["--dry-run"][..], &[]] {
            let refused = refusal(&mut riglab(&[&args, more].concat()));
            assert!(refused.contains("sweep.evaluate_with") && refused.contains(said), "{evaluation}: {refused}");
            assert!(!out.exists());
        }
    }
    write(&rigger, "'skin.run' = 'shipped'");
    must(&[&args[..], &["--dry-run"]].concat());

    // What failed in another evaluation is looked at again.
    fs::rename(&made, path("kept.h5")).unwrap();
    write(&base, "'eval.cuts' = [0.1]");
    assert!(refusal(&mut riglab(&args)).contains("1 job failed"));
    fs::rename(path("kept.h5"), &made).unwrap();
    let run = out.join("jobs/base/seed-0");
    fs::create_dir_all(&run).unwrap();
    fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
    write(&base, "'data.corpora' = ['nope.h5']");
    let before = fs::read(out.join("attempts.jsonl")).unwrap();
    let said = refusal(&mut riglab(&args));
    assert!(said.contains("sweep.evaluate_with: nope.h5: no such corpus"), "{said}");
    assert_eq!(fs::read(out.join("attempts.jsonl")).unwrap(), before);

    // The training's corpora need not have the splits that evaluations name, on corpora of their own.
    write(&other, &format!("'data.corpora' = ['{all}'], 'data.test' = ['all'], 'eval.cuts' = [0.1]"));
    let tested = path("tested");
    must(&["sweep", text(&file), "-o", text(&tested)]);
    let said = refusal(&mut riglab(&["train", text(&other), "--run", text(&path("alone"))]));
    assert!(said.contains("no asset in `all`"), "{said}");
}

#[test]
fn jobs_take_the_threads_that_the_command_line_gives() {
    let dir = tempfile::tempdir().unwrap();
    let base = config(dir.path(), &dir.path().join("nowhere.h5"), "");
    let file = dir.path().join("toy.toml");
    fs::write(&file, format!("[sweep]\nquestion = 'How many?'\nseeds = [0]\nbase = '{}'\n", base.display())).unwrap();
    let out = dir.path().join("out");
    // One job would take all processors.
    let said = refusal(&mut riglab(&["sweep", text(&file), "-o", text(&out), "--jobs", "1", "--threads", "1"]));
    assert!(said.contains("1 at a time with 1 thread each"), "{said}");
    // A later call goes on in the same way.
    let said = refusal(&mut without_threads(&["sweep", text(&out), "--retry"]));
    assert!(said.contains("1 at a time with 1 thread each"), "{said}");
    // And a single job does take all of them.
    let other = dir.path().join("other");
    let said = refusal(&mut without_threads(&["sweep", text(&file), "-o", text(&other)]));
    let all = std::thread::available_parallelism().unwrap().get();
    assert!(said.contains(&format!("1 at a time with {all} thread")), "{said}");
}

#[test]
fn calls_that_make_one_folder_leave_it_to_one_of_them() {
    let dir = tempfile::tempdir().unwrap();
    let base = config(dir.path(), &corpus(dir.path(), 12), "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 50\n");
    let out = dir.path().join("out");
    let file = |seed: u64| {
        let file = dir.path().join(format!("race{seed}.toml"));
        fs::write(&file, format!("[sweep]\nseeds = [{seed}]\nbase = '{}'\n", base.display())).unwrap();
        file
    };
    let calls = [11, 22].map(file).map(|file| {
        let mut call = riglab(&["sweep", text(&file), "-o", text(&out)]);
        call.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    });
    let ended = calls.map(|call| call.wait_with_output().unwrap());
    let won = ended.iter().position(|end| end.status.success()).expect("one goes on");
    let said = String::from_utf8_lossy(&ended[1 - won].stderr).into_owned();
    assert!(said.contains("another process is running") || said.contains("holds another sweep"), "{said}");
    // The folder is the winner's alone.
    let (own, other) = if won == 0 { (11, 22) } else { (22, 11) };
    assert!(fs::read_to_string(out.join("sweep.json")).unwrap().contains(&format!("train.seed={own}")));
    assert!(out.join(format!("jobs/base/seed-{own}/run.json")).is_file());
    assert!(!out.join(format!("configs/base/seed-{other}.toml")).exists());
}

#[test]
fn a_sweep_that_was_begun_elsewhere_is_refused_where_its_files_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let made = corpus(dir.path(), 12);
    let name = Path::new(made.file_name().unwrap());
    config(dir.path(), name, "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 50\n");
    let other = dir.path().join("other");
    fs::create_dir(&other).unwrap();
    let write = |seeds: &str| {
        fs::write(dir.path().join("toy.toml"), format!("[sweep]\nseeds = [{seeds}]\nbase = 'config.toml'\n")).unwrap();
    };
    let call = |at: &Path, args: &[&str]| {
        let mut command = riglab(args);
        command.current_dir(at);
        command
    };
    write("0");
    assert!(call(dir.path(), &["sweep", "toy.toml", "-o", "out"]).output().unwrap().status.success());
    fs::remove_dir_all(dir.path().join("out/jobs/base/seed-0")).unwrap();
    let said = refusal(&mut call(&other, &["sweep", "../out"]));
    assert!(said.contains("`base`, seed 0 reads corpus.h5, which is not below this folder"), "{said}");
    let begun = dir.path().canonicalize().unwrap();
    assert!(said.contains(&format!("hint: cd {} && riglab sweep /", begun.display())), "{said}");
    // Nothing has failed by it.
    assert!(!dir.path().join("out/attempts.jsonl").exists());
    assert!(call(dir.path(), &["sweep", "out"]).output().unwrap().status.success());
}

/// What must be equal.
fn result(sweep: &Path) -> BTreeMap<&'static str, String> {
    let read = |name: &'static str| (name, fs::read_to_string(sweep.join(name)).unwrap());
    ["results.jsonl", "table.md", "table.tex", "table.csv"].into_iter().map(read).collect()
}

/// A call that says nothing of threads.
fn without_threads(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_riglab"));
    command.args(args);
    command
}

/// Starts it and kills it once it has begun its jobs and a while has passed; its runs live on. False when it was
/// done before.
fn killed_after(mut call: Command, delay: Duration, sweep: &Path) -> bool {
    let mut child = call.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let start = Instant::now();
    while start.elapsed() < delay || !sweep.join("jobs").exists() {
        if let Some(status) = child.try_wait().unwrap() {
            // Some of its jobs fail.
            assert_eq!(status.code(), Some(1), "it failed by itself");
            return false;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let running = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    running
}
