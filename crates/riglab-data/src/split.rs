//! Which asset belongs to which split.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use riglab_core::Asset;
use riglab_random::{Draw, stream};

use crate::DataError;

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
}

/// Gives assets their splits.
pub enum Splitter {
    /// By a file: names to splits.
    Given(HashMap<String, String>),
    /// By topology and seed: about 10 % of topologies are new ones for testing; of the rest 8 % of
    /// assets are tested as seen, 8 % validate, the others train.
    ByTopology(u64),
}

impl Splitter {
    /// Reads a split file: a JSON object of lists of file names.
    ///
    /// # Errors
    /// [`DataError::BadSplit`].
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let bad = |message: String| DataError::BadSplit { path: path.into(), message };
        let text = std::fs::read_to_string(path).map_err(|e| bad(e.to_string()))?;
        let lists: BTreeMap<String, Vec<String>> = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
        let mut of = HashMap::new();
        for (split, names) in lists {
            for name in names {
                if let Some(other) = of.insert(name.clone(), split.clone()) {
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
                let split = |name: &String| of.get(name).cloned().unwrap_or_else(|| SplitNames::NONE.into());
                assets.iter().map(|(name, _)| split(name)).collect()
            }
            Self::ByTopology(seed) => by_topology(*seed, assets),
        }
    }

    /// Name and topology of an asset, for [`Self::assign`].
    pub fn key(asset: &Asset) -> (String, u64) {
        (asset.name.clone(), asset.rig.skeleton().topology())
    }
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
    splits.into_iter().map(String::from).collect()
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
        std::fs::write(&path, r#"{"train": ["a"], "val": ["b"]}"#).unwrap();
        let all = [("a".to_string(), 0), ("b".to_string(), 0), ("c".to_string(), 0)];
        assert_eq!(Splitter::read(&path).unwrap().assign(&all), ["train", "val", ""]);
    }
}
