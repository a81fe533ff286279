//! A file's assets, with what the importer saw that the rig no longer shows.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use riglab_asset::{ImportOptions, Imported, Resample, RootPolicy, Warning, count_assets, file_and_item, import_each};
use riglab_core::Asset;
use riglab_data::{DataError, Manifest, OpenFile, Tally, name_below, rigged_below, whole_checksum};
use riglab_files::Below;

use crate::Category;
use crate::config::ImportConfig;

/// A folder of files to curate.
pub struct Folder {
    root: PathBuf,
    files: Vec<PathBuf>,
    /// Paths by name, where a name is not the path: it has letters that are no UTF-8.
    odd: HashMap<String, PathBuf>,
    /// Names of all files, whatever part of them is looked at.
    there: HashSet<String>,
    unread: Vec<(String, String)>,
    hidden: Option<String>,
    manifest: Manifest,
    options: ImportOptions,
}

/// An asset as read.
pub struct ReadAsset {
    /// The asset, under its name in the folder.
    pub asset: Asset,
    /// What only the file shows.
    pub seen: ImportFindings,
}

/// What the importer saw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportFindings {
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
    /// Whether the file is a VRM.
    pub vrm: bool,
}

/// What came of reading.
pub enum ReadOutcome {
    /// An asset.
    Asset(Box<ReadAsset>),
    /// No asset: its name, and why.
    Refused(String, String),
}

impl Folder {
    /// Lists a folder's rigged files, but for `without`: what is written into the folder is no input.
    ///
    /// # Errors
    /// When there is no such folder, or no file in it.
    pub fn open(root: &Path, without: &[&Path], import: &ImportConfig) -> Result<Self, DataError> {
        let found = rigged_below(root)?;
        let hidden = found.left_aside();
        let Below { mut files, unread, .. } = found;
        // However the two are named.
        let without: Vec<PathBuf> = without.iter().filter_map(|other| other.canonicalize().ok()).collect();
        let is_input = |file: &PathBuf| {
            file.canonicalize().map_or(true, |file| !without.iter().any(|other| file.starts_with(other)))
        };
        files.retain(is_input);
        let roots = if import.virtual_root { RootPolicy::Virtual } else { RootPolicy::Reattach };
        let clips = (import.clips > 0.0).then(|| Resample { rate: import.clips, ..Resample::default() });
        let (split, repair) = (import.split_characters, import.repair);
        let options = ImportOptions { roots, clips, split, repair, ..ImportOptions::default() };
        let mut unread: Vec<_> = unread.into_iter().map(|(path, why)| (name_below(root, &path), why)).collect();
        let (mut odd, mut there) = (HashMap::new(), HashSet::new());
        files.retain(|file| {
            let name = name_below(root, file);
            if !there.insert(name.clone()) {
                let own = (2..).map(|n| format!("{name}#{n}")).find(|own| there.insert(own.clone()));
                let why = "another file is named alike, but for bytes that are not UTF-8; rename one";
                unread.push((own.unwrap_or(name), why.into()));
                return false;
            }
            if root.join(&name) != *file {
                odd.insert(name, file.clone());
            }
            true
        });
        Ok(Self { root: root.into(), files, odd, there, unread, hidden, manifest: Manifest::read(root), options })
    }

    /// Whether a name is that of a file here, or of an asset in one.
    pub fn is_there(&self, name: &str) -> bool {
        self.there.contains(self.file_of(name)) || self.root.join(name).is_file()
    }

    /// The file that a name means, whatever part of the files is looked at: its own, or that of the asset of a file of several.
    pub(crate) fn file_of<'n>(&self, name: &'n str) -> &'n str {
        let files = std::iter::once(name).chain(name.match_indices('#').map(|(at, _)| &name[..at]));
        files.into_iter().find(|file| self.there.contains(*file)).unwrap_or(file_and_item(name).0)
    }

    /// Sentences on what looks mistaken in the manifest.
    pub fn doubts(&self) -> Vec<String> {
        let unknown = |(name, _): &(&str, usize)| name.parse::<Category>().is_err();
        let unknown: Vec<(&str, usize)> = self.manifest.categories().into_iter().filter(unknown).collect();
        let categories = (!unknown.is_empty()).then(|| {
            let shown: Vec<String> = unknown.iter().take(6).map(|(name, n)| format!("`{name}` ({n})")).collect();
            let more = if unknown.len() > shown.len() { ", ..." } else { "" };
            format!(
                "manifest.json states categories that are none and count for nothing: {}{more}; known are {}",
                shown.join(", "),
                Category::names()
            )
        });
        let told = self.manifest.told().iter().cloned();
        told.chain(self.manifest.strangers(|name| self.is_there(name))).chain(categories).collect()
    }

    /// A number for what the manifest says of a file.
    pub fn said(&self, file: &str) -> u64 {
        self.manifest.said(file)
    }

    /// The files, by name.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Folders and links that could not be followed: their names, and why.
    pub fn unread(&self) -> &[(String, String)] {
        &self.unread
    }

    /// A sentence on what is hidden in the folder and was left aside.
    pub fn hidden(&self) -> Option<&str> {
        self.hidden.as_deref()
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
        self.odd.get(file).cloned().unwrap_or_else(|| self.root.join(file))
    }

    /// Reads a file's assets one at a time. A file of one asset gives its name to it; those of a file of
    /// several are called by it and their own: `set.npz#name`. Each counts in the tally.
    pub fn each(&self, file: &Path, tally: Option<&Tally<'_>>, mut each: impl FnMut(ReadOutcome) -> ControlFlow<()>) {
        let own = self.name(file);
        let count = count_assets(file);
        let mut open = tally.map(|tally| tally.open(*count.as_ref().unwrap_or(&1)));
        let several = match count {
            Ok(count) => count > 1,
            Err(e) => {
                let _ = each(ReadOutcome::Refused(own, self.sentence(&e.to_string())));
                return;
            }
        };
        import_each(file, &self.options, |imported| {
            let given = each(match imported {
                Ok(imported) => {
                    let name =
                        if several || imported.parted { format!("{own}#{}", imported.name) } else { own.clone() };
                    self.read(imported, &name, &own, file)
                }
                Err(e) => ReadOutcome::Refused(own.clone(), self.sentence(&e.to_string())),
            });
            open.iter_mut().for_each(OpenFile::one);
            given
        });
    }

    fn read(&self, imported: Imported, name: &str, file: &str, path: &Path) -> ReadOutcome {
        let seen = seen(&imported);
        match imported.into_asset() {
            Ok(mut asset) => {
                // The place of the folder is no property of the asset.
                if let Some(part) = asset.provenance.source.strip_prefix(&*path.to_string_lossy()) {
                    asset.provenance.source = format!("{file}{part}");
                }
                self.manifest.describe(name, file, &mut asset.provenance);
                asset.provenance.checksum = whole_checksum(path, &asset.provenance.checksum);
                asset.name = name.into();
                ReadOutcome::Asset(Box::new(ReadAsset { asset, seen }))
            }
            Err(e) => ReadOutcome::Refused(name.into(), self.sentence(&e.to_string())),
        }
    }

    /// A text without the path of the folder: results are the same wherever the files lie.
    fn sentence(&self, text: &str) -> String {
        let root = self.root.to_string_lossy();
        let root = root.trim_end_matches('/');
        if root.is_empty() { text.into() } else { without_folder(text, &format!("{root}/")) }
    }
}

/// A text without a folder where a path begins with it.
fn without_folder(text: &str, folder: &str) -> String {
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find(folder) {
        let (before, after) = rest.split_at(at);
        out += before;
        let within = out.chars().next_back().is_some_and(|c| c.is_alphanumeric() || "/\\._-:".contains(c));
        out += if within { folder } else { "" };
        rest = &after[folder.len()..];
    }
    out + rest
}

fn seen(imported: &Imported) -> ImportFindings {
    let reading = &imported.reading;
    let nodes: BTreeSet<usize> = reading.parts.iter().map(|p| p.node).collect();
    let mut seen = ImportFindings {
        skeletons: reading.skeletons(),
        roots: 1,
        parts: nodes.len(),
        warnings: reading.warnings.len(),
        vrm: reading.body.vrm,
        ..ImportFindings::default()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_goes_from_where_paths_begin_alone() {
        let of = |text: &str| without_folder(text, "models/");
        assert_eq!(of("models/a.obj: `models/b.mtl` is missing"), "a.obj: `b.mtl` is missing");
        let others = "https://x.org/3d-models/fox, old_models/fox.glb, ../models/fox.glb, 3models/é";
        assert_eq!(of(others), others);
    }
}
