//! Which of a run's checkpoints its evaluation is of.

use std::path::Path;

use serde::{Deserialize, Serialize};

/// The steps of the checkpoints that `best` and `last` of a run lead to now; `None` where there is none, or it is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checkpoints {
    /// Of the best.
    pub best: Option<u64>,
    /// Of the last.
    pub last: Option<u64>,
}

/// What is asked of a checkpoint's `state.json`, and of the same within an evaluation.
#[derive(Deserialize)]
struct State {
    step: Option<u64>,
}

/// What is asked of an `eval.json`, which may be large.
#[derive(Deserialize)]
struct Evaluation {
    checkpoint: Option<State>,
    #[serde(default)]
    set: Vec<String>,
    #[serde(default)]
    data: Vec<serde_json::Value>,
    report: Option<Report>,
    #[serde(default)]
    own_cuts: Vec<OwnCut>,
    /// What an earlier version wrote, which kept one.
    own_cut: Option<OwnCut>,
}

/// What is asked of a report.
#[derive(Deserialize)]
struct Report {
    cut: Option<f64>,
}

/// The cut of a decode rule that a run's own validation assets chose for its checkpoint of this step: kept by an evaluation on
/// other assets, or of another checkpoint, that takes the place of the one that chose it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OwnCut {
    /// Of the checkpoint.
    pub step: u64,
    /// Weights below it are none.
    pub cut: f64,
}

/// What is asked of a `run.json`.
#[derive(Deserialize)]
struct Begun {
    data: Vec<serde_json::Value>,
}

impl Checkpoints {
    /// Of the run in a folder.
    pub fn of(run: &Path) -> Self {
        let step = |name: &str| {
            let text = std::fs::read(run.join("checkpoints").join(name).join("state.json")).ok()?;
            serde_json::from_slice::<State>(&text).ok()?.step
        };
        Self { best: step("best"), last: step("last") }
    }
}

/// Whether a run's `eval.json` says what the run came to: it is of the best checkpoint, or of the last where none is the
/// best, and with no settings but the run's and these (`KEY=VALUE`). One of a run whose checkpoints are gone, or that does
/// not say its step, counts, as there is nothing to hold it against.
pub fn speaks_for(run: &Path, sets: &[String]) -> bool {
    let Some(Evaluation { checkpoint, set, .. }) = read(run) else { return false };
    let now = Checkpoints::of(run);
    let step = checkpoint.and_then(|of| of.step);
    let same = step.zip(now.best.or(now.last)).is_none_or(|(of, now)| of == now);
    same && set == sets
}

/// Whether a run's evaluation is of the checkpoint of this step, with no settings but the run's and where its corpora are now:
/// what it chose is what the run's own validation assets chose for that checkpoint.
fn chose_for(run: &Path, Evaluation { checkpoint, set, data, .. }: &Evaluation, step: u64) -> bool {
    let begun = || serde_json::from_slice::<Begun>(&std::fs::read(run.join("run.json")).ok()?).ok();
    // Of each corpus its path, and a checksum.
    let sums = |data: &[serde_json::Value]| data.iter().map(|of| of[1].clone()).collect::<Vec<_>>();
    let moved = |set: &String| set.split('=').next().is_some_and(|key| key.trim() == "data.corpora");
    let own = set.iter().all(moved) && (set.is_empty() || begun().is_some_and(|begun| sums(&begun.data) == sums(data)));
    own && checkpoint.as_ref().and_then(|of| of.step) == Some(step)
}

/// The cuts that a run's own validation assets chose for its checkpoints, as far as an evaluation of these is there, or others
/// that took its place: one a step.
pub fn own_cuts(run: &Path) -> Vec<OwnCut> {
    let Some(evaluation) = read(run) else { return Vec::new() };
    let step = evaluation.checkpoint.as_ref().and_then(|of| of.step);
    let chosen = step.filter(|step| chose_for(run, &evaluation, *step));
    let mut all: Vec<OwnCut> = evaluation.own_cuts.into_iter().chain(evaluation.own_cut).collect();
    all.retain(|own| Some(own.step) != chosen);
    let cut = evaluation.report.and_then(|report| report.cut);
    all.extend(chosen.zip(cut).map(|(step, cut)| OwnCut { step, cut }));
    all
}

/// That for the checkpoint of this step.
pub fn own_cut(run: &Path, step: u64) -> Option<OwnCut> {
    own_cuts(run).into_iter().find(|own| own.step == step)
}

fn read(run: &Path) -> Option<Evaluation> {
    serde_json::from_slice(&std::fs::read(run.join("eval.json")).ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_evaluation_speaks_for_the_checkpoint_that_a_run_stands_for() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path();
        let chose_for = |run: &Path, step| read(run).is_some_and(|evaluation| super::chose_for(run, &evaluation, step));
        let evaluated = |text: &str| {
            std::fs::write(run.join("eval.json"), text).unwrap();
            speaks_for(run, &[])
        };
        let checkpoint = |name: &str, step: u64| {
            let folder = run.join("checkpoints").join(name);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join("state.json"), format!("{{\"task\": \"t\", \"step\": {step}}}")).unwrap();
        };
        assert!(!speaks_for(run, &[]) && !evaluated("{\"checkpoint\": {"), "there is none");
        let of = |step: u64, more: &str| format!("{{{more}\"checkpoint\": {{\"step\": {step}, \"best\": null}}}}");
        assert!(evaluated(&of(5, "")), "nothing to hold it against");
        checkpoint("last", 8);
        assert!(evaluated(&of(8, "")) && !evaluated(&of(5, "")));
        checkpoint("best", 5);
        assert!(evaluated(&of(5, "")) && !evaluated(&of(8, "")));
        assert!(chose_for(run, 8) && !chose_for(run, 5));
        assert!(!evaluated(&of(5, "\"set\": [\"eval.prefixes=[2]\"], ")) && !chose_for(run, 5));
        assert!(speaks_for(run, &["eval.prefixes=[2]".into()]) && !speaks_for(run, &["eval.prefixes=[4]".into()]));
        // Corpora that were moved are the same, others are not.
        std::fs::write(run.join("run.json"), r#"{"data": [["old/a.h5", "sum", 3]]}"#).unwrap();
        let on = |sum: &str| {
            let more = format!(r#""set": ["data.corpora=['new/a.h5']"], "data": [["new/a.h5", "{sum}", 3, 1]], "#);
            evaluated(&of(5, &more));
            chose_for(run, 5)
        };
        assert!(on("sum") && !on("other"));
        // What they chose outlives an evaluation on others.
        assert!(evaluated(&of(5, "\"report\": {\"cut\": 0.25}, ")));
        let own = OwnCut { step: 5, cut: 0.25 };
        assert_eq!([5, 8].map(|step| own_cut(run, step)), [Some(own), None]);
        let kept = serde_json::to_string(&own).unwrap();
        evaluated(&of(
            5,
            &format!("\"set\": [\"data.test=['a']\"], \"report\": {{\"cut\": 0.5}}, \"own_cut\": {kept}, "),
        ));
        assert_eq!([5, 8].map(|step| own_cut(run, step)), [Some(own), None], "by an earlier version");
        // And one of another checkpoint, which has its own.
        evaluated(&of(8, &format!("\"report\": {{\"cut\": 0.5}}, \"own_cuts\": [{kept}], ")));
        let last = OwnCut { step: 8, cut: 0.5 };
        assert_eq!([5, 8].map(|step| own_cut(run, step)), [Some(own), Some(last)]);
        let kept = serde_json::to_string(&own_cuts(run)).unwrap();
        evaluated(&of(5, &format!("\"report\": {{\"cut\": 0.125}}, \"own_cuts\": {kept}, ")));
        let anew = OwnCut { step: 5, cut: 0.125 };
        assert_eq!([5, 8].map(|step| own_cut(run, step)), [Some(anew), Some(last)]);
        assert_eq!(Checkpoints::of(run), Checkpoints { best: Some(5), last: Some(8) });
    }
}
