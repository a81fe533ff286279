//! Means over seeds, and differences of two points seed by seed with what seeds alone would make of them.

use riglab_metric::statistics::Mean;

use crate::file::Better;

/// The mean of some numbers of seeds, and where the mean of many seeds lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spread {
    /// Seeds with a number.
    pub n: usize,
    /// Their mean; NaN without any.
    pub mean: f64,
    /// Standard deviation over seeds (n - 1); NaN for fewer than two.
    pub deviation: f64,
    /// 95 % interval of the mean by Student's t; NaN for fewer than two. Seeds are too few to be drawn again, as assets
    /// are.
    pub interval: (f64, f64),
}

impl Spread {
    /// Of a number a seed.
    pub fn of(values: &[f64]) -> Self {
        let Mean { n, mean, deviation, .. } = Mean::of(values);
        let half = if n > 1 { t(n - 1) * deviation / (n as f64).sqrt() } else { f64::NAN };
        Self { n, mean, deviation, interval: (mean - half, mean + half) }
    }

    /// Whether a difference is farther on the better side of 0 than seeds alone would bring it: its whole interval is there.
    /// Where seeds are missing, that of the seeds which both have may lie on the other side than that of the means.
    pub fn is_beyond_noise(&self, better: Better) -> bool {
        match better {
            Better::Higher => self.interval.0 > 0.0,
            Better::Lower => self.interval.1 < 0.0,
        }
    }
}

/// Between minus and plus this lie 95 % of Student's distribution.
fn t(freedom: usize) -> f64 {
    // As tables have them, up to where the series below is exact to four digits.
    const FEW: [f64; 10] = [12.7062, 4.3027, 3.1824, 2.7764, 2.5706, 2.4469, 2.3646, 2.3060, 2.2622, 2.2281];
    if let Some(value) = freedom.checked_sub(1).and_then(|k| FEW.get(k)) {
        return *value;
    }
    // Abramowitz and Stegun 26.7.5, from the normal distribution's 1.96.
    let (z, v) = (1.959_964_f64, freedom as f64);
    let first = (z.powi(3) + z) / 4.0;
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + first / v + second / v.powi(2) + third / v.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (freedom, value) in
            [(1, 12.706), (2, 4.303), (10, 2.228), (11, 2.201), (20, 2.086), (30, 2.042), (120, 1.980)]
        {
            assert!((t(freedom) - value).abs() < 6e-4, "{freedom}: {}", t(freedom));
        }
    }

    #[test]
    fn an_interval_takes_two_seeds_and_tells_noise() {
        let one = Spread::of(&[0.5]);
        assert!((one.n, one.mean) == (1, 0.5) && one.interval.0.is_nan() && !one.is_beyond_noise(Better::Higher));
        let noisy = Spread::of(&[0.1, 0.3]);
        assert!(noisy.interval.0 < 0.0 && noisy.interval.1 > 0.0 && !noisy.is_beyond_noise(Better::Higher));
        // Student's own: three differences of mean 0.2 and deviation 0.01.
        let sure = Spread::of(&[0.19, 0.20, 0.21]);
        assert!(
            (sure.interval.0 - (0.2 - 4.3027 * 0.01 / 3f64.sqrt())).abs() < 1e-9
                && sure.is_beyond_noise(Better::Higher)
        );
        assert!(!sure.is_beyond_noise(Better::Lower) && Spread::of(&[-0.19, -0.20]).is_beyond_noise(Better::Lower));
        assert!(Spread::of(&[]).mean.is_nan());
    }
}
