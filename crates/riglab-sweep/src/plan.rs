//! All jobs of a sweep, listed before the first begins.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use riglab_config::Config;
use serde::{Deserialize, Serialize};
use toml::Value;

use crate::values::fault;
use crate::{SweepError, SweepFile};

/// Digits after the point in tables at most: a number has no more.
const DIGITS: usize = 17;

/// One run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Its number, from 0.
    pub number: usize,
    /// The point of the sweep, the same for all its seeds.
    pub point: String,
    /// Its seed.
    pub seed: u64,
    /// The config it starts from.
    pub base: String,
    /// Changes, as `--set` takes them.
    pub sets: Vec<String>,
    /// Its run folder, below the sweep's.
    pub folder: String,
}

/// A sweep's file with its jobs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What was asked.
    pub sweep: SweepFile,
    /// The jobs, seeds of a point one after another, but for those that were added later: they come last.
    pub jobs: Vec<Job>,
}

impl Plan {
    /// Lists the jobs: arms, times combinations of `product`, times rows of `zip`, times seeds. `sets` come last, for
    /// all of them.
    ///
    /// # Errors
    /// When a list is empty or of another length, two points have the same name, or a column or figure can have no number.
    pub fn new(sweep: SweepFile, sets: &[String]) -> Result<Self, SweepError> {
        let invalid = |message: String| Err(SweepError::Invalid(message));
        if sweep.seeds.is_empty() {
            return invalid("`sweep.seeds` is empty; give at least one, three for a spread".into());
        }
        if let Some(metric) = sweep.metrics.iter().find(|m| m.digits > DIGITS) {
            return invalid(format!(
                "`sweep.metrics`, {}: digits = {}; give at most {DIGITS}",
                metric.of, metric.digits
            ));
        }
        let different: BTreeSet<u64> = sweep.seeds.iter().copied().collect();
        if different.len() != sweep.seeds.len() {
            return invalid("`sweep.seeds` has a seed twice".into());
        }
        for (table, grid) in [("product", &sweep.product), ("zip", &sweep.zip)] {
            if let Some((key, _)) = grid.iter().find(|(_, values)| values.is_empty()) {
                return invalid(format!("`sweep.{table}.\"{key}\"` has no values"));
            }
        }
        let mut lengths = sweep.zip.iter().map(|(key, values)| (key, values.len()));
        if let Some((first, length)) = lengths.next()
            && let Some((key, other)) = lengths.find(|(_, l)| *l != length)
        {
            return invalid(format!(
                "`sweep.zip`: `{first}` has {length} values and `{key}` {other}; they change together: give as many"
            ));
        }
        for figure in &sweep.figures {
            if figure.at.is_empty() || !figure.of.contains("{}") {
                return invalid(format!(
                    "`sweep.figures`: {:?} needs places in `at`, and `{{}}` in `of` where the place belongs",
                    figure.title
                ));
            }
        }
        let columns = sweep.metrics.iter().map(|m| ("metrics", &m.of, m.of.clone()));
        let figures = sweep.figures.iter().filter_map(|f| Some(("figures", &f.of, f.places().next()?)));
        for (table, of, place) in columns.chain(figures) {
            if let Some(fault) = fault(&place) {
                return invalid(format!("`sweep.{table}`, of = {of:?}: {fault}"));
            }
        }
        let mut plan = Self { jobs: Vec::new(), sweep };
        let points = plan.points();
        let mut names = BTreeSet::new();
        if let Some(point) = points.iter().find(|p| !names.insert(&p.name)) {
            return invalid(format!(
                "two points of the sweep are called `{}`; give arms names of their own, and `product` and `zip` no value \
                 twice",
                point.name
            ));
        }
        let mut folders = BTreeSet::new();
        for point in points {
            let own = slug(&point.name);
            // Names may differ in signs that folders do not have.
            let named = |again: usize| if again == 1 { own.clone() } else { format!("{own}-{again}") };
            let folder = (1..).map(named).find(|f| !folders.contains(f)).unwrap_or_default();
            folders.insert(folder.clone());
            for &seed in &plan.sweep.seeds {
                let seeded = format!("{}={seed}", plan.sweep.seed_key);
                plan.jobs.push(Job {
                    number: plan.jobs.len(),
                    point: point.name.clone(),
                    seed,
                    base: point.base.clone(),
                    sets: point.sets.iter().chain(sets).cloned().chain([seeded]).collect(),
                    folder: format!("jobs/{folder}/seed-{seed}"),
                });
            }
        }
        Ok(plan)
    }

    /// The points in order, without seeds.
    fn points(&self) -> Vec<Point> {
        let all = |set: &std::collections::BTreeMap<String, Value>| {
            set.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<String>>()
        };
        let common = all(&self.sweep.set);
        let mut points: Vec<Point> = Vec::new();
        let nothing = [crate::Arm { name: String::new(), base: None, set: Default::default() }];
        let arms = if self.sweep.arms.is_empty() { &nothing[..] } else { &self.sweep.arms };
        for arm in arms {
            points.push(Point {
                name: arm.name.clone(),
                base: arm.base.clone().unwrap_or_else(|| self.sweep.base.clone()),
                sets: [common.clone(), all(&arm.set)].concat(),
            });
        }
        for (key, values) in &self.sweep.product {
            points = points.iter().flat_map(|p| values.iter().map(|v| p.with(&[(key, v)]))).collect();
        }
        if let Some(rows) = self.sweep.zip.values().next().map(Vec::len) {
            let row = |k: usize| self.sweep.zip.iter().map(|(key, values)| (key, &values[k])).collect::<Vec<_>>();
            points = points.iter().flat_map(|p| (0..rows).map(|k| p.with(&row(k)))).collect();
        }
        for point in &mut points {
            if point.name.is_empty() {
                point.name = "base".into();
            }
        }
        points
    }

    /// Names of the points, each once, in order.
    pub fn names(&self) -> Vec<&str> {
        let mut seen = BTreeSet::new();
        self.jobs.iter().map(|j| j.point.as_str()).filter(|name| seen.insert(*name)).collect()
    }

    /// The same jobs after those of a folder's plan, where they have all of these: so a seed or an arm is added to a sweep
    /// while what is done keeps its number. Another sweep's plan leaves them as they are.
    #[must_use]
    pub fn following(mut self, there: &Self) -> Self {
        let same = |a: &Job, b: &Job| Job { number: 0, ..a.clone() } == Job { number: 0, ..b.clone() };
        let place = |job: &Job| there.jobs.iter().position(|old| same(old, job));
        if there.jobs.iter().all(|old| self.jobs.iter().any(|job| same(old, job))) {
            // Those that are added stay in their order.
            self.jobs.sort_by_key(|job| place(job).unwrap_or(usize::MAX));
            (0..).zip(&mut self.jobs).for_each(|(number, job)| job.number = number);
        }
        self
    }

    /// Points that are the same runs: their names, of which the second has the settings of the first. `config`: of a job.
    ///
    /// # Errors
    /// When a job has no sound config.
    pub fn alike(
        &self,
        config: impl Fn(&Job) -> Result<String, SweepError>,
    ) -> Result<Vec<(String, String)>, SweepError> {
        let mut seen: BTreeMap<String, &str> = BTreeMap::new();
        let mut out = Vec::new();
        for job in self.jobs.iter().filter(|job| job.seed == self.sweep.seeds[0]) {
            match seen.entry(config(job)?) {
                Entry::Occupied(first) => out.push(((*first.get()).to_owned(), job.point.clone())),
                Entry::Vacant(place) => drop(place.insert(&job.point)),
            }
        }
        Ok(out)
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
    /// added to a sweep. The plan comes last: a folder with one has all configs.
    ///
    /// # Errors
    /// As [`Plan::fits`]; when the folder cannot be written.
    pub fn settle(&self, folder: &Path, config: impl Fn(&Job) -> Result<String, SweepError>) -> Result<(), SweepError> {
        let (there, configs) = self.fits(folder, config)?;
        if there.as_ref() == Some(self) {
            return Ok(());
        }
        let added = &self.jobs[there.map_or(0, |t| t.jobs.len())..];
        for (job, text) in added.iter().zip(configs) {
            write(&self.config(folder, job), &text)?;
        }
        let text = serde_json::to_string_pretty(self).map_err(|e| SweepError::Invalid(e.to_string()))?;
        write(&file_of(folder), &(text + "\n"))
    }

    /// The plan that a folder has, and the configs of the jobs that it has not. Writes nothing.
    ///
    /// # Errors
    /// When the folder has another sweep, or jobs of which the same config would be another now: a job that is added
    /// would differ from them in more than it says. When a job has no sound config.
    pub fn fits(
        &self,
        folder: &Path,
        config: impl Fn(&Job) -> Result<String, SweepError>,
    ) -> Result<(Option<Self>, Vec<String>), SweepError> {
        let there = Self::read(folder)?;
        if let Some(difference) = there.as_ref().and_then(|there| there.difference(self)) {
            return Err(SweepError::Another { folder: folder.into(), difference });
        }
        let (old, added) = self.jobs.split_at(there.as_ref().map_or(0, |there| there.jobs.len()));
        for job in old {
            // Read as a base, so that what it does not say is what it is run with: this version's default.
            let written =
                Job { base: self.config(folder, job).to_string_lossy().into_owned(), sets: Vec::new(), ..job.clone() };
            if let Some((before, after)) = changed(&config(&written)?, &config(job)?)? {
                return Err(SweepError::Changed { folder: folder.into(), job: job.shown(), before, after });
            }
        }
        let configs = added.iter().map(config).collect::<Result<_, _>>()?;
        Ok((there, configs))
    }

    /// What differs first between this plan and a new one, which may have more jobs after the same ones.
    fn difference(&self, new: &Self) -> Option<String> {
        if self.jobs.len() > new.jobs.len() {
            return Some(format!("it has {} jobs, this one {}", self.jobs.len(), new.jobs.len()));
        }
        let changed = |(a, b): &(&Job, &Job)| a != b;
        if let Some((a, b)) = self.jobs.iter().zip(&new.jobs).find(changed) {
            let shown = |j: &Job| format!("`{}` seed {} ({} {})", j.point, j.seed, j.base, j.sets.join(" "));
            return Some(format!("its job {} is {}, here {}", a.number, shown(a), shown(b)));
        }
        // What is asked and shown may change; what is run may not. That evaluations are wanted after all only adds to it:
        // what has finished counts as trained again, and they are made.
        let dropped = self.sweep.evaluate && !new.sweep.evaluate;
        dropped.then(|| "it has `evaluate = true`, this one has not".into())
    }

    /// The file a job is trained from.
    pub fn config(&self, folder: &Path, job: &Job) -> PathBuf {
        folder.join(format!("{}.toml", job.folder.replacen("jobs/", "configs/", 1)))
    }
}

impl Job {
    /// As messages name it.
    pub(crate) fn shown(&self) -> String {
        format!("`{}`, seed {}", self.point, self.seed)
    }
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

struct Point {
    name: String,
    base: String,
    sets: Vec<String>,
}

impl Point {
    /// The same with values added, named by the last step of each key.
    fn with(&self, values: &[(&String, &Value)]) -> Self {
        let (mut name, mut sets) = (self.name.clone(), self.sets.clone());
        for (key, value) in values {
            let own = key.rsplit('.').next().unwrap_or(key);
            let gap = if name.is_empty() { "" } else { ", " };
            name += &format!("{gap}{own}={}", shown(value));
            sets.push(format!("{key}={value}"));
        }
        Self { name, base: self.base.clone(), sets }
    }
}

fn shown(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A folder's name.
fn slug(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '.' { c.to_ascii_lowercase() } else { '-' };
    let mut out: String = name.chars().map(plain).take(80).collect();
    while out.contains("--") {
        out = out.replace("--", "-");
    }
    let out = out.trim_matches(['-', '.']);
    if out.is_empty() { "point".into() } else { out.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::State;

    pub(crate) fn file(text: &str) -> SweepFile {
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        config.get_at("sweep").unwrap_or_else(|e| panic!("{e}"))
    }

    #[test]
    fn arms_products_zips_and_seeds_multiply() {
        let text = "[sweep]\nbase = 'b.toml'\nseeds = [3, 4]\nset = { 'train.steps' = 9 }\n\
            [[sweep.arms]]\nname = 'full'\n[[sweep.arms]]\nname = 'no Dice'\nset = { 'loss.dice' = 0.0 }\n\
            [sweep.product]\n'model.width' = [64, 128]\n[sweep.zip]\n'a.x' = [1, 2, 3]\n'a.mode' = ['p', 'q', 'r']\n";
        let plan = Plan::new(file(text), &["data.corpora=['c.h5']".into()]).unwrap();
        assert_eq!((plan.jobs.len(), plan.names().len()), (2 * 2 * 3 * 2, 12));
        let job = &plan.jobs[23];
        assert_eq!(job.point, "no Dice, width=128, mode=r, x=3");
        assert_eq!(job.folder, "jobs/no-dice-width-128-mode-r-x-3/seed-4");
        let sets = [
            "train.steps=9",
            "loss.dice=0.0",
            "model.width=128",
            "a.mode=\"r\"",
            "a.x=3",
            "data.corpora=['c.h5']",
            "train.seed=4",
        ];
        assert_eq!(job.sets, sets);
    }

    #[test]
    fn faults_are_sentences() {
        let fault = |more: &str| {
            let text = format!("[sweep]\nbase = 'b.toml'\n{more}");
            Plan::new(file(&text), &[]).unwrap_err().to_string()
        };
        assert!(fault("seeds = []").contains("is empty"));
        assert!(fault("seeds = [1, 1]").contains("twice"));
        assert!(fault("seeds = [1]\n[sweep.product]\nx = []").contains("no values"));
        assert!(fault("seeds = [1]\n[sweep.zip]\nx = [1]\ny = [1, 2]").contains("`x` has 1 values and `y` 2"));
        let figure = "seeds = [1]\n[[sweep.figures]]\ntitle = 'IoU'\nx = 'codes'\n";
        assert!(fault(&format!("{figure}at = []\nof = 'eval/iou{{}}'")).contains("\"IoU\" needs places in `at`"));
        assert!(fault(&format!("{figure}at = [4]\nof = 'eval/iou'")).contains("`{}` in `of`"));
        let twice = fault("seeds = [1]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'a'");
        assert!(twice.starts_with("two points of the sweep are called `a`; give arms names"), "{twice}");
        let twice = fault("seeds = [1]\n[sweep.product]\nx = [1, 1]");
        assert!(twice.starts_with("two points of the sweep are called `x=1`; give"), "{twice}");
        let of = fault("seeds = [1]\n[[sweep.metrics]]\nof = 'eval.jsn:report.iou'");
        assert!(of.starts_with("`sweep.metrics`, of = \"eval.jsn:report.iou\": numbers of a file `eval.jsn`"), "{of}");
        let of = fault(&format!("{figure}at = [4]\nof = 'eval.json:rows[k={{}}.iou'"));
        let wanted = "`sweep.figures`, of = \"eval.json:rows[k={}.iou\": the bracket of `[k=4.iou` is not closed";
        assert!(of.starts_with(wanted), "{of}");
    }

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
        // Of another sweep, nothing moves.
        let other = of("[0, 2]", &["a", "b"]);
        assert_eq!(other.clone().following(&there), other);
    }

    #[test]
    fn points_of_the_same_settings_are_found() {
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2]\n[[sweep.arms]]\nname = 'a'\n\
                    [[sweep.arms]]\nname = 'b'\nset = { x = 1 }\n[[sweep.arms]]\nname = 'c'\nset = { x = 2 }";
        let plan = Plan::new(file(text), &[]).unwrap();
        // 1 is the default.
        let config = |job: &Job| Ok(if job.sets[0] == "x=2" { "2" } else { "1" }.to_owned());
        assert_eq!(plan.alike(config).unwrap(), [("a".to_owned(), "b".to_owned())]);
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
    }

    #[test]
    fn folders_have_plain_names() {
        assert_eq!(slug("../A b/ c=[1, 2]"), "a-b-c-1-2");
        assert_eq!(slug("ü"), "point");
        // Two names that come to the same folder have two.
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\n[[sweep.arms]]\nname = 'a b'\n[[sweep.arms]]\nname = 'a-b'";
        let plan = Plan::new(file(text), &[]).unwrap();
        assert_eq!(plan.jobs[1].folder, "jobs/a-b-2/seed-1");
    }
}
