//! Several corpora as one.

use std::collections::{HashMap, HashSet};
use std::path::{Component, Path, PathBuf};

use riglab_asset::file_and_item;

use crate::rewrite::same;
use crate::split::new_trained;
use crate::{Corpus, CorpusWriter, DataError, Splitter};

/// What became of several corpora.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MergeReport {
    /// Assets written.
    pub assets: usize,
    /// Assets left out, as one with the same arrays, bones and motions was there already.
    pub repeated: Vec<Repeated>,
    /// Sentences on what looks mistaken in the splits that were made anew.
    pub warnings: Vec<String>,
}

/// An asset that is equal to one before it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repeated {
    /// Which it is.
    pub left_out: Member,
    /// The one that is written.
    pub kept: Member,
}

/// An asset of one of the corpora.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Its name, with the prefix if it gets one.
    pub name: String,
    /// The corpus.
    pub corpus: PathBuf,
    /// Its split there.
    pub split: String,
}

/// Writes the assets of several corpora to one at `out`, in their order, an asset at a time. Each asset
/// keeps its split unless a splitter is given, which then splits all of them anew.
///
/// Assets that are equal by their digest are written once. With `prefix`, the name of each corpus' file,
/// without its ending where that is not all that tells it from another, and `/` is put before the names of its assets; where
/// that is the name of several corpora, with the folders that tell them apart.
///
/// # Errors
/// [`DataError::DuplicateName`] for unlike assets of one name, [`DataError::NamedTwice`] where both are in one corpus, which
/// no prefix helps, [`DataError::Damaged`] for one that is not what its digest
/// was made of, [`DataError::Same`] where `out` is one of the corpora, what is wrong with a corpus, and when the
/// disk refuses; an older corpus at `out` is left alone then.
pub fn merge(
    corpora: &[PathBuf],
    out: &Path,
    prefix: bool,
    splitter: Option<&Splitter>,
    mut progress: impl FnMut(usize),
) -> Result<MergeReport, DataError> {
    if corpora.iter().any(|path| same(path, out)) {
        return Err(DataError::Same(out.into()));
    }
    let open: Vec<Corpus> = corpora.iter().map(|path| Corpus::open(path)).collect::<Result<_, _>>()?;
    let mut writer = CorpusWriter::create(out)?;
    let mut report = MergeReport::default();
    let (mut splits, mut keys) = (Vec::new(), Vec::new());
    let mut seen: HashMap<String, Member> = HashMap::new();
    let mut done = 0;
    let before = if prefix { prefixes(corpora) } else { vec![String::new(); corpora.len()] };
    for ((corpus, path), before) in open.iter().zip(corpora).zip(before) {
        let (digests, own) = (corpus.texts("digest")?, corpus.texts("split")?);
        let mut named = HashSet::new();
        for (index, (digest, split)) in digests.into_iter().zip(own).enumerate() {
            done += 1;
            progress(done);
            let name = format!("{before}{}", corpus.names()?[index]);
            let member = Member { name: name.clone(), corpus: path.clone(), split: split.clone() };
            if let Some(other) = seen.get(&digest) {
                report.repeated.push(Repeated { left_out: member, kept: other.clone() });
                continue;
            }
            if !named.insert(name.clone()) {
                return Err(DataError::NamedTwice { path: path.clone(), name: corpus.names()?[index].clone() });
            }
            let mut asset = corpus.verified(index)?;
            asset.name.clone_from(&name);
            writer.add(&asset)?;
            keys.push(Splitter::key(&asset));
            splits.push(split);
            seen.insert(digest, member);
        }
    }
    report.assets = writer.len();
    if let Some(splitter) = splitter {
        splits = splitter.assign(&keys);
        let names: HashSet<&str> = keys.iter().map(|(name, _)| name.as_str()).collect();
        let files: HashSet<&str> = names.iter().map(|name| file_and_item(name).0).collect();
        report.warnings = splitter.doubts(&keys, &splits, |name| names.contains(name) || files.contains(name));
    } else {
        report.warnings.extend(new_trained(&keys, &splits));
    }
    writer.finish(&splits)?;
    Ok(report)
}

/// What is put before the names of each corpus' assets: as much of the end of its path as no other has.
fn prefixes(corpora: &[PathBuf]) -> Vec<String> {
    let whole = |path: &PathBuf| straight(&std::path::absolute(path).unwrap_or_else(|_| path.clone()));
    let whole: Vec<PathBuf> = corpora.iter().map(whole).collect();
    // Without its ending, unless another is called so, with its own or without.
    let named = |path: &PathBuf| {
        let bare = path.with_extension("");
        let alone = whole.iter().all(|other| other == path || *other != bare && other.with_extension("") != bare);
        if alone { bare } else { path.clone() }
    };
    // Names begin with no root.
    let name = |step: Component| match step {
        Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
        _ => None,
    };
    let steps = |path: PathBuf| path.components().filter_map(name).collect::<Vec<String>>();
    let paths: Vec<Vec<String>> = whole.iter().map(named).map(steps).collect();
    let end = |path: &[String], steps: usize| path[path.len().saturating_sub(steps)..].to_vec();
    let of = |path: &Vec<String>| {
        let alone = |steps: &usize| {
            let own = end(path, *steps);
            paths.iter().filter(|other| *other != path).all(|other| end(other, *steps) != own)
        };
        let steps = (1..path.len()).find(alone).unwrap_or(path.len());
        end(path, steps).join("/") + "/"
    };
    paths.iter().map(of).collect()
}

/// A path without steps that turn back: names lead out of no folder. After a link such a step leads out of the folder that the
/// link leads to.
fn straight(path: &Path) -> PathBuf {
    let mut own = PathBuf::new();
    for step in path.components() {
        if step != Component::ParentDir {
            own.push(step);
            continue;
        }
        if own.is_symlink() {
            own = own.canonicalize().unwrap_or(own);
        }
        own.pop();
    }
    own
}

/// Flips a bit of the first joint of a corpus' first asset.
#[cfg(test)]
pub(crate) fn damage(path: &Path) {
    let file = hdf5::File::open_rw(path).unwrap();
    let joints = file.dataset("joints").unwrap();
    let mut heads = joints.read_2d::<f32>().unwrap();
    heads[[0, 0]] = f32::from_bits(heads[[0, 0]].to_bits() ^ 1 << 20);
    joints.write(&heads).unwrap();
}

/// Gives all assets of a corpus one name.
#[cfg(test)]
pub(crate) fn rename_all(path: &Path, name: &str) {
    use hdf5::types::VarLenUnicode;
    let file = hdf5::File::open_rw(path).unwrap();
    let names = file.dataset("name").unwrap();
    let one: VarLenUnicode = name.parse().unwrap();
    names.write_raw(&vec![one; names.shape()[0]]).unwrap();
}

#[cfg(test)]
mod tests {
    use riglab_core::{Asset, Joint, Mesh, Provenance, Rig, Skeleton, SkinWeights};

    use super::*;

    /// A rig that differs by where its joint is.
    fn asset(name: &str, place: f32) -> Asset {
        let joint = Joint { name: "root".into(), parent: None, head: [place, 0.0, 0.0] };
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)]; 3]).unwrap();
        let rig = Rig::new(Skeleton::new(vec![joint]).unwrap(), mesh, weights).unwrap();
        Asset { name: name.into(), rig, clips: vec![], provenance: Provenance::default() }
    }

    fn written(path: PathBuf, assets: &[(&str, f32, &str)]) -> PathBuf {
        let mut writer = CorpusWriter::create(&path).unwrap();
        assets.iter().for_each(|(name, place, _)| writer.add(&asset(name, *place)).unwrap());
        writer.finish(&assets.iter().map(|a| a.2).collect::<Vec<_>>()).unwrap();
        path
    }

    #[test]
    fn assets_keep_their_splits_and_equal_ones_come_once() {
        let dir = tempfile::tempdir().unwrap();
        let a = written(dir.path().join("a.h5"), &[("x", 0.0, "train"), ("y", 1.0, "val")]);
        let b = written(dir.path().join("b.h5"), &[("z", 2.0, "test_new"), ("again", 1.0, "train")]);
        let out = dir.path().join("all.h5");
        let report = merge(&[a.clone(), b.clone()], &out, false, None, |_| ()).unwrap();
        let member = |name: &str, corpus: &PathBuf, split: &str| Member {
            name: name.into(),
            corpus: corpus.clone(),
            split: split.into(),
        };
        let repeated = Repeated { left_out: member("again", &b, "train"), kept: member("y", &a, "val") };
        // All have one topology.
        assert!(report.warnings[0].starts_with("1 of 1 assets of test_new have a tree of joints that"), "{report:?}");
        assert_eq!((report.assets, report.repeated), (3, vec![repeated]));
        let all = Corpus::open(&out).unwrap();
        assert_eq!(all.names().unwrap(), ["x", "y", "z"]);
        assert_eq!(all.texts("split").unwrap(), ["train", "val", "test_new"]);
        assert_eq!(all.asset(2).unwrap(), asset("z", 2.0));
        assert_eq!(all.verify(|_| ()).unwrap(), []);
        // Split anew, and named by where they are from.
        let report = merge(&[a, b], &out, true, Some(&Splitter::ByTopology(0)), |_| ()).unwrap();
        assert_eq!(report.assets, 3);
        let all = Corpus::open(&out).unwrap();
        assert_eq!(all.names().unwrap(), ["a/x", "a/y", "b/z"]);
        let splits = all.texts("split").unwrap();
        assert!(splits.iter().all(|s| s == "test_new") || splits.iter().all(|s| s != "test_new"), "{splits:?}");
    }

    #[test]
    fn unlike_assets_of_one_name_are_refused_and_the_old_corpus_stays() {
        let dir = tempfile::tempdir().unwrap();
        let a = written(dir.path().join("a.h5"), &[("x", 0.0, "train")]);
        let b = written(dir.path().join("b.h5"), &[("x", 2.0, "train")]);
        let out = written(dir.path().join("all.h5"), &[("old", 9.0, "val")]);
        let error = merge(&[a.clone(), b.clone()], &out, false, None, |_| ()).unwrap_err();
        assert!(matches!(error, DataError::DuplicateName(name) if name == "x"));
        assert_eq!(Corpus::open(&out).unwrap().names().unwrap(), ["old"]);
        assert_eq!(merge(&[a, b], &out, true, None, |_| ()).unwrap().assets, 2);
    }

    #[test]
    fn corpora_of_one_name_are_told_apart_by_their_folders() {
        let dir = tempfile::tempdir().unwrap();
        ["a", "b"].iter().for_each(|name| std::fs::create_dir(dir.path().join(name)).unwrap());
        let at = |name: &str, place| written(dir.path().join(name), &[("x", place, "train")]);
        let corpora = [at("a/c.h5", 0.0), at("b/c.h5", 1.0), at("a/d.v1.h5", 2.0)];
        let out = dir.path().join("all.h5");
        assert_eq!(merge(&corpora, &out, true, None, |_| ()).unwrap().assets, 3);
        assert_eq!(Corpus::open(&out).unwrap().names().unwrap(), ["a/c/x", "b/c/x", "d.v1/x"]);
        // The end of another's path.
        let whole = |folder: &str| PathBuf::from(folder).join("rigs.h5");
        assert_eq!(prefixes(&[whole("/data"), whole("/mnt/data")]), ["data/rigs/", "mnt/data/rigs/"]);
        // Paths that turn back.
        assert_eq!(prefixes(&[whole("/data/sub"), whole("/data/sub/..")]), ["sub/rigs/", "data/rigs/"]);
        let other = PathBuf::from("/data/x/../rigs.hdf5");
        assert_eq!(prefixes(&[whole("/data"), other]), ["rigs.h5/", "rigs.hdf5/"]);
        #[cfg(unix)]
        {
            let (folder, link) = (dir.path().join("a/deep"), dir.path().join("b/link"));
            std::fs::create_dir(&folder).unwrap();
            std::os::unix::fs::symlink(&folder, &link).unwrap();
            assert_eq!(prefixes(&[link.join("../c.h5"), dir.path().join("b/c.h5")]), ["a/c/", "b/c/"]);
            assert_eq!(prefixes(&[link.join("c.h5"), dir.path().join("b/c.h5")]), ["link/c/", "b/c/"]);
        }
        // One that is given twice is itself.
        let twice = [corpora[0].clone(), corpora[0].clone()];
        assert_eq!(merge(&twice, &out, true, None, |_| ()).unwrap().assets, 1);
        assert_eq!(Corpus::open(&out).unwrap().names().unwrap(), ["c/x"]);
    }

    #[test]
    fn of_two_assets_of_one_name_in_one_corpus_the_corpus_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let a = written(dir.path().join("a.h5"), &[("x", 0.0, "train"), ("y", 2.0, "train")]);
        let b = written(dir.path().join("b.h5"), &[("z", 3.0, "train")]);
        rename_all(&a, "x");
        let out = dir.path().join("all.h5");
        for prefix in [false, true] {
            let said = merge(&[b.clone(), a.clone()], &out, prefix, None, |_| ()).unwrap_err().to_string();
            assert!(said.contains("a.h5: two assets in it are named `x`") && !said.contains("--prefix"), "{said}");
        }
        assert!(!out.exists());
    }

    #[test]
    fn corpora_that_differ_by_their_ending_alone_are_told_apart() {
        let dir = tempfile::tempdir().unwrap();
        let all = ["s.h5", "s.hdf5", "s.h5.h5"].map(|name| dir.path().join(name));
        all.iter().zip([0.0, 1.0, 2.0]).for_each(|(path, x)| drop(written(path.clone(), &[("x", x, "train")])));
        let out = dir.path().join("all.h5");
        merge(&all, &out, true, None, |_| ()).unwrap();
        assert_eq!(Corpus::open(&out).unwrap().names().unwrap(), ["s.h5/x", "s.hdf5/x", "s.h5.h5/x"]);
    }

    #[test]
    fn a_split_of_files_holds_for_their_assets_and_is_not_doubted() {
        let dir = tempfile::tempdir().unwrap();
        let a = written(dir.path().join("a.h5"), &[("set.npz#x", 0.0, "val"), ("set.npz#y", 1.0, "val")]);
        let list = [("set.npz", "train"), ("gone.npz", "train")].map(|(name, split)| (name.into(), split.into()));
        let out = dir.path().join("all.h5");
        let report = merge(&[a], &out, false, Some(&Splitter::Given(list.into())), |_| ()).unwrap();
        assert_eq!(Corpus::open(&out).unwrap().texts("split").unwrap(), ["train", "train"]);
        assert!(report.warnings.len() == 1 && report.warnings[0].contains("`gone.npz`"), "{:?}", report.warnings);
        assert!(!report.warnings[0].contains("`set.npz`"), "{:?}", report.warnings);
    }

    #[test]
    fn a_write_protected_corpus_stays() {
        let dir = tempfile::tempdir().unwrap();
        let a = written(dir.path().join("a.h5"), &[("x", 0.0, "train")]);
        let old = written(dir.path().join("old.h5"), &[("y", 1.0, "train")]);
        let mut kept = old.metadata().unwrap().permissions();
        kept.set_readonly(true);
        std::fs::set_permissions(&old, kept).unwrap();
        let said = merge(&[a], &old, false, None, |_| ()).unwrap_err().to_string();
        assert!(said.contains("old.h5: is there already and write-protected"), "{said}");
        assert_eq!(Corpus::open(&old).unwrap().names().unwrap(), ["y"]);
    }

    #[test]
    fn damage_is_not_given_a_fresh_digest() {
        let dir = tempfile::tempdir().unwrap();
        let a = written(dir.path().join("a.h5"), &[("x", 0.0, "train"), ("y", 1.0, "val")]);
        let b = written(dir.path().join("b.h5"), &[("z", 2.0, "train")]);
        let out = dir.path().join("all.h5");
        damage(&a);
        let said = merge(&[b.clone(), a.clone()], &out, false, None, |_| ()).unwrap_err().to_string();
        assert!(said.contains("a.h5") && said.contains("`x`") && said.contains("damaged"), "{said}");
        assert!(!out.exists());
        // Nor is one of those that are read written over.
        assert!(matches!(merge(&[a, b.clone()], &b, false, None, |_| ()), Err(DataError::Same(_))));
    }
}
