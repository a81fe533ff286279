//! What goes wrong ends in a sentence that names the file and the remedy, with earlier work intact.

mod binary;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use binary::{config, corpus, must, refusal, riglab, text};
use serde_json::Value;

/// One corpus and one short run for all tests.
fn ready() -> &'static Path {
    static READY: OnceLock<tempfile::TempDir> = OnceLock::new();
    let dir = READY.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let corpus = corpus(dir.path(), 12);
        let config = config(dir.path(), &corpus, "[train]\nsteps = 3\n[eval]\nvalidation_vertices = 20\n");
        must(&["train", text(&config), "--run", text(&dir.path().join("run"))]);
        dir
    });
    dir.path()
}

/// Trains the shared config with one more setting; gives what was said.
fn with(set: &str) -> String {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    let said = refusal(&mut riglab(&["train", text(&ready().join("config.toml")), "--run", text(&run), "--set", set]));
    assert!(!run.join("checkpoints/last").exists());
    said
}

#[test]
fn settings_that_cannot_be_are_refused_by_key() {
    for (set, parts) in [
        ("model.encoder_width=65", &["encoder_width", "heads"][..]),
        ("model.levels=[1, 8]", &["levels"]),
        ("train.steps=0", &["train.steps", "at least 1"]),
        ("train.stpes=10", &["train.stpes", "steps"]),
        ("train.steps='ten'", &["train.steps"]),
        ("sampling.shape_points=4", &["shape_points"]),
        ("data.train=['nowhere']", &["data.train", "nowhere"]),
        ("data.test=['nope']", &["data.test", "no asset in `nope`", "--set data.test="]),
        ("loss.kl=0.1", &["loss.kl", "bottleneck"]),
        ("task='fsq_vae'", &["fsq_vae", "fsq_cvae"]),
        ("model.encoder_layers=1000000000000", &["encoder_layers", "at most 10000"]),
        ("sampling.rigs=1000000000000", &["sampling.rigs", "more than any machine holds"]),
        ("model.encoder_width=8000000", &["memory", "make it smaller"]),
        ("train.optim.clip=inf", &["train.optim.clip", "no number"]),
    ] {
        let said = with(set);
        for part in parts {
            assert!(said.contains(part), "{set}: {said}");
        }
    }
}

/// As when messages go to a file on a disk that is full.
#[test]
fn messages_that_cannot_be_written_end_no_training() {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut train = riglab(&["train", text(&ready().join("config.toml")), "--run", text(&run)]);
    assert!(train.stderr(full).status().unwrap().success());
    assert!(run.join("checkpoints/last").exists());
}

#[test]
fn counts_beyond_all_measure_are_refused() {
    let temp = tempfile::tempdir().unwrap();
    let out = temp.path().join("out");
    for args in [&["synth", "--count", "18446744073709551615"][..], &["rig", "a.glb", "--samples", "1000000"]] {
        let said = refusal(riglab(args).args(["-o", text(&out)]));
        assert!(said.contains("is not in") && !out.exists(), "{said}");
    }
    let said = refusal(&mut riglab(&["--threads", "18446744073709551615", "doctor"]));
    assert!(said.contains("--threads"), "{said}");
}

#[test]
fn devices_that_are_not_there_are_refused_with_the_remedy() {
    let of = |args: &[&str]| refusal(riglab(args).current_dir(ready()));
    for name in ["gpu", "cpu:1", "cuda:first"] {
        let said = of(&["rig", "a.glb", "-o", "b.glb", "--device", name]);
        assert!(said.contains(&format!("--device {name}: give `cpu`, or `cuda:0` and so on")), "{said}");
    }
    // The word in any case: what is told is about the file.
    assert!(of(&["rig", "a.glb", "-o", "b.glb", "--device", "CPU"]).contains("a.glb"));
    // No machine has as many, with CUDA or without.
    for args in [&["train", "config.toml", "--dry-run"][..], &["eval", "run"]] {
        let said = refusal(riglab(args).current_dir(ready()).env("RIGLAB_DEVICE", "cuda:9999"));
        let told = said.contains("LD_LIBRARY_PATH") || said.contains("GPU");
        assert!(said.contains("--device cuda:9999: ") && told, "{said}");
    }
}

#[test]
fn sizes_of_a_model_beyond_all_measure_are_refused_where_they_are_read() {
    let dir = tempfile::tempdir().unwrap();
    copy(&ready().join("run"), &dir.path().join("run"));
    let run = dir.path().join("run");
    let path = run.join("config.toml");
    let text_of = fs::read_to_string(&path).unwrap();
    let layers = text_of.lines().find(|l| l.starts_with("decoder_layers")).unwrap();
    fs::write(&path, text_of.replace(layers, "decoder_layers = 1000000000000")).unwrap();
    let set = format!("skin.run={:?}", text(&run));
    let args =
        ["train", "quickstart/tokenrig.toml", "--dry-run", "--set", set.as_str(), "--set", "data.corpora=['c.h5']"];
    let said = refusal(riglab(&args).current_dir(ready()));
    assert!(said.contains("config.toml") && said.contains("more than any machine holds"), "{said}");
}

#[test]
fn a_reader_that_leaves_early_ends_the_command_quietly() {
    let dir = tempfile::tempdir().unwrap();
    must(&["synth", "-o", text(dir.path()), "--count", "1"]);
    let names = fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path());
    let file = names.into_iter().find(|p| p.extension().is_some_and(|e| e == "glb")).unwrap();
    // More than a pipe holds, into a pipe that nobody reads.
    let mut child = riglab(&["inspect", "--json", "--all-vertices", text(&file)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let ended = child.wait_with_output().unwrap();
    assert!(!ended.status.success());
    assert_eq!(String::from_utf8_lossy(&ended.stderr), "");
}

#[test]
fn notes_that_nobody_reads_end_no_work() {
    let dir = tempfile::tempdir().unwrap();
    let (files, out) = (dir.path().join("files"), dir.path().join("c.h5"));
    must(&["synth", "-o", text(&files), "--count", "2", "--triangles", "400..800"]);
    let args = ["curate", text(&files), "-o", text(&out), "--config", "curation/any.toml"];
    let mut child = riglab(&args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stderr.take());
    assert!(child.wait().unwrap().success());
    must(&["dataset", "verify", text(&out)]);
}

#[test]
fn a_corpus_that_is_missing_cut_off_or_something_else_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let whole = fs::read(ready().join("corpus.h5")).unwrap();
    let cut = dir.path().join("cut.h5");
    for share in [0, 10, 50, 99] {
        fs::write(&cut, &whole[..whole.len() * share / 100]).unwrap();
        for args in [&["dataset", "stats", text(&cut)][..], &["dataset", "verify", text(&cut)]] {
            let said = refusal(&mut riglab(args));
            assert!(said.contains("cut.h5"), "{share} %: {said}");
        }
    }
    for corpus in [dir.path().join("nowhere.h5"), cut] {
        let said = with(&format!("data.corpora=['{}']", text(&corpus)));
        assert!(said.contains(text(&corpus)), "{said}");
    }
    let text_file = dir.path().join("notes.h5");
    fs::write(&text_file, "not a corpus").unwrap();
    assert!(refusal(&mut riglab(&["dataset", "inspect", text(&text_file)])).contains("notes.h5"));
}

#[test]
fn changed_bytes_are_found_by_verify() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("changed.h5");
    let mut bytes = fs::read(ready().join("corpus.h5")).unwrap();
    // Somewhere between the first and the last of the data; the ends of tables are padding.
    let step = bytes.len() / 64;
    (8..56).for_each(|k| bytes[k * step] ^= 0x40);
    fs::write(&path, bytes).unwrap();
    let said = refusal(&mut riglab(&["dataset", "verify", text(&path)]));
    assert!(said.contains("damaged") || said.contains("changed.h5"), "{said}");
}

#[test]
fn folders_and_files_without_rigs_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("c.h5");
    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let import = |folder: &Path| refusal(&mut riglab(&["dataset", "import", text(folder), "-o", text(&out)]));
    assert!(import(&empty).contains("empty"));
    assert!(import(&dir.path().join("nowhere")).contains("nowhere"));
    let (broken, cut) = (empty.join("broken.glb"), empty.join("cut.glb"));
    fs::write(&broken, b"").unwrap();
    let creature = fs::read_dir(ready().join("files")).unwrap().map(|e| e.unwrap().path());
    let creature = creature.into_iter().find(|p| p.extension().is_some_and(|e| e == "glb")).unwrap();
    let bytes = fs::read(creature).unwrap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    assert!(import(&empty).contains("none of the 2 files"));
    for file in [&broken, &cut] {
        let said = refusal(&mut riglab(&["inspect", text(file)]));
        assert!(said.contains(text(file)), "{said}");
    }
    assert!(!out.exists());
    // One good file among them is enough, and the others are told.
    fs::write(empty.join("good.glb"), &bytes).unwrap();
    let told = must(&["dataset", "import", text(&empty), "-o", text(&out)]);
    let told = String::from_utf8_lossy(&told.stderr).into_owned();
    assert!(told.contains("broken.glb") && told.contains("cut.glb"), "{told}");
}

#[test]
fn a_checkpoint_of_another_model_is_refused_and_kept() {
    let dir = tempfile::tempdir().unwrap();
    copy(&ready().join("run"), &dir.path().join("run"));
    let run = dir.path().join("run");
    let path = run.join("config.toml");
    let text_of = fs::read_to_string(&path).unwrap();
    assert!(text_of.contains("decoder_width = 64"));
    fs::write(&path, text_of.replace("decoder_width = 64", "decoder_width = 32")).unwrap();
    let before = fs::read(run.join("checkpoints/step-00000003/model.safetensors")).unwrap();
    for args in [&["eval", text(&run)][..], &["train", "--resume", text(&run)]] {
        let said = refusal(&mut riglab(args));
        assert!(said.contains("step-00000003") || said.contains("best"), "{said}");
    }
    assert_eq!(fs::read(run.join("checkpoints/step-00000003/model.safetensors")).unwrap(), before);
    assert!(refusal(&mut riglab(&["eval", text(&dir.path().join("none"))])).contains("none"));
}

#[test]
fn codes_that_are_no_tokens_are_refused_by_what_writes_tokens() {
    let dir = tempfile::tempdir().unwrap();
    copy(&ready().join("run"), &dir.path().join("real_numbers"));
    let run = dir.path().join("real_numbers");
    let path = run.join("config.toml");
    let text_of = fs::read_to_string(&path).unwrap();
    assert!(text_of.contains("bottleneck = \"fsq\""));
    let other =
        text_of.replace("bottleneck = \"fsq\"", "bottleneck = \"gaussian\"").replace("spread = 0.03", "spread = 0.0");
    fs::write(&path, other).unwrap();
    let (skin, corpora) = (format!("skin.run='{}'", text(&run)), ready().join("corpus.h5"));
    let corpora = format!("data.corpora=['{}']", text(&corpora));
    let train = ["train", "quickstart/tokenrig.toml", "--set", &skin, "--set", &corpora];
    let said = refusal(riglab(&train).arg("--run").arg(dir.path().join("tokenrig")));
    assert!(said.contains("real_numbers") && said.contains("no tokens") && said.contains("fsq"), "{said}");
}

#[test]
fn an_auto_encoder_of_another_axis_is_refused_before_anything_is_trained() {
    let dir = tempfile::tempdir().unwrap();
    let skin = format!("skin.run='{}'", text(&ready().join("run")));
    let corpora = format!("data.corpora=['{}']", text(&ready().join("corpus.h5")));
    let train = ["train", "quickstart/tokenrig.toml", "--set", &skin, "--set", &corpora, "--set", "data.up=z"];
    for more in [vec!["--dry-run"], vec!["--run", text(&dir.path().join("tokenrig"))]] {
        let said = refusal(&mut riglab(&[&train[..], &more].concat()));
        let told = ["data.up = \"z\"", "with data.up = \"y\"", "skin.run", "--set data.up=y"];
        assert!(told.iter().all(|part| said.contains(part)), "{said}");
    }
    assert!(!dir.path().join("tokenrig").exists());
}

#[test]
fn a_full_disk_ends_the_run_and_leaves_its_last_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    copy(&ready().join("run"), &dir.path().join("run"));
    let run = dir.path().join("run");
    let path = run.join("config.toml");
    let longer = fs::read_to_string(&path).unwrap().replace("steps = 3\n", "steps = 6\n");
    fs::write(&path, longer).unwrap();
    // Files may not grow beyond 64 KB: smaller than a checkpoint's weights.
    let said = refusal(&mut limited(&["train", "--resume", text(&run)], 128));
    assert!(said.contains("checkpoints"), "{said}");
    must(&["eval", text(&run), "--checkpoint", "last", "--pictures", "0"]);
    must(&["train", "--resume", text(&run)]);
    assert!(run.join("checkpoints/step-00000006").is_dir());

    let out = dir.path().join("c.h5");
    let said = refusal(&mut limited(&["dataset", "import", text(&ready().join("files")), "-o", text(&out)], 128));
    assert!(said.contains("c.h5") || said.contains(text(dir.path())), "{said}");
    assert!(!out.exists());
    let left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 1, "only the run is left: {left:?}");
}

/// A call whose files may have so many blocks of 512 bytes; writing beyond fails as on a full disk.
fn limited(args: &[&str], blocks: u32) -> Command {
    let mut command = Command::new("sh");
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
    command.args(["-c", &script, env!("CARGO_BIN_EXE_riglab"), "--threads", "1"]).args(args);
    command
}

#[test]
fn a_folder_without_permission_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let closed = dir.path().join("closed");
    fs::create_dir(&closed).unwrap();
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o500)).unwrap();
    if fs::write(closed.join("probe"), b"").is_ok() {
        println!("skipped: this user may write everywhere");
        return;
    }
    let run = closed.join("run");
    let config = ready().join("config.toml");
    assert!(refusal(&mut riglab(&["train", text(&config), "--run", text(&run)])).contains("closed"));
    let out = closed.join("c.h5");
    let files = ready().join("files");
    assert!(refusal(&mut riglab(&["dataset", "import", text(&files), "-o", text(&out)])).contains("closed"));
    assert!(refusal(&mut riglab(&["synth", "-o", text(&closed.join("s"))])).contains("closed"));
}

#[test]
fn a_place_where_nobody_may_write_is_told_once_before_the_work_with_the_remedy_that_helps() {
    // Not even root.
    let closed = Path::new("/sys");
    let (files, charts) = (ready().join("files"), closed.join("charts"));
    let sweep = ready().join("closed.toml");
    fs::write(&sweep, format!("[sweep]\nseeds = [0]\nbase = '{}'\n", text(&ready().join("config.toml")))).unwrap();
    let out = ready().join("closed-sweep");
    for (call, begun) in [
        (["rig", text(&files), "-o", "/sys/out"].as_slice(), "model:"),
        (&["curate", text(&files), "-o", "/sys/c.h5"], "looking"),
        (&["sweep", text(&sweep), "-o", text(&out), "--charts", text(&charts)], "1 job"),
    ] {
        let said = refusal(&mut riglab(call));
        assert!(said.matches("where you may write").count() == 1 && said.contains("/sys"), "{call:?}: {said}");
        assert!(!said.contains("left out") && !said.contains("make room") && !said.contains(begun), "{said}");
    }
    assert!(!out.exists());
}

#[test]
fn what_is_there_is_not_overwritten() {
    let run = ready().join("run");
    let said = refusal(&mut riglab(&["train", text(&ready().join("config.toml")), "--run", text(&run)]));
    assert!(said.contains("--resume"), "{said}");
    let said = refusal(&mut riglab(&["synth", "-o", text(&ready().join("files"))]));
    assert!(said.contains("not empty"), "{said}");
}

/// A folder with what is in it; links stay links.
fn copy(from: &Path, to: &Path) {
    let status = Command::new("cp").arg("-a").args([from, to]).status().unwrap();
    assert!(status.success());
}

#[test]
fn what_is_left_of_another_run_is_not_taken_for_a_new_one() {
    let (temp, old) = (tempfile::tempdir().unwrap(), ready().join("run"));
    let run = temp.path().join("run");
    fs::create_dir_all(run.join("checkpoints")).unwrap();
    fs::copy(old.join("metrics.jsonl"), run.join("metrics.jsonl")).unwrap();
    let said = refusal(&mut riglab(&["train", text(&ready().join("config.toml")), "--run", text(&run)]));
    assert!(said.contains("whose config.toml is gone"), "{said}");
    assert!(run.join("metrics.jsonl").exists() && !run.join("config.toml").exists());
}

#[test]
fn a_damaged_checkpoint_is_told_of_and_an_older_one_gone_on_from() {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    let more = ["--set", "train.save_every=1", "--set", "train.keep=3"];
    must(&[&["train", text(&ready().join("config.toml")), "--run", text(&run)], more.as_slice()].concat());
    fs::write(run.join("checkpoints/step-00000003/state.json"), "{\"rubbish").unwrap();
    let done = must(&["train", "--resume", text(&run)]);
    let said = String::from_utf8(done.stderr).unwrap();
    assert!(said.contains("step-00000003") && said.contains("going on from step 2"), "{said}");
}

/// Cuts a file to half of its bytes.
fn cut(path: &Path) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
}

#[test]
fn of_a_checkpoint_that_is_cut_off_an_older_one_is_gone_on_from() {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    let more = ["--set", "train.save_every=1", "--set", "train.keep=3"];
    must(&[&["train", text(&ready().join("config.toml")), "--run", text(&run)], more.as_slice()].concat());
    let metrics = fs::read(run.join("metrics.jsonl")).unwrap();
    let lose = |path: &Path| fs::remove_file(path).unwrap();
    let harms: [&dyn Fn(&Path); 2] = [&cut, &lose];
    let files = ["optimizer.safetensors", "model.safetensors", "ema.safetensors"];
    for (file, harm) in files.into_iter().flat_map(|file| harms.map(|harm| (file, harm))) {
        let newest = run.join("checkpoints/step-00000003");
        let whole = fs::read(newest.join(file)).unwrap();
        harm(&newest.join(file));
        let done = must(&["train", "--resume", text(&run)]);
        let said = String::from_utf8(done.stderr).unwrap();
        assert!(said.contains(file) && said.contains("going on from step 2"), "{said}");
        assert!(fs::read(run.join("metrics.jsonl")).unwrap() == metrics, "the last step is the same again");
        assert!(fs::read(newest.join(file)).unwrap() == whole, "and its checkpoint whole");
        assert!(run.join("checkpoints/step-00000002").is_dir(), "what is whole is kept");
    }
    // As a kill leaves it between a checkpoint and the link to it.
    let links = ["best", "last"].map(|name| run.join("checkpoints").join(name));
    let leads = || links.each_ref().map(|link| fs::read_link(link).unwrap());
    let named = leads();
    links.iter().for_each(|link| fs::remove_file(link).unwrap());
    must(&["train", "--resume", text(&run)]);
    assert_eq!(leads(), named);
    // Without any that is whole, nothing is begun anew.
    for step in 1..=3 {
        cut(&run.join(format!("checkpoints/step-0000000{step}/model.safetensors")));
    }
    let said = refusal(&mut riglab(&["train", "--resume", text(&run)]));
    assert!(said.contains("no checkpoint is left") && said.contains("model.safetensors"), "{said}");
    assert!(said.contains("--run OTHER") && fs::read(run.join("metrics.jsonl")).unwrap() == metrics, "{said}");
}

/// Puts NaN in the first number of a file of tensors; gives the tensor's name.
fn spoil(path: &Path) -> String {
    let mut bytes = fs::read(path).unwrap();
    let head = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let tensors: Value = serde_json::from_slice(&bytes[8..8 + head]).unwrap();
    let real =
        |(_, info): &(&String, &Value)| info["dtype"] == "F32" && info["data_offsets"][1] != info["data_offsets"][0];
    let (name, info) = tensors.as_object().unwrap().iter().find(real).unwrap();
    let at = 8 + head + info["data_offsets"][0].as_u64().unwrap() as usize;
    bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(path, bytes).unwrap();
    name.clone()
}

#[test]
fn a_checkpoint_that_holds_nan_is_not_gone_on_from() {
    let temp = tempfile::tempdir().unwrap();
    for file in ["optimizer.safetensors", "model.safetensors", "ema.safetensors"] {
        let run = temp.path().join(file);
        copy(&ready().join("run"), &run);
        let name = spoil(&run.join("checkpoints/step-00000003").join(file));
        let said = refusal(&mut riglab(&["train", "--resume", text(&run)]));
        assert!(said.contains(&format!("{file}: tensor `{name}` holds NaN")), "{said}");
        assert!(said.contains("step-00000003") && said.contains("earlier checkpoint"), "{said}");
    }
}

#[test]
fn a_training_that_starts_from_a_run_takes_its_best_or_a_checkpoint_that_is_named() {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    copy(&ready().join("run"), &run);
    fs::remove_file(run.join("checkpoints/best")).unwrap();
    let said = with(&format!("train.start.from={}", run.display()));
    let last = run.join("checkpoints/last");
    assert!(said.contains("no checkpoint is the best of this run") && said.contains(text(&last)), "{said}");
    let out = temp.path().join("out");
    let from = format!("train.start.from={}", last.display());
    must(&["train", text(&ready().join("config.toml")), "--run", text(&out), "--set", &from]);
}

#[test]
fn a_damaged_state_says_what_to_do() {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    copy(&ready().join("run"), &run);
    for state in [&b"{\"task\": 3"[..], b"\xff\xfe"] {
        fs::write(run.join("checkpoints/step-00000003/state.json"), state).unwrap();
        for command in [&["train", "--resume", text(&run)][..], &["eval", text(&run)]] {
            let said = refusal(&mut riglab(command));
            assert!(said.contains("state.json cannot be understood") && said.contains("from a copy"), "{said}");
        }
    }
}

#[test]
fn what_a_run_was_begun_with_is_not_lost_by_a_broken_file() {
    let temp = tempfile::tempdir().unwrap();
    let run = temp.path().join("run");
    copy(&ready().join("run"), &run);
    cut(&run.join("run.json"));
    let left = fs::read(run.join("run.json")).unwrap();
    for command in [&["train", "--resume", text(&run)][..], &["eval", text(&run)]] {
        let said = refusal(&mut riglab(command));
        assert!(said.contains("run.json: cannot be understood") && said.contains("from a copy"), "{said}");
    }
    assert!(fs::read(run.join("run.json")).unwrap() == left);
}

#[test]
fn a_sweep_is_not_trained_as_a_run() {
    let temp = tempfile::tempdir().unwrap();
    let file = temp.path().join("sweep.toml");
    fs::write(&file, "[sweep]\nbase = \"quickstart/fsq_cvae.toml\"\nseeds = [0]\n").unwrap();
    let said = refusal(&mut riglab(&["train", text(&file)]));
    assert!(said.contains("is a sweep of several runs") && said.contains("riglab sweep"), "{said}");
}

#[test]
fn a_config_without_a_task_is_named() {
    let temp = tempfile::tempdir().unwrap();
    let config = temp.path().join("mine.toml");
    fs::write(&config, "[train]\nsteps = 3\n").unwrap();
    for more in [&[][..], &["--set", "train.seed=1"]] {
        let said = refusal(&mut riglab(&[&["train", text(&config)], more].concat()));
        assert!(said.contains("mine.toml: nothing sets `task`") && said.contains("task = \"fsq_cvae\""), "{said}");
    }
}

#[test]
fn a_run_whose_checkpoints_are_gone_is_not_begun_anew() {
    let temp = tempfile::tempdir().unwrap();
    copy(&ready().join("run"), &temp.path().join("run"));
    let run = temp.path().join("run");
    let before = ["metrics.jsonl", "run.json"].map(|file| fs::read(run.join(file)).unwrap());
    for gone in [&run.join("checkpoints/step-00000003"), &run.join("checkpoints")] {
        fs::remove_dir_all(gone).unwrap();
        // Asking again changes nothing.
        for _ in 0..2 {
            let said = refusal(&mut riglab(&["train", "--resume", text(&run)]));
            assert!(said.contains("3 steps were done, but no checkpoint is there"), "{said}");
            assert!(said.contains("--run OTHER"), "{said}");
            assert!(["metrics.jsonl", "run.json"].map(|file| fs::read(run.join(file)).unwrap()) == before);
        }
    }
}

#[test]
fn an_evaluation_changes_nothing_that_was_trained() {
    let run = ready().join("run");
    let eval = |set: &str| refusal(&mut riglab(&["eval", text(&run), "--set", set]));
    for (set, parts) in [
        ("model.heads=2", &["--set model.heads=2", "trained with"][..]),
        ("model={heads=2}", &["--set model."]),
        ("train.seed=7", &["--set train.seed=7"]),
        ("loss.dice=0.0", &["loss.dice"]),
        ("data.up='z'", &["data.up"]),
        ("data.test=[]", &["data.test names no split"]),
        ("data.test=['test_new', 'test_new']", &["data.test", "test_new is named twice"]),
        ("eval.prefixes=[16, 16]", &["eval.prefixes", "16 is named twice"]),
        ("eval.cuts=[2.0]", &["eval.cuts", "a cut of 2"]),
    ] {
        let said = eval(set);
        assert!(parts.iter().all(|part| said.contains(part)), "{set}: {said}");
    }
    assert!(!run.join("eval.json").exists());
    let other = ready().join("other.json");
    let said =
        must(&["eval", text(&run), "-o", text(&other), "--pictures", "0", "--set", "data.test=['train']"]).stderr;
    let said = String::from_utf8(said).unwrap();
    assert!(
        said.contains("next: riglab report") && said.contains("--eval") && said.contains("other.json -o REPORT"),
        "{said}"
    );
    fs::remove_file(other).unwrap();
    let said = refusal(&mut riglab(&["eval", "runs/nope"]));
    assert!(said.contains("runs/nope: no run here") && !said.contains("looked for"), "{said}");
}

#[test]
fn models_of_every_task_are_shown_and_what_is_exported_is_said() {
    let temp = tempfile::tempdir().unwrap();
    let (run, file) = (ready().join("run"), temp.path().join("a.safetensors"));
    let show = |path: &Path| String::from_utf8(must(&["checkpoint", "show", text(path)]).stdout).unwrap();
    let of_run = show(&run);
    assert!(of_run.contains("of task fsq_cvae") && of_run.contains("3 steps"), "{of_run}");
    assert!(of_run.contains("No card was written"), "{of_run}");
    must(&["checkpoint", "export", text(&run), "-o", text(&file)]);
    let (last, best) = (run.join("checkpoints/last"), fs::read(&file).unwrap());
    must(&["checkpoint", "export", text(&last), "-o", text(&file)]);
    let said = refusal(&mut riglab(&["checkpoint", "export", text(&last), "--checkpoint", "best", "-o", text(&file)]));
    assert!(said.contains("names a checkpoint and --checkpoint best another"), "{said}");
    fs::write(&file, best).unwrap();
    let lines = |shown: &str| shown.lines().skip(1).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(lines(&show(&file)), lines(&of_run), "but for the name");
    assert_eq!(riglab_task::bundle::Stored::open(&file).unwrap().card.text, "", "a model without a card has none");
    // What is known of a model goes on with it.
    let (folder, again, card) =
        (temp.path().join("model"), temp.path().join("b.safetensors"), temp.path().join("c.md"));
    fs::write(&card, "Of twelve creatures.").unwrap();
    must(&["checkpoint", "export", text(&run), "-o", text(&folder), "--card", text(&card)]);
    must(&["checkpoint", "export", text(&folder), "-o", text(&again)]);
    assert!([&folder, &again].iter().all(|path| show(path).contains("Of twelve creatures.")));
    let bare = temp.path().join("bare");
    copy(&run, &bare);
    fs::remove_file(bare.join("checkpoints/step-00000003/optimizer.safetensors")).unwrap();
    let said = refusal(&mut riglab(&["train", "--resume", text(&bare)]));
    assert!(said.contains("weights alone") && said.contains("train.start.from"), "{said}");

    let other = temp.path().join("skin");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("config.toml"), "task = 'unirig_skin'\n").unwrap();
    let export = |run: &Path, more: &[&str]| {
        refusal(&mut riglab(&[&["checkpoint", "export", text(run), "-o", text(&file)], more].concat()))
    };
    let said = export(&other, &[]);
    assert!(said.contains("skin/checkpoints/best"), "{said}");
    for run in [&run, &other] {
        let said = export(run, &["--set", "skin.run='elsewhere'"]);
        assert!(said.contains("builds on no other model"), "{said}");
    }
    let said = export(&run, &["--set", "model.heads=2"]);
    assert!(said.contains("as it was trained") && said.contains("start.model"), "{said}");
}

#[test]
fn parts_of_the_memory_add_up() {
    let done = must(&["train", text(&ready().join("config.toml")), "--dry-run"]);
    let said = String::from_utf8(done.stdout).unwrap();
    let mb = |line: &str| line.split(" MB").next()?.split_whitespace().next_back()?.parse::<f64>().ok();
    let mut lines = said.lines().skip_while(|line| !line.starts_with("memory"));
    let total = mb(lines.next().unwrap()).unwrap();
    let parts: Vec<f64> = lines.take_while(|line| line.starts_with("  ")).filter_map(mb).collect();
    // Each is rounded by itself.
    assert!(parts.len() >= 4 && (parts.iter().sum::<f64>() - total).abs() <= parts.len() as f64, "{said}");
}

#[test]
fn a_training_that_diverged_says_so() {
    let said = with("train.optim={adamw_lr=1e30, muon_lr=1e30}");
    assert!(said.contains("at step") && said.contains("adamw_lr"), "{said}");
    assert!(
        said.contains("diverged") || said.contains("no finite loss") || said.contains("no step was taken"),
        "{said}"
    );
}

#[test]
fn nothing_else_is_written_over_a_corpus() {
    let temp = tempfile::tempdir().unwrap();
    let kept = temp.path().join("kept.h5");
    let files = temp.path().join("files");
    must(&["synth", "-o", text(&files), "--count", "1", "--triangles", "200..300"]);
    let file =
        fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().unwrap() == "glb").unwrap();
    must(&["dataset", "import", text(&files), "-o", text(&kept)]);
    // Another import may replace it, and says so where it is another.
    let import =
        |files: &Path| String::from_utf8(must(&["dataset", "import", text(files), "-o", text(&kept)]).stderr).unwrap();
    assert!(!import(&files).contains("another corpus"));
    let others = temp.path().join("others");
    must(&["synth", "-o", text(&others), "--count", "1", "--seed", "1", "--triangles", "200..300"]);
    let told = import(&others);
    assert!(told.contains("kept.h5 was another corpus before, of 1 asset ("), "{told}");
    let before = fs::read(&kept).unwrap();
    for command in [
        vec!["convert", text(&file), text(&kept)],
        vec!["compare", text(&files), "--truth", text(&files), "-o", text(&kept), "--csv"],
        vec!["eval", text(&ready().join("run")), "-o", text(&kept)],
    ] {
        let said = refusal(&mut riglab(&command));
        assert!(said.contains("is a corpus"), "{command:?}: {said}");
    }
    assert!(fs::read(&kept).unwrap() == before);
}

#[test]
fn a_run_of_relative_paths_says_where_it_goes_on() {
    let temp = tempfile::tempdir().unwrap();
    let place = temp.path().join("my runs");
    fs::create_dir(&place).unwrap();
    fs::copy(ready().join("corpus.h5"), place.join("c.h5")).unwrap();
    let config = config(&place, Path::new("c.h5"), "[train]\nsteps = 2\n[eval]\nvalidation_vertices = 20\n");
    let run = place.join("run");
    assert!(riglab(&["train", text(&config), "--run", text(&run)]).current_dir(&place).status().unwrap().success());
    let said = refusal(riglab(&["train", "--resume", text(&run), "--set", "train.steps=3"]).current_dir(temp.path()));
    assert!(said.contains("corpus c.h5 is not below this folder"), "{said}");
    let hint = said.split_once("hint: ").unwrap().1.trim();
    assert!(hint.contains("cd '") && hint.ends_with(" --set 'train.steps=3'"), "{hint}");
    // As a reader pastes it.
    let script = format!("riglab() {{ \"$0\" --threads 1 \"$@\"; }}\n{hint}");
    let pasted =
        Command::new("sh").args(["-c", &script, env!("CARGO_BIN_EXE_riglab")]).current_dir(temp.path()).output();
    let pasted = pasted.unwrap();
    assert!(pasted.status.success(), "{hint}: {}", String::from_utf8_lossy(&pasted.stderr));
    // An evaluation finds it by itself, and is that of the run.
    assert!(riglab(&["eval", text(&run), "--pictures", "0"]).current_dir(temp.path()).status().unwrap().success());
    let evaluation: serde_json::Value = serde_json::from_slice(&fs::read(run.join("eval.json")).unwrap()).unwrap();
    assert!(evaluation.get("set").is_none() && evaluation["data"][0][0] == text(&place.join("c.h5")), "{evaluation}");
    // One whose corpus was replaced: not gone on with, and evaluated with a warning, unless others are asked for.
    let info = fs::read_to_string(run.join("run.json")).unwrap();
    let mut begun: serde_json::Value = serde_json::from_str(&info).unwrap();
    begun["data"][0][1] = "0123456789abcdef".into();
    fs::write(run.join("run.json"), begun.to_string()).unwrap();
    let other = "begun on c.h5 (0123456789ab), but now there is c.h5 (";
    let said = refusal(riglab(&["train", "--resume", text(&run)]).current_dir(&place));
    let remedies = ["put the former corpora back", "--set train.start.from=RUN"];
    assert!(said.contains(other) && remedies.iter().all(|remedy| said.contains(remedy)), "{said}");
    for (sets, warned) in [([].as_slice(), true), (&["--set", "data.corpora=['c.h5']"], false)] {
        let args = [&["eval", text(&run), "--pictures", "0"], sets].concat();
        let done = riglab(&args).current_dir(&place).output().unwrap();
        let told = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success() && told.contains(other) == warned, "{sets:?}: {told}");
    }
    // One whose run does not say where it was begun.
    let lines: Vec<&str> = info.lines().filter(|line| !line.contains("\"folder\"")).collect();
    fs::write(run.join("run.json"), lines.join("\n")).unwrap();
    let said = refusal(riglab(&["train", "--resume", text(&run)]).current_dir(temp.path()));
    assert!(said.contains("start it in the folder where the run was begun"), "{said}");
}

#[test]
fn experiments_of_the_working_folder_come_before_built_in_ones() {
    let temp = tempfile::tempdir().unwrap();
    let own = temp.path().join("experiments/quickstart");
    fs::create_dir_all(&own).unwrap();
    fs::write(own.join("demo.toml"), "task = 'fsq_cvae'\nmine = 1\n").unwrap();
    fs::write(temp.path().join("other.toml"), "extends = 'quickstart/demo.toml'\n").unwrap();
    for name in ["quickstart/demo.toml", "other.toml", "experiments/quickstart/demo.toml"] {
        let said = refusal(riglab(&["train", name, "--dry-run"]).current_dir(temp.path()));
        assert!(said.contains("mine"), "{name}: {said}");
    }
}

#[test]
fn results_are_written_over_results_alone() {
    let temp = tempfile::tempdir().unwrap();
    let files = temp.path().join("files");
    must(&["synth", "-o", text(&files), "--count", "1", "--triangles", "200..300"]);
    let file =
        fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().unwrap() == "glb").unwrap();
    let (truth, run) = (fs::read(&file).unwrap(), ready().join("run"));
    let (config, notes) = (temp.path().join("mine.toml"), temp.path().join("notes.md"));
    fs::write(&config, "task = \"fsq_cvae\"").unwrap();
    fs::write(&notes, "# Notes").unwrap();
    let compare =
        |out: &Path, form| ["compare", text(&files), "--truth", text(&files), form, "-o", text(out)].map(String::from);
    for command in [
        compare(&file, "--csv").to_vec(),
        ["eval", text(&run), "-o", text(&config)].map(String::from).to_vec(),
        ["report", text(&run), "-o", text(&notes)].map(String::from).to_vec(),
    ] {
        let said = refusal(&mut riglab(&command.iter().map(String::as_str).collect::<Vec<_>>()));
        assert!(said.contains("is there already and no ") && said.contains("another name"), "{command:?}: {said}");
    }
    assert_eq!(fs::read(&file).unwrap(), truth);
    assert_eq!(
        (fs::read_to_string(&config).unwrap(), fs::read_to_string(&notes).unwrap().as_str()),
        ("task = \"fsq_cvae\"".into(), "# Notes")
    );
    // Twice, and in another form.
    let out = temp.path().join("scores");
    for form in ["--csv", "--csv", "--json", "--markdown", "--latex", "--html", "--html"] {
        must(&compare(&out, form).each_ref().map(String::as_str));
    }
    let shown = must(&["compare", text(&files), "--truth", text(&files), "--csv"]).stdout;
    must(&compare(&out, "--csv").each_ref().map(String::as_str));
    assert_eq!(shown, fs::read(&out).unwrap(), "on standard output as in a file");
    let out = temp.path().join("again.md");
    for _ in 0..2 {
        must(&["report", text(&run), "-o", text(&out)]);
    }
}

#[test]
fn outputs_that_cannot_be_are_refused_before_the_work() {
    let temp = tempfile::tempdir().unwrap();
    let (run, out) = (ready().join("run"), temp.path().join("eval"));
    fs::write(&out, "").unwrap();
    let said = refusal(&mut riglab(&["eval", text(&run), "-o", text(&out.with_extension("json"))]));
    assert!(said.contains("pictures") && !said.contains("evaluating"), "{said}");
    let said = refusal(&mut riglab(&["eval", text(&run), "-o", text(temp.path())]));
    assert!(said.contains("is a folder"), "{said}");
    let glb = temp.path().join("a.glb");
    let said = refusal(&mut riglab(&["simulate", "b.glb", "-o", text(&glb), "--png", text(&glb)]));
    assert!(said.contains("name it .png"), "{said}");
}

#[test]
fn a_sweep_whose_charts_would_replace_other_files_is_refused_before_its_jobs() {
    let temp = tempfile::tempdir().unwrap();
    let (file, figures) = (temp.path().join("sweep.toml"), temp.path().join("figures"));
    let base = format!("base = '{}'", text(&ready().join("config.toml")));
    let figure = "[[sweep.figures]]\ntitle = 'By k'\nx = 'k'\nat = [4, 8]\nof = 'eval.json:rows[k={}].iou'";
    fs::write(&file, format!("[sweep]\nseeds = [0]\n{base}\n{figure}\n")).unwrap();
    let sweep = temp.path().join("out");
    let call = ["sweep", text(&file), "-o", text(&sweep), "--charts", text(&figures)];
    for name in ["train-loss.csv", "eval-iou-val.svg", "by-k.svg"] {
        fs::create_dir_all(&figures).unwrap();
        fs::write(figures.join(name), "mine").unwrap();
        // One that is called as no chart may stay.
        fs::write(figures.join("teaser.svg"), "mine").unwrap();
        let said = refusal(&mut riglab(&call));
        assert!(said.contains(name) && said.contains("--charts another folder") && !sweep.exists(), "{said}");
        fs::remove_dir_all(&figures).unwrap();
    }
}

#[test]
fn a_comparison_is_written_in_the_form_that_its_name_says() {
    let temp = tempfile::tempdir().unwrap();
    let files = temp.path().join("files");
    must(&["synth", "-o", text(&files), "--count", "1", "--triangles", "200..300"]);
    // What of the true rigs cannot be looked at is told, in JSON too.
    std::os::unix::fs::symlink("nowhere", files.join("dangling.glb")).unwrap();
    let compare = |out: &str, form: &[&str]| {
        let out = temp.path().join(out);
        let call = ["compare", text(&files), "--truth", text(&files), "--preset", "riglab", "-o", text(&out)];
        riglab(&[&call[..], form].concat())
    };
    assert!(compare("all", &[]).output().unwrap().status.success());
    let read = |name: &str| fs::read_to_string(temp.path().join(name)).unwrap();
    assert!(read("all.html").starts_with("<!doctype html>") && read("all.tex").contains("\\begin{table}"));
    assert!(read("all.csv").starts_with("system,asset,status,") && read("all.md").contains("| --"));
    let json: Value = serde_json::from_str(&read("all.json")).unwrap();
    assert_eq!(json["unread_truth"][0][0], "dangling.glb", "{json}");
    assert!(!temp.path().join("all").exists());
    assert!(compare("one.csv", &[]).output().unwrap().status.success());
    assert!(read("one.csv") == read("all.csv"));
    assert!(refusal(&mut compare("one.pdf", &[])).contains("no form has the ending .pdf"));
    assert!(refusal(&mut compare("one.csv", &["--html"])).contains("does not end as the form does"));
}

#[test]
fn what_is_not_utf8_ends_no_import_and_no_training() {
    use std::os::unix::ffi::OsStrExt;
    let temp = tempfile::tempdir().unwrap();
    let files = temp.path().join("files");
    must(&["synth", "-o", text(&files), "--count", "2", "--triangles", "200..300"]);
    let mut glbs: Vec<_> = fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).collect();
    glbs.retain(|p| p.extension().unwrap() == "glb");
    for (file, name) in glbs.iter().zip([b"a\xff.glb", b"a\xfe.glb"]) {
        fs::rename(file, files.join(std::ffi::OsStr::from_bytes(name))).unwrap();
    }
    fs::write(files.join("manifest.json"), b"[{\"file\": \"a\xff.glb\"}]").unwrap();
    let done = must(&["dataset", "import", text(&files), "-o", text(&temp.path().join("c.h5"))]);
    let said = String::from_utf8_lossy(&done.stderr).into_owned() + &String::from_utf8_lossy(&done.stdout);
    assert!(said.contains("named alike") && said.contains("manifest.json is left out"), "{said}");
    let run = temp.path().join(std::ffi::OsStr::from_bytes(b"r\xff"));
    let mut train = riglab(&["train", text(&ready().join("config.toml")), "--set", "train.steps=1", "--run"]);
    assert!(train.arg(&run).output().unwrap().status.success());
}
