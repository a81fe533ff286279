//! A plan in its folder: written, read, and followed by one with more jobs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use riglab_config::Config;

use crate::attempts::{again, attempts};
use crate::plan::{free_folder, run_folder};
use crate::state::info;
use crate::{Job, Plan, State, SweepError};

impl Plan {
    /// The same jobs after those of a folder's plan, where they have all of these: so a seed or an arm is added to a sweep
    /// while what is done keeps its number. Another sweep's plan leaves them as they are.
    #[must_use]
    pub fn following(mut self, there: &Self) -> Self {
        let same = |a: &Job, b: &Job| a.point == b.point && a.seed == b.seed;
        let place = |job: &Job| there.jobs.iter().position(|old| same(old, job));
        if there.jobs.iter().all(|old| self.jobs.iter().any(|job| same(old, job))) {
            // Those that are added stay in their order.
            self.jobs.sort_by_key(|job| place(job).unwrap_or(usize::MAX));
            let known = there.jobs.iter().map(|old| (old.point.clone(), old.point_folder().to_owned()));
            let mut folders: BTreeMap<String, String> = known.collect();
            let mut taken: BTreeSet<String> = folders.values().cloned().collect();
            for (number, job) in (0..).zip(&mut self.jobs) {
                // A point keeps its folder, whichever come before it now that would have the same.
                let folder = folders.entry(job.point.clone()).or_insert_with(|| free_folder(&job.point, &taken));
                taken.insert(folder.clone());
                (job.number, job.folder) = (number, run_folder(folder, job.seed));
            }
        }
        self
    }

    /// Reads the plan of a sweep's folder; `None` where there is none.
    ///
    /// # Errors
    /// When there is a file that cannot be read or makes no sense.
    pub fn read(folder: &Path) -> Result<Option<Self>, SweepError> {
        let path = file_of(folder);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(SweepError::io(&path, "read", &e)),
        };
        let plan = serde_json::from_str(&text);
        plan.map(Some).map_err(|e| SweepError::Unclear { path, reason: e.to_string() })
    }

    /// Writes it, and for each job the config that it is trained from, unless the folder has this plan already. A
    /// folder whose jobs are the first of this plan's ([`Self::following`]) gets those that follow: so an arm or a seed is
    /// added to a sweep. Jobs that failed and that the sweep's file says otherwise now are begun anew, and what they left is
    /// put into `replaced/`. The plan comes after all configs: a folder with one has them. Returns the jobs that are begun
    /// anew.
    ///
    /// # Errors
    /// As [`Plan::fits`]; when the folder cannot be written.
    pub fn settle(
        &self,
        folder: &Path,
        config: impl Fn(&Job) -> Result<String, SweepError>,
    ) -> Result<Vec<&Job>, SweepError> {
        let Fit { there, replaced, reevaluated, added } = self.fits(folder, config)?;
        if replaced.is_empty() && there.as_ref() == Some(self) {
            return Ok(Vec::new());
        }
        for (job, text) in &replaced {
            put_aside(folder, job)?;
            write(&self.config(folder, job), text)?;
        }
        for (job, text) in added {
            write(&self.config(folder, job), &text)?;
        }
        let text = serde_json::to_string_pretty(self).map_err(|e| SweepError::Invalid(e.to_string()))?;
        write(&file_of(folder), &(text + "\n"))?;
        // Not before: until the plan says otherwise they have failed, and are begun anew by the next call.
        replaced.iter().try_for_each(|(job, _)| again(folder, job))?;
        reevaluated.into_iter().try_for_each(|job| again(folder, job))?;
        Ok(replaced.into_iter().map(|(job, _)| job).collect())
    }

    /// What it changes in a folder. Writes nothing.
    ///
    /// # Errors
    /// When the folder has another sweep, or jobs that have not failed and of which the same config would be another now: a
    /// job that is added would differ from them in more than it says. When a job has no sound config.
    pub fn fits(
        &self,
        folder: &Path,
        config: impl Fn(&Job) -> Result<String, SweepError>,
    ) -> Result<Fit<'_>, SweepError> {
        let there = Self::read(folder)?;
        let failed = there.as_ref().map_or_else(BTreeSet::new, |there| there.failed(folder));
        if let Some(difference) = there.as_ref().and_then(|there| there.difference(self, &failed)) {
            return Err(SweepError::Another { folder: folder.into(), difference });
        }
        let before = there.as_ref().map_or(&[][..], |there| &there.jobs);
        let (old, added) = self.jobs.split_at(before.len());
        let mut replaced = Vec::new();
        for (before, job) in before.iter().zip(old) {
            if !before.is(job) {
                replaced.push((job, config(job)?));
                continue;
            }
            // Read as a base, so that what it does not say is what it is run with: this version's default.
            let written =
                Job { base: self.config(folder, job).to_string_lossy().into_owned(), sets: Vec::new(), ..job.clone() };
            let now = config(job)?;
            let differs = config(&written).and_then(|written| changed(&written, &now));
            match differs {
                Ok(None) => {}
                // What its base says may have been the fault.
                _ if failed.contains(&job.number) => replaced.push((job, now)),
                Ok(Some((before, after))) => {
                    return Err(SweepError::Changed { folder: folder.into(), job: job.shown(), before, after });
                }
                Err(e) => return Err(e),
            }
        }
        let added = added.iter().map(|job| Ok((job, config(job)?))).collect::<Result<_, SweepError>>()?;
        let reevaluated = there.as_ref().map_or_else(Vec::new, |there| self.reevaluated(there, folder));
        Ok(Fit { there, replaced, reevaluated, added })
    }

    /// The jobs that failed in evaluations of before, where these were others: that is no word on those that are asked for now.
    fn reevaluated(&self, there: &Self, folder: &Path) -> Vec<&Job> {
        if there.sweep.evaluate_with == self.sweep.evaluate_with {
            return Vec::new();
        }
        let stuck: BTreeSet<usize> = there.stuck(folder, true).iter().map(|job| job.number).collect();
        self.jobs.iter().filter(|job| stuck.contains(&job.number)).collect()
    }

    /// The numbers of the jobs whose training has failed for good: there is nothing to lose by other settings.
    fn failed(&self, folder: &Path) -> BTreeSet<usize> {
        self.stuck(folder, false).iter().map(|job| job.number).collect()
    }

    /// The jobs that have failed for good: in training, or in the evaluation of what is `trained`.
    fn stuck(&self, folder: &Path, trained: bool) -> Vec<&Job> {
        let known = attempts(folder);
        let is_trained = |job: &Job| info(&folder.join(&job.folder))["outcome"] == "finished";
        let failed = |job: &Job| matches!(State::of(folder, self, job, &known), State::Failed(_));
        self.jobs.iter().filter(|job| failed(job) && is_trained(job) == trained).collect()
    }

    /// What differs first between this plan and a new one, which may have more jobs after the same ones, and other settings
    /// of those that have `failed`.
    fn difference(&self, new: &Self, failed: &BTreeSet<usize>) -> Option<String> {
        if self.jobs.len() > new.jobs.len() {
            return Some(format!("it has {} jobs, this one {}", self.jobs.len(), new.jobs.len()));
        }
        let corrected = |a: &Job, b: &Job| failed.contains(&a.number) && a.folder == b.folder && a.seed == b.seed;
        let changed = |(a, b): &(&Job, &Job)| !a.is(b) && !corrected(a, b);
        if let Some((a, b)) = self.jobs.iter().zip(&new.jobs).find(changed) {
            let shown = |j: &Job| format!("`{}` seed {} ({} {})", j.point, j.seed, j.base, j.sets.join(" "));
            return Some(format!("its job {} is {}, here {}", a.number, shown(a), shown(b)));
        }
        // What is asked and shown may change; what is run may not. That evaluations are wanted after all only adds to it:
        // what has finished counts as trained again, and they are made.
        let dropped = self.sweep.evaluate && !new.sweep.evaluate;
        dropped.then(|| "it has `evaluate = true`, this one has not".into())
    }
}

/// What a plan changes in a folder.
#[derive(Debug)]
pub struct Fit<'a> {
    /// The plan that is there.
    pub there: Option<Plan>,
    /// Jobs that failed and are said otherwise now, and their configs.
    pub replaced: Vec<(&'a Job, String)>,
    /// Jobs whose evaluation failed, and is another now.
    pub reevaluated: Vec<&'a Job>,
    /// Jobs that are added, and their configs.
    pub added: Vec<(&'a Job, String)>,
}

/// Where runs go whose jobs are begun anew, below the sweep's folder.
pub const REPLACED: &str = "replaced";

/// Moves what a job left out of the way; nothing where it left nothing.
fn put_aside(folder: &Path, job: &Job) -> Result<(), SweepError> {
    let run = folder.join(&job.folder);
    if !run.exists() {
        return Ok(());
    }
    let own = folder.join(job.folder.replacen("jobs", REPLACED, 1));
    let named = |again: usize| if again == 1 { own.clone() } else { own.with_extension(format!("{again}")) };
    let free = (1..).map(named).find(|path| !path.exists()).unwrap_or_else(|| own.clone());
    let moved = riglab_files::make_folder_of(&free).and_then(|()| std::fs::rename(&run, &free));
    moved.map_err(|e| SweepError::io(&free, "written", &e))
}

/// What differs first between two configs: what one has, and the other.
fn changed(before: &str, after: &str) -> Result<Option<(String, String)>, SweepError> {
    let read = |text| Config::from_toml_str("config", text).map_err(|e| SweepError::Invalid(e.to_string()));
    let differences = read(before)?.diff(&read(after)?);
    let Some(first) = differences.first() else { return Ok(None) };
    let had = first.before.as_ref().map_or_else(|| format!("no {}", first.path), |v| format!("{} = {v}", first.path));
    let more = if differences.len() > 1 { format!(" ({} keys differ)", differences.len()) } else { String::new() };
    Ok(Some((had, first.after.clone().unwrap_or_else(|| "none".into()) + &more)))
}

pub(crate) fn file_of(folder: &Path) -> PathBuf {
    folder.join("sweep.json")
}

pub(crate) fn write(path: &Path, text: &str) -> Result<(), SweepError> {
    let written = riglab_files::make_folder_of(path).and_then(|()| riglab_files::write(path, text.as_bytes()));
    written.map_err(|e| SweepError::io(path, "written", &e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Attempt;
    use crate::plan::tests::file;

    #[test]
    fn a_folder_keeps_its_plan() {
        let dir = tempfile::tempdir().unwrap();
        let of = |seeds: &str| Plan::new(file(&format!("[sweep]\nbase = 'b.toml'\nseeds = {seeds}")), &[]).unwrap();
        let config = |job: &Job| Ok(format!("seed = {}\n", job.seed));
        of("[1, 2]").settle(dir.path(), config).unwrap();
        of("[1, 2]").settle(dir.path(), config).unwrap();
        let plan = Plan::read(dir.path()).unwrap().unwrap();
        assert_eq!(plan, of("[1, 2]"));
        assert_eq!(std::fs::read_to_string(plan.config(dir.path(), &plan.jobs[1])).unwrap(), "seed = 2\n");
        // What is shown may change, and is remembered.
        let mut shown = of("[1, 2]");
        shown.sweep.question = "Why?".into();
        shown.settle(dir.path(), config).unwrap();
        assert_eq!(Plan::read(dir.path()).unwrap().unwrap(), shown);
        // One seed more comes after.
        of("[1, 2, 3]").fits(dir.path(), config).unwrap();
        assert_eq!(Plan::read(dir.path()).unwrap().unwrap(), shown, "nothing is written by looking");
        of("[1, 2, 3]").settle(dir.path(), config).unwrap();
        let plan = Plan::read(dir.path()).unwrap().unwrap();
        assert_eq!(plan, of("[1, 2, 3]"));
        assert_eq!(std::fs::read_to_string(plan.config(dir.path(), &plan.jobs[2])).unwrap(), "seed = 3\n");
        let fewer = of("[1, 2]").settle(dir.path(), config).unwrap_err().to_string();
        assert!(fewer.contains("it has 3 jobs, this one 2"), "{fewer}");
        let other = of("[1, 3, 4]").settle(dir.path(), config).unwrap_err().to_string();
        assert!(other.contains("its job 1 is `base` seed 2") && other.contains("hint"), "{other}");
        std::fs::write(file_of(dir.path()), "{").unwrap();
        assert!(Plan::read(dir.path()).unwrap_err().to_string().contains("cannot be understood"));
    }

    #[test]
    fn evaluations_may_be_asked_for_later() {
        let dir = tempfile::tempdir().unwrap();
        let of = |more: &str| Plan::new(file(&format!("[sweep]\nbase = 'b'\nseeds = [1]\n{more}")), &[]).unwrap();
        let config = |_: &Job| Ok(String::new());
        of("").settle(dir.path(), config).unwrap();
        let run = dir.path().join(&of("").jobs[0].folder);
        std::fs::create_dir_all(&run).unwrap();
        std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        // As a table without its column advises.
        of("evaluate = true").settle(dir.path(), config).unwrap();
        let plan = Plan::read(dir.path()).unwrap().unwrap();
        let state = State::of(dir.path(), &plan, &plan.jobs[0], &[]);
        assert_eq!((plan.sweep.evaluate, state), (true, State::Trained), "what is trained is evaluated now");
        let said = of("").settle(dir.path(), config).unwrap_err().to_string();
        assert!(said.contains("it has `evaluate = true`, this one has not"), "{said}");
        // What failed is made again once it is said otherwise, and not before.
        for _ in 0..2 {
            let failed = crate::Attempt { job: 0, stage: "eval".into(), reason: "x".into(), given_up: false };
            crate::record(dir.path(), &failed).unwrap();
        }
        let left = |plan: &Plan| {
            plan.settle(dir.path(), config).unwrap();
            plan.left(dir.path(), |_| false).len()
        };
        let [same, other] =
            ["", "evaluate_with = { 'data.test' = ['a'] }"].map(|more| of(&format!("evaluate = true\n{more}")));
        let looked_at = |plan: &Plan| plan.fits(dir.path(), config).unwrap().reevaluated.len();
        assert_eq!([&same, &other].map(looked_at), [0, 1]);
        assert_eq!((left(&same), left(&other), left(&other)), (0, 1, 1));
        assert_eq!(looked_at(&other), 0);
    }

    #[test]
    fn seeds_and_arms_are_added_after_what_is_there() {
        let of = |seeds: &str, arms: &[&str]| {
            let arms: String = arms.iter().map(|name| format!("[[sweep.arms]]\nname = '{name}'\n")).collect();
            Plan::new(file(&format!("[sweep]\nbase = 'b.toml'\nseeds = {seeds}\n{arms}")), &[]).unwrap()
        };
        let there = of("[0, 1]", &["a", "b"]);
        let more = of("[0, 1, 2]", &["new", "a", "b"]).following(&there);
        let jobs: Vec<(usize, &str, u64)> = more.jobs.iter().map(|j| (j.number, j.point.as_str(), j.seed)).collect();
        assert_eq!(jobs[..5], [(0, "a", 0), (1, "a", 1), (2, "b", 0), (3, "b", 1), (4, "new", 0)]);
        assert_eq!(jobs[5..], [(5, "new", 1), (6, "new", 2), (7, "a", 2), (8, "b", 2)]);
        assert_eq!((&more.jobs[..4], more.names()), (&there.jobs[..], vec!["a", "b", "new"]));
        // Names that come to the same folder: what is there keeps its own.
        let (one, two) = (of("[0]", &["=1"]), of("[0, 1]", &["~1", "=1", "1"]));
        let jobs = two.following(&one).jobs;
        let folders: Vec<(&str, &str)> = jobs.iter().map(|j| (j.point.as_str(), j.folder.as_str())).collect();
        assert_eq!(folders[..2], [("=1", "jobs/1/seed-0"), ("~1", "jobs/1-2/seed-0")]);
        assert_eq!(folders[3..], [("=1", "jobs/1/seed-1"), ("1", "jobs/1-3/seed-0"), ("1", "jobs/1-3/seed-1")]);
        // Of another sweep, nothing moves.
        let other = of("[0, 2]", &["a", "b"]);
        assert_eq!(other.clone().following(&there), other);
    }

    #[test]
    fn an_arm_that_failed_may_be_corrected() {
        let dir = tempfile::tempdir().unwrap();
        let of = |rate: &str, more: &str| {
            let text = format!(
                "[sweep]\nbase = 'b'\nseeds = [1, 2]\n[[sweep.arms]]\nname = 'good'\n[[sweep.arms]]\nname = 'bad'\n\
                 set = {{ rate = {rate} }}\n{more}"
            );
            let plan = Plan::new(file(&text), &[]).unwrap();
            match Plan::read(dir.path()).unwrap() {
                Some(there) => plan.following(&there),
                None => plan,
            }
        };
        let config = |job: &Job| match job.base.ends_with(".toml") {
            true => Ok(std::fs::read_to_string(&job.base).unwrap()),
            false => Ok(job.sets.join("\n")),
        };
        of("9.0", "").settle(dir.path(), config).unwrap();
        let there = of("9.0", "");
        let run = |k: usize| dir.path().join(&there.jobs[k].folder);
        for k in [0, 2] {
            std::fs::create_dir_all(run(k)).unwrap();
            std::fs::write(run(k).join("config.toml"), "first").unwrap();
        }
        let fail = |k: usize| {
            let attempt = Attempt { job: k, stage: "train".into(), reason: "no number".into(), given_up: true };
            crate::record(dir.path(), &attempt).unwrap();
        };
        fail(2);
        // Its second seed has not failed, and might be trained with either.
        let said = of("1.0", "").settle(dir.path(), config).unwrap_err().to_string();
        assert!(said.contains("its job 3 is `bad` seed 2") && said.contains("failed"), "{said}");
        assert_eq!((Plan::read(dir.path()).unwrap().unwrap(), run(2).exists()), (there.clone(), true));
        fail(3);
        let anew = of("1.0", "[[sweep.arms]]\nname = 'new'");
        let shown: Vec<String> = anew.settle(dir.path(), config).unwrap().iter().map(|job| job.shown()).collect();
        assert_eq!(shown, ["`bad`, seed 1", "`bad`, seed 2"]);
        let read = Plan::read(dir.path()).unwrap().unwrap();
        assert_eq!((read.clone(), read.jobs.len()), (anew.clone(), 6));
        let state = |k: usize| State::of(dir.path(), &read, &read.jobs[k], &attempts(dir.path()));
        assert_eq!([state(0), state(2), state(3)], [State::Interrupted(0), State::Waiting, State::Waiting]);
        assert_eq!(std::fs::read_to_string(read.config(dir.path(), &read.jobs[2])).unwrap(), "rate=1.0\ntrain.seed=1");
        // What it left is there, that of a second correction too.
        let aside =
            |name: &str| std::fs::read_to_string(dir.path().join("replaced/bad").join(name).join("config.toml"));
        assert_eq!(aside("seed-1").unwrap(), "first");
        assert!(anew.settle(dir.path(), config).unwrap().is_empty(), "nothing more to do");
        // Killed before the plan was written, it has still failed, and is begun anew by the next call.
        there.settle(&dir.path().join("old"), config).unwrap();
        fail(2);
        std::fs::copy(dir.path().join("old/sweep.json"), file_of(dir.path())).unwrap();
        fail(3);
        assert_eq!(anew.settle(dir.path(), config).unwrap().len(), 2);
        // What is trained is not trained again because its evaluation failed.
        std::fs::create_dir_all(run(3)).unwrap();
        std::fs::write(run(3).join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        [2, 3].into_iter().for_each(fail);
        let said = of("0.5", "[[sweep.arms]]\nname = 'new'").settle(dir.path(), config).unwrap_err().to_string();
        assert!(said.contains("its job 3 is `bad` seed 2"), "{said}");
        std::fs::remove_file(run(3).join("run.json")).unwrap();
        std::fs::create_dir_all(run(2)).unwrap();
        std::fs::write(run(2).join("config.toml"), "second").unwrap();
        [2, 3].into_iter().for_each(fail);
        of("0.1", "[[sweep.arms]]\nname = 'new'").settle(dir.path(), config).unwrap();
        assert_eq!([aside("seed-1").unwrap(), aside("seed-1.2").unwrap()], ["first", "second"]);
    }

    #[test]
    fn arms_join_no_jobs_of_other_settings() {
        let dir = tempfile::tempdir().unwrap();
        let base = dir.path().join("b.toml");
        let of = |seeds: &str| {
            let text = format!("[sweep]\nbase = {:?}\nseeds = {seeds}", base.display());
            Plan::new(file(&text), &[]).unwrap()
        };
        // Settings as riglab has them: a key that is not set has its default.
        let config = |job: &Job| {
            let own = Config::load(&job.base, &job.sets, &[]).unwrap();
            let bce: f64 = if own.contains("loss.bce") { own.get_at("loss.bce").unwrap() } else { 1.0 };
            let seed: u64 = own.get_at("train.seed").unwrap();
            let kl = if own.contains("loss.kl") { "kl = 0.5\n" } else { "" };
            Ok(format!("[loss]\nbce = {bce:?}\n{kl}[train]\nseed = {seed}\n"))
        };
        std::fs::write(&base, "").unwrap();
        of("[1]").settle(dir.path(), config).unwrap();
        let there = |plan: &Plan| plan.config(dir.path(), &plan.jobs[0]);
        // Written by a version that had no such key, and by hand: the same settings.
        std::fs::write(there(&of("[1]")), "[train]\nseed = 1 # here\n").unwrap();
        of("[1, 2]").settle(dir.path(), config).unwrap();
        std::fs::write(&base, "[loss]\nbce = 3.0\n").unwrap();
        for seeds in ["[1, 2, 3]", "[1, 2]"] {
            let said = of(seeds).settle(dir.path(), config).unwrap_err().to_string();
            let wanted =
                "holds jobs of other settings: `base`, seed 1 has loss.bce = 1.0, where it would now have 3.0; put";
            assert!(said.contains(wanted) && said.contains("-o"), "{said}");
        }
        std::fs::write(&base, "[loss]\nkl = 0.5\nbce = 2.0\n").unwrap();
        let said = of("[1, 2, 3]").settle(dir.path(), config).unwrap_err().to_string();
        assert!(said.contains("loss.bce = 1.0, where it would now have 2.0 (2 keys differ);"), "{said}");
        std::fs::write(&base, "[loss]\nkl = 0.5\n").unwrap();
        let said = of("[1, 2, 3]").settle(dir.path(), config).unwrap_err().to_string();
        assert!(said.contains("seed 1 has no loss.kl, where it would now have 0.5;"), "{said}");
        assert_eq!(Plan::read(dir.path()).unwrap().unwrap(), of("[1, 2]"), "no arm was added");
        std::fs::write(&base, "[loss]\nbce = 1.0\n").unwrap();
        of("[1, 2, 3]").settle(dir.path(), config).unwrap();
        // One that failed by what its base says is begun anew, once no job is left that is of it.
        let fail = |job: usize| {
            let attempt = Attempt { job, stage: "train".into(), reason: "no number".into(), given_up: true };
            crate::record(dir.path(), &attempt).unwrap();
        };
        std::fs::write(&base, "[loss]\nbce = 2.0\n").unwrap();
        [0, 1].into_iter().for_each(fail);
        let said = of("[1, 2, 3]").settle(dir.path(), config).unwrap_err().to_string();
        assert!(said.contains("`base`, seed 3 has loss.bce = 1.0, where it would now have 2.0"), "{said}");
        fail(2);
        let plan = of("[1, 2, 3]");
        assert_eq!(plan.settle(dir.path(), config).unwrap().len(), 3);
        assert!(std::fs::read_to_string(there(&plan)).unwrap().contains("bce = 2.0"));
        let state = State::of(dir.path(), &plan, &plan.jobs[0], &attempts(dir.path()));
        assert_eq!((state, plan.settle(dir.path(), config).unwrap().len()), (State::Waiting, 0));
    }
}
