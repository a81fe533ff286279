//! Statistics of a corpus: the columns of SkinTokens' Table 1.

use serde::Serialize;

use crate::Corpus;

/// Means over assets.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stats {
    /// How many assets.
    pub assets: usize,
    /// Mean number of vertices N.
    pub vertices: f64,
    /// Mean number of triangles.
    pub triangles: f64,
    /// Mean number of joints J.
    pub joints: f64,
    /// Mean number of non-zero weights of an asset.
    pub active: f64,
    /// Mean over assets of the share of non-zero entries in the N × J matrix, in percent (the paper
    /// calls it sparsity).
    pub sparsity_percent: f64,
}

/// Statistics over the assets `of` (all of them: `0..corpus.len()`). Reads offsets only.
pub fn stats(corpus: &Corpus, of: impl IntoIterator<Item = usize>) -> Stats {
    let mut sums = [0.0; 5];
    let mut assets = 0;
    for index in of {
        let [v, f, j, w] = corpus.counts(index).map(|n| n as f64);
        for (sum, x) in sums.iter_mut().zip([v, f, j, w, 100.0 * w / (v * j).max(1.0)]) {
            *sum += x;
        }
        assets += 1;
    }
    let n = f64::max(assets as f64, 1.0);
    let [vertices, triangles, joints, active, sparsity_percent] = sums.map(|s| s / n);
    Stats { assets, vertices, triangles, joints, active, sparsity_percent }
}
