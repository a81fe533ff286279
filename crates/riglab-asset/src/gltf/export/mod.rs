//! Documents with another rig, or without one.
//!
//! A file is packed into one run of bytes ([`packed`]), rid of numbers that are not finite ([`finite`]), looked at as the importer does ([`scene`]), and
//! altered as JSON ([`draft`]): a rig is put in ([`bind`]), with its human bones ([`humanoid`]) and springs
//! ([`springs`]), or taken out ([`strip`], [`remove`]), one
//! that cannot be read too ([`broken`]). Geometry is moved into the scene only where the nodes
//! would not leave it in its place ([`bake`], [`place`]); a motion may be added ([`mod@preview`], [`motion`]). At the end goes what nothing names any more
//! ([`finish`]). All else stays as it was read.

mod animations;
mod bake;
mod bind;
mod broken;
mod draft;
mod finish;
mod finite;
mod frames;
mod humanoid;
mod meshes;
pub(crate) mod model;
mod motion;
mod packed;
mod place;
mod preview;
mod references;
mod remove;
mod rows;
mod scene;
mod sheared;
mod springs;
mod springs0;
mod strip;
mod vrm;

use std::collections::HashSet;
use std::path::Path;

use riglab_core::{Clip, JointId, Provenance, Rig, Skeleton, Vec3};
use serde::Deserialize;
use serde_json::json;

use super::accessor::Accessors;
use super::buffers::Buffers;
use super::document::Document;
use crate::budget::Budget;
use crate::maker::MAKER;
use crate::{ExportFault, ExportNote, ExportOptions, Exported, Fault, ImportOptions, Imported, Reading, Warning};
use bind::Binder;
use draft::Draft;
pub(super) use draft::container;
use scene::{Same, Scene};

/// See [`crate::export::onto`]. A skeleton that is not the file's own stands, with all that it holds, `off` from where the rig
/// is; its joints of `loose`, which are roots where it comes from, stand beside its root, so that what moves that does not
/// move them.
pub(crate) fn onto(
    bytes: &[u8],
    folder: Option<&Path>,
    imported: &Imported,
    rig: &Rig,
    off: Vec3,
    loose: &[JointId],
    options: &ExportOptions,
) -> Result<Exported, ExportFault> {
    edit(bytes, folder, |draft, source, notes| {
        let reading = &imported.reading;
        let before = imported.rig().filter(|before| before.skeleton() == rig.skeleton());
        let same = before.and_then(|_| Same::new(rig, reading));
        let scene = Scene::new(&source, reading, same.as_ref())?.ok_or(ExportFault::OtherSource)?;
        let mut binder = Binder { draft, accessors: source.accessors, scene: &scene, options, notes };
        match (&same, before) {
            (Some(same), Some(before)) if binder.keep_skeleton(same, before, reading)? => {
                binder.change_body(same, before);
            }
            _ => {
                binder.new_skeleton(rig, before, reading, off, loose)?;
                tell_size(reading, notes);
            }
        }
        Ok(())
    })
}

/// See [`crate::export::strip`].
pub(crate) fn strip(bytes: &[u8], folder: Option<&Path>, reading: &Reading) -> Result<Exported, ExportFault> {
    edit(bytes, folder, |draft, source, notes| {
        let mut scene = Scene::new(&source, reading, None)?.ok_or(ExportFault::OtherSource)?;
        let shown = glam::DAffine3::from_translation(glam::Vec3::from(reading.shown_off).as_dvec3());
        let maps = scene.surfaces.iter_mut().map(|surface| &mut surface.map);
        maps.chain(scene.bound.iter_mut().map(|bound| &mut bound.map)).for_each(|map| *map = shown * *map);
        strip::strip(draft, source.accessors, &scene, reading, notes)?;
        tell_size(reading, notes);
        Ok(())
    })
}

/// Tells where what was read, and is written, has another size than the file shows.
fn tell_size(reading: &Reading, notes: &mut Vec<ExportNote>) {
    let size = reading.warnings.iter().find_map(|warning| match warning {
        Warning::RestIsNotBind { size, .. } if *size != 1.0 => Some(1.0 / size),
        _ => None,
    });
    notes.extend(size.map(|size| ExportNote::Resized { size }));
}

/// As [`strip`], of a file of which reading says `fault`: where its rig is to blame, the file without it, and what is read
/// of that. No bind pose is known then, so meshes stand where their nodes place them.
pub(crate) fn strip_broken(
    bytes: &[u8],
    folder: Option<&Path>,
    options: &ImportOptions,
    fault: Fault,
) -> Result<(Reading, Exported), ExportFault> {
    if !fault.may_lie_in_rig() {
        return Err(fault.into());
    }
    let (bare, joints) = broken::without_rig(bytes)?;
    let (reading, _) = super::read(&bare, folder, options)?;
    if reading.parts.is_empty() {
        return Err(fault.into());
    }
    let exported = edit(&bare, folder, |draft, source, notes| {
        notes.push(ExportNote::RigBroken(fault));
        let mut scene = Scene::new(&source, &reading, None)?.ok_or(ExportFault::OtherSource)?;
        joints.into_iter().for_each(|node| scene.is_joint[node] = true);
        strip::strip(draft, source.accessors, &scene, &reading, notes)?;
        Ok(())
    })?;
    Ok((reading, exported))
}

/// See [`crate::export::preview`].
pub(crate) fn preview(bytes: &[u8], folder: Option<&Path>) -> Result<Exported, ExportFault> {
    edit(bytes, folder, |draft, source, _| {
        preview::add(draft, source.document)?;
        Ok(())
    })
}

/// See [`crate::export::animate`].
pub(crate) fn animate(
    bytes: &[u8],
    folder: Option<&Path>,
    reading: &Reading,
    skeleton: &Skeleton,
    clips: &[Clip],
) -> Result<Exported, ExportFault> {
    edit(bytes, folder, |draft, source, notes| add_motions(draft, &source, reading, skeleton, clips, notes))
}

fn add_motions(
    draft: &mut Draft,
    source: &Source<'_, '_>,
    reading: &Reading,
    skeleton: &Skeleton,
    clips: &[Clip],
    notes: &mut Vec<ExportNote>,
) -> Result<(), ExportFault> {
    let scene = Scene::new(source, reading, None)?.ok_or(ExportFault::OtherSource)?;
    // Each comes before those that are there.
    for clip in clips.iter().rev() {
        let told = motion::add(draft, source.document, &scene, reading, skeleton, clip)?;
        told.into_iter().for_each(|note| note.put(notes));
    }
    Ok(())
}

/// A file of ours with motions of a skeleton that it has.
pub(crate) fn with_motions(
    Exported { bytes, mut notes }: Exported,
    skeleton: &Skeleton,
    clips: &[Clip],
) -> Result<Exported, ExportFault> {
    if clips.is_empty() {
        return Ok(Exported { bytes, notes });
    }
    let (reading, _) = super::read(&bytes, None, &ImportOptions::default())?;
    let moving = edit(&bytes, None, |draft, source, notes| {
        add_motions(draft, &source, &reading, skeleton, clips, notes)?;
        motion::join_weights(draft);
        Ok(())
    })?;
    notes.extend(moving.notes);
    Ok(Exported { bytes: moving.bytes, notes })
}

/// A packed file as the importer reads it.
struct Source<'a, 'd> {
    document: &'a Document,
    accessors: &'a Accessors<'d>,
    /// Accessors of weights that compression rounded, so that their sums are not 1 by more than f32 makes them.
    rounded: &'a HashSet<usize>,
}

/// Packs a file, has it altered, and tidies up.
fn edit(
    bytes: &[u8],
    folder: Option<&Path>,
    alter: impl FnOnce(&mut Draft, Source<'_, '_>, &mut Vec<ExportNote>) -> Result<(), ExportFault>,
) -> Result<Exported, ExportFault> {
    let mut notes = Vec::new();
    let (mut draft, rounded) = packed::open(bytes, folder, &mut notes)?;
    let mut base = draft.freeze();
    let mut document = typed(&mut draft, &base)?;
    if finite::mend(&mut draft, &document, &base, &mut notes) {
        base.extend(draft.freeze());
        document = typed(&mut draft, &base)?;
    }
    let accessors = Accessors::new(&document, Buffers::new(&document, Some(&base), None, Budget::new(base.len())));
    alter(&mut draft, Source { document: &document, accessors: &accessors, rounded: &rounded }, &mut notes)?;
    let mut draft = finish::finish(draft, &base)?;
    super::own::mark(&mut draft.json);
    let bytes = draft.into_glb().map_err(ExportFault::TooLong)?;
    Ok(Exported { bytes, notes })
}

/// What the importer sees of a draft whose bytes are `base`.
fn typed(draft: &mut Draft, base: &[u8]) -> Result<Document, Fault> {
    draft.json["buffers"][0]["byteLength"] = json!(base.len());
    Document::deserialize(&draft.json).map_err(|e| Fault::Json { path: String::new(), reason: e.to_string() })
}

/// See [`crate::export::alone`].
pub(crate) fn alone(
    name: &str,
    rig: &Rig,
    from: &Provenance,
    options: &ExportOptions,
) -> Result<Exported, ExportFault> {
    let mut notes = Vec::new();
    let mut header = json!({"version": "2.0", "generator": MAKER});
    if !from.author.is_empty() {
        header["copyright"] = json!(from.author);
    }
    // Where model portals write it, too.
    if !from.licence.is_empty() {
        header["extras"] = json!({"license": from.licence, "author": from.author});
    }
    let draft = bind::alone(rig, name, header, from, options, &mut notes);
    let bytes = draft.into_glb().map_err(ExportFault::TooLong)?;
    Ok(Exported { bytes, notes })
}
