//! One file written.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use riglab_asset::export;
use riglab_asset::rigging::{self, SubjectNote};
use riglab_asset::{
    Content, ImportOptions, Imported, Target, import, is_gltf, is_vrm, write, write_mesh, written_paths,
};
use riglab_core::Springs;

use super::super::inspect::shown_elsewhere;
use super::super::is_fbx;
use super::lost::subject;
use super::{Args, Lost, Notes};

pub(super) fn warn(imported: &Imported) {
    for warning in imported.warnings() {
        tell!("warning: {}: {warning}", imported.provenance.source);
    }
}

/// Says so where what is written stands elsewhere than the file shows it.
pub(super) fn note_place(imported: &Imported, notes: &mut Notes) {
    if let Some(note) = shown_elsewhere(imported) {
        notes.said(&imported.provenance.source, note);
    }
}

/// Refuses to write over what is read, and over what riglab did not write.
pub(super) fn spare(inputs: &HashSet<PathBuf>, out: &Path, target: Target, args: &Args) -> Result<()> {
    spare_inputs(inputs, out, target)?;
    args.keep_others(out, target)
}

pub(super) fn spare_inputs(inputs: &HashSet<PathBuf>, out: &Path, target: Target) -> Result<()> {
    for path in written_paths(out, target) {
        if path.canonicalize().is_ok_and(|real| inputs.contains(&real)) {
            bail!("{} is the input; give another name or folder to write", path.display());
        }
    }
    Ok(())
}

pub(super) fn store(
    imported: Imported,
    out: &Path,
    target: Target,
    args: &Args,
    inputs: &HashSet<PathBuf>,
    (lost, notes): (&mut Lost, &mut Notes),
) -> Result<()> {
    spare(inputs, out, target, args)?;
    warn(&imported);
    if target == Target::GLB {
        return store_glb(&imported, out, args, (lost, notes));
    }
    #[cfg(feature = "fbx")]
    if target == Target::FBX {
        return store_fbx(&imported, out, args, (lost, notes));
    }
    let with = lost.clone().with(&imported, target);
    note_place(&imported, notes);
    match &imported.content {
        Content::Bare(mesh) if target == Target::OBJ => write_mesh(mesh, out)?,
        _ => {
            let source = imported.provenance.source.clone();
            let told = write(&[args.placed(imported.into_asset()?, target)], out, target)?;
            told.iter().for_each(|note| notes.written(&source, note));
        }
    }
    *lost = with;
    Ok(())
}

/// With all that its document has, where there is one.
fn store_glb(imported: &Imported, out: &Path, args: &Args, (lost, notes): (&mut Lost, &mut Notes)) -> Result<()> {
    let bytes = whole(imported, args, notes)?;
    keep_vrm(out, &bytes, &imported.provenance.source)?;
    export::write(out, &bytes).with_context(|| format!("{}", out.display()))?;
    // A bare model keeps its looks, too.
    if !keeps_looks(imported) && imported.rig().is_some() {
        *lost = std::mem::take(lost).with(imported, Target::GLB);
    }
    Ok(())
}

/// Refuses to call a GLB a VRM that is none: programs that open VRM would refuse it.
pub(super) fn keep_vrm(out: &Path, glb: &[u8], source: &str) -> Result<()> {
    if out.extension().is_some_and(|of| of.eq_ignore_ascii_case("vrm")) && !is_vrm(glb) {
        bail!(
            "{}: only what is a VRM is written as one, and of {source} there is no data of VRM; name it .glb",
            out.display()
        );
    }
    Ok(())
}

/// The same as FBX.
#[cfg(feature = "fbx")]
fn store_fbx(imported: &Imported, out: &Path, args: &Args, (lost, notes): (&mut Lost, &mut Notes)) -> Result<()> {
    let source = &imported.provenance.source;
    let file = riglab_asset::glb_to_fbx(&whole(imported, args, notes)?).with_context(|| source.clone())?;
    export::write(out, &file.bytes).with_context(|| format!("{}", out.display()))?;
    let own = std::mem::take(lost);
    *lost = match keeps_looks(imported) || imported.rig().is_none() {
        true => own.with_document(file.left),
        false => own.with(imported, Target::FBX),
    };
    Ok(())
}

/// Whether a file's materials, pictures and motions come along with its rig.
fn keeps_looks(imported: &Imported) -> bool {
    let source = Path::new(&imported.provenance.source);
    is_gltf(source) || is_fbx(source)
}

/// A file as a GLB with all that it has; what is not in it is told.
fn whole(imported: &Imported, args: &Args, notes: &mut Notes) -> Result<Vec<u8>> {
    let source = &imported.provenance.source;
    let document = is_gltf(Path::new(source));
    // A choice among one is none.
    let whole = match &args.character {
        Some(_) if document => Some(import(source, &ImportOptions::default())?),
        _ => None,
    };
    let imported = whole.as_ref().filter(|all| all.reading.characters().len() == 1).unwrap_or(imported);
    let one_of_several = whole.as_ref().is_some_and(|all| all.reading.characters().len() > 1);
    if one_of_several {
        let left = "of one character only the rig is written; materials, pictures, motions are left out";
        notes.said(source, left.into());
        note_place(imported, notes);
    }
    let exported = match imported.rig() {
        Some(rig) if document && !one_of_several => export::onto(source, imported, rig, &args.export())?,
        #[cfg(feature = "fbx")]
        Some(_) if is_fbx(Path::new(source)) => {
            let (exported, told) =
                rigging::dressed(Path::new(source), &args.import(), &Springs::default(), &args.export())?;
            told.iter().for_each(|note| notes.said(source, note.to_string()));
            exported
        }
        Some(rig) => export::alone(&imported.name, rig, &imported.provenance, &args.export())?,
        // Nothing to take out: the document as one file.
        None if document => export::strip(source, &ImportOptions::default())?,
        None => bare(source, notes)?,
    };
    exported.notes.iter().for_each(|note| notes.exported(source, note));
    Ok(exported.bytes)
}

/// A model of another format as a GLB with its looks.
fn bare(source: &str, notes: &mut Notes) -> Result<export::Exported> {
    let subject = subject(Path::new(source))?;
    for note in subject.notes() {
        match note {
            // What was told as it was imported, and what only matters to who makes a rig.
            SubjectNote::Read(_)
            | SubjectNote::StandApart { .. }
            | SubjectNote::InsideOut { .. }
            | SubjectNote::Flat { .. } => {}
            SubjectNote::LiesDown { axis, .. } => {
                let lies = format!("{axis} seems to be up in it, and y is in a GLB: there it lies on its side");
                notes.said(source, lies);
            }
            note => notes.said(source, note.to_string()),
        }
    }
    let bytes = subject.document().map(<[u8]>::to_vec);
    let bytes = bytes
        .with_context(|| format!("{source}: the file has a mesh but no skeleton, which is written as obj only"))?;
    Ok(export::Exported { bytes, notes: Vec::new() })
}
