//! `riglab train --resume RUN --set KEY=VALUE`: a run that gets more steps than it was begun with, or whose start model or
//! auto-encoder lies elsewhere now.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use riglab_report::counted;
use riglab_task::assets::Assets;
use riglab_task::settings::MODELS;
use riglab_train::{Run, RunInfo, Task, TrainConfig, factor, first_apart};

use super::shown;
use super::train::other_data;
use crate::presets;
use crate::registry::TaskConfig;

/// The one setting of a run that may be another, and only grow: what was learned so far is still of it.
const STEPS: &str = "train.steps";

/// A run's settings with more steps, or with other places of what it builds on.
pub struct Longer {
    /// Steps that it was to have.
    from: u64,
    /// Its `config.toml` with more of them.
    pub config: String,
}

/// Refuses changes of what stands in a run.
pub fn only(run: &Path, sets: &[String]) -> Result<()> {
    let other = |set: &&String| key(set).is_none_or(|key| key != STEPS && !MODELS.contains(&key));
    match sets.iter().find(other) {
        Some(set) => bail!(
            "{}: a run keeps its settings: only {STEPS} may be raised, and {} name a model that was moved; `--set {set}` \
             belongs to a new one",
            run.display(),
            MODELS.join(" and ")
        ),
        None => Ok(()),
    }
}

fn key(set: &str) -> Option<&str> {
    set.split_once('=').map(|(key, _)| key.trim())
}

/// Refuses another place of a model whose weights are not known: nothing would tell whether it is the same.
fn known(run: &Run, sets: &[String]) -> Result<()> {
    let companions = run.info()?.map_or_else(Vec::new, |info| info.companions);
    let unknown = |moved: &&str| companions.iter().all(|(known, _)| known != moved);
    match sets.iter().filter_map(|set| key(set)).filter(|key| MODELS.contains(key)).find(unknown) {
        Some(moved) => bail!(
            "{}: its run.json has no checksum of {moved}, so that another place of it cannot be told from another model: \
             put the model back where it was",
            run.dir().display()
        ),
        None => Ok(()),
    }
}

impl Longer {
    /// Of changes that [`only`] passed; nothing where they are none, as when the same command is given again to go on.
    ///
    /// # Errors
    /// When there would be fewer steps, or the run is one of a sweep.
    pub fn of(run: &Run, sets: &[String]) -> Result<Option<Self>> {
        if sets.is_empty() {
            return Ok(None);
        }
        let (dir, path) = (shown(run.dir()), run.path("config.toml"));
        let text = std::fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        let read = |sets: &[String]| TaskConfig::read(&presets::parse(&shown(&path), &text, sets)?);
        let (config, from) = (read(sets)?, read(&[])?.train().steps);
        let to = config.train().steps;
        let whole = config.to_toml()?;
        if to == from {
            // Given again, it changes nothing. That a model is the same is seen later, by its checksum.
            let moved = whole != read(&[])?.to_toml()?;
            return if moved { known(run, sets).map(|()| Some(Self { from, config: whole })) } else { Ok(None) };
        }
        known(run, sets)?;
        if to < from {
            bail!(
                "{dir} is set to {}; {STEPS} can only be raised, and {to} is fewer. Ctrl-C stops a run where it is",
                counted(from as usize, "step")
            );
        }
        // Its table is of runs that have the same settings but for what their arms change.
        let place = std::path::absolute(run.dir()).unwrap_or_default();
        if let Some(sweep) = place.ancestors().nth(3).filter(|sweep| sweep.join("sweep.json").is_file()) {
            bail!(
                "{dir} is a run of the sweep {}, whose runs are compared as they are: begin another sweep with --set \
                 {STEPS}={to}, or copy the run's folder and extend the copy",
                sweep.display()
            );
        }
        Ok(Some(Self { from, config: whole }))
    }

    /// Writes the settings for a job, which finds a run that is not finished; gives what stood there.
    ///
    /// # Errors
    /// When the corpora are others than the run was begun on, or the file system refuses.
    pub fn hand_over(&self, run: &Run) -> Result<Former> {
        let (dir, path) = (run.dir(), run.path("config.toml"));
        let config = TaskConfig::read(&presets::parse(&shown(&path), &self.config, &[])?)?;
        let now = Assets::open(&config.data().corpora)?.summary()?;
        if let Some(other) = run.info()?.and_then(|info| other_data(&info.data, &now)) {
            bail!("{}: {other}; put the former corpora back", dir.display());
        }
        let files = [path, run.path("run.json")].into_iter().filter(|path| path.is_file());
        let read = |path: PathBuf| {
            let bytes = std::fs::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
            Ok((path, bytes))
        };
        let former = Former(files.map(read).collect::<Result<_>>()?);
        self.write(run)?;
        if let Some(info) = run.info()? {
            run.write_info(&RunInfo { outcome: String::new(), ..info })?;
        }
        Ok(former)
    }

    /// Writes the settings; [`note`] records it when training goes on.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn write(&self, run: &Run) -> Result<()> {
        // An earlier version did not say how many steps there were to be.
        if let Some(info) = run.info()?.filter(|info| info.steps == 0) {
            run.write_info(&RunInfo { steps: self.from, ..info })?;
        }
        let path = run.path("config.toml");
        riglab_files::write(&path, self.config.as_bytes())
            .with_context(|| format!("{} cannot be written", path.display()))
    }
}

/// What stood in a run's folder before it was to have more steps.
pub struct Former(Vec<(PathBuf, Vec<u8>)>);

impl Former {
    /// Writes it again.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn put_back(self) -> Result<()> {
        self.0.iter().try_for_each(|(path, bytes)| {
            riglab_files::write(path, bytes).with_context(|| format!("{} cannot be written", path.display()))
        })
    }
}

/// Notes in `info` that a run which did `at` steps has others to do than it says, however it got them; what to say of it.
pub fn note<T: Task>(task: &T, train: &TrainConfig, at: u64, info: &mut RunInfo) -> Option<String> {
    let (from, to) = (info.steps, train.steps);
    if from == 0 {
        // Not known of a run of an earlier version.
        info.steps = to;
    }
    if [0, to].contains(&from) {
        return None;
    }
    let rates = first_apart(&train.schedule, [from, to], at);
    let paces = (0..at).find(|&step| task.pace(step, from) != task.pace(step, to));
    // The last step is validated in any case, and may be the best.
    let regular = train.validate_every > 0 && from % train.validate_every == 0;
    let validated = at < from || regular;
    let steady = info.is_steady();
    info.extend(at, to, rates.is_none() && paces.is_none() && validated && steady);
    let same = info.extended.last().is_some_and(|e| e.as_from_start);
    let told = format!("extended at step {at} from {from} to {to} steps");
    let (was, is) = (factor(&train.schedule, at.saturating_sub(1), from), factor(&train.schedule, at, to));
    Some(match (rates, paces) {
        _ if same => format!("{told}: the same as {to} steps from the start"),
        (Some(_), _) => format!(
            "{told}: not what {to} steps from the start give, as the learning rate (train.schedule) follows from their number; \
             it was {was:.3} of its peak and goes on at {is:.3}"
        ),
        (None, Some(_)) => format!(
            "{told}: not what {to} steps from the start give, as the weights of the loss follow from their number"
        ),
        (None, None) if !steady => format!(
            "{told}: not what {to} steps from the start give, as it did not always run on {} of one device",
            counted(info.threads, "thread")
        ),
        (None, None) if !validated => format!(
            "{told}: its weights are those of {to} steps from the start, but step {from} was validated as the last, and may be \
             the best"
        ),
        (None, None) => format!("{told}: not what {to} steps from the start give, as it was extended otherwise before"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_was_moved_is_named_anew_where_its_weights_are_known() {
        let dir = tempfile::tempdir().unwrap();
        let of = |run: &Run, place: &str| Longer::of(run, &[format!("start.model='{place}'")]);
        let run = Run::create(dir.path(), "task = 'grpo'\n[start]\nmodel = 'here'\n").unwrap();
        run.write_info(&RunInfo::default()).unwrap();
        let said = of(&run, "there").err().unwrap().to_string();
        assert!(said.contains("no checksum of start.model") && said.contains("put the model back"), "{said}");
        assert!(of(&run, "here").unwrap().is_none(), "nothing changes");
        run.write_info(&RunInfo { companions: vec![("start.model".into(), "ab".into())], ..RunInfo::default() })
            .unwrap();
        assert!(of(&run, "there").unwrap().unwrap().config.contains("model = \"there\""));
    }

    #[test]
    fn steps_and_places_of_models_alone_may_change() {
        let of = |sets: &[&str]| only(Path::new("runs/a"), &sets.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>());
        assert!(of(&[]).is_ok() && of(&["train.steps=5", " train.steps = 7"]).is_ok());
        assert!(of(&["start.model=elsewhere", "skin.run = 'there'"]).is_ok());
        for set in ["train.seed=2", "train.steps.x=1", "train.steps"] {
            let said = of(&["train.steps=5", set]).unwrap_err().to_string();
            assert!(said.contains("runs/a") && said.contains(&format!("`--set {set}` belongs to a new one")), "{said}");
        }
    }
}
