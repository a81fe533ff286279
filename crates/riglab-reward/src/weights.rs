//! How much each reward counts in the total.

use std::fmt;

use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::Rewards;
use crate::rewards::COUNT;

/// The largest weight: sums of what is far larger lose their digits.
const MOST: f64 = 1e6;

/// The weight of each of [`Rewards::PARTS`]. Configs name them, as in `{ coverage = 5.0, motion = 0.0 }`; one that is not
/// named has its default. A list of all, in their order, as earlier configs have it, is read too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RewardWeights([f64; COUNT]);

impl RewardWeights {
    /// Of numbers in the order of [`Rewards::PARTS`].
    pub fn new(weights: [f64; COUNT]) -> Self {
        Self(weights)
    }

    /// As numbers in the order of [`Rewards::PARTS`].
    pub fn all(self) -> [f64; COUNT] {
        self.0
    }

    /// With their names.
    pub fn named(self) -> impl Iterator<Item = (&'static str, f64)> {
        Rewards::PARTS.iter().map(|part| part.name).zip(self.0)
    }

    /// Whether a reward counts that needs a rig with skin weights to judge.
    pub fn judge_weights(self) -> bool {
        Rewards::PARTS.iter().zip(self.0).any(|(part, weight)| part.of_weights && weight != 0.0)
    }

    pub(crate) fn validate(self) -> Result<(), (&'static str, String)> {
        if !self.0.iter().all(|w| (0.0..=MOST).contains(w)) || self.0 == [0.0; COUNT] {
            return Err(("weights", format!("weights lie between 0 and {MOST}, and one of them is above 0")));
        }
        Ok(())
    }
}

/// The paper's.
impl Default for RewardWeights {
    fn default() -> Self {
        Self(Rewards::PARTS.map(|part| part.weight))
    }
}

impl Serialize for RewardWeights {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut map = to.serialize_map(Some(COUNT))?;
        for (name, weight) in self.named() {
            map.serialize_entry(name, &weight)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for RewardWeights {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(Reader)
    }
}

struct Reader;

impl<'de> Visitor<'de> for Reader {
    type Value = RewardWeights;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = Rewards::PARTS.iter().map(|part| part.name).collect();
        write!(f, "a number for each of {}, by name", names.join(", "))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<RewardWeights, A::Error> {
        const NAMES: [&str; COUNT] = {
            let mut names = [""; COUNT];
            let mut k = 0;
            while k < COUNT {
                names[k] = Rewards::PARTS[k].name;
                k += 1;
            }
            names
        };
        let mut weights = RewardWeights::default();
        while let Some(name) = map.next_key::<String>()? {
            let at = NAMES.iter().position(|own| *own == name);
            let at = at.ok_or_else(|| A::Error::unknown_field(&name, &NAMES))?;
            weights.0[at] = map.next_value()?;
        }
        Ok(weights)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<RewardWeights, A::Error> {
        let mut weights = [0.0; COUNT];
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = list.next_element()?.ok_or_else(|| A::Error::invalid_length(k, &self))?;
        }
        match list.next_element::<f64>()? {
            Some(_) => Err(A::Error::invalid_length(COUNT + 1, &self)),
            None => Ok(RewardWeights(weights)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(json: &str) -> Result<RewardWeights, String> {
        serde_json::from_str(json).map_err(|e| e.to_string())
    }

    #[test]
    fn weights_are_told_by_name_and_the_others_are_the_papers() {
        assert_eq!(RewardWeights::default().all(), [5.0, 1.0, 1.0, 1.0]);
        assert_eq!(of("{\"motion\": 0, \"coverage\": 2.5}"), Ok(RewardWeights::new([2.5, 1.0, 1.0, 0.0])));
        assert_eq!(of("{}"), Ok(RewardWeights::default()));
        assert!(of("{\"movement\": 0}").unwrap_err().contains("`movement`, expected one of `coverage`"));
        let text = serde_json::to_string(&RewardWeights::default()).unwrap();
        assert_eq!(text, r#"{"coverage":5.0,"containment":1.0,"skinning":1.0,"motion":1.0}"#);
        assert_eq!(of(&text), Ok(RewardWeights::default()));
    }

    #[test]
    fn lists_of_earlier_configs_are_read() {
        assert_eq!(of("[5, 1, 0, 0]"), Ok(RewardWeights::new([5.0, 1.0, 0.0, 0.0])));
        for wrong in ["[5, 1, 0]", "[5, 1, 0, 0, 1]", "5"] {
            assert!(of(wrong).unwrap_err().contains("coverage, containment, skinning, motion, by name"), "{wrong}");
        }
    }

    #[test]
    fn weights_that_lose_all_digits_are_refused() {
        let of = |first: f64| RewardWeights::new([first, 0.0, 0.0, 0.0]).validate().map_err(|(_, said)| said);
        assert!(of(1.0).is_ok() && of(1e6).is_ok());
        for weight in [0.0, -1.0, 1e300, f64::INFINITY, f64::NAN] {
            assert!(of(weight).unwrap_err().contains("between 0 and 1000000"), "{weight}");
        }
    }

    #[test]
    fn whether_weights_are_judged_is_known() {
        assert!(RewardWeights::default().judge_weights());
        assert!(!RewardWeights::new([5.0, 1.0, 0.0, 0.0]).judge_weights());
    }
}
