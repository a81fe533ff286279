//! `riglab sweep`

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use riglab_report::Table;
use riglab_sweep::{Budget, Ended, Event, Job, Plan, Results, Stage, SweepError, SweepFile, run as run_pool};
use riglab_train::{Interrupt, Progress};

use crate::presets;
use crate::registry::TaskConfig;

/// Train many runs from one file: arms, grids and seeds.
///
/// All jobs are listed at once, each with its resolved config, and run as processes of this machine within a budget.
/// A sweep that was stopped or killed goes on when it is called again; a run that fails is tried once more and never
/// stops the rest. At the end stands a table of means and spreads over seeds, in results.jsonl, table.md, table.tex,
/// table.csv and report.html. TensorBoard compares the runs: `tensorboard --logdir SWEEP/jobs`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab sweep skintokens/table5_dice.toml --set data.corpora='[\"rigs.h5\"]'
  riglab sweep my_sweep.toml -o sweeps/mine --jobs 2
  riglab sweep sweeps/mine            # goes on
  riglab sweep sweeps/mine --status   # how far it is")]
pub struct Args {
    /// Sweep file, the name of a built-in one, or the folder of a sweep to go on with.
    #[arg(required_unless_present = "list")]
    sweep: Option<String>,
    /// Change a value of every job's config, as often as needed.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// The sweep's folder [default: sweeps/<file>].
    #[arg(long, short, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Jobs at a time [default: as many as processors and memory allow].
    #[arg(long, default_value_t = 0, value_name = "N")]
    jobs: usize,
    /// Processors to use; 0 takes all.
    #[arg(long, default_value_t = 0, value_name = "N")]
    cores: usize,
    /// Memory to use in GB; 0 takes nine tenths of what is free.
    #[arg(long, default_value_t = 0.0, value_name = "GB")]
    memory: f64,
    /// Show how far the jobs are and the table so far, and leave.
    #[arg(long)]
    status: bool,
    /// With --status: again every so many seconds, until all is done.
    #[arg(long, value_name = "SECONDS", requires = "status")]
    watch: Option<u64>,
    /// List the jobs and leave.
    #[arg(long)]
    dry_run: bool,
    /// List the built-in sweeps.
    #[arg(long)]
    list: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    if args.list {
        presets::sweeps().iter().for_each(|name| say!("{name}"));
        return Ok(ExitCode::SUCCESS);
    }
    let Some(name) = &args.sweep else { bail!("give a sweep file, or the folder of a sweep") };
    let (plan, folder) = plan(name, args)?;
    if args.status {
        return status(&plan, &folder, args.watch);
    }
    if args.dry_run {
        for job in &plan.jobs {
            resolved(job)?;
            say!("{}  {}  {} {}", job.folder, job.point, job.base, job.sets.join(" "));
        }
        return Ok(ExitCode::SUCCESS);
    }
    plan.settle(&folder, resolved)?;
    let _held = hold(&folder)?;
    let budget = Budget::new(args.jobs, args.cores, plan.sweep.threads, args.memory);
    let total = plan.jobs.len() as u64;
    eprintln!(
        "{total} jobs in {}: {} at a time with {} threads each, within {:.1} GB",
        folder.display(),
        budget.jobs,
        budget.threads,
        budget.memory_gb
    );
    let own = std::env::current_exe().context("the program does not know its own file")?;
    let command = |job: &Job, stage: Stage, run: &Path| process(&own, budget, &plan.config(&folder, job), stage, run);
    let interrupt = Interrupt::listening();
    let mut progress = Progress::new("sweeping", total, 0);
    let ended = run_pool(&folder, &plan, budget, command, || interrupt.raised(), |event| tell(&event, &mut progress));
    progress.finish();
    let ended = ended?;
    let results = Results::read(&folder, &plan);
    results.write(&folder)?;
    if ended == Ended::Interrupted {
        eprintln!("interrupted; go on with: riglab sweep {}", folder.display());
        return Ok(ExitCode::from(130));
    }
    show(&results);
    for outcome in results.outcomes.iter().filter(|o| !o.reason.is_empty()) {
        eprintln!("failed: {}, seed {}: {}", outcome.point, outcome.seed, outcome.reason);
    }
    say!("{}", folder.join("report.html").display());
    Ok(if results.count("finished") > 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The plan: of a folder that has one, else of a file.
fn plan(name: &str, args: &Args) -> Result<(Plan, PathBuf)> {
    let folder = PathBuf::from(name);
    if folder.is_dir() {
        if !args.sets.is_empty() || args.out.is_some() {
            bail!("{name} is a sweep's folder: its jobs are settled, --set and -o belong to a new one");
        }
        let Some(plan) = Plan::read(&folder)? else {
            bail!("{name}: no sweep here (there is no sweep.json); `riglab sweep FILE` makes one");
        };
        return Ok((plan, folder));
    }
    let config = presets::load(name, &[])?;
    config.check_keys(&["sweep"])?;
    let file: SweepFile = config.get_at("sweep")?;
    let plan = Plan::new(file, &args.sets).map_err(|e| config.invalid("sweep", e))?;
    let stem = Path::new(name).file_stem().map_or("sweep".into(), |s| s.to_string_lossy().into_owned());
    Ok((plan, args.out.clone().unwrap_or_else(|| Path::new("sweeps").join(stem))))
}

/// A job's whole config.
fn resolved(job: &Job) -> Result<String, SweepError> {
    let text = || -> Result<String> { TaskConfig::read(&presets::load(&job.base, &job.sets)?)?.settled().to_toml() };
    text().map_err(|e| SweepError::Invalid(format!("{}, seed {}: {e:#}", job.point, job.seed)))
}

/// What runs a stage of a job.
fn process(own: &Path, budget: Budget, config: &Path, stage: Stage, run: &Path) -> Command {
    let mut command = Command::new(own);
    command.arg("--threads").arg(budget.threads.to_string());
    match stage {
        Stage::Train => command.arg("train").arg(config).arg("--run").arg(run),
        Stage::Resume => command.args(["train", "--resume"]).arg(run),
        Stage::Evaluate => command.arg("eval").arg(run),
    };
    command
}

/// The right to run jobs in the folder, held until the process ends.
fn hold(folder: &Path) -> Result<std::fs::File> {
    let path = folder.join(".lock");
    let lock = std::fs::File::create(&path).with_context(|| format!("{} cannot be written", path.display()))?;
    if lock.try_lock().is_err() {
        return Err(SweepError::Held(folder.into()).into());
    }
    Ok(lock)
}

fn tell(event: &Event, progress: &mut Progress) {
    match event {
        Event::Begun(job, stage) => {
            let what = match stage {
                Stage::Train => "trains",
                Stage::Resume => "goes on",
                Stage::Evaluate => "is evaluated",
            };
            progress.line(&format!("{}, seed {}: {what}", job.point, job.seed));
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
        table.caption = format!("{}: {}", folder.display(), counts.join(", "));
        say!("{}", table.to_text());
        show(&results);
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
    fn every_built_in_sweep_has_sound_jobs() {
        let names = presets::sweeps();
        assert!(names.len() >= 3, "{names:?}");
        for name in names {
            let config = presets::load(&name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            let file: SweepFile = config.get_at("sweep").unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(file.seeds.len() >= 3 && !file.question.is_empty() && !file.expected.is_empty(), "{name}");
            let plan = Plan::new(file, &["data.corpora=['rigs.h5']".into()]).unwrap_or_else(|e| panic!("{name}: {e}"));
            // Jobs of one point differ by their seeds alone.
            let first = plan.jobs.iter().filter(|j| j.seed == plan.sweep.seeds[0]);
            let mut configs: Vec<String> =
                first.map(|j| resolved(j).unwrap_or_else(|e| panic!("{name}: {e}"))).collect();
            configs.sort();
            let count = configs.len();
            configs.dedup();
            assert_eq!(configs.len(), count, "{name}: two points are the same");
        }
    }
}
