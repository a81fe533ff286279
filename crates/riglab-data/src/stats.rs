//! Statistics of a corpus: the columns of SkinTokens' Table 1.

use serde::Serialize;

use crate::Corpus;

/// Means over assets.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stats {
    /// How many assets.
    pub assets: usize,
    /// How many of them are bare meshes ([`Corpus::bare`]). What holds them is no rig, and counts as none below.
    pub bare: usize,
    /// Mean number of vertices N.
    pub vertices: f64,
    /// Mean number of triangles.
    pub triangles: f64,
    /// Mean number of joints J of those with a rig; `None` where none has one, as in what follows.
    pub joints: Option<f64>,
    /// Mean number of non-zero weights of an asset with a rig.
    pub active: Option<f64>,
    /// Mean over assets with a rig of the share of non-zero entries in the N × J matrix, in percent (the paper
    /// calls it sparsity).
    pub sparsity_percent: Option<f64>,
}

/// Statistics over the assets `of` (all of them: `0..corpus.len()`), of which those of `bare`, in rising order, are bare
/// meshes ([`Corpus::bare`]). Reads offsets only.
pub fn stats(corpus: &Corpus, of: impl IntoIterator<Item = usize>, bare: &[usize]) -> Stats {
    let (mut meshes, mut rigs) = ([0.0; 2], [0.0; 3]);
    let (mut assets, mut rigged) = (0, 0);
    let add = |sums: &mut [f64], own: &[f64]| sums.iter_mut().zip(own).for_each(|(sum, x)| *sum += x);
    for index in of {
        let [v, f, j, w] = corpus.counts(index).map(|n| n as f64);
        add(&mut meshes, &[v, f]);
        assets += 1;
        if bare.binary_search(&index).is_err() {
            add(&mut rigs, &[j, w, 100.0 * w / (v * j).max(1.0)]);
            rigged += 1;
        }
    }
    let [vertices, triangles] = meshes.map(|sum| sum / f64::max(assets as f64, 1.0));
    let [joints, active, sparsity_percent] = rigs.map(|sum| (rigged > 0).then(|| sum / rigged as f64));
    Stats { assets, bare: assets - rigged, vertices, triangles, joints, active, sparsity_percent }
}

#[cfg(test)]
mod tests {
    use riglab_asset::ImportOptions;

    use super::*;
    use crate::{Splitter, import_folder, import_meshes, merge};

    #[test]
    fn what_holds_a_bare_mesh_is_no_joint() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
        let rig = "joints a 0 0 0\njoints b 0 1 0\nroot a\nhier a b\nskin 0 a 1\nskin 1 a 1\nskin 2 a 1\nskin 3 a 0.5 b 0.5\n";
        std::fs::create_dir(at("rigged")).unwrap();
        std::fs::create_dir(at("bare")).unwrap();
        std::fs::write(at("rigged/a.obj"), mesh).unwrap();
        std::fs::write(at("rigged/a_rig.txt"), rig).unwrap();
        std::fs::write(at("bare/b.obj"), "v 0 0 0\nv 4 0 0\nv 0 2 0\nf 1 2 3\n").unwrap();
        let options = ImportOptions::default();
        import_folder(&at("rigged"), &at("r.h5"), &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap();
        import_meshes(&at("bare"), &at("b.h5"), &options, &|_, _| ()).unwrap();
        merge(&[at("r.h5"), at("b.h5")], &at("both.h5"), false, None, |_| ()).unwrap();
        let of = |name: &str| {
            let corpus = Corpus::open(&at(name)).unwrap();
            stats(&corpus, 0..corpus.len(), &corpus.bare().unwrap())
        };
        let (rigged, bare, both) = (of("r.h5"), of("b.h5"), of("both.h5"));
        assert_eq!(
            (rigged.bare, rigged.joints, rigged.active, rigged.sparsity_percent),
            (0, Some(2.0), Some(5.0), Some(62.5))
        );
        assert_eq!((bare.bare, bare.joints, bare.active, bare.sparsity_percent), (1, None, None, None));
        // Meshes count whole, rigs where there are any.
        assert_eq!((both.assets, both.bare, both.vertices, both.triangles), (2, 1, 3.5, 2.5));
        assert_eq!(
            (both.joints, both.active, both.sparsity_percent),
            (rigged.joints, rigged.active, rigged.sparsity_percent)
        );
    }
}
