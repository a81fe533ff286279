//! Coordinates as cells.

use serde::{Deserialize, Serialize};

/// How a coordinate becomes a cell, and back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// The cell that holds it, and its middle: no bias, at most half a cell of error.
    #[default]
    Centre,
    /// UniRig as released: the nearest cell edge in f32, and the middle of the cell above it. Comes back
    /// half a cell higher on average.
    RoundF32,
    /// SkinTokens as released: as [`Rule::RoundF32`], in f64.
    RoundF64,
    /// UniRig's paper: the cell that holds it, and its lower edge. Comes back half a cell lower.
    Floor,
}

/// Coordinates of `low..=high` as `bins` cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantiser {
    /// Cells.
    pub bins: u16,
    /// Least coordinate.
    pub low: f32,
    /// Greatest coordinate.
    pub high: f32,
    /// How.
    pub rule: Rule,
}

impl Quantiser {
    /// The cell of a coordinate. What is outside comes to the first or last cell, what is no number to the
    /// first.
    pub fn cell(&self, x: f64) -> u16 {
        let (low, high, bins) = (f64::from(self.low), f64::from(self.high), f64::from(self.bins));
        let cell = match self.rule {
            // `as` rounds down what is not negative, and `clamp` has seen to the rest: no call of `floor`.
            Rule::Centre | Rule::Floor => (x - low) / (high - low) * bins,
            Rule::RoundF64 => ((x - low) / (high - low) * bins).round_ties_even(),
            Rule::RoundF32 => {
                f64::from(((x as f32 - self.low) / (self.high - self.low) * f32::from(self.bins)).round_ties_even())
            }
        };
        // `as` saturates, and takes what is no number for 0.
        cell.clamp(0.0, bins - 1.0) as u16
    }

    /// The cells of a point.
    pub fn cells(&self, point: [f32; 3]) -> [u16; 3] {
        point.map(|x| self.cell(f64::from(x)))
    }

    /// Whether a coordinate is in the range.
    pub fn holds(&self, x: f32) -> bool {
        (self.low..=self.high).contains(&x)
    }

    /// The coordinate of a cell. Ids above the cells go on in the same steps, as the released decoders
    /// read them.
    pub fn coordinate(&self, cell: u32) -> f32 {
        let (span, bins) = (self.high - self.low, f32::from(self.bins));
        match self.rule {
            Rule::Floor => cell as f32 / bins * span + self.low,
            _ => (cell as f32 + 0.5) / bins * span + self.low,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_unbiased_and_keeps_what_it_gave() {
        let q = Quantiser { bins: 256, low: -1.0, high: 1.0, rule: Rule::Centre };
        let (mut sum, n) = (0.0, 10_001);
        for k in 0..n {
            let x = 2.0 * k as f32 / (n - 1) as f32 - 1.0;
            let back = q.coordinate(u32::from(q.cell(f64::from(x))));
            assert!((back - x).abs() <= 1.0 / 256.0 + 1e-6);
            sum += f64::from(back - x);
        }
        assert!((sum / n as f64).abs() < 1e-5);
        for cell in 0..256u16 {
            assert_eq!(q.cell(f64::from(q.coordinate(u32::from(cell)))), cell);
        }
        assert_eq!((q.cell(f64::NAN), q.cell(f64::NEG_INFINITY), q.cell(f64::INFINITY)), (0, 0, 255));
    }
}
