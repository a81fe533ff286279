//! The file of a sweep.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use toml::Value;

/// The table `[sweep]` of a file.
///
/// ```toml
/// [sweep]
/// question = "Does the Dice loss raise IoU?"
/// base = "quickstart/fsq_cvae.toml"
/// seeds = [0, 1, 2]
/// evaluate = true
/// evaluate_with = { "data.corpora" = ["rigs.h5"] }
/// set = { "train.steps" = 400 }
///
/// [[sweep.arms]]
/// name = "with"
/// [[sweep.arms]]
/// name = "without"
/// set = { "loss.dice" = 0.0 }
///
/// [sweep.product]               # every combination
/// "model.width" = [128, 256]
/// [sweep.zip]                   # first with first, second with second
/// "train.steps" = [400, 800]
/// "train.optim.muon_lr" = [2e-3, 1e-3]
///
/// [[sweep.metrics]]
/// of = "eval/iou_rule@val"
///
/// [[sweep.figures]]
/// title = "IoU by codes"
/// x = "codes"
/// at = [4, 8, 16]
/// of = "eval.json:report.rows[split=test_new,method=rule,tokens={}].pooled.iou"
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepFile {
    /// What is asked.
    #[serde(default)]
    pub question: String,
    /// What is expected, and why.
    #[serde(default)]
    pub expected: String,
    /// Config of all jobs: a file, of the working folder or beside the sweep's, or a built-in experiment.
    pub base: String,
    /// Seeds; each point of the sweep is run with each.
    pub seeds: Vec<u64>,
    /// The key that a seed is written to.
    #[serde(default = "seed_key")]
    pub seed_key: String,
    /// Whether runs are evaluated on their test splits once they are trained.
    #[serde(default)]
    pub evaluate: bool,
    /// What evaluations have otherwise than the runs, as `riglab eval --set` takes it: corpora whose test splits all runs are
    /// measured on, whatever they learned from; more samples.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub evaluate_with: BTreeMap<String, Value>,
    /// Threads of a job; 0 takes the processors over the jobs that run at a time.
    #[serde(default)]
    pub threads: usize,
    /// Memory of a job in GB; 0 where it is not known: then the most that one of the sweep's jobs has taken.
    #[serde(default)]
    pub memory_gb: f64,
    /// Changes of all jobs.
    #[serde(default)]
    pub set: BTreeMap<String, Value>,
    /// Named variants; none is one without a name.
    #[serde(default)]
    pub arms: Vec<Arm>,
    /// Values of keys, of which every combination is run.
    #[serde(default)]
    pub product: BTreeMap<String, Vec<Value>>,
    /// Values of keys that change together.
    #[serde(default)]
    pub zip: BTreeMap<String, Vec<Value>>,
    /// Columns of the table; none takes everything that the last validation measured.
    #[serde(default)]
    pub metrics: Vec<MetricOf>,
    /// Figures of the report beside the table: numbers of a run over a number.
    #[serde(default)]
    pub figures: Vec<FigureOf>,
}

/// A variant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Its name in tables.
    pub name: String,
    /// Another config than that of the sweep.
    #[serde(default)]
    pub base: Option<String>,
    /// Its changes.
    #[serde(default)]
    pub set: BTreeMap<String, Value>,
}

/// A number of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MetricOf {
    /// Where it is: a name of `metrics.jsonl`, of which the last value is taken, or `eval.json:` and a path with
    /// conditions, such as `eval.json:report.rows[split=test_new,method=rule,tokens=16].pooled.iou`.
    pub of: String,
    /// Its name in tables; without one, `of`.
    #[serde(default)]
    pub name: String,
    /// `higher` or `lower`; without it nothing is marked as the best.
    #[serde(default)]
    pub better: Option<Better>,
    /// Digits after the point.
    #[serde(default = "digits")]
    pub digits: usize,
}

/// Which values are the good ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Large ones.
    Higher,
    /// Small ones.
    Lower,
}

/// Numbers of a run that are counted by something, such as IoU by the number of codes: a line a point of the sweep, each
/// place the mean over seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FigureOf {
    /// What it shows.
    pub title: String,
    /// Name of the axis.
    pub x: String,
    /// Places on the axis.
    pub at: Vec<f64>,
    /// Where the number of a place is, as in [`MetricOf::of`]; `{}` stands for the place.
    pub of: String,
}

impl SweepFile {
    /// The `--set` of `riglab eval` for every run.
    pub fn evaluation_sets(&self) -> Vec<String> {
        changes(&self.evaluate_with)
    }

    /// The keys whose values from before evaluations replace, with all that is below them.
    fn replaced_by_evaluations(&self) -> Vec<String> {
        self.evaluation_sets().iter().flat_map(|set| replaced(set)).collect()
    }

    /// The key of the first of `sets` that says which splits are tested on, where evaluations say it again.
    pub(crate) fn tested_otherwise<'a>(&self, sets: &'a [String]) -> Option<(&'a str, &'static str)> {
        let again = name_tests(&self.evaluation_sets());
        let of = |set: &&String| again && leaves(set).iter().any(|key| key == TESTED);
        Some((sets.iter().find(of)?.as_str(), TESTED))
    }

    /// The first of `sets` that is of a key in which points or seeds differ, and that key.
    pub(crate) fn overridden<'a>(&self, sets: &'a [String]) -> Option<(&'a str, String)> {
        let of_arms = self.arms.iter().flat_map(|arm| arm.set.keys());
        let own: Vec<&String> = of_arms.chain(self.product.keys()).chain(self.zip.keys()).collect();
        let of = |set: &'a String| {
            let (keys, replaced) = (leaves(set), replaced(set));
            let hit = own.iter().find(|own| replaced.iter().any(|key| same(own, key))).copied();
            // Seeds come last: a table that is chosen anew does not hide them.
            let hit = hit.or_else(|| keys.iter().any(|key| same(&self.seed_key, key)).then_some(&self.seed_key))?;
            Some((set.as_str(), hit.clone()))
        };
        sets.iter().find_map(of)
    }

    /// A number that is infinite or none, and its key: a folder could not keep it, nor could anyone compute with it.
    pub(crate) fn unkept(&self) -> Option<(String, f64)> {
        let one = |place: &str, set: &BTreeMap<String, Value>| -> Vec<(String, Option<f64>)> {
            set.iter().map(|(key, value)| (format!("{place}.{key:?}"), strange(value))).collect()
        };
        let all = |place: &str, grid: &BTreeMap<String, Vec<Value>>| -> Vec<(String, Option<f64>)> {
            grid.iter().map(|(key, values)| (format!("{place}.{key:?}"), values.iter().find_map(strange))).collect()
        };
        let arms = self.arms.iter().enumerate();
        let figures = self.figures.iter().enumerate();
        let places = figures.map(|(k, f)| (format!("figures[{k}].at"), f.at.iter().copied().find(|x| !x.is_finite())));
        let own = [("memory_gb".to_owned(), Some(self.memory_gb).filter(|x| !x.is_finite()))].into_iter();
        let own = own.chain(one("set", &self.set)).chain(one("evaluate_with", &self.evaluate_with));
        let own = own.chain(all("product", &self.product)).chain(all("zip", &self.zip));
        let own = own.chain(arms.flat_map(|(k, arm)| one(&format!("arms[{k}].set"), &arm.set))).chain(places);
        own.filter_map(|(key, number)| Some((key, number?))).next()
    }

    /// A key whose value in one place of the file is hidden from every run by another: the key and both places.
    pub(crate) fn hidden(&self) -> Option<(String, &'static str, &'static str)> {
        let one = |set: &BTreeMap<String, Value>| -> Vec<String> {
            set.iter().map(|(key, v)| format!("{key}={v}")).collect()
        };
        let all = |grid: &BTreeMap<String, Vec<Value>>| -> Vec<String> {
            grid.iter().flat_map(|(key, values)| values.iter().map(move |v| format!("{key}={v}"))).collect()
        };
        let seeds = [(self.seed_key.clone(), "sweep.seeds")];
        // In the order in which they are set, so that the last one counts.
        let arms = self.arms.iter().flat_map(|arm| one(&arm.set)).collect();
        let own: [(&str, Vec<String>); 4] = [
            ("sweep.set", one(&self.set)),
            ("sweep.arms", arms),
            ("sweep.product", all(&self.product)),
            ("sweep.zip", all(&self.zip)),
        ];
        // What is of evaluations alone; they may be on other corpora than training, and mean to. Where runs are alike, their
        // validations may have other settings than evaluations, but tested on is nothing else.
        let of_evaluations = |key: &str| key == "eval" || key.starts_with("eval.") || key == TESTED;
        let again = self.replaced_by_evaluations();
        let all = own.iter().flat_map(|(place, sets)| sets.iter().map(move |set| (*place, set)));
        let mut all = all.flat_map(|(place, set)| leaves(set).into_iter().map(move |key| (place, key)));
        let hides = |(place, key): &(&str, String)| {
            let counts = of_evaluations(key) && (*place != "sweep.set" || key == TESTED);
            counts && again.iter().any(|other| same(key, other))
        };
        if let Some((place, key)) = all.find(hides) {
            return Some((key, place, "sweep.evaluate_with"));
        }
        own.iter().enumerate().find_map(|(k, (place, sets))| {
            // What all runs have by default may be another in some.
            let later = own.iter().skip(if k == 0 { own.len() } else { k + 1 });
            let later =
                later.flat_map(|(place, sets)| sets.iter().flat_map(|set| replaced(set)).map(|key| (key, *place)));
            let later: Vec<(String, &str)> = later.chain(seeds.clone()).collect();
            sets.iter().flat_map(|set| leaves(set)).find_map(|key| {
                let (_, hides) = later.iter().find(|(other, _)| same(&key, other))?;
                Some((key, *place, *hides))
            })
        })
    }
}

/// Whether settings of evaluations say which splits are tested on, whatever runs say themselves.
pub fn name_tests(evaluation: &[String]) -> bool {
    evaluation.iter().flat_map(|set| replaced(set)).any(|key| same(&key, TESTED))
}

/// Changes as `--set` takes them.
pub(crate) fn changes(set: &BTreeMap<String, Value>) -> Vec<String> {
    in_order(set).into_iter().map(|(key, value)| format!("{key}={value}")).collect()
}

/// Keys in the order in which they are set: a table is chosen before what is set in it, which would be lost otherwise.
pub(crate) fn in_order<T>(set: &BTreeMap<String, T>) -> Vec<(&String, &T)> {
    let mut all: Vec<(&String, &T)> = set.iter().collect();
    all.sort_by_key(|(key, _)| key.strip_suffix(CHOICE).and_then(|t| t.strip_suffix('.')).unwrap_or(key));
    all
}

/// Whether two keys are the same, or one is within the other: what is no table takes the place of a whole one.
fn same(one: &str, other: &str) -> bool {
    let within = |key: &str, table: &str| key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.'));
    one == other || within(one, other) || within(other, one)
}

/// The key of the splits that are tested on.
const TESTED: &str = "data.test";

/// The key by which a table says that it is chosen anew.
const CHOICE: &str = "extends";

/// The keys that `KEY=VALUE` gives values: those of a table one by one, as tables are merged.
fn leaves(set: &str) -> Vec<String> {
    let mut out = keys(set, false);
    out.retain(|key| key.rsplit('.').next() != Some(CHOICE));
    out
}

/// The keys whose values from before `KEY=VALUE` replaces, with all that is below them: where a table is chosen anew, its
/// own.
fn replaced(set: &str) -> Vec<String> {
    let above = |key: String| match key.strip_suffix(CHOICE).and_then(|above| above.strip_suffix('.')) {
        Some(above) => above.to_owned(),
        None => key,
    };
    keys(set, true).into_iter().map(above).collect()
}

/// Keys of `KEY=VALUE`, those of a table one by one, but for tables that are chosen anew where they are asked for `whole`.
fn keys(set: &str, whole: bool) -> Vec<String> {
    fn add(key: &str, value: &Value, whole: bool, out: &mut Vec<String>) {
        match value {
            Value::Table(table) if !(whole && table.contains_key(CHOICE)) => {
                table.iter().for_each(|(own, value)| add(&format!("{key}.{own}"), value, whole, out));
            }
            _ => out.push(key.to_owned()),
        }
    }
    let (key, value) = split(set);
    let mut out = Vec::new();
    match value {
        Some(value) => add(key, &value, whole, &mut out),
        None => out.push(key.to_owned()),
    }
    out
}

/// The key and the value of `KEY=VALUE`; a word without quotes is no TOML, and no table either.
fn split(set: &str) -> (&str, Option<Value>) {
    let (key, value) = set.split_once('=').unwrap_or((set, ""));
    let table = toml::from_str::<toml::Table>(&format!("v = {value}")).ok();
    (key.trim(), table.and_then(|mut table| table.remove("v")))
}

/// A number of a value that is infinite or none.
fn strange(value: &Value) -> Option<f64> {
    match value {
        Value::Float(x) => Some(*x).filter(|x| !x.is_finite()),
        Value::Array(values) => values.iter().find_map(strange),
        Value::Table(table) => table.values().find_map(strange),
        _ => None,
    }
}

/// A value without the word that a table is chosen anew.
pub(crate) fn unsaid(value: &Value) -> Value {
    match value {
        Value::Table(table) => {
            let said = |key: &str, value: &Value| key == CHOICE && value.as_array().is_some_and(Vec::is_empty);
            let rest = table.iter().filter(|(key, value)| !said(key, value));
            Value::Table(rest.map(|(key, value)| (key.clone(), unsaid(value))).collect())
        }
        Value::Array(values) => Value::Array(values.iter().map(unsaid).collect()),
        other => other.clone(),
    }
}

/// Whether two changes are the same but for the word that tables are chosen anew, which earlier versions left out.
pub(crate) fn alike(one: &str, other: &str) -> bool {
    let plain = |set| {
        let (key, value) = split(set);
        Some((key, unsaid(&value?)))
    };
    one == other || plain(one).is_some_and(|one| Some(one) == plain(other))
}

impl MetricOf {
    /// What stands above its column.
    pub fn head(&self) -> &str {
        if self.name.is_empty() { &self.of } else { &self.name }
    }

    pub(crate) fn plain(of: &str) -> Self {
        Self { of: of.into(), name: String::new(), better: None, digits: digits() }
    }
}

impl FigureOf {
    /// Where the number of each place is.
    pub(crate) fn places(&self) -> impl Iterator<Item = String> {
        self.at.iter().map(|x| self.of.replace("{}", &x.to_string()))
    }
}

fn seed_key() -> String {
    "train.seed".into()
}

fn digits() -> usize {
    4
}
