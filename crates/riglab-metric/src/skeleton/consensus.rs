//! Of several skeletons for one shape the one that the others agree with most.

use super::{Joints, SkeletonConvention};

/// What a pair counts that cannot be compared: more than any two skeletons in the cube are apart.
const FARTHEST: f64 = 3.0 * 1.8;

/// The medoid: the candidate whose J2J + J2B + B2B to the others ([`SkeletonConvention::Unirig`]) are the least on
/// average, the first of equals. Draws of a model being samples of what it believes, that is the candidate with the least
/// expected distance from the truth (minimum Bayes risk).
pub fn consensus(candidates: &[Joints]) -> Option<usize> {
    let n = candidates.len();
    let mut sums = vec![0.0; n];
    for a in 0..n {
        for b in a + 1..n {
            let d = SkeletonConvention::Unirig.distances(&candidates[a], &candidates[b]);
            let apart = d.j2j + d.j2b + d.b2b;
            let apart = if apart.is_finite() { apart } else { FARTHEST };
            sums[a] += apart;
            sums[b] += apart;
        }
    }
    (0..n).min_by(|&a, &b| sums[a].total_cmp(&sums[b]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain(length: f64, joints: usize) -> Joints {
        let positions = (0..joints).map(|k| [0.0, length * k as f64 / (joints - 1).max(1) as f64, 0.0]).collect();
        Joints { positions, parents: (0..joints).map(|k| k.checked_sub(1)).collect() }
    }

    #[test]
    fn the_one_in_the_middle_is_taken() {
        let candidates = [0.2, 1.0, 0.8, 0.9, 0.95].map(|length| chain(length, 4));
        assert_eq!(consensus(&candidates), Some(3));
        assert_eq!(consensus(&[chain(1.0, 3), chain(1.0, 3)]), Some(0), "the first of equals");
    }

    #[test]
    fn one_that_cannot_be_compared_is_taken_last() {
        assert_eq!(consensus(&[chain(1.0, 1), chain(0.3, 3), chain(1.0, 3)]), Some(1));
        assert_eq!(consensus(&[chain(1.0, 1)]), Some(0));
        assert_eq!(consensus(&[]), None);
    }
}
