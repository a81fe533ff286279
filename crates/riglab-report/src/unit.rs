//! Units in which curves are shown beside tables.
//!
//! Logs have distances between skeletons as shares of the cube's edge; tables of tasks and of sweeps have them × 100. A page has one
//! of both: its curves are as its tables.

/// Names under which distances between skeletons are logged, possibly with words before or behind.
const DISTANCES: [&str; 3] = ["j2j", "j2b", "b2b"];

/// What stands behind the name of a value that is shown so.
pub const TIMES_100: &str = " × 100";

/// What a logged value is called in a page, and what it is multiplied by there.
pub fn in_unit(name: &str) -> (String, f64) {
    let (bare, split) = name.split_once('@').map_or((name, None), |(bare, split)| (bare, Some(split)));
    let last = bare.rsplit('/').next().unwrap_or(bare);
    if !last.split('_').any(|word| DISTANCES.contains(&word)) {
        return (name.to_owned(), 1.0);
    }
    (format!("{bare}{TIMES_100}{}", split.map_or(String::new(), |s| format!("@{s}"))), 100.0)
}

/// A logged value as a line says it: `j2j × 100@val 6.543`.
pub fn told(name: &str, value: f64) -> String {
    let (shown, factor) = in_unit(name);
    format!("{shown} {:.*}", if factor == 1.0 { 4 } else { 3 }, factor * value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_shown_times_a_hundred_and_nothing_else_is() {
        for (name, wanted) in [
            ("eval/j2j@val", "eval/j2j × 100@val"),
            ("eval/j2j_all@val", "eval/j2j_all × 100@val"),
            ("eval/start_j2j@j2b", "eval/start_j2j × 100@j2b"),
            ("b2b", "b2b × 100"),
        ] {
            assert_eq!(in_unit(name), (wanted.to_owned(), 100.0));
        }
        assert_eq!(told("j2j_all@val", 0.083_14), "j2j_all × 100@val 8.314");
        assert_eq!(told("iou_rule@val", 0.083_14), "iou_rule@val 0.0831");
        for name in ["eval/iou@j2j", "train/loss", "eval/j2jx@val", "j2j/loss", ""] {
            assert_eq!(in_unit(name), (name.to_owned(), 1.0));
        }
    }
}
