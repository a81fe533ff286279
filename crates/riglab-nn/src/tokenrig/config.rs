//! Sizes of TokenRig.

use serde::{Deserialize, Serialize};

use super::Head;
use crate::decoder::QwenConfig;
use crate::perceiver::PerceiverConfig;

/// The unified model of SkinTokens 3.3. The default is the release's; what goes beyond it is off there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TokenRigConfig {
    /// The shape encoder.
    pub shape: PerceiverConfig,
    /// The decoder.
    pub decoder: QwenConfig,
    /// How skin codes are scored.
    pub head: Head,
    /// Places that [`Head::Flat`] scores at once in a loss: the scores of a batch over the whole vocabulary are its
    /// largest tensors. What is scored in runs is scored again in the backward pass; sums differ by rounding. 0: all at
    /// once.
    pub scored_at_once: usize,
    /// Each code's place is told which joint it belongs to: where that and its parent are, and which of the
    /// bone's codes it is (an extension). Otherwise the network counts.
    pub tell_joint: bool,
    /// It is told as well what of the surface lies nearest to the joint's bones (an extension of `tell_joint`): where that
    /// is, how large, and its share of the whole.
    pub tell_region: bool,
    /// It is told as well the codes that the auto-encoder has for a rule's weights of all joints, by distance to their bones
    /// (an extension of `tell_joint`): an artist's are often like them, and where they are not, that is what there is to
    /// learn.
    pub tell_rule: bool,
    /// Each token of a skeleton is told where the last joint before it is, and the one before that, which is its parent or
    /// names it, and what is known of the one that is being written (an extension). Otherwise the network knows cells by
    /// number alone.
    pub tell_place: bool,
}

impl Default for TokenRigConfig {
    fn default() -> Self {
        let shape = PerceiverConfig { tokens: 512, layers: 8, ..PerceiverConfig::default() };
        Self {
            shape,
            decoder: QwenConfig::default(),
            head: Head::Flat,
            scored_at_once: 0,
            tell_joint: false,
            tell_region: false,
            tell_rule: false,
            tell_place: false,
        }
    }
}

impl TokenRigConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        self.shape.validate().map_err(|(key, text)| (format!("shape.{key}"), text))?;
        self.decoder.validate().map_err(|(key, text)| (format!("decoder.{key}"), text))?;
        if self.decoder.positions <= self.shape.tokens {
            let (positions, tokens) = (self.decoder.positions, self.shape.tokens);
            let text = format!("positions ({positions}) must be more than the {tokens} tokens of the shape");
            return Err(("decoder.positions".into(), text));
        }
        for (key, more) in [("tell_region", self.tell_region), ("tell_rule", self.tell_rule)] {
            if more && !self.tell_joint {
                return Err((key.into(), "tells more of the joint: set tell_joint = true beside it".into()));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_and_rules_are_told_beside_their_joints() {
        let of = |tell_joint, tell_region| TokenRigConfig { tell_joint, tell_region, ..TokenRigConfig::default() };
        assert_eq!(of(false, true).validate().unwrap_err().0, "tell_region");
        let rule = |tell_joint| TokenRigConfig { tell_joint, tell_rule: true, ..TokenRigConfig::default() };
        assert!(rule(false).validate().unwrap_err().0 == "tell_rule" && rule(true).validate().is_ok());
        assert!([(false, false), (true, false), (true, true)].iter().all(|&(a, b)| of(a, b).validate().is_ok()));
    }
}
