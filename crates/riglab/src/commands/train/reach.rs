//! Whether a run that is named from any folder finds what it names by relative paths, and the command that goes on with it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use riglab_report::shell::{command, quoted};
use riglab_task::seen::models;
use riglab_train::RunInfo;

use crate::commands::shown;
use crate::registry::TaskConfig;

/// Refuses to go on with what no training goes on with; `again` gives the arguments that ask for it from any folder.
pub(super) fn may_go_on(run: &Path, config: &TaskConfig, again: impl Fn() -> Vec<String>) -> Result<()> {
    if config.data().corpora.is_empty() {
        bail!(
            "{}: a model that was exported, of which no training goes on: it has no corpora and no state of an optimizer; a \
             new training begins with its weights by --set train.start.from={}",
            run.display(),
            shown(run)
        );
    }
    reached(run, config, again, "")
}

/// Refuses a run whose corpora or models are named by paths that lead nowhere from this folder, though they did from the one
/// where it was begun; `again` gives the arguments of the same command for any folder. `remedy`: what else helps where a file
/// is nowhere.
pub fn reached(run: &Path, config: &TaskConfig, again: impl Fn() -> Vec<String>, remedy: &str) -> Result<()> {
    let here = std::env::current_dir().context("there is no working folder")?;
    let folder = RunInfo::of(run).map(|info| PathBuf::from(info.folder));
    let begun = |path: &Path| folder.as_ref().filter(|folder| folder.join(path).exists());
    let gone = |path: &Path| path.is_relative() && !path.exists();
    let settings = toml::Value::Table(config.to_toml()?.parse()?);
    // Of a model that is not there either, who opens it tells.
    let model = models(&settings).map(|(key, named)| (key, Path::new(named)));
    let mut model = model.filter(|(_, path)| gone(path) && !run.join(path).exists() && begun(path).is_some());
    let corpus = config.data().corpora.iter().find(|path| gone(path));
    let Some((what, path)) = corpus.map(|path| ("its corpus", path.as_path())).or_else(|| model.next()) else {
        return Ok(());
    };
    let hint = match begun(path) {
        Some(folder) => {
            format!("cd {} && {}", quoted(&shown(folder)), command(again().iter().map(String::as_str)))
        }
        // Here it was begun, and it is not below this folder any more.
        None if folder.as_ref() == Some(&here) => format!("put it back where it was{remedy}"),
        None => format!("start it in the folder where the run was begun{remedy}"),
    };
    bail!(
        "{}: {what} {} is not below this folder, {}: a run's relative paths start where it was begun\n\nhint: {hint}",
        run.display(),
        path.display(),
        here.display()
    )
}

/// The arguments that go on with a run from any folder, as it is asked for.
pub(super) fn again(run: &Path, sets: &[String]) -> Vec<String> {
    let sets = sets.iter().flat_map(|set| ["--set".into(), set.clone()]);
    ["train".into(), "--resume".into(), whole(run)].into_iter().chain(sets).collect()
}

/// A path from the root.
pub fn whole(path: &Path) -> String {
    shown(&std::path::absolute(path).unwrap_or_else(|_| path.into()))
}
