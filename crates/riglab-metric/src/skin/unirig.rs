//! UniRig's figures of skin weights, as its training code logs them.
//!
//! w true, ŵ predicted, N vertices, J bones, d = |w - ŵ| in f64:
//!
//! ```text
//! l1, l2, smooth_l1   means over all N·J entries; the last is d²/2 below 1, d - 1/2 above
//! bce                 mean of -(w ln(ŵ + 1e-6) + (1 - w) ln(1 - ŵ + 1e-6))
//! iou_T               per bone (∩ + 0.001) / (∪ + 0.001) of entries above T, mean over bones; bones that
//!                     neither side uses have 1
//! mask_T              share of entries with d < T
//! zero_l1, nonzero_l1 per bone the mean of d over entries with w below, not below 1e-6; summed over bones / J
//! ```

use super::{Figures, Skins};
use crate::rows::both;

const ACTIVE: [f64; 3] = [0.1, 0.01, 0.001];
const CLOSE: [f64; 4] = [0.001, 0.005, 0.01, 0.05];
const SMOOTH: f64 = 0.001;
const EPSILON: f64 = 1e-6;
/// True weights below this are zeros.
const ZERO: f64 = 1e-6;

/// Of each bone.
#[derive(Clone, Copy, Default)]
struct Bone {
    both: [u32; 3],
    any: [u32; 3],
    zero: f64,
    nonzero: f64,
    nonzeros: u32,
}

pub(super) fn figures(skins: &Skins) -> Figures {
    let (truth, predicted) = (skins.truth, skins.predicted);
    let (mut l1, mut l2, mut smooth, mut bce) = (0.0, 0.0, 0.0, 0.0);
    let (mut close, mut stored) = ([0u64; 4], 0u64);
    let mut bones = vec![Bone::default(); truth.columns()];
    for (w, p) in truth.iter().zip(predicted.iter()) {
        both(w, p, |j, w, p| {
            let (w, p) = (f64::from(w), f64::from(p));
            let d = (w - p).abs();
            stored += 1;
            l1 += d;
            l2 += d * d;
            smooth += if d < 1.0 { 0.5 * d * d } else { d - 0.5 };
            bce -= w * (p + EPSILON).ln() + (1.0 - w) * (1.0 - p + EPSILON).ln();
            close.iter_mut().zip(CLOSE).for_each(|(n, t)| *n += u64::from(d < t));
            let bone = &mut bones[j];
            for (k, t) in ACTIVE.into_iter().enumerate() {
                bone.both[k] += u32::from(w > t && p > t);
                bone.any[k] += u32::from(w > t || p > t);
            }
            if w < ZERO {
                bone.zero += d;
            } else {
                bone.nonzero += d;
                bone.nonzeros += 1;
            }
        });
    }
    // Entries that are 0 on both sides.
    let size = truth.size() as u64;
    bce -= (size - stored) as f64 * (1.0 + EPSILON).ln();
    let (n, count, vertices) = (size as f64, bones.len() as f64, truth.len() as f64);
    let iou = |k: usize| {
        let of = |b: &Bone| (f64::from(b.both[k]) + SMOOTH) / (f64::from(b.any[k]) + SMOOTH);
        bones.iter().map(of).sum::<f64>() / count
    };
    let mask = |k: usize| (close[k] + size - stored) as f64 / n;
    let mean = |sum: f64, of: f64| if of > 0.0 { sum / of } else { 0.0 };
    let zero = bones.iter().map(|b| mean(b.zero, vertices - f64::from(b.nonzeros))).sum::<f64>() / count;
    let nonzero = bones.iter().map(|b| mean(b.nonzero, f64::from(b.nonzeros))).sum::<f64>() / count;
    vec![
        ("l1", l1 / n),
        ("l2", l2 / n),
        ("smooth_l1", smooth / n),
        ("bce", bce / n),
        ("iou_100", iou(0)),
        ("iou_010", iou(1)),
        ("iou_001", iou(2)),
        ("mask_001", mask(0)),
        ("mask_005", mask(1)),
        ("mask_010", mask(2)),
        ("mask_050", mask(3)),
        ("zero_l1", zero),
        ("nonzero_l1", nonzero),
    ]
}
