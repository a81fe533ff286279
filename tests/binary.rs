//! Running the `riglab` binary on a corpus of creatures: shared by the tests that do.

#![allow(dead_code)] // each test takes what it needs

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A call of the binary, with a few threads so that results do not depend on the machine's cores.
pub fn riglab(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_riglab"));
    command.args(["--threads", "1"]).args(args);
    command
}

/// Runs it to the end; its output must say success.
pub fn must(args: &[&str]) -> Output {
    let out = riglab(args).output().expect("the binary starts");
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "riglab {}\n{errors}", args.join(" "));
    out
}

/// Runs it to the end; it must fail by itself. Gives what it said.
pub fn refusal(command: &mut Command) -> String {
    let out = command.output().expect("the binary starts");
    let errors = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(!out.status.success(), "it should have failed: {command:?}");
    assert!(out.status.code().is_some_and(|c| c != 0 && c != 101), "it died ({}): {errors}", out.status);
    assert!(!errors.contains("panicked"), "{errors}");
    errors
}

/// Makes a corpus of small creatures in `dir`.
pub fn corpus(dir: &Path, count: u32) -> PathBuf {
    corpus_of(dir, count, "400..800")
}

/// As [`corpus`], with so many triangles: below a thousand, creatures are of blocks that each follow one
/// joint.
pub fn corpus_of(dir: &Path, count: u32, triangles: &str) -> PathBuf {
    let (files, corpus) = (dir.join("files"), dir.join("corpus.h5"));
    let count = count.to_string();
    must(&[
        "synth",
        "-o",
        text(&files),
        "--count",
        &count,
        "--plans",
        "biped,quadruped,fish",
        "--triangles",
        triangles,
    ]);
    must(&["dataset", "import", text(&files), "-o", text(&corpus)]);
    corpus
}

/// A config of the smallest size on a corpus.
pub fn config(dir: &Path, corpus: &Path, more: &str) -> PathBuf {
    let path = dir.join("config.toml");
    let base = format!(
        "extends = 'quickstart/demo.toml'\n[data]\ncorpora = ['{}']\n[sampling]\nrigs = 2\nbones = 2\n",
        corpus.display()
    );
    std::fs::write(&path, base + more).expect("a config can be written");
    path
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("paths of temporary folders are UTF-8")
}
