//! The tasks by name: the one place that knows them all.

use anyhow::{Result, anyhow, bail};
use riglab_config::Config;
use riglab_task::fsq_cvae::{FsqCvaeTask, FsqCvaeTaskConfig};
use riglab_train::TrainConfig;
use tch::Device;

/// A task's settings, checked.
pub enum TaskConfig {
    /// `fsq_cvae`
    FsqCvae(Box<FsqCvaeTaskConfig>),
}

const NAMES: [&str; 1] = ["fsq_cvae"];

impl TaskConfig {
    /// Reads and checks a config; faults name the line that set the value.
    pub fn read(config: &Config) -> Result<Self> {
        let name: String = match config.contains("task") {
            true => config.get_at("task")?,
            false => bail!("the config says no `task`; add for instance task = \"fsq_cvae\""),
        };
        match name.as_str() {
            "fsq_cvae" => {
                let c: FsqCvaeTaskConfig = config.get()?;
                c.validate().map_err(|(key, message)| config.invalid(&key, message))?;
                Ok(Self::FsqCvae(Box::new(c)))
            }
            _ => {
                Err(config.invalid("task", format!("there is no task `{name}`; there is: {}", NAMES.join(", "))).into())
            }
        }
    }

    /// How it trains.
    pub fn train(&self) -> &TrainConfig {
        match self {
            Self::FsqCvae(c) => &c.train,
        }
    }

    /// Everything, defaults included, as TOML: reading it back gives the same run.
    pub fn to_toml(&self) -> Result<String> {
        match self {
            Self::FsqCvae(c) => Ok(toml::to_string(c.as_ref())?),
        }
    }

    /// Opens data and network.
    pub fn open(&self, device: Device) -> Result<FsqCvaeTask> {
        match self {
            Self::FsqCvae(c) => FsqCvaeTask::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e)),
        }
    }
}
