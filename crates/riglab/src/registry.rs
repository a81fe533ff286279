//! The tasks by name: the one place that knows them all.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use riglab_config::Config;
use riglab_report::{Block, Findings};
use riglab_task::Experiment;
use riglab_task::assets::DataConfig;
use riglab_task::fsq_cvae::{self, FsqCvaeTask, FsqCvaeTaskConfig};
use riglab_task::grpo::{self, GrpoTask, GrpoTaskConfig};
use riglab_task::seen::{Seen, warning};
use riglab_task::settings::TaskSettings;
use riglab_task::tokenrig::{self, Rigger, TokenRigTask, TokenRigTaskConfig};
use riglab_task::unirig_skeleton::{self, SkeletonTask, SkeletonTaskConfig};
use riglab_task::unirig_skin::{self, SkinTask, SkinTaskConfig};
use riglab_train::TrainConfig;
use tch::Device;

/// A task's settings, checked.
pub enum TaskConfig {
    /// `fsq_cvae`
    FsqCvae(Box<FsqCvaeTaskConfig>),
    /// `grpo`
    Grpo(Box<GrpoTaskConfig>),
    /// `tokenrig`
    TokenRig(Box<TokenRigTaskConfig>),
    /// `unirig_skeleton`
    UnirigSkeleton(Box<SkeletonTaskConfig>),
    /// `unirig_skin`
    UnirigSkin(Box<SkinTaskConfig>),
}

const NAMES: [&str; 5] = [
    FsqCvaeTaskConfig::TASK,
    GrpoTaskConfig::TASK,
    TokenRigTaskConfig::TASK,
    SkeletonTaskConfig::TASK,
    SkinTaskConfig::TASK,
];

/// As a task's settings; a fault of one that no type says is told with the line that set it.
fn checked<T: TaskSettings>(config: &Config) -> Result<Box<T>> {
    let settings: T = config.get()?;
    settings.check().map_err(|(key, message)| config.invalid(&key, message))?;
    Ok(Box::new(settings))
}

/// Something done with a task, whichever it is.
pub trait Visitor {
    /// What comes of it.
    type Out;

    /// Does it.
    fn visit<T: Experiment>(self, task: T) -> Result<Self::Out>;
}

/// The same for every task's settings.
macro_rules! each {
    ($config:expr, $c:ident => $what:expr) => {
        match $config {
            TaskConfig::FsqCvae($c) => $what,
            TaskConfig::Grpo($c) => $what,
            TaskConfig::TokenRig($c) => $what,
            TaskConfig::UnirigSkeleton($c) => $what,
            TaskConfig::UnirigSkin($c) => $what,
        }
    };
}

impl TaskConfig {
    /// Of the run in a folder: finds what the folder holds beside the config.
    pub fn of_run(mut self, run: &Path) -> Self {
        if let Self::TokenRig(c) = &mut self {
            Rigger::own_auto_encoder(run, c);
        }
        self
    }

    /// Reads and checks a config; faults name the line that set the value. What it says of a cluster is checked and is
    /// no part of a task's settings.
    pub fn read(config: &Config) -> Result<Self> {
        crate::commands::slurm::settings(config)?;
        let config = &config.clone().without("slurm").bounded()?;
        let name: String = match config.contains("task") {
            true => config.get_at("task")?,
            false => {
                let remedy = format!("add for instance `task = \"{}\"`; there are: {}", NAMES[0], NAMES.join(", "));
                return Err(config.lacks("task", remedy).into());
            }
        };
        match name.as_str() {
            FsqCvaeTaskConfig::TASK => checked(config).map(Self::FsqCvae),
            GrpoTaskConfig::TASK => checked(config).map(Self::Grpo),
            TokenRigTaskConfig::TASK => checked(config).map(Self::TokenRig),
            SkeletonTaskConfig::TASK => checked(config).map(Self::UnirigSkeleton),
            SkinTaskConfig::TASK => checked(config).map(Self::UnirigSkin),
            _ => Err(config
                .invalid("task", format!("there is no task `{name}`; there are: {}", NAMES.join(", ")))
                .into()),
        }
    }

    /// How it trains.
    pub fn train(&self) -> &TrainConfig {
        each!(self, c => &c.train)
    }

    /// The corpora it reads.
    pub fn data(&self) -> &DataConfig {
        each!(self, c => &c.data)
    }

    /// Whether an evaluation chooses the cut of a decode rule among several.
    pub fn chooses_a_cut(&self) -> bool {
        match self {
            Self::FsqCvae(c) => c.eval.cuts.len() > 1,
            Self::UnirigSkin(c) => c.eval.cuts.len() > 1,
            Self::Grpo(_) | Self::TokenRig(_) | Self::UnirigSkeleton(_) => false,
        }
    }

    /// The same with what is left to this machine decided: the precision.
    pub fn settled(mut self) -> Self {
        each!(&mut self, c => c.train.precision = c.train.precision.resolved());
        if let Self::Grpo(c) = &mut self {
            c.rollout.precision = c.rollout.precision.resolved();
        }
        self
    }

    /// Everything, defaults included, as TOML: reading it back gives the same run.
    pub fn to_toml(&self) -> Result<String> {
        each!(self, c => Ok(toml::to_string(c.as_ref())?))
    }

    /// Opens data and network, and hands the task on.
    pub fn with<V: Visitor>(&self, device: Device, visitor: V) -> Result<V::Out> {
        match self {
            Self::FsqCvae(c) => visitor.visit(FsqCvaeTask::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e))?),
            Self::Grpo(c) => visitor.visit(GrpoTask::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e))?),
            Self::TokenRig(c) => visitor.visit(TokenRigTask::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e))?),
            Self::UnirigSkeleton(c) => {
                visitor.visit(SkeletonTask::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e))?)
            }
            Self::UnirigSkin(c) => visitor.visit(SkinTask::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e))?),
        }
    }
}

/// What a run's evaluation says, as its task knows to show it.
pub struct Evaluated {
    /// The task's part of the report.
    pub blocks: Vec<Block>,
    /// The same in the form in which runs are compared.
    pub findings: Vec<Findings>,
    /// The corpora whose assets it saw: path and checksum; empty in files that do not say it.
    pub corpora: Vec<(String, String)>,
    /// The step of the checkpoint.
    pub step: Option<u64>,
    /// Settings with which it was made that are not the run's, as KEY=VALUE.
    pub sets: Vec<String>,
    /// What is to be said where assets were tested on that were trained on.
    pub warning: Option<String>,
}

/// The folder of an evaluation's pictures, beside its file.
pub fn pictures(evaluation: &Path) -> PathBuf {
    match evaluation.with_extension("") {
        // A name without an ending is the file's.
        same if same == evaluation => evaluation.with_extension("pictures"),
        folder => folder,
    }
}

/// Reads an evaluation of a run, `eval.json` or what `riglab eval --out` wrote; `None` where there is no such file.
pub fn evaluation(task: &str, run: &Path, path: &Path) -> Result<Option<Evaluated>> {
    if !path.exists() {
        return Ok(None);
    }
    let shown = || path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("{} cannot be read", shown()))?;
    let folder = pictures(path);
    let picture = |file: &str| std::fs::read(folder.join(file)).ok();
    let unclear =
        || format!("{} cannot be understood: cut off, or of another version; make it anew with `riglab eval`", shown());
    let saw: serde_json::Value = serde_json::from_str(&text).with_context(unclear)?;
    let word = |v: &serde_json::Value| v.as_str().unwrap_or_default().to_owned();
    if let Some(other) = saw["checkpoint"]["task"].as_str().filter(|other| *other != task) {
        bail!(
            "{}: an evaluation of a run of task `{other}`, and {} is of `{task}`; give an evaluation of this run",
            shown(),
            run.display()
        );
    }
    let names: Vec<String> = saw["trained_on"].as_array().into_iter().flatten().map(word).collect();
    let warned = warning(&Seen { names, splits: vec!["the splits that were evaluated".into()] });
    // One of which no asset was looked at, as of bare meshes to train on, says nothing of the figures. Earlier versions did
    // not count.
    let corpora = saw["data"].as_array().into_iter().flatten().filter(|d| d[3] != 0);
    let corpora = corpora.map(|d| (word(&d[0]), word(&d[1]))).collect();
    let step = saw["checkpoint"]["step"].as_u64();
    let sets: Vec<String> = saw["set"].as_array().into_iter().flatten().map(word).collect();
    macro_rules! read {
        ($task:ident) => {{
            let evaluation: $task::Evaluation = serde_json::from_str(&text).with_context(unclear)?;
            let mut blocks = Vec::from_iter(warned.clone().map(Block::Text));
            blocks.extend(evaluation.blocks(picture));
            let findings = evaluation.findings();
            Ok(Some(Evaluated { blocks, findings, corpora, step, sets, warning: warned }))
        }};
    }
    match task {
        "fsq_cvae" => read!(fsq_cvae),
        "grpo" => read!(grpo),
        "tokenrig" => read!(tokenrig),
        "unirig_skeleton" => read!(unirig_skeleton),
        "unirig_skin" => read!(unirig_skin),
        _ => bail!("{}: run.json names no known task (`{task}`)", run.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets;

    #[test]
    fn an_evaluation_is_of_a_task_and_of_the_corpora_it_looked_at() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("eval.json");
        let write = |task: &str, data: &str| {
            let state =
                format!("\"task\": \"{task}\", \"step\": 2, \"seed\": 0, \"skipped\": 0, \"skipped_in_a_row\": 0");
            let report = "\"convention\": \"unirig\", \"rows\": [], \"gains\": [], \"assets\": []";
            let text = format!(
                "{{\"data\": {data}, \"checkpoint\": {{{state}, \"best\": null}}, \"report\": {{{report}}}, \"gallery\": []}}"
            );
            std::fs::write(&path, text).unwrap();
        };
        let corpora = || evaluation("grpo", dir.path(), &path).unwrap().unwrap().corpora;
        let two = |more: &str| {
            format!("[[\"rigs.h5\", \"ab\", 60{more}], [\"meshes.h5\", \"cd\", 9{}]]", more.replace('8', "0"))
        };
        let (rigs, meshes) = (("rigs.h5".to_owned(), "ab".to_owned()), ("meshes.h5".to_owned(), "cd".to_owned()));
        write("grpo", &two(", 8"));
        assert_eq!(corpora(), std::slice::from_ref(&rigs));
        write("grpo", &two(""));
        assert_eq!(corpora(), [rigs, meshes], "it does not say");
        write("fsq_cvae", "[]");
        let said = evaluation("grpo", dir.path(), &path).err().unwrap().to_string();
        assert!(
            said.contains("eval.json: an evaluation of a run of task `fsq_cvae`") && said.contains("`grpo`"),
            "{said}"
        );
    }

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
