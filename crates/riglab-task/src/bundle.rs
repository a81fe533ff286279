//! Trained models as single files: tensors, settings, and what to know about them.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Write;
use std::path::Path;

use riglab_nn::NnError;
use riglab_nn::io::{self, Reader};
use riglab_nn::params::Params;
use riglab_train::{State, unsound};
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

/// The text of a file's head that says what it is.
const ABOUT: &str = "riglab";
const FORMAT: u32 = 1;
/// The auto-encoder's place among the tensors' names of a model that has one.
pub const SKIN: &str = "skin.";
/// The place of the network that rigs.
pub const RIG: &str = "rig.";

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

/// What is written into a file.
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

impl Bundle {
    /// Writes it as a file's bytes, numbers as `kind`, a tensor at a time.
    ///
    /// # Errors
    /// Those of `out`, and a sentence for a kind that files cannot hold.
    pub fn write_to(&self, out: &mut impl Write, kind: Kind) -> std::io::Result<()> {
        let about = About {
            format: FORMAT,
            kind: self.kind.clone(),
            card: self.card.clone(),
            rig: self.settings.clone(),
            skin: self.skin.clone(),
        };
        let texts = HashMap::from([(ABOUT.to_string(), serde_json::to_string(&about)?)]);
        io::write_to(out, self.tensors.iter().map(|(n, t)| (n, t.shallow_clone())), Some(kind), Some(texts))
    }
}

/// The task of the model in a file, as its head says it; `None` where that is no model of riglab.
pub fn kind(file: &Path) -> Option<String> {
    let head = io::Reader::open(file).ok()?;
    let about: serde_json::Value = serde_json::from_str(head.text(ABOUT)?).ok()?;
    Some(about["kind"].as_str()?.to_owned())
}

/// A model's file, of which the head was read; tensors are read when they are loaded.
pub struct Stored {
    /// The task that the model is of.
    pub kind: String,
    /// What to know.
    pub card: Card,
    /// The task's settings as TOML.
    pub settings: String,
    /// Those of task `fsq_cvae`, where its model is in the file, too.
    pub skin: String,
    name: String,
    file: Reader,
}

impl Stored {
    /// Opens what [`Bundle::write_to`] wrote.
    ///
    /// # Errors
    /// A sentence: what it is instead, or what is wrong with it.
    pub fn open(path: &Path) -> Result<Self, String> {
        let name = path.display().to_string();
        // A file that is there and cannot be mapped, as an empty one, is no model.
        File::open(path).map_err(|e| format!("{name}: cannot be read ({e})"))?;
        Self::of(Reader::open(path), name)
    }

    /// As [`Self::open`], of a file that is part of the program; `name` stands in messages.
    ///
    /// # Errors
    /// None that a whole program gives.
    pub fn of_held(bytes: &'static [u8], name: &str) -> Result<Self, String> {
        Self::of(Reader::of_held(name, bytes), name.to_owned())
    }

    fn of(file: Result<Reader, NnError>, name: String) -> Result<Self, String> {
        let other = || {
            format!(
                "{name}: not a riglab model: give a folder that `riglab train` made, or a file made by `riglab checkpoint \
                 export` or `import`"
            )
        };
        let file = file.map_err(|_| other())?;
        let about: About = file.text(ABOUT).and_then(|t| serde_json::from_str(t).ok()).ok_or_else(other)?;
        if about.format != FORMAT {
            return Err(format!("{name}: format {}, this program reads format {FORMAT}", about.format));
        }
        Ok(Self { kind: about.kind, card: about.card, settings: about.rig, skin: about.skin, name, file })
    }

    /// Shapes of the tensors whose names begin so, by the rest of their names.
    fn shapes(&self, prefix: &str) -> BTreeMap<String, Vec<i64>> {
        let all = self.file.shapes().into_iter();
        all.filter_map(|(n, shape)| Some((n.strip_prefix(prefix)?.to_owned(), shape))).collect()
    }

    /// Numbers of tensors whose names begin so, in all.
    pub fn numbers(&self, prefix: &str) -> usize {
        self.shapes(prefix).values().map(|shape| shape.iter().product::<i64>() as usize).sum()
    }

    /// Reads the tensors whose names begin so into a network that has the rest of their names, one at a time.
    ///
    /// # Errors
    /// A sentence: tensors of another network, or numbers that are no weights.
    pub fn load(&self, prefix: &str, params: &Params) -> Result<(), String> {
        let loaded = params.load_each(&self.shapes(prefix), |own| self.read(&format!("{prefix}{own}")));
        loaded.map_err(|e| format!("{}: {e}", self.name))
    }

    /// A tensor by its whole name.
    ///
    /// # Errors
    /// Where there is none, or it holds numbers that are no weights.
    pub fn read(&self, tensor: &str) -> Result<Tensor, NnError> {
        let read = self.file.read(tensor)?;
        match unsound(&read) {
            None => Ok(read),
            Some(fault) => Err(NnError::Config(format!(
                "tensor `{tensor}` {fault}: its training diverged, or the file was changed; copy it again, or take another"
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use riglab_nn::params::{Builder, Init, Role};
    use tch::Device;

    use super::*;

    #[test]
    fn what_is_written_is_read_and_numbers_that_are_no_weights_are_refused() {
        let state = State { task: "t".into(), step: 7, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
        let mut builder = Builder::default();
        builder.root().sub("a").add("weight", Role::Vector, &[2], Init::Constant(0.0));
        let own = builder.finish(0, Kind::Float, Device::Cpu).unwrap();
        let read = |t: Tensor| {
            let card = Card { name: "m".into(), state: state.clone(), text: String::new() };
            let tensors = BTreeMap::from([("rig.a.weight".to_string(), t.shallow_clone())]);
            let bundle = Bundle { kind: "t".into(), card, settings: "s".into(), skin: String::new(), tensors };
            let mut bytes = Vec::new();
            bundle.write_to(&mut bytes, t.kind()).unwrap();
            let stored = Stored::of_held(bytes.leak(), "m.safetensors").unwrap();
            assert_eq!((stored.card.state.step, stored.settings.as_str()), (7, "s"));
            assert_eq!([stored.numbers("rig."), stored.numbers(""), stored.numbers("x")], [2, 2, 0]);
            stored.load("rig.", &own)
        };
        assert_eq!(read(Tensor::ones([2], (Kind::Half, Device::Cpu))), Ok(()));
        assert_eq!(own.weights().tensors()[0].double_value(&[1]), 1.0);
        let said = read(Tensor::from_slice(&[1.0f32, f32::NAN])).unwrap_err();
        assert!(said.contains("m.safetensors: tensor `rig.a.weight` holds NaN"), "{said}");
        assert!(read(Tensor::from_slice(&[1i64, 2])).unwrap_err().contains("whole numbers"));
    }

    #[test]
    fn what_is_no_model_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("m.safetensors");
        let said = |path: &Path| Stored::open(path).err().unwrap();
        assert!(said(&file).contains("m.safetensors: cannot be read ("), "{}", said(&file));
        for bytes in [&b""[..], b"no model"] {
            std::fs::write(&file, bytes).unwrap();
            assert!(said(&file).contains("m.safetensors: not a riglab model"), "{}", said(&file));
        }
    }
}
