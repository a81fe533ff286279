//! The folder of a run.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

use crate::TrainError;

/// Between looks at a lock, and how many.
const PAUSE: Duration = Duration::from_millis(20);
const LOOKS: u32 = 5;

/// A run folder, held by this process or, where several train together, by the first of them.
///
/// ```text
/// config.toml      the resolved config; training from it repeats the run
/// metrics.jsonl    the truth: one line a step or validation
/// perf.jsonl       what depends on the clock: speed, memory, time
/// run.json         versions, machine, data, start, end, how it ended
/// tensorboard/     a view
/// checkpoints/     step-N/, last, best
/// ```
pub struct Run {
    dir: PathBuf,
    // Unlocked when the process ends, however it ends.
    _lock: Option<File>,
}

/// `run.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RunInfo {
    /// The task.
    pub task: String,
    /// The command line.
    pub command: Vec<String>,
    /// The folder where it was given, from which paths of the config lead; empty where it is not known.
    #[serde(default)]
    pub folder: String,
    /// Version of riglab, with the commit that it was built of.
    pub riglab: String,
    /// Version of libtorch and the instruction set it chose.
    pub libtorch: String,
    /// Commit of the working folder, with `+` where it had changes; empty outside a repository.
    pub commit: String,
    /// Processor, cores and memory.
    pub machine: String,
    /// Threads of libtorch.
    pub threads: usize,
    /// Processes that trained together.
    #[serde(default)]
    pub ranks: usize,
    /// Device the network ran on.
    pub device: String,
    /// Corpora: path, checksum and number of assets.
    pub data: Vec<(String, String, usize)>,
    /// Networks that it computes with beside the trained one: the key that names each, and a checksum of its weights.
    #[serde(default)]
    pub companions: Vec<(String, String)>,
    /// A checksum of the weights that it began with (`train.start`); empty where all were drawn, and where an earlier
    /// version began it.
    #[serde(default)]
    pub start: String,
    /// Numbers in the network.
    pub parameters: usize,
    /// When it began, UTC.
    pub started: String,
    /// When it went on after an interruption, and with what.
    pub resumed: Vec<Resumed>,
    /// Steps that it is to have; 0 where an earlier version began it.
    #[serde(default)]
    pub steps: u64,
    /// Where it was given other steps than it was begun with.
    #[serde(default)]
    pub extended: Vec<Extended>,
    /// When it ended, UTC; empty while it runs.
    pub ended: String,
    /// How it ended: `finished`, `interrupted`, or the error.
    pub outcome: String,
    /// Seconds of training in all, resumed parts included; of a part that was killed up to its last checkpoint.
    pub seconds: f64,
}

/// A run going on after an interruption.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Resumed {
    /// When, UTC: all that earlier versions noted.
    When(String),
    /// With what, which need not be what it was begun with.
    With {
        /// When, UTC.
        at: String,
        /// As [`RunInfo::riglab`].
        riglab: String,
        /// As [`RunInfo::libtorch`].
        libtorch: String,
        /// As [`RunInfo::commit`].
        commit: String,
        /// As [`RunInfo::machine`].
        machine: String,
        /// As [`RunInfo::threads`].
        threads: usize,
        /// As [`RunInfo::ranks`].
        ranks: usize,
        /// As [`RunInfo::device`].
        device: String,
        /// Steps that were saved by then; 0 where an earlier version noted it.
        #[serde(default)]
        steps: u64,
    },
}

/// A run that was given other steps than it had.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extended {
    /// When, UTC.
    pub when: String,
    /// Steps done by then.
    pub at: u64,
    /// Steps that it was to have before.
    pub from: u64,
    /// Steps that it is to have since.
    pub to: u64,
    /// Whether it is what so many steps from the start give: what follows from their number was the same until then, and so
    /// were the threads and the device.
    pub as_from_start: bool,
}

impl Run {
    /// Makes the folder of a new run and writes its config.
    ///
    /// # Errors
    /// When the folder holds a run already, or cannot be written.
    pub fn create(dir: &Path, config: &str) -> Result<Self, TrainError> {
        if dir.join("config.toml").exists() {
            let message = "holds a run already; continue it with --resume, or choose another folder".into();
            return Err(TrainError::Io { path: dir.into(), message });
        }
        let steps = fs::read_dir(dir.join("checkpoints")).is_ok_and(|mut entries| entries.next().is_some());
        if steps || dir.join("metrics.jsonl").exists() {
            // They are of settings that nobody knows any more, and would pass for those of this run.
            let message =
                "holds checkpoints or metrics of a run whose config.toml is gone; choose another folder".into();
            return Err(TrainError::Io { path: dir.into(), message });
        }
        fs::create_dir_all(dir.join("checkpoints")).map_err(|e| TrainError::io(dir, "be made", &e))?;
        let run = Self::hold(dir)?;
        let path = dir.join("config.toml");
        riglab_files::write(&path, config.as_bytes()).map_err(|e| TrainError::io(&path, "be written", &e))?;
        Ok(run)
    }

    /// Opens the folder of a run to go on with it.
    ///
    /// # Errors
    /// When it is none, or another process is at it.
    pub fn open(dir: &Path) -> Result<Self, TrainError> {
        if !dir.join("config.toml").is_file() {
            let message = format!("no run here (there is no config.toml){}", below(dir));
            return Err(TrainError::Io { path: dir.into(), message });
        }
        Self::hold(dir)
    }

    /// The folder of a run that another rank holds: this one only reads.
    pub fn follow(dir: &Path) -> Self {
        Self { dir: dir.into(), _lock: None }
    }

    fn hold(dir: &Path) -> Result<Self, TrainError> {
        let path = dir.join(".lock");
        let lock = File::create(&path).map_err(|e| TrainError::io(&path, "be written", &e))?;
        let fault = |message: String| TrainError::Io { path: dir.into(), message };
        match taken(|| lock.try_lock()) {
            Ok(true) => Ok(Self { dir: dir.into(), _lock: Some(lock) }),
            Ok(false) => Err(fault("another process is training in this folder".into())),
            Err(e) => Err(fault(format!(
                "its file system refuses the lock that keeps two processes from training in one folder ({e}); put the run on \
                 another, such as a local disk"
            ))),
        }
    }

    /// The folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// A path inside.
    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// `run.json`, if there is one.
    ///
    /// # Errors
    /// As [`RunInfo::read`].
    pub fn info(&self) -> Result<Option<RunInfo>, TrainError> {
        RunInfo::read(&self.dir)
    }

    /// Notes in `run.json`, where there is one, how many seconds of training there were: a run that is killed cannot say so.
    ///
    /// # Errors
    /// When the file system refuses.
    pub(crate) fn note_seconds(&self, seconds: f64) -> Result<(), TrainError> {
        let info = RunInfo::of(&self.dir);
        info.map_or(Ok(()), |info| self.write_info(&RunInfo { seconds, ..info }))
    }

    /// Writes `run.json`.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn write_info(&self, info: &RunInfo) -> Result<(), TrainError> {
        let path = self.path("run.json");
        let text = serde_json::to_string_pretty(info).expect("plain data") + "\n";
        riglab_files::write(&path, text.as_bytes()).map_err(|e| TrainError::io(&path, "be written", &e))
    }
}

impl RunInfo {
    /// What a run's folder says of itself, if it can be read: for whoever can do without.
    pub fn of(run: &Path) -> Option<Self> {
        Self::read(run).ok().flatten()
    }

    /// What a run's folder says of itself; `None` where it holds no `run.json`.
    ///
    /// # Errors
    /// When there is one that cannot be read or understood: what the run was begun with is not known then, and a new one in
    /// its place would lose it for good.
    pub fn read(run: &Path) -> Result<Option<Self>, TrainError> {
        let path = run.join("run.json");
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(None),
            Err(e) => return Err(TrainError::io(&path, "be read", &e)),
        };
        serde_json::from_slice(&bytes).map(Some).map_err(|e| {
            let message = format!(
                "cannot be understood ({e}): it was cut off, or changed; put it back from a copy, or move it away, and what \
                 the run was begun with is no longer known or compared"
            );
            TrainError::Io { path, message }
        })
    }

    /// What can be known about program and machine, with the start set to now.
    pub fn new(riglab: &str, task: &str, threads: usize, device: &str) -> Self {
        Self {
            task: task.into(),
            command: std::env::args_os().map(|arg| arg.to_string_lossy().into_owned()).collect(),
            folder: std::env::current_dir().map_or(String::new(), |folder| folder.display().to_string()),
            riglab: riglab.into(),
            libtorch: format!("{} {}", riglab_torch::libtorch_version(), riglab_torch::cpu_capability()),
            commit: commit(),
            machine: machine(),
            threads,
            ranks: 1,
            device: device.into(),
            started: now(),
            ..Self::default()
        }
    }

    /// Notes that the run goes on after so many steps that were saved, with what `now` tells.
    pub fn go_on(&mut self, steps: u64, now: Self) {
        let Self { riglab, libtorch, commit, machine, threads, ranks, device, started: at, .. } = now;
        self.resumed.push(Resumed::With { at, riglab, libtorch, commit, machine, threads, ranks, device, steps });
        self.reopen();
    }

    /// It is not what it ended as any more: if it is killed, that must not stand there.
    fn reopen(&mut self) {
        self.ended.clear();
        self.outcome.clear();
    }

    /// Whether it came to its end, or was put here as it is: that stays unless it goes on.
    pub fn is_over(&self) -> bool {
        ["finished", "imported", "exported"].contains(&self.outcome.as_str())
    }

    /// Whether it had a checkpoint at some time, as far as is noted: one that ended by itself, or went on from one.
    pub(crate) fn was_saved(&self) -> bool {
        let from = |resumed: &Resumed| matches!(resumed, Resumed::With { steps, .. } if *steps > 0);
        ["finished", "interrupted"].contains(&self.outcome.as_str())
            || self.resumed.iter().any(from)
            || self.extended.iter().any(|extended| extended.at > 0)
    }

    /// Notes that the run, after `at` steps, is given `to` of them; `alike`: whether it was the same until then as one of so
    /// many.
    pub fn extend(&mut self, at: u64, to: u64, alike: bool) {
        let as_from_start = alike && self.extended.iter().all(|e| e.as_from_start);
        self.extended.push(Extended { when: now(), at, from: self.steps, to, as_from_start });
        self.steps = to;
        self.reopen();
    }

    /// Whether it ran on the same device with the same threads whenever it went on, so that its sums round alike.
    pub fn is_steady(&self) -> bool {
        self.resumed.iter().all(|resumed| match resumed {
            Resumed::When(_) => true,
            Resumed::With { threads, ranks, device, .. } => self.rounds_as(*threads, *ranks, device),
        })
    }

    /// Whether sums round as where it was begun on so many threads of so many processes on a device, whatever the number of
    /// batches that are summed.
    pub fn rounds_as(&self, threads: usize, ranks: usize, device: &str) -> bool {
        // Sums of a thread are made by halves: a power of two of processes each make a part of these.
        let (now, then) = (ranks.max(1), self.ranks.max(1));
        let alike = now == then || threads == 1 && now.is_power_of_two() && then.is_power_of_two();
        device == self.device && threads == self.threads && alike
    }

    /// What it was begun on, for a sentence.
    pub fn place(&self) -> String {
        let processes = if self.ranks > 1 { format!("{} processes of ", self.ranks) } else { String::new() };
        let threads = if self.threads == 1 { "1 thread".into() } else { format!("{} threads", self.threads) };
        let device = if self.device == "cpu" { String::new() } else { format!(" on {}", self.device) };
        format!("{processes}{threads}{device}")
    }

    /// Now, UTC.
    pub fn now() -> String {
        now()
    }
}

/// Whether a process trains in a run's folder.
pub(crate) fn is_held(run: &Path) -> bool {
    let lock = File::open(run.join(".lock"));
    lock.is_ok_and(|lock| matches!(taken(|| lock.try_lock_shared()), Ok(false)))
}

/// Whether a lock is had at last: whoever looks whether it is held holds it for a moment.
fn taken(mut attempt: impl FnMut() -> Result<(), TryLockError>) -> io::Result<bool> {
    for look in 0..LOOKS {
        if look > 0 {
            std::thread::sleep(PAUSE);
        }
        match attempt() {
            Ok(()) => return Ok(true),
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(e)) => return Err(e),
        }
    }
    Ok(false)
}

fn now() -> String {
    humantime::format_rfc3339_seconds(SystemTime::now()).to_string()
}

/// Of a folder that is no run, a run that lies in it or a folder deeper, for an error; of several the first by name.
pub fn below(dir: &Path) -> String {
    let folders = |dir: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(dir).into_iter().flatten().flatten();
        let mut all: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
        all.sort();
        all
    };
    let within = folders(dir).into_iter().flat_map(|folder| [vec![folder.clone()], folders(&folder)].concat());
    let run =
        within.into_iter().find(|folder| folder.join("config.toml").is_file() && folder.join("run.json").is_file());
    run.map_or_else(String::new, |run| format!("; a run lies below it: {}", run.display()))
}

fn commit() -> String {
    let git = |args: &[&str]| {
        let out = std::process::Command::new("git").args(args).output().ok()?;
        out.status.success().then(|| String::from_utf8_lossy(&out.stdout).trim().to_string())
    };
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else { return String::new() };
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| !s.is_empty());
    commit + if changed { "+" } else { "" }
}

fn machine() -> String {
    let field = |file: &str, key: &str| {
        let text = fs::read_to_string(file).ok()?;
        let line = text.lines().find(|l| l.starts_with(key))?;
        Some(line.split(':').nth(1)?.trim().to_string())
    };
    let cpu = field("/proc/cpuinfo", "model name").unwrap_or_else(|| std::env::consts::ARCH.into());
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let memory = riglab_torch::memory_gb("MemTotal").unwrap_or(0.0);
    format!("{cpu}, {cores} cores, {memory:.0} GB")
}

/// Refuses other networks beside the trained one than a run was begun with: a run that one of them is named by may have
/// gone on since, and what was learned is about codes, or a policy, of before.
///
/// # Errors
/// A sentence with the key that names it.
pub fn same_companions(before: &[(String, String)], now: &[(String, String)]) -> Result<(), String> {
    match other_companions(before, now).first() {
        None => Ok(()),
        Some((key, other, checksum)) => Err(format!(
            "{key} has other weights ({other}) than those of the training ({checksum}): was that run trained on since? Name \
             the checkpoint that was its best then (--set {key}=RUN/checkpoints/step-N, or in config.toml), or train anew"
        )),
    }
}

/// Of networks beside the trained one those that have other weights than the ones that a run was begun with: key, and the
/// short checksums of now and of then.
pub fn other_companions<'a>(
    before: &'a [(String, String)],
    now: &'a [(String, String)],
) -> Vec<(&'a str, &'a str, &'a str)> {
    let short = |sum: &'a str| sum.get(..12).unwrap_or(sum);
    let other = |(key, checksum): &'a (String, String)| {
        let (_, other) = now.iter().find(|(k, other)| k == key && other != checksum)?;
        Some((key.as_str(), short(other), short(checksum)))
    };
    before.iter().filter_map(other).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_run_went_on_with_is_noted_beside_what_it_was_begun_with() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::create(dir.path(), "").unwrap();
        let mut info = RunInfo::new("1", "t", 2, "cpu");
        info.resumed.push(Resumed::When("2026-01-01T00:00:00Z".into()));
        (info.ended, info.outcome) = ("2026-01-02T00:00:00Z".into(), "interrupted".into());
        info.go_on(7, RunInfo { ranks: 3, ..RunInfo::new("2", "t", 8, "cuda:0") });
        run.write_info(&info).unwrap();
        let read = run.info().unwrap().unwrap();
        // Were it killed now, it would not be as it was left before.
        assert!(read.ended.is_empty() && read.outcome.is_empty() && read.was_saved());
        assert_eq!((read.riglab.as_str(), read.threads, read.device.as_str()), ("1", 2, "cpu"));
        assert_eq!(read.resumed, info.resumed);
        let Resumed::With { riglab, threads, ranks, device, steps, .. } = &read.resumed[1] else { panic!("with what") };
        assert_eq!((riglab.as_str(), *threads, *ranks, device.as_str(), *steps), ("2", 8, 3, "cuda:0", 7));
    }

    #[test]
    fn sums_round_alike_on_the_same_threads_processes_and_device() {
        let of =
            |threads: usize, ranks: usize, device: &str| RunInfo { ranks, ..RunInfo::new("1", "t", threads, device) };
        assert!(of(2, 1, "cpu").rounds_as(2, 1, "cpu") && of(1, 4, "cpu").rounds_as(1, 1, "cpu"));
        assert!(of(2, 0, "cpu").rounds_as(2, 1, "cpu"), "one that does not say");
        assert!(!of(1, 3, "cpu").rounds_as(1, 1, "cpu") && !of(1, 2, "cpu").rounds_as(1, 6, "cpu"), "thirds");
        assert!(of(1, 3, "cpu").rounds_as(1, 3, "cpu"));
        assert!(!of(2, 2, "cpu").rounds_as(2, 1, "cpu") && !of(2, 1, "cuda:0").rounds_as(2, 1, "cpu"));
        assert_eq!(of(1, 1, "cpu").place(), "1 thread");
        assert_eq!(of(2, 2, "cpu").place(), "2 processes of 2 threads");
        assert_eq!(of(8, 1, "cuda:0").place(), "8 threads on cuda:0");
    }

    #[test]
    fn a_folder_of_runs_names_one_of_them() {
        let dir = tempfile::tempdir().unwrap();
        let said = || Run::open(dir.path()).err().expect("it is no run").to_string();
        assert!(said().ends_with("(there is no config.toml)"), "{}", said());
        for name in ["mine/002", "mine/001"] {
            let run = Run::create(&dir.path().join(name), "").unwrap();
            run.write_info(&RunInfo::new("1", "t", 2, "cpu")).unwrap();
        }
        let wanted = format!("; a run lies below it: {}", dir.path().join("mine/001").display());
        assert!(said().ends_with(&wanted), "{}", said());
    }

    #[test]
    fn a_broken_run_json_is_not_taken_for_a_missing_one() {
        let dir = tempfile::tempdir().unwrap();
        assert!(
            RunInfo::read(dir.path()).unwrap().is_none() && RunInfo::read(&dir.path().join("gone")).unwrap().is_none()
        );
        for broken in [&b"{\"task\": \"t\", \"comm"[..], b"{}", b"\xff\xfe", b""] {
            fs::write(dir.path().join("run.json"), broken).unwrap();
            let said = RunInfo::read(dir.path()).unwrap_err().to_string();
            assert!(said.contains("run.json: cannot be understood") && said.contains("from a copy"), "{said}");
            assert!(RunInfo::of(dir.path()).is_none());
        }
    }

    #[test]
    fn a_lock_that_cannot_be_had_is_no_other_process() {
        let dir = tempfile::tempdir().unwrap();
        let held = Run::create(dir.path(), "").unwrap();
        let said = Run::open(dir.path()).err().unwrap().to_string();
        assert!(said.contains("another process is training") && is_held(dir.path()), "{said}");
        drop(held);
        assert!(!is_held(dir.path()));
        assert!(Run::open(dir.path()).is_ok());
        // One who only looks lets go of it.
        let mut looks = 0;
        let momentary = taken(|| {
            looks += 1;
            if looks < 3 { Err(TryLockError::WouldBlock) } else { Ok(()) }
        });
        assert!(momentary.unwrap() && looks == 3);
        let unsupported = || Err(TryLockError::Error(io::Error::from(io::ErrorKind::Unsupported)));
        assert_eq!(taken(unsupported).unwrap_err().kind(), io::ErrorKind::Unsupported);
    }

    #[test]
    fn a_run_is_used_with_the_networks_that_it_was_begun_with() {
        let of = |sum: &str| vec![("skin.run".to_owned(), sum.to_owned())];
        assert!(same_companions(&of("a"), &of("a")).is_ok() && same_companions(&[], &of("a")).is_ok());
        let said = same_companions(&of("a"), &of("b")).unwrap_err();
        assert!(said.contains("skin.run has other weights (b)") && said.contains("step-N"), "{said}");
    }

    #[test]
    fn more_steps_are_noted_with_those_that_were_done() {
        let mut info = RunInfo { steps: 90, outcome: "finished".into(), ..RunInfo::default() };
        for (at, to, alike) in [(90, 120, true), (100, 200, false), (200, 300, true)] {
            info.extend(at, to, alike);
        }
        let noted: Vec<_> = info.extended.iter().map(|e| (e.at, e.from, e.to, e.as_from_start)).collect();
        // What was another run once does not become the same again.
        assert_eq!(noted, [(90, 90, 120, true), (100, 120, 200, false), (200, 200, 300, false)]);
        assert!(info.steps == 300 && info.outcome.is_empty());
        let older: RunInfo = serde_json::from_str(&{
            let mut value = serde_json::to_value(&info).unwrap();
            ["steps", "extended"].iter().for_each(|key| drop(value.as_object_mut().unwrap().remove(*key)));
            value.to_string()
        })
        .unwrap();
        assert!(older.steps == 0 && older.extended.is_empty());
    }
}
