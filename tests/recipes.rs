//! The commands of `data_prep/` as they stand there, on samples of the real formats.
//!
//! A page names its samples in comments, `<!-- sample FOLDER from golden|rigs|creatures WHAT.. -->`, and
//! heads with `sh run` the blocks that are to work on them.

mod binary;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use binary::{must, text};

fn pages() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data_prep");
    let mut pages: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    pages.retain(|p| p.extension().is_some_and(|e| e == "md") && p.file_stem().is_some_and(|s| s != "README"));
    pages.sort();
    pages
}

/// A folder of shared data, by its variable.
fn shared(variable: &str, default: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let path = std::env::var_os(variable).map_or_else(|| root.join(default), PathBuf::from);
    if path.is_dir() {
        return Some(path);
    }
    println!("skipped: no such folder: {} (set {variable})", path.display());
    None
}

/// Copies what a reader is to take: neither what it must refuse nor what is expected of it.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let name = entry.file_name().into_string().unwrap();
        if name.starts_with("refuse") || name.contains(".expected.") {
        } else if entry.path().is_dir() {
            copy(&entry.path(), &to.join(name));
        } else {
            fs::write(to.join(name), fs::read(entry.path()).unwrap()).unwrap();
        }
    }
}

/// Puts the samples of a line into a folder; `false` where this machine has none.
fn sample(line: &str, dir: &Path) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    let ["<!--", "sample", folder, "from", kind, what @ .., "-->"] = words.as_slice() else {
        panic!("no sample: {line}");
    };
    let to = dir.join(folder);
    match *kind {
        "golden" => {
            let Some(golden) = shared("RIGLAB_GOLDEN", "golden") else { return false };
            copy(&golden.join("formats").join(what[0]), &to);
        }
        "rigs" => {
            let Some(rigs) = shared("RIGLAB_RIGS", "rigs") else { return false };
            fs::create_dir(&to).unwrap();
            for name in what {
                fs::write(to.join(name), fs::read(rigs.join(name)).unwrap()).unwrap();
            }
        }
        "creatures" => {
            let (plans, ending) = what.split_at(what.iter().position(|w| *w == "as").unwrap_or(what.len()));
            let made = dir.join("made");
            let plans = plans.join(",");
            must(&["synth", "-o", text(&made), "--count", "8", "--plans", &plans, "--triangles", "400..800"]);
            match ending {
                [] => fs::rename(made, to).unwrap(),
                [_, format] => drop(must(&["convert", text(&made), text(&to), "--to", format])),
                _ => panic!("no sample: {line}"),
            }
        }
        other => panic!("no samples are called {other}"),
    }
    true
}

/// The blocks that are run, joined.
fn commands(page: &str) -> String {
    let (mut all, mut inside) = (String::new(), false);
    for line in page.lines() {
        match line {
            "```sh run" => inside = true,
            "```" => inside = false,
            _ if inside => all += &format!("{line}\n"),
            _ => {}
        }
    }
    all
}

#[test]
fn every_recipe_works_on_samples() {
    let pages = pages();
    assert_eq!(pages.len(), 6);
    for path in pages {
        let page = fs::read_to_string(&path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy();
        for part in ["**Where.**", "**Licence.**", "**Expected.**", "## Mind", "**Run:**", "**Not\nrun:**"] {
            let said = page.contains(part) || page.contains(&part.replace('\n', " "));
            assert!(said, "{name} does not say: {part}");
        }
        let dir = tempfile::tempdir().unwrap();
        let samples: Vec<&str> = page.lines().filter(|l| l.starts_with("<!-- sample ")).collect();
        assert!(!samples.is_empty(), "{name} names no samples");
        if !samples.iter().all(|line| sample(line, dir.path())) {
            continue;
        }
        let script = commands(&page);
        assert!(script.matches("riglab ").count() >= 3, "{name}: {script}");
        let binary = Path::new(env!("CARGO_BIN_EXE_riglab")).parent().unwrap();
        let search = std::env::join_paths([binary.to_path_buf(), "/usr/bin".into(), "/bin".into()]).unwrap();
        let mut shell = Command::new("sh");
        let out = shell.args(["-euxc", &script]).current_dir(dir.path()).env("PATH", search).output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success() && !said.contains("panicked"), "{name}\n{said}");
        // Each corpus that a command names is there and sound.
        let corpora = script.split_whitespace().filter(|word| word.ends_with(".h5"));
        for corpus in corpora {
            must(&["dataset", "verify", text(&dir.path().join(corpus))]);
        }
    }
}

#[test]
fn the_index_names_every_page() {
    let index = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data_prep/README.md")).unwrap();
    for path in pages() {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(index.contains(&format!("({name})")), "{name}");
    }
}
