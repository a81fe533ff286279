//! The true rigs.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use riglab_asset::{ImportOptions, Resample, count_assets, import, import_each, is_rig_file};
use riglab_core::Asset;
use riglab_data::{Corpus, DataError, name_below};
use riglab_report::counted;

use crate::CompareError;
use crate::corpora::corpus_at;
use crate::keys::is_stage;
use crate::rows::Unread;

/// Rigs held at a time.
const AT_ONCE: usize = 64;

/// A name, and the asset or what is wrong with its file.
pub type Named = (String, Result<Asset, String>);

/// Where true rigs are from.
pub enum TruthSource {
    /// Assets of a corpus, by number.
    Corpus(Box<Corpus>, Vec<usize>),
    /// Files of one asset each or of several.
    Files(Vec<PathBuf>),
}

/// The true rigs, one after another.
pub struct Truths {
    path: PathBuf,
    /// Where they are from.
    pub source: TruthSource,
    /// What below the folder is no true rig: folders and links that could not be followed, and what UniRig's stages predict;
    /// with the reason.
    pub unread: Unread,
    /// What else was left aside, a sentence each: meshes without a rig, what is hidden, predictions.
    pub notes: Vec<String>,
    /// Assets of the corpus that are not asked for: those of its other splits, and after these bare meshes.
    pub(crate) elsewhere: Vec<String>,
    /// How many of these are of other splits.
    pub(crate) of_splits: usize,
}

impl Truths {
    /// A corpus (a split of it, if one is named), a folder of rigged files, or a file.
    ///
    /// # Errors
    /// When there is none, no such split, or no splits at all.
    pub fn open(path: &Path, split: Option<&str>) -> Result<Self, CompareError> {
        let at = |source| Self {
            path: path.into(),
            source,
            unread: Unread::new(),
            notes: Vec::new(),
            elsewhere: Vec::new(),
            of_splits: 0,
        };
        if let Some(corpus) = corpus_at(path)? {
            let Chosen { assets, mut others, bare } = chosen(&corpus, split)?;
            let of_splits = others.len();
            let notes = bare_left_out(path, bare.len()).into_iter().collect();
            others.extend(bare);
            let source = TruthSource::Corpus(Box::new(corpus), assets);
            return Ok(Self { elsewhere: others, of_splits, notes, ..at(source) });
        }
        if !path.exists() {
            return Err(DataError::Missing(path.into(), "corpus or folder").into());
        }
        if split.is_some() {
            return Err(CompareError::NoSplits(path.into()));
        }
        if path.is_file() {
            return Ok(at(TruthSource::Files(vec![path.into()])));
        }
        let found = riglab_files::below(path, is_rig_file);
        let notes = found.left_aside().into_iter().collect();
        let is_of_a_stage = |file: &PathBuf| is_stage(file) && holds_one(file);
        let (stages, files): (Vec<PathBuf>, Vec<PathBuf>) = found.files.into_iter().partition(is_of_a_stage);
        if files.is_empty() {
            let but = if stages.is_empty() { "" } else { " but what UniRig's stages predict, each a part of a rig" };
            return Err(CompareError::NoTruth(path.into(), format!(": no rigged file below it{but}")));
        }
        let mut unread: Unread = found.unread.iter().map(|(own, why)| (name_below(path, own), why.clone())).collect();
        unread.extend(stages.iter().map(|own| (name_below(path, own), STAGE.to_owned())));
        Ok(Self { unread, notes, ..at(TruthSource::Files(files)) })
    }

    /// Leaves out what lies in the folders, or is one of the files, that systems are from, where these are below the folder of
    /// true rigs, be it by a link: predictions are nobody's truth. A note says so. Links to single files of systems that lie
    /// elsewhere stay: whoever puts true rigs together from them means them.
    ///
    /// # Errors
    /// When there is nothing else.
    pub fn leave_out<'a>(&mut self, systems: impl IntoIterator<Item = &'a Path>) -> Result<(), CompareError> {
        let real = |path: &Path| path.canonicalize().ok();
        let (TruthSource::Files(files), Some(folder)) = (&mut self.source, real(&self.path)) else { return Ok(()) };
        // The folder itself, or one that it lies in, is compared with itself.
        let others = systems.into_iter().filter_map(|system| Some((system, real(system)?)));
        let others: Vec<(&Path, PathBuf)> = others.filter(|(_, own)| !folder.starts_with(own)).collect();
        if others.is_empty() {
            return Ok(());
        }
        let places = places(files);
        let mut stays = vec![true; files.len()];
        for (system, own) in others {
            let is_below = own.starts_with(&folder);
            let mut count = 0;
            for (stays, place) in stays.iter_mut().zip(&places).filter(|(stays, _)| **stays) {
                let of_file = if is_below { &place.leads } else { &place.lies };
                *stays = !of_file.starts_with(&own);
                count += usize::from(!*stays);
            }
            let left_out = match count {
                0 => continue,
                n => counted(n, "file"),
            };
            let shown = system.display();
            if !stays.contains(&true) {
                let why = format!(": all that is below it are the predictions in {shown}");
                return Err(CompareError::NoTruth(self.path.clone(), why));
            }
            self.notes.push(format!("no true rigs, but predictions: {left_out} in {shown}"));
        }
        let mut stays = stays.into_iter();
        files.retain(|_| stays.next().unwrap_or(true));
        Ok(())
    }

    /// The corpus or folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many assets there are, as far as can be told without reading them: files of several count once.
    pub fn len(&self) -> usize {
        match &self.source {
            TruthSource::Corpus(_, assets) => assets.len(),
            TruthSource::Files(files) => files.len(),
        }
    }

    /// Whether there is none; there never is.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Their names, as far as they are known without reading them: a file of several counts as one of its own name.
    pub(crate) fn names(&self) -> Result<Vec<String>, CompareError> {
        Ok(match &self.source {
            TruthSource::Corpus(corpus, assets) => {
                let names = corpus.names()?;
                assets.iter().map(|&k| names[k].clone()).collect()
            }
            TruthSource::Files(files) => files.iter().map(|file| name_below(self.folder(), file)).collect(),
        })
    }

    /// Those of [`Self::names`] that are an asset's.
    pub(crate) fn names_of_assets(&self) -> Result<Vec<String>, CompareError> {
        let mut names = self.names()?;
        if let TruthSource::Files(files) = &self.source {
            let mut one = files.iter().map(|file| holds_one(file));
            names.retain(|_| one.next().unwrap_or(true));
        }
        Ok(names)
    }

    /// Whether [`Self::names`] has each asset: no file holds several.
    pub(crate) fn are_named(&self) -> bool {
        match &self.source {
            TruthSource::Corpus(..) => true,
            TruthSource::Files(files) => files.iter().all(|file| holds_one(file)),
        }
    }

    /// What files have their names below.
    fn folder(&self) -> &Path {
        if self.path.is_file() { self.path.parent().unwrap_or(Path::new("")) } else { &self.path }
    }

    /// Gives all of them, some at a time, until it is told to stop: a name, and the asset, with the clips that the corpus or
    /// file has, or what is wrong with its file.
    pub fn each(&self, mut give: impl FnMut(Vec<Named>) -> ControlFlow<()>) {
        let _ = self.some(&mut give);
    }

    fn some(&self, give: &mut dyn FnMut(Vec<Named>) -> ControlFlow<()>) -> ControlFlow<()> {
        match &self.source {
            TruthSource::Corpus(corpus, assets) => {
                for some in assets.chunks(AT_ONCE) {
                    let read = |&index: &usize| match corpus.asset(index) {
                        Ok(asset) => (asset.name.clone(), Ok(asset)),
                        Err(e) => (format!("asset {index}"), Err(e.to_string())),
                    };
                    give(some.iter().map(read).collect())?;
                }
            }
            TruthSource::Files(files) => {
                let folder = self.folder();
                for some in files.chunks(AT_ONCE) {
                    let one = |path: &PathBuf| holds_one(path).then(|| single(folder, path));
                    let read: Vec<Option<Named>> = some.par_iter().map(one).collect();
                    let several: Vec<&PathBuf> =
                        some.iter().zip(&read).filter(|(_, r)| r.is_none()).map(|(f, _)| f).collect();
                    give(read.into_iter().flatten().collect())?;
                    several.into_iter().try_for_each(|path| each_of(folder, path, give))?;
                }
            }
        }
        ControlFlow::Continue(())
    }
}

/// Where a file is, links of folders followed, and where it leads to if it is a link itself.
struct Place {
    lies: PathBuf,
    leads: PathBuf,
}

/// Those of files, with a look at each folder.
fn places(files: &[PathBuf]) -> Vec<Place> {
    let mut folders: HashMap<&Path, Option<PathBuf>> = HashMap::new();
    let mut all = Vec::new();
    for file in files {
        let above = file.parent().unwrap_or(Path::new(""));
        let folder = folders.entry(above).or_insert_with(|| above.canonicalize().ok());
        let lies = match (folder, file.file_name()) {
            (Some(folder), Some(name)) => folder.join(name),
            _ => file.clone(),
        };
        let link = lies.is_symlink().then(|| lies.canonicalize().ok()).flatten();
        all.push(Place { leads: link.unwrap_or_else(|| lies.clone()), lies });
    }
    all
}

/// Why what a stage of UniRig predicts is no true rig.
const STAGE: &str = "what a stage of UniRig predicts is a part of a rig";

/// Whether a file holds one asset; reading one that cannot be counted will say what is wrong with it.
fn holds_one(file: &Path) -> bool {
    count_assets(file).unwrap_or(1) <= 1
}

/// What is asked for of a corpus.
struct Chosen {
    /// By number.
    assets: Vec<usize>,
    /// What those of other splits are called.
    others: Vec<String>,
    /// What those are called that are meshes without a rig.
    bare: Vec<String>,
}

/// The rigs of a corpus' split, or all of them.
fn chosen(corpus: &Corpus, split: Option<&str>) -> Result<Chosen, CompareError> {
    let (own, others) = of_split(corpus, split)?;
    let bare = HashSet::<usize>::from_iter(corpus.bare()?);
    let (bare, assets): (Vec<usize>, Vec<usize>) = own.into_iter().partition(|k| bare.contains(k));
    if assets.is_empty() {
        let why = match bare.len() {
            0 => String::new(),
            n => format!(": all it has there is {}", without_rig(n)),
        };
        return Err(CompareError::NoTruth(corpus.path().into(), why));
    }
    let names = corpus.names()?;
    let named = |all: Vec<usize>| all.into_iter().map(|k| names[k].clone()).collect();
    Ok(Chosen { assets, others: named(others), bare: named(bare) })
}

fn without_rig(count: usize) -> String {
    let meshes = if count == 1 { "mesh" } else { "meshes" };
    format!("{count} {meshes} without a rig")
}

/// That bare meshes are no true rigs, where there are any.
fn bare_left_out(path: &Path, count: usize) -> Option<String> {
    (count > 0).then(|| format!("{}: {} left out", path.display(), without_rig(count)))
}

/// The assets of a corpus' split, or all of them, and those of the others, by number.
fn of_split(corpus: &Corpus, split: Option<&str>) -> Result<(Vec<usize>, Vec<usize>), CompareError> {
    let path = corpus.path();
    let Some(split) = split else { return Ok(((0..corpus.len()).collect(), Vec::new())) };
    let splits = corpus.texts("split")?;
    let (own, others): (Vec<usize>, Vec<usize>) = (0..splits.len()).partition(|&k| splits[k] == split);
    if own.is_empty() {
        let there: BTreeSet<&String> = splits.iter().filter(|s| !s.is_empty()).collect();
        let there = match there.is_empty() {
            true => "none of its assets is in a split: leave --split out".to_owned(),
            false => {
                format!("there are {}", there.into_iter().map(|s| format!("`{s}`")).collect::<Vec<_>>().join(", "))
            }
        };
        return Err(CompareError::NoSplit { path: path.into(), split: split.into(), there });
    }
    Ok((own, others))
}

/// With the motions of files: weights are tried in them too.
fn options() -> ImportOptions {
    ImportOptions { clips: Some(Resample::default()), ..ImportOptions::default() }
}

fn single(folder: &Path, path: &Path) -> Named {
    let asset = import(path, &options()).and_then(riglab_asset::Imported::into_asset);
    (name_below(folder, path), asset.map_err(|e| e.to_string()))
}

fn each_of(folder: &Path, path: &Path, give: &mut dyn FnMut(Vec<Named>) -> ControlFlow<()>) -> ControlFlow<()> {
    let file = name_below(folder, path);
    let mut held = Vec::new();
    let (mut number, mut flow) = (0, ControlFlow::Continue(()));
    import_each(path, &options(), |imported| {
        let asset = imported.and_then(riglab_asset::Imported::into_asset);
        held.push(match asset {
            Ok(asset) => (format!("{file}#{}", asset.name), Ok(asset)),
            Err(e) => (format!("{file}#{number}"), Err(e.to_string())),
        });
        number += 1;
        if held.len() == AT_ONCE {
            flow = give(std::mem::take(&mut held));
        }
        flow
    });
    flow?;
    give(held)
}
