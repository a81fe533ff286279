//! Unique names.

use std::collections::{HashMap, HashSet};

/// Hands out names that are not empty and not yet taken, as Blender does: `Bone`, `Bone.001`.
#[derive(Default)]
pub(crate) struct Names {
    taken: HashSet<String>,
    /// The last number tried after a name, so that a thousand equal names do not take a million tries.
    last: HashMap<String, usize>,
}

impl Names {
    /// `wanted`, or `fallback` where that is empty, with a number if it is taken. Line breaks and their
    /// like become `_`: names are a line each in many formats.
    pub(crate) fn unique(&mut self, wanted: &str, fallback: impl FnOnce() -> String) -> String {
        let base = if wanted.is_empty() { fallback() } else { wanted.replace(char::is_control, "_") };
        let mut name = base.clone();
        if self.taken.contains(&name) {
            let last = self.last.entry(base.clone()).or_insert(0);
            while self.taken.contains(&name) {
                *last += 1;
                name = format!("{base}.{last:03}");
            }
        }
        self.taken.insert(name.clone());
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_and_empty_names_get_a_number_or_the_fallback() {
        let mut names = Names::default();
        let given = ["a", "a", "", "a.001", "a", ""];
        let got: Vec<_> = given.iter().enumerate().map(|(i, n)| names.unique(n, || format!("joint_{i}"))).collect();
        assert_eq!(got, ["a", "a.001", "joint_2", "a.001.001", "a.002", "joint_5"]);
        assert_eq!(names.unique("two\nlines", String::new), "two_lines");
    }
}
