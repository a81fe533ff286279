//! `riglab slurm-task`: what job scripts run.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use riglab_curate::{Places, nothing_left};
use riglab_files::was_asked;
use riglab_slurm::{SlurmConfig, Task, attend, attend_steps};
use riglab_sweep::{Attempt, Ended, Event, Job, Plan, Stage, State, attempts, is_held, record, run_one};
use riglab_train::Interrupt;

use super::Desk;
use super::curate::{Order, part};
use crate::commands::sweep::settled::settle;
use crate::commands::sweep::{doing, process, threads_of};

/// Do the part of a Slurm job. Job scripts call it.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    kind: Kind,
    /// Added to the task's number.
    #[arg(long, default_value_t = 0, global = true)]
    offset: usize,
    /// The submission that it is of, the first being 1.
    #[arg(long, global = true)]
    submission: Option<usize>,
}

#[derive(clap::Subcommand)]
enum Kind {
    /// A job of the sweep in this folder.
    Sweep { folder: PathBuf },
    /// The run in this folder.
    Train {
        run: PathBuf,
        #[arg(long)]
        device: Option<String>,
    },
    /// A part of the curation to this corpus.
    Curate { out: PathBuf },
    /// The corpus of the parts.
    Merge { out: PathBuf },
    /// A call of srun, whose processes are to hear what the task is told.
    Srun {
        #[arg(last = true, required = true)]
        arguments: Vec<OsString>,
    },
}

/// How a task's work ended.
enum Done {
    Well,
    Failed,
    /// With this code.
    Saved(u8),
}

pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    let Some(task) = Task::here() else {
        bail!("this is what the scripts of Slurm jobs call; `riglab sweep FILE --on slurm` writes and submits them");
    };
    let number = task.number.unwrap_or(0) + args.offset;
    let desk = |work: &Path| Desk::of_submission(work, args.submission);
    let done = match &args.kind {
        Kind::Sweep { folder } => sweep(&task, &desk(folder)?, folder, number, threads)?,
        Kind::Train { run, device } => train(&task, &desk(run)?, run, device.as_deref(), threads)?,
        Kind::Curate { out } => curate(&task, &desk(&Places::of(out).work)?, out, Some(number), threads)?,
        Kind::Merge { out } => curate(&task, &desk(&Places::of(out).work)?, out, None, threads)?,
        Kind::Srun { arguments } => return srun(&task, arguments),
    };
    match done {
        Done::Well => Ok(ExitCode::SUCCESS),
        Done::Failed => Ok(ExitCode::FAILURE),
        Done::Saved(code) => {
            let again = task.requeue()?;
            tell!("task {}: saved and left{}", task.id(), if again { "; it is put back into the queue" } else { "" });
            Ok(ExitCode::from(code))
        }
    }
}

fn sweep(task: &Task, desk: &Desk, folder: &Path, number: usize, threads: usize) -> Result<Done> {
    let plan = Plan::read(folder)?.with_context(|| format!("{}: no sweep here", folder.display()))?;
    let job = plan.jobs.get(number).with_context(|| format!("{}: no job {number}", folder.display()))?;
    let run = folder.join(&job.folder);
    if let Err(stuck) = task.begin(&desk.starts(number), &place(&run), desk.config.patience)? {
        let stage = if is_trained(&run) { "eval" } else { "train" };
        record(folder, &Attempt { job: number, stage: stage.into(), reason: stuck.to_string(), given_up: true })?;
        tell!("error: {stuck}");
        return Ok(Done::Failed);
    }
    settle(folder, &plan, job)?;
    let own = std::env::current_exe().context("the program does not know its own file")?;
    // The command line comes before the file.
    let all = processors(&desk.config);
    let told = [threads, plan.sweep.threads].into_iter().find(|threads| *threads > 0);
    let of_job = [told.unwrap_or(all), if threads > 0 { 0 } else { all }];
    let evaluation = plan.sweep.evaluation_sets();
    let command = |job: &Job, stage, run: &Path| {
        let trains = stage != Stage::Evaluate;
        let program = if trains { launched(&desk.config, &own) } else { Command::new(&own) };
        process(program, of_job, &plan.config(folder, job), (stage, &evaluation), run)
    };
    let interrupt = Interrupt::listening();
    let tell = |event: Event| match event {
        Event::Begun(job, stage) => {
            tell!("task {}: {}, seed {}: {}", task.id(), job.point, job.seed, doing(stage));
        }
        Event::Adopted(_) => tell!("another process is still at it; it is waited for"),
        Event::Failed(_, reason, _) => tell!("failed: {reason}"),
        Event::Finished(_) | Event::Count(..) => {}
    };
    if run_one(folder, &plan, job, command, || interrupt.raised(), tell)? == Ended::Interrupted {
        return Ok(Done::Saved(interrupt.code()));
    }
    let finished = State::of(folder, &plan, job, &attempts(folder)) == State::Finished;
    Ok(if finished { Done::Well } else { Done::Failed })
}

fn train(task: &Task, desk: &Desk, run: &Path, device: Option<&str>, threads: usize) -> Result<Done> {
    if let Err(stuck) = task.begin(&desk.starts(0), &place(run), desk.config.patience)? {
        tell!("error: {stuck}");
        return Ok(Done::Failed);
    }
    let interrupt = Interrupt::listening();
    let held = || tell!("another process is training in {}; it is waited for", run.display());
    if !is_left(run, SOON, || interrupt.raised(), held) {
        return Ok(Done::Saved(interrupt.code()));
    }
    let own = std::env::current_exe().context("the program does not know its own file")?;
    let mut command = launched(&desk.config, &own);
    let goes_on = run.join("config.toml").is_file();
    let all = processors(&desk.config);
    let threads = match threads {
        0 if goes_on => threads_of(run, [all, all]),
        0 => all,
        told => told,
    };
    command.args(["--threads", &threads.to_string(), "train"]);
    match goes_on {
        true => command.arg("--resume").arg(run),
        false => command.arg(desk.file("config.toml")).arg("--run").arg(run),
    };
    command.args(device.iter().flat_map(|device| ["--device", device]));
    attended(command, &interrupt)
}

/// A process that Slurm has just ended lets go of its run within this.
const SOON: Duration = Duration::from_secs(5);

/// Waits until nobody trains in a run's folder; false where it is to `stop` before. `held` tells of one that is there for
/// longer than `soon`.
fn is_left(run: &Path, soon: Duration, stop: impl Fn() -> bool, held: impl Fn()) -> bool {
    let (begin, mut told) = (Instant::now(), false);
    while is_held(run) {
        if stop() {
            return false;
        }
        if begin.elapsed() >= soon && !std::mem::replace(&mut told, true) {
            held();
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    true
}

/// A part of a curation, or with no number the corpus of all parts.
fn curate(task: &Task, desk: &Desk, out: &Path, number: Option<usize>, threads: usize) -> Result<Done> {
    let places = Places::of(out);
    let order = Order::read(desk)?;
    let (own_out, starts) = match number {
        Some(n) => (part(&places, n, order.parts), desk.starts(n)),
        None => (out.to_path_buf(), desk.starts(0)),
    };
    let own_places = Places::of(&own_out);
    // The journal grows by what has been looked at.
    let looked_at = std::fs::metadata(own_places.journal()).map_or(0, |m| m.len());
    if let Err(stuck) = task.begin(&starts, &format!("{looked_at} bytes of the journal"), desk.config.patience)? {
        tell!("error: {stuck}");
        return Ok(Done::Failed);
    }
    let mut command = Command::new(std::env::current_exe().context("the program does not know its own file")?);
    let threads = if threads > 0 { threads } else { processors(&desk.config) };
    command.args(["--threads", &threads.to_string(), "curate"]);
    match number {
        Some(n) => command.arg(&order.folder).args(["--shard", &format!("{n}/{}", order.parts)]),
        None => command.arg("--merge").args((1..=order.parts).map(|n| part(&places, n, order.parts))),
    };
    command.arg("-o").arg(&own_out).arg("--config").arg(desk.file("config.toml"));
    let done = attended(command, &Interrupt::listening())?;
    // A part of which nothing passes is looked at to the end all the same.
    let empty = number.is_some() && matches!(done, Done::Failed) && nothing_left(&own_places);
    Ok(if empty { Done::Well } else { done })
}

fn srun(task: &Task, arguments: &[OsString]) -> Result<ExitCode> {
    let interrupt = Interrupt::listening();
    let mut command = Command::new("srun");
    command.args(arguments);
    let status = attend_steps(command, task, || interrupt.raised())?;
    let code = status.code().and_then(|c| u8::try_from(c).ok());
    Ok(code.map_or(ExitCode::FAILURE, ExitCode::from))
}

fn attended(command: Command, interrupt: &Interrupt) -> Result<Done> {
    let status = attend(command, || interrupt.raised())?;
    Ok(match status.code() {
        Some(0) => Done::Well,
        code if was_asked(code) => Done::Saved(interrupt.code()),
        // Killed by what it was told, before it listened.
        _ if interrupt.raised() => Done::Saved(interrupt.code()),
        _ => Done::Failed,
    })
}

/// The program, by `srun` where several processes train, and that by one who tells these what he hears.
fn launched(config: &SlurmConfig, own: &Path) -> Command {
    if config.processes < 2 {
        return Command::new(own);
    }
    let mut command = Command::new(own);
    command.args(["slurm-task", "srun", "--"]);
    command.arg(format!("--ntasks={}", config.processes));
    // Since 22.05 srun does not take this over from the job.
    command.arg(format!("--cpus-per-task={}", config.cpus.max(1)));
    if !config.mpi.is_empty() {
        command.arg(format!("--mpi={}", config.mpi));
    }
    // After the first has ended the others have as long as a task has to save; one that hangs is ended then.
    command.arg(format!("--wait={}", config.signal_seconds)).arg(own);
    command
}

/// Processors of a process of this task; 0 where Slurm does not say.
fn processors(config: &SlurmConfig) -> usize {
    let told = |name: &str| std::env::var(name).ok().and_then(|v| v.parse().ok());
    match config.processes {
        1 => told("SLURM_CPUS_PER_TASK").or_else(|| told("SLURM_CPUS_ON_NODE")).unwrap_or(0),
        _ => config.cpus.max(1),
    }
}

fn is_trained(run: &Path) -> bool {
    let text = std::fs::read_to_string(run.join("run.json")).unwrap_or_default();
    serde_json::from_str(&text).is_ok_and(|v: serde_json::Value| v["outcome"] == "finished")
}

/// Where a run stands: at its last checkpoint.
fn place(run: &Path) -> String {
    if is_trained(run) {
        return "evaluation".into();
    }
    let entries = std::fs::read_dir(run.join("checkpoints")).into_iter().flatten().flatten();
    let step = |name: std::ffi::OsString| name.to_str()?.strip_prefix("step-")?.parse::<u64>().ok();
    format!("step {}", entries.filter_map(|e| step(e.file_name())).max().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use riglab_train::RunInfo;

    use super::*;

    #[test]
    fn a_run_stands_at_its_last_checkpoint() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(place(dir.path()), "step 0");
        for name in ["step-00000002", "step-00000010", "best", "step-x"] {
            std::fs::create_dir_all(dir.path().join("checkpoints").join(name)).unwrap();
        }
        assert_eq!(place(dir.path()), "step 10");
        std::fs::write(dir.path().join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        assert_eq!(place(dir.path()), "evaluation");
    }

    #[test]
    fn a_job_that_never_gets_on_is_given_up_for_good() {
        let dir = tempfile::tempdir().unwrap();
        let config = riglab_config::Config::from_toml_str("s.toml", "[sweep]\nbase = 'b'\nseeds = [0, 1]\n").unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        plan.settle(dir.path(), |_| Ok(String::new())).unwrap();
        let desk = Desk::new(dir.path(), SlurmConfig::default()).unwrap();
        let task = Task { job: "17".into(), number: Some(1), node: "n1".into() };
        for _ in 0..desk.config.patience {
            task.begin(&desk.starts(1), "step 0", desk.config.patience).unwrap().unwrap();
        }
        assert!(matches!(sweep(&task, &desk, dir.path(), 1, 0).unwrap(), Done::Failed));
        let State::Failed(reason) = State::of(dir.path(), &plan, &plan.jobs[1], &attempts(dir.path())) else {
            panic!("it is not given up");
        };
        assert!(reason.starts_with("train: it was begun 3 times at the same place (step 0)"), "{reason}");
    }

    #[test]
    fn a_run_goes_on_with_its_threads_within_the_tasks_processors() {
        let dir = tempfile::tempdir().unwrap();
        let of = |processors: usize| threads_of(dir.path(), [processors, processors]);
        assert_eq!([of(0), of(4)], [0, 4], "it does not say");
        let info = RunInfo { threads: 2, ..RunInfo::default() };
        std::fs::write(dir.path().join("run.json"), serde_json::to_string(&info).unwrap()).unwrap();
        assert_eq!([of(0), of(1), of(2), of(8)], [0, 1, 2, 2]);
    }

    #[test]
    fn a_run_that_somebody_else_trains_is_waited_for_aloud() {
        let dir = tempfile::tempdir().unwrap();
        let told = std::cell::Cell::new(0);
        let held = || told.set(told.get() + 1);
        assert!(is_left(dir.path(), Duration::ZERO, || false, held) && told.get() == 0);
        let lock = std::fs::File::create(dir.path().join(".lock")).unwrap();
        lock.try_lock().unwrap();
        let looks = std::cell::Cell::new(0);
        let stop = || looks.replace(looks.get() + 1) == 3;
        assert!(!is_left(dir.path(), Duration::ZERO, stop, held));
        assert_eq!(told.get(), 1, "once");
        looks.set(0);
        assert!(!is_left(dir.path(), SOON, stop, held) && told.get() == 1, "it may have been ended just now");
    }

    #[test]
    fn several_processes_are_started_by_srun() {
        let words = |config: &SlurmConfig| {
            let command = launched(config, Path::new("/opt/riglab"));
            let args: Vec<String> = command.get_args().map(|a| a.to_string_lossy().into_owned()).collect();
            format!("{} {}", command.get_program().to_string_lossy(), args.join(" "))
        };
        assert_eq!(words(&SlurmConfig::default()).trim(), "/opt/riglab");
        let config = SlurmConfig { processes: 4, cpus: 8, mpi: "pmix".into(), ..SlurmConfig::default() };
        let want = "/opt/riglab slurm-task srun -- --ntasks=4 --cpus-per-task=8 --mpi=pmix --wait=120 /opt/riglab";
        assert_eq!(words(&config), want);
    }
}
