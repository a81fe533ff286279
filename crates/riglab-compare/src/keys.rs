//! What predictions and true assets are called when they are matched.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use riglab_asset::Format;

/// What systems add to the name of what they were given.
const ADDED: [&str; 10] =
    ["_rig", "_skin", "_skel", "_skeleton", "_pred", "_predict", "_rigged", "_skinned", "_results", "_ori"];
/// Names that every asset of a set has: the folder is the asset's name.
const COMMON: [&str; 3] = ["raw_data", "predict_skeleton", "predict_skin"];

/// The key of an asset: its path below the folder, without the file's ending and what systems add to names; for
/// an asset of a file of several, what stands behind the `#`.
///
/// ```
/// use riglab_compare::key;
/// assert_eq!(key("cats/tom.v2.glb"), key("cats/tom.v2_rig.txt"));
/// assert_eq!(key("set.npz#tom"), "tom");
/// assert_eq!(key("cats/tom/predict_skin.npz"), "cats/tom");
/// ```
pub fn key(name: &str) -> String {
    if let Some((_, own)) = name.rsplit_once('#').filter(|(_, own)| !own.is_empty()) {
        return own.to_owned();
    }
    let name = name.replace('\\', "/");
    let (folder, file) = name.rsplit_once('/').unwrap_or(("", &name));
    let mut file = match file.rsplit_once('.') {
        Some((stem, ending)) if !stem.is_empty() && (is_format(file) || ending.eq_ignore_ascii_case("json")) => stem,
        _ => file,
    };
    if COMMON.contains(&file) && !folder.is_empty() {
        return folder.to_owned();
    }
    for added in ADDED {
        file = file.strip_suffix(added).filter(|rest| !rest.is_empty()).unwrap_or(file);
    }
    if folder.is_empty() { file.to_owned() } else { format!("{folder}/{file}") }
}

/// Whether a file is called like those of a format that is read.
fn is_format(file: &str) -> bool {
    Format::by_ending(Path::new(file)).is_some()
}

/// The last step of a key.
pub(crate) fn own_name(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or(key)
}

/// What assets are called, to tell whether a name without its folders can only mean one of them.
#[derive(Debug, Default)]
pub(crate) struct Called {
    whole: BTreeSet<String>,
    /// How many are called so in some folder.
    alone: BTreeMap<String, usize>,
}

impl Called {
    pub(crate) fn of<'a>(assets: impl IntoIterator<Item = &'a str>) -> Self {
        let whole: BTreeSet<String> = assets.into_iter().map(key).collect();
        let mut alone = BTreeMap::new();
        whole.iter().for_each(|key| *alone.entry(own_name(key).to_owned()).or_default() += 1);
        Self { whole, alone }
    }

    /// With others, which have their own by their whole keys alone.
    pub(crate) fn beside<'a>(mut self, others: impl IntoIterator<Item = &'a str>) -> Self {
        self.whole.extend(others.into_iter().map(key));
        self
    }

    /// Whether `theirs`, a key in another folder, can be that of the asset of this key: no other asset is called so in
    /// any folder, and none has that key.
    pub(crate) fn may_be(&self, key: &str, theirs: &str) -> bool {
        self.alone.get(own_name(key)).is_none_or(|&count| count < 2) && !self.whole.contains(theirs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bare_name_is_that_of_one_asset_only() {
        let called = Called::of(["x/a.glb", "y/a.glb", "x/b.glb", "x/b.fbx", "c.glb"]).beside(["z/c.glb", "z/b.glb"]);
        // Two are called a; b is one asset in two files; another asset's prediction is not taken.
        assert!(!called.may_be("x/a", "a") && called.may_be("x/b", "b") && called.may_be("x/b", "w/b"));
        assert!(called.may_be("c", "w/c") && !called.may_be("c", "z/c") && !called.may_be("x/b", "z/b"));
        // Names of what a file of several holds are not known before.
        assert!(called.may_be("unknown", "w/unknown"));
    }

    #[test]
    fn what_systems_add_is_taken_off() {
        assert_eq!(key("a/b_skin.txt"), "a/b");
        assert_eq!(key("b_pred_skeleton.txt"), "b");
        assert_eq!(key("a\\b.FBX"), "a/b");
        // Nothing is taken off that would leave nothing.
        assert_eq!((key("_rig.txt"), key("raw_data.npz")), ("_rig".into(), "raw_data".into()));
        assert_eq!((key("v1.5"), key("set.npz#")), ("v1.5".into(), "set.npz#".into()));
        assert_eq!(own_name("a/b"), "b");
    }
}
