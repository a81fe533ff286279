//! Whether vertices are held, and by few bones.

use crate::RawWeights;

/// Shares of vertices with faults, for a limit β.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Faults {
    /// All weights are below β: nothing holds the vertex.
    pub unbound: f64,
    /// More than four weights are above β: more than glTF's usual influences.
    pub crowded: f64,
}

impl Faults {
    /// Counts them. A weight of exactly β counts for neither; without vertices there are none.
    pub fn of(weights: &RawWeights, beta: f64) -> Self {
        let (mut unbound, mut crowded) = (0usize, 0usize);
        for v in 0..weights.rows() {
            let (_, row) = weights.row(v);
            unbound += usize::from(row.iter().all(|w| *w < beta));
            crowded += usize::from(row.iter().filter(|w| **w > beta).count() > 4);
        }
        let n = weights.rows().max(1) as f64;
        Self { unbound: unbound as f64 / n, crowded: crowded as f64 / n }
    }
}

/// Skinning coverage and sparsity (SkinTokens 3.4.1):
///
/// ```text
/// R_sc = 1 - ½ R_z - ½ R_m,   R_z = z^α_z,   R_m = m^α_m
/// ```
///
/// with z the share of vertices whose weights are all below β, m that of vertices with more than four weights
/// above it; exponents below 1 make few faults count, their values were not published. 0 without vertices.
pub fn skinning(weights: &RawWeights, beta: f64, exponents: [f64; 2]) -> f64 {
    if weights.rows() == 0 {
        return 0.0;
    }
    let faults = Faults::of(weights, beta);
    1.0 - 0.5 * power(faults.unbound, exponents[0]) - 0.5 * power(faults.crowded, exponents[1])
}

/// Of a share; the same on every machine.
fn power(share: f64, exponent: f64) -> f64 {
    if share == 0.0 { 0.0 } else { libm::pow(share, exponent) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_itself_counts_for_neither() {
        let rows = [vec![(0, 0.1)], vec![], (0..5).map(|j| (j, 0.11)).collect(), (0..5).map(|j| (j, 0.1)).collect()];
        let weights = RawWeights::new(rows);
        assert_eq!(Faults::of(&weights, 0.1), Faults { unbound: 0.25, crowded: 0.25 });
        assert_eq!(skinning(&weights, 0.1, [0.5, 1.0]), 1.0 - 0.25 - 0.125);
        assert_eq!(skinning(&RawWeights::new([[(0, 1.0)]]), 0.1, [0.0, 0.0]), 1.0);
        assert_eq!(skinning(&RawWeights::default(), 0.1, [1.0; 2]), 0.0);
    }
}
