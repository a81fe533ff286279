//! glTF 2.0 as `.gltf`, `.glb` and `.vrm`.
//!
//! Read in this order: container and JSON ([`glb`], [`document`]), which node hangs where ([`nodes`]),
//! skins and their bind pose ([`skins`], [`bind`]),
//! primitives ([`primitives`]) and
//! their vertices at rest ([`placing`], [`influences`]), then what VRM adds ([`vrm`])
//! and, where asked for, motions ([`clips`]).
//! Buffers are loaded when an accessor first needs them, so missing pictures do no harm.

mod accessor;
mod bind;
mod buffers;
mod clips;
mod colliders;
#[cfg(feature = "fbx")]
pub(crate) mod contents;
mod document;
mod draco;
pub(crate) mod export;
mod extensions;
mod glb;
mod influences;
mod instances;
mod meshopt;
mod nodes;
mod own;
mod parted;
mod placing;
mod primitives;
mod rights;
mod shaped;
mod skins;
mod unseen;
mod vrm;
mod write;

use std::path::{Path, PathBuf};

use crate::budget::Budget;
use crate::format::Reads;
use crate::marked::unmarked;
use crate::reading::{Told, ToldSkin};
use crate::{Fault, ImportOptions, ReadJoint, Reading, Rights, Warning};
use accessor::Accessors;
use bind::Binds;
use buffers::Buffers;
use buffers::buffers_named;
use document::Document;
pub use draco::decode_draco;
pub use meshopt::decode_meshopt;
use nodes::Nodes;
#[cfg(feature = "fbx")]
pub(crate) use own::said_made_of;
pub(crate) use own::{is_own, made_of, say_made_of};
use placing::Apart;
use skins::Skins;
pub use write::to_glb;

/// glTF 2.0 as JSON or GLB; VRM is a GLB.
pub(crate) struct Gltf;

impl Reads for Gltf {
    fn name(&self) -> &'static str {
        "glTF"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["glb", "gltf", "vrm"]
    }

    fn starts(&self, bytes: &[u8]) -> bool {
        bytes.starts_with(b"glTF")
    }

    /// Bytes of a glTF do.
    fn ending_tells(&self) -> bool {
        false
    }

    /// The brace that JSON opens with, with or without a byte-order mark.
    fn may_start(&self, bytes: &[u8]) -> bool {
        unmarked(bytes).trim_ascii_start().starts_with(b"{")
    }

    fn short(&self) -> Option<&'static str> {
        Some("glb")
    }

    fn is_rig(&self, _: &Path) -> bool {
        true
    }

    /// The buffers that a `.gltf` names, there or not. What a GLB keeps outside is not asked.
    fn beside(&self, path: &Path, folder: &Path) -> Vec<PathBuf> {
        match path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("gltf")) {
            true => buffers_named(&std::fs::read(path).unwrap_or_default(), folder),
            false => Vec::new(),
        }
    }

    fn read(&self, bytes: &[u8], folder: Option<&Path>, of: &ImportOptions) -> Result<(Reading, Rights), Fault> {
        read(bytes, folder, of)
    }
}

/// Reads a file's bytes; `folder` is where buffers in files of their own are looked for, if at all.
pub(crate) fn read(bytes: &[u8], folder: Option<&Path>, options: &ImportOptions) -> Result<(Reading, Rights), Fault> {
    let mut warnings = Vec::new();
    let chunks = split(bytes)?;
    if chunks.trailing > 0 {
        warnings.push(Warning::TrailingBytes(chunks.trailing));
    }
    let mut document = Document::parse(chunks.json)?;
    parted::part(&mut document);
    extensions::check_required(&document)?;
    let accessors = Accessors::new(&document, Buffers::new(&document, chunks.binary, folder, Budget::new(bytes.len())));

    let nodes = Nodes::new(&document)?;
    warnings.extend(instances::told(&document, &nodes));
    let skins = Skins::read(&document, &nodes, &accessors, &mut warnings)?;
    let mut sources = primitives::collect(&document, &accessors, &mut warnings)?;
    let whole = options.shaped && shaped::apply(&document, &accessors, &mut sources);
    let binds = Binds::new(&nodes, &skins, &sources, &accessors, &mut warnings);
    let joints = skins.joints(&document, &binds, &mut warnings)?;
    let scene = placing::Scene { accessors: &accessors, nodes: &nodes, skins: &skins, binds: &binds };
    let apart = match options.shown {
        true => Apart { colliders: colliders::colliders(&document), unseen: unseen::unseen(&document) },
        false => Apart::default(),
    };
    let (vertex_sets, parts, left_out) = scene.place(sources, &joints, &apart, &mut warnings)?;
    let body = vrm::read(&document, &scene, &mut warnings);
    let wanted = options.motion.as_deref();
    let clips = options.clips;
    let clips = clips.map(|resample| clips::read(chunks.json, &document, &scene, (resample, wanted), &mut warnings));
    let clips = clips.unwrap_or_default();
    let origin = binds.origin().as_vec3().into();
    let shown_off = binds.shown_off().as_vec3();
    let shown_off = if shown_off.is_finite() { shown_off.into() } else { [0.0; 3] };
    let faces_back = vrm::faces_back(&document);
    let told = Told { skins: told(&skins, &binds, &joints), left_out };
    Ok((
        Reading {
            joints,
            vertex_sets,
            parts,
            body,
            clips,
            origin,
            shown_off,
            faces_back,
            shaped: if whole { Vec::new() } else { shaped::shaped(&document) },
            told,
            warnings,
            ..Reading::default()
        },
        rights::read(&document),
    ))
}

/// What warnings say of each skin, and whose it is.
fn told(skins: &Skins, binds: &Binds, joints: &[ReadJoint]) -> Vec<ToldSkin> {
    let one = |(number, skin): (usize, &skins::Skin)| {
        let skeleton = joints[usize::from(*skin.numbers.first()?)].skeleton;
        Some(ToldSkin { number, skeleton, posed: binds.posed(number) })
    };
    skins.iter().enumerate().filter_map(one).collect()
}

/// See [`crate::is_vrm`].
pub(crate) fn is_vrm(bytes: &[u8]) -> bool {
    let document = split(bytes).ok().and_then(|chunks| Document::parse(chunks.json).ok());
    document.is_some_and(|document| vrm::is_one(&document))
}

/// The JSON of a file and the bytes that come with it.
fn split(bytes: &[u8]) -> Result<glb::Chunks<'_>, Fault> {
    if bytes.starts_with(b"glTF") {
        return glb::chunks(bytes);
    }
    Ok(glb::Chunks { json: bytes, binary: None, trailing: 0 })
}
