//! Work that is handed to a Slurm cluster: what sweeps, trainings and curations share.

pub mod curate;
pub mod sweep;
pub mod task;
pub mod train;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use riglab_config::Config;
use riglab_slurm::{Queue, Queued, Script, SlurmConfig, SlurmError, Submission, array_size, record, submissions};
use riglab_train::Interrupt;
use serde::{Deserialize, Serialize};

use crate::presets;

/// Where work is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum On {
    /// By jobs of a Slurm cluster, as the table [slurm] of the config says. The folders must be on a file system that
    /// its nodes share.
    Slurm,
}

/// The table `[slurm]` of a config, or what holds without one.
pub fn settings(config: &Config) -> Result<SlurmConfig> {
    if !config.contains("slurm") {
        return Ok(SlurmConfig::default());
    }
    let slurm: SlurmConfig = config.get_at("slurm")?;
    slurm.validate().map_err(|(key, message)| config.invalid(&key, message))?;
    Ok(slurm)
}

/// Changes of `[slurm]`, one of its keys or several at once, and those of the work itself.
pub fn apart(sets: &[String]) -> (Vec<String>, Vec<String>) {
    sets.iter().cloned().partition(|set| is_of_cluster(set.split('=').next().unwrap_or_default()))
}

/// Whether a key is `slurm`, or one of that table.
pub fn is_of_cluster(key: &str) -> bool {
    key.trim().strip_prefix("slurm").is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// The file form of settings.
#[derive(Serialize, Deserialize)]
struct Kept {
    slurm: SlurmConfig,
}

/// Where the jobs of a piece of work are written down: the folder `slurm` within that of the work.
///
/// ```text
/// settings.toml   the table [slurm], as the last submission was given it; before that, as the work was begun without one
/// jobs.jsonl      a line a job that was submitted
/// job-N.sh        its script
/// job-N.toml      the table [slurm] that it was submitted with
/// starts/         a line a start of a task
/// logs/           what tasks say
/// ```
pub struct Desk {
    folder: PathBuf,
    /// What jobs ask for.
    pub config: SlurmConfig,
    /// What is kept of it for later calls: all but what these derive again.
    said: SlurmConfig,
    /// As an earlier call left it, or as a config has it.
    before: SlurmConfig,
}

/// A job to be submitted.
pub struct Order<'a> {
    /// `sweep`, `train`, `curate`, `merge`.
    pub what: &'a str,
    /// Its name in the queue.
    pub name: &'a str,
    /// Numbers of the work that it does, as an array; none without one.
    pub numbers: &'a [usize],
    /// Failed attempts that are known.
    pub failures: usize,
    /// The job that must end well before.
    pub after: Option<&'a str>,
    /// Whether it trains.
    pub parallel: bool,
    /// Arguments of `riglab slurm-task`; the offset of the numbers is added.
    pub command: &'a [&'a str],
}

impl Desk {
    /// For the work of a folder.
    pub fn new(work: &Path, config: SlurmConfig) -> Result<Self> {
        let work = std::path::absolute(work).with_context(|| format!("{} has no place", work.display()))?;
        Ok(Self { folder: work.join("slurm"), said: config.clone(), before: config.clone(), config })
    }

    /// With the settings of an earlier call, or defaults, and changes.
    pub fn reopen(work: &Path, sets: &[String]) -> Result<Self> {
        let desk = Self::new(work, SlurmConfig::default())?;
        let path = desk.settings();
        desk.with_kept(&path, sets)
    }

    /// For a task of a submission, whose job got what was asked for then. Scripts of earlier versions do not tell which it
    /// was: their tasks have the settings of the last one.
    pub fn of_submission(work: &Path, number: Option<usize>) -> Result<Self> {
        let Some(number) = number else { return Self::reopen(work, &[]) };
        let desk = Self::new(work, SlurmConfig::default())?;
        let path = desk.settings_of(number);
        if !path.is_file() {
            bail!("{}: no such file; the job cannot tell what it was submitted with", path.display());
        }
        desk.with_kept(&path, &[])
    }

    /// With the settings of a file, defaults without one, and changes.
    fn with_kept(mut self, path: &Path, sets: &[String]) -> Result<Self> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(e).with_context(|| format!("{} cannot be read", path.display())),
        };
        let read = |sets: &[String]| -> Result<(Config, SlurmConfig)> {
            let config = presets::parse(&path.display().to_string(), &text, sets)?;
            let slurm = if config.contains("slurm") { config.get_at("slurm")? } else { SlurmConfig::default() };
            Ok((config, slurm))
        };
        let (config, changed) = read(sets)?;
        let kept = read(&[]).map(|(_, kept)| kept).unwrap_or_default();
        changed.validate_after(&kept).map_err(|(key, message)| config.invalid(&key, message))?;
        (self.config, self.said, self.before) = (changed.clone(), changed, kept);
        Ok(self)
    }

    /// For work of so many threads a process: it gets as many processors at least.
    pub fn for_threads(self, threads: usize) -> Result<Self> {
        self.with(|slurm| slurm.cpus = slurm.cpus.max(threads))
    }

    /// With a change that holds for later calls, too.
    pub fn with(mut self, change: impl Fn(&mut SlurmConfig)) -> Result<Self> {
        change(&mut self.config);
        change(&mut self.said);
        self.checked()
    }

    /// With the memory that the work is known to take, where nothing else is said of memory. Later calls may know better, or
    /// say something: it is not kept for them.
    pub fn for_memory(mut self, gigabytes: f64) -> Result<Self> {
        if gigabytes > 0.0 && !self.config.asks_for_memory() {
            self.config.memory = format!("{:.0}M", (gigabytes * 1024.0).ceil());
        }
        self.checked()
    }

    /// Refuses what options of an earlier version would hide.
    fn checked(self) -> Result<Self> {
        let told = self.config.validate_after(&self.before);
        told.map_err(|(key, message)| anyhow!("{}: `{key}`: {message}", self.settings().display()))?;
        Ok(self)
    }

    /// Whether anything was ever submitted from here.
    pub fn is_known(work: &Path) -> bool {
        work.join("slurm/jobs.jsonl").is_file()
    }

    /// What to say where nothing was ever said of a cluster; `others` tells how to.
    pub fn without_settings(&self, others: &str) -> Option<String> {
        let none = self.before == SlurmConfig::default() && !self.file("jobs.jsonl").is_file();
        none.then(|| format!("no settings for a cluster are kept here, so that its defaults hold; {others}"))
    }

    /// Writes the settings down for later calls that name the folder alone, where it has no others: of what was submitted
    /// those count.
    pub fn keep_for_later(&self) -> Result<()> {
        let says_nothing = self.said == SlurmConfig::default() && !self.settings().is_file();
        if says_nothing || self.file("jobs.jsonl").is_file() {
            return Ok(());
        }
        write(&self.settings(), &kept(&self.said)?)
    }

    fn settings(&self) -> PathBuf {
        self.folder.join("settings.toml")
    }

    fn settings_of(&self, submission: usize) -> PathBuf {
        self.file(&format!("job-{submission}.toml"))
    }

    /// Writes the settings down, for later calls and for the tasks of a submission.
    fn keep(&self, submission: usize) -> Result<()> {
        write(&self.settings(), &kept(&self.said)?)?;
        write(&self.settings_of(submission), &kept(&self.config)?)
    }

    /// A file of the desk.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The starts of a task.
    pub fn starts(&self, number: usize) -> PathBuf {
        self.folder.join(format!("starts/{number}.jsonl"))
    }

    /// Where tasks' messages are.
    pub fn logs(&self) -> PathBuf {
        self.folder.join("logs")
    }

    /// The jobs that were submitted.
    pub fn submitted(&self) -> Vec<Submission> {
        submissions(&self.file("jobs.jsonl"))
    }

    /// Those that are in the queue.
    pub fn queue(&self) -> Result<Queue, SlurmError> {
        let jobs: Vec<String> = self.submitted().into_iter().map(|s| s.job).collect();
        riglab_slurm::queue(&jobs)
    }

    /// Writes scripts and submits them: one, or as many as the cluster's longest array asks for.
    pub fn submit(&self, order: &Order) -> Result<Vec<Submission>> {
        std::fs::create_dir_all(self.logs()).with_context(|| format!("{} cannot be made", self.logs().display()))?;
        if order.numbers.is_empty() {
            return Ok(vec![self.submit_one(order, 0, &[])?]);
        }
        let most = array_size()?;
        let parts = order.numbers.chunk_by(|a, b| a / most == b / most);
        parts.map(|part| self.submit_one(order, part[0] / most * most, part)).collect()
    }

    fn submit_one(&self, order: &Order, offset: usize, numbers: &[usize]) -> Result<Submission> {
        let own = std::env::current_exe().context("the program does not know its own file")?;
        let own = own.to_str().context("the program's own path is not UTF-8")?;
        let here = std::env::current_dir().context("the working folder is gone")?;
        let tasks: Vec<usize> = numbers.iter().map(|n| n - offset).collect();
        let number = self.submitted().len() + 1;
        self.keep(number)?;
        let (offset_text, number_text) = (offset.to_string(), number.to_string());
        let mut command = vec![own, "slurm-task"];
        command.extend(order.command);
        command.extend(["--submission", &number_text]);
        if offset > 0 {
            command.extend(["--offset", &offset_text]);
        }
        let script = Script {
            name: order.name,
            config: &self.config,
            folder: &here,
            logs: &self.logs(),
            tasks: &tasks,
            after: order.after,
            parallel: order.parallel,
            command: &command,
        };
        let path = self.file(&format!("job-{number}.sh"));
        write(&path, &script.text()?)?;
        let job = riglab_slurm::submit(&path).with_context(|| format!("{} is not taken", path.display()))?;
        let what = order.what.into();
        let submission = Submission { job, what, offset, numbers: numbers.to_vec(), failures: order.failures };
        record(&self.file("jobs.jsonl"), &submission)?;
        Ok(submission)
    }

    /// Looks at the queue until none of the jobs is left in it, or `interrupt` is raised; `tell` hears what is there.
    /// False when it was.
    pub fn follow(&self, interrupt: &Interrupt, mut tell: impl FnMut(&Queue)) -> Result<bool> {
        let mut silent = false;
        loop {
            match self.queue() {
                Ok(queue) if queue.is_empty() => return Ok(true),
                Ok(queue) => {
                    silent = false;
                    tell(&queue);
                }
                // It may be restarted just now; its jobs go on without it.
                Err(e @ SlurmError::Refused { .. }) => {
                    if !silent {
                        tell!("note: {e}; asking again");
                    }
                    silent = true;
                }
                Err(e) => return Err(e.into()),
            }
            let start = Instant::now();
            while start.elapsed() < Duration::from_secs(self.config.look_seconds) {
                if interrupt.raised() {
                    return Ok(false);
                }
                std::thread::sleep(Duration::from_millis(50));
            }
        }
    }
}

/// Settings as a file has them.
fn kept(slurm: &SlurmConfig) -> Result<String> {
    Ok(toml::to_string(&Kept { slurm: slurm.clone() })?)
}

/// A queued job in words.
fn shown(queued: &Queued, starts: usize) -> String {
    let again = if starts > 1 { format!(", begun {starts} times") } else { String::new() };
    match queued.state.as_str() {
        "PENDING" | "REQUEUED" if starts > 0 => format!("requeued ({}){again}", queued.reason),
        "PENDING" => format!("queued ({})", queued.reason),
        "RUNNING" => format!("on {}{again}", queued.nodes),
        other => format!("{}{again}", other.to_lowercase()),
    }
}

/// How many are on nodes and how many wait.
fn counted(queue: &Queue) -> String {
    let waiting = queue.iter().filter(|q| q.state == "PENDING").count();
    format!("{} running, {waiting} queued", queue.len() - waiting)
}

fn write(path: &Path, text: &str) -> Result<()> {
    let written = riglab_files::make_folder_of(path).and_then(|()| riglab_files::write(path, text.as_bytes()));
    written.with_context(|| format!("{} cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_kept_and_changed() {
        let dir = tempfile::tempdir().unwrap();
        let desk = Desk::reopen(dir.path(), &["slurm.time='1:00:00'".into()]).unwrap();
        assert_eq!(desk.config.time, "1:00:00");
        write(&desk.settings(), &kept(&desk.config).unwrap()).unwrap();
        let desk = Desk::reopen(dir.path(), &["slurm.partition=cpu".into()]).unwrap();
        assert_eq!((desk.config.time.as_str(), desk.config.partition.as_str()), ("1:00:00", "cpu"));
        let said = Desk::reopen(dir.path(), &["slurm.time=soon".into()]).err().unwrap().to_string();
        assert!(said.contains("--set slurm.time=soon") && said.contains("no time as Slurm takes it"), "{said}");
        let (own, rest) = apart(&["slurm.cpus=2".into(), "train.steps=3".into()]);
        assert_eq!((own.len(), rest), (1, vec!["train.steps=3".to_owned()]));
        let (own, rest) = apart(&["slurm={time='4:00:00'}".into(), "slurmy.cpus=2".into()]);
        assert_eq!((own.len(), rest.len()), (1, 1));
        assert_eq!(Desk::reopen(dir.path(), &own).unwrap().config.time, "4:00:00");
        // What an earlier version took stays, and stands in no other change's way.
        std::fs::write(dir.path().join("slurm/settings.toml"), "[slurm]\noptions = ['-pcpu']\n").unwrap();
        let desk = Desk::reopen(dir.path(), &["slurm.time=4:00:00".into()]).unwrap();
        assert_eq!((desk.config.time.as_str(), desk.config.options), ("4:00:00", vec!["-pcpu".to_owned()]));
        let said = Desk::reopen(dir.path(), &["slurm.partition=gpu".into()]).err().unwrap().to_string();
        assert!(said.contains("settings.toml") && said.contains("--set slurm.options='[]'"), "{said}");
        let desk = |cpus: usize| Desk::new(dir.path(), SlurmConfig { cpus, ..SlurmConfig::default() }).unwrap();
        assert_eq!(
            [(0, 0), (0, 4), (8, 4), (2, 4)].map(|(cpus, threads)| desk(cpus)
                .for_threads(threads)
                .unwrap()
                .config
                .cpus),
            [0, 4, 8, 4]
        );
    }

    #[test]
    fn what_was_begun_here_keeps_its_settings_for_a_cluster() {
        let dir = tempfile::tempdir().unwrap();
        let desk =
            |time: &str| Desk::new(dir.path(), SlurmConfig { time: time.into(), ..SlurmConfig::default() }).unwrap();
        let kept = || Desk::reopen(dir.path(), &[]).unwrap().config.time;
        desk("").keep_for_later().unwrap();
        assert!(!dir.path().join("slurm").exists(), "nothing is asked for");
        desk("4:00:00").keep_for_later().unwrap();
        assert_eq!(kept(), "4:00:00");
        let note = || Desk::reopen(dir.path(), &[]).unwrap().without_settings("say some");
        assert_eq!(note(), None);
        desk("").keep_for_later().unwrap();
        assert_eq!(kept(), "", "the table was taken out of the file");
        assert!(note().unwrap().ends_with("its defaults hold; say some"));
        // A submission knows better.
        desk("2:00:00").keep(1).unwrap();
        std::fs::write(dir.path().join("slurm/jobs.jsonl"), "").unwrap();
        desk("1:00:00").keep_for_later().unwrap();
        assert_eq!(kept(), "2:00:00");
        // That it asked for nothing was meant.
        desk("").keep(2).unwrap();
        assert_eq!((kept(), note()), (String::new(), None));
    }

    #[test]
    fn what_follows_from_the_work_stands_in_no_later_callers_way() {
        let dir = tempfile::tempdir().unwrap();
        let desk = Desk::new(dir.path(), SlurmConfig::default()).unwrap();
        let desk = desk.for_threads(3).and_then(|desk| desk.with(|slurm| slurm.at_a_time = 2)).unwrap();
        let desk = desk.for_memory(1.5).unwrap();
        desk.keep(1).unwrap();
        let of_job = Desk::of_submission(dir.path(), Some(1)).unwrap().config;
        assert_eq!((of_job.memory.as_str(), &of_job), ("1536M", &desk.config));
        let own = "slurm.options=['--mem-per-cpu=2G']".to_owned();
        let later = Desk::reopen(dir.path(), &[own]).unwrap().for_memory(1.5).unwrap().config;
        assert_eq!((later.memory.as_str(), later.cpus, later.at_a_time), ("", 3, 2));
        // Options of an earlier version hide nothing that is asked for now.
        let earlier = "[slurm]\ncpus = 2\noptions = ['-c2', '--mem=4G']\n";
        std::fs::write(dir.path().join("slurm/settings.toml"), earlier).unwrap();
        let open = || Desk::reopen(dir.path(), &[]).unwrap();
        assert_eq!(open().for_threads(2).unwrap().for_memory(1.5).unwrap().config.memory, "");
        let said = open().for_threads(8).err().unwrap().to_string();
        assert!(
            said.contains("settings.toml: `slurm.options`: `-c`") && said.contains("--set slurm.options='[]'"),
            "{said}"
        );
    }

    #[test]
    fn a_task_has_the_settings_of_its_own_submission() {
        let dir = tempfile::tempdir().unwrap();
        for (number, processes) in [(1, 1), (2, 4)] {
            let config = SlurmConfig { processes, ..SlurmConfig::default() };
            Desk::new(dir.path(), config).unwrap().keep(number).unwrap();
        }
        let of = |number| Desk::of_submission(dir.path(), number).map(|desk| desk.config.processes);
        assert_eq!([Some(1), Some(2), None].map(|number| of(number).unwrap()), [1, 4, 4]);
        assert!(of(Some(3)).unwrap_err().to_string().contains("job-3.toml: no such file"));
    }

    #[test]
    fn the_queue_is_told_in_words() {
        let of = |state: &str| Queued {
            job: "17".into(),
            task: Some(1),
            state: state.into(),
            nodes: "n1".into(),
            reason: "Resources".into(),
        };
        assert_eq!(shown(&of("PENDING"), 0), "queued (Resources)");
        assert_eq!(shown(&of("PENDING"), 2), "requeued (Resources), begun 2 times");
        assert_eq!(shown(&of("RUNNING"), 1), "on n1");
        assert_eq!(counted(&vec![of("PENDING"), of("RUNNING"), of("COMPLETING")]), "2 running, 1 queued");
    }
}
