//! Slurm's own programs: what they are asked, and what their answers say.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::SlurmError;

/// A job in the queue, or a task of one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Queued {
    /// The job's id.
    pub job: String,
    /// The number in its array.
    pub task: Option<usize>,
    /// `PENDING`, `RUNNING`, `COMPLETING`, ...
    pub state: String,
    /// The nodes it is on.
    pub nodes: String,
    /// Why it waits.
    pub reason: String,
}

/// What is in the queue.
pub type Queue = Vec<Queued>;

/// The number that tasks of arrays must be below.
///
/// # Errors
/// When there is no Slurm, it cannot be reached, or it takes no arrays.
pub fn array_size() -> Result<usize, SlurmError> {
    let said = ask("scontrol", &["show", "config"])?;
    let size = value(&said, "MaxArraySize");
    let size = size.ok_or_else(|| SlurmError::Unclear { program: "scontrol", said: first_line(&said) })?;
    if size < 2 { Err(SlurmError::NoArrays(size)) } else { Ok(size) }
}

/// Submits a script; gives the job's id.
///
/// # Errors
/// When there is no Slurm, or it refuses.
pub fn submit(script: &Path) -> Result<String, SlurmError> {
    let file = script.to_str().ok_or_else(|| SlurmError::Unnamable(script.into()))?;
    let said = ask("sbatch", &["--parsable", file])?;
    submitted(&said).ok_or_else(|| SlurmError::Unclear { program: "sbatch", said: first_line(&said) })
}

/// Those of these jobs that are in the queue, array tasks one by one.
///
/// # Errors
/// When there is no Slurm, of no jobs too; when it cannot be reached.
pub fn queue(jobs: &[String]) -> Result<Queue, SlurmError> {
    if jobs.is_empty() {
        // Whoever asks is about to hand work over: without Slurm nothing is to be written for it.
        return ask("squeue", &["--version"]).map(|_| Vec::new());
    }
    let ids = jobs.join(",");
    match ask("squeue", &["--noheader", "--array", "--states=all", "--jobs", &ids, "--format=%i|%T|%N|%r"]) {
        Ok(said) => Ok(said.lines().filter_map(queued).filter(|q| is_waiting_or_running(&q.state)).collect()),
        // One alone, which it has forgotten.
        Err(SlurmError::Refused { said, .. }) if said.contains("Invalid job id") => Ok(Vec::new()),
        Err(e) => Err(e),
    }
}

/// How a job or task (`12` or `12_3`) that left the queue ended: `COMPLETED`, `CANCELLED`, `OUT_OF_MEMORY`, ...; `None`
/// where Slurm has forgotten it.
pub fn state(id: &str) -> Option<String> {
    let said = ask("scontrol", &["--oneliner", "show", "job", id]).ok()?;
    said.lines().find_map(job_state)
}

/// Puts a running task back into the queue.
pub(crate) fn requeue(id: &str) -> Result<(), SlurmError> {
    ask("scontrol", &["requeue", id]).map(|_| ())
}

/// Asks the processes that `srun` started in a task to save and leave. `srun` itself would end them at once.
pub(crate) fn tell_steps(id: &str) -> Result<(), SlurmError> {
    ask("scancel", &["--signal=TERM", id]).map(|_| ())
}

fn ask(program: &'static str, args: &[&str]) -> Result<String, SlurmError> {
    let mut command = Command::new(program);
    command.args(args).stdin(Stdio::null());
    for (name, _) in std::env::vars_os() {
        if is_of_a_job(&name.to_string_lossy()) {
            command.env_remove(name);
        }
    }
    let out = match command.output() {
        Ok(out) => out,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Err(SlurmError::Missing(program)),
        Err(e) => return Err(SlurmError::Refused { program, said: e.to_string() }),
    };
    if out.status.success() {
        return Ok(String::from_utf8_lossy(&out.stdout).into_owned());
    }
    let said = String::from_utf8_lossy(&out.stderr);
    let lines: Vec<&str> = said.lines().map(str::trim).filter(|l| !l.is_empty()).collect();
    let said = if lines.is_empty() { out.status.to_string() } else { lines.join("; ") };
    Err(SlurmError::Refused { program, said })
}

/// Whether a variable tells of the job that this is called within: its sizes are not for another one. A cluster's own
/// address, and what it knows its users by, stay.
fn is_of_a_job(variable: &str) -> bool {
    variable.starts_with("SLURM_") && !["SLURM_CONF", "SLURM_CLUSTERS", "SLURM_JWT"].contains(&variable)
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().chars().take(200).collect()
}

/// A number of `scontrol show config`.
fn value(text: &str, key: &str) -> Option<usize> {
    let line = text.lines().find_map(|l| l.trim_start().strip_prefix(key)?.trim_start().strip_prefix('='))?;
    line.trim().parse().ok()
}

/// The id that `sbatch --parsable` prints, with a cluster's name behind it where there are several.
fn submitted(text: &str) -> Option<String> {
    let id = text.lines().next()?.split(';').next()?.trim();
    (!id.is_empty() && id.bytes().all(|b| b.is_ascii_digit())).then(|| id.to_owned())
}

/// A line of `squeue`.
fn queued(line: &str) -> Option<Queued> {
    let mut parts = line.trim().splitn(4, '|');
    let (id, state, nodes, reason) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    let (job, task) = match id.split_once('_') {
        Some((job, task)) => (job, Some(task.parse().ok()?)),
        None => (id, None),
    };
    if job.is_empty() {
        return None;
    }
    Some(Queued { job: job.into(), task, state: state.into(), nodes: nodes.into(), reason: reason.into() })
}

/// Whether a task in this state has not yet come to its end. `squeue` shows those that have for some minutes.
fn is_waiting_or_running(state: &str) -> bool {
    const ENDED: [&str; 9] = [
        "BOOT_FAIL",
        "CANCELLED",
        "COMPLETED",
        "DEADLINE",
        "FAILED",
        "NODE_FAIL",
        "OUT_OF_MEMORY",
        "PREEMPTED",
        "TIMEOUT",
    ];
    !ENDED.contains(&state)
}

/// The state in a line of `scontrol --oneliner show job`.
fn job_state(line: &str) -> Option<String> {
    line.split_whitespace().find_map(|word| word.strip_prefix("JobState=")).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_cluster_knows_its_users_by_stays() {
        let left =
            ["SLURM_JOB_ID", "SLURM_CPUS_PER_TASK", "SLURM_CONF", "SLURM_CLUSTERS", "SLURM_JWT", "PATH", "SLURMX"];
        let left: Vec<&str> = left.into_iter().filter(|name| !is_of_a_job(name)).collect();
        assert_eq!(left, ["SLURM_CONF", "SLURM_CLUSTERS", "SLURM_JWT", "PATH", "SLURMX"]);
    }

    #[test]
    fn answers_are_understood() {
        assert_eq!(submitted("1234\n").as_deref(), Some("1234"));
        assert_eq!(submitted("1234;north\n").as_deref(), Some("1234"));
        assert!(["", "\n", "Submitted batch job 12\n", ";x"].iter().all(|t| submitted(t).is_none()));

        let config =
            "Configuration data as of 2024-01-01T00:00:00\nMaxArraySize            = 1001\nMaxJobCount = 10000\n";
        assert_eq!(value(config, "MaxArraySize"), Some(1001));
        assert_eq!(value(config, "MaxArray"), None);

        let task = queued("17_4|RUNNING|n[1-2]|None\n").unwrap();
        assert_eq!((task.job.as_str(), task.task, task.state.as_str()), ("17", Some(4), "RUNNING"));
        let job = queued("18|PENDING||(Dependency)").unwrap();
        assert_eq!((job.task, job.nodes.as_str(), job.reason.as_str()), (None, "", "(Dependency)"));
        assert!(["", "17_[4-9]|PENDING||None", "17_4|RUNNING", "|a|b|c"].iter().all(|l| queued(l).is_none()));

        let line = "JobId=2 ArrayJobId=1 JobName=a b Requeue=1 JobState=OUT_OF_MEMORY Reason=OutOfMemory";
        assert_eq!(job_state(line).as_deref(), Some("OUT_OF_MEMORY"));
        assert!(is_waiting_or_running("REQUEUED") && is_waiting_or_running("COMPLETING"));
        assert!(!is_waiting_or_running("TIMEOUT"));
    }
}
