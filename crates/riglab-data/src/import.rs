//! A folder of rigged files to a corpus.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use riglab_asset::{ImportOptions, import};
use riglab_core::Asset;
use serde::Deserialize;

use crate::split::Splitter;
use crate::{CorpusWriter, DataError};

/// What became of a folder.
#[derive(Clone, Debug, Default)]
pub struct ImportReport {
    /// Assets written.
    pub imported: usize,
    /// Files that gave no rig, with the reason.
    pub refused: Vec<Refused>,
    /// Imported files with something to tell: name, and a sentence each.
    pub notes: Vec<(String, Vec<String>)>,
    /// Assets of each split.
    pub splits: BTreeMap<String, usize>,
}

/// A file that gave no rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Refused {
    /// The file, below the folder.
    pub name: String,
    /// Why, in a sentence.
    pub reason: String,
}

/// Endings that are imported.
const ENDINGS: [&str; 3] = ["glb", "gltf", "vrm"];

/// Files imported before their assets are written: bounds memory.
const AT_ONCE: usize = 64;

/// What a `manifest.json` beside the files may say of each; all of it optional but the name.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Entry {
    file: String,
    source: String,
    licence: String,
    author: String,
    category: String,
}

/// The rigged files of a folder and those below it, by name.
///
/// # Errors
/// When there is no such folder, or no file in it.
pub fn rigged_files(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    if !folder.is_dir() {
        return Err(DataError::Missing(folder.into(), "folder"));
    }
    let (mut files, mut open) = (Vec::new(), vec![folder.to_path_buf()]);
    while let Some(dir) = open.pop() {
        for entry in std::fs::read_dir(&dir).map_err(|e| DataError::io(&dir, e))? {
            let entry = entry.map_err(|e| DataError::io(&dir, e))?;
            let (path, kind) = (entry.path(), entry.file_type().map_err(|e| DataError::io(&dir, e))?);
            let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
            if kind.is_dir() {
                open.push(path);
            } else if ending.is_some_and(|e| ENDINGS.contains(&e.as_str())) {
                files.push(path);
            }
        }
    }
    files.sort();
    if files.is_empty() { Err(DataError::NothingToImport(folder.into())) } else { Ok(files) }
}

/// Imports a folder into a corpus at `out`. Assets are named by their path below the folder.
///
/// `manifest.json` in the folder adds provenance (a list of objects with `file`, `source`,
/// `licence`, `author`, `category`). A file that gives no rig is a row of the report. `progress` is
/// told how many files are done.
///
/// # Errors
/// When no file gives a rig, or the corpus cannot be written.
pub fn import_folder(
    folder: &Path,
    out: &Path,
    splitter: &Splitter,
    options: &ImportOptions,
    progress: impl Fn(usize) + Sync,
) -> Result<ImportReport, DataError> {
    let files = rigged_files(folder)?;
    let manifest = manifest(folder);
    let mut writer = CorpusWriter::create(out)?;
    let mut report = ImportReport::default();
    let done = AtomicUsize::new(0);
    // Splits may depend on all topologies, so assets are written without and it is filled in last.
    let mut keys = Vec::with_capacity(files.len());
    for chunk in files.chunks(AT_ONCE) {
        let read = |path: &PathBuf| {
            let asset = one(folder, path, &manifest, options);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            asset
        };
        let assets: Vec<Result<Asset, Refused>> = chunk.par_iter().map(read).collect();
        for asset in assets {
            match asset {
                Ok(asset) => {
                    writer.add(&asset)?;
                    keys.push(Splitter::key(&asset));
                    if !asset.provenance.notes.is_empty() {
                        report.notes.push((asset.name, asset.provenance.notes));
                    }
                }
                Err(refused) => report.refused.push(refused),
            }
        }
    }
    report.imported = keys.len();
    if let (0, Some(first)) = (report.imported, report.refused.first()) {
        let (count, first) = (report.refused.len(), first.reason.clone());
        return Err(DataError::AllRefused { path: folder.into(), count, first });
    }
    let splits = splitter.assign(&keys);
    for split in &splits {
        *report.splits.entry(split.clone()).or_default() += 1;
    }
    writer.finish(&splits)?;
    Ok(report)
}

fn one(
    folder: &Path,
    path: &Path,
    manifest: &HashMap<String, Entry>,
    options: &ImportOptions,
) -> Result<Asset, Refused> {
    let name = path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
    let refused = |e: riglab_asset::ImportError| Refused { name: name.clone(), reason: e.to_string() };
    let imported = import(path, options).map_err(refused)?;
    let mut asset = imported.into_asset().map_err(refused)?;
    if let Some(entry) = manifest.get(&name) {
        let from = &mut asset.provenance;
        for (to, value) in [
            (&mut from.source, &entry.source),
            (&mut from.licence, &entry.licence),
            (&mut from.author, &entry.author),
            (&mut from.category, &entry.category),
        ] {
            if !value.is_empty() {
                to.clone_from(value);
            }
        }
    }
    asset.name = name;
    Ok(asset)
}

fn manifest(folder: &Path) -> HashMap<String, Entry> {
    let Ok(text) = std::fs::read_to_string(folder.join("manifest.json")) else { return HashMap::new() };
    match serde_json::from_str::<Vec<Entry>>(&text) {
        Ok(entries) => entries.into_iter().map(|e| (e.file.clone(), e)).collect(),
        Err(e) => {
            eprintln!("warning: {}/manifest.json is left out ({e}): no licences or authors from it", folder.display());
            HashMap::new()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_without_files_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("c.h5");
        let import = |folder: &Path| {
            let options = ImportOptions::default();
            import_folder(folder, &out, &Splitter::ByTopology(0), &options, |_| ()).unwrap_err().to_string()
        };
        assert!(import(dir.path()).contains("no .glb, .gltf or .vrm file"));
        assert!(import(&dir.path().join("nowhere")).contains("no such folder"));
        std::fs::write(dir.path().join("a.glb"), b"glTF").unwrap();
        std::fs::write(dir.path().join("b.GLB"), b"").unwrap();
        assert!(import(dir.path()).contains("none of the 2 files"));
        assert!(!out.exists());
    }
}
