//! Whether an evaluation is of a run.

use std::path::Path;

use anyhow::{Result, bail};
use riglab_report::RunView;
use riglab_report::shell::command;
use riglab_train::{Checkpoint, State};

use super::shown;

/// Refuses an evaluation whose checkpoint another run has saved: its figures would stand under this run's title. One that says
/// nothing of its checkpoint, or of which nothing is left in the run, is believed.
///
/// # Errors
/// A sentence with what differs.
pub fn of_run(evaluation: &Path, run: &Path, view: &RunView) -> Result<()> {
    let told = std::fs::read_to_string(evaluation).ok();
    let told = told.and_then(|text| serde_json::from_str::<serde_json::Value>(&text).ok());
    let state = told.and_then(|mut of| serde_json::from_value::<State>(of["checkpoint"].take()).ok());
    match state.and_then(|state| foreign(&state, run, view)) {
        None => Ok(()),
        Some(why) => bail!(
            "{}: it is of another run's checkpoint: {why}; give the run that it is of, or evaluate this one: `{}`",
            evaluation.display(),
            command(["eval", &shown(run), "--out", "FILE"])
        ),
    }
}

/// Why a checkpoint is none of a run's, if it is none.
fn foreign(state: &State, run: &Path, view: &RunView) -> Option<String> {
    let own = checkpoints(run);
    if own.iter().any(|own| same(own, state)) {
        return None;
    }
    let (step, seed) = (state.step, state.seed);
    if let Some(other) = own.iter().find(|own| own.seed != seed) {
        return Some(format!("trained with seed {seed}, and the run with {}", other.seed));
    }
    if let Some(other) = own.iter().find(|own| own.step == step) {
        return Some(format!("{} until step {step}, and in the run {}", best(state), best(other)));
    }
    // One that was saved and removed since.
    let logged = view.logged();
    let last = logged.values().flatten().map(|(at, _)| *at).fold(f64::NAN, f64::max);
    if (step as f64) > last {
        return Some(format!("it has {step} steps, and the run {last}"));
    }
    let (best, value) = state.best?;
    let validated = logged.iter().filter(|(name, _)| name.starts_with("eval/")).flat_map(|(_, points)| points);
    let mut then = validated.filter(|(at, _)| *at == best as f64).peekable();
    then.peek()?;
    (!then.any(|(_, own)| near(*own, value)))
        .then(|| format!("its best validation, at step {best}, is {value}, which the run never measured then"))
}

/// What the run's checkpoints remember.
fn checkpoints(run: &Path) -> Vec<State> {
    let folders = std::fs::read_dir(run.join("checkpoints")).into_iter().flatten().flatten();
    folders.filter_map(|folder| Checkpoint::open(&folder.path()).ok()).map(|found| found.state().clone()).collect()
}

/// A checkpoint's best validation in words.
fn best(state: &State) -> String {
    match state.best {
        Some((step, value)) => format!("its best validation was {value} at step {step}"),
        None => "it had no best validation".into(),
    }
}

fn same(a: &State, b: &State) -> bool {
    let best = match (a.best, b.best) {
        (Some((one, value)), Some((other, theirs))) => one == other && near(value, theirs),
        (one, other) => one.is_none() && other.is_none(),
    };
    (&a.task, a.step, a.seed, a.skipped) == (&b.task, b.step, b.seed, b.skipped) && best
}

/// Equal but for how a number is read from its digits.
fn near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(step: u64, seed: u64, best: Option<(u64, f64)>) -> State {
        State { task: "t".into(), step, seed, skipped: 0, skipped_in_a_row: 0, best }
    }

    /// A run of 30 steps with a checkpoint of the last.
    fn run(logs: &str) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        let write = |file: &str, text: &str| std::fs::write(dir.path().join(file), text).unwrap();
        write("config.toml", "");
        write("run.json", "{\"task\": \"t\"}");
        write("metrics.jsonl", logs);
        let last = dir.path().join("checkpoints/step-00000030");
        std::fs::create_dir_all(&last).unwrap();
        let text = serde_json::to_string(&state(30, 1, Some((20, 0.5)))).unwrap();
        std::fs::write(last.join("state.json"), text).unwrap();
        dir
    }

    fn said(dir: &Path, checkpoint: &str) -> String {
        let evaluation = dir.join("other.json");
        std::fs::write(&evaluation, format!("{{\"checkpoint\": {checkpoint}}}")).unwrap();
        let view = RunView::read(dir).unwrap();
        of_run(&evaluation, dir, &view).map_or_else(|e| e.to_string(), |()| String::new())
    }

    #[test]
    fn an_evaluation_is_of_the_run_that_saved_its_checkpoint() {
        let logs = "{\"step\":10,\"eval/iou@val\":0.25}\n{\"step\":20,\"eval/iou@val\":0.5}\n{\"step\":30,\"train/loss\":1.0}\n";
        let dir = run(logs);
        let of = |state: State| said(dir.path(), &serde_json::to_string(&state).unwrap());
        assert_eq!(of(state(30, 1, Some((20, 0.5)))), "");
        // One that was removed since, by what was logged.
        assert_eq!([of(state(10, 1, Some((10, 0.25)))), of(state(5, 1, None))], ["", ""]);
        for (other, why) in [
            (state(30, 2, Some((20, 0.5))), "trained with seed 2, and the run with 1"),
            (
                state(30, 1, Some((20, 0.6))),
                "was 0.6 at step 20 until step 30, and in the run its best validation was 0.5",
            ),
            (state(40, 1, Some((20, 0.5))), "it has 40 steps, and the run 30"),
            (state(20, 1, Some((10, 0.3))), "its best validation, at step 10, is 0.3"),
        ] {
            let said = of(other);
            assert!(said.contains("another run's checkpoint") && said.contains(why), "{said}");
            assert!(said.contains("other.json") && said.contains("riglab eval"), "{said}");
        }
        // What an evaluation does not say is believed.
        assert_eq!([said(dir.path(), "null"), said(dir.path(), "{\"step\": 4}")], ["", ""]);
    }

    #[test]
    fn an_exported_model_has_no_logs_and_its_own_evaluations() {
        let dir = run("");
        let of = |state: State| said(dir.path(), &serde_json::to_string(&state).unwrap());
        assert_eq!(of(state(30, 1, Some((20, 0.5)))), "");
        assert!(of(state(30, 1, None)).contains("it had no best validation until step 30"));
    }
}
