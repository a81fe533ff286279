//! `riglab train`

mod dry_run;
mod guard;
mod reach;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use riglab_data::SplitNames;
use riglab_ranks::{Ranks, processors};
use riglab_slurm::SlurmConfig;
use riglab_task::Experiment;
use riglab_task::assets::{Assets, DataConfig};
use riglab_task::seen::{built_on, seen, warning};
use riglab_task::start::{LoadedPart, take, taken};
use riglab_train::{
    Checkpoint, Ended, Interrupt, Run, RunInfo, ScheduleKind, StartConfig, TrainConfig, same_companions, sides, train,
};
use tch::Device;

use super::device::{self, DeviceArgs};
use super::longer::{self, Longer};
use super::slurm::{On, apart, settings, train as on_slurm};
use super::{keep_apart, short, shown};
use crate::offered::open_weights;
use crate::presets;
use crate::registry::{TaskConfig, Visitor};
use dry_run::DryRun;
use guard::Guard;
use reach::{again, may_go_on};
pub use reach::{reached, whole};
use riglab_report::shell::command;
use riglab_report::{counted, explained};

/// Train a model from a config, or continue a run.
///
/// Makes a run folder with the resolved config, metrics and checkpoints. Ctrl-C saves and leaves; --resume goes on as if
/// nothing had happened, and with --set train.steps=N trains longer (a start model or an auto-encoder that was moved is named
/// anew by --set start.model=PATH or skin.run=PATH). With --on slurm the training is a job of a cluster,
/// requeued whenever its time limit ends it.
///
/// Started as several processes by mpirun or srun, it shares the batches of each step (train.accumulate of them, a
/// multiple of the number of processes) among them: with a thread each, the run is the same on one, two, four
/// or eight; it can be resumed on another number.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab train quickstart/fsq_cvae.toml --set data.corpora='[\"corpus.h5\"]'
  riglab train my.toml --set train.seed=2 --run runs/mine/seed-2
  riglab train --resume runs/mine/seed-2
  riglab train --resume runs/mine/seed-2 --set train.steps=8000   # to more steps than at first
  riglab train my.toml --set train.start.from=runs/tokenrig/001
  riglab train unirig/skin_paper.toml --set data.corpora='[\"corpus.h5\"]' \\
      --set train.start.from=sampart3d.pth --set train.start.parts='[\"mesh_encoder\"]'
  riglab train my.toml --dry-run
  riglab train my.toml --on slurm --set slurm.time=12:00:00 --set slurm.memory=32G
  mpirun -n 2 riglab train my.toml --set train.accumulate=2   # built with --features mpi")]
pub struct Args {
    /// Config file, or the name of a built-in experiment.
    #[arg(required_unless_present_any = ["resume", "list"])]
    config: Option<String>,
    /// Change a value of the config, as often as needed.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// The run's folder [default: the next free number below runs/<config>/].
    #[arg(long, value_name = "DIR", value_parser = super::place_to_write())]
    run: Option<PathBuf>,
    /// Continue the run in this folder with its own settings; only train.steps may be raised (--set train.steps=N), and
    /// --set start.model=PATH or skin.run=PATH names the new place of a model that was moved.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "run"])]
    resume: Option<PathBuf>,
    /// Write nothing: go through a few steps and one or two validations, and say what the run would take: parameters, memory,
    /// operations and time.
    #[arg(long, conflicts_with_all = ["resume", "run"])]
    dry_run: bool,
    /// With --dry-run: print the estimate as a line of JSON.
    #[arg(long, requires = "dry_run", conflicts_with_all = ["resume", "run"])]
    json: bool,
    /// Hand the training to a cluster instead of doing it here.
    #[arg(long, value_name = "WHERE", conflicts_with = "dry_run")]
    on: Option<On>,
    /// With --on: follow the job to its end.
    #[arg(long, requires = "on")]
    wait: bool,
    /// Evaluations name the splits that are tested on: those of data.test need not be there.
    #[arg(long, hide = true)]
    tested_otherwise: bool,
    /// List the built-in experiments.
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    if args.list {
        presets::listed(&presets::experiments()).iter().for_each(|line| say!("{line}"));
        return Ok(ExitCode::SUCCESS);
    }
    let (cluster, sets) = apart(&args.sets);
    args.run.as_deref().map_or(Ok(()), keep_apart)?;
    if let Some(dir) = &args.resume {
        longer::only(dir, &sets)?;
    }
    if let (None, Some(set)) = (args.on, cluster.first()) {
        bail!("`--set {set}` is about a cluster; add --on slurm");
    }
    if args.on == Some(On::Slurm) {
        return hand_over(args, &cluster, &sets, threads);
    }
    let ranks = riglab_ranks::world()?;
    let done = together(args, threads, &ranks);
    if let Err(e) = &done {
        // The others would wait for ever.
        ranks.end(&format!("{e:#}"));
    }
    done
}

/// What one of the processes does that train together.
fn together(args: &Args, threads: usize, ranks: &Ranks) -> Result<ExitCode> {
    let threads = if threads == 0 { threads_of(args.resume.as_deref(), ranks)? } else { threads };
    let threads = riglab_torch::init(riglab_torch::Settings { threads });
    let device = device_of(args, ranks)?;
    let (mut longer, mut slurm) = (None, SlurmConfig::default());
    let (config, place) = match (&args.resume, &args.config) {
        (Some(dir), _) => {
            let run = if ranks.leads() { Run::open(dir)? } else { Run::follow(dir) };
            // What the first rank reads counts: folders may be late on other machines.
            let text = std::fs::read_to_string(run.path("config.toml"));
            let mut text = if ranks.leads() { text.context("cannot read config.toml")? } else { String::new() };
            if ranks.leads()
                && let Some(more) = Longer::of(&run, &args.sets)?
            {
                text = more.config.clone();
                longer = Some(more);
            }
            let text = ranks.told(text)?;
            let config = settled(&text, &run.path("config.toml"))?;
            if ranks.leads() {
                may_go_on(dir, &config, || again(dir, &args.sets))?;
            }
            (config, Place::There(run))
        }
        (None, Some(name)) if args.dry_run => {
            if ranks.size() > 1 {
                bail!("--dry-run tries one process; start it without mpirun");
            }
            let config = named(name, &args.sets)?;
            return config.with(device, DryRun { config: &config, threads, device, json: args.json });
        }
        (None, Some(name)) => {
            // Settled once: what is chosen by the processor must be the same for all.
            let mut own = String::new();
            if ranks.leads() {
                own = named(name, &args.sets)?.to_toml()?;
                slurm = settings(&presets::load(name, &args.sets)?)?;
            }
            let text = ranks.told(own)?;
            let place = args.run.clone().map_or_else(|| Place::Next(runs_of(name)), Place::New);
            (settled(&text, Path::new(name))?, place)
        }
        (None, None) => bail!("give a config, or --resume RUN"),
    };
    if let Err((_, message)) = config.train().shared_by(ranks) {
        bail!("train.{message}");
    }
    // What other weights begin with is asked for once.
    let saved = match &place {
        Place::There(run) if ranks.leads() => Checkpoint::latest(run, config.train())?.map(|c| c.state().step),
        _ => None,
    };
    let saved = ranks.told(saved)?;
    let tests = !args.tested_otherwise;
    config.with(device, Session { config: &config, place, slurm, tests, longer, saved, threads, device, ranks })
}

/// The threads of each process without a word about them: those that a run was begun with, on as many processes, or what the
/// machine gives them; 0 for all of it.
fn threads_of(resumed: Option<&Path>, ranks: &Ranks) -> Result<usize> {
    let alone = ranks.size() == 1;
    let all = if alone { std::thread::available_parallelism().map_or(1, usize::from) } else { processors(ranks)? };
    let begun = resumed.filter(|_| ranks.leads()).map_or(0, |run| as_begun(run, ranks.size(), all));
    Ok(match ranks.told(begun)? {
        0 if !alone => all,
        begun => begun,
    })
}

/// The threads that a run was begun with on so many processes, where there are as many; otherwise 0. Sums round by their
/// number, and the run is to be what it would have been.
fn as_begun(run: &Path, processes: usize, all: usize) -> usize {
    let info = RunInfo::of(run).filter(|info| info.ranks.max(1) == processes);
    let begun = info.map_or(0, |info| info.threads);
    if begun > 0 && begun < all {
        let (those, more) = (counted(begun, "thread"), counted(all, "thread"));
        tell!(
            "note: it goes on with {those}, as it was begun; --threads {all} takes {more}, with sums that round differently"
        );
    }
    if begun <= all { begun } else { 0 }
}

/// The device that is asked for; of a run that goes on without a word about it the one that it was begun on, where there is
/// one.
fn device_of(args: &Args, ranks: &Ranks) -> Result<Device> {
    let info = args.resume.as_deref().filter(|_| args.device.asked().is_none() && ranks.size() == 1);
    let Some(begun) = info.and_then(RunInfo::of).map(|info| info.device) else { return args.device.of_ranks(ranks) };
    match riglab_torch::device(&begun) {
        Ok(Device::Cpu) => Ok(Device::Cpu),
        Ok(device) => {
            tell!("note: it goes on on {begun}, as it was begun; --device cpu takes the processors");
            Ok(device)
        }
        Err(e) => {
            tell!("note: it was begun on {begun}, which is not to be had here ({e})");
            args.device.of_ranks(ranks)
        }
    }
}

/// Has the parts of a network stay that `train.frozen` names, if it does, before anything is written of the run; what to
/// say of it.
fn freeze<T: Experiment>(task: &T, train: &TrainConfig) -> Result<Vec<String>> {
    let numbers = task.params().freeze(&train.frozen).map_err(|e| anyhow!("train.frozen: {e}"))?;
    let said = || format!("{:.2} M parameters are frozen (train.frozen)", numbers as f64 / 1e6);
    Ok((numbers > 0).then(said).into_iter().collect())
}

/// What to say where the learning rate never comes to its peak.
fn unwarmed(train: &TrainConfig) -> Option<String> {
    let (warmup, steps) = (train.schedule.warmup, train.steps);
    (train.schedule.kind != ScheduleKind::OneCycle && warmup > steps).then(|| {
        format!(
            "train.schedule.warmup = {warmup} is more than train.steps = {steps}: the learning rate ends below its peak"
        )
    })
}

/// Refuses corpora that a task cannot be trained on, and, where it `begins`, what no training should begin with.
fn trainable<T: Experiment>(task: &T, config: &TaskConfig, begins: bool) -> Result<()> {
    task.unfit().filter(|_| begins).map_or(Ok(()), |why| Err(anyhow!(why)))?;
    task.assets().trainable(config.data()).map_err(|e| anyhow!(e))?;
    task.untrainable().map_or(Ok(()), |why| Err(anyhow!(why)))
}

/// What to say of assets that are both trained on and looked at, in one corpus or in two.
fn overlap(config: &TaskConfig) -> Result<Vec<String>> {
    let data = config.data();
    let splits: Vec<String> = std::iter::once(&data.validate).chain(&data.test).cloned().collect();
    let own = warning(&seen(data, &splits, &config.training()).map_err(|e| anyhow!(e))?, None);
    // Corpora of earlier trainings may be gone, or moved.
    let before = built_on(&config.to_toml()?).into_iter();
    let before = before.filter_map(|(key, trained)| warning(&seen(data, &splits, &trained).ok()?, Some(key)));
    Ok(own.into_iter().chain(before).collect())
}

/// Gives a network the weights that `train.start` names, if it does; what to say of it.
fn begin<T: Experiment>(task: &T, start: &StartConfig) -> Result<Vec<String>> {
    if start.is_none() {
        return Ok(Vec::new());
    }
    let (shown, params) = (start.from.display(), task.params());
    let mut offered = open_weights(&start.from).context("train.start.from")?;
    let taken = take(params, &start.parts, &mut offered).map_err(|e| anyhow!("train.start: {shown}: {e}"))?;
    let line = |t: &LoadedPart| {
        let what = if t.part.is_empty() { "the network".into() } else { format!("`{}`", t.part) };
        let below = if t.prefix.is_empty() { String::new() } else { format!(" below `{}`", t.prefix) };
        let left = match t.left_over.as_slice() {
            [] => String::new(),
            [only] => format!("; a tensor of that file is not used (`{only}`)"),
            [first, ..] => format!("; {} tensors of that file are not used (`{first}`, ...)", t.left_over.len()),
        };
        format!(
            "{what} begins with {}, {:.2} M numbers, of {shown}{below}{left}",
            counted(t.count.0, "tensor"),
            t.count.1 as f64 / 1e6
        )
    };
    Ok(taken.iter().map(line).collect())
}

/// The config of a file or preset, for this machine.
fn named(name: &str, sets: &[String]) -> Result<TaskConfig> {
    Ok(unsettled(name, sets)?.settled())
}

/// The config of a file or preset, for whichever machine trains.
fn unsettled(name: &str, sets: &[String]) -> Result<TaskConfig> {
    if Path::new(name).join("config.toml").is_file() {
        let again = command(["train", "--resume", name]);
        bail!("{name} is a run: go on with `{again}`, or begin another of its {name}/config.toml");
    }
    let config = presets::load(name, sets)?;
    if !config.contains("task") && config.contains("sweep") {
        bail!("{name} is a sweep of several runs: `{}` trains them", command(["sweep", name]));
    }
    Ok(beside(TaskConfig::read(&config)?, Path::new(name)))
}

/// The config that a run's `config.toml` holds, or will hold.
fn settled(text: &str, path: &Path) -> Result<TaskConfig> {
    Ok(beside(TaskConfig::read(&presets::parse(&path.display().to_string(), text, &[])?)?, path))
}

/// With what lies beside its file, where that is the config of a run.
fn beside(config: TaskConfig, file: &Path) -> TaskConfig {
    match file.parent() {
        Some(run) => config.of_run(run),
        None => config,
    }
}

/// Submits a training.
fn hand_over(args: &Args, cluster: &[String], sets: &[String], threads: usize) -> Result<ExitCode> {
    let mut former = None;
    let (run, desk, config) = match (&args.resume, &args.config) {
        (Some(dir), _) => {
            let path = dir.join("config.toml");
            if path.is_file() {
                // Before it is in the queue, where it could but fail.
                let config = TaskConfig::read(&presets::load(&shown(&path), sets)?)?;
                may_go_on(dir, &config, || [again(dir, &args.sets), vec!["--on".into(), "slurm".into()]].concat())?;
            }
            let desk = on_slurm::desk(dir, None, cluster)?;
            if cluster.is_empty() {
                let note = desk.without_settings("--set slurm.KEY=VALUE gives others");
                note.iter().for_each(|note| tell!("note: {}: {note}", dir.display()));
            }
            // One that is in the queue is refused below.
            if !sets.is_empty() && desk.queue()?.is_empty() {
                let run = Run::open(dir)?;
                former = Longer::of(&run, sets)?.map(|longer| longer.hand_over(&run)).transpose()?;
            }
            (dir.clone(), desk, None)
        }
        (None, Some(name)) => {
            let text = unsettled(name, &args.sets)?.to_toml()?;
            let config = presets::load(name, &args.sets)?;
            let dir = args.run.clone().map_or_else(|| claim(&runs_of(name)), Ok)?;
            let desk = on_slurm::desk(&dir, Some(settings(&config)?), &[])?;
            (dir, desk, Some(text))
        }
        (None, None) => bail!("give a config, or --resume RUN"),
    };
    let desk = desk.for_threads(threads)?;
    let request = on_slurm::Request {
        run: &run,
        config: config.as_deref(),
        threads,
        device: args.device.asked(),
        wait: args.wait,
    };
    let submitted = match (on_slurm::submit(&request, &desk), former) {
        (Ok(submitted), _) => submitted,
        (Err(e), former) => {
            if args.run.is_none() && args.resume.is_none() {
                // It is empty where nothing was written for the cluster yet.
                let _ = std::fs::remove_dir(&run);
            }
            // What does not go on is not extended.
            former.map_or(Ok(()), longer::Former::put_back)?;
            return Err(e);
        }
    };
    on_slurm::follow(&request, &desk, &submitted)
}

/// A run's folder, which is made when the task has been opened: a corpus that is missing leaves none behind.
enum Place {
    There(Run),
    New(PathBuf),
    /// The next free number in a folder of runs.
    Next(PathBuf),
}

/// A run to be made or continued.
struct Session<'a> {
    config: &'a TaskConfig,
    place: Place,
    /// What the config of a new run asks of a cluster, on the rank that writes.
    slurm: SlurmConfig,
    /// Whether evaluations test on what the config names.
    tests: bool,
    /// More steps than the run was to have before, on the rank that writes.
    longer: Option<Longer>,
    /// The last step that was saved.
    saved: Option<u64>,
    threads: usize,
    device: Device,
    ranks: &'a Ranks,
}

impl Visitor for Session<'_> {
    type Out = ExitCode;

    fn visit<T: Experiment>(self, task: T) -> Result<ExitCode> {
        let Self { config, place, slurm, tests, longer, saved, threads, device, ranks } = self;
        trainable(&task, config, !matches!(place, Place::There(_)))?;
        let mut begun = if saved.is_none() { begin(&task, &config.train().start)? } else { Vec::new() };
        let from = &config.train().start;
        let start = (saved.is_none() && !from.is_none()).then(|| taken(task.params(), &from.parts));
        begun.extend(freeze(&task, config.train())?);
        if !ranks.leads() {
            let run = match place {
                Place::There(run) => run,
                Place::New(dir) => Run::follow(&dir),
                // The first rank says which it is.
                Place::Next(_) => Run::follow(&ranks.told(PathBuf::new())?),
            };
            let interrupt = Interrupt::listening_with(ranks);
            let outcome = train(&task, config.train(), &run, &interrupt, ranks)?;
            let interrupted = outcome.ended == Ended::Interrupted;
            return Ok(if interrupted { ExitCode::from(interrupt.code()) } else { ExitCode::SUCCESS });
        }
        if tests && !matches!(place, Place::There(_)) {
            known_tests(config.data(), task.assets())?;
        }
        let (run, resumed) = match place {
            Place::There(run) => (run, true),
            Place::New(dir) => (Run::create(&dir, &config.to_toml()?)?, false),
            Place::Next(runs) => {
                let run = Run::create(&claim(&runs)?, &config.to_toml()?)?;
                ranks.told(run.dir().to_owned())?;
                (run, false)
            }
        };
        if !resumed {
            // A later call may hand it to a cluster.
            on_slurm::desk(run.dir(), Some(slurm), &[])?.keep_for_later()?;
        }
        let data = task.assets().summary()?;
        let mut now = RunInfo::new(crate::VERSION, task.name(), threads, &device::name(device));
        (now.ranks, now.steps) = (ranks.size(), config.train().steps);
        // One that has done all its steps computes nothing.
        let goes_on = saved.is_none_or(|done| done < now.steps);
        let before = if resumed { run.info()? } else { None };
        if let Some(before) = &before {
            // Steps and figures would be of others then.
            if let Some(other) = other_data(&before.data, &data) {
                let dir = run.dir().display();
                bail!(
                    "{dir}: {other}; put the former corpora back, or begin a run anew with --set train.start.from=RUN"
                );
            }
            same_companions(&before.companions, &task.companions())
                .map_err(|e| anyhow!(e))
                .with_context(|| run.dir().display().to_string())?;
            if goes_on && !before.rounds_as(now.threads, now.ranks, &now.device) {
                let on = |info: &RunInfo| match (before.device == now.device, info.device.as_str()) {
                    (false, "cpu") => format!("{} on cpu", info.place()),
                    _ => info.place(),
                };
                tell!(
                    "note: begun with {}, and it goes on with {}: sums round otherwise, so results will differ from those of an \
                     uninterrupted run",
                    on(before),
                    on(&now)
                );
            }
        }
        if let Some(longer) = &longer {
            longer.write(&run)?;
        }
        // Again, with what was noted of it only now.
        let noted = if resumed { run.info()? } else { None };
        let mut info = match noted {
            Some(mut info) => {
                if goes_on {
                    let saved = saved.unwrap_or(0);
                    info.go_on(saved, now);
                    begun.extend(longer::note(&task, config.train(), saved, &mut info));
                }
                info
            }
            None => now,
        };
        info.data = data;
        info.companions = task.companions();
        if let Some(start) = start {
            info.start = start;
        }
        info.parameters = task.params().numel();
        run.write_info(&info)?;
        let steps = config.train().steps;
        if !goes_on {
            let longer = ["train", "--resume", &shown(run.dir()), "--set", &format!("train.steps={}", 2 * steps)];
            tell!("note: all its {} are done; `{}` trains longer", counted(steps as usize, "step"), command(longer));
        }
        tell!(
            "{}: {:.2} M parameters, {}, {}{}{}, in {}",
            task.name(),
            info.parameters as f64 / 1e6,
            counted(steps as usize, "step"),
            if ranks.size() > 1 { format!("{} ranks of ", ranks.size()) } else { String::new() },
            counted(threads, "thread"),
            match sides(&task, config.train(), ranks) {
                1 => String::new(),
                n => format!(", {n} batches side by side"),
            },
            run.dir().display()
        );
        if tests {
            begun.extend(tell_untested(&untested(config.data(), task.assets())?, task.assets())?);
        }
        begun.extend(unwarmed(config.train()));
        task.warnings().iter().for_each(|warning| tell!("warning: {warning}"));
        begun.iter().chain(&task.notes()).chain(&overlap(config)?).for_each(|note| tell!("note: {note}"));
        let interrupt = Interrupt::listening_with(ranks);
        let guard = Guard::of_first_step(&run);
        let start = Instant::now();
        let outcome = train(&task, config.train(), &run, &interrupt, ranks);
        drop(guard);
        // Of one that is over, nothing has happened.
        if goes_on || !info.is_over() {
            if goes_on {
                info.seconds += start.elapsed().as_secs_f64();
            }
            info.ended = RunInfo::now();
            info.outcome = match &outcome {
                Ok(o) if o.ended == Ended::Finished => "finished".into(),
                Ok(_) => "interrupted".into(),
                Err(e) => e.to_string(),
            };
            run.write_info(&info)?;
        }
        let outcome = outcome.with_context(|| format!("in {}", run.dir().display()))?;
        if outcome.skipped > 0 {
            let were = if outcome.skipped == 1 { "was" } else { "were" };
            tell!(
                "warning: {} of {} {were} skipped because loss or gradient was not finite",
                outcome.skipped,
                counted(outcome.step as usize, "step")
            );
        }
        if outcome.ended == Ended::Interrupted {
            let again = command(["train", "--resume", &shown(run.dir())]);
            tell!("interrupted after step {}; go on with: {again}", outcome.step);
            return Ok(ExitCode::from(interrupt.code()));
        }
        if let Some((step, value)) = outcome.best {
            let name = task.objective().0;
            let said = explained(task.name(), name).map_or(String::new(), |said| format!(" ({said})"));
            tell!("best: {} at step {step}{said}", task.told(value));
        }
        // Without one that was better than its start, there is none to take by itself.
        let which = if outcome.best.is_none() { " --checkpoint last" } else { "" };
        tell!("next: {}{which}", command(["eval", &shown(run.dir())]));
        say!("{}", run.dir().display());
        Ok(ExitCode::SUCCESS)
    }
}

/// The splits to be tested on that have no asset: mistyped, or not there.
pub fn untested(data: &DataConfig, assets: &Assets) -> Result<Vec<String>> {
    let mut without = Vec::new();
    for split in &data.test {
        if assets.split(split)?.is_empty() {
            without.push(split.clone());
        }
    }
    Ok(without)
}

/// Refuses a split to be tested on that no corpus has and no splitting makes: mistyped, which would be told after the
/// training alone. One that is usual may be missing: there are few assets.
fn known_tests(data: &DataConfig, assets: &Assets) -> Result<()> {
    let usual = [SplitNames::TRAIN, SplitNames::VAL, SplitNames::TEST_SEEN, SplitNames::TEST_NEW, SplitNames::MESHES];
    let without = untested(data, assets)?;
    let without: Vec<String> = without.into_iter().filter(|split| !usual.contains(&split.as_str())).collect();
    match tell_untested(&without, assets)? {
        Some(fault) => bail!("{fault}, and --set data.test='[\"SPLIT\"]' names another"),
        None => Ok(()),
    }
}

/// What to say of them.
pub fn tell_untested(splits: &[String], assets: &Assets) -> Result<Option<String>> {
    if splits.is_empty() {
        return Ok(None);
    }
    let named: Vec<String> = splits.iter().map(|split| format!("`{split}`")).collect();
    Ok(Some(format!("data.test: the corpora have no asset in {}; {}", named.join(" nor in "), assets.splits()?)))
}

/// What to say of corpora that are not those a run was begun on; nothing of the same, or where it does not say.
pub fn other_data(before: &[(String, String, usize)], now: &[(String, String, usize)]) -> Option<String> {
    let sums = |of: &[(String, String, usize)]| of.iter().map(|(_, sum, _)| sum.clone()).collect::<Vec<_>>();
    // Older runs may not say what they saw.
    if before.is_empty() || sums(before) == sums(now) {
        return None;
    }
    let list = |of: &[(String, String, usize)]| {
        of.iter().map(|(path, sum, _)| format!("{path} ({})", short(sum))).collect::<Vec<_>>().join(", ")
    };
    Some(format!("begun on {}, but now there is {}", list(before), list(now)))
}

/// `runs/<config>`, where runs of a config are numbered. The config of a run in `runs/NAME/001` is one of NAME.
fn runs_of(config: &str) -> PathBuf {
    let file = Path::new(config);
    let of_run = file.parent().filter(|run| file.ends_with("config.toml") && run.join("run.json").is_file());
    let above = of_run.and_then(|run| run.parent()?.file_name());
    let name = above.or(file.file_stem()).map_or("run".into(), |s| s.to_string_lossy().into_owned());
    Path::new("runs").join(name)
}

/// Makes the folder of the next free number, `001` and on: of two runs that begin at once each has its own.
fn claim(runs: &Path) -> Result<PathBuf> {
    std::fs::create_dir_all(runs).with_context(|| format!("{} cannot be made", runs.display()))?;
    for dir in (1..).map(|n| runs.join(format!("{n:03}"))) {
        match std::fs::create_dir(&dir) {
            Ok(()) => return Ok(dir),
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e).with_context(|| format!("{} cannot be made", dir.display())),
        }
    }
    bail!("{}: no number is free", runs.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_called_as_its_config_or_as_the_one_that_it_repeats() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("dice/007");
        std::fs::create_dir_all(&run).unwrap();
        let config = run.join("config.toml");
        let of = |config: &Path| runs_of(config.to_str().unwrap());
        assert_eq!(of(&config), Path::new("runs/config"));
        std::fs::write(run.join("run.json"), "").unwrap();
        assert_eq!(of(&config), Path::new("runs/dice"));
        assert_eq!(of(Path::new("quickstart/tokenrig.toml")), Path::new("runs/tokenrig"));
    }

    #[test]
    fn runs_that_begin_at_once_have_folders_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let runs = dir.path().join("runs/demo");
        std::fs::create_dir_all(runs.join("002")).unwrap();
        let claimed = std::thread::scope(|s| {
            let all: Vec<_> = (0..4).map(|_| s.spawn(|| claim(&runs).unwrap())).collect();
            all.into_iter().map(|t| t.join().unwrap()).collect::<std::collections::BTreeSet<_>>()
        });
        assert_eq!(claimed, ["001", "003", "004", "005"].map(|n| runs.join(n)).into());
        std::fs::write(dir.path().join("file"), "").unwrap();
        assert!(claim(&dir.path().join("file")).unwrap_err().to_string().contains("file cannot be made"));
    }

    #[test]
    fn a_run_goes_on_with_the_threads_that_it_was_begun_with() {
        let dir = tempfile::tempdir().unwrap();
        let of = |processes, all| as_begun(dir.path(), processes, all);
        assert_eq!(of(1, 4), 0, "it does not say");
        for (ranks, processes) in [(0, 1), (1, 1), (2, 2)] {
            let info = RunInfo { threads: 2, ranks, ..RunInfo::default() };
            std::fs::write(dir.path().join("run.json"), serde_json::to_string(&info).unwrap()).unwrap();
            assert_eq!([of(processes, 4), of(processes, 2), of(processes, 1), of(processes + 1, 4)], [2, 2, 0, 0]);
        }
    }

    #[test]
    fn a_run_goes_on_with_its_own_corpora_alone() {
        let of = |sum: &str| vec![("c.h5".to_owned(), sum.to_owned(), 3)];
        assert_eq!(other_data(&of("0123456789abcdef"), &of("0123456789abcdef")), None);
        assert_eq!(other_data(&[], &of("0123456789abcdef")), None, "not said");
        // The same elsewhere.
        let moved = vec![("d.h5".to_owned(), "0123456789abcdef".to_owned(), 3)];
        assert_eq!(other_data(&of("0123456789abcdef"), &moved), None);
        let said = other_data(&of("0123456789abcdef"), &of("fedcba9876543210")).unwrap();
        assert_eq!(said, "begun on c.h5 (0123456789ab), but now there is c.h5 (fedcba987654)");
    }
}
