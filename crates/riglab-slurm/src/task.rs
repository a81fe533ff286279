//! A task on its node: begun, told to leave, put back into the queue.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::time::Duration;

use riglab_files::ask_to_leave;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::ledger::{append, lines};
use crate::{SlurmError, cluster};

/// Between looks at a process: short against the start of one.
const PAUSE: Duration = Duration::from_millis(20);
/// Between tries to reach a controller that does not answer, and how many: it may be restarted just now.
const AGAIN: Duration = Duration::from_secs(2);
const TRIES: usize = 30;

/// The task of a Slurm job that this process is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Task {
    /// The id of the job, or of its array.
    pub job: String,
    /// Its number in the array.
    pub number: Option<usize>,
    /// The node it is on.
    pub node: String,
}

/// A start of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Start {
    /// The job's id.
    pub job: String,
    /// The node.
    pub node: String,
    /// How far the work was.
    pub at: String,
}

/// A task that does not get on.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "it was begun {starts} times at the same place ({at}) and never got further; give it more time (slurm.time), save \
     more often (train.save_every), or allow more starts (slurm.patience)"
)]
pub struct Stuck {
    /// How often it was begun there.
    pub starts: usize,
    /// Where.
    pub at: String,
}

/// All starts that a file lists.
pub fn starts(file: &Path) -> Vec<Start> {
    lines(file)
}

impl Task {
    /// From what Slurm tells its tasks; `None` outside one.
    pub fn here() -> Option<Self> {
        Self::told(|name| std::env::var(name).ok())
    }

    fn told(variable: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let array = variable("SLURM_ARRAY_JOB_ID");
        let number = match &array {
            Some(_) => Some(variable("SLURM_ARRAY_TASK_ID")?.parse().ok()?),
            None => None,
        };
        let job = array.or_else(|| variable("SLURM_JOB_ID"))?;
        let node = variable("SLURMD_NODENAME").unwrap_or_default();
        Some(Self { job, number, node })
    }

    /// As Slurm's programs name it. The id of one of an array's tasks is that of the array too: by itself it would mean
    /// all of them.
    pub fn id(&self) -> String {
        self.number.map_or_else(|| self.job.clone(), |n| format!("{}_{n}", self.job))
    }

    /// Notes in `file` that the task begins at a place.
    ///
    /// # Errors
    /// When the last `patience` starts of this job were there too, or the file cannot be written.
    pub fn begin(&self, file: &Path, at: &str, patience: usize) -> Result<Result<(), Stuck>, SlurmError> {
        let before = starts(file);
        let here = before.iter().rev().take_while(|s| s.job == self.job && s.at == at).count();
        if here >= patience {
            return Ok(Err(Stuck { starts: here, at: at.into() }));
        }
        append(file, &Start { job: self.job.clone(), node: self.node.clone(), at: at.into() })?;
        Ok(Ok(()))
    }

    /// Puts the task back into the queue, once it has saved. False where Slurm has already decided about it: it was
    /// cancelled, or requeued by Slurm itself.
    ///
    /// # Errors
    /// When the controller does not answer for a minute, or refuses.
    pub fn requeue(&self) -> Result<bool, SlurmError> {
        for again in 1.. {
            let asked = match cluster::queue(&[self.id()]) {
                Ok(queue) => match queue.iter().any(|q| q.task == self.number && q.state == "RUNNING") {
                    true => cluster::requeue(&self.id()).map(|()| true),
                    false => Ok(false),
                },
                Err(e) => Err(e),
            };
            match asked {
                Err(SlurmError::Refused { .. }) if again < TRIES => std::thread::sleep(AGAIN),
                other => return other,
            }
        }
        Ok(false)
    }
}

/// Runs `srun` to its end. When `stop` says so, the processes that it started are asked, once, to save and leave.
///
/// # Errors
/// When it cannot be started.
pub fn attend_steps(mut command: Command, task: &Task, stop: impl Fn() -> bool) -> Result<ExitStatus, SlurmError> {
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt;
        // What the group is told must not come to srun, which ends its processes for it.
        command.process_group(0);
    }
    attended(command, stop, |_| {
        if let Err(e) = cluster::tell_steps(&task.id()) {
            let _ = writeln!(
                std::io::stderr(),
                "warning: the processes of task {} cannot be told to leave: {e}",
                task.id()
            );
        }
    })
}

/// Runs a process to its end. When `stop` says so it is asked, once, to save and leave. It stays in this process's
/// group, by which some clusters know what belongs to a job, and may therefore hear the same wish from Slurm too.
///
/// # Errors
/// When it cannot be started.
pub fn attend(command: Command, stop: impl Fn() -> bool) -> Result<ExitStatus, SlurmError> {
    attended(command, stop, ask_to_leave)
}

fn attended(mut command: Command, stop: impl Fn() -> bool, ask: impl Fn(&Child)) -> Result<ExitStatus, SlurmError> {
    let program = PathBuf::from(command.get_program());
    let mut child = command.spawn().map_err(|e| SlurmError::io(&program, "started", &e))?;
    let mut asked = false;
    loop {
        if let Some(status) = child.try_wait().map_err(|e| SlurmError::io(&program, "waited for", &e))? {
            return Ok(status);
        }
        if stop() && !asked {
            asked = true;
            ask(&child);
        }
        std::thread::sleep(PAUSE);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    fn task(number: Option<usize>) -> Task {
        Task { job: "17".into(), number, node: "n1".into() }
    }

    #[test]
    fn tasks_know_themselves_by_their_array() {
        let of = |pairs: &[(&str, &str)]| {
            Task::told(|name| pairs.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned()))
        };
        let array = [("SLURM_JOB_ID", "19"), ("SLURM_ARRAY_JOB_ID", "17"), ("SLURM_ARRAY_TASK_ID", "3")];
        assert_eq!(of(&array).unwrap().id(), "17_3");
        assert_eq!(of(&[("SLURM_JOB_ID", "19")]).unwrap().id(), "19");
        assert_eq!(of(&[]), None);
    }

    #[test]
    fn a_task_that_never_gets_on_is_given_up() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("starts/3.jsonl");
        let begin = |task: &Task, at: &str| task.begin(&file, at, 2).unwrap();
        let here = task(Some(3));
        assert!(begin(&here, "step 0").is_ok() && begin(&here, "step 4").is_ok() && begin(&here, "step 4").is_ok());
        let stuck = begin(&here, "step 4").unwrap_err();
        assert_eq!((stuck.starts, stuck.at.as_str()), (2, "step 4"));
        assert!(stuck.to_string().contains("begun 2 times") && stuck.to_string().contains("slurm.time"));
        // Submitted again, it has its starts again.
        let again = Task { job: "18".into(), ..here };
        assert!(begin(&again, "step 4").is_ok());
        assert_eq!(starts(&file).len(), 4);
    }

    #[test]
    fn a_process_is_asked_to_leave_and_its_code_is_told() {
        let shell = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]);
            command
        };
        assert_eq!(attend(shell("exit 3"), || false).unwrap().code(), Some(3));
        let start = Instant::now();
        let stop = || start.elapsed() > Duration::from_millis(200);
        assert_eq!(attend(shell("trap 'exit 130' TERM; sleep 30 & wait"), stop).unwrap().code(), Some(130));
        assert!(start.elapsed() < Duration::from_secs(20));
        let missing = attend(Command::new("/nowhere/at-all"), || false).unwrap_err().to_string();
        assert!(missing.contains("/nowhere/at-all cannot be started"), "{missing}");
    }
}
