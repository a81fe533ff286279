//! Units in which a sweep's numbers are shown: those of the runs' own tables and curves.
//!
//! Logs and evaluations have distances between skeletons as shares of the cube's edge, and so has `results.jsonl`, which is
//! the truth; tables and pictures have them × 100, with that behind their names.

use riglab_report::{TIMES_100, in_unit};

use crate::MetricOf;
use crate::values::EVALUATION;

/// What a number is multiplied by where it is shown, by where it is ([`MetricOf::of`]).
pub(crate) fn factor(of: &str) -> f64 {
    let own = match of.strip_prefix(EVALUATION) {
        Some(path) => path.rsplit('.').next().unwrap_or(path),
        None => of,
    };
    in_unit(own).1
}

/// A name that a file gives a number, with its unit behind what is measured.
pub(crate) fn named(name: &str, of: &str) -> String {
    if factor(of) == 1.0 || name.contains(TIMES_100) {
        return name.to_owned();
    }
    let at = name.find([',', '@']).unwrap_or(name.len());
    let (what, rest) = name.split_at(at);
    format!("{what}{TIMES_100}{rest}")
}

/// A column as it is shown: of the same number, as many of whose digits.
pub(crate) fn column(metric: MetricOf) -> MetricOf {
    let of = metric.of.clone();
    let name =
        if metric.name.is_empty() && !of.starts_with(EVALUATION) { in_unit(&of).0 } else { named(metric.head(), &of) };
    let digits = metric.digits.saturating_sub(if factor(&of) == 1.0 { 0 } else { 2 });
    MetricOf { name, digits, ..metric }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_shown_times_a_hundred_by_whatever_name() {
        let of = |of: &str, name: &str| {
            let shown = column(MetricOf { name: name.into(), ..MetricOf::plain(of) });
            (shown.head().to_owned(), shown.digits, factor(of))
        };
        let path = "eval.json:report.rows[split=val,method=model].j2j";
        assert_eq!(of("eval/j2j_all@val", ""), ("eval/j2j_all × 100@val".into(), 2, 100.0));
        assert_eq!(of(path, "J2J, val"), ("J2J × 100, val".into(), 2, 100.0));
        assert_eq!(of(path, "J2J × 100, val").0, "J2J × 100, val");
        assert_eq!(of("eval/b2b@val", "B2B"), ("B2B × 100".into(), 2, 100.0));
        for other in ["eval/iou@val", "eval.json:j2j.rows[of=j2j].iou"] {
            assert_eq!(of(other, ""), (other.into(), 4, 1.0));
        }
    }
}
