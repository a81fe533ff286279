//! Joints matched one to one, and the nearest of each.

use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;

/// Distances as whole numbers, which have an order: 2^-32 of a unit, up to 2^12 units, so that the sum over as many
/// joints as a skeleton can have fits.
const PARTS: f64 = (1u64 << 32) as f64;
const FARTHEST: f64 = (1u64 << 12) as f64;

/// Joints of the two sides that found each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matched {
    /// Pairs within the tolerance.
    pub pairs: usize,
    /// Joints predicted.
    pub predicted: usize,
    /// Joints of the truth.
    pub truth: usize,
}

impl Matched {
    /// 2 TP / (P + G), which RigNet calls IoU.
    pub fn dice(&self) -> f64 {
        2.0 * self.pairs as f64 / (self.predicted + self.truth) as f64
    }

    /// TP / P.
    pub fn precision(&self) -> f64 {
        self.pairs as f64 / self.predicted as f64
    }

    /// TP / G.
    pub fn recall(&self) -> f64 {
        self.pairs as f64 / self.truth as f64
    }

    /// TP / (P + G - TP).
    pub fn iou(&self) -> f64 {
        self.pairs as f64 / (self.predicted + self.truth - self.pairs) as f64
    }
}

/// The one-to-one assignment with the least sum of distances, and its pairs that are nearer than the tolerance of
/// the true joint; the last tolerance is that of all further joints.
///
/// O(n² m) for n joints on the smaller side: milliseconds for hundreds.
pub fn match_joints(predicted: &[[f64; 3]], truth: &[[f64; 3]], tolerances: &[f64]) -> Matched {
    let mut out = Matched { pairs: 0, predicted: predicted.len(), truth: truth.len() };
    let Some(last) = tolerances.last() else { return out };
    if predicted.is_empty() || truth.is_empty() {
        return out;
    }
    let tolerance = |g: usize| tolerances.get(g).unwrap_or(last);
    let swapped = predicted.len() > truth.len();
    let (rows, columns) = if swapped { (truth, predicted) } else { (predicted, truth) };
    let cost = Matrix::from_fn(rows.len(), columns.len(), |(r, c)| {
        (distance(rows[r], columns[c]).min(FARTHEST) * PARTS).round() as i64
    });
    let (_, assigned) = kuhn_munkres_min(&cost);
    let near = |&(r, &c): &(usize, &usize)| distance(rows[r], columns[c]) < *tolerance(if swapped { r } else { c });
    out.pairs = assigned.iter().enumerate().filter(near).count();
    out
}

/// The shares of joints predicted, and of true ones, whose nearest joint of the other side is within `tolerance`:
/// Anymate's precision and recall, without assignment.
pub fn nearest_shares(predicted: &[[f64; 3]], truth: &[[f64; 3]], tolerance: f64) -> [f64; 2] {
    let share = |from: &[[f64; 3]], to: &[[f64; 3]]| {
        from.iter().filter(|a| to.iter().any(|b| distance(**a, *b) < tolerance)).count() as f64 / from.len() as f64
    };
    [share(predicted, truth), share(truth, predicted)]
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    if d.is_finite() { d } else { FARTHEST }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> [f64; 3] {
        [x, 0.0, 0.0]
    }

    #[test]
    fn the_assignment_is_the_best_as_a_whole() {
        // By nearest first, 0.1 would go to 0.0 and 0.4 to 0.05 far off; as a whole both shift by one.
        let (predicted, truth) = ([at(0.1), at(0.0)], [at(0.04), at(-0.3)]);
        let m = match_joints(&predicted, &truth, &[0.07]);
        assert_eq!((m.pairs, m.precision(), m.dice()), (1, 0.5, 0.5));
        assert_eq!(nearest_shares(&predicted, &truth, 0.07), [1.0, 0.5]);
    }

    #[test]
    fn tolerances_are_those_of_the_true_joints() {
        let (few, many) = ([at(0.0)], [at(0.5), at(0.05), at(0.9)]);
        assert_eq!(match_joints(&few, &many, &[0.1, 0.01, 0.1]).pairs, 0);
        assert_eq!(match_joints(&few, &many, &[0.01, 0.1, 0.01]).pairs, 1);
        let m = match_joints(&many, &few, &[0.1]);
        assert_eq!((m.pairs, m.recall()), (1, 1.0));
        assert!((m.iou() - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn far_and_broken_positions_do_not_panic() {
        let m = match_joints(&[at(f64::NAN), at(1e300)], &[at(-1e300), at(0.0)], &[0.1]);
        assert_eq!(m.pairs, 0);
        assert!(match_joints(&[], &[at(0.0)], &[0.1]).precision().is_nan());
    }
}
