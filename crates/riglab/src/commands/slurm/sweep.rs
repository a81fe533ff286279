//! A sweep as job arrays: a task for each job of the plan.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Result;
use riglab_slurm::{Queue, Queued, Submission, starts, state};
use riglab_sweep::{Attempt, Job, Plan, State, attempts, record};
use riglab_train::{Interrupt, Progress};

use super::{Desk, Order, counted, shown};

/// How handing a sweep over ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handed {
    /// Jobs are in the queue.
    Queued,
    /// Nothing is left in it, nor to be handed over.
    Done,
    /// Whoever waited had enough; the jobs go on.
    Left(u8),
}

/// Hands what is left of a sweep to the cluster. With `wait` it does so again with what comes back unfinished, until
/// nothing does. `threads`: of each job; 0 leaves them to the sweep's file, or to the cluster.
pub fn run(folder: &Path, plan: &Plan, desk: &Desk, threads: usize, wait: bool) -> Result<Handed> {
    let interrupt = if wait { Interrupt::listening() } else { Interrupt::default() };
    let mut stopped = BTreeSet::new();
    for round in 0.. {
        let queue = desk.queue()?;
        let cancelled = judge_gone(folder, plan, desk, &queue)?;
        // A new call means the cancelled ones too; one that waits has seen them go.
        if round > 0 {
            stopped.extend(cancelled);
        }
        let left = left(folder, plan, desk, &queue, &stopped);
        if !left.is_empty() {
            hand_over(folder, plan, desk, threads, &left)?;
        } else if queue.is_empty() {
            break;
        }
        if !wait {
            return Ok(Handed::Queued);
        }
        let total = plan.jobs.len() as u64;
        let mut progress = Progress::new("sweeping", total, 0);
        let emptied = desk.follow(&interrupt, |queue| {
            progress.set(total - open(folder, plan).len() as u64, || counted(queue));
        })?;
        progress.finish();
        if !emptied {
            return Ok(Handed::Left(interrupt.code()));
        }
    }
    Ok(Handed::Done)
}

/// What Slurm has to say about each job of a sweep that was handed over; `None` where it was not.
pub fn seen(folder: &Path, plan: &Plan) -> Result<Option<Vec<String>>> {
    if !Desk::is_known(folder) {
        return Ok(None);
    }
    let desk = Desk::reopen(folder, &[])?;
    let (queue, submitted) = (desk.queue()?, desk.submitted());
    let of = |job: &Job| {
        let queued = queue.iter().find(|q| number(&submitted, q) == Some(job.number));
        let begun = |q: &Queued| starts(&desk.starts(job.number)).iter().filter(|s| s.job == q.job).count();
        queued.map_or_else(String::new, |q| shown(q, begun(q)))
    };
    Ok(Some(plan.jobs.iter().map(of).collect()))
}

/// The job of the plan that a task in the queue does.
fn number(submitted: &[Submission], queued: &Queued) -> Option<usize> {
    let own = submitted.iter().find(|s| s.job == queued.job)?;
    Some(queued.task? + own.offset)
}

/// Jobs that are neither finished nor failed for good, with what they have come to.
fn open<'a>(folder: &Path, plan: &'a Plan) -> Vec<(&'a Job, State)> {
    let failed = attempts(folder);
    let all = plan.jobs.iter().map(|job| (job, State::of(folder, plan, job, &failed)));
    all.filter(|(_, state)| !matches!(state, State::Finished | State::Failed(_))).collect()
}

/// The numbers of jobs that nobody is at and that are to be done.
fn left(folder: &Path, plan: &Plan, desk: &Desk, queue: &Queue, stopped: &BTreeSet<usize>) -> Vec<usize> {
    let submitted = desk.submitted();
    let queued: BTreeSet<usize> = queue.iter().filter_map(|q| number(&submitted, q)).collect();
    let open = open(folder, plan).into_iter().filter(|(_, state)| !matches!(state, State::Running(_)));
    open.map(|(job, _)| job.number).filter(|n| !queued.contains(n) && !stopped.contains(n)).collect()
}

/// Looks at tasks that left the queue with their work undone and without a word: what Slurm ended for a fault of theirs
/// is a failed attempt. Gives the numbers of those that somebody cancelled.
fn judge_gone(folder: &Path, plan: &Plan, desk: &Desk, queue: &Queue) -> Result<Vec<usize>> {
    let submitted = desk.submitted();
    let queued: BTreeSet<usize> = queue.iter().filter_map(|q| number(&submitted, q)).collect();
    // The last submission of each.
    let last: BTreeMap<usize, &Submission> =
        submitted.iter().flat_map(|s| s.numbers.iter().map(move |n| (*n, s))).collect();
    let known = attempts(folder);
    let mut cancelled = Vec::new();
    for (job, now) in open(folder, plan) {
        let Some(submission) = last.get(&job.number).filter(|_| !queued.contains(&job.number)) else { continue };
        let told = known.iter().skip(submission.failures).any(|a| a.job == job.number);
        if told || matches!(now, State::Running(_)) {
            continue;
        }
        let task = format!("{}_{}", submission.job, job.number - submission.offset);
        match state(&task).as_deref() {
            Some("CANCELLED") => cancelled.push(job.number),
            Some(ended) if is_fault(ended) => {
                let log = desk.logs().join(format!("{task}.log"));
                let reason = format!("Slurm ended it: {ended}; its messages are in {}", log.display());
                record(folder, &Attempt { job: job.number, stage: "slurm".into(), reason, given_up: false })?;
            }
            _ => {}
        }
    }
    Ok(cancelled)
}

/// Whether a task ended so for a reason of its own; nodes that fail and jobs that go first are none.
fn is_fault(state: &str) -> bool {
    matches!(state, "FAILED" | "OUT_OF_MEMORY" | "TIMEOUT" | "DEADLINE" | "BOOT_FAIL")
}

fn hand_over(folder: &Path, plan: &Plan, desk: &Desk, threads: usize, left: &[usize]) -> Result<()> {
    let place = std::path::absolute(folder)?;
    let (place, threads) = (place.to_string_lossy(), threads.to_string());
    let name = folder.file_name().map_or("sweep".into(), |n| n.to_string_lossy().into_owned());
    let order = Order {
        what: "sweep",
        name: &name,
        numbers: left,
        failures: attempts(folder).len(),
        after: None,
        parallel: true,
        command: &["--threads", &threads, "sweep", &place],
    };
    let all = plan.jobs.len();
    for submission in desk.submit(&order)? {
        tell!("job {}: {} of {all} runs, in {}", submission.job, submission.numbers.len(), folder.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use riglab_slurm::SlurmConfig;

    use super::*;

    #[test]
    fn what_is_queued_running_done_or_stopped_is_not_handed_over_again() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [0, 1, 2, 3, 4]\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let desk = Desk::new(dir.path(), SlurmConfig::default()).unwrap();
        let submission =
            Submission { job: "17".into(), what: "sweep".into(), offset: 3, numbers: vec![3, 4], failures: 0 };
        riglab_slurm::record(&desk.file("jobs.jsonl"), &submission).unwrap();
        let task = |job: &str, task| Queued {
            job: job.into(),
            task: Some(task),
            state: "PENDING".into(),
            nodes: String::new(),
            reason: String::new(),
        };
        // Task 1 of the second part is job 4; another's job 18 is none of ours.
        let queue = vec![task("17", 1), task("18", 2)];
        let run = dir.path().join(&plan.jobs[0].folder);
        std::fs::create_dir_all(&run).unwrap();
        std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        let found = |stopped: &[usize]| left(dir.path(), &plan, &desk, &queue, &stopped.iter().copied().collect());
        assert_eq!(found(&[]), [1, 2, 3]);
        assert_eq!(found(&[2]), [1, 3]);
        let run = dir.path().join(&plan.jobs[1].folder);
        std::fs::create_dir_all(&run).unwrap();
        let lock = std::fs::File::create(run.join(".lock")).unwrap();
        lock.try_lock().unwrap();
        assert_eq!(found(&[]), [2, 3]);
    }
}
