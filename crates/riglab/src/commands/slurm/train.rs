//! A training as a job.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_report::shell;
use riglab_slurm::{SlurmConfig, state};
use riglab_train::{Interrupt, Progress};

use super::{Desk, Order, counted, write};

/// A training to be handed over.
pub struct Request<'a> {
    /// The run's folder.
    pub run: &'a Path,
    /// The config of a new run, as TOML; `None` for one that is to go on.
    pub config: Option<&'a str>,
    /// Threads of a process; 0 takes what the cluster gives.
    pub threads: usize,
    /// Where the job's network computes; what the job's surroundings say where that is not told.
    pub device: Option<&'a str>,
    /// Whether to wait for its end.
    pub wait: bool,
}

/// A training that is in the queue.
pub struct Submitted {
    job: String,
    log: PathBuf,
}

/// Submits a training.
///
/// # Errors
/// When it is in the queue already, or the cluster refuses it: nothing goes on then.
pub fn submit(request: &Request, desk: &Desk) -> Result<Submitted> {
    let Request { run, config, threads, device, .. } = *request;
    let shown = run.display();
    if let Some(queued) = desk.queue()?.first() {
        bail!("{shown} is in the queue already, as job {} ({})", queued.job, queued.state.to_lowercase());
    }
    match config {
        Some(_) if run.join("config.toml").exists() => {
            let again = shell::command(["train", "--resume", &run.to_string_lossy(), "--on", "slurm"]);
            bail!("{shown} holds a run already; go on with it by `{again}`")
        }
        Some(text) => write(&desk.file("config.toml"), text)?,
        None if !run.join("config.toml").is_file() && !desk.file("config.toml").is_file() => {
            bail!("{shown}: no run here (there is no config.toml)")
        }
        None => {}
    }
    let place = std::path::absolute(run).with_context(|| format!("{shown} has no place"))?;
    let (place, threads) = (place.to_string_lossy(), threads.to_string());
    let name: Vec<_> = run.components().rev().take(2).map(|c| c.as_os_str().to_string_lossy()).collect();
    let mut command = vec!["--threads", &threads, "train", &place];
    command.extend(device.iter().flat_map(|device| ["--device", device]));
    let order = Order {
        what: "train",
        name: &name.into_iter().rev().collect::<Vec<_>>().join("/"),
        numbers: &[],
        failures: 0,
        after: None,
        parallel: true,
        command: &command,
    };
    let [submission] = desk.submit(&order)?.try_into().map_err(|_| anyhow::anyhow!("one job was to be submitted"))?;
    let log = desk.logs().join(format!("{}.log", submission.job));
    tell!("job {}: messages in {}; `squeue -j {0}` shows it", submission.job, log.display());
    say!("{shown}");
    Ok(Submitted { job: submission.job, log })
}

/// With `wait` follows it to its end.
///
/// # Errors
/// When it does not end as a finished run.
pub fn follow(request: &Request, desk: &Desk, submitted: &Submitted) -> Result<ExitCode> {
    let (run, shown, Submitted { job, log }) = (request.run, request.run.display(), submitted);
    if !request.wait {
        return Ok(ExitCode::SUCCESS);
    }
    let mut progress = Progress::new("training", 1, 0);
    let interrupt = Interrupt::listening();
    let emptied = desk.follow(&interrupt, |queue| progress.set(0, || counted(queue)))?;
    let text = std::fs::read_to_string(run.join("run.json")).unwrap_or_default();
    let info: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let finished = info["outcome"] == "finished";
    progress.set(u64::from(emptied && finished), String::new);
    progress.finish();
    if !emptied {
        tell!("the job goes on; `scancel {job}` would end it");
        return Ok(ExitCode::from(interrupt.code()));
    }
    if finished {
        tell!("next: {}", shell::command(["eval", &run.to_string_lossy()]));
        return Ok(ExitCode::SUCCESS);
    }
    let ended = state(job).unwrap_or_else(|| "ended".into());
    bail!("{shown} is not finished: job {job} {ended}; its messages are in {}", log.display())
}

/// The desk of a run: with the settings of a config, or those that the run was begun with.
pub fn desk(run: &Path, config: Option<SlurmConfig>, sets: &[String]) -> Result<Desk> {
    match config {
        Some(config) => Desk::new(run, config),
        None => Desk::reopen(run, sets),
    }
}
