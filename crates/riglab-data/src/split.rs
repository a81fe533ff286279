//! Which asset belongs to which split.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use riglab_asset::file_and_item;
use riglab_core::Asset;
use riglab_random::{Draw, stream};

use crate::DataError;
use crate::copies::firsts;
use crate::words::{listed_name, nearest, some_of, without_mark};

/// The names of splits that evaluation knows: trained on, chosen by, tested on with skeletons of
/// known and of new topology.
pub struct SplitNames;

impl SplitNames {
    /// Trained on.
    pub const TRAIN: &str = "train";
    /// Checkpoints and decode rules are chosen on it.
    pub const VAL: &str = "val";
    /// Tested on; topologies that training has seen.
    pub const TEST_SEEN: &str = "test_seen";
    /// Tested on; topologies that training has not seen.
    pub const TEST_NEW: &str = "test_new";
    /// Meshes without rigs: for training that needs none.
    pub const MESHES: &str = "meshes";
    /// Assets that a split file does not name.
    pub const NONE: &str = "";
    /// Those that mean something.
    pub const KNOWN: [&str; 5] = [Self::TRAIN, Self::VAL, Self::TEST_SEEN, Self::TEST_NEW, Self::MESHES];
}

/// Gives assets their splits.
pub enum Splitter {
    /// By a file: names to splits, of assets or of files that hold several.
    Given(HashMap<String, String>),
    /// By topology and seed: about 10 % of topologies are new ones for testing; of the rest 8 % of
    /// assets validate, 8 % are tested as seen, the others train. Of those to be tested as seen the ones
    /// whose topology none trains are tested as new, unless that would be all.
    ByTopology(u64),
    /// All into one split, as a test set of one's own.
    All(String),
}

impl Splitter {
    /// Reads a split file: a JSON object of lists of file names.
    ///
    /// # Errors
    /// [`DataError::BadSplit`].
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let bad = |message: String| DataError::BadSplit { path: path.into(), message };
        let bytes = std::fs::read(path).map_err(|e| bad(e.to_string()))?;
        let lists: BTreeMap<String, Vec<String>> =
            serde_json::from_slice(without_mark(&bytes)).map_err(|e| bad(e.to_string()))?;
        let mut of = HashMap::new();
        for (split, names) in lists {
            for name in names {
                let name = listed_name(&name).to_owned();
                // Twice in one list is once too often, but no question.
                if let Some(other) = of.insert(name.clone(), split.clone()).filter(|other| *other != split) {
                    return Err(bad(format!("`{name}` is in `{other}` and in `{split}`")));
                }
            }
        }
        Ok(Self::Given(of))
    }

    /// The split of each asset.
    pub fn assign(&self, assets: &[(String, u64)]) -> Vec<String> {
        match self {
            Self::Given(of) => {
                let split = |name: &str| given(of, name).unwrap_or(SplitNames::NONE).to_owned();
                assets.iter().map(|(name, _)| split(name)).collect()
            }
            Self::ByTopology(seed) => by_topology(*seed, assets),
            Self::All(split) => vec![split.clone(); assets.len()],
        }
    }

    /// The split that a file gives to the asset of a name; `None` where there is no file, or it names neither the asset nor
    /// the file that the asset is of.
    pub fn given(&self, name: &str) -> Option<&str> {
        if let Self::Given(of) = self { given(of, name) } else { None }
    }

    /// As [`Self::assign`], with equal assets in one split where this makes the splits: of two files of one rig, one would be
    /// tested on what the other trained. Assets are equal where their `contents` are, such as their digests. Splits of assets
    /// that all differ are those of [`Self::assign`].
    pub fn assign_equal(&self, assets: &[(String, u64)], contents: &[impl AsRef<str>]) -> Vec<String> {
        if !matches!(self, Self::ByTopology(_)) {
            return self.assign(assets);
        }
        let firsts = firsts(contents);
        let own: Vec<usize> = (0..assets.len()).filter(|&k| firsts[k] == k).collect();
        let splits = self.assign(&own.iter().map(|&k| assets[k].clone()).collect::<Vec<_>>());
        let of: HashMap<usize, String> = own.into_iter().zip(splits).collect();
        firsts.iter().map(|first| of[first].clone()).collect()
    }

    /// Sentences on what looks mistaken in the splits of some assets: test splits that hold most of them or are not what
    /// they are called, names that a split file has and nothing `is_there` for, names of splits that are nearly one that
    /// evaluation knows.
    pub fn doubts(&self, assets: &[(String, u64)], splits: &[String], is_there: impl Fn(&str) -> bool) -> Vec<String> {
        match self {
            Self::ByTopology(_) => {
                let found = [mostly_tested(splits), none_seen(assets, splits), unvalidated(splits)];
                found.into_iter().flatten().collect()
            }
            Self::All(name) => {
                let near = nearest(name, &SplitNames::KNOWN);
                near.map(|near| format!("all are of the split `{name}`; did you mean `{near}`?")).into_iter().collect()
            }
            Self::Given(of) => {
                let mut told = Vec::new();
                for name in of.values().collect::<BTreeSet<_>>() {
                    if let Some(near) = nearest(name, &SplitNames::KNOWN) {
                        told.push(format!("the split file has a split `{name}`; did you mean `{near}`?"));
                    }
                }
                let gone: Vec<&str> = of.keys().map(String::as_str).filter(|name| !is_there(name)).collect();
                if !gone.is_empty() {
                    let names = some_of(gone);
                    told.push(format!(
                        "the split file names what is not there: {names}; names are paths below the folder"
                    ));
                }
                told
            }
        }
    }

    /// Name and topology of an asset, for [`Self::assign`].
    pub fn key(asset: &Asset) -> (String, u64) {
        (asset.name.clone(), asset.rig.skeleton().topology())
    }
}

/// What is said of an asset, or else of the file that it is of.
fn given<'a>(of: &'a HashMap<String, String>, name: &str) -> Option<&'a str> {
    of.get(name).or_else(|| of.get(file_and_item(name).0)).map(String::as_str)
}

fn by_topology(seed: u64, assets: &[(String, u64)]) -> Vec<String> {
    let topologies: BTreeSet<u64> = assets.iter().map(|(_, t)| *t).collect();
    let mut order: Vec<u64> = topologies.into_iter().collect();
    stream(seed, "split/topologies", &[]).shuffled(&mut order);
    // At least one new topology where there are two or more.
    let new = if order.len() < 2 { 0 } else { (order.len() / 10).max(1) };
    let new: BTreeSet<u64> = order[..new].iter().copied().collect();
    let mut rest: Vec<usize> = (0..assets.len()).filter(|&i| !new.contains(&assets[i].1)).collect();
    stream(seed, "split/assets", &[]).shuffled(&mut rest);
    let share = if rest.len() < 3 { 0 } else { (rest.len() * 8 / 100).max(1) };
    let mut splits = vec![SplitNames::TEST_NEW; assets.len()];
    for (k, &i) in rest.iter().enumerate() {
        splits[i] = match k {
            k if k < share => SplitNames::VAL,
            k if k < 2 * share => SplitNames::TEST_SEEN,
            _ => SplitNames::TRAIN,
        };
    }
    // Rare topologies may have fallen to validation and test alone: what trains and validates stays as it is, and so does a
    // test that would be left without any asset.
    let trained = topologies_of(assets, &splits, SplitNames::TRAIN);
    if !topologies_of(assets, &splits, SplitNames::TEST_SEEN).is_disjoint(&trained) {
        for (split, (_, topology)) in splits.iter_mut().zip(assets) {
            if *split == SplitNames::TEST_SEEN && !trained.contains(topology) {
                *split = SplitNames::TEST_NEW;
            }
        }
    }
    splits.into_iter().map(String::from).collect()
}

fn topologies_of(assets: &[(String, u64)], splits: &[impl AsRef<str>], split: &str) -> BTreeSet<u64> {
    assets.iter().zip(splits).filter(|(_, own)| own.as_ref() == split).map(|((_, topology), _)| *topology).collect()
}

/// Told where nothing that is tested as seen is.
fn none_seen(assets: &[(String, u64)], splits: &[String]) -> Option<String> {
    let [seen, trained] = [SplitNames::TEST_SEEN, SplitNames::TRAIN].map(|split| topologies_of(assets, splits, split));
    (!seen.is_empty() && seen.is_disjoint(&trained)).then(|| {
        "no asset of test_seen shares its tree of joints (or source) with a training asset, as hardly any occurs \
         twice: results on that split are for new ones, too"
            .into()
    })
}

/// Told where trees of joints are tested as new ones that training assets have, too.
pub(crate) fn new_trained(assets: &[(String, u64)], splits: &[String]) -> Option<String> {
    let trained = topologies_of(assets, splits, SplitNames::TRAIN);
    let new = assets.iter().zip(splits).filter(|(_, split)| *split == SplitNames::TEST_NEW);
    let (known, others): (Vec<_>, Vec<_>) = new.map(|(asset, _)| asset).partition(|(_, tree)| trained.contains(tree));
    (!known.is_empty()).then(|| {
        format!(
            "{} of {} assets of test_new have a tree of joints that training assets have: {}; their results are not for new \
             topologies. --seed splits all anew",
            known.len(),
            known.len() + others.len(),
            some_of(known.iter().map(|(name, _)| name.as_str()))
        )
    })
}

/// Told where there is nothing to validate on.
fn unvalidated(splits: &[String]) -> Option<String> {
    (!splits.is_empty() && splits.iter().all(|split| split != SplitNames::VAL)).then(|| {
        "too few kinds of skeletons for a split `val`, which training needs (data.validate); a split.json decides asset \
         by asset"
            .into()
    })
}

/// Told where test splits hold more than half of the assets.
fn mostly_tested(splits: &[String]) -> Option<String> {
    let count = |wanted: &str| splits.iter().filter(|split| *split == wanted).count();
    let [train, seen, new] = [SplitNames::TRAIN, SplitNames::TEST_SEEN, SplitNames::TEST_NEW].map(count);
    (2 * (seen + new) > splits.len()).then(|| {
        format!(
            "of {} assets {} are tested on (test_new {new}, test_seen {seen}) and {train} trained on: splits keep each \
             tree of joints (or source) whole, and a few of these hold most assets here; another seed may split them \
             better, and a split.json decides asset by asset",
            splits.len(),
            seen + new
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_topologies_are_never_trained_on() {
        let assets: Vec<(String, u64)> = (0..200u64).map(|i| (format!("{i}"), i % 17)).collect();
        let splits = Splitter::ByTopology(3).assign(&assets);
        let of =
            |name: &str| -> BTreeSet<u64> { (0..200).filter(|&i| splits[i] == name).map(|i| assets[i].1).collect() };
        assert!(of("test_new").is_disjoint(&of("train")));
        for name in ["train", "val", "test_seen", "test_new"] {
            assert!(!of(name).is_empty(), "{name}");
        }
        assert_eq!(splits, Splitter::ByTopology(3).assign(&assets));
    }

    #[test]
    fn equal_assets_are_of_one_split_and_change_no_other() {
        let assets: Vec<(String, u64)> = (0..60u64).map(|i| (format!("{i}"), i % 5)).collect();
        let contents: Vec<String> = (0..60).map(|i| format!("{i}")).collect();
        let own = Splitter::ByTopology(2);
        let alone = own.assign(&assets);
        assert_eq!(own.assign_equal(&assets, &contents), alone, "none is there twice");
        // Copies of all.
        let copies = assets.iter().map(|(name, kind)| (format!("copy of {name}"), *kind));
        let both: Vec<(String, u64)> = assets.iter().cloned().chain(copies).collect();
        let twice = [&contents[..], &contents].concat();
        let splits = own.assign_equal(&both, &twice);
        assert_eq!((&splits[..60], &splits[60..]), (&alone[..], &alone[..]));
        assert_ne!(own.assign(&both)[60..], alone, "by chance they would be apart");
        // A person's own split stays.
        let given = Splitter::Given([("0".to_owned(), "val".to_owned())].into());
        assert_eq!(given.assign_equal(&both[..2], &["x", "x"]), ["val", ""]);
    }

    #[test]
    fn what_is_tested_as_seen_is_trained_on() {
        // Most trees are there once or twice.
        let assets: Vec<(String, u64)> =
            (0..300u64).map(|i| (format!("{i}"), if i < 60 { 7 } else { i / 2 })).collect();
        for seed in 0..5 {
            let splits = Splitter::ByTopology(seed).assign(&assets);
            let of = |name: &str| -> BTreeSet<u64> {
                (0..300).filter(|&i| splits[i] == name).map(|i| assets[i].1).collect()
            };
            assert!(of("test_seen").is_subset(&of("train")) && of("test_new").is_disjoint(&of("train")));
            let count = |name: &str| splits.iter().filter(|s| *s == name).count();
            // As many validate as were drawn for the other test: some of these are new.
            assert!(count("test_seen") > 0 && count("test_seen") < count("val"));
        }
    }

    #[test]
    fn a_test_of_seen_trees_without_any_is_told() {
        let splits_of = |kinds: u64| {
            let assets: Vec<(String, u64)> = (0..20u64).map(|i| (format!("{i}"), i % kinds)).collect();
            let splits = Splitter::ByTopology(0).assign(&assets);
            assert!(splits.iter().any(|split| split == "test_seen"), "it is not left empty");
            Splitter::ByTopology(0).doubts(&assets, &splits, |_| true)
        };
        assert!(splits_of(3).is_empty());
        let told = splits_of(20);
        assert!(told.len() == 1 && told[0].contains("no asset of test_seen"), "{told:?}");
    }

    #[test]
    fn assets_without_any_to_validate_on_are_told() {
        let told = |splits: &[&str]| {
            let splits: Vec<String> = splits.iter().map(|split| (*split).to_owned()).collect();
            Splitter::ByTopology(0).doubts(&[], &splits, |_| true)
        };
        assert!(told(&[]).is_empty() && told(&["train", "val"]).is_empty());
        let told = told(&["train", "train"]);
        assert!(told.len() == 1 && told[0].contains("for a split `val`"), "{told:?}");
    }

    #[test]
    fn a_split_that_mostly_tests_is_told() {
        let splits = |test: usize| -> Vec<String> {
            let of = |i: usize| if i < test { "test_new" } else { ["train", "val"][usize::from(i == 9)] };
            (0..10).map(|i| of(i).to_owned()).collect()
        };
        let own = Splitter::ByTopology(0);
        assert!(own.doubts(&[], &splits(5), |_| true).is_empty());
        let told = own.doubts(&[], &splits(9), |_| true);
        assert!(
            told.len() == 1 && told[0].contains("of 10 assets 9 are tested on (test_new 9, test_seen 0)"),
            "{told:?}"
        );
        // A person's own split is as the person wants it.
        assert!(Splitter::Given(HashMap::new()).doubts(&[], &splits(9), |_| true).is_empty());
    }

    #[test]
    fn typing_errors_of_split_files_are_told() {
        let of = [("a.glb", "trian"), ("b.glb", "mine"), ("c.glb", "train"), ("gone.glb", "val")];
        let given = Splitter::Given(of.iter().map(|(a, s)| ((*a).to_owned(), (*s).to_owned())).collect());
        let told = given.doubts(&[], &[], |name| name != "gone.glb");
        assert!(told.len() == 2 && told[0].contains("`trian`; did you mean `train`"), "{told:?}");
        assert!(told[1].contains("`gone.glb`") && !told[1].contains("a.glb"), "{told:?}");
    }

    #[test]
    fn what_is_said_of_a_file_is_said_of_its_assets() {
        let of = [("set.npz", "train"), ("set.npz#b", "val")].map(|(name, split)| (name.to_owned(), split.to_owned()));
        let given = Splitter::Given(of.into());
        let assets = ["set.npz#a", "set.npz#b", "other.npz#a"].map(|name| (name.to_owned(), 0));
        assert_eq!(given.assign(&assets), ["train", "val", ""]);
        assert_eq!((given.given("set.npz#a"), given.given("other.npz#a")), (Some("train"), None));
    }

    #[test]
    fn all_may_be_of_one_split() {
        let assets: Vec<(String, u64)> = (0..4u64).map(|i| (format!("{i}"), i)).collect();
        let all = Splitter::All("test_new".into());
        assert_eq!(all.assign(&assets), ["test_new"; 4]);
        assert!(all.doubts(&assets, &all.assign(&assets), |_| true).is_empty());
        let told = Splitter::All("tets_new".into()).doubts(&[], &[], |_| true);
        assert!(told.len() == 1 && told[0].contains("did you mean `test_new`"), "{told:?}");
    }

    #[test]
    fn few_assets_still_train() {
        for n in 1..6u64 {
            let assets: Vec<(String, u64)> = (0..n).map(|i| (format!("{i}"), 5)).collect();
            assert!(Splitter::ByTopology(1).assign(&assets).contains(&"train".to_string()));
        }
    }

    #[test]
    fn split_files_are_checked() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("split.json");
        std::fs::write(&path, r#"{"train": ["a"], "val": ["a"]}"#).unwrap();
        assert!(Splitter::read(&path).err().unwrap().to_string().contains("`a` is in"));
        std::fs::write(&path, "[]").unwrap();
        assert!(Splitter::read(&path).is_err());
        // As some editors write it: with a byte order mark, and a name twice.
        std::fs::write(&path, "\u{feff}{\"train\": [\"a\", \"./a\"], \"val\": [\"b\"]}").unwrap();
        let all = [("a".to_string(), 0), ("b".to_string(), 0), ("c".to_string(), 0)];
        assert_eq!(Splitter::read(&path).unwrap().assign(&all), ["train", "val", ""]);
    }
}
