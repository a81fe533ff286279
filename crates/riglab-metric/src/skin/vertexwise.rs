//! Precision and recall by vertex: RigNet's and Anymate's figures.
//!
//! Both take a vertex' TP over its predicted (or true) active bones and then the mean over all vertices; one
//! without active bones adds 0 and counts.
//!
//! ```text
//! rignet    active > 1e-4; l1 sums over bones, mean over vertices
//! anymate   active >= 0.05; l1_matrix is the mean over all entries, l1 as above
//!           cosine          1 - mean over vertices of cos(w, ŵ)
//!           cosine_clamped  the same with max(ŵ - 0.001, 0)
//!           cross_entropy   mean over vertices of -Σ w ln(ŵ + 1e-6)
//! ```
//!
//! RigNet's threshold is from the paper as remembered; its evaluation of weights is not public.

use super::{Figures, Skins};
use crate::rows::both;

const RIGNET: f32 = 1e-4;
const ANYMATE: f32 = 0.05;
/// Smallest norm that cosines are divided by.
const LEAST_NORM: f64 = 1e-8;
const CLAMP: f64 = 0.001;
const EPSILON: f64 = 1e-6;

/// Means over vertices of precision and recall, and of the L1 summed over bones.
fn by_vertex(skins: &Skins, active: impl Fn(f32) -> bool) -> [f64; 3] {
    let (mut precision, mut recall, mut l1) = (0.0, 0.0, 0.0);
    for (w, p) in skins.truth.iter().zip(skins.predicted.iter()) {
        let (mut tp, mut found, mut wanted) = (0u32, 0u32, 0u32);
        both(w, p, |_, w, p| {
            l1 += (f64::from(w) - f64::from(p)).abs();
            let (a, b) = (active(w), active(p));
            tp += u32::from(a && b);
            found += u32::from(b);
            wanted += u32::from(a);
        });
        // TP is 0 where a denominator is.
        precision += f64::from(tp) / f64::from(found.max(1));
        recall += f64::from(tp) / f64::from(wanted.max(1));
    }
    [precision, recall, l1].map(|sum| sum / skins.truth.len() as f64)
}

pub(super) fn rignet(skins: &Skins) -> Figures {
    let [precision, recall, l1] = by_vertex(skins, |w| w > RIGNET);
    vec![("precision", precision), ("recall", recall), ("l1", l1)]
}

pub(super) fn anymate(skins: &Skins) -> Figures {
    let [precision, recall, l1] = by_vertex(skins, |w| w >= ANYMATE);
    let (mut cosine, mut clamped, mut entropy) = (0.0, 0.0, 0.0);
    for (w, p) in skins.truth.iter().zip(skins.predicted.iter()) {
        let (mut dot, mut dot_clamped, mut ww, mut pp, mut cc) = (0.0, 0.0, 0.0, 0.0, 0.0);
        both(w, p, |_, w, p| {
            let (w, p) = (f64::from(w), f64::from(p));
            let c = (p - CLAMP).max(0.0);
            dot += w * p;
            dot_clamped += w * c;
            ww += w * w;
            pp += p * p;
            cc += c * c;
            entropy -= w * (p + EPSILON).ln();
        });
        let norm = |x: f64| x.sqrt().max(LEAST_NORM);
        cosine += dot / (norm(ww) * norm(pp));
        clamped += dot_clamped / (norm(ww) * norm(cc));
    }
    let n = skins.truth.len() as f64;
    vec![
        ("precision", precision),
        ("recall", recall),
        ("l1_matrix", l1 / skins.truth.columns() as f64),
        ("l1", l1),
        ("cosine", 1.0 - cosine / n),
        ("cosine_clamped", 1.0 - clamped / n),
        ("cross_entropy", entropy / n),
    ]
}
