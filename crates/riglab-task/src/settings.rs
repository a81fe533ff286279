//! The settings that a run's folder or a model's file holds.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use riglab_config::{Config, Loader};
use riglab_token::Limits;
use riglab_train::{Precision, RunInfo, TrainConfig};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::assets::DataConfig;

/// What a task is set by.
pub trait TaskSettings: DeserializeOwned + Serialize {
    /// The task, as `task` names it.
    const TASK: &'static str;

    /// Checks what no type says.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    fn check(&self) -> Result<(), (String, String)>;

    /// How it trains.
    fn train(&self) -> &TrainConfig;

    /// The corpora it reads.
    fn data(&self) -> &DataConfig;

    /// How it trains, to be changed.
    fn train_mut(&mut self) -> &mut TrainConfig;

    /// What may be left to a machine: precisions, where they are `auto`.
    fn precisions(&mut self) -> Vec<&mut Precision> {
        vec![&mut self.train_mut().precision]
    }

    /// The longest sequences that it trains on, where it trains on sequences of rigs.
    fn limits(&self) -> Option<Limits> {
        None
    }

    /// Finds what the folder of a run holds beside its config.
    fn in_run(&mut self, _run: &Path) {}

    /// Whether an evaluation chooses the cut of a decode rule among several.
    fn chooses_a_cut(&self) -> bool {
        false
    }

    /// Whether it looks at meshes alone, so that they may be without rigs.
    fn takes_bare_meshes(&self) -> bool {
        false
    }
}

/// What is the same in all [`TaskSettings`]: a check of their own, and the fields `train` and `data`.
macro_rules! own_settings {
    () => {
        fn check(&self) -> Result<(), (String, String)> {
            self.validate()
        }

        fn train(&self) -> &riglab_train::TrainConfig {
            &self.train
        }

        fn train_mut(&mut self) -> &mut riglab_train::TrainConfig {
            &mut self.train
        }

        fn data(&self) -> &crate::assets::DataConfig {
            &self.data
        }
    };
}
pub(crate) use own_settings;

/// Checks that a list names nothing twice: what it names is counted once for each time.
///
/// # Errors
/// (key, message) of the first that comes again.
pub(crate) fn distinct<T: PartialEq + Display>(key: &str, list: &[T]) -> Result<(), (String, String)> {
    match (1..list.len()).find(|&k| list[..k].contains(&list[k])) {
        Some(k) => Err((key.into(), format!("{} is named twice, and would count twice: name it once", list[k]))),
        None => Ok(()),
    }
}

/// The largest weight of a part of a loss: gradients of what is far larger pass what single precision holds, and beside it
/// the other parts lose their digits.
const HEAVIEST: f64 = 1e6;

/// Checks the weights of a loss, by the keys they have.
///
/// # Errors
/// (key, message) of the first that is no weight.
pub(crate) fn weights(all: &[(&str, f64)]) -> Result<(), (String, String)> {
    match all.iter().find(|(_, weight)| !(0.0..=HEAVIEST).contains(weight)) {
        Some((key, weight)) => Err(((*key).into(), format!("a weight of {weight:?} must lie in [0, {HEAVIEST}]"))),
        None => Ok(()),
    }
}

/// Settings that say where models lie which a run builds on: they may have been moved since.
pub const MODELS: [&str; 2] = ["start.model", "skin.run"];

/// Where the models and corpora are that a run names by paths which lead nowhere from here, though they do from the folder
/// where it was begun: as `--set` takes them.
pub fn places(run: &Path, config: &Config) -> Vec<String> {
    let begun = RunInfo::of(run).map(|info| PathBuf::from(info.folder)).filter(|begun| begun.is_absolute());
    let Some(begun) = begun else { return Vec::new() };
    let whole = |path: &PathBuf| {
        let here = path.is_absolute() || path.as_os_str().is_empty() || path.exists();
        Some(begun.join(path)).filter(|whole| !here && whole.exists())
    };
    let quoted = |path: PathBuf| toml::Value::String(path.display().to_string()).to_string();
    let place = |key: &&str| {
        let path = config.get_at::<PathBuf>(key).ok().filter(|path| !run.join(path).exists())?;
        Some(format!("{key}={}", quoted(whole(&path)?)))
    };
    let corpora: Vec<PathBuf> = config.get_at("data.corpora").unwrap_or_default();
    let moved = corpora.iter().any(|path| whole(path).is_some()).then(|| {
        let all: Vec<String> = corpora.iter().map(|path| quoted(whole(path).unwrap_or_else(|| path.clone()))).collect();
        format!("data.corpora=[{}]", all.join(", "))
    });
    MODELS.iter().filter_map(place).chain(moved).collect()
}

/// Settings as they are written, and where.
pub struct Settings {
    name: String,
    config: Config,
}

impl Settings {
    /// Of a run's folder.
    ///
    /// # Errors
    /// A sentence: no run there, or what cannot be understood.
    pub fn of_run(run: &Path) -> Result<Self, String> {
        Self::of_run_with(run, &[])
    }

    /// As [`Self::of_run`], with values changed as `--set` does. Models and corpora that a run names from the folder where it
    /// was begun are found from any other.
    ///
    /// # Errors
    /// As [`Self::of_run`].
    pub fn of_run_with(run: &Path, sets: &[String]) -> Result<Self, String> {
        let path = run.join("config.toml");
        let name = path.to_string_lossy();
        let shown = run.display();
        if run.is_file() {
            return Err(format!("{shown}: a file, and no run's folder"));
        }
        let text = std::fs::read_to_string(&path).map_err(|e| match run.exists() {
            true => format!("{shown}: no run here (config.toml: {e})"),
            false => format!("{shown}: there is no such file or folder"),
        })?;
        let read = |sets: &[String]| Loader::new().parse(&name, &text, sets).map_err(|e| e.to_string());
        let mut config = read(sets)?;
        let places = places(run, &config);
        if !places.is_empty() {
            config = read(&[sets, &places].concat())?;
        }
        Ok(Self { name: name.into(), config })
    }

    /// Of TOML; `name` stands in messages.
    ///
    /// # Errors
    /// A sentence: what cannot be understood.
    pub fn of_text(name: &str, text: &str) -> Result<Self, String> {
        let config = Config::from_toml_str(name, text).map_err(|e| e.to_string())?;
        Ok(Self { name: name.into(), config })
    }

    /// All of them.
    pub fn table(&self) -> toml::Table {
        self.config.get().unwrap_or_default()
    }

    /// Where they stand, for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The task that they are of; nothing where they do not say.
    pub fn task(&self) -> String {
        self.config.get_at("task").unwrap_or_default()
    }

    /// Whether they are of this task.
    pub fn are<T: TaskSettings>(&self) -> bool {
        self.task() == T::TASK
    }

    /// As those of a task, whichever they name.
    ///
    /// # Errors
    /// A sentence: what is unknown, missing or wrong, and its place.
    pub fn get<T: TaskSettings>(&self) -> Result<T, String> {
        let settings: T = self.config.clone().bounded().and_then(|c| c.get()).map_err(|e| e.to_string())?;
        settings.check().map_err(|(key, message)| format!("{}: {key}: {message}", self.name))?;
        Ok(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fsq_cvae::FsqCvaeTaskConfig;
    use crate::tokenrig::TokenRigTaskConfig;

    #[test]
    fn what_a_run_builds_on_is_found_from_any_folder() {
        let dir = tempfile::tempdir().unwrap();
        // A letter and its mark apart, as macOS writes names.
        let (run, begun) = (dir.path().join("run"), dir.path().join("be\u{300}gun"));
        std::fs::create_dir_all(&run).unwrap();
        std::fs::create_dir_all(begun.join("runs/ae")).unwrap();
        std::fs::write(begun.join("a.h5"), "").unwrap();
        let text = "[skin]\nrun = 'runs/ae'\n[start]\nmodel = 'runs/gone'\n[data]\ncorpora = ['a.h5', 'gone.h5']\n";
        std::fs::write(run.join("config.toml"), text).unwrap();
        let info = RunInfo { folder: begun.display().to_string(), ..RunInfo::default() };
        std::fs::write(run.join("run.json"), serde_json::to_string(&info).unwrap()).unwrap();
        let of = |sets: &[String]| {
            let settings = Settings::of_run_with(&run, sets).unwrap();
            ["skin.run", "start.model"].map(|key| settings.config.get_at::<PathBuf>(key).unwrap())
        };
        assert_eq!(of(&[]), [begun.join("runs/ae"), "runs/gone".into()]);
        let corpora: Vec<PathBuf> = Settings::of_run(&run).unwrap().config.get_at("data.corpora").unwrap();
        assert_eq!(corpora, [begun.join("a.h5"), "gone.h5".into()]);
        assert_eq!(of(&["skin.run='runs/other'".into()])[0], Path::new("runs/other"));
        // What is here, or in the run's own folder, is what is meant.
        std::fs::create_dir_all(run.join("runs/ae")).unwrap();
        assert_eq!(of(&[])[0], Path::new("runs/ae"));
    }

    #[test]
    fn what_is_named_twice_is_told() {
        assert_eq!(distinct("a", &[4, 16, 8]), Ok(()));
        let (key, message) = distinct("eval.prefixes", &[4, 16, 8, 16]).unwrap_err();
        assert!(key == "eval.prefixes" && message.starts_with("16 is named twice"), "{key}: {message}");
    }

    #[test]
    fn weights_of_a_loss_are_neither_negative_nor_beyond_what_gradients_hold() {
        assert_eq!(weights(&[("loss.a", 0.0), ("loss.b", 1e6)]), Ok(()));
        for wrong in [-1.0, -1e-30, 1e7, 1e30, f64::INFINITY, f64::NAN] {
            let (key, message) = weights(&[("loss.a", 1.0), ("loss.b", wrong)]).unwrap_err();
            assert!(key == "loss.b" && message.contains(&format!("{wrong:?}")), "{key}: {message}");
        }
    }

    #[test]
    fn a_run_says_its_task_and_faults_name_their_place() {
        let run = tempfile::tempdir().unwrap();
        let of = |text: &str| {
            std::fs::write(run.path().join("config.toml"), text).unwrap();
            Settings::of_run(run.path())
        };
        let found = of("task = 'fsq_cvae'\n[train]\nseed = 3\n").unwrap();
        assert!(found.are::<FsqCvaeTaskConfig>() && !found.are::<TokenRigTaskConfig>());
        assert_eq!(found.get::<FsqCvaeTaskConfig>().unwrap().train.seed, 3);
        assert_eq!(of("").unwrap().task(), "");
        let fault = |text: &str| of(text).and_then(|found| found.get::<FsqCvaeTaskConfig>()).err().unwrap();
        for (text, told) in [
            ("task = ", "config.toml"),
            ("[train]\nsteeps = 3", "steeps"),
            ("[model]\nlevels = []", "levels"),
            ("[eval]\nchunk = 0", "eval.chunk"),
        ] {
            let said = fault(text);
            assert!(said.contains("config.toml") && said.contains(told), "{said}");
        }
        let none = Settings::of_run(&run.path().join("elsewhere")).err().unwrap();
        assert!(none.ends_with("elsewhere: there is no such file or folder"), "{none}");
    }
}
