//! A trained skeleton model as others start from it.

use std::fs::File;
use std::path::Path;

use riglab_nn::params::Params;
use riglab_nn::skeleton::SkeletonModel;
use riglab_train::{Checkpoint, State, named_by};
use tch::Device;

use super::{SkeletonTask, SkeletonTaskConfig};
use crate::bundle::{Card, Stored};
use crate::grpo::{descends, refined, same_start};
use crate::settings::{Settings, TaskSettings};

/// Its task.
const KIND: &str = SkeletonTaskConfig::TASK;
/// What may be started from.
const REMEDY: &str = "give start.model the folder of a run or of one of its checkpoints, or a model's file (--set \
                      start.model=PATH, where it was moved)";

/// Settings and weights, with what is known of them.
pub(crate) struct Trained {
    pub config: SkeletonTaskConfig,
    pub net: SkeletonModel,
    pub params: Params,
    pub card: Card,
}

impl Trained {
    /// Of a run's folder, its best checkpoint, or of that of another of its checkpoints, or of a file that `riglab checkpoint
    /// import` made; of a run of GRPO, what became of such a model. `None` where it is of another task.
    ///
    /// # Errors
    /// A sentence: what cannot be read, or another model where a run of GRPO started.
    pub fn open(path: &Path, device: Device) -> Result<Option<Self>, String> {
        Self::open_with(path, &[], device)
    }

    /// As [`Self::open`], with settings of a run changed as `--set` does: where the model lies now that it started from.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(path: &Path, sets: &[String], device: Device) -> Result<Option<Self>, String> {
        let (run, checkpoint) = named_by(path);
        if run.is_dir() {
            descends(&run)?;
            let settings = Settings::of_run_with(&run, sets).map_err(|e| format!("{e}; {REMEDY}"))?;
            let own = match refined(&settings)? {
                Some(start) if start.as_os_str().is_empty() => None,
                Some(start) => {
                    let start = Self::open(&start, device)?;
                    start.as_ref().map(|start| same_start(&run, &start.params)).transpose()?;
                    start
                }
                None => Self::of_settings(&settings, device)?,
            };
            let Some(mut own) = own else { return Ok(None) };
            let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map_err(|e| e.to_string())?;
            checkpoint.load_weights(&own.params).map_err(|e| e.to_string())?;
            own.card = Card::of_run(&run, checkpoint.state());
            return Ok(Some(own));
        }
        let name = path.to_string_lossy();
        File::open(path).map_err(|e| format!("{name}: no model to start from ({e}); {REMEDY}"))?;
        let stored = Stored::open(path)?;
        if stored.kind != KIND {
            return Ok(None);
        }
        let own = Self::of_settings(&Settings::of_text(&name, &stored.settings)?, device)?;
        let own = own.ok_or_else(|| format!("{name}: the settings inside are of another task"))?;
        stored.load("", &own.params)?;
        Ok(Some(Self { card: stored.card, ..own }))
    }

    /// Without weights yet.
    fn of_settings(settings: &Settings, device: Device) -> Result<Option<Self>, String> {
        if !settings.are::<SkeletonTaskConfig>() {
            return Ok(None);
        }
        let config: SkeletonTaskConfig = settings.get()?;
        let made = SkeletonTask::blank(&config, device);
        let (net, params) = made.map_err(|e| format!("{}: {e}", settings.name()))?;
        let state = State { task: KIND.into(), step: 0, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
        let card = Card { name: settings.name().to_owned(), state, text: String::new() };
        Ok(Some(Self { config, net, params, card }))
    }
}
