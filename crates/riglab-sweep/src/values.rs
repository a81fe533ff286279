//! Numbers of a run, by where they are.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use crate::companions::{Companions, companions};
use crate::corpora::{Corpora, looked_at, trained_on};
use crate::state::info;

/// What stands before a path into a run's evaluation.
pub(crate) const EVALUATION: &str = "eval.json:";

/// What a finished run found, as far as a sweep asks for it: its files may be large, and are read once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Numbers {
    /// The last value of everything that its log has.
    pub last: BTreeMap<String, f64>,
    /// Of its evaluation what was asked for, by [`crate::MetricOf::of`].
    evaluated: BTreeMap<String, f64>,
    /// What it was trained on.
    pub trained_on: Corpora,
    /// What its evaluation looked at.
    pub evaluated_on: Corpora,
    /// The networks that it had beside its own.
    pub companions: Companions,
    /// Whether its evaluation is of a checkpoint though none was the run's best.
    pub without_best: bool,
    /// The assets of its evaluation that it was trained on, or a model that it builds on.
    pub seen: Vec<String>,
    /// What its evaluation says of models that it took in the place of the run's.
    pub other_models: Vec<String>,
}

impl Numbers {
    /// Of a run, with the numbers of its evaluation that are `asked` for.
    pub fn read(run: &Path, asked: &[String]) -> Self {
        let evaluation = evaluation(run).unwrap_or_default();
        let found = |of: &String| Some((of.clone(), at(&evaluation, of.strip_prefix(EVALUATION)?)?));
        let evaluated = asked.iter().filter_map(found).collect();
        let without_best = evaluation.pointer("/checkpoint/best").is_some_and(Value::is_null);
        let info = info(run);
        let words = |key: &str| -> Vec<String> {
            evaluation[key].as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect()
        };
        Self {
            last: last(run),
            evaluated,
            trained_on: trained_on(&info),
            evaluated_on: looked_at(&evaluation),
            companions: companions(run, &info),
            without_best,
            seen: words("trained_on"),
            other_models: words("other_models"),
        }
    }

    /// The number that [`crate::MetricOf::of`] names; `None` where there is none.
    pub fn value(&self, of: &str) -> Option<f64> {
        let all = if of.starts_with(EVALUATION) { &self.evaluated } else { &self.last };
        all.get(of).copied()
    }
}

/// What is wrong with where a number is said to be, as far as that is seen without a run.
pub(crate) fn fault(of: &str) -> Option<String> {
    if let Some(path) = of.strip_prefix(EVALUATION) {
        let mut rest = path;
        let mut read = || {
            while !rest.is_empty() {
                rest = part(rest)?.1;
            }
            if path.is_empty() { Err("it names nothing in eval.json".to_owned()) } else { Ok(()) }
        };
        let example = "write a path such as `eval.json:report.rows[split=val,tokens=4].iou`";
        return read().err().map(|wrong| format!("{wrong}; {example}"));
    }
    // Behind `@` stands a split, which may be called anything.
    let name = of.split('@').next().unwrap_or(of);
    let known = "write `eval.json:` and a path, or a name of metrics.jsonl alone, such as `eval/iou@val`";
    let file = name.split_once(':').map(|(file, _)| file);
    match file {
        Some(file) => Some(format!("numbers of a file `{file}` are not known; {known}")),
        None if name.is_empty() || name.starts_with("eval.json") || name.contains(['[', ']']) => {
            Some(format!("it is no name of metrics.jsonl; {known}"))
        }
        None => None,
    }
}

/// A run's evaluation, if it has one.
pub(crate) fn evaluation(run: &Path) -> Option<Value> {
    serde_json::from_str(&std::fs::read_to_string(run.join("eval.json")).ok()?).ok()
}

/// The last value of everything that the run's log has.
fn last(run: &Path) -> BTreeMap<String, f64> {
    let text = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
    let mut out = BTreeMap::new();
    for line in text.lines().filter_map(|l| serde_json::from_str::<Value>(l).ok()) {
        let numbers = line.as_object().into_iter().flatten().filter(|(name, _)| *name != "step");
        // A value that is not finite is written as null: it is the last all the same.
        out.extend(numbers.map(|(name, value)| (name.clone(), value.as_f64().unwrap_or(f64::NAN))));
    }
    out
}

fn at(value: &Value, path: &str) -> Option<f64> {
    follow(value, path).ok()?.as_f64()
}

/// Follows a path such as `report.rows[split=val,tokens=4].iou`; conditions choose the first element of a list that
/// has all of these values; their keys may be paths, too.
///
/// # Errors
/// How far it leads: the value there, and the rest of the path.
pub(crate) fn follow<'v, 'p>(value: &'v Value, path: &'p str) -> Result<&'v Value, (&'v Value, &'p str)> {
    let mut here = value;
    let mut rest = path;
    while !rest.is_empty() {
        (here, rest) = step(here, rest).ok_or((here, rest))?;
    }
    Ok(here)
}

/// One step of a path: where it leads, and the rest.
fn step<'v, 'p>(here: &'v Value, path: &'p str) -> Option<(&'v Value, &'p str)> {
    let (part, rest) = part(path).ok()?;
    let wanted = match part {
        Part::Key(key) => return Some((here.get(key)?, rest)),
        Part::Row(wanted) => wanted,
    };
    let is = |value: &Value, text: &str| match value {
        Value::String(s) => s == text,
        Value::Number(n) => n.to_string() == text,
        Value::Bool(b) => text == if *b { "true" } else { "false" },
        _ => false,
    };
    let own = |e: &Value, key: &str, text: &str| {
        key.split('.').try_fold(e, |e, part| e.get(part)).is_some_and(|v| is(v, text))
    };
    let fits = |e: &&Value| wanted.iter().all(|(key, text)| own(e, key, text));
    Some((here.as_array()?.iter().find(fits)?, rest))
}

/// A part of a path.
enum Part<'p> {
    /// A key of a table.
    Key(&'p str),
    /// Conditions of a row: key and value.
    Row(Vec<(&'p str, &'p str)>),
}

/// The first part of a path, and the rest.
fn part(path: &str) -> Result<(Part<'_>, &str), String> {
    let Some(inner) = path.strip_prefix('[') else {
        let own = path.strip_prefix('.').unwrap_or(path);
        let end = own.find(['.', '[', ']']).unwrap_or(own.len());
        return match &own[..end] {
            "" if own.starts_with(']') => Err(format!("no bracket is open before `{own}`")),
            "" => Err(format!("a key is missing before `{path}`")),
            key => Ok((Part::Key(key), &own[end..])),
        };
    };
    let closed = inner.split_once(']').filter(|(conditions, _)| !conditions.contains('['));
    let (conditions, rest) = closed.ok_or_else(|| format!("the bracket of `{path}` is not closed"))?;
    let wanted = conditions.split(',').map(|c| match c.split_once('=') {
        Some((key, value)) if !key.trim().is_empty() => Ok((key.trim(), value.trim())),
        _ => Err(format!("`{c}` in `[{conditions}]` is no condition")),
    });
    Ok((Part::Row(wanted.collect::<Result<_, _>>()?), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_choose_rows_by_their_values() {
        let json = serde_json::json!({"report": {"rows": [
            {"split": "a", "tokens": 4, "pooled": {"iou": 0.5}},
            {"split": "b", "tokens": 4, "pooled": {"iou": 0.25}},
        ]}});
        assert_eq!(at(&json, "report.rows[split=b, tokens=4].pooled.iou"), Some(0.25));
        assert_eq!(at(&json, "report.rows[pooled.iou=0.25].tokens"), Some(4.0));
        for wrong in ["report.rows[split=c].pooled.iou", "report.rows[split", "report.rows.iou", "report", "[x=1]"] {
            assert_eq!(at(&json, wrong), None, "{wrong}");
        }
    }

    #[test]
    fn what_can_be_no_number_is_seen_without_a_run() {
        let sound = ["eval/iou@val", "train/loss", "eval/iou@a:[b]", "eval.json:a", "eval.json:r.rows[a.b=x, k=4].iou"];
        sound.iter().for_each(|of| assert_eq!(fault(of), None, "{of}"));
        let wrong = |of: &str| fault(of).unwrap_or_else(|| panic!("{of} is refused"));
        let said = wrong("eval.jsn:report.rows[split=val].iou");
        assert!(said.starts_with("numbers of a file `eval.jsn` are not known; write `eval.json:`"), "{said}");
        for of in ["", "eval.json.report.iou", "report.rows[split=val].iou"] {
            assert!(wrong(of).starts_with("it is no name of metrics.jsonl; write"), "{of}");
        }
        for (of, why) in [
            ("eval.json:", "it names nothing in eval.json"),
            ("eval.json:report.rows[split=val", "the bracket of `[split=val` is not closed"),
            ("eval.json:rows[a=b.rows[c=d].iou", "the bracket of `[a=b.rows[c=d].iou` is not closed"),
            ("eval.json:rows split=val].iou", "no bracket is open before `].iou`"),
            ("eval.json:rows[].iou", "`` in `[]` is no condition"),
            ("eval.json:rows[split=val,k].iou", "`k` in `[split=val,k]` is no condition"),
            ("eval.json:report..iou", "a key is missing before `..iou`"),
            ("eval.json:report.", "a key is missing before `.`"),
        ] {
            assert_eq!(wrong(of).split("; ").next(), Some(why), "{of}");
            assert!(wrong(of).contains("write a path such as `eval.json:report"), "{of}");
        }
    }

    #[test]
    fn the_last_value_of_a_log_counts() {
        let dir = tempfile::tempdir().unwrap();
        let log = "{\"step\":1,\"eval/x\":1.0}\n{\"step\":2,\"eval/x\":2.5,\"eval/y\":null}\n{\"step\":3,\"tr";
        std::fs::write(dir.path().join("metrics.jsonl"), log).unwrap();
        let numbers = Numbers::read(dir.path(), &["eval.json:x".into()]);
        assert_eq!(numbers.value("eval/x"), Some(2.5));
        assert!(numbers.value("eval/y").unwrap().is_nan());
        assert_eq!(numbers.value("eval/z"), None);
        assert_eq!(numbers.value("eval.json:x"), None);
        let evaluation = r#"{"x": 2, "trained_on": ["fox", "cat"], "other_models": ["skin.run names another"]}"#;
        std::fs::write(dir.path().join("eval.json"), evaluation).unwrap();
        let numbers = Numbers::read(dir.path(), &["eval.json:x".into()]);
        assert_eq!((numbers.seen.len(), numbers.other_models.len()), (2, 1));
    }
}
