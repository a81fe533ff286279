//! A trained model in one file: network, auto-encoder, settings, and what to know about it.

use std::path::Path;
use std::sync::Arc;

use riglab_train::{Checkpoint, RunInfo, named_by, same_companions};
use tch::{Device, Kind};

use super::{Rigger, TokenRigTaskConfig};
use crate::bundle::{Bundle, Card, SKIN};
use crate::fsq_cvae::Frozen;
use crate::grpo::GrpoTaskConfig;
use crate::settings::{Settings, TaskSettings};

/// The network's place among the tensors' names.
pub(crate) const RIG: &str = "rig.";
/// The task of models that rig.
const KIND: &str = TokenRigTaskConfig::TASK;

impl Rigger {
    /// Reads a run's folder, that of one of its checkpoints, or a file that [`Self::bundle`] made.
    ///
    /// # Errors
    /// A sentence: what it is instead, or what is wrong with it.
    pub fn open(path: &Path, device: Device) -> Result<(Self, Card), String> {
        let (run, checkpoint) = named_by(path);
        if run.is_dir() {
            return Self::of_run(&run, &checkpoint, device);
        }
        let bytes = std::fs::read(path).map_err(|e| format!("{}: cannot be read ({e})", path.display()))?;
        Self::of_bundle(&bytes, &path.display().to_string(), device)
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
        let rigger = Self::new(config, vae, device)?;
        // Whether it was named for this or not: codes mean nothing to an auto-encoder that they were not learned with.
        let before = RunInfo::of(run).map_or_else(Vec::new, |info| info.companions);
        let other = |e: String| format!("{}: {e}", run.display());
        same_companions(&before, &rigger.companions()).map_err(other)?;
        let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map_err(|e| e.to_string())?;
        checkpoint.load_weights(&rigger.params).map_err(|e| e.to_string())?;
        Ok((rigger, Card::of_run(run, checkpoint.state())))
    }

    /// One file with everything, numbers as `kind`.
    ///
    /// # Errors
    /// When settings or tensors cannot be written.
    pub fn bundle(&self, card: &Card, kind: Kind) -> Result<Vec<u8>, String> {
        // Where it learned from is of no use elsewhere, and says more of a machine than it should.
        let (mut rig, mut skin) = (self.config.clone(), self.vae.config().clone());
        (rig.data.corpora, rig.data.weights, rig.skin.run) = (Vec::new(), Vec::new(), std::path::PathBuf::new());
        (skin.data.corpora, skin.data.weights) = (Vec::new(), Vec::new());
        let toml = |e: toml::ser::Error| e.to_string();
        let own = self.params.named(self.params.weights()).map(|(n, t)| (format!("{RIG}{n}"), t.detach()));
        let of_skin = self.vae.tensors().into_iter().map(|(n, t)| (format!("{SKIN}{n}"), t));
        let bundle = Bundle {
            kind: KIND.into(),
            card: card.clone(),
            settings: toml::to_string(&rig).map_err(toml)?,
            skin: toml::to_string(&skin).map_err(toml)?,
            tensors: own.chain(of_skin).map(|(n, t)| (n, t.to_kind(kind))).collect(),
        };
        bundle.to_bytes()
    }

    /// What [`Self::bundle`] made; `name` stands in messages.
    ///
    /// # Errors
    /// A sentence: what it is instead, or what is wrong with it.
    pub fn of_bundle(bytes: &[u8], name: &str, device: Device) -> Result<(Self, Card), String> {
        let fault = |e: String| format!("{name}: {e}");
        let bundle = Bundle::of_bytes(bytes, name)?;
        if bundle.kind != KIND {
            return Err(fault(format!(
                "a model of task `{}`, but rigs are made by `tokenrig` and `grpo`, or by `unirig_skeleton` and `unirig_skin` together",
                bundle.kind
            )));
        }
        let config = rig_config(&Settings::of_text(name, &bundle.settings)?)?;
        let vae = Frozen::of_parts(name, &bundle.skin, &bundle.below(SKIN), device)?;
        let rigger = Self::new(config, Arc::new(vae), device).map_err(fault)?;
        rigger.params.load(&bundle.below(RIG)).map_err(|e| fault(e.to_string()))?;
        Ok((rigger, bundle.card))
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
