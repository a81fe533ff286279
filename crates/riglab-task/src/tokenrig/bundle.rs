//! A trained model in one file: network, auto-encoder, settings, and what to know about it.

use std::path::Path;
use std::sync::Arc;

use riglab_train::{Checkpoint, RunInfo, StartConfig, named_by, same_companions};
use tch::Device;

use super::{Rigger, TokenRigTaskConfig};
use crate::bundle::{Bundle, Card, RIG, SKIN, Stored};
use crate::fsq_cvae::Frozen;
use crate::grpo::GrpoTaskConfig;
use crate::settings::{Settings, TaskSettings};

/// The task of models that rig.
const KIND: &str = TokenRigTaskConfig::TASK;

impl Rigger {
    /// Reads a run's folder, that of one of its checkpoints, or a file of a [`Self::bundle`].
    ///
    /// # Errors
    /// A sentence: what it is instead, or what is wrong with it.
    pub fn open(path: &Path, device: Device) -> Result<(Self, Card), String> {
        let (run, checkpoint) = named_by(path);
        if run.is_dir() {
            return Self::of_run(&run, &checkpoint, device);
        }
        Self::of_stored(Stored::open(path)?, &path.display().to_string(), device)
    }

    /// Of a run's checkpoint: `best`, `last` or `step-N`.
    ///
    /// # Errors
    /// A sentence.
    pub fn of_run(run: &Path, checkpoint: &str, device: Device) -> Result<(Self, Card), String> {
        Self::of_run_with(run, checkpoint, &[], device)
    }

    /// As [`Self::of_run`], with settings changed as `--set` does: where models lie now that the run builds on.
    ///
    /// # Errors
    /// A sentence: also where such a model has other weights than the one that the run was begun with.
    pub fn of_run_with(run: &Path, checkpoint: &str, sets: &[String], device: Device) -> Result<(Self, Card), String> {
        let settings = Settings::of_run_with(run, sets)?;
        if settings.are::<GrpoTaskConfig>() {
            return crate::grpo::of_run(run, &settings, checkpoint, device);
        }
        let mut config = rig_config(&settings)?;
        Self::own_auto_encoder(run, &mut config);
        let vae = Self::auto_encoder(&config, device)?;
        let rigger = Self::blank(config, vae, device)?;
        // Whether it was named for this or not: codes mean nothing to an auto-encoder that they were not learned with.
        let before = RunInfo::of(run).map_or_else(Vec::new, |info| info.companions);
        let other = |e: String| format!("{}: {e}", run.display());
        same_companions(&before, &rigger.companions()).map_err(other)?;
        let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map_err(|e| e.to_string())?;
        checkpoint.load_weights(&rigger.params).map_err(|e| e.to_string())?;
        Ok((rigger, Card::of_run(run, checkpoint.state())))
    }

    /// Everything for one file.
    ///
    /// # Errors
    /// When settings cannot be written.
    pub fn bundle(&self, card: &Card) -> Result<Bundle, String> {
        // Where it learned from is of no use elsewhere, and says more of a machine than it should.
        let (mut rig, mut skin) = (self.config.clone(), self.vae.config().clone());
        (rig.data.corpora, rig.data.weights, rig.skin.run) = (Vec::new(), Vec::new(), std::path::PathBuf::new());
        (skin.data.corpora, skin.data.weights) = (Vec::new(), Vec::new());
        (rig.train.start, skin.train.start) = (StartConfig::default(), StartConfig::default());
        let toml = |e: toml::ser::Error| e.to_string();
        let own = self.params.named(self.params.weights()).map(|(n, t)| (format!("{RIG}{n}"), t.detach()));
        let of_skin = self.vae.tensors().into_iter().map(|(n, t)| (format!("{SKIN}{n}"), t));
        Ok(Bundle {
            kind: KIND.into(),
            card: card.clone(),
            settings: toml::to_string(&rig).map_err(toml)?,
            skin: toml::to_string(&skin).map_err(toml)?,
            tensors: own.chain(of_skin).collect(),
        })
    }

    /// What [`Self::bundle`] made; `name` stands in messages.
    pub(super) fn of_stored(stored: Stored, name: &str, device: Device) -> Result<(Self, Card), String> {
        let fault = |e: String| format!("{name}: {e}");
        if stored.kind != KIND {
            return Err(fault(format!(
                "a model of task `{}`, but rigs are made by `tokenrig` and `grpo`, or by `unirig_skeleton` and `unirig_skin` together",
                stored.kind
            )));
        }
        let config = rig_config(&Settings::of_text(name, &stored.settings)?)?;
        let vae = Frozen::of_stored(&stored, name, device)?;
        let rigger = Self::blank(config, Arc::new(vae), device).map_err(fault)?;
        stored.load(RIG, &rigger.params)?;
        Ok((rigger, stored.card))
    }
}

fn rig_config(settings: &Settings) -> Result<TokenRigTaskConfig, String> {
    if !settings.are::<TokenRigTaskConfig>() {
        let (name, task) = (settings.name(), settings.task());
        return Err(format!(
            "{name}: of task `{task}`, but rigs are made by models of `tokenrig` and `grpo`, or by `unirig_skeleton` and `unirig_skin` together"
        ));
    }
    settings.get()
}
