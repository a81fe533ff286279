//! Work that is handed to a real Slurm ends as it does here, whatever happens to nodes, controller and tasks.

mod binary;
mod cluster;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::Duration;

use binary::{config, corpus, must, refusal, riglab, text};
use cluster::Cluster;

/// With this variable set, the sweep has twelve arms of three seeds, and a training runs into its time limit: minutes.
const FULL: &str = "RIGLAB_SLURM_FULL";

#[test]
fn work_on_a_cluster_ends_as_it_does_here() {
    let dir = tempfile::tempdir().unwrap();
    let Some(mut cluster) = Cluster::start(&dir.path().join("cluster")) else { return };
    let corpus = corpus(dir.path(), 12);
    let base = config(
        dir.path(),
        &corpus,
        "[train]\nsteps = 8\nsave_every = 2\nvalidate_every = 4\n[eval]\nvalidation_vertices = 50\nprefixes = [4]\n\
         [slurm]\nlook_seconds = 1\n",
    );
    sweep(dir.path(), &base, &mut cluster);
    training(dir.path(), &base, &cluster);
    curation(dir.path(), &cluster);
    processes(dir.path(), &cluster);
}

/// Arms by seeds as arrays; a node is drained, the controller restarted, a task requeued, one told that its time ends,
/// one cancelled.
fn sweep(dir: &Path, base: &Path, cluster: &mut Cluster) {
    let (arms, seeds) = if std::env::var_os(FULL).is_some() { (12, "0, 1, 2") } else { (3, "0, 1") };
    let mut lines = vec![
        format!("[sweep]\nquestion = 'Does it go on?'\nevaluate = true\nthreads = 1\nseeds = [{seeds}]"),
        format!("base = '{}'", base.display()),
        "[slurm]\nlook_seconds = 1\nprologue = ['export TOY=1']".into(),
        "[[sweep.metrics]]\nof = 'eval/iou_raw@val'\nbetter = 'higher'".into(),
        "[[sweep.metrics]]\nof = 'eval.json:report.rows[split=test_new,method=raw,tokens=4].pooled.l1'\nname = 'L1'"
            .into(),
    ];
    let arm = |k: usize| format!("[[sweep.arms]]\nname = 'dice {k}'\nset = {{ 'loss.dice' = {k}.0 }}");
    lines.extend((0..arms).map(arm));
    // Sound as a config: it fails when the run begins.
    lines.push("[[sweep.arms]]\nname = 'no corpus'\nset = { 'data.corpora' = ['nowhere.h5'] }".into());
    let file = dir.join("toy.toml");
    fs::write(&file, lines.join("\n")).unwrap();
    let (here, there) = (dir.join("here"), dir.join("there"));
    // One of its arms fails.
    refusal(&mut riglab(&["sweep", text(&file), "-o", text(&here)]));

    on(cluster, &["sweep", text(&file), "-o", text(&there), "--on", "slurm"]);
    let jobs = lines_of(&there.join("slurm/jobs.jsonl"));
    assert!(jobs >= 2, "arrays of four tasks at most");
    on(cluster, &["sweep", text(&there), "--on", "slurm"]);
    assert_eq!(lines_of(&there.join("slurm/jobs.jsonl")), jobs, "nothing is submitted twice");
    let said = on(cluster, &["sweep", text(&there), "--status"]);
    assert!(said.contains("| Slurm") || said.contains("Slurm"), "{said}");
    assert!(said.contains("queued (") || said.contains("on n1"), "{said}");

    let finished = || folders(&there.join("jobs")).iter().filter(|run| is_finished(run)).count();
    cluster.until("a run is finished", || finished() > 0);
    cluster.ask("scontrol", &["update", "NodeName=n2", "State=DRAIN", "Reason=test"]);
    cluster.until("a running task is requeued", || cluster.does_to_running("scontrol", &["requeue"]));
    cluster.restart_controller();
    // What Slurm tells a task before its time limit.
    let told = ["--batch", "--signal=TERM"];
    cluster.until("a running task is told to leave", || cluster.does_to_running("scancel", &told));
    if let Some(waiting) = cluster.tasks("PENDING").last() {
        cluster.does("scancel", &[waiting]);
    }
    refusal(cluster.known_to(&mut riglab(&["sweep", text(&there), "--on", "slurm", "--wait"])));
    cluster.ask("scontrol", &["update", "NodeName=n2", "State=RESUME"]);

    assert_eq!(result(&there), result(&here));
    assert!(result(&there)["table.md"].contains("| no corpus | 0 | "));
    // Every run is the unbroken one: each step once, in order.
    for run in folders(&here.join("jobs")).iter().filter(|run| is_finished(run)) {
        let own = there.join(run.strip_prefix(&here).unwrap());
        assert_eq!(read(&own.join("metrics.jsonl")), read(&run.join("metrics.jsonl")), "{}", own.display());
    }
    let starts = fs::read_dir(there.join("slurm/starts")).unwrap().flatten().map(|e| lines_of(&e.path()));
    let most = starts.max().unwrap();
    assert!(most >= 2, "none of the tasks was begun again");
    let said = refusal(cluster.known_to(&mut riglab(&["sweep", text(&there), "--on", "slurm"])));
    assert!(said.contains("--retry") && said.contains("no corpus"), "{said}");
    println!("{} runs by {} jobs, {most} starts at most", finished(), lines_of(&there.join("slurm/jobs.jsonl")));
}

/// One run.
fn training(dir: &Path, base: &Path, cluster: &Cluster) {
    let (here, there) = (dir.join("alone"), dir.join("runs/one"));
    must(&["train", text(base), "--run", text(&here)]);
    on(cluster, &["train", text(base), "--run", text(&there), "--on", "slurm", "--wait"]);
    assert_eq!(read(&there.join("metrics.jsonl")), read(&here.join("metrics.jsonl")));
    let said = refusal(cluster.known_to(&mut riglab(&["train", text(base), "--run", text(&there), "--on", "slurm"])));
    assert!(said.contains("holds a run already") && said.contains("--resume"), "{said}");
    // Nothing is left to do: its log stays as it is.
    on(cluster, &["train", "--resume", text(&there), "--on", "slurm", "--wait", "--set", "slurm.cpus=1"]);
    assert_eq!(read(&there.join("metrics.jsonl")), read(&here.join("metrics.jsonl")));
    assert!(read(&there.join("slurm/job-2.sh")).contains("--cpus-per-task=1\n"));
    // One that fails says where its messages are.
    let none = dir.join("runs/none");
    let args = ["train", text(base), "--run", text(&none), "--on", "slurm", "--wait"];
    let missing = ["--set", "data.corpora=['nowhere.h5']"];
    let said = refusal(cluster.known_to(riglab(&args).args(missing)));
    let log = said.rsplit(' ').next().unwrap().trim();
    assert!(said.contains("is not finished: job") && read(Path::new(log)).contains("nowhere.h5"), "{said}");
}

/// Parts of a folder, some of them without a file, and the corpus of all.
fn curation(dir: &Path, cluster: &Cluster) {
    let (files, here, there) = (dir.join("files"), dir.join("here.h5"), dir.join("there.h5"));
    let settings = ["--config", "curation/any.toml", "--set", "report.kept=4"];
    must(&[&["curate", text(&files), "-o", text(&here)], &settings[..]].concat());
    let args = ["curate", text(&files), "-o", text(&there), "--on", "slurm", "--parts", "9", "--wait"];
    let said = on(cluster, &[&args[..], &settings, &["--set", "slurm.look_seconds=1"]].concat());
    assert!(said.contains("there.h5") && said.contains("report.html"), "{said}");
    let parts = fs::read_dir(dir.join("there.curation/parts-9")).unwrap().flatten();
    let corpora = parts.filter(|e| e.path().extension().is_some_and(|e| e == "h5")).count();
    assert!((2..9).contains(&corpora), "{corpora} of nine parts with a corpus");
    let content = |corpus: &Path| must(&["dataset", "inspect", text(corpus), "--json"]).stdout;
    assert_eq!(content(&there), content(&here));
    let said = refusal(cluster.known_to(&mut riglab(&["curate", text(dir), "-o", text(&there), "--on", "slurm"])));
    assert!(said.contains("has to lie outside"), "{said}");
}

/// Processes of a task hear what it is told, and may end by themselves.
fn processes(dir: &Path, cluster: &Cluster) {
    let (script, log) = (dir.join("two.sh"), dir.join("two.log"));
    let own = "trap 'echo told; exit 130' TERM; echo begun; sleep 60 & wait";
    let lines = [
        "#!/bin/bash",
        "#SBATCH --ntasks=2",
        &format!("#SBATCH --output={}", log.display()),
        &format!("exec {} slurm-task srun -- --ntasks=2 bash -c \"{own}\"", env!("CARGO_BIN_EXE_riglab")),
    ];
    fs::write(&script, lines.join("\n") + "\n").unwrap();
    let job = cluster.ask("sbatch", &["--parsable", text(&script)]);
    let count = |word: &str| fs::read_to_string(&log).unwrap_or_default().matches(word).count();
    cluster.until("two processes run", || count("begun") == 2);
    // A step that is just being started hears nothing.
    std::thread::sleep(Duration::from_secs(2));
    cluster.ask("scancel", &["--batch", "--signal=TERM", &job]);
    cluster.until("the job ends", || cluster.ask("squeue", &["-h", "-j", &job]).is_empty());
    let ended = cluster.ask("scontrol", &["--oneliner", "show", "job", &job]);
    // Had srun been told instead, it would have killed them: 137.
    assert!(ended.contains("ExitCode=130:0") && count("told") > 0, "{ended}\n{}", read(&log));
}

/// A training whose time is never enough goes on until it is done.
#[test]
fn a_time_limit_costs_nothing() {
    if std::env::var_os(FULL).is_none() {
        println!("skipped: it takes minutes; set {FULL}=1");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let Some(cluster) = Cluster::start(&dir.path().join("cluster")) else { return };
    let base =
        config(dir.path(), &corpus(dir.path(), 12), "[slurm]\ntime = 2\nsignal_seconds = 50\nlook_seconds = 1\n");
    let (here, there) = (dir.path().join("here"), dir.path().join("there"));
    let train = |run: &Path, steps: u64, more: &[&str]| {
        let steps = format!("train.steps={steps}");
        let rest = ["--set", &steps, "--set", "train.validate_every=0", "--set", "train.save_every=0"];
        let all = [&["train", text(&base), "--run", text(run)], &rest[..], more].concat();
        if more.is_empty() { drop(must(&all)) } else { drop(on(&cluster, &all)) }
    };
    // As many steps as take longer than the 70 seconds of a job here.
    let start = std::time::Instant::now();
    train(&dir.path().join("tried"), 300, &[]);
    let steps = (300.0 * 160.0 / start.elapsed().as_secs_f64()) as u64;
    train(&here, steps, &[]);
    train(&there, steps, &["--on", "slurm", "--wait"]);
    assert_eq!(read(&there.join("metrics.jsonl")), read(&here.join("metrics.jsonl")));
    let starts = read(&there.join("slurm/starts/0.jsonl"));
    assert!(starts.lines().count() > 1, "it was never told to leave: {starts}");
    println!("a run in {} starts\n{starts}", starts.lines().count());
}

#[test]
fn without_slurm_it_is_a_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("toy.toml");
    fs::write(&file, "[sweep]\nbase = 'quickstart/demo.toml'\nseeds = [0]\nset = { 'data.corpora' = ['a.h5'] }\n")
        .unwrap();
    let out = dir.path().join("out");
    let args = ["sweep", text(&file), "-o", text(&out), "--on", "slurm"];
    let said = refusal(riglab(&args).env("PATH", dir.path()));
    assert!(said.contains("there is no Slurm on this machine") && said.contains("hint"), "{said}");
    let run = dir.path().join("run");
    let args_of_run = ["train", "quickstart/demo.toml", "--run", text(&run), "--on", "slurm"];
    let said = refusal(riglab(&args_of_run).env("PATH", dir.path()));
    assert!(said.contains("there is no Slurm on this machine") && !run.exists(), "{said}");
    let said = refusal(riglab(&args).args(["--set", "slurm.time=soon"]));
    assert!(said.contains("slurm.time") && said.contains("4:00:00"), "{said}");
    let said = refusal(riglab(&args[..4]).args(["--set", "slurm.time=60"]));
    assert!(said.contains("add --on slurm"), "{said}");
    let said = refusal(&mut riglab(&["slurm-task", "sweep", text(&out)]));
    assert!(said.contains("--on slurm"), "{said}");
}

#[test]
fn a_run_is_extended_by_a_job_or_stays_as_it_is() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 8);
    let base =
        config(dir.path(), &corpus, "[train]\nsteps = 2\nvalidate_every = 0\n[eval]\nvalidation_vertices = 20\n");
    let (run, bin) = (dir.path().join("run"), dir.path().join("bin"));
    must(&["train", text(&base), "--run", text(&run)]);
    fs::create_dir(&bin).unwrap();
    let says = |program: &str, script: &str| {
        let file = bin.join(program);
        fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    };
    says("squeue", "exit 0");
    says("scontrol", "echo 'JobId=7 JobState=OUT_OF_MEMORY Reason=x'");
    says("sbatch", "echo 'sbatch: error: Invalid account' >&2; exit 1");
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let extend = |steps: &str| {
        let set = format!("train.steps={steps}");
        let args = ["train", "--resume", text(&run), "--on", "slurm", "--wait", "--set", &set, "--device", "cuda:1"];
        refusal(riglab(&args).env("PATH", &path))
    };
    let before = ["config.toml", "run.json"].map(|name| read(&run.join(name)));
    // What could but fail in the queue is refused: a model that was exported, and a run whose paths start elsewhere.
    let exported = dir.path().join("exported");
    must(&["checkpoint", "export", text(&run), "-o", text(&dir.path().join("model.safetensors"))]);
    must(&["checkpoint", "export", text(&dir.path().join("model.safetensors")), "-o", text(&exported)]);
    let resume = |run: &Path, sets: &[&str]| {
        let args = [&["train", "--resume", text(run), "--on", "slurm"], sets].concat();
        refusal(riglab(&args).env("PATH", &path).current_dir(dir.path().parent().unwrap()))
    };
    let said = resume(&exported, &[]);
    assert!(said.contains("of which no training goes on"), "{said}");
    let relative = dir.path().join("relative");
    let args = ["train", text(&base), "--run", text(&relative), "--set", "data.corpora=['corpus.h5']"];
    assert!(riglab(&args).current_dir(dir.path()).status().unwrap().success());
    let said = resume(&relative, &["--set", "train.steps=5"]);
    let hint = said.split_once("hint: cd ").unwrap_or_else(|| panic!("{said}")).1.trim();
    assert!(hint.ends_with("/relative --set 'train.steps=5' --on slurm"), "{said}");
    // The cluster does not want it.
    let said = extend("5");
    assert!(said.contains("Invalid account"), "{said}");
    assert!(said.contains("no settings for a cluster are kept here") && said.contains("slurm.KEY=VALUE"), "{said}");
    assert_eq!(["config.toml", "run.json"].map(|name| read(&run.join(name))), before);
    // Nor can a run go on whose corpus is another one.
    let former = fs::read(&corpus).unwrap();
    must(&["synth", "-o", text(&corpus), "--count", "3", "--seed", "5", "--triangles", "300..500"]);
    let said = extend("5");
    assert!(said.contains("put the former corpora back"), "{said}");
    fs::write(&corpus, former).unwrap();
    assert_eq!(["config.toml", "run.json"].map(|name| read(&run.join(name))), before);
    // A job that died trained nothing, though the run was finished before.
    says("sbatch", "echo 7");
    let said = extend("5");
    assert!(said.contains("is not finished: job 7 OUT_OF_MEMORY"), "{said}");
    assert!(read(&run.join("config.toml")).contains("steps = 5"));
    // The job computes where it was asked to.
    let script = read(&run.join("slurm/job-1.sh"));
    assert!(script.lines().last().is_some_and(|line| line.ends_with("--device cuda:1 --submission 1")), "{script}");
}

/// Programs that answer as those of a cluster would which takes all jobs and runs none; a search path with them.
fn answering(dir: &Path) -> String {
    use std::os::unix::fs::PermissionsExt;
    let bin = dir.join("bin");
    fs::create_dir(&bin).unwrap();
    let told = "if [ \"$2\" = config ]; then echo 'MaxArraySize = 1001'; else echo 'JobId=7 JobState=CANCELLED'; fi";
    for (program, script) in [("squeue", "exit 0"), ("scontrol", told), ("sbatch", "echo 7")] {
        let file = bin.join(program);
        fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    }
    format!("{}:{}", bin.display(), std::env::var("PATH").unwrap())
}

#[test]
fn threads_and_tables_reach_the_jobs() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 8);
    let path = answering(dir.path());
    let call = |threads: &str, args: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_riglab"));
        command.args(["--threads", threads]).args(args).env("PATH", &path).current_dir(dir.path());
        command
    };
    let done = |threads: &str, args: &[&str]| {
        let out = call(threads, args).output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    };
    let holds = |script: &Path, parts: &[&str]| {
        let text = read(script);
        assert!(parts.iter().all(|part| text.contains(part)), "{parts:?}: {text}");
    };
    // Threads of the command line come before those of a file, and get a processor each.
    let base = config(dir.path(), &corpus, "[slurm]\npartition = 'small'\nqos = 'low'\ncpus = 2\n");
    let [run, out, curated] = ["run", "out", "curated.h5"].map(|name| dir.path().join(name));
    let left = "train.precision='auto'";
    done("3", &["train", text(&base), "--run", text(&run), "--on", "slurm", "--set", left]);
    // What is left to the machine is left to the node, not to the one that submits.
    holds(&run.join("slurm/config.toml"), &["precision = \"auto\""]);
    holds(&run.join("slurm/job-1.sh"), &["--cpus-per-task=3\n", "--qos=low\n", "slurm-task --threads 3 train "]);
    // One that was begun here has them for later.
    let begun = dir.path().join("begun");
    let short = ["--set", "train.steps=1", "--set", "eval.validation_vertices=20"];
    done("1", &[&["train", text(&base), "--run", text(&begun)], &short[..]].concat());
    done("0", &["train", "--resume", text(&begun), "--on", "slurm"]);
    holds(&begun.join("slurm/job-1.sh"), &["--partition=small\n", "--qos=low\n"]);
    done("3", &["curate", text(&dir.path().join("files")), "-o", text(&curated), "--on", "slurm", "--parts", "2"]);
    let jobs = dir.path().join("curated.curation/slurm");
    holds(&jobs.join("job-1.sh"), &["--cpus-per-task=3\n", "slurm-task --threads 3 curate "]);
    // A sweep's own table stands over that of the config which its jobs start from.
    let file = dir.path().join("toy.toml");
    let write =
        |more: &str| fs::write(&file, format!("[sweep]\nbase = '{}'\nseeds = [0]\n{more}", base.display())).unwrap();
    write("threads = 4\nset = { 'train.precision' = 'auto' }\n[slurm]\npartition = 'cpu'\nlook_seconds = 1\n");
    let sweep = ["sweep", text(&file), "-o", text(&out), "--on", "slurm"];
    done("0", &sweep);
    holds(&out.join("configs/base/seed-0.toml"), &["precision = \"auto\""]);
    let asked = ["--partition=cpu\n", "--qos=low\n"];
    holds(&out.join("slurm/job-1.sh"), &[&asked[..], &["--cpus-per-task=4\n", "--threads 0 sweep "]].concat());
    done("5", &sweep);
    holds(&out.join("slurm/job-2.sh"), &[&asked[..], &["--cpus-per-task=5\n", "--threads 5 sweep "]].concat());
    // A task of the first that is still to start has what it was given.
    holds(&out.join("slurm/job-1.sh"), &[" --submission 1\n"]);
    holds(&out.join("slurm/job-1.toml"), &["cpus = 4\n"]);
    holds(&out.join("slurm/settings.toml"), &["cpus = 5\n"]);
    // Tasks that somebody cancels are told, and no success.
    let said = refusal(&mut call("0", &["sweep", text(&out), "--on", "slurm", "--wait"]));
    assert!(said.contains("1 job not done") && said.contains("`base`, seed 0 (waiting)"), "{said}");
    // What would be read by nobody is refused.
    for more in [
        "set = { 'slurm.time' = '1:00:00' }\n",
        "[sweep.product]\n'slurm.time' = ['1:00:00']\n",
        "[[sweep.arms]]\nname = 'a'\nset = { slurm = { time = '1:00:00' } }\n",
    ] {
        write(more);
        let said = refusal(&mut call("0", &["sweep", text(&file), "-o", "new", "--dry-run"]));
        assert!(said.contains("the table [slurm] of the sweep's file") && said.contains("toy.toml:"), "{said}");
    }
    write("[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\nbase = 'other.toml'\n");
    fs::write(dir.path().join("other.toml"), "extends = 'config.toml'\n[slurm]\nqos = 'high'\n").unwrap();
    let said = refusal(&mut call("0", &["sweep", text(&file), "-o", "new", "--on", "slurm"]));
    assert!(said.contains("different tables [slurm]") && said.contains("other.toml"), "{said}");
    let said = refusal(&mut call("0", &["sweep", text(&file), "-o", "new", "--set", "slurm={time='4:00:00'}"]));
    assert!(said.contains("add --on slurm"), "{said}");
}

#[test]
fn tables_that_do_not_go_together_leave_what_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let base = config(dir.path(), &dir.path().join("nowhere.h5"), "[slurm]\npartition = 'cpu'\n");
    fs::write(dir.path().join("other.toml"), "extends = 'config.toml'\n[slurm]\npartition = 'gpu'\n").unwrap();
    let (file, out) = (dir.path().join("toy.toml"), dir.path().join("out"));
    let sweep = |more: &str| {
        let arm = "[[sweep.arms]]\nname = 'a'\n";
        fs::write(&file, format!("[sweep]\nseeds = [0]\nbase = '{}'\n{arm}{more}", base.display())).unwrap();
        refusal(&mut riglab(&["sweep", text(&file), "-o", text(&out)]))
    };
    let kept = || read(&out.join("slurm/settings.toml"));
    assert!(!sweep("").contains("for later") && kept().contains("partition = \"cpu\""));
    let said = sweep("[[sweep.arms]]\nname = 'b'\nbase = 'other.toml'\n");
    assert!(said.contains("is not kept for later") && said.contains("different tables [slurm]"), "{said}");
    assert!(kept().contains("partition = \"cpu\""), "{}", kept());
}

/// Calls the binary on the cluster; it must end well. Gives all it said.
fn on(cluster: &Cluster, args: &[&str]) -> String {
    let Output { status, stdout, stderr } = cluster.known_to(&mut riglab(args)).output().unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success(), "riglab {}\n{said}", args.join(" "));
    said
}

/// What must be equal. Failed runs are tried as often as there is cause to, so their reasons alone are compared.
fn result(sweep: &Path) -> BTreeMap<&'static str, String> {
    let names = ["results.jsonl", "table.md", "table.tex", "table.csv"];
    names.into_iter().map(|name| (name, read(&sweep.join(name)))).collect()
}

/// The run folders below `jobs`.
fn folders(jobs: &Path) -> Vec<PathBuf> {
    let inner = |dir: &Path| fs::read_dir(dir).into_iter().flatten().flatten().map(|e| e.path()).filter(|p| p.is_dir());
    inner(jobs).flat_map(|point| inner(&point).collect::<Vec<_>>()).collect()
}

fn is_finished(run: &Path) -> bool {
    fs::read_to_string(run.join("run.json")).is_ok_and(|t| t.contains("\"outcome\": \"finished\""))
        && run.join("eval.json").is_file()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn lines_of(path: &Path) -> usize {
    read(path).lines().count()
}
