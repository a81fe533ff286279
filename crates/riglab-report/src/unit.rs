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
        for name in ["eval/iou@j2j", "train/loss", "eval/j2jx@val", "j2j/loss", ""] {
            assert_eq!(in_unit(name), (name.to_owned(), 1.0));
        }
    }
}
