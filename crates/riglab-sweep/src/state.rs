//! What a job has come to, read from its run folder.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::time::Duration;

use riglab_report::speaks_for;
use serde_json::Value;

use crate::attempts::{attempts, counted};
use crate::{Attempt, Job, Plan, SweepError};

/// Held by who trains in a run's folder, and by who evaluates it there. An evaluation has one of its own: a run may be
/// evaluated while it is trained.
const TRAINED: &str = ".lock";
const EVALUATED: &str = ".eval.lock";
/// Between tries for a lock, and how many: whoever looks whether it is held holds it for a moment.
const PAUSE: Duration = Duration::from_millis(20);
const LOOKS: u32 = 5;

/// Attempts that a job has, until somebody asks for more.
pub(crate) const TRIES: usize = 2;

/// What a job has come to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Nothing yet.
    Waiting,
    /// A process is at it, training or evaluating; the last step of its log.
    Running(u64),
    /// It was begun, and no process is at it.
    Interrupted(u64),
    /// Trained, but not yet evaluated where that is asked for: what somebody evaluated while it was trained, or otherwise
    /// than the sweep does, is not what it came to.
    Trained,
    /// All done.
    Finished,
    /// Every attempt failed, the last of them so. It stays at that until [`crate::retry`].
    Failed(String),
}

impl State {
    /// Of one job of the sweep in `folder`.
    pub fn of(folder: &Path, plan: &Plan, job: &Job, attempts: &[Attempt]) -> Self {
        let run = folder.join(&job.folder);
        let finished = is_trained(&run);
        if finished && (!plan.sweep.evaluate || speaks_for(&run, &plan.sweep.evaluation_sets())) {
            return Self::Finished;
        }
        if is_held(&run) {
            return Self::Running(last_step(&run));
        }
        let failed = counted(attempts, job.number);
        if let Some(last) = failed.last().filter(|last| failed.len() >= TRIES || last.given_up) {
            return Self::Failed(format!("{}: {}", last.stage, last.reason));
        }
        if finished {
            Self::Trained
        } else if run.join("config.toml").is_file() {
            Self::Interrupted(last_step(&run))
        } else {
            Self::Waiting
        }
    }
}

impl Plan {
    /// The jobs that are still to be done and that nobody is at, with those that failed and are begun `again`.
    pub fn left(&self, folder: &Path, again: impl Fn(&Job) -> bool) -> Vec<&Job> {
        let known = attempts(folder);
        let left = |job: &&Job| match State::of(folder, self, job, &known) {
            State::Failed(_) => again(job),
            State::Waiting | State::Interrupted(_) | State::Trained => true,
            State::Running(_) | State::Finished => false,
        };
        self.jobs.iter().filter(left).collect()
    }
}

pub(crate) fn info(run: &Path) -> Value {
    let text = std::fs::read_to_string(run.join("run.json")).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

/// Whether a run's training is over: of its job an evaluation is left at most.
pub fn is_trained(run: &Path) -> bool {
    info(run)["outcome"] == "finished"
}

/// Whether a process is at a run: training in its folder or, once that is done, evaluating it there. Both hold their lock
/// as long as they live. An evaluation of a run that is not done yet stands in nobody's way.
pub fn is_held(run: &Path) -> bool {
    let held = |name: &str| riglab_files::is_locked(&run.join(name));
    held(TRAINED) || (held(EVALUATED) && is_trained(run))
}

/// The right to evaluate a run into its folder, as long as what it gives lives: a sweep that outlives its process finds it
/// and does not evaluate beside it. `None` where the folder takes no lock, being read-only or on a disk that has none.
///
/// # Errors
/// When another process has it.
pub fn hold_evaluation(run: &Path) -> Result<Option<File>, SweepError> {
    let Ok(lock) = File::create(run.join(EVALUATED)) else { return Ok(None) };
    for look in 0..LOOKS {
        if look > 0 {
            std::thread::sleep(PAUSE);
        }
        match lock.try_lock() {
            Ok(()) => return Ok(Some(lock)),
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(_)) => return Ok(None),
        }
    }
    Err(SweepError::Evaluated(run.into()))
}

/// The step of the last whole line of the log; 0 without one.
fn last_step(run: &Path) -> u64 {
    let tail = || {
        let mut file = File::open(run.join("metrics.jsonl")).ok()?;
        let length = file.metadata().ok()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(1 << 16))).ok()?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).ok()?;
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let step = |line: &str| serde_json::from_str::<Value>(line).ok()?["step"].as_u64();
        text.lines().rev().find_map(step)
    };
    tail().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_tells_what_a_run_has_come_to() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\nevaluate = true\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let run = dir.path().join(&plan.jobs[0].folder);
        let state = |attempts: &[Attempt]| State::of(dir.path(), &plan, &plan.jobs[0], attempts);
        assert_eq!(state(&[]), State::Waiting);
        std::fs::create_dir_all(&run).unwrap();
        std::fs::write(run.join("config.toml"), "").unwrap();
        std::fs::write(run.join("metrics.jsonl"), "{\"step\":3}\n{\"step\":4}\n{\"st").unwrap();
        assert_eq!(state(&[]), State::Interrupted(4));
        let lock = File::create(run.join(".lock")).unwrap();
        lock.try_lock().unwrap();
        assert_eq!(state(&[]), State::Running(4));
        drop(lock);
        let failed = Attempt { job: 0, stage: "train".into(), reason: "no room".into(), given_up: false };
        assert_eq!(state(std::slice::from_ref(&failed)), State::Interrupted(4));
        let given_up = Attempt { given_up: true, ..failed.clone() };
        assert_eq!(state(&[given_up]), State::Failed("train: no room".into()));
        let twice = [failed.clone(), failed.clone()];
        assert_eq!(state(&twice), State::Failed("train: no room".into()));
        twice.iter().for_each(|failed| crate::record(dir.path(), failed).unwrap());
        assert_eq!(crate::retry(dir.path(), &plan).unwrap(), 1);
        let known = || crate::attempts(dir.path());
        assert_eq!((state(&known()), known().len()), (State::Interrupted(4), 3), "what failed stays in the list");
        assert_eq!(crate::retry(dir.path(), &plan).unwrap(), 0, "it has not failed since");
        twice.iter().for_each(|failed| crate::record(dir.path(), failed).unwrap());
        assert_eq!(state(&known()), State::Failed("train: no room".into()));
        std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        assert_eq!(state(&[]), State::Trained);
        let checkpoint = run.join("checkpoints/last");
        std::fs::create_dir_all(&checkpoint).unwrap();
        std::fs::write(checkpoint.join("state.json"), "{\"step\": 4}").unwrap();
        for (evaluation, wanted) in [
            // A glance while it was trained, and one with other settings.
            ("{\"checkpoint\": {\"step\": 3}}", State::Trained),
            ("{\"checkpoint\": {\"step\": 4}, \"set\": [\"eval.prefixes=[2]\"]}", State::Trained),
            ("{\"checkpoint\": {\"step\": 4}}", State::Finished),
        ] {
            std::fs::write(run.join("eval.json"), evaluation).unwrap();
            assert_eq!(state(&[]), wanted, "{evaluation}");
        }
    }

    #[test]
    fn who_evaluates_a_trained_run_is_at_it_and_alone() {
        let dir = tempfile::tempdir().unwrap();
        // While it is trained, an evaluation keeps nobody from going on.
        let lock = hold_evaluation(dir.path()).unwrap();
        assert!(lock.is_some() && !is_held(dir.path()));
        std::fs::write(dir.path().join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        assert!(is_held(dir.path()));
        let said = hold_evaluation(dir.path()).unwrap_err().to_string();
        assert!(said.contains("another process is evaluating this run") && said.contains("--out"), "{said}");
        drop(lock);
        assert!(!is_held(dir.path()) && hold_evaluation(dir.path()).unwrap().is_some());
        // A folder that takes no lock is evaluated all the same.
        assert!(hold_evaluation(&dir.path().join("none")).unwrap().is_none());
    }
}
