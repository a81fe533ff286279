//! Numbers that a sweep's file asks for and no run has: said, with the names that there are.

use std::cell::LazyCell;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::values::{EVALUATION, Numbers, evaluation, follow};
use crate::{FigureOf, Results, SweepFile};

/// Names that are told.
const TOLD: usize = 5;

impl Results {
    /// A sentence for each column and figure that stays empty because no finished run has its numbers. Empty while no run
    /// is finished.
    pub fn absent(&self, folder: &Path) -> Vec<String> {
        let all = self.plan.jobs.iter().zip(&self.outcomes).zip(&self.numbers);
        let runs: Vec<(PathBuf, &Numbers)> = all
            .filter(|((_, outcome), _)| outcome.state == "finished")
            .map(|((job, _), numbers)| (folder.join(&job.folder), numbers))
            .collect();
        let columns = self.plan.sweep.metrics.iter().map(|m| ("column", m.head(), vec![m.of.clone()]));
        let figures = self.plan.sweep.figures.iter().map(|f| ("figure", f.title.as_str(), f.places().collect()));
        let empty = |of: &String| runs.iter().all(|(_, numbers)| numbers.value(of).is_none());
        let asked = columns.chain(figures).filter(|(.., places)| !runs.is_empty() && places.iter().all(empty));
        // To tell what there is instead.
        let example = LazyCell::new(|| runs.iter().find_map(|(run, _)| evaluation(run)));
        asked.map(|(what, name, places)| sentence(what, name, &places[0], &runs, &example)).collect()
    }

    /// A sentence for each figure that has numbers at some places and none at others, and for each of its lines that leaves
    /// out places which some of its runs have, as far as finished runs tell.
    pub fn gaps(&self) -> Vec<String> {
        let runs: Vec<&Numbers> = self.finished().collect();
        let empty = |of: &String| runs.iter().all(|numbers| numbers.value(of).is_none());
        let of = |figure: &FigureOf| {
            let at = figure.at.iter().zip(figure.places());
            let missing: Vec<String> = at.filter(|(_, of)| empty(of)).map(|(x, _)| x.to_string()).collect();
            let some = !missing.is_empty() && missing.len() < figure.at.len();
            some.then(|| {
                format!("the figure `{}` has a gap at {}: no finished run has these", figure.title, missing.join(", "))
            })
        };
        self.plan.sweep.figures.iter().flat_map(|figure| of(figure).into_iter().chain(self.partly(figure))).collect()
    }

    /// A sentence for each line of a figure that leaves out places which some of its runs have.
    fn partly(&self, figure: &FigureOf) -> Vec<String> {
        let line = |point: &str| {
            let all = self.outcomes.iter().zip(&self.numbers);
            let runs: Vec<&Numbers> =
                all.filter(|(o, _)| o.point == point && o.state == "finished").map(|(_, numbers)| numbers).collect();
            let having = |of: &String| runs.iter().filter(|run| run.value(of).is_some_and(f64::is_finite)).count();
            let some = |of: &String| (1..runs.len()).contains(&having(of));
            let places: Vec<String> =
                figure.at.iter().zip(figure.places()).filter(|(_, of)| some(of)).map(|(x, _)| x.to_string()).collect();
            let (title, places) = (&figure.title, (!places.is_empty()).then(|| places.join(", "))?);
            Some(format!("the figure `{title}` leaves out {places} of `{point}`: not all of its finished runs have it"))
        };
        self.plan.names().into_iter().filter_map(line).collect()
    }

    fn finished(&self) -> impl Iterator<Item = &Numbers> {
        self.outcomes.iter().zip(&self.numbers).filter(|(outcome, _)| outcome.state == "finished").map(|(_, n)| n)
    }

    /// A sentence for each column and figure whose conditions fit several rows of the first evaluation, of which the first is
    /// taken.
    pub fn ambiguous(&self, folder: &Path) -> Vec<String> {
        let finished = self.plan.jobs.iter().zip(&self.outcomes).filter(|(_, outcome)| outcome.state == "finished");
        let Some(json) = finished.map(|(job, _)| folder.join(&job.folder)).find_map(|run| evaluation(&run)) else {
            return Vec::new();
        };
        let columns = self.plan.sweep.metrics.iter().map(|m| ("column", m.head(), Some(m.of.clone())));
        let figures = self.plan.sweep.figures.iter().map(|f| ("figure", f.title.as_str(), f.places().next()));
        let of = |(what, name, place): (&str, &str, Option<String>)| {
            let several = several(&json, place?.strip_prefix(EVALUATION)?)?;
            Some(format!("the {what} `{name}` takes the first {several}"))
        };
        columns.chain(figures).filter_map(of).collect()
    }
}

/// Where conditions of a path fit several rows: how many, and in what they differ.
fn several(json: &Value, path: &str) -> Option<String> {
    let (rows, rest) = path.split_once('[')?;
    let (conditions, rest) = rest.split_once(']')?;
    let all = follow(json, rows).ok()?.as_array()?;
    let fits = |row: &&Value| follow(&Value::Array(vec![(*row).clone()]), &format!("[{conditions}]")).is_ok();
    let fitting: Vec<&Value> = all.iter().filter(fits).collect();
    let first = fitting.first()?;
    if fitting.len() < 2 {
        return several(first, rest);
    }
    // What tells rows apart is a word or a whole number; measures are neither.
    let keys = first.as_object()?.iter().filter(|(_, value)| value.is_string() || value.is_u64());
    let values = |key: &String| -> BTreeSet<String> {
        fitting.iter().filter_map(|row| row.get(key)).map(|v| v.to_string().trim_matches('"').to_owned()).collect()
    };
    let differ = keys.map(|(key, _)| (key, values(key))).find(|(_, values)| values.len() == fitting.len());
    let advice = differ.map_or(String::new(), |(key, values)| {
        format!("; add a condition, such as {key}={}", values.into_iter().next().unwrap_or_default())
    });
    Some(format!("of the {} rows of `{}` that fit [{conditions}]{advice}", fitting.len(), rows.trim_start_matches('.')))
}

impl SweepFile {
    /// What is read from evaluations, which the sweep does not make.
    pub fn unevaluated(&self) -> Vec<&str> {
        let asked = self.metrics.iter().map(|m| &m.of).chain(self.figures.iter().map(|f| &f.of));
        asked.filter(|of| !self.evaluate && of.starts_with(EVALUATION)).map(String::as_str).collect()
    }
}

fn sentence(
    what: &str,
    name: &str,
    of: &str,
    runs: &[(PathBuf, &Numbers)],
    example: &LazyCell<Option<Value>, impl FnOnce() -> Option<Value>>,
) -> String {
    let asked = if name == of { String::new() } else { format!(" (`{of}`)") };
    let there = match of.strip_prefix(EVALUATION) {
        Some(path) => match &**example {
            Some(json) => stuck(json, path),
            None => "no run was evaluated: set `evaluate = true` in the sweep's file".into(),
        },
        None => {
            let names: BTreeSet<&str> = runs.iter().flat_map(|(_, n)| n.last.keys()).map(String::as_str).collect();
            format!("there {}", listed(of, names.into_iter()))
        }
    };
    format!("the {what} `{name}`{asked} is empty, no finished run has it; {there}")
}

/// Where a path ends that leads to no number, and what there is instead.
fn stuck(json: &Value, path: &str) -> String {
    let (here, rest) = match follow(json, path) {
        Ok(value) => (value, ""),
        Err(stuck) => stuck,
    };
    let come = match path[..path.len() - rest.len()].trim_end_matches('.') {
        "" => "eval.json".to_owned(),
        come => format!("`{come}`"),
    };
    match here {
        Value::Object(own) => {
            let word = rest.trim_start_matches('.').split(['.', '[']).next().unwrap_or_default();
            format!("in {come} {}", listed(word, own.keys().map(String::as_str)))
        }
        Value::Array(own) if own.is_empty() => {
            format!("{come} has no rows: the evaluation found nothing to measure there")
        }
        Value::Array(own) => match rest.strip_prefix('[').and_then(|inner| inner.split_once(']')) {
            Some((conditions, _)) => {
                format!("none of the {} rows of {come} fits: {}", own.len(), rows(own, conditions))
            }
            None => format!("{come} is a list: choose a row by a condition, such as [split=val]"),
        },
        other => format!("{come} is {other}, and nothing below it"),
    }
}

/// The values that rows have under the keys of conditions.
fn rows(rows: &[Value], conditions: &str) -> String {
    let keys = conditions.split(',').map(|c| c.split_once('=').unwrap_or((c, "")));
    let of = |(key, wanted): (&str, &str)| {
        let key = key.trim();
        let found = |row| match follow(row, key).ok()? {
            Value::String(s) => Some(s.clone()),
            Value::Object(_) | Value::Array(_) => None,
            other => Some(other.to_string()),
        };
        let values: BTreeSet<String> = rows.iter().filter_map(found).collect();
        format!("as {key} there {}", listed(wanted.trim(), values.iter().map(String::as_str)))
    };
    keys.map(of).collect::<Vec<_>>().join(", ")
}

/// "is `a`", "are `a`, `b` and 3 more": those that are most like `word` first.
fn listed<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> String {
    let mut known: Vec<&str> = known.collect();
    // A part of a name is what people give who leave out the rest.
    known.sort_by_key(|k| (word.is_empty() || !k.contains(word), strsim::osa_distance(word, k)));
    let some: Vec<String> = known.iter().take(TOLD).map(|k| format!("`{k}`")).collect();
    match known.len() {
        0 => "is nothing".into(),
        1 => format!("is {}", some[0]),
        n if n > TOLD => format!("are {} and {} more", some.join(", "), n - TOLD),
        _ => format!("are {}", some.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Plan;

    #[test]
    fn what_no_run_has_is_told_with_what_there_is() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2]\n\
            [[sweep.metrics]]\nof = 'eval/iou@val'\n[[sweep.metrics]]\nof = 'eval/uio@val'\nname = 'IoU'\n\
            [[sweep.metrics]]\nof = 'eval/none@val'\n\
            [[sweep.metrics]]\nof = 'eval.json:report.rows[split=test].iou'\n\
            [[sweep.metrics]]\nof = 'eval.json:report.rows[split=val].uio'\n\
            [[sweep.metrics]]\nof = 'eval.json:report.rows'\n\
            [[sweep.metrics]]\nof = 'eval.json:report.springs[split=val].rms'\n\
            [[sweep.figures]]\ntitle = 'by k'\nx = 'k'\nat = [4, 8]\nof = 'eval.json:report.row[k={}].iou'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let absent = || Results::read(dir.path(), &plan).absent(dir.path());
        assert!(absent().is_empty(), "nothing is finished yet");
        let run = dir.path().join(&plan.jobs[1].folder);
        std::fs::create_dir_all(&run).unwrap();
        // What was measured and is no number is not absent.
        let log = "{\"step\":1,\"eval/iou@val\":0.5,\"eval/none@val\":null,\"train/loss\":1.0}\n";
        std::fs::write(run.join("metrics.jsonl"), log).unwrap();
        std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        let said = absent();
        let wanted = "the column `IoU` (`eval/uio@val`) is empty, no finished run has it; there are `eval/iou@val`, ";
        assert!(said[0].starts_with(wanted), "{said:?}");
        assert!(said[1].ends_with("set `evaluate = true` in the sweep's file"), "{said:?}");
        assert_eq!((said.len(), plan.sweep.unevaluated().len()), (6, 5));
        let eval = "{\"report\": {\"springs\": [], \
            \"rows\": [{\"split\": \"val\", \"iou\": 0.5}, {\"split\": \"new\", \"iou\": 0.4}]}}";
        std::fs::write(run.join("eval.json"), eval).unwrap();
        let ends: Vec<String> = absent()[1..].iter().map(|s| s.split_once("; ").unwrap().1.to_owned()).collect();
        let wanted = [
            "none of the 2 rows of `report.rows` fits: as split there are `new`, `val`",
            "in `report.rows[split=val]` are `iou`, `split`",
            "`report.rows` is a list: choose a row by a condition, such as [split=val]",
            "`report.springs` has no rows: the evaluation found nothing to measure there",
            "in `report` are `rows`, `springs`",
        ];
        assert_eq!(ends, wanted);
    }

    #[test]
    fn places_of_a_figure_that_no_run_has_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2]\n\
            [[sweep.figures]]\ntitle = 'by k'\nx = 'k'\nat = [4, 8, 16]\nof = 'eval.json:report.rows[k={}].iou'\n\
            [[sweep.figures]]\ntitle = 'none'\nx = 'k'\nat = [3]\nof = 'eval.json:report.rows[k={}].iou'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let gaps = || Results::read(dir.path(), &plan).gaps();
        assert!(gaps().is_empty(), "nothing is finished yet");
        let run = dir.path().join(&plan.jobs[1].folder);
        std::fs::create_dir_all(&run).unwrap();
        std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        std::fs::write(run.join("eval.json"), "{\"report\": {\"rows\": [{\"k\": 8, \"iou\": 0.5}]}}").unwrap();
        // One that is empty is told as that.
        assert_eq!(gaps(), ["the figure `by k` has a gap at 4, 16: no finished run has these"]);
    }

    #[test]
    fn conditions_that_fit_several_rows_are_told() {
        let json = serde_json::json!({"rows": [
            {"split": "new", "k": 1, "iou": 0.1, "pooled": {"all": [{"w": "a", "x": 1.0}, {"w": "b", "x": 1.0}]}},
            {"split": "new", "k": 4, "iou": 0.1},
            {"split": "val", "k": 4, "iou": 0.3},
        ]});
        let of = |path: &str| several(&json, path);
        assert_eq!(
            of("rows[split=new].iou").unwrap(),
            "of the 2 rows of `rows` that fit [split=new]; add a condition, such as k=1"
        );
        assert_eq!(
            [of("rows[split=new,k=4].iou"), of("rows[split=val].iou"), of("rows[split=x].iou"), of("rows")],
            [const { None }; 4]
        );
        let below = of("rows[split=new,k=1].pooled.all[x=1.0].x").unwrap();
        assert_eq!(below, "of the 2 rows of `pooled.all` that fit [x=1.0]; add a condition, such as w=a");
    }
}
