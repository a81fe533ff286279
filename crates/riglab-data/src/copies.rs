//! Assets that are there twice, under two names.

use std::collections::HashMap;

/// Of each asset the first that is equal to it: itself, where none before it is. `contents` are equal where assets are, as
/// their digests.
pub(crate) fn firsts(contents: &[impl AsRef<str>]) -> Vec<usize> {
    let mut seen: HashMap<&str, usize> = HashMap::new();
    contents.iter().enumerate().map(|(k, content)| *seen.entry(content.as_ref()).or_insert(k)).collect()
}

/// A sentence on assets that are equal to others: those in another split than the other, which may be tested on though they
/// were trained on, or else all of them. What is in no split is neither.
pub fn told(names: &[&str], contents: &[impl AsRef<str>], splits: &[String]) -> Option<String> {
    let copies: Vec<(usize, usize)> =
        firsts(contents).into_iter().enumerate().filter(|(k, first)| k != first).collect();
    let differ = |a: &String, b: &String| a != b && !a.is_empty() && !b.is_empty();
    let apart: Vec<(usize, usize)> =
        copies.iter().copied().filter(|(k, first)| differ(&splits[*k], &splits[*first])).collect();
    let counted = |n: usize| if n == 1 { "1 asset is".to_owned() } else { format!("{n} assets are") };
    match (apart.first(), copies.first()) {
        (Some(&(k, first)), _) => Some(format!(
            "{} equal to one of another split, as `{}` of {} to `{}` of {}: a test on what was trained on says nothing of new \
             assets; put equal ones into one split",
            counted(apart.len()),
            names[k],
            splits[k],
            names[first],
            splits[first]
        )),
        (None, Some(&(k, first))) => Some(format!(
            "{} equal to another, as `{}` to `{}`, and count twice; `riglab dataset merge CORPUS -o \
             ONCE.h5` writes each once",
            counted(copies.len()),
            names[k],
            names[first]
        )),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_copy_knows_the_first() {
        assert_eq!(firsts(&["x", "y", "x", "z", "y", "x"]), [0, 1, 0, 3, 1, 0]);
    }

    #[test]
    fn copies_are_told_with_what_to_do() {
        let of = |contents: &[&str], splits: &[&str]| {
            let splits: Vec<String> = splits.iter().map(|s| (*s).to_owned()).collect();
            told(&["a.glb", "b.glb", "c.glb"][..contents.len()], contents, &splits)
        };
        assert_eq!(of(&["x", "y", "z"], &["train", "val", "train"]), None);
        let together = of(&["x", "y", "x"], &["train", "val", "train"]).unwrap();
        assert!(together.starts_with("1 asset is equal to another, as `c.glb` to `a.glb`"), "{together}");
        assert!(together.contains("riglab dataset merge"), "{together}");
        let none = of(&["x", "x"], &["train", ""]).unwrap();
        assert!(none.starts_with("1 asset is equal to another"), "what is in no split is not tested on: {none}");
        let apart = of(&["x", "x", "x"], &["train", "train", "val"]).unwrap();
        let start = "1 asset is equal to one of another split, as `c.glb` of val to `a.glb` of train";
        assert!(apart.starts_with(start) && apart.ends_with("put equal ones into one split"), "{apart}");
    }
}
