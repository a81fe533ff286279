//! How a sweep was begun: where, and with how many threads a job. Sums round by the number of threads, and relative paths
//! start in a folder, so that a call which says nothing goes on in the same way.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use riglab_report::counted;
use riglab_sweep::Plan;
use riglab_train::RunInfo;
use serde::{Deserialize, Serialize};

/// Holds it, below the sweep's folder.
const FILE: &str = "begun.json";

/// How a sweep was begun, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Begun {
    /// The folder from which the relative paths of its configs lead; empty where it is not known.
    pub folder: PathBuf,
    /// Jobs at a time that were asked for; 0 without a word.
    pub jobs: usize,
    /// Processors that were asked for; 0 without a word.
    pub cores: usize,
    /// Threads of a job that were asked for by the command line; 0 without a word.
    pub told: usize,
    /// Threads of a job, wherever they came from; 0 where they are left to a cluster, or it is not known.
    pub threads: usize,
}

impl Begun {
    /// As the last call left it in a sweep's folder.
    pub fn read(folder: &Path) -> Self {
        let read = || serde_json::from_str(&std::fs::read_to_string(folder.join(FILE)).ok()?).ok();
        read().unwrap_or_default()
    }

    /// With what runs tell of a sweep that an earlier version began.
    #[must_use]
    pub fn or_of_runs(mut self, folder: &Path, plan: &Plan) -> Self {
        if self.threads == 0 || self.folder.as_os_str().is_empty() {
            let runs = plan.jobs.iter().filter_map(|job| RunInfo::of(&folder.join(&job.folder)));
            if let Some(info) = runs.into_iter().find(|info| info.threads > 0) {
                self.threads = if self.threads == 0 { info.threads } else { self.threads };
                self.folder = if self.folder.as_os_str().is_empty() { info.folder.into() } else { self.folder };
            }
        }
        self
    }

    /// How a call goes on that asks for so many jobs at a time, processors and threads of a job (0: without a word), where the
    /// sweep's file has `of_file` threads and the machine `all` processors; and what to say of the threads.
    pub fn asked(&self, [jobs, cores, threads]: [usize; 3], of_file: usize, all: usize) -> (Self, Option<String>) {
        let or = |asked: usize, kept: usize| if asked > 0 { asked } else { kept };
        let (jobs, cores) = (or(jobs, self.jobs), or(cores, self.cores));
        // Those that a job may have: more would get into each other's way.
        let all = or(cores, all);
        let own = all / jobs.max(1);
        let kept = if self.threads <= own { self.threads } else { 0 };
        let now = or(threads, or(kept, of_file));
        let begun = counted(self.threads, "thread");
        let rounds = "sums round otherwise, so that jobs which begin now differ in more than their settings";
        let note = match self.threads {
            0 => None,
            own if threads > 0 => (threads != own).then(|| {
                format!("the sweep was begun with {begun} a job, and goes on with {threads}: {rounds}")
            }),
            // One job takes what there is.
            begun_with if begun_with > own => Some(format!(
                "the sweep was begun with {begun} a job, and there {} here{}: {rounds}",
                if all == 1 { "is 1 processor".to_owned() } else { format!("are {all} processors") },
                if jobs > 1 { format!(" for {jobs} jobs at a time") } else { String::new() }
            )),
            own => (of_file > 0 && of_file != own).then(|| {
                format!(
                    "it goes on with {begun} a job, as it was begun; --threads {of_file} takes those of its file, with sums \
                     that round differently"
                )
            }),
        };
        (Self { folder: self.folder.clone(), jobs, cores, told: or(threads, self.told), threads: now }, note)
    }

    /// What is kept of a call that goes on as `now`, with `threads` a job: those that it was begun with, unless this call
    /// asks for others. A machine that has not as many is no reason.
    #[must_use]
    pub fn after(&self, now: Self, asks: bool, threads: usize) -> Self {
        Self { threads: if asks || self.threads == 0 { threads } else { self.threads }, ..now }
    }

    /// Writes it down for later calls; where it was not known before, it is begun here.
    pub fn keep(mut self, folder: &Path) -> Result<()> {
        if self.folder.as_os_str().is_empty() {
            self.folder = std::env::current_dir().context("there is no working folder")?;
        }
        let (path, text) = (folder.join(FILE), serde_json::to_string(&self)? + "\n");
        riglab_files::write(&path, text.as_bytes()).with_context(|| format!("{} cannot be written", path.display()))
    }

    /// The first of some paths that leads nowhere from here, though it does from the folder where the sweep was begun.
    pub fn lost<'a>(&self, paths: &'a [PathBuf]) -> Option<&'a PathBuf> {
        let known = !self.folder.as_os_str().is_empty();
        paths.iter().find(|path| known && path.is_relative() && !path.exists() && self.folder.join(path).exists())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_that_says_nothing_goes_on_as_the_sweep_was_begun() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(Begun::read(dir.path()), Begun::default());
        let of = |begun: &Begun, asked: [usize; 3], of_file: usize| {
            let (now, note) = begun.asked(asked, of_file, 8);
            ([now.jobs, now.cores, now.threads], note.unwrap_or_default())
        };
        // New: what is asked for comes before the file.
        assert_eq!(of(&Begun::default(), [0, 0, 0], 3), ([0, 0, 3], String::new()));
        assert_eq!(of(&Begun::default(), [2, 0, 4], 3), ([2, 0, 4], String::new()));
        Begun { jobs: 2, threads: 4, ..Begun::default() }.keep(dir.path()).unwrap();
        let kept = Begun::read(dir.path());
        assert_eq!(kept.folder, std::env::current_dir().unwrap());
        assert_eq!(of(&kept, [0, 0, 0], 0), ([2, 0, 4], String::new()));
        assert_eq!(of(&kept, [0, 6, 4], 0), ([2, 6, 4], String::new()), "each of the two by itself");
        assert_eq!(of(&kept, [1, 0, 0], 0), ([1, 0, 4], String::new()));
        // More jobs at a time, or fewer processors, leave less for each.
        let (now, note) = of(&kept, [4, 0, 0], 0);
        assert!(now == [4, 0, 0] && note.contains("there are 8 processors here for 4 jobs at a time: sums"), "{note}");
        let (now, note) = of(&kept, [0, 4, 0], 2);
        assert!(now == [2, 4, 2] && note.contains("there are 4 processors here for 2 jobs at a time: sums"), "{note}");
        let (now, note) = of(&kept, [0, 0, 0], 2);
        assert!(now[2] == 4 && note.contains("4 threads a job, as it was begun; --threads 2 takes"), "{note}");
        let (now, note) = of(&kept, [0, 0, 1], 0);
        assert!(now == [2, 0, 1] && note.contains("begun with 4 threads a job, and goes on with 1: sums"), "{note}");
        // There are not as many.
        let (now, note) = kept.asked([0; 3], 0, 2);
        assert!(now.threads == 0 && note.unwrap().contains("there are 2 processors here"));
        // What it was begun with stays, until a call asks for others.
        assert_eq!(kept.after(now.clone(), false, 1).threads, 4);
        let other = kept.after(kept.asked([0, 0, 2], 0, 8).0, true, 2);
        assert_eq!((other.told, other.threads, kept.told), (2, 2, 0));
        assert_eq!(Begun::default().after(now, false, 1).threads, 1);
    }

    #[test]
    fn what_an_earlier_version_began_is_told_by_its_runs() {
        let dir = tempfile::tempdir().unwrap();
        let config = riglab_config::Config::from_toml_str("s.toml", "[sweep]\nbase = 'b'\nseeds = [0, 1]\n").unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let begun = |begun: Begun| begun.or_of_runs(dir.path(), &plan);
        assert_eq!(begun(Begun::default()), Begun::default());
        let run = dir.path().join(&plan.jobs[1].folder);
        std::fs::create_dir_all(&run).unwrap();
        let info = RunInfo { threads: 3, folder: dir.path().display().to_string(), ..RunInfo::default() };
        std::fs::write(run.join("run.json"), serde_json::to_string(&info).unwrap()).unwrap();
        let found = begun(Begun::default());
        assert_eq!((found.threads, found.folder.as_path()), (3, dir.path()));
        assert_eq!(begun(Begun { threads: 2, ..Begun::default() }).threads, 2);
        // Paths that lead somewhere from there alone.
        std::fs::write(dir.path().join("only_there.h5"), "").unwrap();
        let paths = ["Cargo.toml", "nowhere.h5", "only_there.h5"].map(PathBuf::from);
        assert_eq!((found.lost(&paths), found.lost(&paths[..2])), (Some(&paths[2]), None));
        assert_eq!(Begun::default().lost(&paths), None);
    }
}
