//! Joints that vanish from their chain: their children hang on the joint above, which holds their
//! vertices, too.

use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::Draft;
use crate::rules::{Colliders, Fault, inside, probability};

/// Connects joints to new parents: those in between vanish, and their weights go to the nearest
/// ancestor that is left (SkinTokens, 4.1.2: probability 0.5, up to 0.3, for the auto-encoder only;
/// `collapse` of the public code of SkinTokens and UniRig). The mesh stays as it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReconnectConfig {
    /// How often.
    pub probability: f32,
    /// Share of the joints that vanish, or how likely each does. 0 to 1.
    pub share: f32,
    /// Draws the share anew each time, from 0 up to `share`, and takes that many joints; else each
    /// joint vanishes with probability `share`, as in the public code.
    pub up_to: bool,
}

impl Default for ReconnectConfig {
    fn default() -> Self {
        Self { probability: 0.0, share: 0.3, up_to: true }
    }
}

impl ReconnectConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("share", self.share, 0.0, 1.0)
    }

    /// Draws whether and which joints, and takes them out.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if !random.chance(self.probability) {
            return;
        }
        let joints = draft.joints();
        let keep = if self.up_to {
            let mut order: Vec<usize> = (1..joints).collect();
            random.shuffled(&mut order);
            let count = (joints as f32 * self.share * random.unit()) as usize;
            let mut keep = vec![true; joints];
            order.iter().take(count).for_each(|&j| keep[j] = false);
            keep
        } else {
            (0..joints).map(|_| !random.chance(self.share)).collect()
        };
        reconnect(draft, &keep);
    }
}

/// Keeps the joints that are marked, and the root; weights and children of the others go to the
/// nearest ancestor that is kept.
pub fn reconnect(draft: &mut Draft, keep: &[bool]) {
    draft.keep_joints(keep, Colliders::Stay);
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::{after, chain, origins};

    #[test]
    fn the_mesh_stays_and_no_more_joints_vanish_than_asked() {
        let config = ReconnectConfig { probability: 1.0, share: 0.5, up_to: true };
        let done = |config: &ReconnectConfig, k| after(|d| config.apply(d, &mut stream(1, "test", &[k])));
        let all: Vec<_> = (0..100).map(|k| done(&config, k)).collect();
        assert!(all.iter().all(|r| r.rig.mesh() == chain().mesh() && origins(r).len() >= 4));
        assert!(all.iter().any(|r| origins(r).len() == 4));
        let each = ReconnectConfig { up_to: false, ..config };
        let mean = (0..200).map(|k| origins(&done(&each, k)).len() as f32).sum::<f32>() / 200.0;
        assert!((mean - 3.5).abs() < 0.3, "{mean}");
    }
}
