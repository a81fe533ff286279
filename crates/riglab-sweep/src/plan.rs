//! All jobs of a sweep, listed before the first begins.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::Value;

use crate::file::{alike, changes, in_order, unsaid};
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
    /// When a list is empty or of another length, two points have the same name, a key is set by two of the places that
    /// points and seeds differ in, a column or figure can have no number, or one of `sets` is of such a key.
    pub fn new(sweep: SweepFile, sets: &[String]) -> Result<Self, SweepError> {
        let invalid = |message: String| Err(SweepError::Invalid(message));
        let at = |key: String, message: String| Err(SweepError::Key { key, message });
        if sweep.seeds.is_empty() {
            return invalid("`sweep.seeds` is empty; give at least one, three for a spread".into());
        }
        if let Some(k) = sweep.metrics.iter().position(|m| m.digits > DIGITS) {
            return at(format!("metrics[{k}].digits"), format!("{}; give at most {DIGITS}", sweep.metrics[k].digits));
        }
        if let Some((key, number)) = sweep.unkept() {
            return at(key, format!("{number} is no number to compute with; give a finite one"));
        }
        if sweep.memory_gb < 0.0 {
            return at("memory_gb".into(), format!("{}; give gigabytes, or 0 where it is not known", sweep.memory_gb));
        }
        if !sweep.evaluate_with.is_empty() && !sweep.evaluate {
            let message = "it says how runs are evaluated, and none is: add `evaluate = true`".into();
            return at("evaluate_with".into(), message);
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
        if let Some((key, place, hides)) = sweep.hidden() {
            return invalid(format!(
                "`{place}` sets `{key}`, and `{hides}` sets it again for every run: leave it out of one"
            ));
        }
        let mut lengths = sweep.zip.iter().map(|(key, values)| (key, values.len()));
        if let Some((first, length)) = lengths.next()
            && let Some((key, other)) = lengths.find(|(_, l)| *l != length)
        {
            return invalid(format!(
                "`sweep.zip`: `{first}` has {length} values and `{key}` {other}; they change together: give as many"
            ));
        }
        for (k, figure) in sweep.figures.iter().enumerate() {
            for (key, lacks) in [("at", figure.at.is_empty()), ("of", !figure.of.contains("{}"))] {
                if lacks {
                    let needs = "needs places in `at`, and `{}` in `of` where the place belongs";
                    return at(format!("figures[{k}].{key}"), format!("{:?} {needs}", figure.title));
                }
            }
        }
        let columns = sweep.metrics.iter().map(|m| m.of.clone()).enumerate().map(|of| ("metrics", of));
        let places = sweep.figures.iter().map(|f| f.places().next().unwrap_or_default());
        for (table, (k, place)) in columns.chain(places.enumerate().map(|place| ("figures", place))) {
            if let Some(fault) = fault(&place) {
                return at(format!("{table}[{k}].of"), fault);
            }
        }
        if let Some((set, key)) = sweep.tested_otherwise(sets) {
            return invalid(format!(
                "--set {set}: `sweep.evaluate_with` sets `{key}` for every evaluation; change it there, in the sweep's file"
            ));
        }
        if let Some((set, key)) = sweep.overridden(sets) {
            return invalid(format!(
                "--set {set}: the sweep itself sets `{key}`, which differs between its runs; change it in the sweep's file"
            ));
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
            let folder = free_folder(&point.name, &folders);
            folders.insert(folder.clone());
            for &seed in &plan.sweep.seeds {
                let seeded = format!("{}={seed}", plan.sweep.seed_key);
                plan.jobs.push(Job {
                    number: plan.jobs.len(),
                    point: point.name.clone(),
                    seed,
                    base: point.base.clone(),
                    sets: point.sets.iter().chain(sets).cloned().chain([seeded]).collect(),
                    folder: run_folder(&folder, seed),
                });
            }
        }
        Ok(plan)
    }

    /// The points in order, without seeds.
    fn points(&self) -> Vec<Point> {
        let common = changes(&self.sweep.set);
        let mut points: Vec<Point> = Vec::new();
        let nothing = [crate::Arm { name: String::new(), base: None, set: Default::default() }];
        let arms = if self.sweep.arms.is_empty() { &nothing[..] } else { &self.sweep.arms };
        for arm in arms {
            points.push(Point {
                name: arm.name.clone(),
                base: arm.base.clone().unwrap_or_else(|| self.sweep.base.clone()),
                sets: [common.clone(), changes(&arm.set)].concat(),
            });
        }
        for (key, values) in in_order(&self.sweep.product) {
            points = points.iter().flat_map(|p| values.iter().map(|v| p.with(&[(key, v)]))).collect();
        }
        if let Some(rows) = self.sweep.zip.values().next().map(Vec::len) {
            let row = |k: usize| {
                in_order(&self.sweep.zip).into_iter().map(|(key, values)| (key, &values[k])).collect::<Vec<_>>()
            };
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

    /// Whether its first jobs are those of another plan.
    pub fn continues(&self, there: &Self) -> bool {
        there.jobs.len() <= self.jobs.len() && there.jobs.iter().zip(&self.jobs).all(|(old, job)| old.is(job))
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

    /// The file a job is trained from.
    pub fn config(&self, folder: &Path, job: &Job) -> PathBuf {
        folder.join(format!("{}.toml", job.folder.replacen("jobs/", "configs/", 1)))
    }
}

impl Job {
    /// As messages name it.
    pub fn shown(&self) -> String {
        format!("`{}`, seed {}", self.point, self.seed)
    }

    /// The folder of its point, within `jobs`.
    pub(crate) fn point_folder(&self) -> &str {
        self.folder.split('/').nth(1).unwrap_or_default()
    }

    /// Whether it is the same as another, which an earlier version may have listed: that did not say of which tables a
    /// change is chosen anew.
    pub fn is(&self, other: &Self) -> bool {
        let sets = self.sets.len() == other.sets.len() && self.sets.iter().zip(&other.sets).all(|(a, b)| alike(a, b));
        sets && *self == Self { sets: self.sets.clone(), ..other.clone() }
    }
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
            name += &format!("{gap}{own}={}", shown(&unsaid(value)));
            sets.push(format!("{key}={value}"));
        }
        Self { name, base: self.base.clone(), sets }
    }
}

fn shown(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A run's folder, below the sweep's, in that of its point.
pub(crate) fn run_folder(point: &str, seed: u64) -> String {
    format!("jobs/{point}/seed-{seed}")
}

/// A folder for a point beside those that are taken: names may differ in signs that folders do not have.
pub(crate) fn free_folder(point: &str, taken: &BTreeSet<String>) -> String {
    let own = slug(point);
    let named = |again: usize| if again == 1 { own.clone() } else { format!("{own}-{again}") };
    (1..).map(named).find(|folder| !taken.contains(folder)).unwrap_or_default()
}

/// A folder's name.
fn slug(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || c == '.' { c.to_ascii_lowercase() } else { '-' };
    // File systems count bytes.
    let mut out: String = name.chars().map(plain).take(80).collect();
    out.truncate((0..=200.min(out.len())).rev().find(|at| out.is_char_boundary(*at)).unwrap_or(0));
    while out.contains("--") {
        out = out.replace("--", "-");
    }
    let out = out.trim_matches(['-', '.']);
    if out.is_empty() { "point".into() } else { out.into() }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

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
        // A folder could not keep them.
        for (more, key) in [
            ("seeds = [1]\nmemory_gb = inf".to_owned(), "memory_gb"),
            (format!("{figure}at = [4, nan]\nof = 'eval/iou{{}}'"), "figures[0].at"),
            ("seeds = [1]\nset = { 'a.b' = [{ c = inf }] }".to_owned(), "set.\"a.b\""),
            ("seeds = [1]\n[[sweep.arms]]\nname = 'a'\nset = { a = { b = nan } }".to_owned(), "arms[0].set.\"a\""),
            ("seeds = [1]\n[sweep.product]\n'a.b' = [1.0, -inf]".to_owned(), "product.\"a.b\""),
            ("seeds = [1]\n[sweep.zip]\n'a.b' = [inf]".to_owned(), "zip.\"a.b\""),
        ] {
            let said = fault(&more);
            assert!(said.starts_with(&format!("`sweep.{key}`: ")) && said.ends_with("give a finite one"), "{said}");
        }
        assert!(fault("seeds = [1]\nmemory_gb = -2.0").starts_with("`sweep.memory_gb`: -2; give gigabytes"));
        assert!(fault(&format!("{figure}at = []\nof = 'eval/iou{{}}'")).contains("\"IoU\" needs places in `at`"));
        assert!(fault(&format!("{figure}at = [4]\nof = 'eval/iou'")).contains("`{}` in `of`"));
        let twice = fault("seeds = [1]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'a'");
        assert!(twice.starts_with("two points of the sweep are called `a`; give arms names"), "{twice}");
        let twice = fault("seeds = [1]\n[sweep.product]\nx = [1, 1]");
        assert!(twice.starts_with("two points of the sweep are called `x=1`; give"), "{twice}");
        let of = fault("seeds = [1]\n[[sweep.metrics]]\nof = 'eval.jsn:report.iou'");
        assert!(of.starts_with("`sweep.metrics[0].of`: numbers of a file `eval.jsn`"), "{of}");
        let of = fault(&format!("{figure}at = [4]\nof = 'eval.json:rows[k={{}}.iou'"));
        let wanted = "`sweep.figures[0].of`: the bracket of `[k=4.iou` is not closed";
        assert!(of.starts_with(wanted), "{of}");
    }

    #[test]
    fn what_points_differ_in_is_not_set_for_all_of_them() {
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\nset = { 'train.steps' = 9 }\n\
                    [[sweep.arms]]\nname = 'a'\nset = { 'loss.dice' = 0 }\n\
                    [sweep.product]\n'model.width' = [1, 2]\n[sweep.zip]\n'a.x' = [1, 2]\n";
        let of = |set: &str| Plan::new(file(text), &[set.into()]).map_err(|e| e.to_string());
        for (set, key) in [
            ("model.width=3", "model.width"),
            ("model={ width = 3 }", "model.width"),
            ("a.x=3", "a.x"),
            ("loss.dice=1", "loss.dice"),
            ("train.seed=7", "train.seed"),
        ] {
            let said = of(set).unwrap_err();
            assert!(said.starts_with(&format!("--set {set}: the sweep itself sets `{key}`")), "{said}");
        }
        for set in ["train.steps=3", "model.widths=3", "loss.bce=1", "train={ steps = 3 }", "a.y=word"] {
            assert!(of(set).is_ok(), "{set}");
        }
        // Another block leaves nothing of a table; seeds come after it.
        for (set, key) in [
            ("model={ extends = 'm.toml' }", "model.width"),
            ("model.extends='m.toml'", "model.width"),
            ("loss={ extends = [], bce = 1 }", "loss.dice"),
        ] {
            assert!(of(set).unwrap_err().contains(&format!("the sweep itself sets `{key}`")), "{set}");
        }
        for set in ["train={ extends = 't.toml' }", "model.encoder={ extends = 'm.toml' }", "eval.extends='e.toml'"] {
            assert!(of(set).is_ok(), "{set}");
        }
        assert!(of("train={ extends = 't.toml', seed = 3 }").unwrap_err().contains("`train.seed`"));
    }

    #[test]
    fn a_block_that_is_chosen_takes_the_place_of_the_former() {
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\nset = { loss = { extends = [] } }\n\
                    [sweep.product]\nmodel = [{ extends = [], width = 1 }, { extends = [], width = 2 }]\n";
        // Read as JSON, as the word would be resolved where it is written.
        let choose = |text: &str| {
            let table: toml::Table = toml::from_str(text).unwrap();
            Plan::new(table["sweep"].clone().try_into().unwrap(), &[])
        };
        let plan = choose(text).unwrap();
        let names = ["model={ width = 1 }", "model={ width = 2 }"];
        assert_eq!((plan.names(), plan.jobs[0].sets[0].as_str()), (names.to_vec(), "loss={ extends = [] }"));
        assert_eq!(plan.jobs[1].sets[1], "model={ extends = [], width = 2 }");
        // An earlier version listed the same without the word.
        let earlier = Job {
            sets: vec!["loss={}".into(), format!("{}", names[1]), plan.jobs[1].sets[2].clone()],
            ..plan.jobs[1].clone()
        };
        assert!(plan.jobs[1].is(&earlier) && earlier.is(&plan.jobs[1]) && !plan.jobs[0].is(&earlier));
        assert!(!plan.jobs[1].is(&Job { base: "c".into(), ..earlier }));
        // It hides what is set before it.
        let hidden = "[sweep]\nbase = 'b'\nseeds = [1]\n[[sweep.arms]]\nname = 'n'\nset = { 'model.depth' = 3 }\n\
                      [sweep.product]\nmodel = [{ extends = [], width = 1 }]\n";
        let said = choose(hidden).unwrap_err().to_string();
        assert!(said.starts_with("`sweep.arms` sets `model.depth`, and `sweep.product` sets it again"), "{said}");
        // Not what is set in it beside it, whatever the alphabet says.
        let beside =
            "[sweep]\nbase = 'b'\nseeds = [1]\nset = { 'model.depth' = 3, 'model.extends' = 'm.toml', lr = 1 }\n";
        assert_eq!(choose(beside).unwrap().jobs[0].sets[..3], ["lr=1", "model.extends=\"m.toml\"", "model.depth=3"]);
        for table in ["product", "zip"] {
            let text = "'model.depth' = [3]\n'model.extends' = ['m.toml']\nlr = [1]\n";
            let plan = choose(&format!("[sweep]\nbase = 'b'\nseeds = [1]\n[sweep.{table}]\n{text}")).unwrap();
            assert_eq!(plan.jobs[0].sets[..3], ["lr=1", "model.extends=\"m.toml\"", "model.depth=3"], "{table}");
        }
    }

    #[test]
    fn a_key_is_set_in_one_place() {
        let of = |more: &str| {
            let text = format!("[sweep]\nbase = 'b'\nseeds = [1, 2]\n{more}");
            Plan::new(file(&text), &[]).map(drop).map_err(|e| e.to_string())
        };
        let product = "[sweep.product]\n'a.x' = [1, 2]\n";
        for (more, place, key, hides) in [
            ("[sweep.product]\n'train.seed' = [5, 6]".to_owned(), "product", "train.seed", "seeds"),
            ("set = { 'train' = { seed = 3 } }".to_owned(), "set", "train.seed", "seeds"),
            (format!("{product}[sweep.zip]\n'a.x' = [3, 4]"), "product", "a.x", "zip"),
            (format!("{product}[sweep.zip]\na = [{{ x = 3 }}, {{ y = 4 }}]"), "product", "a.x", "zip"),
            (format!("{product}[[sweep.arms]]\nname = 'n'\nset = {{ 'a.x' = 3 }}"), "arms", "a.x", "product"),
        ] {
            let wanted = format!("`sweep.{place}` sets `{key}`, and `sweep.{hides}` sets it again");
            let said = of(&more).unwrap_err();
            assert!(said.starts_with(&wanted), "{said}");
        }
        // Points that differ in what all evaluations set are measured alike; they may learn from different corpora.
        let with = |set: &str| {
            format!("evaluate = true\nevaluate_with = {{ 'eval.x' = 8, 'data.corpora' = ['t.h5'] }}\n{set}")
        };
        let said = of(&with("[sweep.product]\n'eval.x' = [1, 16]")).unwrap_err();
        assert!(said.starts_with("`sweep.product` sets `eval.x`, and `sweep.evaluate_with` sets it again"), "{said}");
        assert_eq!(of(&with("[sweep.product]\n'data.corpora' = [['a.h5'], ['b.h5']]")), Ok(()));
        // However they set it, and what is tested on is nothing that runs have otherwise.
        let points = "[sweep.product]\n'eval.x' = [1, 16]\n'data.test' = [['a'], ['b']]";
        let both = "set = { 'data.test' = ['a'], 'eval.x' = 2 }";
        for (evaluation, more, place, key) in [
            ("eval = { extends = [] }", points, "product", "eval.x"),
            ("'eval.extends' = 'block.toml'", points, "product", "eval.x"),
            ("data = { extends = [], corpora = ['t.h5'] }", points, "product", "data.test"),
            ("'data.test' = ['b']", both, "set", "data.test"),
            ("data = { test = ['b'] }", both, "set", "data.test"),
        ] {
            let text = format!("evaluate = true\nevaluate_with = {{ {evaluation} }}\n{more}");
            let table: toml::Table = toml::from_str(&format!("[sweep]\nbase = 'b'\nseeds = [1, 2]\n{text}")).unwrap();
            let said = Plan::new(table["sweep"].clone().try_into().unwrap(), &[]).unwrap_err().to_string();
            let wanted = format!("`sweep.{place}` sets `{key}`, and `sweep.evaluate_with` sets it again");
            assert!(said.starts_with(&wanted), "{evaluation}: {said}");
        }
        assert_eq!(
            of(&with("set = { 'eval.x' = 2, 'data.test' = ['a'] }")),
            Ok(()),
            "of validations; of its own corpora"
        );
        let text =
            format!("[sweep]\nbase = 'b'\nseeds = [1]\n{}", with("")).replace("'eval.x' = 8", "'data.test' = ['b']");
        let set = |set: &str| Plan::new(file(&text), &[set.into()]).map(drop).map_err(|e| e.to_string());
        let wanted =
            "--set data.test=['c']: `sweep.evaluate_with` sets `data.test` for every evaluation; change it there";
        assert!(set("data.test=['c']").unwrap_err().starts_with(wanted));
        assert!(set("data={ test = ['c'] }").is_err() && set("data.validate=test").is_ok());
        // What all have by default may be another in some.
        assert_eq!(of(&format!("set = {{ 'a.x' = 1 }}\n{product}")), Ok(()));
        assert_eq!(of("set = { 'a.x' = 1 }\n[[sweep.arms]]\nname = 'n'\nset = { 'a.x' = 3 }"), Ok(()));
        assert_eq!(of(&format!("set = {{ 'a.xy' = 1 }}\n{product}[sweep.zip]\n'a.y' = [1, 2]")), Ok(()));
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
    fn folders_have_plain_names() {
        assert_eq!(slug("../A b/ c=[1, 2]"), "a-b-c-1-2");
        assert_eq!((slug("ohne Dice ü"), slug("--")), ("ohne-dice-ü".into(), "point".into()));
        assert!(slug(&"長".repeat(100)).len() <= 200);
        // Two names that come to the same folder have two.
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\n[[sweep.arms]]\nname = 'a b'\n[[sweep.arms]]\nname = 'a-b'";
        let plan = Plan::new(file(text), &[]).unwrap();
        assert_eq!(plan.jobs[1].folder, "jobs/a-b-2/seed-1");
    }
}
