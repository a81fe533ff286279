//! The rewards that there are, by name.

use serde::{Deserialize, Serialize};

/// A reward of those that the total is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// What it is called in configs, logs and tables.
    pub name: &'static str,
    /// What it is called in the paper.
    pub symbol: &'static str,
    /// What it asks of a rig, in a few words.
    pub asks: &'static str,
    /// What it counts in the total where a config does not say: as in the paper.
    pub weight: f64,
    /// Whether it judges skin weights, and not only joints and bones.
    pub of_weights: bool,
    /// Settings ([`crate::RewardConfig`]) that say what it measures: under others it is another quantity.
    pub settings: &'static [&'static str],
}

/// How many there are.
pub(crate) const COUNT: usize = 4;

/// The rewards of a candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rewards {
    /// R_vj, see [`crate::coverage`].
    pub coverage: f64,
    /// R_vk, see [`crate::containment`].
    pub containment: f64,
    /// R_sc, see [`crate::skinning`].
    pub skinning: f64,
    /// R_mo, see [`crate::motion`].
    pub motion: f64,
    /// R = 5 R_vj + R_vk + R_sc + R_mo, by the config's weights.
    pub total: f64,
}

impl Rewards {
    /// All of them.
    pub const PARTS: [Part; COUNT] = [
        Part {
            name: "coverage",
            symbol: "R_vj",
            asks: "joints near all of the body",
            weight: 5.0,
            of_weights: false,
            settings: &["resolution", "alpha"],
        },
        Part {
            name: "containment",
            symbol: "R_vk",
            asks: "bones inside the body",
            weight: 1.0,
            of_weights: false,
            settings: &["resolution", "bone_steps"],
        },
        Part {
            name: "skinning",
            symbol: "R_sc",
            asks: "every vertex bound, to at most four bones",
            weight: 1.0,
            of_weights: true,
            settings: &["beta", "unbound_exponent", "crowded_exponent"],
        },
        Part {
            name: "motion",
            symbol: "R_mo",
            asks: "a surface that stays whole in poses",
            weight: 1.0,
            of_weights: true,
            settings: &["stretch_scale", "poses", "pose_degrees", "seed"],
        },
    ];

    /// Those of the parts, in their order, with their total by weights. What is not finite counts as 0.
    pub fn of(parts: [f64; COUNT], weights: [f64; COUNT]) -> Self {
        let parts = parts.map(|r| if r.is_finite() { r } else { 0.0 });
        let total = parts.iter().zip(weights).map(|(r, w)| r * w).sum();
        Self { total, ..Self::from_parts(parts) }
    }

    /// The parts, in their order.
    pub fn parts(&self) -> [f64; COUNT] {
        [self.coverage, self.containment, self.skinning, self.motion]
    }

    /// The mean of several; NaN of none.
    pub fn mean(all: &[Self]) -> Self {
        let n = all.len() as f64;
        let mean = |of: &dyn Fn(&Self) -> f64| all.iter().map(of).sum::<f64>() / n;
        let parts = std::array::from_fn(|k| mean(&|r| r.parts()[k]));
        Self { total: mean(&|r| r.total), ..Self::from_parts(parts) }
    }

    fn from_parts([coverage, containment, skinning, motion]: [f64; COUNT]) -> Self {
        Self { coverage, containment, skinning, motion, total: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_their_names_and_their_weights() {
        let all = Rewards::of([0.5, 0.25, f64::NAN, 1.0], [5.0, 1.0, 7.0, 2.0]);
        assert_eq!((all.parts(), all.total), ([0.5, 0.25, 0.0, 1.0], 4.75));
        // Files name them as logs do.
        let json = serde_json::to_value(all).unwrap();
        for (part, value) in Rewards::PARTS.iter().zip(all.parts()) {
            assert_eq!(json[part.name].as_f64(), Some(value), "{}", part.name);
        }
        assert_eq!(json.as_object().unwrap().len(), COUNT + 1);
    }

    #[test]
    fn every_setting_belongs_to_a_part_or_weighs_them() {
        let config = serde_json::to_value(crate::RewardConfig::default()).unwrap();
        let of_parts = Rewards::PARTS.iter().flat_map(|part| part.settings.iter().copied());
        let known: std::collections::BTreeSet<&str> = of_parts.chain(["weights"]).collect();
        let all: std::collections::BTreeSet<&str> = config.as_object().unwrap().keys().map(String::as_str).collect();
        assert_eq!(known, all);
    }

    #[test]
    fn means_are_of_each_part() {
        let weights = [1.0; COUNT];
        let all = [Rewards::of([0.0, 0.5, 1.0, 0.25], weights), Rewards::of([1.0, 0.5, 0.0, 0.75], weights)];
        assert_eq!(Rewards::mean(&all), Rewards::of([0.5; COUNT], weights));
        assert!(Rewards::mean(&[]).total.is_nan());
    }
}
