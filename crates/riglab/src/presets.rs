//! The configs and experiments of the source tree, compiled in: the program works without it.

use std::path::PathBuf;

use include_dir::{Dir, include_dir};
use riglab_config::{Config, ConfigError, Loader};

static CONFIGS: Dir = include_dir!("$CARGO_MANIFEST_DIR/../../configs");
static EXPERIMENTS: Dir = include_dir!("$CARGO_MANIFEST_DIR/../../experiments");

/// Loads a config: a file, or an experiment that is compiled in by its name
/// (`quickstart/fsq_cvae.toml`). What it extends is looked up beside it, in `configs/` and
/// `experiments/` of the working folder, then among the compiled-in ones.
pub fn load(name: &str, sets: &[String]) -> Result<Config, ConfigError> {
    let built_in = [texts(&CONFIGS), texts(&EXPERIMENTS)].concat();
    let search = [PathBuf::from("configs"), PathBuf::from("experiments")];
    let loader = Loader::new().search(&search).built_in(&built_in);
    let wanted = name.strip_prefix("experiments/").unwrap_or(name);
    match EXPERIMENTS.get_file(wanted).and_then(|f| f.contents_utf8()) {
        Some(text) if !PathBuf::from(name).is_file() => loader.parse(&format!("built-in {name}"), text, sets),
        _ => loader.load(name, sets),
    }
}

/// Reads a text as a config, called `name` in messages.
pub fn parse(name: &str, text: &str, sets: &[String]) -> Result<Config, ConfigError> {
    Loader::new().parse(name, text, sets)
}

/// Loads a building block by itself: a file, or one of `configs/` that is compiled in by its name
/// (`curation/rig_xl.toml`).
pub fn load_block(name: &str, sets: &[String]) -> Result<Config, ConfigError> {
    let built_in = texts(&CONFIGS);
    let search = [PathBuf::from("configs")];
    let loader = Loader::new().search(&search).built_in(&built_in);
    let wanted = name.strip_prefix("configs/").unwrap_or(name);
    match CONFIGS.get_file(wanted).and_then(|f| f.contents_utf8()) {
        Some(text) if !PathBuf::from(name).is_file() => loader.parse(&format!("built-in {name}"), text, sets),
        _ => loader.load(name, sets),
    }
}

/// The experiments of one run that are compiled in.
pub fn experiments() -> Vec<String> {
    named(|text| !is_sweep(text))
}

/// The sweeps that are compiled in.
pub fn sweeps() -> Vec<String> {
    named(is_sweep)
}

fn named(wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let all = texts(&EXPERIMENTS).into_iter().filter(|(_, text)| wanted(text));
    let mut names: Vec<String> = all.map(|(name, _)| name.to_string()).collect();
    names.sort();
    names
}

fn is_sweep(text: &str) -> bool {
    text.lines().any(|line| line.trim() == "[sweep]")
}

fn texts(dir: &'static Dir<'static>) -> Vec<(&'static str, &'static str)> {
    let mut all = Vec::new();
    let mut open = vec![dir];
    while let Some(dir) = open.pop() {
        open.extend(dir.dirs());
        for file in dir.files() {
            let toml = file.path().extension().is_some_and(|e| e == "toml");
            if let (true, Some(name), Some(text)) = (toml, file.path().to_str(), file.contents_utf8()) {
                all.push((name, text));
            }
        }
    }
    all
}
