//! A trained auto-encoder that other tasks use, unchanged.

use std::path::Path;
use std::sync::Mutex;

use riglab_nn::fsq_cvae::{Bottleneck, FsqCvae};
use riglab_nn::params::{Params, Weights};
use riglab_train::{Checkpoint, State, named_by};
use tch::Device;

use super::coder::Coder;
use super::{FsqCvaeTask, FsqCvaeTaskConfig};
use crate::bundle::{SKIN, Stored};
use crate::settings::Settings;

/// Network, settings and weights; shared by threads.
pub struct Frozen {
    config: FsqCvaeTaskConfig,
    net: FsqCvae,
    params: Mutex<Params>,
    /// Its weights in bfloat16, once they were asked for.
    half: Mutex<Option<Weights>>,
    device: Device,
}

/// What to do where there is none.
const REMEDY: &str = "train an auto-encoder with `riglab train skintokens/fsq_cvae_with_prior.toml` and give its folder \
                      as skin.run";

/// Codes that are real numbers are no tokens.
fn has_tokens(config: &FsqCvaeTaskConfig) -> Result<(), String> {
    const REFUSED: &str = "the codes of this auto-encoder are real numbers, of which no tokens can be made: train one \
                           with model.bottleneck = \"fsq\" (skintokens/fsq_cvae_with_prior.toml)";
    if config.model.bottleneck == Bottleneck::Gaussian { Err(REFUSED.into()) } else { Ok(()) }
}

impl Frozen {
    /// With these weights.
    pub fn new(config: FsqCvaeTaskConfig, net: FsqCvae, params: Params, device: Device) -> Self {
        Self { config, net, params: Mutex::new(params), half: Mutex::default(), device }
    }

    /// Of a run's folder: its config, and its best checkpoint; or of that of another of its checkpoints; or of a file that
    /// `riglab checkpoint` made: an auto-encoder's, or that of a model that rigs, of which the auto-encoder is taken.
    ///
    /// # Errors
    /// A sentence: what is missing there, or not of this task.
    pub fn open(run: &Path, device: Device) -> Result<Self, String> {
        if run.is_file() {
            return Self::of_file(run, device);
        }
        if !run.exists() {
            return Err(format!(
                "skin.run: there is no {}; if it was moved, say where it is now by --set skin.run=PATH, or {REMEDY}",
                run.display()
            ));
        }
        let (run, checkpoint) = named_by(run);
        Self::of_run(&run, &checkpoint, device).map(|(own, _)| own)
    }

    /// Of a run's checkpoint, `best`, `last` or `step-N`, and where that stood in the training.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn of_run(run: &Path, checkpoint: &str, device: Device) -> Result<(Self, State), String> {
        let settings = Settings::of_run(run).map_err(|e| format!("{e}; {REMEDY}"))?;
        let (name, task) = (settings.name(), settings.task());
        if !settings.are::<FsqCvaeTaskConfig>() {
            return Err(format!("{name}: a run of task `{task}`; {REMEDY}"));
        }
        let config: FsqCvaeTaskConfig = settings.get()?;
        has_tokens(&config).map_err(|e| format!("{name}: {e}"))?;
        let (net, params) = FsqCvaeTask::blank(&config, device).map_err(|e| format!("{name}: {e}"))?;
        let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map_err(|e| e.to_string())?;
        checkpoint.load_weights(&params).map_err(|e| e.to_string())?;
        Ok((Self::new(config, net, params, device), checkpoint.state().clone()))
    }

    fn of_file(path: &Path, device: Device) -> Result<Self, String> {
        let name = path.to_string_lossy();
        Self::of_stored(&Stored::open(path)?, &name, device)
    }

    /// Of a file's content, its own or that of a model that rigs; `name` stands in messages.
    pub(crate) fn of_stored(stored: &Stored, name: &str, device: Device) -> Result<Self, String> {
        let (settings, prefix) = match stored.kind.as_str() {
            "fsq_cvae" => (&stored.settings, ""),
            _ if !stored.skin.is_empty() => (&stored.skin, SKIN),
            kind => return Err(format!("{name}: a model of task `{kind}`, which has no auto-encoder (task fsq_cvae)")),
        };
        let fault = |e: String| format!("{name}: {e}");
        let config: FsqCvaeTaskConfig = Settings::of_text(name, settings)?.get()?;
        has_tokens(&config).map_err(fault)?;
        let (net, params) = FsqCvaeTask::blank(&config, device).map_err(|e| fault(e.to_string()))?;
        stored.load(prefix, &params)?;
        Ok(Self::new(config, net, params, device))
    }

    /// Its settings.
    pub fn config(&self) -> &FsqCvaeTaskConfig {
        &self.config
    }

    /// The levels of its codes.
    pub fn levels(&self) -> &[i64] {
        self.net.fsq().levels()
    }

    /// Works with it; several threads may at a time.
    pub fn with<T>(&self, work: impl FnOnce(Coder<'_>) -> T) -> T {
        let weights = {
            // Weights are only read: a thread that panicked left them whole.
            let params = self.params.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            params.weights().recomputing(false)
        };
        work(Coder { config: &self.config, net: &self.net, weights: &weights, device: self.device })
    }

    /// As [`Self::with`], computing in bfloat16: twice as fast where the processor has it, shares off by some thousandths.
    pub fn with_half<T>(&self, work: impl FnOnce(Coder<'_>) -> T) -> T {
        let weights = {
            let mut half = self.half.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let weights = half.get_or_insert_with(|| {
                let params = self.params.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                tch::no_grad(|| params.weights().cast(tch::Kind::BFloat16))
            });
            weights.recomputing(false)
        };
        work(Coder { config: &self.config, net: &self.net, weights: &weights, device: self.device })
    }

    /// Puts it into a run's folder, as [`Checkpoint::plant`] does.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn plant(&self, run: &Path, state: &State) -> Result<(), String> {
        let params = self.params.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        Checkpoint::plant(run, &params, state).map_err(|e| e.to_string())
    }

    /// Its settings and parameters, to be written into another file.
    pub fn into_parts(self) -> (FsqCvaeTaskConfig, Params) {
        (self.config, self.params.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// Its parameters by name, to be written into another file.
    pub fn tensors(&self) -> Vec<(String, tch::Tensor)> {
        let params = self.params.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        params.named(params.weights()).map(|(n, t)| (n.to_string(), t.detach())).collect()
    }
}
