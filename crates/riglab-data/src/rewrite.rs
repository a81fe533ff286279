//! A corpus with its assets changed.

use std::path::Path;

use riglab_core::Asset;

use crate::{Corpus, CorpusWriter, DataError};

/// Where an asset stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place<'a> {
    /// Its split; empty where it has none.
    pub split: &'a str,
    /// A number for streams of random numbers, which hangs on its name alone.
    pub key: u64,
}

/// Writes the assets of a corpus to another at `out`, in their order and with their splits, each as `change` leaves it,
/// an asset at a time. `change` says in a sentence why it cannot.
///
/// # Errors
/// [`DataError::Refused`] with the sentence of `change`, [`DataError::Damaged`] for an asset that is not what its digest
/// was made of, [`DataError::NamedTwice`], [`DataError::Same`] where `out` is the corpus itself, what is
/// wrong with the corpus, and when the disk refuses; an older corpus at `out` is left alone then.
pub fn rewrite(
    corpus: &Path,
    out: &Path,
    mut change: impl FnMut(Asset, Place) -> Result<Asset, String>,
    mut progress: impl FnMut(usize),
) -> Result<usize, DataError> {
    if same(corpus, out) {
        return Err(DataError::Same(out.into()));
    }
    let open = Corpus::open(corpus)?;
    let mut writer = CorpusWriter::create(out)?;
    let splits = open.texts("split")?;
    for (index, split) in splits.iter().enumerate() {
        let asset = open.verified(index)?;
        let name = asset.name.clone();
        let hash = blake3::hash(name.as_bytes());
        let key = hash.as_bytes().iter().take(8).fold(0, |key, byte| key << 8 | u64::from(*byte));
        let refused = |message| DataError::Refused { path: corpus.into(), name, message };
        writer.add(&change(asset, Place { split, key }).map_err(refused)?).map_err(|e| match e {
            DataError::DuplicateName(name) => DataError::NamedTwice { path: corpus.into(), name },
            other => other,
        })?;
        progress(index + 1);
    }
    writer.finish(&splits)?;
    Ok(splits.len())
}

/// Whether two paths lead to one file.
pub fn same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, Mesh, Provenance, Rig, Skeleton, SkinWeights};

    use super::*;

    fn asset(name: &str) -> Asset {
        let joint = Joint { name: "root".into(), parent: None, head: [0.0; 3] };
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)]; 3]).unwrap();
        let rig = Rig::new(Skeleton::new(vec![joint]).unwrap(), mesh, weights).unwrap();
        Asset { name: name.into(), rig, clips: vec![], provenance: Provenance::default() }
    }

    #[test]
    fn assets_are_changed_in_their_places_and_a_refusal_leaves_what_was() {
        let dir = tempfile::tempdir().unwrap();
        let (from, out) = (dir.path().join("a.h5"), dir.path().join("b.h5"));
        let mut writer = CorpusWriter::create(&from).unwrap();
        ["x", "y"].iter().for_each(|name| writer.add(&asset(name)).unwrap());
        writer.finish(&["train", "test_new"]).unwrap();
        let mut keys = Vec::new();
        let noted = |mut asset: Asset, place: Place| {
            keys.push(place.key);
            if place.split == "test_new" {
                asset.provenance.notes.push("changed".into());
            }
            Ok(asset)
        };
        assert_eq!(rewrite(&from, &out, noted, |_| ()).unwrap(), 2);
        assert_ne!(keys[0], keys[1]);
        let done = Corpus::open(&out).unwrap();
        assert_eq!(done.texts("split").unwrap(), ["train", "test_new"]);
        let notes = [0, 1].map(|k| done.asset(k).unwrap().provenance.notes.len());
        assert_eq!((done.names().unwrap().to_vec(), notes), (vec!["x".into(), "y".into()], [0, 1]));
        let error = rewrite(&from, &out, |_, _| Err("no".into()), |_| ()).unwrap_err();
        assert!(error.to_string().ends_with("a.h5: asset `x`: no"), "{error}");
        assert_eq!(Corpus::open(&out).unwrap().len(), 2);
        assert!(matches!(rewrite(&from, &from, |a, _| Ok(a), |_| ()), Err(DataError::Same(_))));
        // Two of one name.
        let twice = dir.path().join("twice.h5");
        std::fs::copy(&from, &twice).unwrap();
        crate::merge::rename_all(&twice, "x");
        let error = rewrite(&twice, &out, |a, _| Ok(a), |_| ()).unwrap_err().to_string();
        assert!(error.contains("twice.h5: two assets in it are named `x`"), "{error}");
        // A damaged asset gets no fresh digest.
        crate::merge::damage(&from);
        let error = rewrite(&from, &out, |a, _| Ok(a), |_| ()).unwrap_err();
        assert!(matches!(error, DataError::Damaged { .. }), "{error}");
        assert_eq!(Corpus::open(&out).unwrap().verify(|_| ()).unwrap(), []);
    }
}
