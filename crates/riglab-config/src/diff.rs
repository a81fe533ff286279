//! What two configurations differ in.

use std::collections::BTreeMap;

use crate::Config;

/// A value that is not the same in two configurations.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Path of keys, such as `model.width`.
    pub path: String,
    /// The value in the first, as TOML; `None` if not set there.
    pub before: Option<String>,
    /// The value in the second.
    pub after: Option<String>,
}

impl Config {
    /// The values that differ in `other`, in the order of paths: what a run of a sweep is about.
    pub fn diff(&self, other: &Self) -> Vec<Difference> {
        let values = |c: &Self| c.leaves().into_iter().map(|l| (l.path, l.value)).collect::<BTreeMap<_, _>>();
        let (mut before, mut after) = (values(self), values(other));
        let paths: std::collections::BTreeSet<String> = before.keys().chain(after.keys()).cloned().collect();
        paths
            .into_iter()
            .map(|path| Difference { before: before.remove(&path), after: after.remove(&path), path })
            .filter(|d| d.before != d.after)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differing_values_are_listed_by_path() {
        let a = Config::from_toml_str("a", "x = 1\n[m]\nw = 2\nh = [1, 2]").unwrap();
        let b = Config::from_toml_str("b", "x = 1\n[m]\nw = 3.0\nd = true\nh = [1, 2]").unwrap();
        let difference = |path: &str, before: Option<&str>, after: Option<&str>| Difference {
            path: path.into(),
            before: before.map(Into::into),
            after: after.map(Into::into),
        };
        assert_eq!(a.diff(&b), [difference("m.d", None, Some("true")), difference("m.w", Some("2"), Some("3.0"))]);
        assert!(a.diff(&a).is_empty());
    }
}
