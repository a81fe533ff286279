//! A run that was killed and resumed is the unbroken run, bit for bit.

mod binary;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use binary::{config, corpus, must, refusal, riglab, text};

const STEPS: u64 = 90;
/// Kills of each broken run: 21 in all.
const KILLS: usize = 7;

#[test]
fn a_killed_run_goes_on_as_if_nothing_had_happened() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 12);
    let settings = format!(
        "[train]\nsteps = {STEPS}\nsave_every = 4\nvalidate_every = 30\naccumulate = 2\n[eval]\nvalidation_vertices = 50\n"
    );
    let config = config(dir.path(), &corpus, &settings);

    let whole = dir.path().join("whole");
    let start = Instant::now();
    must(&["train", text(&config), "--run", text(&whole), "--set", "train.workers=2"]);
    let took = start.elapsed();
    let expected = result(&whole);

    for workers in [1, 2, 4] {
        let run = dir.path().join(format!("broken-{workers}"));
        let workers = format!("train.workers={workers}");
        let mut args = vec!["train", text(&config), "--run", text(&run), "--set", &workers];
        let mut kills = 0;
        loop {
            // From before the first step to almost the end of a whole run.
            let delay = took.mul_f64(0.05 + 0.5 * random());
            if kills < KILLS && killed_after(&args, delay) {
                kills += 1;
            } else {
                must(&args);
                break;
            }
            if run.join("config.toml").exists() {
                args = vec!["train", "--resume", text(&run)];
            }
        }
        assert!(kills > 0, "the run was too short to be killed");
        let found = result(&run);
        assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
        for (file, bytes) in &expected {
            assert!(found[file] == *bytes, "{workers}, {kills} kills: {file} differs from the unbroken run's");
        }
    }

    // Without the optimizer's state the result differs: the comparison above can fail.
    let (half, other) = (dir.path().join("half"), dir.path().join("other"));
    must(&["train", text(&config), "--run", text(&half), "--set", "train.keep=100"]);
    must(&["train", text(&config), "--run", text(&other), "--set", "train.keep=100"]);
    for run in [&half, &other] {
        for entry in fs::read_dir(run.join("checkpoints")).unwrap() {
            let path = entry.unwrap().path();
            let step =
                path.file_name().unwrap().to_str().unwrap().strip_prefix("step-").and_then(|n| n.parse::<u64>().ok());
            match step {
                Some(step) if step <= 40 => {}
                Some(_) => fs::remove_dir_all(path).unwrap(),
                None => fs::remove_file(path).unwrap(),
            }
        }
    }
    let state = other.join("checkpoints/step-00000040/optimizer.safetensors");
    forget(&state);
    for run in [&half, &other] {
        must(&["train", "--resume", text(run)]);
    }
    let weights = format!("step-{STEPS:08}/model.safetensors");
    let read = |run: &Path| fs::read(run.join("checkpoints").join(&weights)).unwrap();
    assert!(read(&half) == expected[&weights], "a resume from step 40 is exact");
    assert!(read(&other) != expected[&weights], "a resume without the optimizer's state cannot be");
}

#[test]
fn an_extended_run_is_the_longer_one_where_nothing_follows_from_its_length() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 12);
    let settings = "[train]\nsteps = 4\nsave_every = 2\nvalidate_every = 2\nschedule.kind = 'constant'\n\
                    schedule.warmup = 2\n[eval]\nvalidation_vertices = 20\n";
    let config = config(dir.path(), &corpus, settings);
    let train = |run: &Path, more: &[&str]| {
        must(&[&["train", text(&config), "--run", text(run)], more].concat());
    };
    let extend = |run: &Path, to: &str| {
        let told = must(&["train", "--resume", text(run), "--set", &format!("train.steps={to}")]).stderr;
        String::from_utf8(told).unwrap()
    };
    let [long, short, cosine] = ["long", "short", "jobs/cosine/seed-0"].map(|name| dir.path().join(name));
    train(&long, &["--set", "train.steps=8"]);
    train(&short, &[]);
    let told = extend(&short, "8");
    assert!(told.contains("extended at step 4 from 4 to 8 steps: the same as 8 steps from the start"), "{told}");
    assert!(result_at(&short, 8) == result_at(&long, 8), "the longer run, bit for bit");
    let read = |run: &Path, name: &str| fs::read_to_string(run.join(name)).unwrap();
    assert_eq!(read(&short, "config.toml"), read(&long, "config.toml"));
    let info: serde_json::Value = serde_json::from_str(&read(&short, "run.json")).unwrap();
    let noted = &info["extended"][0];
    assert_eq!((&noted["at"], &noted["from"], &noted["to"]), (&4.into(), &4.into(), &8.into()), "{noted}");
    assert!(noted["as_from_start"] == true && info["outcome"] == "finished", "{info}");

    // With as many threads as it was begun with, unless others are asked for.
    let on = |threads: &[&str]| {
        let args = [threads, &["train", "--resume", text(&short)]].concat();
        let done = Command::new(env!("CARGO_BIN_EXE_riglab")).args(args).output().unwrap();
        assert!(done.status.success());
        String::from_utf8(done.stderr).unwrap()
    };
    let ended = || {
        let info: serde_json::Value = serde_json::from_str(&read(&short, "run.json")).unwrap();
        ["ended", "outcome", "seconds"].map(|key| info[key].clone())
    };
    let as_it_ended = ended();
    let several = std::thread::available_parallelism().is_ok_and(|n| n.get() > 1);
    assert_eq!(on(&[]).contains("note: it goes on with 1 thread, as it was begun"), several);
    // One that is done computes nothing on others, and stays what it is.
    assert!(!on(&["--threads", "2"]).contains("sums round otherwise"));
    let info: serde_json::Value = serde_json::from_str(&read(&short, "run.json")).unwrap();
    assert_eq!(info["resumed"].as_array().unwrap().len(), 1, "{info}");

    // The same command again goes on, and has nothing to do or to note.
    let told = extend(&short, "8");
    assert!(!told.contains("extended") && !told.contains("training:"), "{told}");
    assert!(told.contains("all its 8 steps are done") && told.contains("'train.steps=16'` trains longer"), "{told}");
    // Nor has it failed where it could not be read.
    let hidden = |name: &str| {
        let steps = fs::read_dir(short.join("checkpoints")).unwrap().map(|e| e.unwrap().path());
        steps.filter(|path| !path.is_symlink()).map(|path| path.join(name)).collect::<Vec<_>>()
    };
    let (state, aside) = (hidden("optimizer.safetensors"), hidden("aside"));
    state.iter().zip(&aside).for_each(|(file, aside)| fs::rename(file, aside).unwrap());
    refusal(&mut riglab(&["train", "--resume", text(&short)]));
    state.iter().zip(&aside).for_each(|(file, aside)| fs::rename(aside, file).unwrap());
    assert_eq!(ended(), as_it_ended, "nothing was trained");
    let before = read(&short, "config.toml");
    for (set, parts) in [
        ("train.seed=1", ["a run keeps its settings", "`--set train.seed=1`"]),
        ("train.steps=6", ["is set to 8 steps", "can only be raised, and 6 is fewer"]),
        ("train.steps=0", ["--set train.steps", "at least 1"]),
    ] {
        let said = refusal(&mut riglab(&["train", "--resume", text(&short), "--set", set]));
        assert!(parts.iter().all(|part| said.contains(part)), "{set}: {said}");
    }
    // What cannot go on is not extended.
    fs::rename(&corpus, dir.path().join("elsewhere.h5")).unwrap();
    refusal(&mut riglab(&["train", "--resume", text(&short), "--set", "train.steps=9"]));
    fs::rename(dir.path().join("elsewhere.h5"), &corpus).unwrap();
    assert_eq!(read(&short, "config.toml"), before);
    let told = extend(&short, "10");
    assert!(told.contains("from 8 to 10 steps: the same as 10 steps from the start"), "{told}");

    // Sums of other threads round otherwise.
    let other = dir.path().join("other");
    train(&other, &[]);
    let args = ["--threads", "2", "train", "--resume", text(&other), "--set", "train.steps=8"];
    let done = Command::new(env!("CARGO_BIN_EXE_riglab")).args(args).output().unwrap();
    let told = String::from_utf8(done.stderr).unwrap();
    assert!(done.status.success() && told.contains("as it did not always run on 1 thread of one device"), "{told}");
    assert!(told.contains("begun with 1 thread, and it goes on with 2 threads: sums round otherwise"), "{told}");

    // The last step is validated in any case: it may be the best.
    let odd = dir.path().join("odd");
    train(&odd, &["--set", "train.validate_every=0"]);
    let told = extend(&odd, "8");
    assert!(
        told.contains("weights are those of 8 steps from the start, but step 4 was validated as the last"),
        "{told}"
    );

    // So do those of another device, which is not here.
    let info = read(&odd, "run.json").replace("\"device\": \"cpu\"", "\"device\": \"cuda:99\"");
    fs::write(odd.join("run.json"), info).unwrap();
    let told = extend(&odd, "9");
    assert!(told.contains("it was begun on cuda:99, which is not to be had here"), "{told}");
    assert!(told.contains("begun with 1 thread on cuda:99, and it goes on with 1 thread on cpu: sums round"), "{told}");

    // A rate that comes down to the end was at its end.
    train(&cosine, &["--set", "train.schedule.kind=cosine"]);
    let told = extend(&cosine, "8");
    assert!(told.contains("not what 8 steps from the start give") && told.contains("was 0.010 of its peak"), "{told}");
    must(&["report", text(&cosine)]);
    let report = read(&cosine, "report.md");
    assert!(report.contains("at step 4 from 4 to 8") && report.contains("gives another run"), "{report}");
    // Runs of a sweep stay as their table has them.
    fs::write(dir.path().join("sweep.json"), "{}").unwrap();
    let said = refusal(&mut riglab(&["train", "--resume", text(&cosine), "--set", "train.steps=9"]));
    assert!(said.contains("a run of the sweep"), "{said}");
}

#[test]
fn creatures_go_on_where_they_were_broken_off() {
    fn synth<'a>(out: &'a Path, seed: &'a str) -> [&'a str; 8] {
        ["synth", "-o", text(out), "--count", "100", "--seed", seed, "--triangles=400..800"]
    }
    let dir = tempfile::tempdir().unwrap();
    let [whole, broken] = ["whole", "broken"].map(|name| dir.path().join(name));
    must(&synth(&whole, "3"));
    let files = |folder: &Path| -> BTreeMap<String, Vec<u8>> {
        let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        entries.map(|path| (text(path.strip_prefix(folder).unwrap()).into(), fs::read(&path).unwrap())).collect()
    };
    let made = || {
        let glb = |e: &fs::DirEntry| e.path().extension().is_some_and(|of| of == "glb");
        fs::read_dir(&broken).into_iter().flatten().flatten().filter(glb).count()
    };
    for wanted in [15, 45] {
        let mut child = riglab(&synth(&broken, "3")).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        while made() < wanted && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // SIGKILL: nothing can be tidied up.
        assert!(child.try_wait().unwrap().is_none(), "it was too short to be killed");
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let said = refusal(&mut riglab(&synth(&broken, "4")));
    assert!(said.contains("begun with --seed 3, and not 4"), "{said}");
    let mine = broken.join("mine.glb");
    fs::write(&mine, "mine").unwrap();
    let said = refusal(&mut riglab(&synth(&broken, "3")));
    assert!(said.contains("mine.glb is none of the creatures"), "{said}");
    fs::remove_file(&mine).unwrap();
    let there = made();
    let told = String::from_utf8(must(&synth(&broken, "3")).stderr).unwrap();
    assert!(there < 100 && told.contains(&format!("{there} of 100 creatures are there already; going on")), "{told}");
    assert!(files(&broken) == files(&whole), "the same bytes as of the unbroken call, and nothing else");
    assert!(refusal(&mut riglab(&synth(&broken, "3"))).contains("not empty"));
}

/// What must be equal: the metrics, and every file of the last checkpoint.
fn result(run: &Path) -> BTreeMap<String, Vec<u8>> {
    result_at(run, STEPS)
}

/// As [`result`], of a run of so many steps.
fn result_at(run: &Path, steps: u64) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::from([("metrics.jsonl".to_string(), fs::read(run.join("metrics.jsonl")).unwrap())]);
    let last = format!("step-{steps:08}");
    for entry in fs::read_dir(run.join("checkpoints").join(&last)).expect("the run came to its end") {
        let path: PathBuf = entry.unwrap().path();
        let name = format!("{last}/{}", path.file_name().unwrap().to_str().unwrap());
        files.insert(name, fs::read(path).unwrap());
    }
    files
}

#[cfg(unix)]
#[test]
fn a_run_that_is_asked_to_leave_saves_and_says_by_which_signal() {
    use rustix::process::{Pid, Signal, kill_process};
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 6);
    let config = config(dir.path(), &corpus, "[train]\nsteps = 100000\nsave_every = 100000\nvalidate_every = 100000\n");
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143)] {
        let run = dir.path().join(code.to_string());
        let mut child = riglab(&["train", text(&config), "--run", text(&run)]).stderr(Stdio::null()).spawn().unwrap();
        let start = Instant::now();
        while fs::metadata(run.join("metrics.jsonl")).map_or(0, |meta| meta.len()) == 0 {
            assert!(start.elapsed() < Duration::from_secs(120) && child.try_wait().unwrap().is_none());
            std::thread::sleep(Duration::from_millis(20));
        }
        kill_process(Pid::from_child(&child), signal).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(code));
        assert!(run.join("checkpoints/last").exists());
        assert!(fs::read_to_string(run.join("run.json")).unwrap().contains("\"interrupted\""));
    }
}

/// Starts it and kills it after a while; false when it was done before.
fn killed_after(args: &[&str], delay: Duration) -> bool {
    let mut child = riglab(args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let start = Instant::now();
    while start.elapsed() < delay {
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "it failed by itself");
            return false;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    // SIGKILL: nothing can be saved.
    let running = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    running
}

/// Moments of kills differ from test to test on purpose: any moment must do.
fn random() -> f64 {
    use std::hash::{BuildHasher, Hasher};
    let bits = std::hash::RandomState::new().build_hasher().finish();
    bits as f64 / u64::MAX as f64
}

/// Sets every number in a file of tensors to 0.
fn forget(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    bytes[header..].fill(0);
    fs::write(path, bytes).unwrap();
}
