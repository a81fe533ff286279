//! Assets of one or several corpora, read when they are needed and kept up to a limit.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};

use riglab_core::Asset;
use riglab_data::{Corpus, DataError, SplitNames};
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};

use crate::settings::distinct;
pub use crate::up::Up;

/// Which corpora a task reads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DataConfig {
    /// Corpus files, as `riglab dataset import` writes them.
    pub corpora: Vec<PathBuf>,
    /// How much of the training comes from each corpus, one weight each; also of the validation assets, where only
    /// some of them are used. Empty: by the corpora's sizes.
    pub weights: Vec<f32>,
    /// Splits that are trained on.
    pub train: Vec<String>,
    /// The split that checkpoints and decode rules are chosen by.
    pub validate: String,
    /// Splits that `riglab eval` reports.
    pub test: Vec<String>,
    /// Assets with more joints are left out of training (not of evaluation).
    pub max_joints: usize,
    /// Memory for prepared assets, in MB: for all kinds of what a task prepares together.
    pub cache_mb: usize,
    /// The axis that points up in what the network sees: models that others trained in Blender's axes have `z`.
    pub up: Up,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            corpora: Vec::new(),
            weights: Vec::new(),
            train: vec![SplitNames::TRAIN.into()],
            validate: SplitNames::VAL.into(),
            test: vec![SplitNames::TEST_SEEN.into(), SplitNames::TEST_NEW.into()],
            max_joints: 1024,
            cache_mb: 4096,
            up: Up::default(),
        }
    }
}

/// An asset in all of a task's corpora.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct AssetId {
    corpus: usize,
    index: usize,
}

impl AssetId {
    /// A number for streams of random numbers.
    pub fn key(self) -> u64 {
        (self.corpus as u64) << 40 | self.index as u64
    }
}

impl DataConfig {
    /// Checks that corpora have a name, and that no split is named twice.
    ///
    /// # Errors
    /// (key path, message) of the first fault.
    pub(crate) fn validate(&self) -> Result<(), (String, String)> {
        if self.corpora.iter().any(|path| path.as_os_str().is_empty()) {
            return Err(("data.corpora".into(), "an empty name is no file: give a corpus or leave it out".into()));
        }
        distinct("data.train", &self.train)?;
        distinct("data.test", &self.test)
    }

    /// Whether an asset is of a corpus that is trained on: one whose weight is 0 is not.
    pub(crate) fn trains_on(&self, id: AssetId) -> bool {
        self.weights.get(id.corpus).is_none_or(|weight| *weight > 0.0)
    }

    /// Refuses to choose among several cuts of a decode rule by no asset.
    ///
    /// # Errors
    /// A sentence.
    pub(crate) fn can_choose(&self, cuts: &[f32], by: &[AssetId]) -> Result<(), String> {
        if cuts.len() == 1 || !by.is_empty() {
            return Ok(());
        }
        Err(format!(
            "data.validate: the corpora have no asset in `{}` by which to choose one of eval.cuts. First evaluate this \
             checkpoint on the run's own corpora (`riglab eval RUN/checkpoints/NAME`), whose cut is then used, or give one: \
             --set eval.cuts='[0.1]'",
            self.validate
        ))
    }

    /// Of the assets of a split so many, 0 for all, the same ones each time: of all corpora, as many of each as their weights
    /// say while there are any, so that a few files are not lost among thousands of generated ones.
    pub(crate) fn some_of(&self, all: &[AssetId], most: usize, seed: u64) -> Vec<AssetId> {
        let mut ids = all.to_vec();
        stream(seed, "validation assets", &[]).shuffled(&mut ids);
        if most == 0 || most >= ids.len() {
            return ids;
        }
        if !self.weights.is_empty() {
            // The sooner each comes, the fewer of its corpus stand before it for that one's weight.
            let mut taken = vec![0.0; self.weights.len()];
            let mut along = |id: &AssetId| {
                taken[id.corpus] += 1.0;
                taken[id.corpus] / self.weights[id.corpus]
            };
            let mut order: Vec<(f32, AssetId)> = ids.iter().map(|id| (along(id), *id)).collect();
            order.sort_by(|(a, _), (b, _)| a.total_cmp(b));
            ids = order.into_iter().map(|(_, id)| id).collect();
        }
        ids.truncate(most);
        ids
    }
}

/// Open corpora.
pub struct Assets {
    corpora: Vec<Corpus>,
    up: Up,
    /// Of each corpus, once it was asked for.
    categories: Vec<OnceLock<Vec<String>>>,
}

impl Assets {
    /// Opens corpora.
    ///
    /// # Errors
    /// As [`Corpus::open`].
    pub fn open(paths: &[PathBuf]) -> Result<Self, DataError> {
        let corpora = paths.iter().map(|p| Corpus::open(p)).collect::<Result<Vec<_>, _>>()?;
        let categories = corpora.iter().map(|_| OnceLock::new()).collect();
        Ok(Self { corpora, up: Up::default(), categories })
    }

    /// Opens the corpora of a config; gives them with the assets trained on and those validated on. Either may be empty:
    /// test assets alone can be evaluated ([`Self::trainable`] says what a training needs).
    ///
    /// # Errors
    /// A sentence: no corpus, one that cannot be read, two of the same assets, or weights that do not fit.
    #[allow(clippy::type_complexity)] // two lists, each named where it goes
    pub fn of(config: &DataConfig) -> Result<(Self, Vec<(f32, Vec<AssetId>)>, Vec<AssetId>), String> {
        if config.corpora.is_empty() {
            return Err("data.corpora names no corpus; give one with --set data.corpora='[\"corpus.h5\"]' (`riglab dataset import` makes it)".into());
        }
        let assets = Self { up: config.up, ..Self::open(&config.corpora).map_err(|e| e.to_string())? };
        let sums = assets.summary().map_err(|e| e.to_string())?;
        for (at, (path, sum, _)) in sums.iter().enumerate() {
            // Its assets would count twice in every table and test.
            if let Some((other, ..)) = sums[..at].iter().find(|(_, before, _)| before == sum) {
                return Err(format!(
                    "data.corpora: {other} and {path} hold the same assets; name only one of them (data.weights sets \
                     how often a corpus is sampled)"
                ));
            }
        }
        let training = assets.training(config)?;
        let validation = assets.split(&config.validate).map_err(|e| e.to_string())?;
        Ok((assets, training, validation))
    }

    /// Of corpora that hold bare meshes, a sentence that says how to train on those; none of others.
    fn on_meshes(&self) -> String {
        let mut bare = self.corpora.iter().filter(|corpus| corpus.bare().is_ok_and(|bare| !bare.is_empty()));
        bare.next().map_or_else(String::new, |corpus| {
            format!(
                ". {} holds bare meshes; task = \"grpo\", which needs no rigs, is trained on them with --set \
                 data.train='[\"{split}\"]' --set data.validate='\"{split}\"' --set data.test='[\"{split}\"]'",
                display(corpus.path()),
                split = SplitNames::MESHES
            )
        })
    }

    /// Checks that there is something to train on, and something to validate on.
    ///
    /// # Errors
    /// A sentence: a split without assets, or a column that cannot be read.
    pub fn trainable(&self, config: &DataConfig) -> Result<(), String> {
        if self.training(config)?.iter().all(|(_, ids)| ids.is_empty()) {
            let (splits, most) = (config.train.join(", "), config.max_joints);
            let meshes = self.on_meshes();
            let there = self.splits().map_err(|e| e.to_string())?;
            if splits.is_empty() {
                return Err(format!(
                    "data.train names no split to train on; {there}, and --set data.train='[\"SPLIT\"]' names one"
                ));
            }
            return Err(format!(
                "data.train: the corpora have no asset in `{splits}` of at most data.max_joints = {most}; {there}, and --set \
                 data.train='[\"SPLIT\"]' names another{meshes}"
            ));
        }
        if self.split(&config.validate).map_err(|e| e.to_string())?.is_empty() {
            return Err(format!(
                "data.validate: the corpora have no asset in `{}`, as small ones may; {}, and --set data.validate=SPLIT \
                 names another{}",
                config.validate,
                self.splits().map_err(|e| e.to_string())?,
                self.on_meshes()
            ));
        }
        Ok(())
    }

    /// Refuses bare meshes among the assets that a config names, for tasks that learn from rigs: such a mesh has one joint
    /// in its middle, which is no rig to learn or to be measured by.
    ///
    /// # Errors
    /// A sentence with the corpus, or that a column cannot be read.
    pub fn rigged(&self, config: &DataConfig) -> Result<(), String> {
        let named: Vec<&String> = config.train.iter().chain([&config.validate]).chain(&config.test).collect();
        for corpus in &self.corpora {
            let bare = corpus.bare().map_err(|e| e.to_string())?;
            if bare.is_empty() {
                continue;
            }
            let splits = corpus.texts("split").map_err(|e| e.to_string())?;
            let used = bare.iter().filter(|&&index| named.contains(&&splits[index]));
            let (count, Some(&first)) = (used.clone().count(), used.clone().next()) else { continue };
            return Err(format!(
                "{}: {count} of its {} assets are bare meshes (as of `riglab dataset import --meshes`) in splits that are \
                 used here, the first in `{}`: they have no rigs to learn from or to be measured by. Leave the corpus out \
                 of data.corpora, or name other splits in data.train, data.validate and data.test; task = \"grpo\" trains \
                 on meshes alone",
                display(corpus.path()),
                corpus.len(),
                splits[first]
            ));
        }
        Ok(())
    }

    /// The corpora: path, checksum, number of assets.
    ///
    /// # Errors
    /// When a column cannot be read.
    pub fn summary(&self) -> Result<Vec<(String, String, usize)>, DataError> {
        let each = |c: &Corpus| Ok((display(c.path()), c.checksum()?, c.len()));
        self.corpora.iter().map(each).collect()
    }

    /// How many assets of each corpus are of one of some splits.
    ///
    /// # Errors
    /// When a column cannot be read.
    pub fn in_splits(&self, splits: &[&str]) -> Result<Vec<usize>, DataError> {
        let count = |c: &Corpus| Ok(c.texts("split")?.iter().filter(|own| splits.contains(&own.as_str())).count());
        self.corpora.iter().map(count).collect()
    }

    /// The splits that the corpora have, with the assets of each, as a clause of a sentence.
    ///
    /// # Errors
    /// When a column cannot be read.
    pub fn splits(&self) -> Result<String, DataError> {
        let mut counts = BTreeMap::<String, usize>::new();
        for corpus in &self.corpora {
            corpus.texts("split")?.into_iter().for_each(|split| *counts.entry(split).or_default() += 1);
        }
        let name = |split: &str| if split.is_empty() { "no split".to_owned() } else { format!("`{split}`") };
        let all: Vec<String> = counts.iter().map(|(split, count)| format!("{} ({count})", name(split))).collect();
        Ok(format!("their splits are {}", all.join(", ")))
    }

    /// The assets of a split, over all corpora.
    ///
    /// # Errors
    /// When a column cannot be read.
    pub fn split(&self, split: &str) -> Result<Vec<AssetId>, DataError> {
        let mut ids = Vec::new();
        for (corpus, c) in self.corpora.iter().enumerate() {
            ids.extend(c.split(split)?.into_iter().map(|index| AssetId { corpus, index }));
        }
        Ok(ids)
    }

    /// The assets of the splits trained on, apart by corpus where the corpora have weights.
    ///
    /// # Errors
    /// A sentence: weights that do not fit the corpora, or a column that cannot be read.
    pub fn training(&self, config: &DataConfig) -> Result<Vec<(f32, Vec<AssetId>)>, String> {
        let (weights, corpora) = (&config.weights, self.corpora.len());
        if !weights.is_empty() && weights.len() != corpora {
            return Err(format!("data.weights has {} numbers for {corpora} corpora", weights.len()));
        }
        if weights.iter().any(|w| !(w.is_finite() && *w >= 0.0))
            || !weights.is_empty() && weights.iter().all(|w| *w == 0.0)
        {
            return Err("data.weights must not be negative, and at least one must be above 0".into());
        }
        let mut ids = Vec::new();
        for split in &config.train {
            let of = self.split(split).map_err(|e| e.to_string())?;
            ids.extend(of.into_iter().filter(|&id| self.counts(id)[2] <= config.max_joints));
        }
        if weights.is_empty() {
            return Ok(vec![(1.0, ids)]);
        }
        if ids.is_empty() {
            return Ok(vec![(1.0, ids)]);
        }
        let of = |corpus: usize| ids.iter().copied().filter(|id| id.corpus == corpus).collect();
        let parts: Vec<(f32, Vec<AssetId>)> = weights.iter().enumerate().map(|(k, &weight)| (weight, of(k))).collect();
        match parts.iter().position(|(weight, of)| *weight > 0.0 && of.is_empty()) {
            Some(k) => Err(format!(
                "{}: has a weight (data.weights) but no asset in data.train; `riglab dataset inspect` shows its splits",
                config.corpora[k].display()
            )),
            // What has no weight is not trained on, nor compared with.
            None => Ok(parts.into_iter().filter(|(weight, _)| *weight > 0.0).collect()),
        }
    }

    /// An asset's name, without reading it.
    ///
    /// # Errors
    /// When the column cannot be read.
    pub fn name(&self, id: AssetId) -> Result<String, DataError> {
        Ok(self.corpora[id.corpus].names()?[id.index].clone())
    }

    /// An asset's category, without reading it; empty where it has none.
    ///
    /// # Errors
    /// When the column cannot be read.
    pub fn category(&self, id: AssetId) -> Result<String, String> {
        let held = &self.categories[id.corpus];
        let all = match held.get() {
            Some(all) => all,
            None => {
                let read = self.corpora[id.corpus].texts("category").map_err(|e| e.to_string())?;
                held.get_or_init(|| read)
            }
        };
        Ok(all.get(id.index).cloned().unwrap_or_default())
    }

    /// Of assets, the name and what tells an asset from others in any corpus: checksum of its file and digest of its numbers,
    /// those that it has.
    ///
    /// # Errors
    /// When a column cannot be read.
    pub fn marks(&self, ids: &[AssetId]) -> Result<Vec<(String, Vec<String>)>, DataError> {
        let columns = |c: &Corpus| Ok([c.texts("name")?, c.texts("checksum")?, c.texts("digest")?]);
        let all = self.corpora.iter().map(columns).collect::<Result<Vec<_>, DataError>>()?;
        let of = |id: &AssetId| {
            let [name, marks @ ..] = all[id.corpus].each_ref().map(|column| column[id.index].clone());
            (name, marks.into_iter().filter(|mark| !mark.is_empty()).collect())
        };
        Ok(ids.iter().map(of).collect())
    }

    /// Whether any of some assets has spring bones.
    ///
    /// # Errors
    /// When the column cannot be read.
    pub fn any_springs(&self, ids: impl IntoIterator<Item = AssetId>) -> Result<bool, DataError> {
        let all = self.corpora.iter().map(|corpus| corpus.texts("springs")).collect::<Result<Vec<_>, _>>()?;
        Ok(ids.into_iter().any(|id| !all[id.corpus][id.index].is_empty()))
    }

    /// Vertices, triangles, joints, non-zero weights, without reading the asset.
    pub fn counts(&self, id: AssetId) -> [usize; 4] {
        self.corpora[id.corpus].counts(id.index)
    }

    /// Reads one, as [`DataConfig::up`] has it.
    ///
    /// # Errors
    /// When it is damaged.
    pub fn read(&self, id: AssetId) -> Result<Asset, DataError> {
        let mut asset = self.corpora[id.corpus].asset(id.index)?;
        // A rig that is turned stays a rig: no number becomes another.
        if let (Up::Z, Ok(turned)) = (self.up, self.up.rig(&asset.rig)) {
            asset.rig = turned;
            asset.clips = asset.clips.iter().filter_map(|clip| self.up.clip(clip).ok()).collect();
        }
        Ok(asset)
    }
}

fn display(path: &Path) -> String {
    path.display().to_string()
}

/// What a task made of assets, kept up to a number of bytes; the oldest go first.
pub struct Cache<T, K = AssetId> {
    limit: usize,
    held: Mutex<CacheState<T, K>>,
}

struct CacheState<T, K> {
    of: HashMap<K, (Arc<T>, usize)>,
    order: VecDeque<K>,
    bytes: usize,
}

impl<T, K: Copy + Eq + std::hash::Hash> Cache<T, K> {
    /// Empty, with an equal part of the memory that a run has for so many `kinds` of what is prepared.
    pub fn of(config: &DataConfig, kinds: usize) -> Self {
        let held = CacheState { of: HashMap::new(), order: VecDeque::new(), bytes: 0 };
        Self { limit: (config.cache_mb << 20) / kinds.max(1), held: Mutex::new(held) }
    }

    /// How many are kept, and their bytes.
    #[cfg(test)]
    pub(crate) fn kept(&self) -> [usize; 2] {
        let held = self.lock();
        [held.of.len(), held.bytes]
    }

    /// What is kept of an asset, or what `make` makes of it, with its size in bytes. Two threads that
    /// miss at once both make it; what they make is equal.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn get<E>(&self, id: K, make: impl FnOnce() -> Result<(T, usize), E>) -> Result<Arc<T>, E> {
        if let Some((found, _)) = self.lock().of.get(&id) {
            return Ok(found.clone());
        }
        let (made, bytes) = make()?;
        let made = Arc::new(made);
        let mut held = self.lock();
        if held.of.insert(id, (made.clone(), bytes)).is_none() {
            held.order.push_back(id);
            held.bytes += bytes;
        }
        while held.bytes > self.limit && held.order.len() > 1 {
            let Some(oldest) = held.order.pop_front() else { break };
            if let Some((_, bytes)) = held.of.remove(&oldest) {
                held.bytes -= bytes;
            }
        }
        Ok(made)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, CacheState<T, K>> {
        // A thread that panicked while it held the lock left a whole map behind.
        self.held.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, Rig, Skeleton, SkinWeights};

    use super::*;

    #[test]
    fn bare_meshes_are_refused_where_they_would_be_used() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("meshes.h5");
        let mut writer = riglab_data::CorpusWriter::create(&path).unwrap();
        for (name, joint) in [("rig", "hips"), ("mesh", riglab_data::LONE_JOINT)] {
            let joint = Joint { name: joint.into(), parent: None, head: [0.0; 3] };
            let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
            let skeleton = Skeleton::new(vec![joint]).unwrap();
            let rig = Rig::new(skeleton, crate::tokenrig::testing::tetrahedron(), weights).unwrap();
            let provenance = riglab_core::Provenance::default();
            writer.add(&Asset { name: name.into(), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&["train", SplitNames::MESHES]).unwrap();
        let assets = Assets::open(&[path]).unwrap();
        let config = DataConfig::default();
        assert_eq!(assets.rigged(&config), Ok(()), "nobody asked for it");
        let of = |splits: &[&str]| assets.in_splits(splits).unwrap();
        assert_eq!((of(&["train", "meshes"]), of(&["meshes", "val"]), of(&["val"])), (vec![2], vec![1], vec![0]));
        assert_eq!(assets.splits().unwrap(), "their splits are `meshes` (1), `train` (1)");
        let said = assets.trainable(&DataConfig { train: vec!["trian".into()], ..config.clone() }).unwrap_err();
        assert!(said.contains("`trian`") && said.contains("their splits are `meshes` (1)"), "{said}");
        let said = assets.trainable(&DataConfig { train: vec![], ..config.clone() }).unwrap_err();
        assert!(said.starts_with("data.train names no split to train on; their splits are `meshes` (1)"), "{said}");
        let meshes = vec![SplitNames::MESHES.to_string()];
        for config in
            [DataConfig { train: meshes.clone(), ..config.clone() }, DataConfig { test: meshes, ..config.clone() }]
        {
            let said = assets.rigged(&config).unwrap_err();
            assert!(said.contains("meshes.h5: 1 of its 2 assets") && said.contains("grpo"), "{said}");
        }
    }

    #[test]
    fn springs_are_known_without_reading_assets() {
        use riglab_core::{JointId, Spring, SpringJoint, Springs, Swing};
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.h5");
        let mut writer = riglab_data::CorpusWriter::create(&path).unwrap();
        for name in ["stiff", "swings"] {
            let joint = Joint { name: "hair".into(), parent: None, head: [0.0; 3] };
            let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
            let skeleton = Skeleton::new(vec![joint]).unwrap();
            let mut rig = Rig::new(skeleton, crate::tokenrig::testing::tetrahedron(), weights).unwrap();
            if name == "swings" {
                let joint = SpringJoint { joint: JointId(0), tail: Some([0.0, 1.0, 0.0]), swing: Swing::default() };
                let spring = Spring { name: "hair".into(), joints: vec![joint], groups: vec![], center: None };
                rig = rig.with_springs(Springs::new(vec![spring], vec![], vec![]).unwrap()).unwrap();
            }
            let provenance = riglab_core::Provenance::default();
            writer.add(&Asset { name: name.into(), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&["train", "val"]).unwrap();
        let assets = Assets::open(&[path]).unwrap();
        let any = |split: &str| assets.any_springs(assets.split(split).unwrap()).unwrap();
        assert_eq!([any("train"), any("val"), any("none")], [false, true, false]);
    }

    #[test]
    fn some_assets_are_of_all_corpora_by_their_weights() {
        let of = |corpus: usize, count| (0..count).map(move |index| AssetId { corpus, index });
        let all: Vec<AssetId> = of(0, 25).chain(of(1, 284)).chain(of(2, 9)).collect();
        let counts = |weights: &[f32], most| {
            let config = DataConfig { weights: weights.to_vec(), ..DataConfig::default() };
            let (ids, again) = (config.some_of(&all, most, 3), config.some_of(&all, most, 3));
            assert_eq!(ids, again, "the same ones each time");
            assert_eq!(ids.iter().collect::<std::collections::HashSet<_>>().len(), ids.len(), "each once");
            [0, 1, 2].map(|k| ids.iter().filter(|id| id.corpus == k).count())
        };
        assert_eq!(counts(&[2.0, 1.0, 0.0], 30), [20, 10, 0]);
        assert_eq!(counts(&[2.0, 1.0, 1.0], 32), [16, 8, 8]);
        assert_eq!(counts(&[2.0, 1.0, 0.0], 60), [25, 35, 0], "no more than there are");
        assert_eq!(counts(&[2.0, 1.0, 0.0], 0), [25, 284, 9]);
        let by_size = counts(&[], 32);
        assert!(by_size[1] > 20 && by_size.iter().sum::<usize>() == 32, "{by_size:?}");
    }

    #[test]
    fn the_cache_stays_within_its_limit() {
        let config = DataConfig { cache_mb: 2, ..DataConfig::default() };
        let cache = Cache::of(&config, 2);
        let id = |index| AssetId { corpus: 0, index };
        for i in 0..10 {
            cache.get::<()>(id(i), || Ok((i, 300_000))).unwrap();
        }
        assert!(cache.kept()[1] <= 1 << 20);
        assert_eq!(*cache.get::<()>(id(9), || panic!("is kept")).unwrap(), 9);
        assert_eq!(*cache.get::<()>(id(0), || Ok((100, 1))).unwrap(), 100);
    }
}
