//! A trained skeleton model as others start from it.

use std::path::Path;

use riglab_config::Config;
use riglab_nn::params::Params;
use riglab_train::Checkpoint;
use tch::Device;

use super::{SkeletonTask, SkeletonTaskConfig};
use crate::bundle::Bundle;
use crate::grpo::{descends, refined};

/// Its task.
const KIND: &str = "unirig_skeleton";

/// Settings and weights.
pub(crate) struct Trained {
    pub config: SkeletonTaskConfig,
    pub params: Params,
}

impl Trained {
    /// Of a run's folder, its best checkpoint, or of a file that `riglab checkpoint import` made; of a run of GRPO, what
    /// became of such a model. `None` where it is of another task.
    ///
    /// # Errors
    /// A sentence: what cannot be read.
    pub fn open(path: &Path, device: Device) -> Result<Option<Self>, String> {
        if path.is_dir() {
            descends(path)?;
            let file = path.join("config.toml");
            let text = std::fs::read_to_string(&file).map_err(|e| absent(&file, &e))?;
            let name = file.to_string_lossy();
            let own = match refined(&name, &text)? {
                Some(start) if start.as_os_str().is_empty() => None,
                Some(start) => Self::open(&start, device)?,
                None => Self::of_settings(&name, &text, device)?,
            };
            let Some(own) = own else { return Ok(None) };
            let checkpoint = Checkpoint::open(&path.join("checkpoints").join("best")).map_err(|e| e.to_string())?;
            checkpoint.load_weights(&own.params).map_err(|e| e.to_string())?;
            return Ok(Some(own));
        }
        let name = path.to_string_lossy();
        let bytes = std::fs::read(path).map_err(|e| absent(path, &e))?;
        let Bundle { kind, settings, tensors, .. } = Bundle::of_bytes(&bytes, &name)?;
        if kind != KIND {
            return Ok(None);
        }
        let own = Self::of_settings(&name, &settings, device)?;
        let own = own.ok_or_else(|| format!("{name}: the settings inside are of another task"))?;
        own.params.load(&tensors).map_err(|e| format!("{name}: {e}"))?;
        Ok(Some(own))
    }

    /// With starting weights.
    fn of_settings(name: &str, text: &str, device: Device) -> Result<Option<Self>, String> {
        let config = Config::from_toml_str(name, text).map_err(|e| e.to_string())?;
        if config.get_at::<String>("task").unwrap_or_default() != KIND {
            return Ok(None);
        }
        let config: SkeletonTaskConfig = config.bounded().and_then(|c| c.get()).map_err(|e| e.to_string())?;
        config.validate().map_err(|(key, message)| format!("{name}: {key}: {message}"))?;
        let (_, params) = SkeletonTask::network(&config, device).map_err(|e| format!("{name}: {e}"))?;
        Ok(Some(Self { config, params }))
    }
}

fn absent(path: &Path, e: &std::io::Error) -> String {
    let path = path.display();
    format!("{path}: no model to start from ({e}); give start.model the folder of a run, or a model's file")
}
