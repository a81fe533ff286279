//! What refuses the jobs of a sweep before anything is written: settings that no run or evaluation can have, files that are not
//! found from here, evaluations without an asset, corpora that have changed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use riglab_data::{Corpus, SplitNames};
use riglab_report::shell::{command, quoted};
use riglab_sweep::{Job, Plan, is_trained};
use riglab_task::assets::{Assets, DataConfig};
use riglab_task::seen::{look_for, models};

use super::begun::Begun;
use super::{Args, settings_of, settled, unsound};
use crate::commands::eval::{fits, sets_key, with_their_weights};
use crate::commands::shown;
use crate::commands::train::{tell_untested, untested, whole};
use crate::registry::TaskConfig;

/// Corpora of jobs that are to be done which are not there.
pub(super) fn missing(plan: &Plan, folder: &Path, again: &Again, args: &Args) -> Result<BTreeSet<String>> {
    let mut missing = BTreeSet::new();
    for job in plan.left(folder, again.with_asked(args)) {
        let corpora = corpora_of(plan, (folder, &again.anew), job).map_err(|e| unsound(job, &e))?;
        missing.extend(corpora.iter().filter(|path| !path.exists()).map(|path| path.display().to_string()));
    }
    Ok(missing)
}

/// The settings that a job is or will be trained with. `anew`: jobs whose settings in the folder are no longer theirs.
fn job_settings(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<TaskConfig> {
    job_settings_with(plan, place, job, &[])
}

/// The settings that a job is evaluated with, where it is.
///
/// # Errors
/// Where no evaluation can have them.
fn evaluation_settings(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<Option<TaskConfig>> {
    if !plan.sweep.evaluate {
        return Ok(None);
    }
    let sets = plan.sweep.evaluation_sets();
    let read = || {
        let config = job_settings_with(plan, place, job, &with_their_weights(&sets))?;
        fits(&job_settings(plan, place, job)?, &config)?;
        Ok::<_, anyhow::Error>(config)
    };
    read().map(Some).context(said_by(plan))
}

/// The key of the sweep's file that says how its runs are evaluated.
fn said_by(plan: &Plan) -> &'static str {
    if plan.sweep.evaluate_with.is_empty() { "sweep.evaluate" } else { "sweep.evaluate_with" }
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

/// Whether nothing is left of a job but its evaluation.
fn is_over(place: (&Path, &[String]), job: &Job) -> bool {
    let (folder, anew) = place;
    is_trained(&folder.join(&job.folder)) && !anew.contains(&job.shown())
}

/// The settings of what is left of a job: of its training, unless that is over, and of its evaluation.
fn settings_left(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<Vec<TaskConfig>> {
    let training = (!is_over(place, job)).then(|| job_settings(plan, place, job)).transpose()?;
    Ok(training.into_iter().chain(evaluation_settings(plan, place, job)?).collect())
}

/// The corpora that a job still reads, in training and in its evaluation.
fn corpora_of(plan: &Plan, place: (&Path, &[String]), job: &Job) -> Result<BTreeSet<PathBuf>> {
    Ok(settings_left(plan, place, job)?.iter().flat_map(|config| config.data().corpora.clone()).collect())
}

/// The jobs that are begun again without being asked for, though they failed.
#[derive(Default)]
pub(super) struct Again {
    /// What has other settings now, and is trained anew.
    pub anew: Vec<String>,
    /// What failed in its evaluation, which is another now.
    reevaluated: Vec<String>,
}

impl Again {
    /// With all that failed, where it is to be tried again.
    fn with_asked(&self, args: &Args) -> impl Fn(&Job) -> bool + Copy {
        move |job| args.retry || [&self.anew, &self.reevaluated].iter().any(|jobs| jobs.contains(&job.shown()))
    }
}

/// What refuses jobs before anything is written: another sweep's folder, where the plan is of a file, files that are not
/// found from here, evaluations that could but fail, and corpora that have changed. Returns the jobs that would be begun again.
pub(super) fn check(plan: &Plan, folder: &Path, args: &Args) -> Result<Again> {
    let mut again = Again::default();
    if is_of_file(args) {
        let fit = plan.fits(folder, settled::configs(folder)?)?;
        again.anew = fit.replaced.iter().map(|(job, _)| job.shown()).collect();
        again.reevaluated = fit.reevaluated.iter().map(|job| job.shown()).collect();
        for job in &plan.jobs {
            if job_settings(plan, (folder, &again.anew), job).map_err(|e| unsound(job, &e))?.data().corpora.is_empty() {
                bail!(
                    "{}: data.corpora names no corpus; write one into `set` of the sweep's file, or give it by --set \
                     data.corpora='[\"corpus.h5\"]' (`riglab dataset import` makes it)",
                    job.shown()
                );
            }
            // Now, not after hours of training.
            evaluation_settings(plan, (folder, &again.anew), job).map_err(|e| unsound(job, &e))?;
        }
    }
    let mut sums = BTreeMap::new();
    let (place, tried) = ((folder, &*again.anew), again.with_asked(args));
    let left = plan.left(folder, tried);
    within_reach(plan, place, &left, args)?;
    measurable(plan, place, &left)?;
    plan.same_corpora(folder, tried, |job| {
        let paths = corpora_of(plan, place, job).map_err(|e| unsound(job, &e))?;
        // Of one that cannot be opened its jobs tell.
        let sum = |path: PathBuf| {
            let open = || Corpus::open(&path).ok()?.checksum().ok();
            let sum = sums.entry(path.clone()).or_insert_with(open).clone();
            Some((path.display().to_string(), sum?))
        };
        Ok(paths.into_iter().filter_map(sum).collect())
    })?;
    Ok(again)
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
        let Ok(all) = settings_left(plan, place, job) else { continue };
        let paths = all.iter().map(files_of).collect::<Result<Vec<_>>>()?.concat();
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

/// Refuses evaluations that could but fail, now and not after hours of training: on corpora that are not there, do not go
/// together, are of bare meshes where rigs are needed, or have no asset in any of the splits, and with models that are not
/// there. What a job's training is refused for, too, that tells at once.
fn measurable(plan: &Plan, place: (&Path, &[String]), left: &[&Job]) -> Result<()> {
    let splits_are_named = sets_key(&plan.sweep.evaluation_sets(), "data.test");
    // Whether there is an asset to choose a cut by.
    let mut sound: Vec<(&str, DataConfig, bool)> = Vec::new();
    for job in left {
        let refused = |e: anyhow::Error| unsound(job, &e.context(said_by(plan)));
        // Of settings that cannot be read the job tells.
        let Ok(trained) = job_settings(plan, place, job) else { continue };
        let Some(config) = evaluation_settings(plan, place, job).map_err(|e| unsound(job, &e))? else { continue };
        with_companions(&trained, &config).map_err(refused)?;
        let (task, data) = (config.task(), config.data());
        let known = sound.iter().find(|(of, own, _)| *of == task && own == data).map(|(.., chooses)| *chooses);
        let chooses = match known {
            Some(chooses) => chooses,
            None => {
                let assets = match config.assets() {
                    Ok(assets) => assets,
                    Err(e) if trained.assets().err().as_ref() == Some(&e) => continue,
                    Err(e) => return Err(refused(anyhow!(e)).into()),
                };
                tested(data, &assets, splits_are_named).map_err(refused)?;
                let chooses = !assets.split(&data.validate)?.is_empty();
                sound.push((task, data.clone(), chooses));
                chooses
            }
        };
        if !chooses && config.chooses_a_cut() && !is_over(place, job) {
            return Err(refused(anyhow!(
                "the corpora have no asset in `{}` (data.validate) by which to choose one of eval.cuts; give one, such as \
                 \"eval.cuts\" = [0.1]",
                data.validate
            ))
            .into());
        }
    }
    Ok(())
}

/// Refuses models that evaluations take in the place of the training's, where they are not there.
fn with_companions(trained: &TaskConfig, config: &TaskConfig) -> Result<()> {
    let [own, others] =
        [trained, config].map(|config| Ok::<_, anyhow::Error>(toml::Value::Table(config.to_toml()?.parse()?)));
    let (own, others) = (own?, others?);
    for (key, named) in models(&others).filter(|model| !models(&own).any(|before| before == *model)) {
        look_for(key, named).map_err(|e| anyhow!("{key}: {e}"))?;
    }
    Ok(())
}

/// Refuses splits that have no asset: all of them, and those that are `named` for evaluations and not usual, as mistyped ones.
fn tested(data: &DataConfig, assets: &Assets, named: bool) -> Result<()> {
    let mut without = untested(data, assets)?;
    if without.len() < data.test.len() {
        without.retain(|split| named && !SplitNames::KNOWN.contains(&split.as_str()));
    }
    match tell_untested(&without, assets)? {
        Some(fault) => bail!("{fault}; name splits with assets in data.test"),
        None => Ok(()),
    }
}

/// The files that a job's settings name: corpora, and models that it builds on.
fn files_of(config: &TaskConfig) -> Result<Vec<PathBuf>> {
    let settings = toml::Value::Table(config.to_toml()?.parse()?);
    let models = models(&settings).map(|(_, named)| PathBuf::from(named));
    Ok(config.data().corpora.iter().cloned().chain(models).filter(|path| !path.as_os_str().is_empty()).collect())
}
