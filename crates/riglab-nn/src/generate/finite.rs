//! Scores of a network whose own weights are no numbers any more.

use std::fmt;

/// A network gave scores of which nothing can be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotFinite;

impl NotFinite {
    /// Refuses scores that are not finite; what is impossible may be -∞, but not all.
    pub(crate) fn refuse(scores: &[f32]) -> Result<(), Self> {
        let broken = |s: &f32| s.is_nan() || *s == f32::INFINITY;
        match scores.iter().any(broken) || !scores.iter().any(|s| s.is_finite()) {
            true => Err(Self),
            false => Ok(()),
        }
    }

    /// What was drawn, unless the network can draw nothing; other errors stay.
    ///
    /// # Errors
    /// Others than this one.
    pub fn unless<T>(drawn: Result<T, String>) -> Result<Option<T>, String> {
        match drawn {
            Ok(drawn) => Ok(Some(drawn)),
            Err(e) if e == Self.to_string() => Ok(None),
            Err(e) => Err(e),
        }
    }
}

impl fmt::Display for NotFinite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "the network gives no finite scores: its training diverged; lower train.optim.muon_lr and \
             train.optim.adamw_lr, and train anew",
        )
    }
}

impl std::error::Error for NotFinite {}

impl From<NotFinite> for String {
    fn from(e: NotFinite) -> Self {
        e.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Decoder, GenerateConfig, Grammar, argmax, rows};

    /// Gives these scores after the first token.
    struct Gives(Vec<f32>);

    impl Decoder for Gives {
        fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>> {
            vec![self.0.clone(); ids.len()]
        }

        fn select(&mut self, _: &[usize]) {}
    }

    /// Three tokens, of which the last ends.
    #[derive(Clone)]
    struct Three;

    impl Grammar for Three {
        fn allowed(&self) -> Vec<u64> {
            vec![0b111]
        }

        fn accept(&mut self, _: u32) {}

        fn ends(&self, id: u32) -> bool {
            id == 2
        }
    }

    #[test]
    fn nothing_is_drawn_by_what_are_no_numbers() {
        let of = |scores: [f32; 3]| {
            let (first, config) = (vec![vec![1.0, 0.0, 0.0]], GenerateConfig::default());
            rows(&mut Gives(scores.into()), first, vec![Three], &config, |_, _, scores| argmax(scores))
        };
        assert_eq!(of([0.0, f32::NEG_INFINITY, 1.0]), Ok(vec![vec![0, 2]]));
        for broken in [[0.0, f32::NAN, 1.0], [0.0, f32::INFINITY, 1.0], [f32::NEG_INFINITY; 3]] {
            assert_eq!(of(broken), Err(NotFinite), "{broken:?}");
        }
        assert!(NotFinite.to_string().contains("training diverged"));
    }

    #[test]
    fn what_else_goes_wrong_stays_an_error() {
        assert_eq!(NotFinite::unless(Ok(1)), Ok(Some(1)));
        assert_eq!(NotFinite::unless::<u8>(Err(NotFinite.into())), Ok(None));
        assert_eq!(NotFinite::unless::<u8>(Err("lost".into())), Err("lost".into()));
    }
}
