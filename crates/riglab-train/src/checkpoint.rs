//! Checkpoints: complete or absent.
//!
//! `checkpoints/step-N/` holds the weights, their moving average, the optimizer's state, what the task keeps besides
//! (each as safetensors) and `state.json`, after N steps. It is written under a temporary name, synced and renamed;
//! `last` and `best` are links to such folders.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use riglab_nn::optim::{Ema, Optimizer};
use riglab_nn::params::{Params, Weights};
use riglab_nn::{NnError, io};
use serde::{Deserialize, Serialize};
use tch::Tensor;

use crate::TrainError;
use crate::config::TrainConfig;
use crate::run::Run;
use crate::sound::unsound;
use riglab_files::sync_folder;

/// What a run remembers besides tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The task's name.
    pub task: String,
    /// Steps done.
    pub step: u64,
    /// The run's seed.
    pub seed: u64,
    /// Steps skipped so far because something was not finite.
    pub skipped: u64,
    /// Of those, the ones right before this checkpoint.
    pub skipped_in_a_row: u64,
    /// Step and value of the best validation.
    pub best: Option<(u64, f64)>,
}

/// A complete checkpoint on disk.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    path: PathBuf,
    state: State,
}

/// The run and the checkpoint that a folder names where a trained model is asked for: a checkpoint within a run's
/// `checkpoints`, or the run itself, of which that is `best`.
pub fn named_by(folder: &Path) -> (PathBuf, String) {
    let within = || {
        // Runs may well be kept in a folder of that name.
        let folder = Some(folder).filter(|folder| !folder.join("config.toml").is_file())?;
        let checkpoints = folder.parent().filter(|parent| parent.ends_with(CHECKPOINTS))?;
        let run = checkpoints.parent().filter(|run| !run.as_os_str().is_empty());
        Some((run.unwrap_or(Path::new(".")).to_path_buf(), folder.file_name()?.to_str()?.to_string()))
    };
    within().unwrap_or_else(|| (folder.to_path_buf(), "best".to_string()))
}

/// Whether a run has checkpoints of which none is its best, as where a guard refused all.
pub fn without_best(run: &Path) -> bool {
    let there = |name: &str| run.join(CHECKPOINTS).join(name).exists();
    !there("best") && there("last")
}

/// Why no checkpoint is where one was looked for: of a `best` beside a `last`, what to take instead.
fn missing(path: &Path, e: &std::io::Error) -> String {
    if let Some(run) = without_any(path) {
        if crate::run::is_held(run) {
            return "the run has no checkpoint yet: a process is training in its folder and has not written its first"
                .into();
        }
        return format!(
            "the run has no checkpoint yet, as it was stopped before it wrote its first; `riglab train --resume {}` goes on \
             with it",
            run.display()
        );
    }
    let last = path.with_file_name("last");
    if !path.ends_with("best") || path.exists() || !last.exists() {
        return format!("no checkpoint here ({STATE}: {e}){}", beside(path));
    }
    format!(
        "no checkpoint is the best of this run: none passed guard.worse, or what they are chosen by was never measured or \
         never finite; take the last: --checkpoint last, or {} where a folder is named{}",
        last.display(),
        beside(path)
    )
}

/// The run whose checkpoint is looked for, if it is one that has none, not even a broken one.
fn without_any(path: &Path) -> Option<&Path> {
    let folder = path.parent().filter(|folder| folder.ends_with(CHECKPOINTS))?;
    let run = folder.parent().filter(|run| run.join("config.toml").is_file())?;
    fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none()).then_some(run)
}

/// What checkpoints there are where one was looked for, for an error.
fn beside(path: &Path) -> String {
    let entries = path.parent().and_then(|folder| fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter(|entry| entry.path().join(STATE).is_file())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    if names.is_empty() { String::new() } else { format!("; there are: {}", names.join(", ")) }
}

/// The folder of a step whose number is written as people write it.
fn numbered(path: &Path) -> PathBuf {
    let step = || path.file_name()?.to_str()?.strip_prefix("step-")?.parse().ok();
    match step().filter(|_| !path.exists()) {
        Some(step) => path.with_file_name(folder(step)),
        None => path.into(),
    }
}

/// The folder of a run's checkpoints.
const CHECKPOINTS: &str = "checkpoints";
const MODEL: &str = "model.safetensors";
const AVERAGE: &str = "ema.safetensors";
const OPTIMIZER: &str = "optimizer.safetensors";
const KEPT: &str = "task.safetensors";
const STATE: &str = "state.json";

impl Checkpoint {
    /// Opens a checkpoint folder: `step-N`, its number with or without zeros before it, `best` or `last`.
    ///
    /// # Errors
    /// When it is none, or of a version that is not understood.
    pub fn open(path: &Path) -> Result<Self, TrainError> {
        let path = &numbered(path);
        let fault = |message: String| TrainError::Checkpoint { path: path.into(), message };
        let bytes = fs::read(path.join(STATE)).map_err(|e| fault(missing(path, &e)))?;
        let state = serde_json::from_slice(&bytes).map_err(|e| {
            let remedy =
                "it was damaged or written by another version: put it back from a copy, or take another checkpoint";
            fault(format!("{STATE} cannot be understood ({e}); {remedy}{}", beside(path)))
        })?;
        Ok(Self { path: path.into(), state })
    }

    /// The one that a run goes on from; `None` where it was stopped before it had any.
    ///
    /// # Errors
    /// Where there was one: to begin anew would throw away what was trained.
    pub fn latest(run: &Run, config: &TrainConfig) -> Result<Option<Self>, TrainError> {
        let store = Store { dir: run.path(CHECKPOINTS), averaged: config.ema > 0.0 };
        if let Some(found) = store.latest() {
            return Ok(Some(found));
        }
        const REMEDY: &str = "put it back from a copy, or train anew in another folder (`riglab train config.toml --run \
                              OTHER`)";
        if let Some(damage) = store.damage() {
            let message = format!("no checkpoint is left to go on from: {damage}; {REMEDY}");
            return Err(TrainError::Checkpoint { path: run.dir().into(), message });
        }
        let steps = logged(&run.path("metrics.jsonl"));
        // A run that is killed early has none yet.
        let was_saved = run.info()?.is_some_and(|info| info.was_saved());
        let saved = (config.save_every > 0 && steps > config.save_every) || was_saved || !store.dir.is_dir();
        if steps == 0 || !saved {
            return Ok(None);
        }
        let message = format!(
            "{} steps were done, but no checkpoint is there, and starting over would replace them: {REMEDY}, or move \
             metrics.jsonl and run.json away",
            steps
        );
        Err(TrainError::Checkpoint { path: run.dir().into(), message })
    }

    /// The checkpoint that the rank who writes found in a run's folder.
    pub(crate) fn of_step(run: &Run, step: u64) -> Result<Self, TrainError> {
        let path = run.path("checkpoints").join(folder(step));
        Self::open(&path).map_err(|_| {
            let message =
                "the first rank goes on from here, but this one cannot read it; ranks on several machines need \
                           the run in a folder that all of them share"
                    .into();
            TrainError::Checkpoint { path, message }
        })
    }

    /// Puts weights that were not trained here into a run's folder, as its best and last checkpoint. They can be
    /// evaluated and started from, but not trained on as if nothing had happened: there is no optimizer's state.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn plant(run: &Path, params: &Params, state: &State) -> Result<(), TrainError> {
        let store = Store::new(run.join("checkpoints"), false)?;
        let temp = store.dir.join(format!(".tmp-{}-{}", folder(state.step), std::process::id()));
        let written = store.write(&temp, params, None, None, state, &BTreeMap::new());
        if let Err(e) = written.and_then(|()| store.put(&temp, &store.dir.join(folder(state.step)))) {
            let _ = fs::remove_dir_all(&temp);
            return Err(e);
        }
        store.link("last", state.step)?;
        store.link("best", state.step)
    }

    /// What it remembers.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Whether its files can be read from end to end, those of `asked` among them: one that is cut off is told by its head.
    fn whole(self, asked: &[&str]) -> Result<Self, TrainError> {
        for name in [MODEL, AVERAGE, OPTIMIZER, KEPT] {
            let file = self.path.join(name);
            // Not every run has all of them.
            if asked.contains(&name) || file.is_file() {
                io::Reader::open(&file)?;
            }
        }
        Ok(self)
    }

    /// Its folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Loads the weights to evaluate with: the moving average if there is one.
    ///
    /// # Errors
    /// When they are damaged, or of another network.
    pub fn load_weights(&self, params: &Params) -> Result<(), TrainError> {
        let file = self.weights();
        self.take(&file, params, params.weights())?;
        let fault = |(name, t): (&str, &Tensor)| Some(format!("tensor `{name}` {}", unsound(t)?));
        match params.named(params.weights()).find_map(fault) {
            Some(fault) => {
                let message = format!("{fault}: its training diverged, or it was damaged; take another checkpoint");
                Err(TrainError::Checkpoint { path: file, message })
            }
            None => Ok(()),
        }
    }

    /// The file of the weights to evaluate with.
    pub fn weights(&self) -> PathBuf {
        let average = self.path.join(AVERAGE);
        if average.is_file() { average } else { self.path.join(MODEL) }
    }

    /// Loads everything a run goes on with.
    ///
    /// # Errors
    /// When something is missing, damaged, or of another network or optimizer.
    pub fn restore(&self, params: &Params, optimizer: &mut Optimizer, ema: Option<&Ema>) -> Result<(), TrainError> {
        let file = |name: &str| self.path.join(name);
        if !file(OPTIMIZER).is_file() {
            let message =
                "holds weights alone, no optimizer state: start a new run from them with --set train.start.from=RUN";
            return Err(TrainError::Checkpoint { path: self.path.clone(), message: message.into() });
        }
        self.take(&file(MODEL), params, params.weights())?;
        self.check(&file(MODEL), params.named(params.weights()))?;
        if let Some(ema) = ema {
            self.take(&file(AVERAGE), params, ema.weights())?;
            self.check(&file(AVERAGE), params.named(ema.weights()))?;
        }
        let (state, mut fault) = (io::Reader::open(&file(OPTIMIZER))?, Ok(()));
        let loaded = optimizer.load_each(params, &state.shapes(), |name| {
            let tensor = state.read(name)?;
            // Counts of steps may be whole numbers.
            if fault.is_ok() && tensor.is_floating_point() {
                fault = self.check(&file(OPTIMIZER), std::iter::once((name, &tensor)));
            }
            Ok(tensor)
        });
        loaded.map_err(|e| match e {
            NnError::Mismatch { .. } => self.foreign(&file(OPTIMIZER), &e),
            e => e.into(),
        })?;
        fault
    }

    /// That what a run goes on with is finite: from a number that is not, nothing can be learned.
    fn check<'a>(&self, file: &Path, tensors: impl Iterator<Item = (&'a str, &'a Tensor)>) -> Result<(), TrainError> {
        let fault = |(name, t): (&str, &Tensor)| Some(format!("tensor `{name}` {}", unsound(t)?));
        let Some(fault) = { tensors }.find_map(fault) else { return Ok(()) };
        let message = format!(
            "{fault}: its training diverged, or it was damaged; move the folder {} out of the run, and `riglab train \
             --resume` goes on from an earlier checkpoint",
            self.path.file_name().unwrap_or_default().to_string_lossy()
        );
        Err(TrainError::Checkpoint { path: file.into(), message })
    }

    /// What the task kept; nothing where it keeps nothing.
    ///
    /// # Errors
    /// When it is damaged.
    pub fn kept(&self) -> Result<BTreeMap<String, Tensor>, TrainError> {
        let file = self.path.join(KEPT);
        if file.is_file() { Ok(io::read(&file)?) } else { Ok(BTreeMap::new()) }
    }

    fn take(&self, file: &Path, params: &Params, weights: &Weights) -> Result<(), TrainError> {
        params.load_from(&io::Reader::open(file)?, weights).map_err(|e| match e {
            NnError::Mismatch { .. } => self.foreign(file, &e),
            e => e.into(),
        })
    }

    fn foreign(&self, file: &Path, e: &NnError) -> TrainError {
        let message = format!(
            "not of this network ({e}); it was written by task `{}` with another config: take the `config.toml` beside its checkpoints",
            self.state.task
        );
        TrainError::Checkpoint { path: file.into(), message }
    }
}

/// The folder `checkpoints` of a run.
pub(crate) struct Store {
    dir: PathBuf,
    /// Whether its run keeps a moving average (`train.ema`), without which nothing goes on.
    averaged: bool,
}

impl Store {
    /// Opens or makes it, and clears what a killed run left half-written.
    pub fn new(dir: PathBuf, averaged: bool) -> Result<Self, TrainError> {
        fs::create_dir_all(&dir).map_err(|e| TrainError::io(&dir, "be made", &e))?;
        let store = Self { dir, averaged };
        for name in store.entries() {
            if name.starts_with(".tmp-") {
                let _ = fs::remove_dir_all(store.dir.join(name));
            }
        }
        Ok(store)
    }

    /// The newest complete checkpoint; of a run that has weights alone, as one that was made of a model's file, the newest
    /// that can be read.
    pub fn latest(&self) -> Option<Checkpoint> {
        let steps = self.steps();
        let bare = |step: &u64| Checkpoint::open(&self.dir.join(folder(*step))).ok()?.whole(&[MODEL]).ok();
        let whole = steps.iter().rev().find_map(|step| self.whole(*step).ok());
        whole.or_else(|| steps.iter().rev().find_map(bare))
    }

    /// A checkpoint with all that a training goes on with.
    fn whole(&self, step: u64) -> Result<Checkpoint, TrainError> {
        let asked = [MODEL, OPTIMIZER, AVERAGE];
        let count = if self.averaged { asked.len() } else { asked.len() - 1 };
        Checkpoint::open(&self.dir.join(folder(step)))?.whole(&asked[..count])
    }

    /// What is wrong with the newest checkpoint, if something is: older ones are gone on from then.
    pub fn damage(&self) -> Option<TrainError> {
        let newest = self.steps().pop()?;
        let taken = |latest: Checkpoint| latest.path() == self.dir.join(folder(newest));
        self.whole(newest).err().filter(|_| !self.latest().is_some_and(taken))
    }

    /// Writes a checkpoint, in place of one that is damaged, links `last` (and `best`) to it and removes the oldest beyond
    /// `keep`.
    pub fn save(
        &self,
        params: &Params,
        optimizer: &Optimizer,
        ema: Option<&Ema>,
        state: &State,
        kept: &BTreeMap<String, Tensor>,
        keep: usize,
    ) -> Result<(), TrainError> {
        let target = self.dir.join(folder(state.step));
        if !self.is_whole(state.step) {
            let temp = self.dir.join(format!(".tmp-{}-{}", folder(state.step), std::process::id()));
            let written = self.write(&temp, params, Some(optimizer), ema, state, kept);
            if let Err(e) = written.and_then(|()| self.put(&temp, &target)) {
                let _ = fs::remove_dir_all(&temp);
                return Err(e);
            }
        }
        self.link("last", state.step)?;
        self.link_best(state)?;
        self.prune(keep, state);
        Ok(())
    }

    /// Points `last` to the checkpoint that a run goes on from, and `best` to what its state holds for it, where that is
    /// there: the run may have been killed before they were linked, or a later checkpoint may have been damaged or moved away.
    pub fn link_again(&self, state: &State) -> Result<(), TrainError> {
        if self.is_whole(state.step) {
            self.link("last", state.step)?;
        }
        self.link_best(state)
    }

    fn link_best(&self, state: &State) -> Result<(), TrainError> {
        match state.best {
            Some((step, _)) if self.is_whole(step) => self.link("best", step),
            _ => Ok(()),
        }
    }

    fn is_whole(&self, step: u64) -> bool {
        self.whole(step).is_ok_and(|found| found.state().step == step)
    }

    fn write(
        &self,
        dir: &Path,
        params: &Params,
        optimizer: Option<&Optimizer>,
        ema: Option<&Ema>,
        state: &State,
        kept: &BTreeMap<String, Tensor>,
    ) -> Result<(), TrainError> {
        fs::create_dir_all(dir).map_err(|e| TrainError::io(dir, "be made", &e))?;
        io::write(&dir.join(MODEL), params.named(params.weights()))?;
        if let Some(ema) = ema {
            io::write(&dir.join(AVERAGE), params.named(ema.weights()))?;
        }
        if let Some(optimizer) = optimizer {
            let tensors: BTreeMap<String, Tensor> = optimizer.state(params);
            io::write(&dir.join(OPTIMIZER), tensors.iter().map(|(k, v)| (k.as_str(), v)))?;
        }
        if !kept.is_empty() {
            io::write(&dir.join(KEPT), kept.iter().map(|(k, v)| (k.as_str(), v)))?;
        }
        let path = dir.join(STATE);
        let text = serde_json::to_string_pretty(state).expect("plain data") + "\n";
        let written = File::create(&path).and_then(|mut f| f.write_all(text.as_bytes()).and_then(|()| f.sync_all()));
        written.and_then(|()| sync_folder(dir)).map_err(|e| TrainError::io(&path, "be written", &e))
    }

    fn put(&self, temp: &Path, target: &Path) -> Result<(), TrainError> {
        if target.exists() {
            // Never complete, or damaged.
            fs::remove_dir_all(target).map_err(|e| TrainError::io(target, "be replaced", &e))?;
        }
        fs::rename(temp, target)
            .and_then(|()| sync_folder(&self.dir))
            .map_err(|e| TrainError::io(target, "be put in place", &e))
    }

    /// Points a link (`last`, `best`) to the checkpoint of a step, in one move.
    pub fn link(&self, name: &str, step: u64) -> Result<(), TrainError> {
        let (link, temp) = (self.dir.join(name), self.dir.join(format!(".tmp-{name}-{}", std::process::id())));
        let _ = fs::remove_file(&temp);
        std::os::unix::fs::symlink(folder(step), &temp)
            .and_then(|()| fs::rename(&temp, &link))
            .and_then(|()| sync_folder(&self.dir))
            .map_err(|e| TrainError::io(&link, "be linked", &e))
    }

    /// What is damaged does not count as kept, nor what a run that went on from before it has still to write anew.
    fn prune(&self, keep: usize, state: &State) {
        let best = state.best.map(|(step, _)| step);
        let (mut steps, mut kept) = (self.steps(), 0);
        steps.retain(|&step| step <= state.step);
        for &step in steps.iter().rev() {
            if kept < keep && self.is_whole(step) {
                kept += 1;
            } else if Some(step) != best && step != state.step {
                let _ = fs::remove_dir_all(self.dir.join(folder(step)));
            }
        }
    }

    /// Steps that have a folder, rising.
    fn steps(&self) -> Vec<u64> {
        let mut steps: Vec<u64> = self.entries().iter().filter_map(|n| n.strip_prefix("step-")?.parse().ok()).collect();
        steps.sort_unstable();
        steps
    }

    fn entries(&self) -> Vec<String> {
        let Ok(entries) = fs::read_dir(&self.dir) else { return Vec::new() };
        entries.filter_map(|e| e.ok()?.file_name().into_string().ok()).collect()
    }
}

/// The last step that a run logged; 0 where it logged none.
fn logged(metrics: &Path) -> u64 {
    let text = fs::read_to_string(metrics).unwrap_or_default();
    let step = |line: &str| serde_json::from_str::<serde_json::Value>(line).ok()?["step"].as_u64();
    text.lines().rev().find_map(step).unwrap_or(0)
}

fn folder(step: u64) -> String {
    format!("step-{step:08}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_names_a_run_or_one_of_its_checkpoints() {
        let of = |folder: &str| {
            let (run, checkpoint) = named_by(Path::new(folder));
            (run.display().to_string(), checkpoint)
        };
        let pair = |run: &str, checkpoint: &str| (run.to_string(), checkpoint.to_string());
        assert_eq!(of("runs/a"), pair("runs/a", "best"));
        assert_eq!(of("runs/a/checkpoints/last"), pair("runs/a", "last"));
        assert_eq!(of("runs/a/checkpoints/step-00000100/"), pair("runs/a", "step-00000100"));
        assert_eq!(of("checkpoints/best"), pair(".", "best"));
        assert_eq!(of("checkpoints"), pair("checkpoints", "best"));
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("checkpoints").join("last");
        fs::create_dir_all(&run).unwrap();
        assert_eq!(named_by(&run), (dir.path().to_path_buf(), "last".to_string()));
        fs::write(run.join("config.toml"), "").unwrap();
        assert_eq!(named_by(&run), (run.clone(), "best".to_string()));
    }

    #[test]
    fn what_was_trained_is_not_begun_anew() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::create(&dir.path().join("run"), "").unwrap();
        let config = TrainConfig { save_every: 4, ..TrainConfig::default() };
        let latest =
            |config: &TrainConfig| Checkpoint::latest(&run, config).map(|c| c.is_some()).map_err(|e| e.to_string());
        let steps = |n: u64| {
            let lines: String = (1..=n).map(|step| format!("{{\"step\": {step}}}\n")).collect();
            fs::write(run.path("metrics.jsonl"), lines + "{\"step\": 9").unwrap();
        };
        assert_eq!(latest(&config), Ok(false));
        // Killed before its first checkpoint.
        steps(4);
        assert_eq!(latest(&config), Ok(false));
        steps(7);
        let said = latest(&config).unwrap_err();
        assert!(said.contains("7 steps were done") && said.contains("--run OTHER"), "{said}");
        let rarely = TrainConfig { save_every: 0, ..config };
        assert_eq!(latest(&rarely), Ok(false));
        run.write_info(&crate::RunInfo { outcome: "finished".into(), ..Default::default() }).unwrap();
        assert!(latest(&rarely).is_err(), "its last step is saved in any case");
        // Killed after it was begun anew, or after it went on.
        let went_on = |steps: u64| {
            let mut info = crate::RunInfo { outcome: "interrupted".into(), ..Default::default() };
            info.go_on(steps, crate::RunInfo::default());
            run.write_info(&info).unwrap();
            latest(&rarely)
        };
        assert_eq!(went_on(0), Ok(false));
        assert!(went_on(4).is_err());
        // One that nobody can read.
        fs::create_dir_all(run.path("checkpoints/step-00000004")).unwrap();
        let said = latest(&rarely).unwrap_err();
        assert!(said.contains("no checkpoint is left") && said.contains("step-00000004"), "{said}");
    }

    #[test]
    fn a_run_without_a_best_says_what_to_take_instead() {
        let dir = tempfile::tempdir().unwrap();
        let of = |name: &str| Checkpoint::open(&dir.path().join(CHECKPOINTS).join(name)).unwrap_err().to_string();
        assert!(!without_best(dir.path()) && of("best").contains("no checkpoint here"));
        let last = dir.path().join(CHECKPOINTS).join("last");
        fs::create_dir_all(&last).unwrap();
        assert!(without_best(dir.path()));
        let said = of("best");
        assert!(said.contains("none passed guard.worse") && said.contains("--checkpoint last, or "), "{said}");
        assert!(of("last").contains("no checkpoint here") && of("step-3").contains("no checkpoint here"));
        fs::create_dir_all(last.with_file_name("best")).unwrap();
        assert!(!without_best(dir.path()) && of("best").contains("no checkpoint here"));
    }

    #[test]
    fn a_run_that_was_stopped_before_its_first_checkpoint_says_how_to_go_on() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        fs::create_dir_all(run.join(CHECKPOINTS)).unwrap();
        let of = |name: &str| Checkpoint::open(&run.join(CHECKPOINTS).join(name)).unwrap_err().to_string();
        assert!(of("best").contains("no checkpoint here"), "no run: there is no config.toml");
        fs::write(run.join("config.toml"), "").unwrap();
        let said = of("best");
        assert!(said.contains("no checkpoint yet") && said.contains("riglab train --resume "), "{said}");
        // A link to a checkpoint that is gone is something else.
        fs::create_dir_all(run.join(CHECKPOINTS).join("step-00000004")).unwrap();
        assert!(of("best").contains("no checkpoint here"));
    }

    #[test]
    fn a_step_is_found_by_its_number() {
        let dir = tempfile::tempdir().unwrap();
        let state = r#"{"task": "t", "step": 40, "seed": 0, "skipped": 0, "skipped_in_a_row": 0, "best": null}"#;
        for name in ["step-00000040", "best"] {
            fs::create_dir_all(dir.path().join(name)).unwrap();
            fs::write(dir.path().join(name).join(STATE), state).unwrap();
        }
        let open =
            |name: &str| Checkpoint::open(&dir.path().join(name)).map(|c| c.state.step).map_err(|e| e.to_string());
        for name in ["step-40", "step-00000040", "best"] {
            assert_eq!(open(name), Ok(40), "{name}");
        }
        for name in ["step-41", "step-", "lost"] {
            assert!(open(name).unwrap_err().contains("there are: best, step-00000040"), "{name}");
        }
    }
}
