//! How sure a mean is, and whether two systems differ.
//!
//! By resampling the assets, without assuming a distribution: errors of rigs are far from normal. What is random
//! comes from a stream of its own, so the same numbers give the same interval.

use rayon::prelude::*;
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};

/// Samples drawn for an interval.
const RESAMPLES: usize = 2_000;
/// Sign flips drawn for a test.
const SAMPLES: usize = 10_000;
/// Pairs up to which all signs are tried.
const EXACT: usize = 13;
/// Lists that share their draws, which take most of the time.
const TOGETHER: usize = 8;

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
        let finite = finite(values);
        let [interval] = bootstrap(&alone(&finite));
        Self::with(values.len(), finite, interval)
    }

    /// Of each of some lists: what [`Self::of`] gives one by one, in less time.
    pub fn of_each(lists: &[&[f64]]) -> Vec<Self> {
        let finite: Vec<Vec<f64>> = lists.iter().map(|values| finite(values)).collect();
        let intervals = together(&finite, bootstrap);
        let all = lists.iter().zip(finite).zip(intervals);
        all.map(|((values, finite), interval)| Self::with(values.len(), finite, interval)).collect()
    }

    /// Of the finite ones of so many values.
    fn with(count: usize, mut finite: Vec<f64>, (low, high): (f64, f64)) -> Self {
        let mean = mean(&finite);
        let squares: f64 = finite.iter().map(|v| (v - mean).powi(2)).sum();
        let n = finite.len();
        finite.sort_by(f64::total_cmp);
        Self {
            n,
            undefined: count - n,
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
        let differences = differences(a, b);
        let ([interval], [p]) = (bootstrap(&alone(&differences)), sign_flips(&alone(&differences)));
        Self::with(&differences, interval, p)
    }

    /// Of each of some pairs of lists: what [`Self::of`] gives one by one, in less time.
    pub fn of_each(pairs: &[(&[f64], &[f64])]) -> Vec<Self> {
        let differences: Vec<Vec<f64>> = pairs.iter().map(|(a, b)| differences(a, b)).collect();
        let found = together(&differences, bootstrap).into_iter().zip(together(&differences, sign_flips));
        differences.iter().zip(found).map(|(own, (interval, p))| Self::with(own, interval, p)).collect()
    }

    fn with(differences: &[f64], (low, high): (f64, f64), p: f64) -> Self {
        let larger = differences.iter().filter(|d| **d > 0.0).count();
        let equal = differences.iter().filter(|d| **d == 0.0).count();
        let smaller_equal_larger = [differences.len() - equal - larger, equal, larger];
        Self { n: differences.len(), difference: mean(differences), low, high, smaller_equal_larger, p }
    }
}

fn finite(values: &[f64]) -> Vec<f64> {
    values.iter().copied().filter(|v| v.is_finite()).collect()
}

/// Of pairs that are finite on both sides.
fn differences(a: &[f64], b: &[f64]) -> Vec<f64> {
    let pairs = a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite());
    pairs.map(|(a, b)| a - b).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// One list, as [`bootstrap`] and [`sign_flips`] take several.
fn alone(values: &[f64]) -> Vec<[f64; 1]> {
    values.iter().map(|v| [*v]).collect()
}

/// What is found of each list, on all threads. Lists of one length have the same draws: they are looked at together.
fn together<T: Copy + Send>(lists: &[Vec<f64>], find: fn(&[[f64; TOGETHER]]) -> [T; TOGETHER]) -> Vec<T> {
    let mut order: Vec<usize> = (0..lists.len()).collect();
    order.sort_by_key(|list| lists[*list].len());
    let alike = order.chunk_by(|a, b| lists[*a].len() == lists[*b].len());
    let groups: Vec<&[usize]> = alike.flat_map(|alike| alike.chunks(TOGETHER)).collect();
    let found = |group: &&[usize]| {
        let row = |k: usize| std::array::from_fn(|l| group.get(l).map_or(0.0, |list| lists[*list][k]));
        find(&(0..lists[group[0]].len()).map(row).collect::<Vec<_>>())
    };
    let found: Vec<[T; TOGETHER]> = groups.par_iter().map(found).collect();
    let mut out: Vec<(usize, T)> =
        groups.iter().zip(found).flat_map(|(group, of)| group.iter().copied().zip(of)).collect();
    out.sort_by_key(|(list, _)| *list);
    out.into_iter().map(|(_, of)| of).collect()
}

/// The middle 95 % of means of as many values drawn with repetition, of lists of one length: a row a place in them.
fn bootstrap<const L: usize>(rows: &[[f64; L]]) -> [(f64, f64); L] {
    if rows.len() < 2 {
        return [(f64::NAN, f64::NAN); L];
    }
    let mut random = stream(0, "metric/bootstrap", &[rows.len() as u64]);
    let mut means = [const { Vec::new() }; L];
    for _ in 0..RESAMPLES {
        let mut sums = [-0.0; L];
        (0..rows.len()).for_each(|_| add(&mut sums, &rows[random.below(rows.len())], 1.0));
        means.iter_mut().zip(sums).for_each(|(means, sum)| means.push(sum / rows.len() as f64));
    }
    means.map(|mut means: Vec<f64>| {
        means.sort_by(f64::total_cmp);
        let at = |share: f64| means[((RESAMPLES - 1) as f64 * share).round() as usize];
        (at(0.025), at(0.975))
    })
}

fn add<const L: usize>(sums: &mut [f64; L], row: &[f64; L], sign: f64) {
    sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += sign * value);
}

/// The share of sign flips with a sum as far from 0, of lists of one length: a row a place in them.
fn sign_flips<const L: usize>(rows: &[[f64; L]]) -> [f64; L] {
    let n = rows.len();
    if n == 0 {
        return [f64::NAN; L];
    }
    let observed = flipped(rows, |_| false).map(f64::abs);
    let mut reached = [0usize; L];
    let mut count = |sums: [f64; L]| {
        for ((reached, sum), observed) in reached.iter_mut().zip(sums).zip(observed) {
            // Rounding must not tell the observed signs from themselves.
            *reached += usize::from(sum.abs() >= observed * (1.0 - 1e-12));
        }
    };
    if n <= EXACT {
        let all = 1u32 << n;
        (0..all).for_each(|signs| count(flipped(rows, |k| signs >> k & 1 == 1)));
        return reached.map(|reached| reached as f64 / f64::from(all));
    }
    let mut random = stream(0, "metric/paired", &[n as u64]);
    let mut bits = vec![0u8; n.div_ceil(8)];
    for _ in 0..SAMPLES {
        random.bytes(&mut bits);
        count(flipped(rows, |k| bits[k / 8] >> (k % 8) & 1 == 1));
    }
    // The signs as they are count as one of the samples: never 0.
    reached.map(|reached| (reached + 1) as f64 / (SAMPLES + 1) as f64)
}

/// The sums with the signs of some places turned.
fn flipped<const L: usize>(rows: &[[f64; L]], is_turned: impl Fn(usize) -> bool) -> [f64; L] {
    let mut sums = [-0.0; L];
    rows.iter().enumerate().for_each(|(k, row)| add(&mut sums, row, if is_turned(k) { -1.0 } else { 1.0 }));
    sums
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
    fn many_lists_have_the_bits_that_each_has_alone() {
        let mut random = stream(3, "test", &[]);
        let mut list = |n: usize| (0..n).map(|_| f64::from(random.normal())).collect::<Vec<f64>>();
        let mut lists: Vec<Vec<f64>> = [40, 0, 1, 12, 40, 2].into_iter().map(&mut list).collect();
        lists.extend((0..10).map(|_| list(40)));
        lists[4][7] = f64::NAN;
        lists.push(vec![-0.0; 40]);
        let all: Vec<&[f64]> = lists.iter().map(Vec::as_slice).collect();
        let text = |found: &dyn std::fmt::Debug| format!("{found:?}");
        let one: Vec<Mean> = all.iter().map(|values| Mean::of(values)).collect();
        assert_eq!(text(&Mean::of_each(&all)), text(&one));
        let pairs: Vec<(&[f64], &[f64])> = all.iter().map(|values| (*values, all[6])).collect();
        let one: Vec<Paired> = pairs.iter().map(|(a, b)| Paired::of(a, b)).collect();
        assert_eq!(text(&Paired::of_each(&pairs)), text(&one));
        // What these draws have given ever since: results of others hang on them.
        let values: Vec<f64> = (0..20).map(|k| f64::from(k * k)).collect();
        let (m, p) =
            (Mean::of(&values), Paired::of(&values, &values.iter().map(|v| 0.9 * v + 8.0).collect::<Vec<_>>()));
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        let found = [m.low, m.high, p.low, p.high, p.p];
        found.into_iter().zip([76.0, 172.45, -0.4, 9.245, 1116.0 / 10_001.0]).for_each(|(a, b)| near(a, b));
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
