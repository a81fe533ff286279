//! How sure a mean is, and whether two systems differ.
//!
//! By resampling the assets, without assuming a distribution: errors of rigs are far from normal. What is random
//! comes from a stream of its own, so the same numbers give the same interval.

use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};

/// Samples drawn for an interval.
const RESAMPLES: usize = 2_000;
/// Sign flips drawn for a test.
const SAMPLES: usize = 10_000;
/// Pairs up to which all signs are tried.
const EXACT: usize = 13;

/// A mean with what is needed to judge it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mean {
    /// Values it is of: those that are finite.
    pub n: usize,
    /// Values that are not: undefined, left out.
    pub undefined: usize,
    /// The mean; NaN without values.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub mean: f64,
    /// Standard deviation of the values (n - 1); NaN for fewer than two.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub deviation: f64,
    /// The middle value.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub median: f64,
    /// Lower end of the 95 % interval of the mean, by bootstrap over the values; NaN for fewer than two.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub low: f64,
    /// Its upper end.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub high: f64,
}

impl Mean {
    /// Of some values; those that are not finite are left out and counted.
    pub fn of(values: &[f64]) -> Self {
        let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        let (low, high) = bootstrap(&finite);
        let mean = mean(&finite);
        let squares: f64 = finite.iter().map(|v| (v - mean).powi(2)).sum();
        let n = finite.len();
        finite.sort_by(f64::total_cmp);
        Self {
            n,
            undefined: values.len() - n,
            mean,
            deviation: if n > 1 { (squares / (n - 1) as f64).sqrt() } else { f64::NAN },
            median: if n == 0 { f64::NAN } else { (finite[(n - 1) / 2] + finite[n / 2]) / 2.0 },
            low,
            high,
        }
    }
}

/// Two systems over the same assets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Assets where both values are finite.
    pub n: usize,
    /// Mean of a - b over them.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub difference: f64,
    /// Lower end of its 95 % interval.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub low: f64,
    /// Upper end.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub high: f64,
    /// Assets where a is smaller, where both are equal, where a is larger.
    pub smaller_equal_larger: [usize; 3],
    /// How often a difference so large would come about if a and b were interchangeable on every asset: the share of
    /// sign flips with a mean as far from 0. All flips up to 13 pairs, 10,000 drawn ones beyond.
    #[serde(deserialize_with = "crate::nan_for_null")]
    pub p: f64,
}

impl Paired {
    /// Compares value by value; what is undefined on a side is left out.
    pub fn of(a: &[f64], b: &[f64]) -> Self {
        let pairs = a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite());
        let differences: Vec<f64> = pairs.map(|(a, b)| a - b).collect();
        let larger = differences.iter().filter(|d| **d > 0.0).count();
        let equal = differences.iter().filter(|d| **d == 0.0).count();
        let (low, high) = bootstrap(&differences);
        Self {
            n: differences.len(),
            difference: mean(&differences),
            low,
            high,
            smaller_equal_larger: [differences.len() - equal - larger, equal, larger],
            p: sign_flips(&differences),
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The middle 95 % of means of as many values drawn with repetition.
fn bootstrap(values: &[f64]) -> (f64, f64) {
    if values.len() < 2 {
        return (f64::NAN, f64::NAN);
    }
    let mut random = stream(0, "metric/bootstrap", &[values.len() as u64]);
    let mut sample =
        || (0..values.len()).map(|_| values[random.below(values.len())]).sum::<f64>() / values.len() as f64;
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| sample()).collect();
    means.sort_by(f64::total_cmp);
    let at = |share: f64| means[((RESAMPLES - 1) as f64 * share).round() as usize];
    (at(0.025), at(0.975))
}

fn sign_flips(differences: &[f64]) -> f64 {
    let n = differences.len();
    if n == 0 {
        return f64::NAN;
    }
    let observed = differences.iter().sum::<f64>().abs();
    // Rounding must not tell the observed signs from themselves.
    let reaches = |sum: f64| sum.abs() >= observed * (1.0 - 1e-12);
    if n <= EXACT {
        let sum = |signs: u32| (0..n).map(|k| if signs >> k & 1 == 1 { -differences[k] } else { differences[k] }).sum();
        let all = 1u32 << n;
        return (0..all).filter(|&signs| reaches(sum(signs))).count() as f64 / f64::from(all);
    }
    let mut random = stream(0, "metric/paired", &[n as u64]);
    let mut bits = vec![0u8; n.div_ceil(8)];
    let reached = (0..SAMPLES).filter(|_| {
        random.bytes(&mut bits);
        let sign = |k: usize| if bits[k / 8] >> (k % 8) & 1 == 1 { -1.0 } else { 1.0 };
        reaches(differences.iter().enumerate().map(|(k, d)| sign(k) * d).sum())
    });
    // The signs as they are count as one of the samples: never 0.
    (reached.count() + 1) as f64 / (SAMPLES + 1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_counts_what_it_leaves_out() {
        let m = Mean::of(&[1.0, f64::NAN, 3.0, 8.0]);
        assert_eq!((m.n, m.undefined, m.mean, m.median), (3, 1, 4.0, 3.0));
        assert!((m.deviation - 13f64.sqrt()).abs() < 1e-12);
        assert!(Mean::of(&[]).mean.is_nan() && Mean::of(&[2.0]).low.is_nan());
    }

    #[test]
    fn the_interval_of_a_normal_sample_is_that_of_theory() {
        let mut random = stream(1, "test", &[]);
        let values: Vec<f64> = (0..400).map(|_| f64::from(random.normal())).collect();
        let m = Mean::of(&values);
        let half = 1.96 * m.deviation / 20.0;
        assert!((m.low - (m.mean - half)).abs() < 0.01 && (m.high - (m.mean + half)).abs() < 0.01, "{m:?}");
        assert_eq!(Mean::of(&values), m);
    }

    #[test]
    fn differences_that_all_point_one_way_are_told_from_chance() {
        let (a, b): (Vec<f64>, Vec<f64>) = (0..8).map(|k| (f64::from(k), f64::from(k) + 0.5)).unzip();
        let p = Paired::of(&a, &b);
        // Of 256 flips only all as they are and all turned reach it.
        assert_eq!((p.n, p.difference, p.p), (8, -0.5, 2.0 / 256.0));
        assert_eq!(p.smaller_equal_larger, [8, 0, 0]);
        assert_eq!(Paired::of(&a, &a).p, 1.0);
    }

    #[test]
    fn many_pairs_are_sampled_and_chance_looks_like_chance() {
        let mut random = stream(2, "test", &[]);
        let a: Vec<f64> = (0..200).map(|_| f64::from(random.normal())).collect();
        let b: Vec<f64> = (0..200).map(|_| f64::from(random.normal())).collect();
        let shifted: Vec<f64> = b.iter().map(|b| b + 0.6).collect();
        assert!(Paired::of(&a, &b).p > 0.05 && Paired::of(&a, &shifted).p < 0.001);
        assert!(Paired::of(&[f64::NAN], &[1.0]).p.is_nan());
    }
}
