//! Curation by the command: killed and continued, on a full disk, in parts.

mod binary;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use binary::{must, refusal, riglab, text};
use serde_json::Value;

/// Settings that keep every creature, those that are there twice too.
const ALL: [&str; 4] = ["--config", "curation/any.toml", "--set", "stages=[]"];
/// Settings that keep each creature once.
const ANY: [&str; 4] = ["--config", "curation/any.toml", "--set", "report.kept=4"];

fn creatures(dir: &Path, count: u32) -> PathBuf {
    let files = dir.join("files");
    must(&["synth", "-o", text(&files), "--count", &count.to_string(), "--triangles", "400..800"]);
    files
}

/// Copies every file so many times: making creatures takes longer than curating them.
fn multiply(files: &Path, times: usize) {
    let names: Vec<PathBuf> = fs::read_dir(files).unwrap().map(|e| e.unwrap().path()).collect();
    for file in names.iter().filter(|p| p.extension().unwrap() == "glb") {
        for k in 1..times {
            fs::copy(file, file.with_extension(format!("{k}.glb"))).unwrap();
        }
    }
}

fn curate<'a>(files: &'a Path, out: &'a Path, settings: &[&'a str]) -> Vec<&'a str> {
    [&["curate", text(files), "-o", text(out)], settings].concat()
}

/// Names, splits and digests, which `dataset inspect` shows.
fn content(corpus: &Path) -> Vec<u8> {
    must(&["dataset", "verify", text(corpus)]);
    must(&["dataset", "inspect", text(corpus), "--json"]).stdout
}

fn lines(journal: &Path) -> usize {
    fs::read(journal).map_or(0, |b| b.iter().filter(|b| **b == b'\n').count())
}

#[test]
fn a_killed_curation_goes_on_and_gives_what_the_unbroken_one_gives() {
    let dir = tempfile::tempdir().unwrap();
    let files = creatures(dir.path(), 3);
    multiply(&files, 50);
    let (whole, broken) = (dir.path().join("whole.h5"), dir.path().join("broken.h5"));
    must(&curate(&files, &whole, &ALL));
    let journal = dir.path().join("broken.curation/journal.jsonl");
    let mut kills = 0;
    for wanted in [20, 90, 180, 260] {
        let mut child = riglab(&curate(&files, &broken, &ALL)).stderr(std::process::Stdio::null()).spawn().unwrap();
        let begun = Instant::now();
        while lines(&journal) < wanted && child.try_wait().unwrap().is_none() {
            assert!(begun.elapsed() < Duration::from_secs(120));
            std::thread::sleep(Duration::from_millis(1));
        }
        // What is in the journal is finished; a kill loses none of it.
        kills += usize::from(child.try_wait().unwrap().is_none());
        let _ = child.kill();
        child.wait().unwrap();
        assert!(lines(&journal) >= wanted);
    }
    assert!(kills > 0, "the run was too short to be killed");
    let said = must(&curate(&files, &broken, &ALL)).stderr;
    let said = String::from_utf8(said).unwrap();
    assert!(said.contains("continues from") && said.contains("journal.jsonl"), "{said}");
    assert!(said.contains("comparing: 150/150"), "{said}");
    // A head, and two lines a file: none was looked at twice.
    assert_eq!(lines(&journal), 1 + 2 * 150);
    assert_eq!(content(&broken), content(&whole));
}

#[test]
fn a_full_disk_is_a_sentence_and_what_is_finished_stays() {
    let dir = tempfile::tempdir().unwrap();
    let files = creatures(dir.path(), 2);
    multiply(&files, 20);
    let out = dir.path().join("c.h5");
    // 20 kB, then writing fails as on a full disk: room for some lines of the journal.
    let script = "trap '' XFSZ; ulimit -f 40; exec \"$0\" \"$@\"";
    let mut limited = Command::new("sh");
    limited.args(["-c", script, env!("CARGO_BIN_EXE_riglab"), "--threads", "1"]).args(curate(&files, &out, &ALL));
    let said = refusal(&mut limited);
    assert!(said.contains("cannot be written") && said.contains("run the same command again"), "{said}");
    let journal = dir.path().join("c.curation/journal.jsonl");
    let kept = lines(&journal);
    assert!(kept > 2 && !out.exists());
    must(&curate(&files, &out, &ALL));
    assert!(lines(&journal) >= 81);
    assert!(must(&["dataset", "verify", text(&out)]).status.success());
}

#[test]
fn parts_merge_and_the_report_says_what_became_of_each() {
    let dir = tempfile::tempdir().unwrap();
    let files = creatures(dir.path(), 5);
    let first =
        fs::read_dir(&files).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().unwrap() == "glb").unwrap();
    fs::copy(&first, files.join("same.glb")).unwrap();
    fs::write(files.join("broken.glb"), b"glTF").unwrap();
    let whole = dir.path().join("whole.h5");
    let told = must(&[curate(&files, &whole, &ANY), vec!["--json"]].concat()).stdout;
    let funnel: Value = serde_json::from_slice(&told).unwrap();
    assert_eq!((&funnel["assets"], &funnel["kept"]), (&7.into(), &5.into()));
    let parts: Vec<PathBuf> = (1..=2)
        .map(|k| {
            let part = dir.path().join(format!("part{k}.h5"));
            must(&[curate(&files, &part, &ANY), vec!["--shard", &format!("{k}/2")]].concat());
            part
        })
        .collect();
    let merged = dir.path().join("merged.h5");
    must(&[&["curate", "--merge", text(&parts[0]), text(&parts[1]), "-o", text(&merged)], ANY.as_slice()].concat());
    assert_eq!(content(&merged), content(&whole));
    let report = fs::read_to_string(dir.path().join("merged.curation/report.html")).unwrap();
    assert!(report.contains("broken.glb") && report.contains("same.glb") && report.contains("data:image/png"));
}

#[test]
fn parts_that_do_not_belong_together_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    for (seed, folder) in [("0", &one), ("1", &two)] {
        must(&["synth", "-o", text(folder), "--count", "1", "--seed", seed, "--triangles", "400..800"]);
        let made = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        let glb = made.into_iter().find(|p| p.extension().unwrap() == "glb").unwrap();
        fs::rename(glb, folder.join("x.glb")).unwrap();
        fs::remove_file(folder.join("manifest.json")).unwrap();
    }
    let [a, b, other, out] = ["a.h5", "b.h5", "other.h5", "ab.h5"].map(|name| dir.path().join(name));
    must(&curate(&one, &a, &ALL));
    must(&curate(&two, &b, &ALL));
    must(&[curate(&one, &other, &ALL), vec!["--set", "bones.min=2"]].concat());
    let merge = |parts: [&Path; 2], out: &Path, more: &[&str]| {
        let args = [&["curate", "--merge", text(parts[0]), text(parts[1]), "-o", text(out)], &ALL[..], more].concat();
        riglab(&args)
    };
    let said = refusal(&mut merge([&a, &b], &out, &[]));
    assert!(said.contains("each have an asset `x.glb`, of different files") && !out.exists(), "{said}");
    let before = fs::read(&a).unwrap();
    let said = refusal(&mut merge([&a, &other], &a, &[]));
    assert!(said.contains("this corpus is the input") && fs::read(&a).unwrap() == before, "{said}");
    let said = |more: &[&str], parts| String::from_utf8(merge(parts, &out, more).output().unwrap().stderr).unwrap();
    let told = said(&[], [&a, &other]);
    assert!(told.contains("made with different settings"), "{told}");
    let told = said(&["--set", "bones.min=2"], [&a, &a]);
    assert!(told.contains("have no effect"), "{told}");
    assert!(!said(&[], [&a, &a]).contains("settings"));
    // An older corpus beside a newer report.
    let said = refusal(&mut riglab(
        &[
            curate(&one, &a, &ALL),
            vec!["--set", "stages=['bones']", "--set", "bones.min=5000", "--set", "bones.max=6000"],
        ]
        .concat(),
    ));
    assert!(said.contains("is of an earlier curation and stays") && fs::read(&a).unwrap() == before, "{said}");
    // Another corpus in its place.
    let said = String::from_utf8(must(&curate(&two, &other, &ALL)).stderr).unwrap();
    assert!(said.contains("was another corpus before"), "{said}");
}

#[test]
fn a_list_of_splits_in_the_folder_is_kept_unless_settings_say_otherwise() {
    let dir = tempfile::tempdir().unwrap();
    let files = creatures(dir.path(), 4);
    let mut names: Vec<String> =
        fs::read_dir(&files).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| name.ends_with(".glb"));
    names.sort();
    let list = serde_json::json!({"train": [names[0]], "mine": names[1..]});
    fs::write(files.join("split.json"), list.to_string()).unwrap();
    let splits = |name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let done = must(&[curate(&files, &out, &ALL), vec!["--json"], more.to_vec()].concat());
        let funnel: Value = serde_json::from_slice(&done.stdout).unwrap();
        (funnel["splits"].clone(), String::from_utf8(done.stderr).unwrap())
    };
    let (kept, said) = splits("kept.h5", &[]);
    assert_eq!(kept, serde_json::json!({"train": 1, "mine": 3}));
    assert!(said.contains("split.json"), "{said}");
    let parts = ["part1.h5", "part2.h5", "part3.h5"];
    for (part, shard) in parts.iter().zip(["1/3", "2/3", "3/3"]) {
        splits(part, &["--shard", shard]);
    }
    let merged = |name: &str, parts: &[&str], more: &[&str]| {
        let parts: Vec<PathBuf> = parts.iter().map(|part| dir.path().join(part)).collect();
        let out = dir.path().join(name);
        let parts: Vec<&str> = parts.iter().map(|part| text(part)).collect();
        let done = must(&[&["curate", "--merge"], &parts[..], &["-o", text(&out), "--json"], &ALL, more].concat());
        let funnel: Value = serde_json::from_slice(&done.stdout).unwrap();
        (funnel["splits"].clone(), String::from_utf8(done.stderr).unwrap())
    };
    let (same, said) = merged("merged.h5", &parts, &[]);
    assert_eq!(same, kept);
    assert!(said.contains("splits are those of the parts"), "{said}");
    let (others, said) = merged("others.h5", &parts, &["--set", "split.by=topology"]);
    assert!(others.get("mine").is_none() && said.contains("left aside"), "{others} {said}");
    let (made, said) = splits("made.h5", &["--set", "split.by=topology"]);
    assert!(made.get("mine").is_none() && said.contains("left aside"), "{made} {said}");
    // One that a list split, and one that none did: the same files, of which the list's word counts.
    let (both, said) = merged("both.h5", &["kept.h5", "made.h5"], &[]);
    assert_eq!(both, kept);
    assert!(
        said.contains("kept.h5 are kept") && said.contains("none gave those of") && said.contains("made.h5"),
        "{said}"
    );
}

#[test]
fn wrong_use_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let files = creatures(dir.path(), 1);
    let out = dir.path().join("c.h5");
    let told = |args: &[&str]| refusal(&mut riglab(args));
    let base = ["curate", text(&files), "-o", text(&out)];
    let with = |more: &[&str]| told(&[&base, more].concat());
    assert!(with(&["--set", "bones.mim=3"]).contains("did you mean `min`?"));
    assert!(with(&["--set", "bones.min=9", "--set", "bones.max=3"]).contains("bones.min"));
    assert!(with(&["--shard", "3/2"]).contains("1/8"));
    assert!(with(&["--decisions", "nowhere.tsv"]).contains("no such file"));
    assert!(told(&["curate", "nowhere", "-o", text(&out)]).contains("no such folder"));
    let imported = dir.path().join("imported.h5");
    must(&["dataset", "import", text(&files), "-o", text(&imported)]);
    let said = told(&["curate", "--merge", text(&imported), "-o", text(&out)]);
    assert!(said.contains("no journal of a curation") && said.contains("riglab dataset merge"), "{said}");
    // Told before any file is looked at.
    let mine = dir.path().join("mine.h5");
    fs::write(&mine, "mine").unwrap();
    let said = told(&["curate", text(&files), "-o", text(&mine)]);
    assert!(said.contains("no corpus") && !said.contains("looking"), "{said}");
    let said = told(&["curate", text(&files), "-o", text(&dir.path().join("named.curation"))]);
    assert!(said.contains("give the corpus another") && !dir.path().join("named.curation").exists(), "{said}");
    // Nothing passes: an error that names the report.
    assert!(with(&["--set", "bones.min=5000", "--set", "bones.max=6000"]).contains("report.html"));
}
