//! What commands need of a task besides training it.

use riglab_nn::params::Weights;
use riglab_report::{Block, Picture, Turned, Turntable};
use riglab_train::{At, Loss, LossOf, State, Task};
use serde::Serialize;
use tch::{Device, Kind, Tensor};

use crate::assets::Assets;

/// A task that is evaluated.
pub trait Experiment: Task {
    /// Its corpora.
    fn assets(&self) -> &Assets;

    /// Sentences that someone who trains should read first, such as what is left out.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// Why it cannot be trained on its corpora, though it may be evaluated on them.
    fn untrainable(&self) -> Option<String> {
        None
    }

    /// Why no training should begin with it, though one that was begun may go on.
    fn unfit(&self) -> Option<String> {
        None
    }

    /// Sentences for who goes on with a training, or evaluates what came of it, though none would begin so now.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    /// Networks that it computes with beside the trained one: the key that names each, and a checksum of its weights.
    fn companions(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// How many steps [`Self::examine`] tells of.
    ///
    /// # Errors
    /// A sentence.
    fn examination_steps(&self) -> Result<usize, String>;

    /// Evaluates weights on the test splits, with so many of the best and of the worst assets as pictures.
    ///
    /// # Errors
    /// A sentence.
    fn examine(
        &self,
        weights: &Weights,
        checkpoint: &State,
        pictures: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Examined, String>;
}

/// A checksum of a network's weights, whatever type they are stored in.
pub(crate) fn checksum<'a>(weights: impl Iterator<Item = (&'a str, Tensor)>) -> String {
    let mut hasher = blake3::Hasher::new();
    for (name, tensor) in weights {
        hasher.update(name.as_bytes());
        let flat = tensor.detach().to_kind(Kind::Float).to_device(Device::Cpu).contiguous().view([-1]);
        let values = Vec::<f32>::try_from(flat).unwrap_or_default();
        values.chunks(1 << 16).for_each(|part| {
            let bytes: Vec<u8> = part.iter().flat_map(|x| x.to_le_bytes()).collect();
            hasher.update(&bytes);
        });
    }
    hasher.finalize().to_hex().to_string()
}

/// A loss for threads beside each other, for [`Task::beside`]: on the CPU; another device does one thing at a time.
pub(crate) fn beside<B>(
    device: Device,
    loss: impl Fn(&Weights, &B, At) -> Result<Loss, String> + Send + 'static,
) -> Option<LossOf<B>> {
    (device == Device::Cpu).then(|| Box::new(loss) as LossOf<B>)
}

/// What an evaluation gives.
pub struct Examined {
    /// The file that reports are made from.
    pub json: String,
    /// Lines for a terminal.
    pub text: Vec<String>,
    /// Names and bytes of files: PNGs, views of the rigs beside them, what else a task has to show.
    pub pictures: Vec<(String, Vec<u8>)>,
}

/// What is shown of an asset beside its figures.
pub(crate) struct Sheet {
    /// A PNG file.
    pub png: Vec<u8>,
    /// The rigs, to be turned by a reader.
    pub view: Option<Turntable>,
}

impl Examined {
    /// Of lines for a terminal, sheets by what is said of them and its PNG's name, and the evaluation that is written of
    /// what is said.
    pub(crate) fn of<S, E: Serialize>(
        text: Vec<String>,
        sheets: Vec<(S, Sheet)>,
        png: impl Fn(&S) -> &String,
        evaluation: impl FnOnce(Vec<S>) -> E,
    ) -> Result<Self, String> {
        let (said, sheets): (Vec<S>, Vec<Sheet>) = sheets.into_iter().unzip();
        let mut pictures = Vec::new();
        for (sheet, name) in sheets.into_iter().zip(said.iter().map(png)) {
            let view = sheet.view.map(|view| (view_file(name), view.to_bytes().to_vec()));
            pictures.push((name.clone(), sheet.png));
            pictures.extend(view);
        }
        let json = serde_json::to_string_pretty(&evaluation(said)).map_err(|e| e.to_string())? + "\n";
        Ok(Self { json, text, pictures })
    }
}

/// The file of the view beside a PNG.
fn view_file(png: &str) -> String {
    format!("{}.view", png.strip_suffix(".png").unwrap_or(png))
}

/// The heading of what was found on some splits. Whether their assets were unseen is known of none: the splits are named.
pub(crate) fn of_splits<'a>(what: &str, splits: impl IntoIterator<Item = &'a str>) -> String {
    match splits.into_iter().collect::<Vec<_>>().as_slice() {
        [] => what.to_owned(),
        [split] => format!("{what} of the split {split}"),
        splits => format!("{what} of the splits {}", splits.join(", ")),
    }
}

/// Pictures, given by file and caption; those whose files are gone are left out.
pub(crate) fn pictures<'a>(
    shown: impl IntoIterator<Item = (&'a str, String)>,
    read: impl Fn(&str) -> Option<Vec<u8>>,
) -> Block {
    let picture = |(file, caption)| Some(Picture { caption, file: Some(String::from(file)), png: read(file)? });
    Block::Pictures(shown.into_iter().filter_map(picture).collect())
}

/// The views beside PNGs, given by file and caption; nothing where there are none, as in evaluations of older versions.
pub(crate) fn views<'a>(
    shown: impl IntoIterator<Item = (&'a str, String)>,
    read: impl Fn(&str) -> Option<Vec<u8>>,
) -> Option<Block> {
    let view =
        |(png, caption): (&str, String)| Some(Turned { caption, view: Turntable::from_bytes(read(&view_file(png))?)? });
    let found: Vec<Turned> = shown.into_iter().filter_map(view).collect();
    (!found.is_empty()).then_some(Block::Views(found))
}

/// The file of a sheet: its number, which no other has, and as much of the split as every file system takes.
pub(crate) fn sheet_file(number: usize, split: &str, why: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || c == '-' { c } else { '_' };
    let split: String = split.chars().take(LONGEST).map(plain).collect();
    format!("{number:02}-{split}-{why}.png")
}

/// Letters of a split in the name of a file.
const LONGEST: usize = 48;

/// Which places of a ranking of `n` are shown, and why: the first `each`, the middle, the last
/// `each`, none twice.
pub(crate) fn places(n: usize, each: usize) -> Vec<(&'static str, usize)> {
    let each = each.min(n.saturating_sub(1).div_ceil(2)).max(n.min(1));
    let worst = n - each.min(n);
    let mut out: Vec<(&str, usize)> = (0..each.min(n)).map(|k| ("best", k)).collect();
    if n / 2 >= each && n / 2 < worst {
        out.push(("median", n / 2));
    }
    out.extend((worst.max(each)..n).map(|k| ("worst", k)));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheets_have_names_that_can_be_written() {
        assert_eq!(sheet_file(3, "test_new", "best"), "03-test_new-best.png");
        assert_eq!(sheet_file(12, "test/../hard", "worst"), "12-test____hard-worst.png");
        assert!(sheet_file(1, &"\u{1f98a}é".repeat(400), "best").len() < 255);
    }

    #[test]
    fn headings_name_the_splits() {
        assert_eq!(of_splits("Skeletons", ["val"]), "Skeletons of the split val");
        assert_eq!(of_splits("Skeletons", ["test_seen", "test_new"]), "Skeletons of the splits test_seen, test_new");
        assert_eq!(of_splits("Skeletons", []), "Skeletons");
    }

    #[test]
    fn best_median_and_worst_are_shown_once_each() {
        assert_eq!(places(0, 2), []);
        assert_eq!(places(1, 2), [("best", 0)]);
        assert_eq!(places(2, 2), [("best", 0), ("worst", 1)]);
        assert_eq!(places(3, 2), [("best", 0), ("median", 1), ("worst", 2)]);
        assert_eq!(places(9, 2), [("best", 0), ("best", 1), ("median", 4), ("worst", 7), ("worst", 8)]);
    }
}
