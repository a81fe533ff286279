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
use crate::rows::both;

const LEAST: f64 = 1e-3;
const SUM: f64 = 0.01;

pub(super) fn figures(skins: &Skins, share: f64, ring: bool) -> Figures {
    // The peer's code measures from sampled points to vertices first; here every vertex is its own.
    let cleaned: Vec<Vec<(u32, f64)>> = skins.predicted.iter().map(without_small).collect();
    let rows = if ring { one_ring(&cleaned, skins.edges, skins.predicted.columns()) } else { cleaned };
    let (mut tp, mut active, mut wanted, mut l1, mut kept) = (0u64, 0u64, 0u64, 0.0, 0u64);
    for (w, p) in skins.truth.iter().zip(&rows) {
        let sum: f64 = w.iter().map(|(_, w)| f64::from(*w)).sum();
        if (sum - 1.0).abs() >= SUM {
            continue;
        }
        kept += 1;
        let largest = p.iter().map(|(_, p)| *p).fold(0.0, f64::max);
        let mut p: Vec<(u32, f64)> = p.iter().copied().filter(|(_, p)| *p >= share * largest).collect();
        let sum: f64 = p.iter().map(|(_, p)| p).sum();
        p.iter_mut().for_each(|(_, p)| *p /= sum);
        both(w, &p, |_, w, p| {
            let w = f64::from(w);
            l1 += (w - p).abs();
            tp += u64::from(w > 0.0 && p > 0.0);
            active += u64::from(p > 0.0);
            wanted += u64::from(w > 0.0);
        });
    }
    let share = |n: u64| if n == 0 { 0.0 } else { tp as f64 / n as f64 };
    vec![("precision", share(active)), ("recall", share(wanted)), ("l1", l1 / kept as f64), ("rows", kept as f64)]
}

fn without_small(row: &[(u32, f32)]) -> Vec<(u32, f64)> {
    row.iter().map(|(c, p)| (*c, f64::from(*p))).filter(|(_, p)| *p >= LEAST).collect()
}

/// The mean of the rows at the far ends of each vertex' edges; a vertex without edges keeps its own.
fn one_ring(rows: &[Vec<(u32, f64)>], edges: &[[u32; 2]], columns: usize) -> Vec<Vec<(u32, f64)>> {
    let mut from = vec![Vec::new(); rows.len()];
    for &[a, b] in edges {
        if (a as usize) < rows.len() && (b as usize) < rows.len() {
            from[a as usize].push(b as usize);
        }
    }
    let (mut sums, mut used) = (vec![0.0; columns], Vec::new());
    let ring = |(v, around): (usize, &Vec<usize>)| {
        if around.is_empty() {
            return rows[v].clone();
        }
        for &u in around {
            for &(c, p) in &rows[u] {
                if sums[c as usize] == 0.0 {
                    used.push(c);
                }
                sums[c as usize] += p;
            }
        }
        used.sort_unstable();
        let n = around.len() as f64;
        used.drain(..).map(|c| (c, std::mem::take(&mut sums[c as usize]) / n)).collect()
    };
    from.iter().enumerate().map(ring).collect()
}

/// The edges of triangles, each in both directions once: for Puppeteer's one-ring filter.
pub fn edges_of(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let sides = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]].map(|[a, b]| [[a, b], [b, a]]);
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(sides).flatten().filter(|[a, b]| a != b).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}
