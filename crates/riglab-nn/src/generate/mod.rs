//! Sequences drawn from a decoder: greedy, by sampling, by beams, with the semantics of the field's
//! standard library (transformers), under a grammar.
//!
//! A [`Decoder`] gives scores, a [`Grammar`] says what may follow, and everything between is plain
//! arithmetic on the CPU: a row's result depends on its own scores and its own draws, so a batch equals
//! its members.

mod beams;
mod finite;
mod processors;
mod rows;

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

pub use beams::{BeamDraw, beams, best, best_of, chooser as beam_chooser, draws};
pub use finite::NotFinite;
pub use processors::{log_share, log_softmax, process, shares, softmax};
pub use rows::{argmax, chooser, draw, likely_rows, rows};

/// Temperatures that scores can be divided by: far below, they would pass what f32 holds and draws would keep to no
/// grammar; beyond, draws are as good as even over all that may follow.
pub const TEMPERATURES: RangeInclusive<f32> = 0.001..=100.0;
/// Likewise repetition penalties.
const PENALTIES: RangeInclusive<f32> = 0.01..=100.0;

/// Beams at most: each has keys and values of its own.
pub const MOST_BEAMS: usize = 256;

/// Whether a temperature can be drawn at.
///
/// # Errors
/// What it must be, to be put after its name.
pub fn drawable_at(temperature: f32) -> Result<(), String> {
    let (coolest, hottest) = TEMPERATURES.into_inner();
    if TEMPERATURES.contains(&temperature) {
        return Ok(());
    }
    Err(format!("{temperature} must lie in [{coolest}, {hottest}]"))
}

/// How sequences are drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateConfig {
    /// Tokens that are drawn at most, after the prompt.
    pub tokens: usize,
    /// Whether tokens are drawn, or the likeliest taken.
    pub sample: bool,
    /// Sequences kept beside each other, of which the best that ended counts; 1 is none.
    pub beams: usize,
    /// Scores are divided by it.
    pub temperature: f32,
    /// Only the so many likeliest tokens are drawn from; 0 takes all.
    pub top_k: usize,
    /// Only the likeliest tokens that together reach this probability are drawn from; 1 takes all.
    pub top_p: f32,
    /// Scores of tokens that were drawn before are divided by it where positive, multiplied where negative.
    pub repetition_penalty: f32,
}

impl Default for GenerateConfig {
    /// Greedy.
    fn default() -> Self {
        Self { tokens: 2048, sample: false, beams: 1, temperature: 1.0, top_k: 0, top_p: 1.0, repetition_penalty: 1.0 }
    }
}

impl GenerateConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        if self.tokens == 0 {
            return Err(("tokens", "tokens must be at least 1".into()));
        }
        if !(1..=MOST_BEAMS).contains(&self.beams) {
            return Err(("beams", format!("beams = {} must lie in [1, {MOST_BEAMS}]", self.beams)));
        }
        drawable_at(self.temperature).map_err(|why| ("temperature", format!("temperature = {why}")))?;
        if !(self.top_p > 0.0 && self.top_p <= 1.0) {
            return Err(("top_p", format!("top_p = {} must lie in (0, 1]", self.top_p)));
        }
        if !PENALTIES.contains(&self.repetition_penalty) {
            let (least, most) = PENALTIES.into_inner();
            let why = format!("{} must lie in [{least}, {most}]", self.repetition_penalty);
            return Err(("repetition_penalty", why));
        }
        Ok(())
    }

    /// Whether scores are changed before tokens are chosen by them, but for what the grammar forbids.
    pub fn changes(&self) -> bool {
        let plain = Self::default();
        let sampled = |config: &Self| (config.temperature, config.top_k, config.top_p);
        self.repetition_penalty != plain.repetition_penalty || self.sample && sampled(self) != sampled(&plain)
    }

    /// How a validation while training draws: the likeliest tokens where beams would be kept, which takes many times as long.
    #[must_use]
    pub fn while_training(&self) -> Self {
        if self.beams == 1 { self.clone() } else { Self { tokens: self.tokens, ..Self::default() } }
    }

    /// What it changes about what is drawn, so many for each prompt, in words: empty where nothing. What only tokens that
    /// are sampled hang on is left out where the likeliest are taken.
    pub fn draws(&self, each: usize) -> String {
        let plain = Self::default();
        let mut words = Vec::new();
        let mut say = |changed: bool, text: String| words.extend(changed.then_some(text));
        let drawn = self.sample || each > 1;
        say(self.beams > 1, format!("{} beams", self.beams));
        say(drawn && self.temperature != plain.temperature, format!("temperature {}", self.temperature));
        say(drawn && self.top_k != plain.top_k, format!("top-k {}", self.top_k));
        say(drawn && self.top_p != plain.top_p, format!("top-p {}", self.top_p));
        // The likeliest tokens are those of penalised scores, too.
        let penalty = self.repetition_penalty;
        say(penalty != plain.repetition_penalty, format!("repetition penalty {penalty}"));
        words.join(", ")
    }
}

/// Gives scores of what follows, for rows that go on together.
pub trait Decoder {
    /// Reads one token a row; gives each row's scores of the next.
    fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>>;

    /// Goes on with these rows, in this order; one may come several times.
    fn select(&mut self, rows: &[usize]);

    /// Scores of what follows a token of one row where that is known without reading it: the further parts of a
    /// token that is drawn in parts. `None` where the token has to be read, by [`Self::next`].
    fn within(&mut self, _row: usize, _id: u32) -> Option<Vec<f32>> {
        None
    }
}

/// Says what may follow in one row.
pub trait Grammar: Clone {
    /// The allowed ids, a bit each from the lowest on.
    fn allowed(&self) -> Vec<u64>;

    /// Takes the next token.
    fn accept(&mut self, id: u32);

    /// Whether this token ends a sequence.
    fn ends(&self, id: u32) -> bool;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_have_bounds() {
        let of = |beams| GenerateConfig { beams, ..GenerateConfig::default() }.validate().map_err(|(key, _)| key);
        assert_eq!([of(1), of(MOST_BEAMS)], [Ok(()); 2]);
        assert_eq!([of(0), of(MOST_BEAMS + 1)], [Err("beams"); 2]);
    }

    #[test]
    fn whatever_is_allowed_leaves_shares_that_can_be_drawn() {
        let at = |temperature, repetition_penalty| GenerateConfig {
            sample: true,
            temperature,
            repetition_penalty,
            ..GenerateConfig::default()
        };
        let (coolest, hottest) = TEMPERATURES.into_inner();
        for (temperature, penalty) in [(coolest, 0.01), (hottest, 100.0)] {
            let config = at(temperature, penalty);
            assert_eq!(config.validate(), Ok(()));
            // As large as bfloat16 leaves any sense in scores.
            let mut scores = [3e4, -3e4, 2.9e4, 3e4];
            process(&mut scores, &[0, 1], Some(&[0b0111]), &config, 1);
            let shares = softmax(&scores);
            let sum: f32 = shares.iter().sum();
            assert!(shares[3] == 0.0 && (sum - 1.0).abs() < 1e-6, "{shares:?}");
        }
        for no in [0.0, -1.0, 1e-40, 2e-38, 1e-4, 1e30, f32::INFINITY, f32::NAN] {
            assert_eq!(at(no, 1.0).validate().map_err(|(key, _)| key), Err("temperature"), "{no}");
            assert_eq!(at(1.0, no).validate().map_err(|(key, _)| key), Err("repetition_penalty"), "{no}");
        }
        assert_eq!(at(1e-4, 1.0).validate().unwrap_err().1, "temperature = 0.0001 must lie in [0.001, 100]");
    }

    fn plain_of(config: &GenerateConfig) -> GenerateConfig {
        GenerateConfig { tokens: config.tokens, ..GenerateConfig::default() }
    }

    #[test]
    fn changes_of_the_distribution_are_told_in_words() {
        let plain = GenerateConfig::default();
        assert_eq!(plain.draws(32), "");
        assert_eq!(GenerateConfig { sample: true, tokens: 9, ..plain.clone() }.draws(1), "");
        let cooler = GenerateConfig { temperature: 0.8, top_p: 0.95, ..plain };
        assert_eq!(cooler.draws(32), "temperature 0.8, top-p 0.95");
        assert_eq!(cooler.draws(1), "", "the likeliest");
        let beams = GenerateConfig { beams: 4, ..cooler };
        assert_eq!([beams.draws(1), beams.draws(2)], ["4 beams", "4 beams, temperature 0.8, top-p 0.95"]);
        assert_eq!(beams.while_training(), plain_of(&beams));
        let sampled = GenerateConfig { beams: 1, ..beams };
        assert_eq!(sampled.while_training(), sampled);
        let punished = GenerateConfig { repetition_penalty: 1.5, ..sampled };
        assert_eq!(punished.draws(1), "repetition penalty 1.5");
        assert_eq!(punished.draws(2), "temperature 0.8, top-p 0.95, repetition penalty 1.5");
    }
}
