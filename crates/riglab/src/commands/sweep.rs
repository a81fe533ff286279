//! `riglab sweep`

mod begun;
mod checked;
mod named;
pub mod settled;

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use riglab_report::{Cell, Table};
use riglab_sweep::{
    Budget, Ended, Event, Job, Plan, REPLACED, Results, Stage, SweepError, may_be_called, name_tests, retry,
    run as run_pool,
};
use riglab_train::{Interrupt, Progress, RunInfo, without_best};

use super::alike::by_reason;
use super::charts::{charts, no_file, spare};
use super::report::write;
use super::slurm::sweep::{Handed, run as hand_over, seen};
use super::slurm::{Desk, On, apart, settings};
use super::{keep_apart, shown, some_of};
use crate::presets;
use crate::registry::TaskConfig;
use begun::Begun;
use checked::{check, missing};
use named::{asks, based, file_of, without_cluster};
use riglab_report::counted;
use riglab_report::shell::command;

/// Train many runs from one file: arms, grids (`[sweep.product]`) and seeds.
///
/// All jobs are listed at once, each with its resolved config, and run as processes of this machine within a budget.
/// A sweep that was stopped or killed goes on when it is called again, with the threads of a job and the jobs at a time that
/// it was begun with, unless these are given or do not fit; a run that fails is tried once more and never
/// stops the rest; with --retry it is tried anew. Arms (named variants) added to the file join the existing
/// runs, as long as their settings and corpora are unchanged; an arm whose jobs failed may be changed, or the config that it
/// is based on, and they are begun anew. The result is a table of means and spreads over seeds, in results.jsonl, table.md, table.tex, table.csv and
/// report.html. TensorBoard compares the runs: `tensorboard --logdir SWEEP/jobs`.
///
/// Its exit code is 1 if a run failed, or was cancelled on a cluster and is not done.
///
/// With --on slurm the jobs are tasks of an array, which save when their time ends, are requeued and go on. The same
/// command again hands over what is neither done nor in the queue, and writes the table when all is.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab sweep skintokens/table5_dice.toml --set data.corpora='[\"rigs.h5\"]'
  riglab sweep my_sweep.toml -o sweeps/mine --jobs 2
  riglab sweep sweeps/mine            # goes on
  riglab sweep sweeps/mine --status   # how far it is
  riglab sweep sweeps/mine --retry    # what failed, too
  riglab sweep sweeps/mine --charts figures   # each chart as a file, for a paper
  riglab sweep my_sweep.toml --on slurm --set slurm.partition=cpu --set slurm.time=4:00:00
  riglab sweep sweeps/my_sweep --on slurm --wait   # until the table is written")]
pub struct Args {
    /// Sweep file, the name of a built-in one, or the folder of a sweep to go on with.
    #[arg(required_unless_present = "list")]
    sweep: Option<String>,
    /// Change a value of every job's config, or of the sweep's own [slurm], as often as needed.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// The sweep's folder [default: sweeps/<file>].
    #[arg(long, short, value_name = "DIR", value_parser = super::place_to_write())]
    out: Option<PathBuf>,
    /// Jobs at a time; 0 takes as many as before, and at first as processors and memory allow.
    #[arg(long, default_value_t = 0, value_name = "N")]
    jobs: usize,
    /// Processors to use; 0 takes as many as before, and at first all.
    #[arg(long, default_value_t = 0, value_name = "N", conflicts_with = "on")]
    cores: usize,
    /// Memory to use in GB; 0 takes nine tenths of what is free.
    #[arg(long, default_value_t = 0.0, value_name = "GB", conflicts_with = "on")]
    memory: f64,
    /// Hand the jobs to a cluster instead of running them here.
    #[arg(long, value_name = "WHERE")]
    on: Option<On>,
    /// With --on: follow the jobs until all are done, and write the table.
    #[arg(long, requires = "on")]
    wait: bool,
    /// Try failed jobs again, twice each as at first.
    #[arg(long, conflicts_with_all = ["status", "list"])]
    retry: bool,
    /// Show how far the jobs are and the table so far, and leave.
    #[arg(long)]
    status: bool,
    /// With --status: again every so many seconds, until all is done.
    #[arg(long, value_name = "SECONDS", requires = "status")]
    watch: Option<u64>,
    /// When all is done, write each chart of the report into this folder, too, as `riglab report --charts` does.
    #[arg(long, value_name = "DIR", value_parser = super::place_to_write(), conflicts_with_all = ["status", "list", "dry_run"])]
    charts: Option<PathBuf>,
    /// Check that the jobs can be done in the folder, list them, and leave.
    #[arg(long)]
    dry_run: bool,
    /// List the built-in sweeps.
    #[arg(long)]
    list: bool,
}

/// `threads`: of each job; 0 leaves it to the sweep's file.
pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    super::alone("sweep")?;
    if args.list {
        presets::listed(&presets::sweeps()).iter().for_each(|line| say!("{line}"));
        return Ok(ExitCode::SUCCESS);
    }
    let Some(name) = &args.sweep else { bail!("give a sweep file, or the folder of a sweep") };
    args.charts.as_deref().map_or(Ok(()), no_file)?;
    let (plan, folder, desk) = plan(name, args)?;
    args.charts.as_deref().map_or(Ok(()), |figures| spare(figures, |name| may_be_called(&plan, name)))?;
    if args.status {
        return status(&there(plan, &folder)?, &folder, args.watch);
    }
    // A folder's own plan is settled: it goes on even where the files that it was made of are gone or others.
    let new = !Path::new(name).is_dir();
    if args.dry_run {
        let again = check(&plan, &folder, args)?;
        if new {
            tell_alike(&plan, &folder)?;
        }
        if !again.anew.is_empty() {
            tell!("would be begun anew, as they had failed and have other settings now: {}", again.anew.join("; "));
        }
        for job in &plan.jobs {
            say!("{}  {}  {} {}", job.folder, job.point, job.base, job.sets.join(" "));
        }
        for missing in missing(&plan, &folder, &again, args)? {
            tell!("warning: {missing}: no such corpus; the jobs that read it would fail");
        }
        return Ok(ExitCode::SUCCESS);
    }
    if !folder.is_dir() {
        // What is refused leaves none behind.
        check(&plan, &folder, args)?;
        std::fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    }
    // Before anything is written: of two calls at once, one alone says which sweep it is.
    let _held = hold(&folder)?;
    check(&plan, &folder, args)?;
    if new {
        tell_alike(&plan, &folder)?;
        let anew: Vec<String> =
            plan.settle(&folder, settled::configs(&folder)?)?.iter().map(|job| job.shown()).collect();
        if !anew.is_empty() {
            let kept = shown(&folder.join(REPLACED));
            tell!(
                "begun anew, as they had failed and have other settings now: {}; what they left is in {kept}",
                anew.join("; ")
            );
        }
        // A later call that names the folder alone may hand it to a cluster.
        match &desk {
            Ok(desk) if args.on.is_none() => desk.keep_for_later()?,
            Ok(_) => {}
            Err(why) => tell!("note: what the jobs ask of a cluster is not kept for later: {why:#}"),
        }
    }
    if args.retry {
        tell!("{}: tried again", counted(retry(&folder, &plan)?, "failed job"));
    }
    for of in plan.sweep.unevaluated() {
        tell!("warning: `{of}` comes of an evaluation, and none is made: the sweep's file has not `evaluate = true`");
    }
    let (place, memory) = (shown(&folder), args.memory.to_string());
    let again = match args.memory > 0.0 {
        true => command(["sweep", &place, "--memory", &memory]),
        false => command(["sweep", &place]),
    };
    let begun = Begun::read(&folder).or_of_runs(&folder, &plan);
    let goes_on = !plan.left(&folder, |_| false).is_empty();
    if args.on == Some(On::Slurm) {
        // What a machine gave its jobs by itself says nothing of a cluster's.
        let threads = if threads > 0 { threads } else { begun.told };
        if goes_on {
            Begun { told: threads, ..begun }.keep(&folder)?;
        }
        let desk = asked(desk?, args, &plan, threads)?;
        return match hand_over(&folder, &plan, &desk, threads, args.wait)? {
            Handed::Queued => {
                tell!("follow them with: {again} --status");
                tell!("the table comes by: {again} --on slurm");
                say!("{}", folder.display());
                Ok(ExitCode::SUCCESS)
            }
            Handed::Left(code) => {
                tell!("the jobs go on; look again with: {again} --on slurm --wait");
                Ok(ExitCode::from(code))
            }
            Handed::Done => conclude(&plan, &folder, args, " --on slurm"),
        };
    }
    let all = std::thread::available_parallelism().map_or(1, usize::from);
    let (now, note) = begun.asked([args.jobs, args.cores, threads], plan.sweep.threads, all);
    note.iter().for_each(|note| tell!("note: {note}"));
    let budget = Budget::new(now.jobs, now.cores, now.threads, args.memory, plan.jobs.len());
    // A training that goes on keeps its threads, if the job may have as many and nothing else is asked for.
    let own = if now.cores > 0 { now.cores } else { all } / budget.jobs.max(1);
    let most = if threads > 0 { 0 } else { own.max(budget.threads) };
    if goes_on {
        begun.after(now, threads > 0, budget.threads).keep(&folder)?;
    }
    let total = plan.jobs.len() as u64;
    tell!(
        "{} in {}: {} at a time with {} each, within {:.1} GB",
        counted(plan.jobs.len(), "job"),
        folder.display(),
        budget.jobs,
        counted(budget.threads, "thread"),
        budget.memory_gb
    );
    plan.jobs.iter().try_for_each(|job| settled::settle(&folder, &plan, job))?;
    let own = std::env::current_exe().context("the program does not know its own file")?;
    let evaluation = plan.sweep.evaluation_sets();
    let start = |job: &Job, stage: Stage, run: &Path| {
        process(Command::new(&own), [budget.threads, most], &plan.config(&folder, job), (stage, &evaluation), run)
    };
    let interrupt =
        Interrupt::listening_for("trainings save after this step, evaluations begin anew when the sweep goes on");
    let mut progress = Progress::new("sweeping", total, 0);
    // Hours before all is done, the first finished run tells what stays empty.
    let mut told = plan.jobs.len() == 1;
    let hear = |event: Event| {
        tell(&event, &mut progress);
        if matches!(event, Event::Finished(_)) && !std::mem::replace(&mut told, true) {
            let results = Results::read(&folder, &plan);
            let early = results.absent(&folder).into_iter().chain(results.gaps());
            early.for_each(|sentence| progress.line(&format!("warning, after the first finished run: {sentence}")));
        }
    };
    let ended = run_pool(&folder, &plan, budget, start, || interrupt.raised(), hear);
    progress.finish();
    let ended = ended?;
    if ended == Ended::Interrupted {
        Results::read(&folder, &plan).write(&folder)?;
        tell!("interrupted; go on with: {again}");
        return Ok(ExitCode::from(interrupt.code()));
    }
    conclude(&plan, &folder, args, "")
}

/// The plan whose jobs a folder has: its own where a file lists others.
fn there(plan: Plan, folder: &Path) -> Result<Plan> {
    match Plan::read(folder)? {
        Some(there) if !plan.continues(&there) => {
            tell!("note: the file lists other jobs than {} has; shown is what the folder has", folder.display());
            Ok(there)
        }
        Some(_) => Ok(plan),
        None => {
            tell!("note: nothing was begun in {} yet", folder.display());
            Ok(plan)
        }
    }
}

/// Tells of points that are the same runs.
fn tell_alike(plan: &Plan, folder: &Path) -> Result<()> {
    for (first, second) in plan.alike(settled::guesses(folder))? {
        tell!("warning: `{first}` and `{second}` have the same settings: their jobs are the same runs");
    }
    Ok(())
}

/// Writes and shows what a sweep found. `on`: what its command says of a cluster.
fn conclude(plan: &Plan, folder: &Path, args: &Args, on: &str) -> Result<ExitCode> {
    let results = Results::read(folder, plan);
    results.write(folder)?;
    show(&results);
    results.ambiguous(folder).iter().for_each(|sentence| tell!("warning: {sentence}"));
    let absent = [results.absent(folder), results.gaps()].concat();
    absent.iter().for_each(|sentence| tell!("warning: {sentence}"));
    if !absent.is_empty() {
        tell!("correct the sweep's file and give it again: what is trained stays, and the table is written anew");
    }
    for sentence in results.mixed() {
        match results.is_meant() {
            true => tell!("note: {sentence}"),
            false => tell!("warning: {sentence}; what differs may be the corpora's doing"),
        }
    }
    if plan.sweep.evaluate && results.evaluation_groups().is_some() {
        tell!(
            "to measure all on the same assets: `evaluate_with = {{ \"data.corpora\" = [\"FILE\"] }}` in the sweep's file, which \
             evaluates again and trains nothing anew"
        );
    }
    for sentence in results.retrained() {
        tell!("warning: {sentence}; what differs may be their doing");
    }
    results.not_their_own().iter().for_each(|sentence| tell!("warning: {sentence}"));
    let reasons = results.outcomes.iter().filter(|o| !o.reason.is_empty());
    let reasons: Vec<_> = reasons.map(|o| (format!("{} (seed {})", o.point, o.seed), o.reason.clone())).collect();
    by_reason("failed: ", &reasons).0.iter().for_each(|line| tell!("{line}"));
    let failed = results.count("failed");
    if failed > 0 {
        let again = command(["sweep", &shown(folder)]);
        tell!(
            "{} failed; where settings are at fault, correct the sweep's file and give it again; else try again with: {again} \
             --retry{on}",
            counted(failed, "job")
        );
    }
    let open = results.outcomes.iter().filter(|o| !["finished", "failed"].contains(&o.state.as_str()));
    let open: Vec<String> = open.map(|o| format!("`{}`, seed {} ({})", o.point, o.seed, o.state)).collect();
    if !open.is_empty() {
        let again = command(["sweep", &shown(folder)]);
        tell!(
            "{} not done, such as tasks that were cancelled: {}; go on with: {again}{on}",
            counted(open.len(), "job"),
            some_of(&open)
        );
    }
    say!("{}", folder.join("report.html").display());
    if let Some(figures) = &args.charts {
        charts(&results.page(folder), figures)?.iter().try_for_each(|(path, content)| write(path, content))?;
    }
    let all = failed == 0 && open.is_empty() && results.count("finished") > 0;
    Ok(if all { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The plan, its folder, and what its jobs ask of a cluster: of a folder that has one, else of a file. Where nothing is handed
/// over, configs may ask for what does not go together; then that is told in its place.
fn plan(name: &str, args: &Args) -> Result<(Plan, PathBuf, Result<Desk>)> {
    let folder = PathBuf::from(name);
    let (cluster, sets) = apart(&args.sets);
    if !cluster.is_empty() && args.on.is_none() {
        bail!("`--set {}` is about a cluster; add --on slurm", cluster[0]);
    }
    if folder.is_dir() {
        if !sets.is_empty() || args.out.is_some() {
            bail!("{name} is a sweep's folder: its jobs are settled, --set (but of slurm) and -o belong to a new one");
        }
        let Some(plan) = Plan::read(&folder)? else {
            bail!("{name}: no sweep here (there is no sweep.json); `riglab sweep FILE` makes one");
        };
        let desk = Desk::reopen(&folder, &cluster)?;
        if args.on.is_some() && cluster.is_empty() {
            let others = "the sweep's file in the place of the folder, or --set slurm.KEY=VALUE, gives others";
            desk.without_settings(others).iter().for_each(|note| tell!("note: {}: {note}", folder.display()));
        }
        return Ok((plan, folder, Ok(desk)));
    }
    let config = presets::load(name, &cluster)?;
    if config.contains("task") && !config.contains("sweep") {
        bail!("{name} is an experiment of one run: `{}` trains it", command(["train", name]));
    }
    config.check_keys(&["sweep", "slurm"])?;
    if config.contains("sweep.grid") {
        // What others call a grid.
        let message = "a grid is [sweep.product] here: did you mean `product`?";
        return Err(config.invalid("sweep.grid", message).into());
    }
    let mut file = file_of(&config)?;
    // Where each arm has its own, that of the sweep is not read.
    let used = file.arms.is_empty() || file.arms.iter().any(|arm| arm.base.is_none());
    let arms = file.arms.iter_mut().enumerate();
    let arms = arms.filter_map(|(k, arm)| arm.base.as_mut().map(|base| (format!("sweep.arms[{k}].base"), base)));
    for (key, base) in [("sweep.base".to_owned(), &mut file.base)].into_iter().filter(|_| used).chain(arms) {
        *base = based(&config, &key, Path::new(name), base)?;
    }
    without_cluster(&config, &file)?;
    let bases = used.then_some(&file.base).into_iter().chain(file.arms.iter().filter_map(|arm| arm.base.as_ref()));
    settings(&config)?;
    let slurm = match asks(&config, bases) {
        // What cannot be handed over is refused where it is to be.
        Err(why) if args.on.is_none() => Err(why),
        asked => Ok(asked?),
    };
    let plan = Plan::new(file, &sets).map_err(|e| match e {
        SweepError::Key { key, message } => config.invalid(&format!("sweep.{key}"), message),
        e => config.invalid("sweep", e),
    })?;
    let stem = Path::new(name).file_stem().map_or("sweep".into(), |s| s.to_string_lossy().into_owned());
    let folder = args.out.clone().unwrap_or_else(|| Path::new("sweeps").join(stem));
    let plan = match Plan::read(&folder)? {
        Some(there) => plan.following(&there),
        None => {
            keep_apart(&folder)?;
            plan
        }
    };
    let desk = slurm.and_then(|slurm| Desk::new(&folder, slurm));
    Ok((plan, folder, desk))
}

/// With the jobs at a time, and the threads of each, that the command line asks for, and the memory of a job that the sweep's
/// file tells, where [slurm] tells none.
fn asked(desk: Desk, args: &Args, plan: &Plan, threads: usize) -> Result<Desk> {
    let desk = desk.for_threads(if threads > 0 { threads } else { plan.sweep.threads })?;
    let desk = if args.jobs > 0 { desk.with(|slurm| slurm.at_a_time = args.jobs)? } else { desk };
    desk.for_memory(plan.sweep.memory_gb)
}

fn settings_of(name: &str, sets: &[String]) -> Result<TaskConfig> {
    TaskConfig::read(&presets::load(name, sets)?)
}

fn unsound(job: &Job, e: &anyhow::Error) -> SweepError {
    SweepError::Invalid(format!("{}, seed {}: {e:#}", job.point, job.seed))
}

/// The threads of a training that goes on: those that it was begun with, where it says so and these are `most` at most, else
/// `threads`. 0 leaves it to the training.
pub fn threads_of(run: &Path, [threads, most]: [usize; 2]) -> usize {
    let begun = RunInfo::of(run).map_or(0, |info| info.threads);
    if (1..=most).contains(&begun) { begun } else { threads }
}

/// What runs a stage of a job: `riglab`, however it is started, with its arguments. A training that goes on takes the threads
/// that it was begun with, where these are `most` at most; an evaluation has the settings `evaluation` besides the run's, and
/// where these name the splits that are tested on, nothing is asked of those of the run.
pub fn process(
    riglab: Command,
    [threads, most]: [usize; 2],
    config: &Path,
    (stage, evaluation): (Stage, &[String]),
    run: &Path,
) -> Command {
    let mut command = riglab;
    let threads = if stage == Stage::Resume { threads_of(run, [threads, most]) } else { threads };
    command.arg("--threads").arg(threads.to_string());
    match stage {
        Stage::Train => {
            command.arg("train").arg(config).arg("--run").arg(run);
            if name_tests(evaluation) { command.arg("--tested-otherwise") } else { &mut command }
        }
        Stage::Resume => command.args(["train", "--resume"]).arg(run),
        // Of a run that no checkpoint is the best of, the last: to leave it out would leave out what went wrong.
        Stage::Evaluate if without_best(run) => command.arg("eval").arg(run).args(["--checkpoint", "last"]),
        Stage::Evaluate => command.arg("eval").arg(run),
    };
    if stage == Stage::Evaluate {
        command.args(evaluation.iter().flat_map(|set| ["--set", set]));
    }
    command
}

/// The right to run jobs in the folder, held until the process ends.
fn hold(folder: &Path) -> Result<File> {
    let path = folder.join(".lock");
    let lock = File::create(&path).with_context(|| format!("{} cannot be written", path.display()))?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(SweepError::Held(folder.into()).into()),
        // Of a file system without locks, say: nobody need be at work.
        Err(TryLockError::Error(e)) => Err(e).with_context(|| format!("{} cannot be locked", path.display())),
    }
}

/// A stage in words.
pub fn doing(stage: Stage) -> &'static str {
    match stage {
        Stage::Train => "trains",
        Stage::Resume => "goes on",
        Stage::Evaluate => "is evaluated",
    }
}

fn tell(event: &Event, progress: &mut Progress) {
    match event {
        Event::Begun(job, stage) => {
            progress.line(&format!("{}, seed {}: {}", job.point, job.seed, doing(*stage)));
        }
        Event::Adopted(job) => {
            progress.line(&format!("{}, seed {}: still runs; it is waited for", job.point, job.seed))
        }
        Event::Failed(job, reason, again) => {
            let next = if *again { "; it is tried once more" } else { "" };
            progress.line(&format!("failed: {}, seed {}: {reason}{next}", job.point, job.seed));
        }
        Event::Finished(_) => {}
        Event::Count(done, running) => progress.set(*done as u64, || format!("{running} running")),
    }
}

fn show(results: &Results) {
    let tables = std::iter::once(results.table()).chain(results.differences());
    say!("{}", tables.map(|t| t.to_text()).collect::<Vec<_>>().join("\n"));
}

fn status(plan: &Plan, folder: &Path, watch: Option<u64>) -> Result<ExitCode> {
    loop {
        let results = Results::read(folder, plan);
        let states = ["finished", "running", "trained", "interrupted", "waiting", "failed"];
        let counts = states.map(|s| (s, results.count(s))).into_iter().filter(|(_, n)| *n > 0);
        let counts: Vec<String> = counts.map(|(s, n)| format!("{n} {s}")).collect();
        let mut table: Table = results.status();
        match seen(folder, plan) {
            Ok(None) => {}
            Ok(Some(queued)) => {
                table.head.push("Slurm".into());
                table.rows.iter_mut().zip(queued).for_each(|(row, q)| row.push(Cell::text(q)));
            }
            Err(e) => tell!("note: what is in the queue is not known: {e:#}"),
        }
        table.caption = format!("{}: {}", folder.display(), counts.join(", "));
        say!("{}", table.to_text());
        // Before that all of it is empty.
        if results.count("finished") > 0 {
            show(&results);
        }
        let left = results.outcomes.len() - results.count("finished") - results.count("failed");
        match watch {
            Some(seconds) if left > 0 => std::thread::sleep(Duration::from_secs(seconds.max(1))),
            _ => return Ok(ExitCode::SUCCESS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_a_best_is_evaluated_at_its_last_step() {
        let run = tempfile::tempdir().unwrap();
        let asked = || {
            let command =
                process(Command::new("riglab"), [1, 0], Path::new("c.toml"), (Stage::Evaluate, &[]), run.path());
            command.get_args().skip(3).map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
        };
        let (last, best) = (run.path().join("checkpoints/last"), run.path().join("checkpoints/best"));
        std::fs::create_dir_all(last).unwrap();
        assert_eq!(asked(), format!("{} --checkpoint last", run.path().display()));
        std::fs::create_dir_all(best).unwrap();
        assert_eq!(asked(), run.path().display().to_string());
    }

    #[test]
    fn a_run_that_goes_on_keeps_its_threads() {
        let dir = tempfile::tempdir().unwrap();
        let of = |most, stage| {
            let sets = ["eval.a=1".into(), "data.b=2".into()];
            let command = process(Command::new("riglab"), [4, most], Path::new("c.toml"), (stage, &sets), dir.path());
            let all = command.get_args().map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ");
            all.replace(&shown(dir.path()), "RUN")
        };
        // Broken off before it wrote how many it has.
        assert_eq!(of(4, Stage::Resume), "--threads 4 train --resume RUN");
        let info = RunInfo { threads: 2, ..RunInfo::default() };
        std::fs::write(dir.path().join("run.json"), serde_json::to_string(&info).unwrap()).unwrap();
        assert_eq!(of(4, Stage::Resume), "--threads 2 train --resume RUN");
        assert_eq!([0, 1].map(|most| of(most, Stage::Resume)), ["--threads 4 train --resume RUN"; 2]);
        assert_eq!(of(4, Stage::Train), "--threads 4 train c.toml --run RUN");
        assert_eq!(of(4, Stage::Evaluate), "--threads 4 eval RUN --set eval.a=1 --set data.b=2");
        for tests in ["data.test=['a']", "data={ extends = [], corpora = ['b.h5'] }"] {
            let sets = [tests.to_owned()];
            let command =
                process(Command::new("riglab"), [4, 4], Path::new("c.toml"), (Stage::Train, &sets), dir.path());
            assert_eq!(command.get_args().last().unwrap(), "--tested-otherwise", "{tests}");
        }
    }

    #[test]
    fn blocks_that_a_sweep_chooses_leave_nothing_of_the_former() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("s.toml");
        let text = "[sweep]\nbase = 'quickstart/unirig_skeleton.toml'\nseeds = [0]\n\
                    set = { 'data.corpora' = ['c.h5'] }\n\
                    [[sweep.arms]]\nname = 'other'\nset = { augment = { extends = 'augment/unirig_ar.toml' } }\n\
                    [[sweep.arms]]\nname = 'none'\nset = { augment = { extends = [] } }\n";
        std::fs::write(&file, text).unwrap();
        let plan = Plan::new(file_of(&presets::load(&shown(&file), &[]).unwrap()).unwrap(), &[]).unwrap();
        let of = |job: &Job| settings_of(&job.base, &job.sets).unwrap().to_toml().unwrap();
        let by_hand = |set: &str| {
            let sets = ["data.corpora=['c.h5']", set, "train.seed=0"].map(String::from);
            settings_of("quickstart/unirig_skeleton.toml", &sets).unwrap().to_toml().unwrap()
        };
        assert_eq!(of(&plan.jobs[0]), by_hand("augment={ extends = 'augment/unirig_ar.toml' }"));
        assert_eq!(of(&plan.jobs[1]), by_hand("augment={ extends = [] }"));
        assert!(![&plan.jobs[0], &plan.jobs[1]].map(of).contains(&by_hand("train.seed=0")));
        // Jobs of an earlier version have the former block, too, where that says what this one does not.
        let out = folder.path().join("out");
        let mut earlier = plan.clone();
        let word = "extends = []";
        for set in earlier.jobs.iter_mut().flat_map(|job| &mut job.sets).filter(|set| set.contains(word)) {
            *set = set.replace(&format!("{word}, "), "").replace(&format!(", {word}"), "").replace(word, "");
        }
        earlier.settle(&out, settled::configs(&out).unwrap()).unwrap();
        let said = plan.fits(&out, settled::configs(&out).unwrap()).unwrap_err().to_string();
        assert!(said.contains("`other`, seed 0 has augment."), "{said}");
        // What came to the same joins them.
        for job in &plan.jobs {
            std::fs::write(plan.config(&out, job), of(job)).unwrap();
        }
        plan.settle(&out, settled::configs(&out).unwrap()).unwrap();
        assert_eq!(Plan::read(&out).unwrap().unwrap(), plan);
    }

    #[test]
    fn a_cluster_is_asked_for_the_memory_that_the_sweep_tells() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: Args,
        }
        let args = <Line as clap::Parser>::parse_from(["sweep", "s.toml", "--on", "slurm"]).args;
        let folder = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\nmemory_gb = 1.5\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        // As a call has it that names the folder alone.
        let of = |sets: &[&str]| {
            let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
            asked(Desk::reopen(folder.path(), &sets).unwrap(), &args, &plan, 0).unwrap().config.memory
        };
        assert_eq!((of(&[]), of(&["slurm.memory=4G"])), ("1536M".into(), "4G".into()));
        assert_eq!(of(&["slurm.options=['--mem-per-cpu=2G']"]), "", "as it says otherwise");
    }

    #[test]
    fn every_built_in_sweep_has_sound_jobs() {
        let all = presets::sweeps();
        assert!(all.len() >= 3, "{all:?}");
        for (name, _) in all {
            let config = presets::load(name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            let file: riglab_sweep::SweepFile = config.get_at("sweep").unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(file.seeds.len() >= 3 && !file.question.is_empty() && !file.expected.is_empty(), "{name}");
            let plan = Plan::new(file, &["data.corpora=['rigs.h5']".into()]).unwrap_or_else(|e| panic!("{name}: {e}"));
            let whole = settled::configs(Path::new("nowhere")).unwrap();
            // Jobs of one point differ by their seeds alone.
            let first = plan.jobs.iter().filter(|j| j.seed == plan.sweep.seeds[0]);
            let mut configs: Vec<String> = first.map(|j| whole(j).unwrap_or_else(|e| panic!("{name}: {e}"))).collect();
            configs.sort();
            let count = configs.len();
            configs.dedup();
            assert_eq!(configs.len(), count, "{name}: two points are the same");
        }
    }
}
