//! The small model that comes with the program.

use tch::Device;

use super::{Card, Rigger};

/// Made by `riglab checkpoint export`; see the card in it, and `experiments/README.md`.
const TOKENRIG_SMALL: &[u8] = include_bytes!("../../assets/tokenrig_small.safetensors");

impl Rigger {
    /// The model that is taken where no other is given.
    ///
    /// # Errors
    /// None that a whole program gives.
    pub fn shipped(device: Device) -> Result<(Self, Card), String> {
        Self::of_bundle(TOKENRIG_SMALL, "the model that comes with riglab", device)
    }
}
