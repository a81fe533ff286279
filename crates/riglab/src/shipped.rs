//! The small model that comes with the program.

use riglab_task::tokenrig::{Card, Rigger};
use tch::Device;

/// Made by `riglab checkpoint export`; see the card in it, and `experiments/README.md`.
const TOKENRIG_SMALL: &[u8] = include_bytes!("../assets/tokenrig_small.safetensors");

/// The model that `riglab rig` takes where no other is given.
///
/// # Errors
/// None that a whole program gives.
pub fn rigger(device: Device) -> Result<(Rigger, Card), String> {
    Rigger::of_bundle(TOKENRIG_SMALL, "the model that comes with riglab", device)
}
