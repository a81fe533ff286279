//! What predictions and true assets are called when they are matched.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use riglab_asset::{Format, file_and_item};

/// What systems add to the name of what they were given.
const ADDED: [&str; 10] =
    ["_rig", "_skin", "_skel", "_skeleton", "_pred", "_predict", "_rigged", "_skinned", "_results", "_ori"];
/// What UniRig's two stages write beside what they were given.
pub(crate) const STAGES: [&str; 2] = ["predict_skeleton", "predict_skin"];
/// What else every asset of a set has in a folder of its own, whose name is the asset's.
const COMMON: &str = "raw_data";

/// What an asset is called: its path below the folder, without the file's ending; of one of several of a file, what it is
/// called there.
pub(crate) fn called(name: &str) -> String {
    let name = name.replace('\\', "/");
    match file_and_item(&name) {
        (_, "") => without_ending(&name),
        (_, item) => without_ending(item),
    }
}

/// The whole name of an asset, with its ending; of one of several of a file, what it is called there.
pub(crate) fn whole(name: &str) -> String {
    let name = name.replace('\\', "/");
    match file_and_item(&name) {
        (_, "") => name,
        (_, item) => item.to_owned(),
    }
}

/// The file that one of several assets is of; empty for others.
pub(crate) fn file_of(name: &str) -> String {
    let name = name.replace('\\', "/");
    match file_and_item(&name) {
        (_, "") => String::new(),
        (file, _) => file.to_owned(),
    }
}

/// What an asset is called, with the file that it is one of.
fn called_in_file(name: &str) -> String {
    match (file_of(name), called(name)) {
        (file, own) if file.is_empty() => own,
        (file, own) => format!("{file}#{own}"),
    }
}

/// The key of an asset: what it is called, without what systems add to names.
///
/// ```
/// use riglab_compare::key;
/// assert_eq!(key("cats/tom.v2.glb"), key("cats/tom.v2_rig.txt"));
/// assert_eq!(key("set.npz#tom"), "tom");
/// assert_eq!(key("cats/tom/predict_skin.npz"), "cats/tom");
/// ```
pub fn key(name: &str) -> String {
    shortest(&called(name))
}

/// What something is called, without what systems add.
pub(crate) fn shortest(called: &str) -> String {
    shortened(called).pop().unwrap_or_default()
}

/// A path or name without the ending of a file that may hold an asset.
pub(crate) fn without_ending(name: &str) -> String {
    let (folder, file) = name.rsplit_once('/').unwrap_or(("", name));
    let file = match file.rsplit_once('.') {
        Some((stem, ending)) if !stem.is_empty() && (is_format(file) || ending.eq_ignore_ascii_case("json")) => stem,
        _ => file,
    };
    match folder {
        "" => file.to_owned(),
        folder if file == COMMON || STAGES.contains(&file) => folder.to_owned(),
        folder => format!("{folder}/{file}"),
    }
}

/// What something is called, and that without what systems add, one after another.
pub(crate) fn shortened(called: &str) -> Vec<String> {
    let start = called.len() - own_name(called).len();
    let mut all = vec![called.to_owned()];
    let mut left = called;
    for added in ADDED {
        if let Some(rest) = left.strip_suffix(added).filter(|rest| rest.len() > start) {
            left = rest;
            all.push(left.to_owned());
        }
    }
    all
}

/// Assets of two sets that are the same, by the numbers of their names: those that are called alike, in files that are, too, then
/// in any, and of the others those with the same key. What several of a set are called tells none of them.
pub fn pairs(first: &[&str], second: &[&str]) -> Vec<(usize, usize)> {
    let mut partners: Vec<Option<usize>> = vec![None; first.len()];
    for name_of in [called_in_file, called, key] {
        let taken: BTreeSet<usize> = partners.iter().flatten().copied().collect();
        let own = only(first, name_of, |k| partners[k].is_some());
        let theirs = only(second, name_of, |k| taken.contains(&k));
        for (name, k) in own {
            if let (Some(k), Some(Some(other))) = (k, theirs.get(&name)) {
                partners[k] = Some(*other);
            }
        }
    }
    partners.iter().enumerate().filter_map(|(k, other)| Some((k, (*other)?))).collect()
}

/// Which of the names that are left means something; `None` for what several mean.
fn only(
    names: &[&str],
    name_of: fn(&str) -> String,
    is_taken: impl Fn(usize) -> bool,
) -> HashMap<String, Option<usize>> {
    let mut out = HashMap::new();
    for (k, name) in names.iter().enumerate().filter(|(k, _)| !is_taken(*k)) {
        out.entry(name_of(name)).and_modify(|other| *other = None).or_insert(Some(k));
    }
    out
}

/// Whether a file is called as what one of UniRig's stages writes.
pub(crate) fn is_stage(file: &Path) -> bool {
    let is_npz = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npz"));
    is_npz && file.file_stem().is_some_and(|stem| STAGES.iter().any(|stage| stem == *stage))
}

/// Whether a file is called like those of a format that is read.
fn is_format(file: &str) -> bool {
    Format::by_ending(Path::new(file)).is_some()
}

/// The last step of a key.
pub(crate) fn own_name(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or(key)
}

/// What assets are called, to tell which of them a prediction can mean.
#[derive(Debug, Default)]
pub(crate) struct Called {
    keys: BTreeSet<String>,
    /// How many keys end so.
    alone: BTreeMap<String, usize>,
    /// Without anything taken off.
    exactly: BTreeSet<String>,
    /// The last steps of these.
    exactly_alone: BTreeSet<String>,
    /// Whether a file that is given for the only asset is its own, whatever it is called.
    one_for_one: bool,
}

impl Called {
    pub(crate) fn of<'a>(assets: impl IntoIterator<Item = &'a str>) -> Self {
        let mut out = Self::default().beside(assets);
        out.keys.iter().for_each(|key| *out.alone.entry(own_name(key).to_owned()).or_default() += 1);
        out
    }

    /// With others, which have their own by their whole keys alone.
    pub(crate) fn beside<'a>(mut self, others: impl IntoIterator<Item = &'a str>) -> Self {
        for other in others {
            let called = called(other);
            self.keys.insert(key(other));
            self.exactly_alone.insert(own_name(&called).to_owned());
            self.exactly.insert(called);
        }
        self
    }

    /// Of all that is asked for: where that is one asset, a file given for it is its own, whatever the two are called.
    pub(crate) fn all(mut self) -> Self {
        self.one_for_one = self.exactly.len() == 1;
        self
    }

    /// Whether an asset is called exactly so.
    pub(crate) fn is_called(&self, name: &str) -> bool {
        self.exactly.contains(name)
    }

    pub(crate) fn one_for_one(&self) -> bool {
        self.one_for_one
    }

    /// Whether `theirs`, a key in another folder, can be that of the asset of this key: no other asset is called so in
    /// any folder, and none has that key.
    pub(crate) fn may_be(&self, key: &str, theirs: &str) -> bool {
        self.alone.get(own_name(key)).is_none_or(|&count| count < 2) && !self.keys.contains(theirs)
    }

    /// Whether a prediction called so is that of the asset called `asset`, of all that have its key: what is taken off its name
    /// first that leaves an asset's name leaves this one.
    pub(crate) fn is_of(&self, prediction: &str, asset: &str) -> bool {
        shortened(prediction).iter().find(|name| self.exactly.contains(*name)).is_none_or(|name| name == asset)
    }

    /// The same where both are in different folders.
    pub(crate) fn is_of_elsewhere(&self, prediction: &str, asset: &str) -> bool {
        let names = shortened(own_name(prediction));
        let meant = names.iter().find(|name| self.exactly_alone.contains(*name));
        meant.is_none_or(|name| name == own_name(asset))
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

    #[test]
    fn a_sign_in_a_path_names_no_asset_of_a_file() {
        for (name, wanted) in [
            ("Character #3.glb", "Character #3"),
            ("batch#2/tom.glb", "batch#2/tom"),
            ("batch#2/set.npz#tom#2", "tom#2"),
            ("set.npz#tom_rig.glb", "tom"),
            ("runs#1/v1.5", "runs#1/v1.5"),
        ] {
            assert_eq!(key(name), wanted);
        }
    }

    #[test]
    fn what_is_called_exactly_so_comes_before_what_is_taken_off() {
        let called = Called::of(["warrior.glb", "warrior_skeleton.glb", "x/fox.glb", "x/fox_skin.glb"]);
        for (prediction, asset) in [
            ("warrior", "warrior"),
            ("warrior_rig", "warrior"),
            ("warrior_skeleton", "warrior_skeleton"),
            ("warrior_skeleton_pred", "warrior_skeleton"),
        ] {
            for other in ["warrior", "warrior_skeleton"] {
                assert_eq!(called.is_of(prediction, other), asset == other, "{prediction} {other}");
            }
        }
        assert!(called.is_of_elsewhere("y/fox_skin", "x/fox_skin") && !called.is_of_elsewhere("y/fox_skin", "x/fox"));
        // What no asset is called may be any of its key.
        assert!(called.is_of("wolf", "wolf_rig"));
    }

    #[test]
    fn pairs_are_called_alike_or_have_one_key() {
        let both = ["warrior.glb", "warrior_skeleton.glb", "cat.glb", "dog.glb", "#1.glb"];
        let theirs = ["#1.fbx", "dog_a.glb", "cat_rig.txt", "warrior_skeleton.fbx", "warrior.fbx"];
        assert_eq!(pairs(&both, &theirs), [(0, 4), (1, 3), (2, 2), (4, 0)]);
        // Which of two is meant is not told.
        assert_eq!(pairs(&["a.glb"], &["a.glb", "a.fbx"]), []);
        assert_eq!(pairs(&["a.glb", "a.fbx"], &["a.glb"]), []);
        assert_eq!(pairs(&["a.glb"], &["a_rig.txt", "a_pred.txt"]), []);
        // Of files that hold some of one name.
        let both = ["a.npz#tom", "b.npz#tom"];
        assert_eq!(pairs(&both, &["b.npz#tom.glb", "a.npz#tom.glb"]), [(0, 1), (1, 0)]);
        assert_eq!(pairs(&both, &["tom.glb"]), []);
    }

    #[test]
    fn stages_are_called_exactly_so() {
        let of =
            ["x/predict_skin.npz", "predict_skeleton.NPZ", "predict_a.h5", "predict_skin.glb", "predict_skin_2.npz"];
        assert_eq!(of.map(|file| is_stage(Path::new(file))), [true, true, false, false, false]);
    }
}
