//! Assets that are evaluated though a network was trained on them: their scores say nothing of new ones.

use std::collections::HashSet;

use crate::assets::{AssetId, Assets, DataConfig};

/// Assets that are evaluated and trained on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeenAssets {
    /// Their names, split by split, in corpus order.
    pub names: Vec<String>,
    /// The splits that have some.
    pub splits: Vec<String>,
}

/// The assets in splits of `data`'s corpora that training by `trained` takes too, whatever corpora these are of:
/// read from the same file, or the same in every number.
///
/// # Errors
/// A sentence: a corpus that cannot be read, or as [`Assets::training`].
pub fn seen(data: &DataConfig, splits: &[String], trained: &DataConfig) -> Result<SeenAssets, String> {
    let assets = Assets::open(&trained.corpora).map_err(|e| e.to_string())?;
    let ids: Vec<AssetId> = assets.training(trained)?.into_iter().flat_map(|(_, ids)| ids).collect();
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

/// A sentence on such assets, for who trains or evaluates; `None` without any.
pub fn warning(seen: &SeenAssets) -> Option<String> {
    let (first, splits) = (seen.names.first()?, seen.splits.join(", "));
    Some(match seen.names.len() {
        1 => format!("`{first}`, of {splits}, is trained on too: its scores say nothing of new assets"),
        n => format!(
            "{n} assets of {splits} are trained on too (`{first}`, ...): their scores say nothing of new assets"
        ),
    })
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

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
        assert_eq!(seen(&looked_at, splits, &DataConfig { max_joints: 0, ..trained }).unwrap(), SeenAssets::default());
        assert!(seen(&looked_at, splits, &data(&[&dir.path().join("gone.h5")])).is_err());
    }

    #[test]
    fn a_warning_names_one_and_counts_them_all() {
        let names = |seen: &[&str]| seen.iter().map(|s| (*s).to_string()).collect();
        let say = |seen: &[&str]| warning(&SeenAssets { names: names(seen), splits: vec!["val".into()] });
        assert_eq!(say(&[]), None);
        assert!(say(&["a.glb"]).unwrap().starts_with("`a.glb`, of val, is trained on too"));
        assert!(say(&["a.glb", "b.glb"]).unwrap().starts_with("2 assets of val are trained on too (`a.glb`"));
    }
}
