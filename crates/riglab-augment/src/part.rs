//! A part of the rig instead of all of it.

use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::delete::keep_part;
use crate::draft::Draft;
use crate::rules::{Fault, inside, probability};
use crate::select::close_upwards;

/// Keeps random joints, their ancestors and what they hold; the rest goes (`drop_part` of the public
/// code of UniRig and SkinTokens).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PartConfig {
    /// How often.
    pub probability: f32,
    /// How likely each joint is drawn to be kept; ancestors come on top. 0 to 1.
    pub keep: f32,
    /// Smallest share of the joints that must be left, or nothing is done. 0 to 1.
    pub at_least: f32,
}

impl Default for PartConfig {
    fn default() -> Self {
        Self { probability: 0.0, keep: 0.5, at_least: 0.25 }
    }
}

impl PartConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("keep", self.keep, 0.0, 1.0)?;
        inside("at_least", self.at_least, 0.0, 1.0)
    }

    /// Draws whether and which joints, and keeps these; nothing is done where none is drawn.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if !random.chance(self.probability) {
            return;
        }
        let mut keep: Vec<bool> = (0..draft.joints()).map(|_| random.chance(self.keep)).collect();
        if !keep.contains(&true) {
            return;
        }
        close_upwards(&mut keep, &draft.parents);
        let kept = keep.iter().filter(|k| **k).count();
        if kept as f32 >= self.at_least * keep.len() as f32 {
            keep_part(draft, &keep);
        }
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::{after, origins};

    #[test]
    fn parts_that_are_too_small_are_not_taken() {
        let config = PartConfig { probability: 1.0, keep: 0.1, at_least: 0.5 };
        let left = |k| origins(&after(|d| config.apply(d, &mut stream(1, "test", &[k])))).len();
        let left: Vec<usize> = (0..200).map(left).collect();
        assert!(left.iter().all(|n| *n >= 3) && left.iter().any(|n| *n < 6));
    }

    #[test]
    fn no_joint_drawn_is_no_part() {
        // The root alone would be enough.
        let config = PartConfig { probability: 1.0, keep: 0.0, at_least: 0.1 };
        assert_eq!(origins(&after(|d| config.apply(d, &mut stream(1, "test", &[])))), [0, 1, 2, 3, 4, 5]);
    }
}
