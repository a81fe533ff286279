//! Numbers of a run, by where they are.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

/// What stands before a path into a run's evaluation.
pub(crate) const EVALUATION: &str = "eval.json:";

/// The number that [`crate::MetricOf::of`] names, of a run; `None` where there is none.
pub fn value(run: &Path, of: &str) -> Option<f64> {
    match of.strip_prefix(EVALUATION) {
        Some(path) => at(&evaluation(run)?, path),
        None => last(run).get(of).copied(),
    }
}

/// A run's evaluation, if it has one.
pub(crate) fn evaluation(run: &Path) -> Option<Value> {
    serde_json::from_str(&std::fs::read_to_string(run.join("eval.json")).ok()?).ok()
}

/// The last value of everything that the run's log has.
pub(crate) fn last(run: &Path) -> BTreeMap<String, f64> {
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
    if let Some(inner) = path.strip_prefix('[') {
        let (conditions, rest) = inner.split_once(']')?;
        let wanted: Vec<(&str, &str)> = conditions.split(',').map(|c| c.split_once('=')).collect::<Option<Vec<_>>>()?;
        let is = |value: &Value, text: &str| match value {
            Value::String(s) => s == text,
            Value::Number(n) => n.to_string() == text,
            Value::Bool(b) => text == if *b { "true" } else { "false" },
            _ => false,
        };
        let own = |e: &Value, key: &str, text: &str| {
            key.trim().split('.').try_fold(e, |e, part| e.get(part)).is_some_and(|v| is(v, text))
        };
        let fits = |e: &&Value| wanted.iter().all(|(key, text)| own(e, key, text.trim()));
        return Some((here.as_array()?.iter().find(fits)?, rest));
    }
    let own = path.strip_prefix('.').unwrap_or(path);
    let end = own.find(['.', '[']).unwrap_or(own.len());
    Some((here.get(&own[..end])?, &own[end..]))
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
    fn the_last_value_of_a_log_counts() {
        let dir = tempfile::tempdir().unwrap();
        let log = "{\"step\":1,\"eval/x\":1.0}\n{\"step\":2,\"eval/x\":2.5,\"eval/y\":null}\n{\"step\":3,\"tr";
        std::fs::write(dir.path().join("metrics.jsonl"), log).unwrap();
        assert_eq!(value(dir.path(), "eval/x"), Some(2.5));
        assert!(value(dir.path(), "eval/y").unwrap().is_nan());
        assert_eq!(value(dir.path(), "eval/z"), None);
        assert_eq!(value(dir.path(), "eval.json:x"), None);
    }
}
