//! What a run of GRPO refines, which may be such a run itself.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use riglab_nn::params::{Params, Weights};
use riglab_train::{RunInfo, named_by, same_companions};

use super::config::GrpoTaskConfig;
use crate::experiment::checksum;
use crate::settings::Settings;
use crate::tokenrig::TokenRigTaskConfig;

/// Where a run of GRPO started (empty: the model that comes with riglab), by its settings; `None` where it is of another
/// task.
///
/// # Errors
/// A sentence: what cannot be understood.
pub(crate) fn refined(settings: &Settings) -> Result<Option<PathBuf>, String> {
    settings.are::<GrpoTaskConfig>().then(|| Ok(settings.get::<GrpoTaskConfig>()?.start.model)).transpose()
}

/// Sees that those that a run started from come to an end.
///
/// # Errors
/// A sentence: it starts from itself.
pub(crate) fn descends(run: &Path) -> Result<(), String> {
    let (mut seen, mut at) = (BTreeSet::new(), run.to_path_buf());
    // What cannot be read is told by who needs it.
    while let (Ok(full), Ok(settings)) = (at.canonicalize(), Settings::of_run(&at)) {
        if !seen.insert(full) {
            let run = run.display();
            return Err(format!(
                "{run}: starts from itself, by the start.model of its config.toml; name another model"
            ));
        }
        match refined(&settings) {
            Ok(Some(start)) if !start.as_os_str().is_empty() => at = named_by(&start).0,
            _ => break,
        }
    }
    Ok(())
}

/// The key that names the model that a run started from, and a checksum of that one's weights, which `params` has names
/// for.
pub(super) fn started(params: &Params, start: &Weights) -> Vec<(String, String)> {
    let named = params.named(start).map(|(name, tensor)| (name, tensor.shallow_clone()));
    vec![("start.model".into(), checksum(named))]
}

/// Refuses another model than the one that a run started from: its settings, and its auto-encoder, are the run's own.
///
/// # Errors
/// A sentence: it has other weights.
pub(crate) fn same_start(run: &Path, start: &Params) -> Result<(), String> {
    let before = RunInfo::of(run).map_or_else(Vec::new, |info| info.companions);
    if before.is_empty() {
        return Ok(());
    }
    same_companions(&before, &started(start, start.weights())).map_err(|e| format!("{}: {e}", run.display()))
}

/// Refuses a run of a task that draws no rigs and no skeletons.
pub(super) fn startable(path: &Path) -> Result<(), String> {
    let run = named_by(path).0;
    let Some(settings) = run.join("config.toml").is_file().then(|| Settings::of_run(&run)).transpose()? else {
        return Ok(());
    };
    if settings.are::<TokenRigTaskConfig>() || settings.are::<GrpoTaskConfig>() {
        return Ok(());
    }
    Err(format!(
        "start.model: {} is a run of task `{}`; rewards refine one of `tokenrig` or `grpo`, or of `unirig_skeleton`, as \
         unirig/skeleton_grpo.toml does",
        path.display(),
        settings.task()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rewards_cannot_refine_is_told_with_what_they_can() {
        let dir = tempfile::tempdir().unwrap();
        let of = |task: &str| {
            std::fs::write(dir.path().join("config.toml"), format!("task = '{task}'\n")).unwrap();
            startable(dir.path())
        };
        assert!(of("tokenrig").is_ok() && of("grpo").is_ok());
        let said = of("fsq_cvae").unwrap_err();
        assert!(said.contains("a run of task `fsq_cvae`") && said.contains("`unirig_skeleton`"), "{said}");
        // A file, and what is not there, say it themselves.
        assert!(startable(&dir.path().join("model.safetensors")).is_ok());
    }

    #[test]
    fn a_run_that_starts_from_itself_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let run = |name: &str, start: &str| {
            let run = dir.path().join(name);
            std::fs::create_dir_all(&run).unwrap();
            let start = if start.is_empty() { String::new() } else { dir.path().join(start).display().to_string() };
            std::fs::write(run.join("config.toml"), format!("task = 'grpo'\n[start]\nmodel = '{start}'\n")).unwrap();
            descends(&run)
        };
        assert_eq!(run("shipped", ""), Ok(()));
        assert_eq!(run("second", "shipped"), Ok(()));
        assert!(run("of_last", "of_last/checkpoints/last").unwrap_err().contains("starts from itself"));
        assert!(run("own", "own").unwrap_err().contains("own: starts from itself"));
        run("one", "two").unwrap();
        assert!(run("two", "one").unwrap_err().contains("starts from itself"));
    }
}
