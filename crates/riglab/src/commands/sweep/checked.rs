//! What refuses the jobs of a sweep before anything is written: settings that no run or evaluation can have, files that are not
//! found from here, corpora that have changed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use riglab_data::Corpus;
use riglab_report::shell::{command, quoted};
use riglab_sweep::{Job, Plan};
use riglab_task::seen::models;

use super::begun::Begun;
use super::{Args, settings_of, settled, unsound};
use crate::commands::eval::{fits, with_their_weights};
use crate::commands::shown;
use crate::commands::train::whole;
use crate::registry::TaskConfig;

/// Corpora of jobs that are not there.
pub(super) fn missing(plan: &Plan, folder: &Path, anew: &[String]) -> Result<BTreeSet<String>> {
    let mut missing = BTreeSet::new();
    for job in &plan.jobs {
        let corpora = corpora_of(plan, (folder, anew), job).map_err(|e| unsound(job, &e))?;
        missing.extend(corpora.iter().filter(|path| !path.exists()).map(|path| path.display().to_string()));
    }
    Ok(missing)
}

/// The settings that a job is or will be trained with. `anew`: jobs whose settings in the folder are no longer theirs.
fn job_settings(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<TaskConfig> {
    job_settings_with(plan, place, job, &[])
}

/// The settings that a job is evaluated with, where they are not those of its training.
///
/// # Errors
/// Where no evaluation can have them.
fn evaluation_settings(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<Option<TaskConfig>> {
    let sets = plan.sweep.evaluation_sets();
    if sets.is_empty() {
        return Ok(None);
    }
    let read = || {
        let config = job_settings_with(plan, place, job, &with_their_weights(&sets))?;
        fits(&job_settings(plan, place, job)?, &config)?;
        Ok::<_, anyhow::Error>(config)
    };
    read().map(Some).context("sweep.evaluate_with")
}

fn job_settings_with(
    plan: &Plan,
    (folder, anew): (&Path, &[String]),
    job: &Job,
    more: &[String],
) -> Result<TaskConfig> {
    let own = plan.config(folder, job);
    match own.is_file() && !anew.contains(&job.shown()) {
        true => settings_of(&own.to_string_lossy(), more),
        false => settings_of(&job.base, &[&job.sets, more].concat()),
    }
}

/// The corpora that a job reads, in training and in its evaluation.
fn corpora_of(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<Vec<PathBuf>> {
    let mut corpora = job_settings(plan, place, job)?.data().corpora.clone();
    if let Some(config) = evaluation_settings(plan, place, job)? {
        let more = config.data().corpora.iter().filter(|path| !corpora.contains(path)).cloned();
        corpora.extend(more.collect::<Vec<_>>());
    }
    Ok(corpora)
}

/// What refuses jobs before anything is written: another sweep's folder, where the plan is of a file, files that are not
/// found from here, and corpora that have changed. Returns the jobs that would be begun anew.
pub(super) fn check(plan: &Plan, folder: &Path, args: &Args) -> Result<Vec<String>> {
    let mut anew = Vec::new();
    if is_of_file(args) {
        anew = plan.fits(folder, settled::configs(folder)?)?.replaced.iter().map(|(job, _)| job.shown()).collect();
        for job in &plan.jobs {
            if job_settings(plan, (folder, &anew), job).map_err(|e| unsound(job, &e))?.data().corpora.is_empty() {
                bail!(
                    "{}: data.corpora names no corpus; write one into `set` of the sweep's file, or give it by --set \
                     data.corpora='[\"corpus.h5\"]' (`riglab dataset import` makes it)",
                    job.shown()
                );
            }
            // Now, not after hours of training.
            evaluation_settings(plan, (folder, &anew), job).map_err(|e| unsound(job, &e))?;
        }
    }
    let mut sums = BTreeMap::new();
    // What failed and has other settings now is begun anew without being asked for.
    let again = |job: &Job| args.retry || anew.contains(&job.shown());
    within_reach(plan, (folder, &anew), &plan.left(folder, again), args)?;
    plan.same_corpora(folder, again, |job| {
        let paths = corpora_of(plan, (folder, &anew), job).map_err(|e| unsound(job, &e))?;
        // Of one that cannot be opened its jobs tell.
        let sum = |path: PathBuf| {
            let open = || Corpus::open(&path).ok()?.checksum().ok();
            let sum = sums.entry(path.clone()).or_insert_with(open).clone();
            Some((path.display().to_string(), sum?))
        };
        Ok(paths.into_iter().filter_map(sum).collect())
    })?;
    Ok(anew)
}

/// Whether the sweep is named by a file, which may say otherwise than its folder; a folder's own plan is settled.
fn is_of_file(args: &Args) -> bool {
    args.sweep.as_ref().is_some_and(|name| !Path::new(name).is_dir())
}

/// Refuses jobs whose files are named by paths that lead nowhere from this folder, though they do from the one where the
/// sweep was begun: every one of them would fail, and stand as failed.
fn within_reach(plan: &Plan, place: (&Path, &[String]), left: &[&Job], args: &Args) -> Result<()> {
    let folder = place.0;
    let begun = Begun::read(folder).or_of_runs(folder, plan);
    let here = std::env::current_dir().context("there is no working folder")?;
    let known = !begun.folder.as_os_str().is_empty();
    for job in left.iter().filter(|_| known && begun.folder != here) {
        // Of settings that cannot be read the job tells.
        let Ok(config) = job_settings(plan, place, job) else { continue };
        let mut paths = files_of(&config)?;
        if let Ok(Some(evaluation)) = evaluation_settings(plan, place, job) {
            paths.extend(files_of(&evaluation)?);
        }
        let Some(path) = begun.lost(&paths) else { continue };
        let named = args.sweep.as_deref().unwrap_or_default();
        let named = if Path::new(named).exists() { whole(Path::new(named)) } else { named.to_owned() };
        let mut again = vec!["sweep".to_owned(), named];
        if is_of_file(args) {
            again.extend(args.sets.iter().flat_map(|set| ["--set".to_owned(), set.clone()]));
            again.extend(["-o".to_owned(), whole(folder)]);
        }
        again.extend(args.on.map(|_| "--on slurm".split(' ').map(str::to_owned)).into_iter().flatten());
        again.extend(args.retry.then(|| "--retry".to_owned()));
        bail!(
            "{}: {} reads {}, which is not below this folder, {}: a sweep's relative paths start where it was \
             begun\n\nhint: cd {} && {}",
            folder.display(),
            job.shown(),
            path.display(),
            here.display(),
            quoted(&shown(&begun.folder)),
            command(again.iter().map(String::as_str))
        );
    }
    Ok(())
}

/// The files that a job's settings name: corpora, and models that it builds on.
fn files_of(config: &TaskConfig) -> Result<Vec<PathBuf>> {
    let settings = toml::Value::Table(config.to_toml()?.parse()?);
    let models = models(&settings).map(|(_, named)| PathBuf::from(named));
    Ok(config.data().corpora.iter().cloned().chain(models).filter(|path| !path.as_os_str().is_empty()).collect())
}
