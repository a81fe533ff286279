//! The tasks by name: the one place that knows them all.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use riglab_config::Config;
use riglab_report::{Block, Findings};
use riglab_task::Experiment;
use riglab_task::assets::{Assets, DataConfig};
use riglab_task::seen::{SeenAssets, Training, warning};
use riglab_task::settings::TaskSettings;
use riglab_task::{fsq_cvae, grpo, tokenrig, unirig_skeleton, unirig_skin};
use riglab_train::{Precision, TrainConfig};
use tch::Device;

/// Makes of the list of all tasks what is said for each of them.
macro_rules! tasks {
    ($($(#[$doc:meta])* $name:ident: $module:ident::{$task:ident, $config:ident},)*) => {
        /// A task's settings, checked.
        pub enum TaskConfig {
            $($(#[$doc])* $name(Box<$module::$config>),)*
        }

        const NAMES: &[&str] = &[$($module::$config::TASK),*];

        impl TaskConfig {
            /// Those of the task of this name; `None` where there is none.
            fn named(name: &str, config: &Config) -> Option<Result<Self>> {
                match name {
                    $($module::$config::TASK => Some(checked(config).map(Self::$name)),)*
                    _ => None,
                }
            }

            /// The task's name.
            pub fn task(&self) -> &'static str {
                match self {
                    $(Self::$name(_) => $module::$config::TASK,)*
                }
            }

            fn settings(&self) -> &dyn Settings {
                match self {
                    $(Self::$name(c) => c.as_ref(),)*
                }
            }

            fn settings_mut(&mut self) -> &mut dyn Settings {
                match self {
                    $(Self::$name(c) => c.as_mut(),)*
                }
            }

            /// Opens data and network, and hands the task on.
            pub fn with<V: Visitor>(&self, device: Device, visitor: V) -> Result<V::Out> {
                match self {
                    $(Self::$name(c) => {
                        visitor.visit($module::$task::new(c.as_ref().clone(), device).map_err(|e| anyhow!(e))?)
                    })*
                }
            }
        }

        /// What an evaluation of the task of this name says, with its pictures; `None` where there is no such task.
        fn of_task(name: &str, text: &str, picture: impl Fn(&str) -> Option<Vec<u8>>) -> Option<serde_json::Result<Shown>> {
            match name {
                $($module::$config::TASK => Some(
                    serde_json::from_str::<$module::Evaluation>(text).map(|e| (e.blocks(picture), e.findings())),
                ),)*
                _ => None,
            }
        }
    };
}

tasks! {
    /// `fsq_cvae`
    FsqCvae: fsq_cvae::{FsqCvaeTask, FsqCvaeTaskConfig},
    /// `grpo`
    Grpo: grpo::{GrpoTask, GrpoTaskConfig},
    /// `tokenrig`
    TokenRig: tokenrig::{TokenRigTask, TokenRigTaskConfig},
    /// `unirig_skeleton`
    UnirigSkeleton: unirig_skeleton::{SkeletonTask, SkeletonTaskConfig},
    /// `unirig_skin`
    UnirigSkin: unirig_skin::{SkinTask, SkinTaskConfig},
}

/// A task's part of the report, and the same in the form in which runs are compared.
type Shown = (Vec<Block>, Vec<Findings>);

/// [`TaskSettings`] of whichever task.
trait Settings {
    fn train(&self) -> &TrainConfig;
    fn data(&self) -> &DataConfig;
    fn training(&self) -> Training;
    fn precisions(&mut self) -> Vec<&mut Precision>;
    fn in_run(&mut self, run: &Path);
    fn chooses_a_cut(&self) -> bool;
    fn takes_bare_meshes(&self) -> bool;
    fn to_toml(&self) -> Result<String>;
}

impl<T: TaskSettings> Settings for T {
    fn train(&self) -> &TrainConfig {
        TaskSettings::train(self)
    }

    fn data(&self) -> &DataConfig {
        TaskSettings::data(self)
    }

    fn training(&self) -> Training {
        Training::of(self)
    }

    fn precisions(&mut self) -> Vec<&mut Precision> {
        TaskSettings::precisions(self)
    }

    fn in_run(&mut self, run: &Path) {
        TaskSettings::in_run(self, run);
    }

    fn chooses_a_cut(&self) -> bool {
        TaskSettings::chooses_a_cut(self)
    }

    fn takes_bare_meshes(&self) -> bool {
        TaskSettings::takes_bare_meshes(self)
    }

    fn to_toml(&self) -> Result<String> {
        Ok(toml::to_string(self)?)
    }
}

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

impl TaskConfig {
    /// Of the run in a folder: finds what the folder holds beside the config.
    pub fn of_run(mut self, run: &Path) -> Self {
        self.settings_mut().in_run(run);
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
        Self::named(&name, config).unwrap_or_else(|| {
            Err(config.invalid("task", format!("there is no task `{name}`; there are: {}", NAMES.join(", "))).into())
        })
    }

    /// How it trains.
    pub fn train(&self) -> &TrainConfig {
        self.settings().train()
    }

    /// The corpora it reads.
    pub fn data(&self) -> &DataConfig {
        self.settings().data()
    }

    /// Which assets it trains on.
    pub fn training(&self) -> Training {
        self.settings().training()
    }

    /// Whether an evaluation chooses the cut of a decode rule among several.
    pub fn chooses_a_cut(&self) -> bool {
        self.settings().chooses_a_cut()
    }

    /// Opens the corpora as the task does, without its network.
    ///
    /// # Errors
    /// A sentence: as [`Assets::of`], or of bare meshes, where the task needs rigs.
    pub fn assets(&self) -> Result<Assets, String> {
        let (assets, ..) = Assets::of(self.data())?;
        if !self.settings().takes_bare_meshes() {
            assets.rigged(self.data())?;
        }
        Ok(assets)
    }

    /// The same with what is left to this machine decided: the precision.
    pub fn settled(self) -> Self {
        self.settled_to(Precision::Auto.resolved())
    }

    /// The same with what is left to a machine decided so.
    pub fn settled_to(mut self, auto: Precision) -> Self {
        self.left().for_each(|own| *own = auto);
        self
    }

    /// What is left to the machine that trains.
    pub fn left(&mut self) -> impl Iterator<Item = &mut Precision> {
        self.settings_mut().precisions().into_iter().filter(|own| **own == Precision::Auto)
    }

    /// Has what is left to a machine be as in settings of the same task that may have it decided; gives the first that they
    /// have.
    pub fn settle_as(&mut self, other: &mut Self) -> Option<Precision> {
        let pairs = self.settings_mut().precisions().into_iter().zip(other.settings_mut().precisions());
        let mut first = None;
        for (own, other) in pairs.filter(|(own, other)| **own == Precision::Auto && **other != Precision::Auto) {
            *own = *other;
            first = first.or(Some(*other));
        }
        first
    }

    /// Everything, defaults included, as TOML: reading it back gives the same run.
    pub fn to_toml(&self) -> Result<String> {
        self.settings().to_toml()
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
    /// What is to be said where assets were tested on that were trained on, or other models were taken than the run's.
    pub warning: Option<String>,
}

/// The folder of an evaluation's pictures, beside its file.
pub fn pictures(evaluation: &Path) -> PathBuf {
    match evaluation.extension() {
        Some(ending) if ending.eq_ignore_ascii_case("json") => evaluation.with_extension(""),
        _ => riglab_files::beside(evaluation, &[], "pictures"),
    }
}

/// Where the pictures of an evaluation are that was made before: earlier versions took what stands behind the last point of a
/// name for an ending, whatever it was.
pub fn pictures_there(evaluation: &Path) -> PathBuf {
    let (own, earlier) = (pictures(evaluation), evaluation.with_extension(""));
    if own.is_dir() || earlier == evaluation { own } else { earlier }
}

/// Reads an evaluation of a run, `eval.json` or what `riglab eval --out` wrote; `None` where there is no such file.
pub fn evaluation(task: &str, run: &Path, path: &Path) -> Result<Option<Evaluated>> {
    if !path.exists() {
        return Ok(None);
    }
    let shown = || path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("{} cannot be read", shown()))?;
    let folder = pictures_there(path);
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
    let seen = warning(&SeenAssets { names, splits: vec!["the splits that were evaluated".into()] }, None);
    let others = saw["other_models"].as_array().into_iter().flatten().map(|said| word(said) + ".");
    let warned: Vec<String> = seen.into_iter().chain(others).collect();
    // One of which no asset was looked at, as of bare meshes to train on, says nothing of the figures. Earlier versions did
    // not count.
    let corpora = saw["data"].as_array().into_iter().flatten().filter(|d| d[3] != 0);
    let corpora = corpora.map(|d| (word(&d[0]), word(&d[1]))).collect();
    let step = saw["checkpoint"]["step"].as_u64();
    let sets: Vec<String> = saw["set"].as_array().into_iter().flatten().map(word).collect();
    let Some(said) = of_task(task, &text, picture) else {
        bail!("{}: run.json names no known task (`{task}`)", run.display());
    };
    let (own, findings) = said.with_context(unclear)?;
    let warning = (!warned.is_empty()).then(|| warned.join(" "));
    let blocks = warned.into_iter().map(Block::Text).chain(own).collect();
    Ok(Some(Evaluated { blocks, findings, corpora, step, sets, warning }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets;

    #[test]
    fn each_evaluation_has_pictures_of_its_own_and_those_of_earlier_versions_are_found() {
        let dir = tempfile::tempdir().unwrap();
        let names = ["eval.json", "best", "step.100", "step.200"];
        let of = |find: fn(&Path) -> PathBuf| {
            names.map(|name| find(&dir.path().join(name)).file_name().unwrap().to_string_lossy().into_owned())
        };
        let own = ["eval", "best.pictures", "step.100.pictures", "step.200.pictures"];
        assert_eq!(of(pictures), own);
        std::fs::create_dir(dir.path().join("step.100.pictures")).unwrap();
        assert_eq!(of(pictures_there), ["eval", "best.pictures", "step.100.pictures", "step"]);
    }

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
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replacen('{', "{\"other_models\": [\"start.model names another\"],", 1)).unwrap();
        let read = evaluation("grpo", dir.path(), &path).unwrap().unwrap();
        assert_eq!(read.warning.as_deref(), Some("start.model names another."));
        assert!(matches!(&read.blocks[0], Block::Text(said) if said == "start.model names another."));
        write("fsq_cvae", "[]");
        let said = evaluation("grpo", dir.path(), &path).err().unwrap().to_string();
        assert!(
            said.contains("eval.json: an evaluation of a run of task `fsq_cvae`") && said.contains("`grpo`"),
            "{said}"
        );
    }

    #[test]
    fn every_built_in_experiment_is_sound_and_survives_being_resolved() {
        let all = presets::experiments();
        assert!(all.len() >= 6, "{all:?}");
        for (name, _) in all {
            let config = presets::load(name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
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
