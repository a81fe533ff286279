//! Jobs as processes of this machine.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use riglab_files::{ask_to_leave, was_asked};

use crate::attempts::{counted, record};
use crate::state::{info, is_held};
use crate::{Attempt, Job, Plan, State, SweepError, attempts};

/// Between looks at the processes: short against the start of one.
const PAUSE: Duration = Duration::from_millis(20);
/// Looks between those at runs that another process is at, and at jobs that wait for others to end.
const LOOKS: u32 = 25;

/// What of the machine a sweep may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Jobs at a time.
    pub jobs: usize,
    /// Threads of each.
    pub threads: usize,
    /// Memory of all together in GB.
    pub memory_gb: f64,
}

impl Budget {
    /// For a sweep of `all` jobs that have `threads` threads (0: what the processors give those at a time) on `cores`
    /// processors (0: all); `jobs` (0: as many as fit) at a time, within `memory_gb` (0: nine tenths of what is free
    /// now).
    pub fn new(jobs: usize, cores: usize, threads: usize, memory_gb: f64, all: usize) -> Self {
        let most = all.max(1);
        let all = std::thread::available_parallelism().map_or(1, usize::from);
        let cores = if cores == 0 { all } else { cores };
        let jobs = match (jobs, threads) {
            (0, 0) => cores,
            (0, t) => (cores / t).max(1),
            (j, _) => j,
        };
        // Processors of those that would wait for nothing are for the others.
        let jobs = jobs.min(most);
        let threads = if threads == 0 { (cores / jobs).max(1) } else { threads };
        let memory_gb = if memory_gb > 0.0 { memory_gb } else { 0.9 * free_gb().unwrap_or(f64::INFINITY) };
        Self { jobs, threads, memory_gb }
    }
}

/// Memory that can be had, in GB; `None` where the system does not say.
fn free_gb() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    // The kernel's "kB" are 1024 bytes.
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? * 1.024 / 1e6)
}

/// A step of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Train from the job's config.
    Train,
    /// Go on training in its folder.
    Resume,
    /// Evaluate on the test splits.
    Evaluate,
}

impl Stage {
    fn name(self) -> &'static str {
        match self {
            Self::Train | Self::Resume => "train",
            Self::Evaluate => "eval",
        }
    }
}

/// What happens, for who shows it.
#[derive(Clone, Debug, PartialEq)]
pub enum Event<'a> {
    /// A stage of a job began.
    Begun(&'a Job, Stage),
    /// A job is all done.
    Finished(&'a Job),
    /// An attempt failed; whether the job is tried again.
    Failed(&'a Job, String, bool),
    /// A job of an earlier process of this sweep still runs: it is waited for.
    Adopted(&'a Job),
    /// Jobs done (finished or failed) and running.
    Count(usize, usize),
}

/// How a pool ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// Every job finished or failed for good.
    Done,
    /// It was asked to stop; jobs saved and left.
    Interrupted,
}

/// A stage that runs.
struct Busy {
    job: usize,
    stage: Stage,
    child: Child,
    /// Where what it tells begins in the log, behind what earlier attempts told.
    told_from: u64,
}

/// Runs what is left of a sweep. `command` gives the process of a stage (run folder, config, threads are its
/// business); `stop` is asked all the time; `tell` hears what happens.
///
/// # Errors
/// When the sweep's own files cannot be written. Whatever happens to a job is its own affair.
pub fn run(
    folder: &Path,
    plan: &Plan,
    budget: Budget,
    command: impl Fn(&Job, Stage, &Path) -> Command,
    stop: impl Fn() -> bool,
    tell: impl FnMut(Event),
) -> Result<Ended, SweepError> {
    let all = plan.jobs.iter().map(|j| j.number).collect();
    Pool::new(folder, plan, all, true).run(budget, command, stop, tell)
}

/// As [`run`], of one job alone. Other processes may be at others of the sweep. Its stages stay
/// in this process's group, by which a cluster knows what belongs to its task.
///
/// # Errors
/// As [`run`].
pub fn run_one(
    folder: &Path,
    plan: &Plan,
    job: &Job,
    command: impl Fn(&Job, Stage, &Path) -> Command,
    stop: impl Fn() -> bool,
    tell: impl FnMut(Event),
) -> Result<Ended, SweepError> {
    let budget = Budget { jobs: 1, threads: 0, memory_gb: f64::INFINITY };
    Pool::new(folder, plan, [job.number].into(), false).run(budget, command, stop, tell)
}

struct Pool<'a> {
    folder: &'a Path,
    plan: &'a Plan,
    waiting: VecDeque<usize>,
    busy: Vec<Busy>,
    /// Jobs that a process of an earlier call is at.
    adopted: BTreeSet<usize>,
    done: usize,
    failures: BTreeMap<usize, usize>,
    /// The most memory that a finished run has had, in GB; `None` until somebody asks.
    peak: Option<f64>,
    /// Whether something ended, or is to be tried again, since jobs were started last: nothing else makes room.
    stirred: bool,
    /// Whether stages have process groups of their own.
    apart: bool,
}

impl<'a> Pool<'a> {
    fn new(folder: &'a Path, plan: &'a Plan, waiting: VecDeque<usize>, apart: bool) -> Self {
        let known = attempts(folder);
        let failures = plan.jobs.iter().map(|j| (j.number, counted(&known, j.number).len())).collect();
        let (busy, adopted) = (Vec::new(), BTreeSet::new());
        Self { folder, plan, waiting, busy, adopted, done: 0, failures, peak: None, stirred: true, apart }
    }

    fn run(
        mut self,
        budget: Budget,
        command: impl Fn(&Job, Stage, &Path) -> Command,
        stop: impl Fn() -> bool,
        mut tell: impl FnMut(Event),
    ) -> Result<Ended, SweepError> {
        let (mut asked, mut looks) = (false, 0u32);
        loop {
            let before = (self.done, self.busy.len());
            self.reap(asked, &mut tell)?;
            if looks.is_multiple_of(LOOKS) {
                self.look_at_adopted();
            }
            if stop() && !asked {
                asked = true;
                // Runs save and leave on this signal; a second one would make them leave at once.
                self.busy.iter().for_each(|b| ask_to_leave(&b.child));
            }
            if !asked && (std::mem::take(&mut self.stirred) || looks.is_multiple_of(LOOKS)) {
                self.start(budget, &command, &mut tell)?;
            }
            if before != (self.done, self.busy.len()) || looks == 0 {
                tell(Event::Count(self.done, self.busy.len() + self.adopted.len()));
            }
            if self.busy.is_empty() && (asked || (self.waiting.is_empty() && self.adopted.is_empty())) {
                return Ok(if asked { Ended::Interrupted } else { Ended::Done });
            }
            looks = looks.wrapping_add(1);
            std::thread::sleep(PAUSE);
        }
    }

    fn job(&self, number: usize) -> &'a Job {
        &self.plan.jobs[number]
    }

    fn run_of(&self, number: usize) -> PathBuf {
        self.folder.join(&self.job(number).folder)
    }

    /// Takes note of processes that ended.
    fn reap(&mut self, asked: bool, tell: &mut impl FnMut(Event)) -> Result<(), SweepError> {
        let mut k = 0;
        while k < self.busy.len() {
            let status = match self.busy[k].child.try_wait() {
                Ok(None) => {
                    k += 1;
                    continue;
                }
                Ok(Some(status)) => status,
                Err(e) => return Err(SweepError::io(&self.run_of(self.busy[k].job), "waited for", &e)),
            };
            let Busy { job, stage, told_from, .. } = self.busy.swap_remove(k);
            self.ended(job);
            if status.success() {
                // What comes next is seen from the folder; ahead of others, so that results come early.
                let went_on = match stage {
                    Stage::Evaluate => State::of(self.folder, self.plan, self.job(job), &[]) == State::Finished,
                    // Whoever evaluates it by now holds it, and is waited for.
                    Stage::Train | Stage::Resume => info(&self.run_of(job))["outcome"] == "finished",
                };
                if went_on {
                    self.waiting.push_front(job);
                } else {
                    self.fail(job, stage, "it ended well, but left no result".into(), tell)?;
                }
            } else if asked || was_asked(status.code()) {
                // It was asked to leave: no fault of its own.
                if !asked {
                    self.waiting.push_back(job);
                }
            } else {
                let said = last_error(&log_of(&self.run_of(job)), told_from);
                let reason = said.unwrap_or_else(|| status.to_string());
                self.fail(job, stage, reason, tell)?;
            }
        }
        Ok(())
    }

    fn fail(
        &mut self,
        job: usize,
        stage: Stage,
        reason: String,
        tell: &mut impl FnMut(Event),
    ) -> Result<(), SweepError> {
        let stage = stage.name().into();
        record(self.folder, &Attempt { job, stage, reason: reason.clone(), given_up: false })?;
        let count = self.failures.entry(job).or_default();
        *count += 1;
        let again = *count < crate::state::TRIES;
        tell(Event::Failed(self.job(job), reason, again));
        // At the end of the queue: whatever it was may have passed by then. Counted when it is looked at.
        self.waiting.push_back(job);
        self.stirred = true;
        Ok(())
    }

    /// Takes note that a process of a job ended, whoever started it.
    fn ended(&mut self, job: usize) {
        self.stirred = true;
        if let Some(peak) = self.peak {
            self.peak = Some(peak.max(peak_gb(&self.run_of(job))));
        }
    }

    fn look_at_adopted(&mut self) {
        let free: Vec<usize> = self.adopted.iter().copied().filter(|j| !is_held(&self.run_of(*j))).collect();
        for job in free {
            self.adopted.remove(&job);
            self.ended(job);
            self.waiting.push_front(job);
        }
    }

    /// Starts what fits.
    fn start(
        &mut self,
        budget: Budget,
        command: &impl Fn(&Job, Stage, &Path) -> Command,
        tell: &mut impl FnMut(Event),
    ) -> Result<(), SweepError> {
        let mut all_attempts = None;
        for _ in 0..self.waiting.len() {
            let Some(number) = self.waiting.pop_front() else { break };
            let (job, run) = (self.job(number), self.run_of(number));
            let known = all_attempts.get_or_insert_with(|| attempts(self.folder));
            let stage = match State::of(self.folder, self.plan, job, known) {
                State::Finished => {
                    self.done += 1;
                    tell(Event::Finished(job));
                    continue;
                }
                State::Failed(_) => {
                    self.done += 1;
                    continue;
                }
                State::Running(_) => {
                    self.adopted.insert(number);
                    tell(Event::Adopted(job));
                    continue;
                }
                State::Waiting => Stage::Train,
                State::Interrupted(_) => Stage::Resume,
                State::Trained => Stage::Evaluate,
            };
            if !self.fits(budget) {
                self.waiting.push_front(number);
                break;
            }
            match spawn(command(job, stage, &run), &run, self.apart) {
                Ok((child, told_from)) => {
                    self.busy.push(Busy { job: number, stage, child, told_from });
                    tell(Event::Begun(job, stage));
                }
                Err(e) => {
                    let reason = format!("it cannot be started: {e}");
                    self.fail(number, stage, reason, tell)?;
                    all_attempts = None;
                }
            }
        }
        Ok(())
    }

    /// Whether another job may run: always one, and more within the budget.
    fn fits(&mut self, budget: Budget) -> bool {
        let running = self.busy.len() + self.adopted.len();
        if running == 0 {
            return true;
        }
        if running >= budget.jobs {
            return false;
        }
        let each = match self.plan.sweep.memory_gb {
            told if told > 0.0 => told,
            _ => {
                let all = || self.plan.jobs.iter().map(|j| peak_gb(&self.folder.join(&j.folder))).fold(0.0, f64::max);
                *self.peak.get_or_insert_with(all)
            }
        };
        (running + 1) as f64 * each <= budget.memory_gb
    }
}

/// The most memory that a finished run has had; 0 for others.
fn peak_gb(run: &Path) -> f64 {
    if info(run)["outcome"] != "finished" {
        return 0.0;
    }
    let text = std::fs::read_to_string(run.join("perf.jsonl")).unwrap_or_default();
    let last = text.lines().rev().find_map(|l| serde_json::from_str::<serde_json::Value>(l).ok());
    last.and_then(|l| l["perf/peak_memory_mb"].as_f64()).unwrap_or(0.0) / 1e3
}

/// Where a job's messages go: beside its run folder, which may not exist yet.
fn log_of(run: &Path) -> PathBuf {
    run.with_extension("log")
}

/// Starts a process; with it, where what it tells begins in the log.
fn spawn(mut command: Command, run: &Path, apart: bool) -> std::io::Result<(Child, u64)> {
    let log = log_of(run);
    riglab_files::make_folder_of(&log)?;
    let errors: File = OpenOptions::new().create(true).append(true).open(&log)?;
    let told_from = errors.metadata()?.len();
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(errors);
    #[cfg(unix)]
    if apart {
        use std::os::unix::process::CommandExt;
        // Ctrl-C is for the sweep, which tells its runs by itself.
        command.process_group(0);
    }
    Ok((command.spawn()?, told_from))
}

/// The last `error:` that a job told from there on.
fn last_error(log: &Path, from: u64) -> Option<String> {
    let all = std::fs::read(log).ok()?;
    let text = String::from_utf8_lossy(all.get(usize::try_from(from).ok()?..)?);
    text.lines().rev().find_map(|l| l.strip_prefix("error: ")).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::time::Instant;

    use super::*;

    fn plan(more: &str) -> Plan {
        let text = format!("[sweep]\nbase = 'b'\nseeds = [1, 2, 3]\n{more}");
        let config = riglab_config::Config::from_toml_str("s.toml", &text).unwrap();
        Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap()
    }

    fn shell(script: String) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", &script]);
        command
    }

    /// A process that leaves a finished run behind.
    fn finishes(run: &Path, seconds: f64) -> Command {
        let run = run.display();
        let script =
            format!("sleep {seconds}; mkdir -p '{run}'; echo '{{\"outcome\":\"finished\"}}' > '{run}/run.json'");
        shell(script)
    }

    const BUDGET: Budget = Budget { jobs: 2, threads: 1, memory_gb: 1e3 };

    #[test]
    fn a_failing_job_is_tried_twice_and_the_rest_goes_on() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        let tried = Cell::new(0);
        let command = |job: &Job, _: Stage, run: &Path| {
            if job.seed == 2 {
                tried.set(tried.get() + 1);
                return shell("echo 'error: no room' >&2; exit 1".into());
            }
            finishes(run, 0.0)
        };
        for _ in 0..2 {
            let ended = run(dir.path(), &plan, BUDGET, command, || false, |_| ()).unwrap();
            // Called again, nothing is left to do.
            assert_eq!((ended, tried.get()), (Ended::Done, 2));
        }
        let failed = attempts(dir.path());
        assert_eq!(failed.len(), 2);
        // Unless somebody asks for it: twice again, and no more.
        assert_eq!(crate::retry(dir.path(), &plan).unwrap(), 1);
        let again = Cell::new(0);
        let tell = |event: Event| again.set(again.get() + u32::from(matches!(event, Event::Failed(_, _, true))));
        for _ in 0..2 {
            run(dir.path(), &plan, BUDGET, command, || false, tell).unwrap();
            assert_eq!((tried.get(), again.get()), (4, 1));
        }
        let failed = attempts(dir.path());
        let states: Vec<State> = plan.jobs.iter().map(|j| State::of(dir.path(), &plan, j, &failed)).collect();
        assert_eq!(states, [State::Finished, State::Failed("train: no room".into()), State::Finished]);
    }

    #[test]
    fn a_reason_is_that_of_its_own_attempt() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        let tried = Cell::new(0);
        let command = |job: &Job, _: Stage, run: &Path| {
            if job.seed != 2 {
                return finishes(run, 0.0);
            }
            tried.set(tried.get() + 1);
            shell(if tried.get() == 1 { "echo 'error: no room' >&2; exit 1".into() } else { "kill -9 $$".into() })
        };
        run(dir.path(), &plan, BUDGET, command, || false, |_| ()).unwrap();
        let reasons: Vec<String> = attempts(dir.path()).into_iter().map(|attempt| attempt.reason).collect();
        assert!(reasons.len() == 2 && reasons[0] == "no room" && reasons[1].contains("signal: 9"), "{reasons:?}");
    }

    #[test]
    fn one_job_is_done_alone() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        let command = |_: &Job, _: Stage, run: &Path| finishes(run, 0.0);
        let ended = run_one(dir.path(), &plan, &plan.jobs[1], command, || false, |_| ()).unwrap();
        let states: Vec<State> = plan.jobs.iter().map(|j| State::of(dir.path(), &plan, j, &[])).collect();
        assert_eq!((ended, states), (Ended::Done, vec![State::Waiting, State::Finished, State::Waiting]));
    }

    #[test]
    fn a_job_that_leaves_nothing_behind_has_failed() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        run(dir.path(), &plan, BUDGET, |_, _, _| shell("true".into()), || false, |_| ()).unwrap();
        assert_eq!(attempts(dir.path()).len(), 6);
    }

    #[test]
    fn both_processors_are_kept_busy() {
        // Nine jobs of a tenth of a second, two at a time: five rounds.
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan("[sweep.product]\nx = [1, 2, 3]\n"));
        let (start, most) = (Instant::now(), Cell::new(0));
        let tell = |event: Event| {
            if let Event::Count(_, running) = event {
                most.set(most.get().max(running));
            }
        };
        run(dir.path(), &plan, BUDGET, |_, _, run| finishes(run, 0.1), || false, tell).unwrap();
        assert_eq!(most.get(), 2);
        // Alone, a process and a look take a few hundredths more; one at a time would take 0.9 at least.
        assert!(start.elapsed().as_secs_f64() >= 0.5, "{:?}", start.elapsed());
    }

    #[test]
    fn what_a_finished_run_has_taken_is_read_once_and_kept() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        let known = dir.path().join(&plan.jobs[0].folder);
        std::fs::create_dir_all(&known).unwrap();
        std::fs::write(known.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        std::fs::write(known.join("perf.jsonl"), "{\"perf/peak_memory_mb\": 6000}\n").unwrap();
        let most = Cell::new(0);
        let tell = |event: Event| {
            if let Event::Count(_, running) = event {
                most.set(most.get().max(running));
            }
        };
        // Two have no room beside each other, which is known from before.
        let command = |job: &Job, _: Stage, run: &Path| {
            if job.seed == 2 {
                return shell(format!(
                    "sleep 0.2; rm '{0}/perf.jsonl'; sleep 0.2; mkdir -p '{1}'; \
                     echo '{{\"outcome\":\"finished\"}}' > '{1}/run.json'",
                    known.display(),
                    run.display()
                ));
            }
            finishes(run, 0.0)
        };
        run(dir.path(), &plan, Budget { memory_gb: 8.0, ..BUDGET }, command, || false, tell).unwrap();
        assert_eq!((most.get(), known.join("perf.jsonl").exists()), (1, false));
    }

    #[test]
    fn trained_runs_are_evaluated_and_begun_ones_resumed() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan("evaluate = true\n"));
        let begun = dir.path().join(&plan.jobs[1].folder);
        std::fs::create_dir_all(&begun).unwrap();
        std::fs::write(begun.join("config.toml"), "").unwrap();
        let stages = std::cell::RefCell::new(Vec::new());
        let command = |job: &Job, stage: Stage, run: &Path| {
            stages.borrow_mut().push((job.seed, stage));
            match stage {
                Stage::Evaluate => shell(format!("echo '{{}}' > '{}/eval.json'", run.display())),
                _ => finishes(run, 0.0),
            }
        };
        run(dir.path(), &plan, BUDGET, command, || false, |_| ()).unwrap();
        let of = |seed: u64| stages.borrow().iter().filter(|s| s.0 == seed).map(|s| s.1).collect::<Vec<_>>();
        assert_eq!(of(1), [Stage::Train, Stage::Evaluate]);
        assert_eq!(of(2), [Stage::Resume, Stage::Evaluate]);
    }

    #[test]
    fn a_run_that_outlived_its_sweep_is_waited_for() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        let run_1 = dir.path().join(&plan.jobs[0].folder);
        std::fs::create_dir_all(&run_1).unwrap();
        let lock = File::create(run_1.join(".lock")).unwrap();
        lock.try_lock().unwrap();
        let ends = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(150));
            std::fs::write(run_1.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
            drop(lock);
        });
        let adopted = Cell::new(0);
        let command = |job: &Job, _: Stage, run: &Path| {
            assert_ne!(job.seed, 1, "it was running already");
            finishes(run, 0.0)
        };
        let tell = |event: Event| adopted.set(adopted.get() + u32::from(matches!(event, Event::Adopted(_))));
        assert_eq!(run(dir.path(), &plan, BUDGET, command, || false, tell).unwrap(), Ended::Done);
        assert_eq!(adopted.get(), 1);
        ends.join().unwrap();
    }

    #[test]
    fn an_evaluation_that_outlived_its_sweep_is_waited_for() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan("evaluate = true\n"));
        let run_1 = dir.path().join(&plan.jobs[0].folder);
        std::fs::create_dir_all(&run_1).unwrap();
        std::fs::write(run_1.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        let lock = crate::hold_evaluation(&run_1).unwrap();
        let ends = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(150));
            std::fs::write(run_1.join("eval.json"), "{}").unwrap();
            drop(lock);
        });
        let command = |job: &Job, stage: Stage, run: &Path| {
            assert_ne!(job.seed, 1, "it was evaluated already");
            match stage {
                Stage::Evaluate => shell(format!("echo '{{}}' > '{}/eval.json'", run.display())),
                _ => finishes(run, 0.0),
            }
        };
        let adopted = Cell::new(0);
        let tell = |event: Event| adopted.set(adopted.get() + u32::from(matches!(event, Event::Adopted(_))));
        assert_eq!(run(dir.path(), &plan, BUDGET, command, || false, tell).unwrap(), Ended::Done);
        assert_eq!((adopted.get(), attempts(dir.path()).len()), (1, 0));
        ends.join().unwrap();
    }

    #[test]
    fn asked_to_stop_it_asks_its_runs_and_counts_no_failure() {
        let (dir, plan) = (tempfile::tempdir().unwrap(), plan(""));
        let start = Instant::now();
        let command = |_: &Job, _: Stage, _: &Path| shell("trap 'exit 130' TERM; sleep 30 & wait".into());
        let stop = || start.elapsed() > Duration::from_millis(200);
        assert_eq!(run(dir.path(), &plan, BUDGET, command, stop, |_| ()).unwrap(), Ended::Interrupted);
        assert!(start.elapsed() < Duration::from_secs(20) && attempts(dir.path()).is_empty());
    }

    #[test]
    fn budgets_follow_the_machine_and_the_wish() {
        assert_eq!(Budget::new(0, 8, 2, 4.0, 9), Budget { jobs: 4, threads: 2, memory_gb: 4.0 });
        assert_eq!(Budget::new(3, 8, 0, 4.0, 9), Budget { jobs: 3, threads: 2, memory_gb: 4.0 });
        assert_eq!(Budget::new(0, 2, 0, 4.0, 9), Budget { jobs: 2, threads: 1, memory_gb: 4.0 });
        assert_eq!(Budget::new(5, 2, 0, 4.0, 9).threads, 1);
        // Fewer jobs than processors leave none idle.
        assert_eq!(Budget::new(0, 8, 0, 4.0, 3), Budget { jobs: 3, threads: 2, memory_gb: 4.0 });
        assert_eq!(Budget::new(5, 8, 0, 4.0, 1), Budget { jobs: 1, threads: 8, memory_gb: 4.0 });
        assert_eq!(Budget::new(0, 8, 2, 4.0, 1), Budget { jobs: 1, threads: 2, memory_gb: 4.0 });
    }
}
