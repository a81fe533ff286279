//! A curation as a job array over parts of the files, and a job that makes one corpus of theirs.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_curate::{CurateConfig, Places};
use riglab_slurm::state;
use riglab_train::{Interrupt, Progress};
use serde::{Deserialize, Serialize};

use super::{Desk, counted, write};

/// What the tasks of a curation do.
#[derive(Serialize, Deserialize)]
pub struct Order {
    /// The files.
    pub folder: PathBuf,
    /// How many parts.
    pub parts: usize,
}

impl Order {
    /// The one of a desk.
    pub fn read(desk: &Desk) -> Result<Self> {
        let path = desk.file("order.json");
        let text = std::fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} cannot be understood", path.display()))
    }
}

/// The corpus of a part, the first being 1. Other numbers of parts have other folders: their journals differ.
pub fn part(places: &Places, number: usize, of: usize) -> PathBuf {
    places.work.join(format!("parts-{of}/part-{number}.h5"))
}

/// How a curation is to be done.
pub struct Request {
    /// Parts of the files, each a task.
    pub parts: usize,
    /// Threads of a task; 0 takes what the cluster gives.
    pub threads: usize,
    /// Whether to wait for its end.
    pub wait: bool,
}

/// Submits a curation, and follows it to its end where that is asked for.
pub fn run(folder: &Path, out: &Path, config: &CurateConfig, desk: &Desk, request: &Request) -> Result<ExitCode> {
    let Request { parts, threads, wait } = *request;
    let absolute = |p: &Path| std::path::absolute(p).with_context(|| format!("{} has no place", p.display()));
    let (folder, out) = (absolute(folder)?, absolute(out)?);
    if !folder.is_dir() {
        bail!("{}: no such folder", folder.display());
    }
    if out.starts_with(&folder) {
        // The corpora of parts would be files of one another.
        bail!("{} lies in {}; with --on slurm it has to lie outside", out.display(), folder.display());
    }
    if let Some(queued) = desk.queue()?.first() {
        let state = queued.state.to_lowercase();
        bail!("this curation is in the queue already, as job {} ({state}); `squeue` shows it", queued.job);
    }
    write(&desk.file("config.toml"), &toml::to_string(config)?)?;
    write(&desk.file("order.json"), &serde_json::to_string(&Order { folder, parts })?)?;
    let (place, threads) = (out.to_string_lossy(), threads.to_string());
    let name = out.file_stem().map_or("curate".into(), |n| n.to_string_lossy().into_owned());
    let numbers: Vec<usize> = (1..=parts).collect();
    let order = super::Order {
        what: "curate",
        name: &name,
        numbers: &numbers,
        failures: 0,
        after: None,
        parallel: false,
        command: &["--threads", &threads, "curate", &place],
    };
    let looked: Vec<String> = desk.submit(&order)?.into_iter().map(|s| s.job).collect();
    let merge = super::Order {
        what: "merge",
        numbers: &[],
        after: Some(&looked.join(":")),
        command: &["--threads", &threads, "merge", &place],
        ..order
    };
    let [merge] = desk.submit(&merge)?.try_into().map_err(|_| anyhow::anyhow!("one job was to be submitted"))?;
    tell!(
        "job {}: {parts} parts; job {} merges them; messages in {}",
        looked.join(", "),
        merge.job,
        desk.logs().display()
    );
    if !wait {
        say!("{}", out.display());
        return Ok(ExitCode::SUCCESS);
    }
    let mut progress = Progress::new("curating", parts as u64 + 1, 0);
    let interrupt = Interrupt::listening();
    let emptied = desk.follow(&interrupt, |queue| {
        progress.set((parts as u64 + 1).saturating_sub(queue.len() as u64), || counted(queue));
    })?;
    progress.finish();
    if !emptied {
        tell!("the jobs go on; `scancel {} {}` would end them", looked.join(" "), merge.job);
        return Ok(ExitCode::from(interrupt.code()));
    }
    match state(&merge.job).as_deref() {
        Some("COMPLETED") | None if out.is_file() => {
            say!("{}", out.display());
            say!("{}", Places::of(&out).report().display());
            Ok(ExitCode::SUCCESS)
        }
        ended => bail!(
            "{} was not made: the job that merges ended as {}; messages in {}\n\nhint: the same command goes on where it \
             was",
            out.display(),
            ended.unwrap_or("unknown"),
            desk.logs().display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_other_numbers_lie_apart() {
        let places = Places::of(Path::new("/w/rigs.h5"));
        assert_eq!(part(&places, 3, 8), Path::new("/w/rigs.curation/parts-8/part-3.h5"));
        assert_ne!(part(&places, 3, 8), part(&places, 3, 9));
    }
}
