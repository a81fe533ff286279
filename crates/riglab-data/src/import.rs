//! A folder of rigged files to a corpus.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use riglab_asset::{
    ImportError, ImportOptions, Imported, count_assets, import, import_each, is_model_file, is_rig_file,
};
use riglab_core::Asset;
use riglab_files::{Below, make_folder_of};

use crate::beside::whole_checksum;
use crate::copies;
use crate::manifest::Manifest;
use crate::split::{SplitNames, Splitter};
use crate::tally::{OpenFile, Tally};
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
    /// Motions of all assets.
    pub clips: usize,
    /// Assets of each split.
    pub splits: BTreeMap<String, usize>,
    /// Sentences on what looks mistaken in `manifest.json` and in the splits.
    pub warnings: Vec<String>,
}

/// A file that gave no rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Refused {
    /// The file, below the folder.
    pub name: String,
    /// Why, in a sentence.
    pub reason: String,
}

/// Files imported before their assets are written: bounds memory.
const AT_ONCE: usize = 64;

/// The rigged files of a folder and those below it, by name.
///
/// # Errors
/// When there is no such folder, or no file in it.
pub fn rigged_files(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    rigged_below(folder).map(|found| found.files)
}

/// The same, with the folders and links below that could not be followed.
///
/// # Errors
/// As [`rigged_files`].
pub fn rigged_below(folder: &Path) -> Result<Below, DataError> {
    files_below(folder, is_rig_file, DataError::NothingToImport)
}

/// The models of a folder and those below it, rigged or not, by name.
///
/// # Errors
/// As [`rigged_files`].
pub fn models_below(folder: &Path) -> Result<Below, DataError> {
    files_below(folder, is_model_file, DataError::NoModels)
}

fn files_below(folder: &Path, wanted: fn(&Path) -> bool, none: fn(PathBuf) -> DataError) -> Result<Below, DataError> {
    if folder.is_file() {
        return Err(DataError::NoFolder(folder.into()));
    }
    if !folder.is_dir() {
        return Err(DataError::Missing(folder.into(), "folder"));
    }
    let found = riglab_files::below(folder, wanted);
    match (found.files.is_empty(), found.unread.first()) {
        (false, _) => Ok(found),
        (true, None) => Err(none(folder.into())),
        (true, Some((path, reason))) => Err(DataError::io(path, reason)),
    }
}

/// Imports a folder into a corpus at `out`. Assets are named by their path below the folder; those of
/// a file of several, by that and their own name: `set.npz#name`.
///
/// `manifest.json` in the folder adds provenance (a list of objects with `file`, `source`,
/// `licence`, `author`, `category`). A file that gives no rig is a row of the report. `progress` is
/// told how many assets are done, and of how many. Equal assets under two names are in one split, where
/// the splitter makes the splits, and are told.
///
/// # Errors
/// When no file gives a rig, or the corpus cannot be written.
pub fn import_folder(
    folder: &Path,
    out: &Path,
    splitter: &Splitter,
    options: &ImportOptions,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<ImportReport, DataError> {
    write_all(
        folder,
        rigged_below(folder)?,
        out,
        Some(splitter),
        &Source { options, make: Imported::into_asset },
        progress,
    )
}

/// As [`import_folder`], of the meshes alone ([`Imported::into_mesh_asset`]), of rigged and unrigged models alike; all are
/// of the split [`SplitNames::MESHES`].
///
/// # Errors
/// As [`import_folder`].
pub fn import_meshes(
    folder: &Path,
    out: &Path,
    options: &ImportOptions,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<ImportReport, DataError> {
    write_all(folder, models_below(folder)?, out, None, &Source { options, make: Imported::into_mesh_asset }, progress)
}

/// How files become assets.
struct Source<'a> {
    options: &'a ImportOptions,
    make: fn(Imported) -> Result<Asset, ImportError>,
}

fn write_all(
    folder: &Path,
    Below { mut files, unread, .. }: Below,
    out: &Path,
    splitter: Option<&Splitter>,
    source: &Source<'_>,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<ImportReport, DataError> {
    // An earlier corpus at the same place is not part of the data, however the two are named; nor is it to be replaced
    // where there is nothing else.
    if let Ok(earlier) = out.canonicalize() {
        files.retain(|file| file.canonicalize().map_or(true, |file| file != earlier));
        if files.is_empty() && unread.is_empty() {
            return Err(match splitter {
                Some(_) => DataError::NothingToImport(folder.into()),
                None => DataError::NoModels(folder.into()),
            });
        }
    }
    make_folder_of(out).map_err(|e| DataError::io(out, e))?;
    let manifest = Manifest::read(folder);
    let mut writer = CorpusWriter::create(out)?;
    let mut report = ImportReport::default();
    let refused = |(path, reason): (PathBuf, String)| Refused {
        reason: format!("{}: {reason}", path.display()),
        name: name_below(folder, &path),
    };
    report.refused = unread.into_iter().map(refused).collect();
    let tally = Tally::new(files.len(), 0, progress);
    // Splits may depend on all topologies, so assets are written without and it is filled in last.
    let mut keys = Vec::with_capacity(files.len());
    for chunk in files.chunks(AT_ONCE) {
        let read = |path: &PathBuf| one(folder, path, &manifest, source, &tally);
        let read: Vec<Result<Found, Refused>> = chunk.par_iter().map(read).collect();
        for (path, found) in chunk.iter().zip(read) {
            let mut add = |asset: Result<Asset, Refused>| -> Result<(), DataError> {
                match asset {
                    Ok(asset) => {
                        match writer.add(&asset) {
                            // As names that differ in bytes that are no UTF-8, or a file called as an asset of another
                            // would be: no reason to leave out all.
                            Err(DataError::DuplicateName(name)) => {
                                let why = "another asset is named alike in a corpus; rename one";
                                let reason = format!("{}: {why}", path.display());
                                report.refused.push(Refused { name, reason });
                                return Ok(());
                            }
                            added => added?,
                        }
                        keys.push(Splitter::key(&asset));
                        report.clips += asset.clips.len();
                        if !asset.provenance.notes.is_empty() {
                            report.notes.push((asset.name, asset.provenance.notes));
                        }
                    }
                    Err(refused) => report.refused.push(refused),
                }
                Ok(())
            };
            match found {
                Ok(Found::One(asset)) => add(Ok(*asset))?,
                // Written as they are read: there may be more than memory holds.
                Ok(Found::Several(mut file)) => {
                    several(folder, path, &manifest, source, &mut |asset| {
                        file.one();
                        add(asset)
                    })?;
                }
                Err(refused) => add(Err(refused))?,
            }
        }
    }
    report.imported = keys.len();
    if let (0, Some(first)) = (report.imported, report.refused.first()) {
        let (count, first) = (report.refused.len(), first.reason.clone());
        return Err(DataError::AllRefused { path: folder.into(), count, first });
    }
    let splits = match splitter {
        Some(splitter) => splitter.assign_equal(&keys, &writer.digests()),
        None => vec![SplitNames::MESHES.into(); keys.len()],
    };
    let names: BTreeSet<&str> = keys.iter().map(|(name, _)| name.as_str()).collect();
    let files: HashSet<String> = files.iter().map(|path| name_below(folder, path)).collect();
    let is_there = |name: &str| names.contains(name) || files.contains(name);
    report.warnings.extend(manifest.told().iter().cloned().chain(manifest.strangers(is_there)));
    if let Some(splitter) = splitter {
        // What was refused is told already.
        report.warnings.extend(splitter.doubts(&keys, &splits, is_there));
        let names: Vec<&str> = keys.iter().map(|(name, _)| name.as_str()).collect();
        report.warnings.extend(copies::told(&names, &writer.digests(), &splits));
    }
    for split in &splits {
        *report.splits.entry(split.clone()).or_default() += 1;
    }
    writer.finish(&splits)?;
    Ok(report)
}

/// What a file holds.
enum Found<'a> {
    One(Box<Asset>),
    Several(OpenFile<'a>),
}

fn one<'a>(
    folder: &Path,
    path: &Path,
    manifest: &Manifest,
    source: &Source<'_>,
    tally: &'a Tally<'a>,
) -> Result<Found<'a>, Refused> {
    let name = name_below(folder, path);
    let refused = |e: ImportError| Refused { name: name.clone(), reason: e.to_string() };
    let count = count_assets(path);
    let file = tally.open(*count.as_ref().unwrap_or(&1));
    if count.map_err(refused)? > 1 {
        return Ok(Found::Several(file));
    }
    let imported = import(path, source.options).map_err(refused)?;
    if source.options.split && imported.reading.characters().len() > 1 {
        return Ok(Found::Several(file));
    }
    let asset = asset(imported, &name, folder, path, manifest, source.make).map_err(refused)?;
    Ok(Found::One(Box::new(asset)))
}

fn several(
    folder: &Path,
    path: &Path,
    manifest: &Manifest,
    source: &Source<'_>,
    add: &mut impl FnMut(Result<Asset, Refused>) -> Result<(), DataError>,
) -> Result<(), DataError> {
    let name = name_below(folder, path);
    let mut done = Ok(());
    import_each(path, source.options, |imported| {
        let found = imported.and_then(|i| {
            let own = format!("{name}#{}", i.name);
            asset(i, &own, folder, path, manifest, source.make)
        });
        done = add(found.map_err(|e| Refused { name: name.clone(), reason: e.to_string() }));
        if done.is_err() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    done
}

/// What a file is called: its path below the folder.
pub fn name_below(folder: &Path, path: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned()
}

/// The asset under a name, with what the manifest says of it or its file.
fn asset(
    imported: Imported,
    name: &str,
    folder: &Path,
    path: &Path,
    manifest: &Manifest,
    make: fn(Imported) -> Result<Asset, ImportError>,
) -> Result<Asset, ImportError> {
    let mut asset = make(imported)?;
    let file = name_below(folder, path);
    // How the folder was given is no property of the asset: corpora of one folder are equal, wherever it lies.
    if let Some(part) = asset.provenance.source.strip_prefix(&*path.to_string_lossy()) {
        asset.provenance.source = format!("{file}{part}");
    }
    manifest.describe(name, &file, &mut asset.provenance);
    asset.provenance.checksum = whole_checksum(path, &asset.provenance.checksum);
    asset.name = name.to_owned();
    Ok(asset)
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
            import_folder(folder, &out, &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap_err().to_string()
        };
        std::fs::write(dir.path().join("readme.txt"), b"no rig").unwrap();
        assert!(import(dir.path()).contains("no rigged file"));
        assert!(import(&dir.path().join("nowhere")).contains("no such folder"));
        std::fs::write(dir.path().join("a.glb"), b"glTF").unwrap();
        std::fs::write(dir.path().join("b.GLB"), b"").unwrap();
        assert!(import(dir.path()).contains("none of the 2 files"));
        assert!(!out.exists());
    }

    /// A tetrahedron on one joint, as a pair of text and OBJ.
    fn pair(folder: &Path, name: &str) {
        let mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
        let text = "joints a 0 0 0\nroot a\nskin 0 a 1\nskin 1 a 1\nskin 2 a 1\nskin 3 a 1\n";
        std::fs::write(folder.join(format!("{name}.obj")), mesh).unwrap();
        std::fs::write(folder.join(format!("{name}_rig.txt")), text).unwrap();
    }

    #[test]
    fn meshes_come_alone_and_in_a_split_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("meshes.h5");
        let options = ImportOptions::default();
        let none = import_meshes(dir.path(), &out, &options, &|_, _| ()).unwrap_err().to_string();
        assert!(none.contains("no model"), "{none}");
        // A rigged one, whose rig is left behind, and one without.
        pair(dir.path(), "a");
        std::fs::write(dir.path().join("b.obj"), "v 0 0 0\nv 4 0 0\nv 0 2 0\nf 1 2 3\n").unwrap();
        let report = import_meshes(dir.path(), &out, &options, &|_, _| ()).unwrap();
        assert_eq!((report.imported, report.refused.len()), (2, 0), "{report:?}");
        assert_eq!(report.splits, BTreeMap::from([("meshes".into(), 2)]));
        let corpus = crate::Corpus::open(&out).unwrap();
        assert_eq!(corpus.names().unwrap(), ["a.obj", "b.obj"]);
        let rig = corpus.asset(1).unwrap().rig;
        assert_eq!(rig.skeleton().heads(), [[2.0, 1.0, 0.0]]);
        assert!(rig.weights().row(2).eq([(riglab_core::JointId(0), 1.0)]));
        // They are told from rigs of one joint.
        assert_eq!(corpus.bare().unwrap(), [0, 1]);
        import_folder(dir.path(), &out, &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap();
        assert!(crate::Corpus::open(&out).unwrap().bare().unwrap().is_empty());
    }

    #[test]
    fn an_earlier_corpus_in_the_folder_is_no_part_of_it() {
        let dir = tempfile::tempdir().unwrap();
        pair(dir.path(), "a");
        std::fs::create_dir(dir.path().join("sub")).unwrap();
        for folder in [dir.path().to_owned(), dir.path().join("sub/..")] {
            let (out, options) = (dir.path().join("c.h5"), ImportOptions::default());
            let report = import_folder(&folder, &out, &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap();
            assert_eq!((report.imported, report.refused.len()), (1, 0), "{report:?}");
        }
        // Without what it was made of it stays.
        for name in ["a.obj", "a_rig.txt"] {
            std::fs::remove_file(dir.path().join(name)).unwrap();
        }
        let (out, options) = (dir.path().join("c.h5"), ImportOptions::default());
        let none = import_folder(dir.path(), &out, &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap_err();
        assert!(matches!(none, DataError::NothingToImport(_)), "{none}");
        assert_eq!(crate::Corpus::open(&out).unwrap().len(), 1);
    }

    #[test]
    fn a_pair_counts_once_and_a_file_of_several_gives_each() {
        let dir = tempfile::tempdir().unwrap();
        pair(dir.path(), "a");
        pair(dir.path(), "b");
        // Of the same mesh, without weights: the stage before.
        std::fs::write(dir.path().join("b.txt"), "joints a 0 0 0\nroot a\n").unwrap();
        let options = ImportOptions::default();
        let read = |name: &str| import(dir.path().join(name), &options).unwrap().into_asset().unwrap();
        let both = [read("a_rig.txt"), read("b_rig.txt")];
        let set = dir.path().join("set.npz");
        riglab_asset::write(&both, &set, riglab_asset::Target::ARTICULATION_XL).unwrap();
        let names: Vec<_> = rigged_files(dir.path()).unwrap().iter().map(|p| name_below(dir.path(), p)).collect();
        assert_eq!(names, ["a_rig.txt", "b_rig.txt", "set.npz"]);
        let out = dir.path().join("c.h5");
        for _ in 0..2 {
            let report = import_folder(dir.path(), &out, &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap();
            assert_eq!((report.imported, report.refused), (4, vec![]));
        }
        let corpus = crate::Corpus::open(&out).unwrap();
        assert_eq!(corpus.names().unwrap(), ["a_rig.txt", "b_rig.txt", "set.npz#a", "set.npz#b"]);
        assert_eq!(corpus.texts("source").unwrap(), ["a_rig.txt", "b_rig.txt", "set.npz#0", "set.npz#1"]);
        // Each asset is told when it is done, of as many as there are.
        let told = std::sync::Mutex::new(Vec::new());
        let tell = |done, of| told.lock().unwrap().push((done, of));
        import_folder(dir.path(), &out, &Splitter::ByTopology(0), &options, &tell).unwrap();
        let told = told.into_inner().unwrap();
        assert!(told.len() == 4 && told.last() == Some(&(4, 4)), "{told:?}");
        // One that is in its set twice gets a name of its own.
        let [a, b] = both;
        riglab_asset::write(&[a.clone(), a, b], &set, riglab_asset::Target::ARTICULATION_XL).unwrap();
        let report = import_folder(dir.path(), &out, &Splitter::ByTopology(0), &options, &|_, _| ()).unwrap();
        assert_eq!((report.imported, report.refused), (5, vec![]));
    }

    #[test]
    fn one_rig_of_two_names_is_in_one_split() {
        let dir = tempfile::tempdir().unwrap();
        (0..12).for_each(|k| pair(dir.path(), &format!("rig{k:02}")));
        let out = dir.path().join("c.h5");
        let import = |splitter: &Splitter| {
            let report = import_folder(dir.path(), &out, splitter, &ImportOptions::default(), &|_, _| ()).unwrap();
            let told: Vec<String> = report.warnings.into_iter().filter(|said| said.contains("equal")).collect();
            (crate::Corpus::open(&out).unwrap().texts("split").unwrap(), told)
        };
        let (splits, told) = import(&Splitter::ByTopology(0));
        assert_eq!(splits, ["train"; 12]);
        assert!(told.len() == 1 && told[0].starts_with("11 assets are equal to another"), "{told:?}");
        let given = [("rig00_rig.txt", "train"), ("rig01_rig.txt", "test_new")];
        let given = given.iter().map(|(name, split)| ((*name).to_owned(), (*split).to_owned())).collect();
        let (_, told) = import(&Splitter::Given(given));
        assert!(
            told.len() == 1 && told[0].contains("`rig01_rig.txt` of test_new to `rig00_rig.txt` of train"),
            "{told:?}"
        );
    }
}
