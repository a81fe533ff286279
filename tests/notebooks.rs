//! The notebooks, run from top to bottom on the outputs of a small sweep.

mod binary;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use binary::{config, corpus_of, must, text};

/// A Python with what the notebooks need; `None`, with a line that says so, on a machine that has none.
fn python() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let cache = set("XDG_CACHE_HOME").filter(|path| path.is_absolute()).or_else(|| Some(set("HOME")?.join(".cache")));
    // Where `cargo xtask notebooks` puts it.
    let own = cache.map(|c| c.join("riglab/notebooks-venv-1/bin/python"));
    let all = set("RIGLAB_NOTEBOOK_PYTHON").into_iter().chain(own).chain([PathBuf::from("python3")]);
    let works = |python: &PathBuf| {
        let out = Command::new(python).args(["-c", "import h5py, numpy, pandas, matplotlib, sklearn"]).output();
        out.is_ok_and(|o| o.status.success())
    };
    let found = all.into_iter().find(works);
    if found.is_none() {
        println!(
            "skipped: no Python with h5py, pandas, matplotlib and scikit-learn (`cargo xtask notebooks` installs one; or set RIGLAB_NOTEBOOK_PYTHON)"
        );
    }
    found
}

/// A sweep of two arms and two seeds, trained and evaluated; its first run.
fn sweep(dir: &Path, corpus: &Path) -> (PathBuf, PathBuf) {
    let base = config(
        dir,
        corpus,
        "[train]\nsteps = 12\nema = 0.9\nvalidate_every = 6\n[train.schedule]\nwarmup = 2\n[eval]\nprefixes = [4, 16]\n",
    );
    let lines = [
        "[sweep]\nquestion = 'Do the notebooks run?'\nseeds = [0, 1]\nevaluate = true",
        &format!("base = '{}'", base.display()),
        "[[sweep.arms]]\nname = 'with'\n[[sweep.arms]]\nname = 'without'\nset = { 'loss.dice' = 0.0 }",
        "[[sweep.metrics]]\nof = 'eval/iou_raw@val'\nbetter = 'higher'",
        "[[sweep.metrics]]\nof = 'eval.json:report.rows[split=test_new,method=raw,tokens=4].pooled.l1'\nname = 'L1'",
    ];
    let (file, out) = (dir.join("sweep.toml"), dir.join("sweep"));
    fs::write(&file, lines.join("\n")).unwrap();
    must(&["sweep", text(&file), "-o", text(&out)]);
    let plan: serde_json::Value = serde_json::from_str(&fs::read_to_string(out.join("sweep.json")).unwrap()).unwrap();
    let run = out.join(plan["jobs"][0]["folder"].as_str().unwrap());
    (out, run)
}

#[test]
fn every_notebook_runs_from_top_to_bottom() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus_of(dir.path(), 24, "400..800");
    let (sweep, run) = sweep(dir.path(), &corpus);
    // As a kill leaves it.
    let mut log = fs::OpenOptions::new().append(true).open(run.join("metrics.jsonl")).unwrap();
    log.write_all(b"{\"step\":13,\"train/lo").unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../notebooks");
    let mut books: Vec<PathBuf> = fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()).collect();
    books.retain(|p| p.extension().is_some_and(|e| e == "ipynb"));
    books.sort();
    assert!(books.len() >= 4, "{books:?}");
    let out = Command::new(python)
        .arg(folder.join("run.py"))
        .args(&books)
        .envs([("RIGLAB_CORPUS", &corpus), ("RIGLAB_RUN", &run), ("RIGLAB_SWEEP", &sweep)])
        .envs([("OMP_NUM_THREADS", "1"), ("PYTHONDONTWRITEBYTECODE", "1")])
        .output()
        .unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "{said}");
    for book in &books {
        let name = book.file_name().unwrap().to_string_lossy();
        assert!(said.contains(&format!("{name}: ")), "{name} was not run: {said}");
        // What was computed is not kept: a notebook in version control has no outputs.
        let book: serde_json::Value = serde_json::from_str(&fs::read_to_string(book).unwrap()).unwrap();
        let cells = book["cells"].as_array().unwrap();
        assert!(cells.iter().all(|c| c["outputs"].as_array().is_none_or(Vec::is_empty)), "{name} holds outputs");
    }
}

#[test]
fn the_notebook_of_a_run_reads_what_grpo_found() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let write = |file: &str, text: &str| fs::write(dir.path().join(file), text).unwrap();
    write("config.toml", "task = \"grpo\"\n");
    write(
        "metrics.jsonl",
        "{\"step\":1,\"train/loss\":0.5}\n{\"step\":2,\"train/loss\":0.4,\"eval/j2j_all@val\":0.2,\"eval/coverage@val\":0.7}\n",
    );
    // Distances and rewards stand apart in a row, and assets have them before and after.
    let row = |method: &str| {
        serde_json::json!({
            "rewards": {"coverage": 0.8, "containment": 0.1, "skinning": 0.5, "motion": 0.7, "total": 5.3},
            "skeletons": {"split": "test_new", "method": method, "assets": 2, "compared": 2, "j2j": 0.2, "j2b": 0.2,
                          "b2b": 0.1, "valid": 1.0, "joints": 9.0, "true_joints": 8.0, "joints_off": 0.1},
        })
    };
    let score = serde_json::json!({"reward": 5.0, "distances": {"j2j": 0.25, "j2b": 0.2, "b2b": 0.1}});
    let asset = |name: &str| serde_json::json!({"split": "test_new", "name": name, "category": "", "before": score, "after": score});
    let report = serde_json::json!({"convention": "unirig", "rows": [row("before"), row("after")],
                                    "gains": [], "assets": [asset("a"), asset("b")]});
    write("eval.json", &serde_json::json!({"report": report, "gallery": []}).to_string());
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../notebooks");
    let out = Command::new(python)
        .args([folder.join("run.py"), folder.join("look_at_a_run.ipynb")])
        .env("RIGLAB_RUN", dir.path())
        .env("RIGLAB_CORPUS", dir.path().join("none.h5"))
        .envs([("OMP_NUM_THREADS", "1"), ("PYTHONDONTWRITEBYTECODE", "1")])
        .output()
        .unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(
        out.status.success() && said.contains("after.distances.j2j") && said.contains("rewards.coverage"),
        "{said}"
    );
}
