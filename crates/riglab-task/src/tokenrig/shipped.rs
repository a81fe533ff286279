//! What comes trained with the program: the small model, and the auto-encoders that runs may stand on.

use std::path::Path;

use tch::Device;

use super::{Card, Rigger};
use crate::bundle::Stored;
use crate::fsq_cvae::Frozen;

/// Made by `riglab checkpoint export`; see the card in it, and `experiments/README.md`.
const TOKENRIG_SMALL: &[u8] = include_bytes!("../../assets/tokenrig_small.safetensors");
/// Its card, in place of the one in the file, which would have to be written anew for each word.
const CARD: &str = include_str!("../../assets/tokenrig_small.md");
/// The auto-encoder of the model that came with earlier versions.
const FSQ_CVAE_WITH_FRAMES: &[u8] = include_bytes!("../../assets/fsq_cvae_with_frames.safetensors");

/// How `skin.run` calls the auto-encoders that come with riglab: that of its model, which is told what geometry says, and
/// that of the one before. Runs name them so, and their tokens are its codes: another auto-encoder needs another word.
const WORDS: [(&str, &[u8]); 2] = [("shipped", FSQ_CVAE_WITH_FRAMES), (WITH_PRIOR, TOKENRIG_SMALL)];
pub(super) const WITH_PRIOR: &str = "shipped_with_prior";

impl Rigger {
    /// The model that is taken where no other is given.
    ///
    /// # Errors
    /// None that a whole program gives.
    pub fn shipped(device: Device) -> Result<(Self, Card), String> {
        let name = "the model that comes with riglab";
        let (model, card) = Self::of_stored(Stored::of_held(TOKENRIG_SMALL, name)?, name, device)?;
        Ok((model, Card { text: CARD.into(), ..card }))
    }
}

/// Whether `skin.run` names an auto-encoder by a word.
pub(crate) fn is_word(named: &Path) -> bool {
    WORDS.iter().any(|(own, _)| named == Path::new(own))
}

/// The auto-encoder that `skin.run` names by a word, if that is one.
pub(super) fn auto_encoder(word: &Path, device: Device) -> Option<Result<Frozen, String>> {
    let (own, bytes) = WORDS.into_iter().find(|(own, _)| word == Path::new(own))?;
    let name = format!("skin.run = {own}");
    Some(Stored::of_held(bytes, &name).and_then(|stored| Frozen::of_stored(&stored, &name, device)))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::sync::Arc;

    use tch::Kind;

    use super::super::TokenRigTaskConfig;
    use super::*;
    use crate::assets::Up;

    fn taken(run: impl Into<PathBuf>) -> Result<Arc<Frozen>, String> {
        let mut config = TokenRigTaskConfig::default();
        config.skin.run = run.into();
        Rigger::auto_encoder(&config, Device::Cpu)
    }

    #[test]
    fn its_auto_encoder_is_found_by_word_and_by_file() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("small.safetensors");
        std::fs::write(&file, TOKENRIG_SMALL).unwrap();
        let (whole, _) = Rigger::shipped(Device::Cpu).unwrap();
        for run in [PathBuf::from(WITH_PRIOR), file] {
            let own: &Frozen = &taken(run).unwrap();
            assert_eq!(own.levels(), whole.vae.levels());
            for ((a, x), (b, y)) in own.tensors().iter().zip(whole.vae.tensors()) {
                assert!(*a == b && *x == y, "{a}");
            }
        }
    }

    #[test]
    fn who_names_none_is_told_of_those_with_the_same_axis_up() {
        let of = |up| {
            let mut config = TokenRigTaskConfig::default();
            config.data.up = up;
            Rigger::auto_encoder(&config, Device::Cpu).err().unwrap()
        };
        let (y, z) = (of(Up::Y), of(Up::Z));
        assert!(y.contains("--set skin.run=shipped_with_prior takes") && !y.contains("checkpoint import"), "{y}");
        assert!(
            z.contains("--as fsq_cvae CHECKPOINT") && z.contains("--set data.up=z") && !z.contains(WITH_PRIOR),
            "{z}"
        );
    }

    /// Runs name them by a word and read nothing but their codes, which a word must never change.
    #[test]
    fn words_keep_their_auto_encoders() {
        for (word, prior, sum) in [("shipped", false, 3_883.824_451_446_533), (WITH_PRIOR, true, 3_751.076_764_404_774)]
        {
            let own = taken(word).unwrap();
            assert_eq!(own.config().model.extensions.prior, prior, "{word}");
            let all: f64 = own.tensors().iter().map(|(_, t)| t.sum(Kind::Double).double_value(&[])).sum();
            assert!((all - sum).abs() < 1e-6, "{word}: {all}");
        }
    }
}
