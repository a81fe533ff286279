//! From a file to its assets: one, or each.

use std::ops::ControlFlow;
use std::path::Path;

use riglab_core::Provenance;

use super::archive::Input;
use super::array_rig::ArrayRig;
use super::budget::Budget;
use super::fault::PeerFault;
use super::read::Wanted;
use super::{fields, reading, repair};
use crate::names::Names;
use crate::{Fault, Format, ImportError, ImportOptions, Imported, Warning, assemble};

/// Bytes that a joint takes in a reading and a rig, with its names.
const JOINT: u64 = 256;

/// Takes an asset or its fault.
pub(crate) type Each<'a> = &'a mut dyn FnMut(Result<Imported, ImportError>) -> ControlFlow<()>;

/// A file of a peer's format.
pub(crate) struct Source<'a> {
    pub path: &'a Path,
    pub format: Format,
    pub input: Input<'a>,
    /// Where the other half of a pair is looked for.
    pub folder: Option<&'a Path>,
}

/// Reads the asset that the options choose, or the only one.
pub(crate) fn one(source: &Source<'_>, options: &ImportOptions) -> Result<Imported, ImportError> {
    let mut found = None;
    each(source, options, true, &mut |asset| {
        found = Some(asset);
        ControlFlow::Break(())
    });
    found.unwrap_or_else(|| Err(ImportError::new(&source.path.to_string_lossy(), PeerFault::NoAsset.into())))
}

/// Reads every asset, or the one that the options choose; with `alone`, a file of several without a
/// choice is a fault.
pub(crate) fn each(source: &Source<'_>, options: &ImportOptions, alone: bool, each: Each<'_>) {
    let path = source.path.to_string_lossy().into_owned();
    if let Err(fault) = try_each(source, &path, options, alone, each) {
        let _ = each(Err(ImportError::new(&path, fault)));
    }
}

/// As [`each`]; what is wrong with the file as a whole is the error.
fn try_each(
    source: &Source<'_>,
    path: &str,
    options: &ImportOptions,
    alone: bool,
    each: Each<'_>,
) -> Result<(), Fault> {
    let checksum = checksum(source.input).map_err(|e| Fault::unreadable(&e))?;
    let mut assets = source.format.reads().open(source, false)?;
    let count = assets.count();
    let fault = match options.item {
        _ if count == 0 => Some(PeerFault::NoAsset),
        Some(item) if item >= count => Some(PeerFault::NoSuchItem { item, count }),
        None if alone && count > 1 => Some(PeerFault::Several(count)),
        _ => None,
    };
    if let Some(fault) = fault {
        return Err(fault.into());
    }
    let stem = stem(source.path);
    let budget = Budget::of(source.input.len().map_err(|e| Fault::unreadable(&e))?);
    let mut names = Names::default();
    let mut ended = false;
    let wanted = Wanted { item: options.item, extras: false };
    let done = assets.each(wanted, &mut |item, rig| {
        // The path with the asset's number, where there are several.
        let place = if count > 1 { format!("{path}#{item}") } else { path.to_owned() };
        let imported = rig.map_err(Fault::from).and_then(|rig| {
            budget.clone().take(JOINT * rig.joints.len() as u64, "the skeleton")?;
            let name = match (count, rig.name.trim()) {
                (1, _) => stem.clone(),
                (_, "") => format!("{stem}-{item:06}"),
                (_, own) => own.to_owned(),
            };
            import(rig, names.unique(&name, String::new), &place, &checksum, options)
        });
        let done = each(imported.map_err(|fault| ImportError::new(&place, fault)));
        ended = done.is_break();
        done
    });
    if ended { Ok(()) } else { Ok(done?) }
}

/// How many assets there are.
pub(crate) fn count(source: &Source<'_>) -> Result<usize, Fault> {
    Ok(source.format.reads().open(source, false)?.count())
}

/// Reads arrays as they are in the file, every asset of it; the second of each pair is what is wrong.
pub(crate) fn read_arrays(source: &Source<'_>) -> Result<Vec<Result<ArrayRig, Fault>>, Fault> {
    let mut out = Vec::new();
    let mut assets = source.format.reads().open(source, true)?;
    assets.each(Wanted { item: None, extras: true }, &mut |_, rig| {
        let checked = rig.and_then(|rig| fields::check(&rig).map(|()| rig));
        out.push(checked.map_err(Fault::from));
        ControlFlow::Continue(())
    })?;
    Ok(out)
}

fn import(
    mut rig: ArrayRig,
    name: String,
    source: &str,
    checksum: &str,
    options: &ImportOptions,
) -> Result<Imported, Fault> {
    let repaired = if options.repair { repair::repair(&mut rig)? } else { Vec::new() };
    let mut reading = reading::reading(&rig)?;
    reading.warnings.splice(0..0, repaired);
    if let Some(character) = &options.character {
        reading.keep(character)?;
    }
    let (content, clips) = assemble::content(&mut reading, options)?;
    let provenance = Provenance {
        source: source.to_owned(),
        checksum: checksum.to_owned(),
        notes: reading.warnings.iter().map(Warning::to_string).collect(),
        ..Provenance::default()
    };
    Ok(Imported { name, content, clips, provenance, reading, parted: false })
}

/// The file's name without ending; that of its folder for names that every asset of a set has.
fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    match (&*stem, path.parent().and_then(Path::file_name)) {
        ("raw_data" | "predict_skeleton" | "predict_skin", Some(folder)) => folder.to_string_lossy().into_owned(),
        _ => stem.strip_suffix("_rig").filter(|s| !s.is_empty()).unwrap_or(&stem).to_owned(),
    }
}

fn checksum(input: Input<'_>) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(input.open()?)?;
    Ok(hasher.finalize().to_hex().to_string())
}
