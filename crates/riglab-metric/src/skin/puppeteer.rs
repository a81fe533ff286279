//! Puppeteer's precision, recall and L1, with what its evaluation does to predictions first.
//!
//! ```text
//! ŵ below 0.001 is 0; where asked for, each row becomes the mean of the rows one edge away;
//! ŵ below t times the row's largest is 0 (t = 0.15, on ModelsResource 0.35); rows are divided by their sums.
//! Only vertices whose true row sums to 1 within 0.01 count ("rows").
//! precision, recall   TP over predicted, over true active (> 0) entries of the asset; 0 where there are none
//! l1                  sum over bones, mean over vertices
//! ```

use super::{Figures, Skins};
use crate::Rows;

const LEAST: f64 = 1e-3;
const SUM: f64 = 0.01;

pub(super) fn figures(skins: &Skins, share: f64, ring: bool) -> Figures {
    // The peer's code measures from sampled points to vertices first; here every vertex is its own.
    let rings = ring.then(|| Rings::new(skins.predicted.len(), skins.edges));
    let (mut tp, mut active, mut wanted, mut l1, mut kept) = (0u64, 0u64, 0u64, 0.0, 0u64);
    let columns = skins.truth.columns().max(skins.predicted.columns());
    let (mut means, mut row) = (Means::new(columns), Vec::new());
    for (v, w) in skins.truth.iter().enumerate().take(skins.predicted.len()) {
        let sum: f64 = w.iter().map(|(_, w)| f64::from(*w)).sum();
        if (sum - 1.0).abs() >= SUM {
            continue;
        }
        kept += 1;
        let own = [v as u32];
        let around = rings.as_ref().map(|r| r.around(v)).filter(|around| !around.is_empty()).unwrap_or(&own);
        means.of(around, skins.predicted, w, &mut row);
        let least = share * row.iter().map(|(_, p)| *p).fold(0.0, f64::max);
        let mut sum = 0.0;
        for (_, p) in &mut row {
            *p = if *p >= least { *p } else { 0.0 };
            sum += *p;
        }
        // Nothing is left only where there was nothing.
        let sum = if sum == 0.0 { 1.0 } else { sum };
        for (w, p) in &row {
            let p = p / sum;
            l1 += (w - p).abs();
            tp += u64::from(*w > 0.0 && p > 0.0);
            active += u64::from(p > 0.0);
            wanted += u64::from(*w > 0.0);
        }
    }
    let share = |n: u64| if n == 0 { 0.0 } else { tp as f64 / n as f64 };
    vec![("precision", share(active)), ("recall", share(wanted)), ("l1", l1 / kept as f64), ("rows", kept as f64)]
}

/// The far ends of each vertex' edges.
struct Rings {
    /// Where a vertex' ends begin; where they end is where the next one's begin.
    starts: Vec<usize>,
    ends: Vec<u32>,
}

impl Rings {
    /// In the order of the edges; those that name no vertex are left out.
    fn new(vertices: usize, edges: &[[u32; 2]]) -> Self {
        let inside = |e: &&[u32; 2]| e.iter().all(|v| (*v as usize) < vertices);
        let mut counts = vec![0usize; vertices];
        edges.iter().filter(inside).for_each(|e| counts[e[0] as usize] += 1);
        let mut at = 0;
        let start = |count: &usize| {
            at += count;
            at - count
        };
        let mut starts: Vec<usize> = counts.iter().map(start).collect();
        let mut next = starts.clone();
        starts.push(at);
        let mut ends = vec![0; at];
        for [a, b] in edges.iter().filter(inside) {
            let next = &mut next[*a as usize];
            ends[*next] = *b;
            *next += 1;
        }
        Self { starts, ends }
    }

    fn around(&self, vertex: usize) -> &[u32] {
        &self.ends[self.starts[vertex]..self.starts[vertex + 1]]
    }
}

/// Makes means of sparse rows in a dense one.
struct Means {
    /// True weight and sum of predicted ones, by column: all 0 between two rows.
    sums: Vec<(f64, f64)>,
    /// A bit for each column that has a sum.
    used: Vec<u64>,
}

impl Means {
    fn new(columns: usize) -> Self {
        Self { sums: vec![(0.0, 0.0); columns], used: vec![0; columns / 64 + 1] }
    }

    /// Writes the weights of `w` and the mean of the rows `around`, small weights dropped: where one is stored,
    /// columns rising.
    fn of(&mut self, around: &[u32], rows: &Rows, w: &[(u32, f32)], into: &mut Vec<(f64, f64)>) {
        for &(c, w) in w {
            self.sums[c as usize].0 = f64::from(w);
            self.used[c as usize / 64] |= 1 << (c % 64);
        }
        for &u in around {
            // Bits are collected before they are stored: most rows have theirs in one word.
            let (mut word, mut bits) = (0, 0);
            for &(c, p) in rows.row(u as usize) {
                let p = f64::from(p);
                if p >= LEAST {
                    if c as usize / 64 != word {
                        self.used[word] |= bits;
                        (word, bits) = (c as usize / 64, 0);
                    }
                    bits |= 1 << (c % 64);
                    self.sums[c as usize].1 += p;
                }
            }
            self.used[word] |= bits;
        }
        let n = around.len() as f64;
        into.clear();
        for (word, bits) in self.used.iter_mut().enumerate() {
            while *bits != 0 {
                let c = 64 * word + bits.trailing_zeros() as usize;
                *bits &= *bits - 1;
                let (w, sum) = std::mem::take(&mut self.sums[c]);
                into.push((w, sum / n));
            }
        }
    }
}

/// The edges of triangles, each in both directions once: for Puppeteer's one-ring filter.
pub fn edges_of(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let sides = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]].map(|[a, b]| [[a, b], [b, a]]);
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(sides).flatten().filter(|[a, b]| a != b).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_is_that_of_dense_rows() {
        use riglab_random::{Draw, stream};
        let mut random = stream(5, "test", &[]);
        // More columns than a word has bits.
        let (vertices, columns) = (40usize, 150usize);
        let mut weights = vec![0.0f32; vertices * columns];
        for row in weights.chunks_exact_mut(columns) {
            (0..6).for_each(|k| row[random.below(columns)] = if k == 0 { 0.0005 } else { random.unit() });
        }
        // Some vertices have no edge, some edges lead nowhere.
        let end = |random: &mut riglab_random::Stream, below: usize| random.below(below) as u32;
        let mut edges: Vec<[u32; 2]> =
            (0..90).map(|_| [end(&mut random, vertices / 2), end(&mut random, vertices)]).collect();
        edges.extend([[0, 99], [99, 0]]);
        let rows = Rows::dense(&weights, columns);
        let (rings, mut means, mut got) = (Rings::new(vertices, &edges), Means::new(columns), Vec::new());
        for v in 0..vertices {
            let ends = edges.iter().filter(|[a, b]| *a as usize == v && (*b as usize) < vertices);
            let around: Vec<u32> = ends.map(|[_, b]| *b).collect();
            assert_eq!(rings.around(v), around, "vertex {v}");
            means.of(&around, &rows, rows.row(v), &mut got);
            let cleaned = |u: u32, c: usize| f64::from(weights[u as usize * columns + c]);
            let mean = |c: usize| {
                around.iter().map(|u| cleaned(*u, c)).filter(|p| *p >= LEAST).sum::<f64>() / around.len().max(1) as f64
            };
            let both = (0..columns).map(|c| (cleaned(v as u32, c), mean(c)));
            let want: Vec<(f64, f64)> = both.filter(|(w, p)| *w > 0.0 || *p > 0.0).collect();
            let got: Vec<(f64, f64)> = got.iter().map(|(w, p)| (*w, if p.is_nan() { 0.0 } else { *p })).collect();
            assert_eq!(got, want, "vertex {v}");
        }
    }
}
