//! Trained models as single files: tensors, settings, and what to know about them.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use riglab_nn::io;
use riglab_train::{State, unsound};
use serde::{Deserialize, Serialize};
use tch::Tensor;

/// The text of a file's head that says what it is.
const ABOUT: &str = "riglab";
const FORMAT: u32 = 1;
/// The auto-encoder's place among the tensors' names of a model that has one.
pub(crate) const SKIN: &str = "skin.";

/// What to know about a trained model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Card {
    /// A short name.
    pub name: String,
    /// Where in its training it stood.
    pub state: State,
    /// What it learned from, how good it is, its licence: Markdown.
    pub text: String,
}

impl Card {
    /// Of a run at a checkpoint; one that was exported or imported has what was known of it.
    pub fn of_run(run: &Path, state: &State) -> Self {
        let text = std::fs::read_to_string(run.join("card.md")).unwrap_or_default();
        Self { name: run.display().to_string(), state: state.clone(), text }
    }
}

#[derive(Serialize, Deserialize)]
struct About {
    format: u32,
    kind: String,
    card: Card,
    /// Settings as TOML.
    rig: String,
    /// Those of the auto-encoder, where the model has one.
    #[serde(default)]
    skin: String,
}

/// What a file holds.
pub struct Bundle {
    /// The task that the model is of.
    pub kind: String,
    /// What to know.
    pub card: Card,
    /// The task's settings as TOML.
    pub settings: String,
    /// Those of task `fsq_cvae`, where its model is in the file, too.
    pub skin: String,
    /// All tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
}

/// The task of the model in a file, as its head says it; `None` where that is no model of riglab.
pub fn kind(file: &Path) -> Option<String> {
    let head = io::Reader::open(file).ok()?;
    let about: serde_json::Value = serde_json::from_str(head.text(ABOUT)?).ok()?;
    Some(about["kind"].as_str()?.to_owned())
}

impl Bundle {
    /// The tensors whose names begin so, by the rest of their names, as 32-bit floats.
    pub fn below(&self, prefix: &str) -> BTreeMap<String, Tensor> {
        let own = self.tensors.iter().filter_map(|(n, t)| Some((n.strip_prefix(prefix)?, t)));
        own.map(|(n, t)| (n.to_string(), t.to_kind(tch::Kind::Float))).collect()
    }

    /// As a file's bytes.
    ///
    /// # Errors
    /// When a tensor is of a kind that files cannot hold.
    pub fn to_bytes(&self) -> Result<Vec<u8>, String> {
        let about = About {
            format: FORMAT,
            kind: self.kind.clone(),
            card: self.card.clone(),
            rig: self.settings.clone(),
            skin: self.skin.clone(),
        };
        let about = serde_json::to_string(&about).map_err(|e| e.to_string())?;
        let texts = HashMap::from([(ABOUT.to_string(), about)]);
        io::to_bytes_with(self.tensors.iter().map(|(n, t)| (n.as_str(), t)), Some(texts)).map_err(|e| e.to_string())
    }

    /// What [`Self::to_bytes`] made; `name` stands in messages.
    ///
    /// # Errors
    /// A sentence: what it is instead, or what is wrong with it.
    pub fn of_bytes(bytes: &[u8], name: &str) -> Result<Self, String> {
        let other = || {
            format!(
                "{name}: not a riglab model: give a folder that `riglab train` made, or a file made by `riglab checkpoint \
                 export` or `import`"
            )
        };
        let (tensors, texts) = io::from_bytes(bytes).map_err(|_| other())?;
        let about: About = texts.get(ABOUT).and_then(|t| serde_json::from_str(t).ok()).ok_or_else(other)?;
        if about.format != FORMAT {
            return Err(format!("{name}: format {}, this program reads format {FORMAT}", about.format));
        }
        if let Some((tensor, fault)) = tensors.iter().find_map(|(n, t)| Some((n, unsound(t)?))) {
            return Err(format!(
                "{name}: tensor `{tensor}` {fault}: its training diverged, or the file was changed; copy it again, or take \
                 another"
            ));
        }
        Ok(Self { kind: about.kind, card: about.card, settings: about.rig, skin: about.skin, tensors })
    }

    /// Numbers of tensors whose names start so, in all.
    pub fn numbers(&self, prefix: &str) -> usize {
        self.tensors.iter().filter(|(name, _)| name.starts_with(prefix)).map(|(_, t)| t.numel()).sum()
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;

    #[test]
    fn numbers_that_are_no_weights_are_refused() {
        let state = State { task: "t".into(), step: 0, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
        let read = |t: Tensor| {
            let card = Card { name: "m".into(), state: state.clone(), text: String::new() };
            let tensors = BTreeMap::from([("a.weight".to_string(), t)]);
            let bundle = Bundle { kind: "t".into(), card, settings: String::new(), skin: String::new(), tensors };
            Bundle::of_bytes(&bundle.to_bytes().unwrap(), "m.safetensors").map(|_| ())
        };
        assert_eq!(read(Tensor::ones([2], (Kind::Half, Device::Cpu))), Ok(()));
        let said = read(Tensor::from_slice(&[1.0f32, f32::NAN])).unwrap_err();
        assert!(said.contains("m.safetensors: tensor `a.weight` holds NaN"), "{said}");
        assert!(read(Tensor::from_slice(&[1i64])).unwrap_err().contains("whole numbers"));
    }
}
