//! Joints in the middle of the cells that tokens name.

use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::Draft;
use crate::rules::{Fault, probability, range};

/// Moves joints to where the tokenizer's cells put them (`joint_discrete` of the public code).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DiscretiseConfig {
    /// How often.
    pub probability: f32,
    /// Cells along each axis; at least 1.
    pub cells: u32,
    /// From where to where they reach; joints outside move into the outermost cell.
    pub range: [f32; 2],
}

impl Default for DiscretiseConfig {
    fn default() -> Self {
        Self { probability: 0.0, cells: 256, range: [-1.0, 1.0] }
    }
}

impl DiscretiseConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        range("range", self.range, -1000.0, 1000.0)?;
        match self.cells > 0 && self.cells <= 1 << 20 && self.range[0] < self.range[1] {
            true => Ok(()),
            false => Err(("cells", format!("cells = {} over {:?}", self.cells, self.range))),
        }
    }

    /// Draws whether, and moves the joints.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if random.chance(self.probability) {
            draft.heads.as_flattened_mut().iter_mut().for_each(|x| *x = self.rounded(*x));
        }
    }

    /// The middle of the cell that a coordinate is rounded to. The public code rounds to the cells'
    /// edges, to even ones in the middle between two, and gives back middles: half a cell more on average.
    pub fn rounded(&self, x: f32) -> f32 {
        let ([low, high], cells) = (self.range, self.cells as f32);
        let cell = ((x - low) / (high - low) * cells).round_ties_even().clamp(0.0, cells - 1.0);
        (cell + 0.5) / cells * (high - low) + low
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_round_to_even_and_middles_come_back() {
        let config = DiscretiseConfig { cells: 4, ..DiscretiseConfig::default() };
        // Cells of 1/2: -1, -0.5, 0, 0.5.
        let pairs =
            [(-1.0, -0.75), (-0.75, -0.75), (-0.25, 0.25), (0.0, 0.25), (0.9, 0.75), (5.0, 0.75), (-5.0, -0.75)];
        for (x, wanted) in pairs {
            assert_eq!(config.rounded(x), wanted, "{x}");
        }
    }
}
