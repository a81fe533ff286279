//! The tasks by name: the one place that knows them all.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use riglab_config::Config;
use riglab_report::Block;
use riglab_task::fsq_cvae::{Evaluation, FsqCvaeTask, FsqCvaeTaskConfig};
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

    /// The same with what is left to this machine decided: the precision.
    pub fn settled(mut self) -> Self {
        match &mut self {
            Self::FsqCvae(c) => c.train.precision = c.train.precision.resolved(),
        }
        self
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

/// The part of a run's report that its task knows how to show; empty before the first evaluation.
pub fn evaluation_blocks(task: &str, run: &Path) -> Result<Vec<Block>> {
    let path = run.join("eval.json");
    if !path.exists() {
        return Ok(Vec::new());
    }
    let shown = || path.display();
    let text = std::fs::read_to_string(&path).with_context(|| format!("{} cannot be read", shown()))?;
    match task {
        "fsq_cvae" => {
            let evaluation: Evaluation = serde_json::from_str(&text)
                .with_context(|| format!("{} cannot be understood; make it anew with `riglab eval`", shown()))?;
            Ok(evaluation.blocks(|file| std::fs::read(run.join("eval").join(file)).ok()))
        }
        _ => bail!("{}: run.json names no known task (`{task}`)", run.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets;

    #[test]
    fn every_built_in_experiment_is_sound_and_survives_being_resolved() {
        let names = presets::experiments();
        assert!(names.len() >= 6, "{names:?}");
        for name in names {
            let config = presets::load(&name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            let read = TaskConfig::read(&config).unwrap_or_else(|e| panic!("{name}: {e}"));
            let text = read.to_toml().unwrap();
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("config.toml");
            std::fs::write(&path, &text).unwrap();
            let again = TaskConfig::read(&presets::load(path.to_str().unwrap(), &[]).unwrap()).unwrap();
            assert_eq!(again.to_toml().unwrap(), text, "{name}");
        }
    }
}
