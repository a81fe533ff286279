//! Assets that are evaluated though a network was trained on them: their scores say nothing of new ones.

use std::collections::HashSet;
use std::path::Path;

use riglab_token::Limits;
use riglab_train::{Checkpoint, named_by};

use crate::assets::{AssetId, Assets, DataConfig};
use crate::bundle::Stored;
use crate::sequences::may_fit;
use crate::settings::{Settings, TaskSettings};
use crate::tokenrig::is_word;

/// Assets that are evaluated and trained on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeenAssets {
    /// Their names, split by split, in corpus order.
    pub names: Vec<String>,
    /// The splits that have some.
    pub splits: Vec<String>,
}

/// What says which assets a training takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Training {
    /// Its corpora and splits.
    pub data: DataConfig,
    /// What their sequences have to fit, in tasks that train on sequences.
    pub limits: Option<Limits>,
}

impl Training {
    /// That of a task.
    pub fn of(settings: &impl TaskSettings) -> Self {
        Self { data: settings.data().clone(), limits: settings.limits() }
    }

    /// That of the settings of some task; `None` where they cannot be understood.
    fn of_table(settings: &toml::Table) -> Option<Self> {
        let own = |key: &str| settings.get(key).cloned();
        Some(Self { data: own("data")?.try_into().ok()?, limits: own("limits").and_then(|own| own.try_into().ok()) })
    }

    fn assets(&self) -> Result<(Assets, Vec<AssetId>), String> {
        let assets = Assets::open(&self.data.corpora).map_err(|e| e.to_string())?;
        let all = assets.training(&self.data)?.into_iter().flat_map(|(_, ids)| ids);
        let ids = all.filter(|&id| self.limits.is_none_or(|limits| may_fit(&assets, limits, id))).collect();
        Ok((assets, ids))
    }
}

/// The assets in splits of `data`'s corpora that training by `trained` takes too, whatever corpora these are of:
/// read from the same file, or the same in every number.
///
/// # Errors
/// A sentence: a corpus that cannot be read, or as [`Assets::training`].
pub fn seen(data: &DataConfig, splits: &[String], trained: &Training) -> Result<SeenAssets, String> {
    let (assets, ids) = trained.assets()?;
    let marks = assets.marks(&ids).map_err(|e| e.to_string())?;
    let known: HashSet<String> = marks.into_iter().flat_map(|(_, marks)| marks).collect();
    let assets = Assets::open(&data.corpora).map_err(|e| e.to_string())?;
    let mut found = SeenAssets::default();
    // A split may be both validated and tested on: its assets are there once.
    for (_, split) in splits.iter().enumerate().filter(|(k, split)| !splits[..*k].contains(split)) {
        let marks = assets.split(split).and_then(|ids| assets.marks(&ids)).map_err(|e| e.to_string())?;
        let both = marks.into_iter().filter(|(_, marks)| marks.iter().any(|mark| known.contains(mark)));
        let before = found.names.len();
        found.names.extend(both.map(|(name, _)| name));
        if found.names.len() > before {
            found.splits.push(split.clone());
        }
    }
    Ok(found)
}

/// The trainings of models that a model builds on, each with the key of its settings (a TOML text) that names the run: the
/// model that rewards refine, the auto-encoder of skin tokens, the weights to begin with, and what these build on in turn. Of
/// models in files, and of those that come with riglab, no corpora are known.
pub fn built_on(settings: &str) -> Vec<(&'static str, Training)> {
    let (mut found, mut known) = (Vec::new(), HashSet::new());
    let own = settings.parse().map(toml::Value::Table);
    let mut open: Vec<(Option<&'static str>, toml::Value)> = own.into_iter().map(|own| (None, own)).collect();
    while let Some((first, of)) = open.pop() {
        for (key, named) in models(&of) {
            let run = named_by(Path::new(named)).0;
            let (Ok(whole), Ok(settings)) = (run.canonicalize(), Settings::of_run(&run)) else { continue };
            if !known.insert(whole) {
                continue;
            }
            let (first, of) = (first.unwrap_or(key), settings.table());
            found.extend(Training::of_table(&of).map(|trained| (first, trained)));
            open.push((Some(first), toml::Value::Table(of)));
        }
    }
    found
}

/// The models that settings build on, each with its key: as they are named, a path or one that comes with riglab.
pub fn models(settings: &toml::Value) -> impl Iterator<Item = (&'static str, &str)> {
    const KEYS: [&str; 3] = ["start.model", "skin.run", "train.start.from"];
    let named = move |key: &'static str| {
        let value = key.split('.').try_fold(settings, |table, name| table.get(name))?;
        Some((key, value.as_str().filter(|named| !named.is_empty())?))
    };
    KEYS.into_iter().filter_map(named)
}

/// Looks for a model that settings name under a key, as [`models`] gives both. What it is of is told by who opens it.
///
/// # Errors
/// A sentence: there is none.
pub fn look_for(key: &str, named: &str) -> Result<(), String> {
    let path = Path::new(named);
    if key == "skin.run" && is_word(path) {
        return Ok(());
    }
    if path.is_file() {
        return Stored::open(path).map(drop);
    }
    let (run, checkpoint) = named_by(path);
    Settings::of_run(&run)?;
    Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map(drop).map_err(|e| e.to_string())
}

/// A sentence on such assets, for who trains or evaluates; `None` without any. `by` is the key that names the model that was
/// trained on them, where it is one that this one builds on.
pub fn warning(seen: &SeenAssets, by: Option<&str>) -> Option<String> {
    let (first, splits) = (seen.names.first()?, seen.splits.join(", "));
    let too = by.map_or("trained on too".to_owned(), |key| format!("trained on by what {key} names"));
    Some(match seen.names.len() {
        1 => format!("`{first}`, of {splits}, is {too}: its scores say nothing of new assets"),
        n => format!("{n} assets of {splits} are {too} (`{first}`, ...): their scores say nothing of new assets"),
    })
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use riglab_core::{Asset, Joint, Provenance, Rig, Skeleton, SkinWeights};
    use riglab_data::CorpusWriter;

    use super::*;
    use crate::tokenrig::testing::tetrahedron;

    /// A corpus of tetrahedra: name, split, height of the one joint, which makes two of them differ, and checksum.
    fn corpus(path: PathBuf, assets: &[(&str, &str, f32, &str)]) -> PathBuf {
        let mut writer = CorpusWriter::create(&path).unwrap();
        for (name, _, height, checksum) in assets {
            let joint = Joint { name: "a".into(), parent: None, head: [0.0, *height, 0.0] };
            let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
            let rig = Rig::new(Skeleton::new(vec![joint]).unwrap(), tetrahedron(), weights).unwrap();
            let provenance = Provenance { checksum: (*checksum).into(), ..Provenance::default() };
            writer.add(&Asset { name: (*name).into(), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&assets.iter().map(|(_, split, ..)| *split).collect::<Vec<_>>()).unwrap();
        path
    }

    fn data(corpora: &[&Path]) -> DataConfig {
        DataConfig { corpora: corpora.iter().map(|p| (*p).into()).collect(), ..DataConfig::default() }
    }

    #[test]
    fn assets_that_were_trained_on_are_found_by_file_and_by_numbers() {
        let dir = tempfile::tempdir().unwrap();
        let own =
            [("a", "train", 0.1, ""), ("b", "train", 0.2, "file"), ("c", "val", 0.3, ""), ("d", "train", 0.4, "")];
        let trained = corpus(dir.path().join("trained.h5"), &own);
        let others = [
            ("same numbers", "test_new", 0.1, ""),
            ("same file", "test_seen", 0.5, "file"),
            ("validated on", "test_new", 0.3, ""),
            ("new", "test_new", 0.6, "another"),
            ("not looked at", "val", 0.4, ""),
            ("of its own", "train", 0.7, ""),
        ];
        let looked_at = corpus(dir.path().join("looked_at.h5"), &others);
        let (trained, looked_at) = (data(&[&trained]), data(&[&looked_at]));
        let splits = &looked_at.test;
        let within = |limits, trained: &DataConfig| Training { data: trained.clone(), limits };
        let seen = |data: &DataConfig, splits: &[String], trained: &DataConfig| {
            super::seen(data, splits, &within(None, trained))
        };
        let found = seen(&looked_at, splits, &trained).unwrap();
        assert_eq!(found.names, ["same file", "same numbers"]);
        let new = ["test_new".to_owned()];
        assert_eq!((found.splits, seen(&looked_at, &new, &trained).unwrap().splits), (splits.clone(), new.to_vec()));
        let twice = [new.to_vec(), new.to_vec()].concat();
        assert_eq!(seen(&looked_at, &twice, &trained).unwrap(), seen(&looked_at, &new, &trained).unwrap());
        assert_eq!(seen(&trained, splits, &trained).unwrap(), SeenAssets::default());
        // One file in two corpora of a training, in another split each.
        let both = DataConfig { corpora: [&trained.corpora[..], &looked_at.corpora[..]].concat(), ..trained.clone() };
        assert_eq!(seen(&both, splits, &both).unwrap().names.len(), 2);
        // Only splits that have some are named.
        let splits_of_all = ["train", "test_new"].map(String::from);
        assert_eq!(seen(&trained, &splits_of_all, &trained).unwrap().splits, ["train"]);
        // What has no weight, or too many joints, is not trained on.
        let weights = DataConfig { weights: vec![0.0, 1.0], ..both.clone() };
        assert_eq!(seen(&looked_at, splits, &weights).unwrap(), SeenAssets::default());
        let without = DataConfig { max_joints: 0, ..trained.clone() };
        assert_eq!(seen(&looked_at, splits, &without).unwrap(), SeenAssets::default());
        // Nor is what has no sequence that fits: one joint takes six tokens.
        let of = |joints, tokens| {
            let limits = Some(Limits { joints, tokens });
            super::seen(&looked_at, splits, &within(limits, &trained)).unwrap().names.len()
        };
        assert_eq!([of(1, 6), of(0, 6), of(1, 5)], [2, 0, 0]);
        assert!(seen(&looked_at, splits, &data(&[&dir.path().join("gone.h5")])).is_err());
    }

    #[test]
    fn models_that_a_model_builds_on_are_found_however_far_back() {
        let dir = tempfile::tempdir().unwrap();
        let run = |name: &str, settings: &str| {
            let run = dir.path().join(name);
            std::fs::create_dir_all(&run).unwrap();
            std::fs::write(run.join("config.toml"), settings).unwrap();
            run.display().to_string()
        };
        let vae = run("vae", "[data]\ncorpora = ['v.h5']\n");
        let rigs = run("rigs", &format!("[data]\ncorpora = ['r.h5']\n[limits]\njoints = 64\n[skin]\nrun = '{vae}'\n"));
        let own = format!("[start]\nmodel = '{rigs}/checkpoints/last'\n[skin]\nrun = 'shipped'\n");
        let of = |settings: &str| -> Vec<(&str, String)> {
            let all = built_on(settings).into_iter();
            all.map(|(key, trained)| (key, trained.data.corpora[0].display().to_string())).collect()
        };
        assert_eq!(of(&own), [("start.model", "r.h5".to_owned()), ("start.model", "v.h5".to_owned())]);
        let limits = built_on(&own).iter().map(|(_, trained)| trained.limits.map(|own| own.joints)).collect::<Vec<_>>();
        assert_eq!(limits, [Some(64), None]);
        assert_eq!(of(&format!("[train.start]\nfrom = '{vae}'\n")), [("train.start.from", "v.h5".to_owned())]);
        // One that begins with itself comes to an end.
        let turns = dir.path().join("turns").display().to_string();
        run("turns", &format!("[data]\ncorpora = ['t.h5']\n[train.start]\nfrom = '{turns}'\n"));
        assert_eq!(of(&format!("[train.start]\nfrom = '{turns}'\n")).len(), 1);
        assert!(built_on("").is_empty());
    }

    #[test]
    fn a_warning_names_one_and_counts_them_all() {
        let names = |seen: &[&str]| seen.iter().map(|s| (*s).to_string()).collect();
        let of = |seen: &[&str]| SeenAssets { names: names(seen), splits: vec!["val".into()] };
        let say = |seen: &[&str]| warning(&of(seen), None);
        let by = warning(&of(&["a.glb"]), Some("skin.run")).unwrap();
        assert!(by.starts_with("`a.glb`, of val, is trained on by what skin.run names"), "{by}");
        assert_eq!(say(&[]), None);
        assert!(say(&["a.glb"]).unwrap().starts_with("`a.glb`, of val, is trained on too"));
        assert!(say(&["a.glb", "b.glb"]).unwrap().starts_with("2 assets of val are trained on too (`a.glb`"));
    }
}
