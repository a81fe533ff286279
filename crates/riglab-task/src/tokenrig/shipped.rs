//! The small model that comes with the program.

use tch::Device;

use super::{Card, Rigger};

/// Made by `riglab checkpoint export`; see the card in it, and `experiments/README.md`.
const TOKENRIG_SMALL: &[u8] = include_bytes!("../../assets/tokenrig_small.safetensors");

/// How `skin.run` calls that model's auto-encoder. Runs name it so, and their tokens are its codes: another auto-encoder
/// needs another word.
pub(crate) const SHIPPED: &str = "shipped";

impl Rigger {
    /// The model that is taken where no other is given.
    ///
    /// # Errors
    /// None that a whole program gives.
    pub fn shipped(device: Device) -> Result<(Self, Card), String> {
        Self::of_bundle(TOKENRIG_SMALL, "the model that comes with riglab", device)
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::TokenRigTaskConfig;
    use super::*;
    use crate::fsq_cvae::Frozen;

    #[test]
    fn its_auto_encoder_is_found_by_word_and_by_file() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("small.safetensors");
        std::fs::write(&file, TOKENRIG_SMALL).unwrap();
        let (whole, _) = Rigger::shipped(Device::Cpu).unwrap();
        let taken = |run: PathBuf| {
            let mut config = TokenRigTaskConfig::default();
            config.skin.run = run;
            Rigger::auto_encoder(&config, Device::Cpu)
        };
        for run in [PathBuf::from(SHIPPED), file] {
            let own: &Frozen = &taken(run).unwrap();
            assert_eq!(own.levels(), whole.vae.levels());
            for ((a, x), (b, y)) in own.tensors().iter().zip(whole.vae.tensors()) {
                assert!(*a == b && *x == y, "{a}");
            }
        }
        let said = taken(PathBuf::new()).err().unwrap();
        assert!(said.contains("skin.run=shipped"), "{said}");
    }
}
