//! Precision against recall of weights, over all thresholds from which a weight counts as active.

use super::ACTIVE;

/// Steps of the threshold in a factor of two.
const FINE: f32 = 64.0;
/// Factors of two below 1 that are told apart; weights below are the last step.
const OCTAVES: f32 = 40.0;

/// Counts of predicted weights by size, where the true one is active and where it is not; see [`ACTIVE`].
///
/// Counts of assets add up to the pooled curve. Thresholds lie a hundredth apart, down to 1e-12.
#[derive(Clone, Debug)]
pub struct PrecisionRecall {
    /// By falling size.
    hits: Vec<u64>,
    misses: Vec<u64>,
    /// Truly active entries, those predicted as 0 among them.
    wanted: u64,
}

impl Default for PrecisionRecall {
    fn default() -> Self {
        let steps = (FINE * OCTAVES) as usize + 1;
        Self { hits: vec![0; steps], misses: vec![0; steps], wanted: 0 }
    }
}

impl PrecisionRecall {
    /// Adds entries: true weights and predicted ones, entry by entry.
    pub fn add(&mut self, truth: &[f32], predicted: &[f32]) {
        for (&w, &p) in truth.iter().zip(predicted) {
            let active = w > ACTIVE;
            self.wanted += u64::from(active);
            if p > 0.0 {
                let steps = self.hits.len();
                let at = ((-p.log2() * FINE).max(0.0) as usize).min(steps - 1);
                let counts = if active { &mut self.hits } else { &mut self.misses };
                counts[at] += 1;
            }
        }
    }

    /// The precision at the largest threshold whose recall is at least this; NaN where none is.
    pub fn precision_at(&self, recall: f64) -> f64 {
        if self.wanted == 0 || recall.is_nan() {
            return f64::NAN;
        }
        let (mut hits, mut all) = (0u64, 0u64);
        for (hit, miss) in self.hits.iter().zip(&self.misses) {
            hits += hit;
            all += hit + miss;
            if all > 0 && hits as f64 >= recall * self.wanted as f64 {
                return hits as f64 / all as f64;
            }
        }
        f64::NAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_threshold_falls_until_the_recall_is_there() {
        let mut curve = PrecisionRecall::default();
        let truth = [1.0, 0.0, 0.5, 0.5, 0.0, 0.02, 0.0, 0.0];
        let predicted = [0.9, 0.1, 0.8, 0.05, 0.15, 0.0, 1e-20, 0.0];
        curve.add(&truth, &predicted);
        // Four are active, one of them never found.
        assert_eq!(curve.precision_at(0.25), 1.0);
        assert_eq!(curve.precision_at(0.5), 1.0);
        assert_eq!(curve.precision_at(0.51), 3.0 / 5.0);
        assert_eq!(curve.precision_at(0.75), 3.0 / 5.0);
        assert!(curve.precision_at(0.76).is_nan() && curve.precision_at(f64::NAN).is_nan());
        assert!(PrecisionRecall::default().precision_at(0.0).is_nan());
        // Twice the same is the same.
        curve.add(&truth, &predicted);
        assert_eq!(curve.precision_at(0.51), 3.0 / 5.0);
    }
}
