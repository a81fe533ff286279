//! Training as several processes: the same run on any number of them, resumed on another, ended by one that fails.
//!
//! Needs a riglab with MPI: `cargo xtask mpi` builds one and runs this. The same rules are tested over threads in
//! `riglab-train`, without MPI.

mod binary;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Instant;

use binary::{config, corpus, must, text};

const STEPS: u64 = 200;

/// `riglab` as so many processes.
fn launched(processes: usize, args: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    command.args(["-n", &processes.to_string(), env!("CARGO_BIN_EXE_riglab"), "--threads", "1"]).args(args);
    // Started as root or with more processes than processors, Open MPI wants to be told that it is meant.
    command.envs([
        ("OMPI_ALLOW_RUN_AS_ROOT", "1"),
        ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1"),
        ("OMPI_MCA_rmaps_base_oversubscribe", "1"),
        ("PRTE_MCA_rmaps_default_mapping_policy", ":oversubscribe"),
    ]);
    command
}

fn has_mpi() -> bool {
    let told = must(&["doctor", "--json"]).stdout;
    let told: serde_json::Value = serde_json::from_slice(&told).unwrap();
    let has = !told["mpi"].is_null();
    if !has {
        eprintln!("skipped: riglab was built without MPI; `cargo xtask mpi` builds it with one and runs this test");
    }
    has
}

fn well(out: &Output) {
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

/// What counts of a run.
fn result(run: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let files = ["metrics.jsonl", "checkpoints/last/model.safetensors", "checkpoints/last/optimizer.safetensors"];
    files.iter().map(|f| (run.join(f), std::fs::read(run.join(f)).unwrap())).collect()
}

fn same(one: &Path, other: &Path) {
    for ((a, bytes), (b, others)) in result(one).into_iter().zip(result(other)) {
        assert!(bytes == others, "{} and {} differ", a.display(), b.display());
    }
}

#[test]
fn processes_train_one_run_and_go_on_with_another_number() {
    if !has_mpi() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 12);
    let settings = format!(
        "[train]\nsteps = {STEPS}\nsave_every = 20\nvalidate_every = 100\naccumulate = 4\n[eval]\nvalidation_vertices = 50\n"
    );
    let config = config(dir.path(), &corpus, &settings);
    let folder = |name: &str| dir.path().join(name);
    let start = Instant::now();
    must(&["train", text(&config), "--run", text(&folder("one"))]);
    let took = start.elapsed();
    for processes in [2, 4] {
        let run = folder(&processes.to_string());
        well(&launched(processes, &["train", text(&config), "--run", text(&run)]).output().unwrap());
        same(&folder("one"), &run);
    }
    let info: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder("4").join("run.json")).unwrap()).unwrap();
    assert_eq!(info["ranks"], 4);

    // Killed again and again, all its processes or one of them, and gone on with another number; a run that came to its
    // end before is followed by another.
    let (mut killed, mut ended) = (0, 0);
    let mut broken = folder("broken-0");
    for attempt in 0.. {
        let args = match broken.join("config.toml").exists() {
            true => vec!["train", "--resume", text(&broken)],
            false => vec!["train", text(&config), "--run", text(&broken)],
        };
        if killed == faults() {
            well(&launched(2, &args).output().unwrap());
            same(&folder("one"), &broken);
            break;
        }
        assert!(attempt < 20 * faults(), "runs end before they can be killed");
        let mut child = launched([2, 1, 4][attempt % 3], &args).spawn().unwrap();
        std::thread::sleep(took.mul_f64(0.1 + 0.1 * (attempt % 7) as f64));
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "it ended by itself: {status}");
            same(&folder("one"), &broken);
            ended += 1;
            broken = folder(&format!("broken-{ended}"));
            continue;
        }
        killed += usize::from(kill(&broken, attempt % 2 == 0));
        // Of one that is killed, the others do not wait for ever.
        let _ = child.wait();
        kill(&broken, true);
    }
    eprintln!("{killed} times killed; {} runs equal the unbroken one", ended + 1);
}

/// How often the run is killed; `RIGLAB_FAULTS=50` for a long test.
fn faults() -> usize {
    std::env::var("RIGLAB_FAULTS").ok().and_then(|n| n.parse().ok()).unwrap_or(4)
}

#[test]
fn ranks_share_the_rollouts_of_a_step() {
    if !has_mpi() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 14);
    let config = dir.path().join("grpo.toml");
    let settings = "extends = 'skintokens/grpo_quick.toml'\n[rollout]\ngroup = 4\nvertices = 48\nprecision = 'fp32'\n\
                    [reward]\nresolution = 32\n[train]\nsteps = 3\naccumulate = 2\nvalidate_every = 2\n\
                    [held_out]\ndraws = 2\n[eval]\nvalidation_assets = 3\nrows = 2\nvertices = 64\n";
    std::fs::write(&config, format!("{settings}[data]\ncorpora = ['{}']\n", corpus.display())).unwrap();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    must(&["train", text(&config), "--run", text(&one), "--threads", "1"]);
    well(&launched(2, &["train", text(&config), "--run", text(&two)]).output().unwrap());
    same(&one, &two);
}

#[test]
fn one_that_fails_ends_all() {
    if !has_mpi() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 12);
    let config = config(dir.path(), &corpus, "[train]\nsteps = 5\naccumulate = 3\n");
    let run = dir.path().join("run");
    let out = launched(2, &["train", text(&config), "--run", text(&run)]).output().unwrap();
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(
        !out.status.success() && errors.contains("train.accumulate = 3") && !errors.contains("panicked"),
        "{errors}"
    );
    assert!(!run.exists(), "what cannot be shared leaves no folder behind");
    let missing = ["--set", "data.corpora=['nowhere.h5']", "--set", "train.accumulate=2"];
    let args = [&["train", text(&config), "--run", text(&run)][..], &missing].concat();
    let out = launched(2, &args).output().unwrap();
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success() && errors.contains("nowhere.h5"), "{errors}");
}

/// Kills processes that train in a folder without a chance to save: all, or the first that is found. Says
/// whether there were any.
fn kill(run: &Path, all: bool) -> bool {
    let mut any = false;
    for entry in std::fs::read_dir("/proc").unwrap().flatten() {
        let Some(id) = entry.file_name().to_str().and_then(|n| n.parse::<i32>().ok()) else { continue };
        let Ok(line) = std::fs::read(entry.path().join("cmdline")) else { continue };
        let words: Vec<&[u8]> = line.split(|b| *b == 0).collect();
        let own = words.first().is_some_and(|w| w.ends_with(b"/riglab"));
        if own
            && words.contains(&text(run).as_bytes())
            && let Some(id) = rustix::process::Pid::from_raw(id)
        {
            let _ = rustix::process::kill_process(id, rustix::process::Signal::KILL);
            any = true;
            if !all {
                return any;
            }
        }
    }
    any
}
