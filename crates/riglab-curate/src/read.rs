//! A file's assets, with what the importer saw that the rig no longer shows.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use riglab_asset::{ImportOptions, Imported, Resample, RootPolicy, Warning, count_assets, import_each};
use riglab_core::Asset;
use riglab_data::{DataError, Manifest, name_below, rigged_below};
use riglab_files::Below;

use crate::config::ImportConfig;

/// A folder of files to curate.
pub struct Folder {
    root: PathBuf,
    files: Vec<PathBuf>,
    unread: Vec<(String, String)>,
    manifest: Manifest,
    options: ImportOptions,
}

/// An asset as read.
pub struct Read {
    /// The asset, under its name in the folder.
    pub asset: Asset,
    /// What only the file shows.
    pub seen: Seen,
}

/// What the importer saw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Skeletons that no skin connects.
    pub skeletons: usize,
    /// Roots of the largest number of trees under one skin.
    pub roots: usize,
    /// Vertices without weight in the file.
    pub unweighted: usize,
    /// Vertices whose weights did not sum to 1.
    pub unnormalised: usize,
    /// Weights look like those of other vertices: mean distance to the heaviest bone over that to the nearest.
    pub far: Option<f64>,
    /// Unskinned meshes beside the rig.
    pub left_out: usize,
    /// Nodes that hold meshes of the rig.
    pub parts: usize,
    /// Warnings of any kind.
    pub warnings: usize,
}

/// What came of reading.
pub enum Found {
    /// An asset.
    Asset(Box<Read>),
    /// No asset: its name, and why.
    Refused(String, String),
}

impl Folder {
    /// Lists a folder's rigged files, but for `without`: what is written into the folder is no input.
    ///
    /// # Errors
    /// When there is no such folder, or no file in it.
    pub fn open(root: &Path, without: &[&Path], import: &ImportConfig) -> Result<Self, DataError> {
        let Below { mut files, unread } = rigged_below(root)?;
        files.retain(|file| !without.iter().any(|other| file.starts_with(other)));
        let roots = if import.virtual_root { RootPolicy::Virtual } else { RootPolicy::Reattach };
        let clips = (import.clips > 0.0).then(|| Resample { rate: import.clips, ..Resample::default() });
        let (split, repair) = (import.split_characters, import.repair);
        let options = ImportOptions { roots, clips, split, repair, ..ImportOptions::default() };
        let unread = unread.into_iter().map(|(path, why)| (name_below(root, &path), why)).collect();
        Ok(Self { root: root.into(), files, unread, manifest: Manifest::read(root), options })
    }

    /// The files, by name.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Folders and links that could not be followed: their names, and why.
    pub fn unread(&self) -> &[(String, String)] {
        &self.unread
    }

    /// Leaves the files that `keep` wants, by their names.
    pub fn retain(&mut self, mut keep: impl FnMut(&str) -> bool) {
        let root = self.root.clone();
        self.unread.retain(|(name, _)| keep(name));
        self.files.retain(|file| keep(&name_below(&root, file)));
    }

    /// A file's name: its path below the folder.
    pub fn name(&self, file: &Path) -> String {
        name_below(&self.root, file)
    }

    /// The file of a name.
    pub fn path(&self, file: &str) -> PathBuf {
        self.root.join(file)
    }

    /// Reads a file's assets one at a time. A file of one asset gives its name to it; those of a file of
    /// several are called by it and their own: `set.npz#name`.
    pub fn each(&self, file: &Path, mut each: impl FnMut(Found) -> ControlFlow<()>) {
        let own = self.name(file);
        let several = match count_assets(file) {
            Ok(count) => count > 1,
            Err(e) => {
                let _ = each(Found::Refused(own, self.sentence(&e.to_string())));
                return;
            }
        };
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        import_each(file, &self.options, |imported| {
            each(match imported {
                Ok(imported) => {
                    let parted = several || (self.options.split && imported.name != stem);
                    let name = if parted { format!("{own}#{}", imported.name) } else { own.clone() };
                    self.read(imported, &name, &own)
                }
                Err(e) => Found::Refused(own.clone(), self.sentence(&e.to_string())),
            })
        });
    }

    fn read(&self, imported: Imported, name: &str, file: &str) -> Found {
        let seen = seen(&imported);
        match imported.into_asset() {
            Ok(mut asset) => {
                self.manifest.describe(name, file, &mut asset.provenance);
                // The place of the folder is no property of the asset.
                asset.provenance.source = self.sentence(&asset.provenance.source);
                asset.name = name.into();
                Found::Asset(Box::new(Read { asset, seen }))
            }
            Err(e) => Found::Refused(name.into(), self.sentence(&e.to_string())),
        }
    }

    /// A text without the path of the folder: results are the same wherever the files lie.
    fn sentence(&self, text: &str) -> String {
        let root = self.root.to_string_lossy();
        let root = root.trim_end_matches('/');
        if root.is_empty() { text.into() } else { text.replace(&format!("{root}/"), "") }
    }
}

fn seen(imported: &Imported) -> Seen {
    let reading = &imported.reading;
    let nodes: BTreeSet<usize> = reading.parts.iter().map(|p| p.node).collect();
    let mut seen = Seen {
        skeletons: reading.skeletons(),
        roots: 1,
        parts: nodes.len(),
        warnings: reading.warnings.len(),
        ..Seen::default()
    };
    for warning in &reading.warnings {
        match warning {
            Warning::SeveralRoots { roots, .. } => seen.roots = roots.len(),
            Warning::Unweighted { vertices } => seen.unweighted += vertices,
            Warning::NotNormalised { vertices, .. } => seen.unnormalised += vertices,
            Warning::FarWeights { ratio } => seen.far = Some(*ratio),
            Warning::LeftOut { nodes } => seen.left_out += nodes.len(),
            _ => {}
        }
    }
    seen
}
